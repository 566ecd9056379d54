//! The exact model of the instrument, on arrays.

mod camera;
mod galvo;
mod port;
mod scanner;
mod water;

pub use camera::Camera;
pub use galvo::{Fan, Galvo};
pub use port::Port;
pub use scanner::Scanner;
pub use water::water_index;

use crate::convert::{Out, row_arrays, table};
use crate::errors::input;
use pyo3::prelude::*;
use uwscan::geom::{self, GeomError, Medium};

/// A row for each of an array's, NaN where there is none; without the GIL.
pub fn each<const I: usize, const O: usize>(
    name: &str,
    any: &Bound<'_, PyAny>,
    one: impl Fn([f64; I]) -> Result<[f64; O], GeomError> + Sync,
) -> PyResult<Vec<[f64; O]>> {
    let rows: Vec<[f64; I]> = row_arrays(&table(name, any, I)?);
    Ok(any.py().detach(|| rows.into_iter().map(|row| one(row).unwrap_or([f64::NAN; O])).collect()))
}

pub fn medium(py: Python<'_>, index: f64) -> PyResult<Medium> {
    if (1.0..3.0).contains(&index) {
        return Ok(Medium::of_index(index));
    }
    Err(input(py, format!("an index of refraction must be from 1 to 3, got {index}")))
}

/// Origins and directions.
pub type Rays<'py> = (Out<'py, f64>, Out<'py, f64>);

/// A ray as six numbers: origin, direction.
pub fn six(ray: &geom::Ray) -> [f64; 6] {
    let (o, d) = (&ray.origin, &ray.direction);
    [o.x, o.y, o.z, d.x, d.y, d.z]
}

/// Rays of six numbers each as two arrays.
pub fn rays(py: Python<'_>, rows: Vec<[f64; 6]>) -> PyResult<Rays<'_>> {
    let part = |first: usize| rows.iter().map(|r| [r[first], r[first + 1], r[first + 2]]).collect();
    Ok((Out::rows::<3>(py, part(0))?, Out::rows::<3>(py, part(3))?))
}
