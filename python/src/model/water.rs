//! The water's index.

use crate::convert::{Out, floats};
use crate::errors::input;
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use uwscan::geom;

/// An argument with a number as its default.
#[derive(FromPyObject)]
pub enum Given<'py> {
    Number(f64),
    Other(Bound<'py, PyAny>),
}

/// Index of refraction of water relative to air: Quan and Fry (Appl. Opt. 34 (1995) 3477), with a term linear in depth.
///
/// Parameters
/// ----------
/// temperature_c : array_like
///     Temperature, °C (0 to 30).
/// salinity_psu : array_like
///     Practical salinity (0 to 35).
/// wavelength_nm : array_like
///     Wavelength in air, nm (400 to 700).
/// depth_m : array_like, default 0.0
///     Depth below the surface, m.
///
/// Returns
/// -------
/// float or numpy.ndarray
///     The arguments broadcast against each other; a float where all are numbers.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> round(uwscan.water_index(20.0, 35.0, 532.0), 6)
/// 1.34151
/// >>> uwscan.water_index([10.0, 20.0], 0.0, 532.0).round(5).tolist()
/// [1.33569, 1.33504]
#[pyfunction]
#[pyo3(text_signature = "(temperature_c, salinity_psu, wavelength_nm, depth_m=0.0)")]
#[pyo3(signature = (
    temperature_c: "numpy.typing.ArrayLike",
    salinity_psu: "numpy.typing.ArrayLike",
    wavelength_nm: "numpy.typing.ArrayLike",
    depth_m: "numpy.typing.ArrayLike" = Given::Number(0.0),
) -> "typing.Any")]
pub fn water_index<'py>(
    py: Python<'py>,
    temperature_c: &Bound<'py, PyAny>,
    salinity_psu: &Bound<'py, PyAny>,
    wavelength_nm: &Bound<'py, PyAny>,
    depth_m: Given<'py>,
) -> PyResult<Bound<'py, PyAny>> {
    let depth_m = match depth_m {
        Given::Number(depth_m) => depth_m.into_pyobject(py)?.into_any(),
        Given::Other(depth_m) => depth_m,
    };
    let given = [temperature_c, salinity_psu, wavelength_nm, &depth_m];
    let numbers: Result<Vec<f64>, _> = given.iter().map(|any| any.extract::<f64>()).collect();
    if let Ok([t, s, l, d]) = numbers.as_deref() {
        return Ok(geom::water::index(*t, *s, *l, *d).into_pyobject(py)?.into_any());
    }
    let names = ["temperature_c", "salinity_psu", "wavelength_nm", "depth_m"];
    let arrays: Vec<_> =
        names.into_iter().zip(given).map(|(name, any)| floats(name, any)).collect::<PyResult<_>>()?;
    let arrays: Vec<&Bound<'_, PyAny>> = arrays.iter().map(|a| a.as_any()).collect();
    let numpy = py.import("numpy")?;
    let tuple = pyo3::types::PyTuple::new(py, arrays)?;
    let refused = |e: PyErr| input(py, e.value(py).to_string());
    let broadcast = numpy.call_method1("broadcast_arrays", tuple).map_err(refused)?;
    let mut columns = Vec::new();
    for array in broadcast.try_iter()? {
        let array = floats("an argument", &array?.call_method0("copy")?)?;
        columns.push((array.as_array().iter().copied().collect::<Vec<f64>>(), array.shape().to_vec()));
    }
    let [(t, shape), (s, _), (l, _), (d, _)] = &columns[..] else {
        return Err(input(py, "four arguments are needed"));
    };
    let index = (0..t.len()).map(|i| geom::water::index(t[i], s[i], l[i], d[i])).collect();
    Out::<f64>::of(py, index).into_inner().call_method1("reshape", (shape.clone(),))
}
