//! A stripe's arrays.

use crate::convert::Out;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use uwscan::stripe::Axis;

/// The laser stripe of an image or of a stack of images: one entry a line (row or column) of the whole image.
///
/// Arrays have the shape (h,) for an image and (n, h) for a stack (with ``axis="columns"``: w instead of h). They are views of
/// one block of memory, which ``extract_stripe(…, out=stripe)`` fills anew.
#[pyclass(module = "uwscan", frozen)]
pub struct Stripe {
    pub(super) values: Py<PyArrayDyn<f32>>,
    pub(super) notes: Py<PyArrayDyn<u16>>,
    pub(super) axis: Axis,
}

impl Stripe {
    fn value<'py>(&self, py: Python<'py>, which: usize) -> PyResult<Out<'py, f32>> {
        Ok(Out::known(self.values.bind(py).get_item(which)?))
    }

    fn note<'py>(&self, py: Python<'py>, which: usize) -> PyResult<Out<'py, u16>> {
        Ok(Out::known(self.notes.bind(py).get_item(which)?))
    }
}

#[pymethods]
impl Stripe {
    /// Centre along the line, px; 0 is the centre of the line's first pixel. NaN where there is no stripe. float32.
    #[getter]
    fn position_px<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 0)
    }

    /// Predicted standard deviation of the position, px. float32.
    #[getter]
    fn sigma_px<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 1)
    }

    /// Peak height above the background, DN. float32.
    #[getter]
    fn amplitude<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 2)
    }

    /// Standard deviation of the Gaussian cross section along the line, px. float32.
    #[getter]
    fn width_px<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 3)
    }

    /// Background under the centre, DN. float32.
    #[getter]
    fn background<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 4)
    }

    /// Chi-square of the fit by its degrees of freedom; NaN where it is not measured. float32.
    #[getter]
    fn chi2<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 5)
    }

    /// Strength of the strongest other peak of the line by that of the one taken; 0: no other; NaN: not looked for. float32.
    #[getter]
    fn rival_ratio<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f32>> {
        self.value(py, 6)
    }

    /// What is noteworthy about each measurement: bits of ``uwscan.StripeFlags``. uint16.
    #[getter]
    fn flags<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, u16>> {
        self.note(py, 0)
    }

    /// Why a line has no position: a value of ``uwscan.StripeReject``; 0 where it has one. uint16.
    #[getter]
    fn reject<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, u16>> {
        self.note(py, 1)
    }

    /// ``"rows"``: one measurement a row, the position is u; ``"columns"``: one a column, the position is v.
    #[getter]
    pub(super) fn axis(&self) -> &'static str {
        match self.axis {
            Axis::PerRow => "rows",
            Axis::PerColumn => "columns",
        }
    }

    /// Number of images and of lines: (h,) or (n, h).
    #[getter]
    pub(super) fn shape(&self, py: Python<'_>) -> Vec<usize> {
        self.values.bind(py).shape()[1..].to_vec()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let positions: PyReadonlyArrayDyn<'_, f32> = self.value(py, 0)?.into_inner().extract()?;
        let found = positions.as_array().iter().filter(|p| p.is_finite()).count();
        Ok(format!("Stripe(shape={:?}, axis=\"{}\", found={found})", self.shape(py), self.axis()))
    }
}
