//! Stripe extraction on arrays.

mod codes;
mod job;
mod result;

pub use codes::stripe_codes;
pub use result::Stripe;

use crate::convert::Images;
use crate::errors::input;
use crate::noise::NoiseModel;
use job::Job;
use numpy::{PyArray, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use uwscan::stripe::{Axis, Method, Options, Roi};

/// Arrays of float32 a stripe has.
const VALUES: usize = 7;
/// Arrays of uint16 besides: flags and reasons.
const NOTES: usize = 2;

/// The stripe method of this name.
pub fn method(py: Python<'_>, name: &str) -> PyResult<Method> {
    let found = Method::ALL.into_iter().find(|m| m.name() == name);
    found.ok_or_else(|| {
        let all: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        input(py, format!("method must be one of {}, got \"{name}\"", all.join(", ")))
    })
}

fn axis(py: Python<'_>, name: &str) -> PyResult<Axis> {
    match name {
        "rows" => Ok(Axis::PerRow),
        "columns" => Ok(Axis::PerColumn),
        _ => Err(input(py, format!("axis must be \"rows\" or \"columns\", got \"{name}\""))),
    }
}

/// The laser stripe of an image, or of each image of a stack, to a fraction of a pixel.
///
/// Parameters
/// ----------
/// image : numpy.ndarray
///     (h, w) or (n, h, w), uint8 or uint16 (right-justified). Read as it lies in memory where the pixels of a row follow each other.
/// axis : str, default "rows"
///     "rows": one measurement a row (a stripe roughly vertical); "columns": one a column.
/// method : str, default "robust"
///     "fast", "robust", "precise", "ridge", "cog" or "blais-rioux".
/// noise : NoiseModel, optional
///     The camera's noise. Without it the noise is read off the image: by "precise" off each, by the others off the first image of the
///     stack that shows enough of a stripe.
/// sigma_px : float, optional
///     Standard deviation of the stripe's cross section, px. Without it, as `noise`.
/// threshold : float, optional
///     Least ratio of the stripe's light to its sigma; 5 by default.
/// roi : tuple of int, optional
///     Region looked at: (x, y, width, height).
/// background : numpy.ndarray, optional
///     (h, w) of the image's type: the same scene with the laser off. With it, lines are measured as by "precise".
/// reject_edges : bool, default False
///     Leave out what lies on an edge of brightness.
/// full_scale_dn : float, optional
///     Value at which pixels are clipped, where `noise` does not say it; by default the least 2ⁿ − 1 that the image does not exceed.
/// out : Stripe, optional
///     A result of the same shape and axis to fill anew, instead of making one.
/// threads : int, default 1
///     Threads that share a stack.
///
/// Returns
/// -------
/// Stripe
///     Arrays of the shape (h,), or (n, h) for a stack.
///
/// Raises
/// ------
/// DtypeError
///     For an array that is not of uint8 or uint16.
/// InputError
///     For an image without pixels, of another shape, or a setting out of range. An image without a stripe is no error: its
///     positions are NaN.
///
/// Examples
/// --------
/// >>> import numpy as np, uwscan
/// >>> x = np.arange(40)
/// >>> row = 200 * np.exp(-0.125 * (x - 20.25) ** 2)
/// >>> stripe = uwscan.extract_stripe(np.tile(row, (16, 1)).astype(np.uint8))
/// >>> bool(np.all(np.abs(stripe.position_px - 20.25) < 0.02))
/// True
#[pyfunction]
#[pyo3(signature = (
    image: "numpy.typing.NDArray[numpy.uint8] | numpy.typing.NDArray[numpy.uint16]",
    *,
    axis: "typing.Literal['rows', 'columns']" = "rows",
    method: "typing.Literal['fast', 'robust', 'precise', 'ridge', 'cog', 'blais-rioux']" = "robust",
    noise = None,
    sigma_px = None,
    threshold = None,
    roi = None,
    background: "numpy.typing.NDArray[numpy.uint8] | numpy.typing.NDArray[numpy.uint16] | None" = None,
    reject_edges = false,
    full_scale_dn = None,
    out = None,
    threads = 1,
) -> "Stripe")]
#[allow(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn extract_stripe<'py>(
    py: Python<'py>,
    image: &Bound<'py, PyAny>,
    axis: &str,
    method: &str,
    noise: Option<PyRef<'py, NoiseModel>>,
    sigma_px: Option<f32>,
    threshold: Option<f32>,
    roi: Option<(usize, usize, usize, usize)>,
    background: Option<&Bound<'py, PyAny>>,
    reject_edges: bool,
    full_scale_dn: Option<f32>,
    out: Option<Bound<'py, Stripe>>,
    threads: usize,
) -> PyResult<Bound<'py, Stripe>> {
    let images = Images::of("image", image)?;
    let background = background.map(|b| Images::of("background", b)).transpose()?;
    let defaults = Options::default();
    let options = Options {
        axis: self::axis(py, axis)?,
        method: self::method(py, method)?,
        noise: noise.map(|n| n.model),
        width_px: sigma_px,
        min_snr: threshold.unwrap_or(defaults.min_snr),
        roi: roi.map(|(x, y, width, height)| Roi { x, y, width, height }),
        reject_edges,
        full_scale_dn,
        ..defaults
    };
    let (number, height, width) = images.shape();
    let lines = options.axis.lines(width, height);
    let axis = options.axis;
    let frames = number.unwrap_or(1);
    let mut values = vec![0.0_f32; VALUES * frames * lines];
    let mut notes = vec![0_u16; NOTES * frames * lines];
    let job = Job { options, lines, threads };
    match (&images, &background) {
        (Images::U8(images), None) => job.run(py, images, None, &mut values, &mut notes)?,
        (Images::U16(images), None) => job.run(py, images, None, &mut values, &mut notes)?,
        (Images::U8(images), Some(Images::U8(dark))) => {
            job.run(py, images, Some(dark), &mut values, &mut notes)?;
        }
        (Images::U16(images), Some(Images::U16(dark))) => {
            job.run(py, images, Some(dark), &mut values, &mut notes)?;
        }
        _ => return Err(input(py, "background must be of the image's type")),
    }
    let shape = |arrays: usize| match number {
        Some(n) => vec![arrays, n, lines],
        None => vec![arrays, lines],
    };
    if let Some(out) = out {
        let kept = out.get();
        if kept.axis != axis || kept.values.bind(py).shape() != shape(VALUES) {
            let (got, needed) = (kept.shape(py), shape(VALUES)[1..].to_vec());
            return Err(input(
                py,
                format!(
                    "out must be a Stripe of shape {needed:?} along the same axis, got {got:?} by {}",
                    kept.axis()
                ),
            ));
        }
        kept.values.bind(py).try_readwrite()?.as_slice_mut()?.copy_from_slice(&values);
        kept.notes.bind(py).try_readwrite()?.as_slice_mut()?.copy_from_slice(&notes);
        return Ok(out);
    }
    let values = PyArray::from_vec(py, values).reshape(shape(VALUES))?.unbind();
    let notes = PyArray::from_vec(py, notes).reshape(shape(NOTES))?.unbind();
    Bound::new(py, Stripe { values, notes, axis })
}
