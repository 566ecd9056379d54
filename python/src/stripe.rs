//! Stripe extraction on arrays.

use crate::convert::{Frame, Images, Out, stack};
use crate::errors::{OrRaise, input};
use crate::noise::NoiseModel;
use numpy::ndarray::{Axis as Dim, s};
use numpy::{PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayon::prelude::*;
use std::cell::RefCell;
use uwscan::stripe::{Axis, Extractor, Flags, Method, Options, Pixel, Reject, Roi, StripeError};

/// Arrays of float32 a stripe has.
const VALUES: usize = 7;
/// Arrays of uint16 besides: flags and reasons.
const NOTES: usize = 2;
/// Extractors that a thread keeps for calls with the same settings: making filters takes longer than applying them.
const KEPT: usize = 4;

thread_local! {
    static EXTRACTORS: RefCell<Vec<Extractor>> = const { RefCell::new(Vec::new()) };
}

/// The laser stripe of an image or of a stack of images: one entry a line (row or column) of the whole image.
///
/// Arrays have the shape (h,) for an image and (n, h) for a stack (with ``axis="columns"``: w instead of h). They are views of
/// one block of memory, which ``extract_stripe(…, out=stripe)`` fills anew.
#[pyclass(module = "uwscan", frozen)]
pub struct Stripe {
    values: Py<PyArrayDyn<f32>>,
    notes: Py<PyArrayDyn<u16>>,
    axis: Axis,
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
    fn axis(&self) -> &'static str {
        match self.axis {
            Axis::PerRow => "rows",
            Axis::PerColumn => "columns",
        }
    }

    /// Number of images and of lines: (h,) or (n, h).
    #[getter]
    fn shape(&self, py: Python<'_>) -> Vec<usize> {
        self.values.bind(py).shape()[1..].to_vec()
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let positions: PyReadonlyArrayDyn<'_, f32> = self.value(py, 0)?.into_inner().extract()?;
        let found = positions.as_array().iter().filter(|p| p.is_finite()).count();
        Ok(format!("Stripe(shape={:?}, axis=\"{}\", found={found})", self.shape(py), self.axis()))
    }
}

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

struct Job {
    options: Options,
    lines: usize,
    threads: usize,
}

/// Where one image's results go.
struct Place<'a> {
    values: [&'a mut [f32]; VALUES],
    notes: [&'a mut [u16]; NOTES],
}

impl Job {
    fn run<P: Pixel + numpy::Element>(
        self,
        py: Python<'_>,
        images: &PyReadonlyArrayDyn<'_, P>,
        background: Option<&PyReadonlyArrayDyn<'_, P>>,
        values: &mut [f32],
        notes: &mut [u16],
    ) -> PyResult<()> {
        let Some(images) = stack(images) else { return Err(input(py, "image must have two or three axes")) };
        let dark = background.map(|dark| {
            let dark = stack(dark).filter(|d| d.dim().0 == 1);
            dark.ok_or_else(|| input(py, "background must be one image (h, w)"))
        });
        let dark = dark.transpose()?;
        let threads = self.threads;
        let mut places = self.places(values, notes);
        let work = |places: &mut [Place<'_>]| -> Result<(), StripeError> {
            let dark = dark.as_ref().map(|d| Frame::of(d.index_axis(Dim(0), 0))).transpose()?;
            let dark = dark.as_ref().map(Frame::view).transpose()?;
            let mut first = extractor(&self.options)?;
            // What methods learn from the first image that shows it is learned before images are shared out.
            for image in images.outer_iter().take(if dark.is_none() { usize::MAX } else { 0 }) {
                if self.options.method == Method::Precise
                    || first.model().is_some()
                    || first.learn(Frame::of(image)?.view()?)?
                {
                    break;
                }
            }
            let one = |extractor: &mut Extractor, (k, place): (usize, &mut Place<'_>)| {
                let image = Frame::of(images.slice(s![k, .., ..]))?;
                place.fill(extractor.extract(image.view()?, dark)?);
                Ok(())
            };
            if threads == 1 || places.len() < 2 {
                places.iter_mut().enumerate().try_for_each(|job| one(&mut first, job))?;
                keep(first);
                return Ok(());
            }
            let model = first.model();
            let settled = Options {
                noise: model.map(|m| m.0).or(self.options.noise),
                width_px: model.map(|m| m.1).or(self.options.width_px),
                ..self.options.clone()
            };
            places
                .par_iter_mut()
                .enumerate()
                .map_init(
                    || Extractor::new(settled.clone()),
                    |extractor, job| match extractor {
                        Ok(extractor) => one(extractor, job),
                        Err(e) => Err(e.clone()),
                    },
                )
                .collect()
        };
        if threads == 1 {
            return py.detach(|| work(&mut places)).or_raise(py);
        }
        crate::long::run(py, Some(threads), Some(&false.into_pyobject(py)?.to_owned().into_any()), |_| {
            work(&mut places)
        })?
        .or_raise(py)
    }

    /// One place an image: each array holds its values image by image.
    fn places<'a>(&self, values: &'a mut [f32], notes: &'a mut [u16]) -> Vec<Place<'a>> {
        fn arrays<'a, T, const N: usize>(
            all: &'a mut [T],
            lines: usize,
        ) -> [std::slice::ChunksExactMut<'a, T>; N] {
            let size = (all.len() / N).max(1);
            let mut arrays = all.chunks_exact_mut(size);
            std::array::from_fn(|_| arrays.next().unwrap_or_default().chunks_exact_mut(lines.max(1)))
        }
        let frames = values.len() / (VALUES * self.lines).max(1);
        let mut values: [_; VALUES] = arrays(values, self.lines);
        let mut notes: [_; NOTES] = arrays(notes, self.lines);
        let place = |_| Place {
            values: values.each_mut().map(|array| array.next().unwrap_or_default()),
            notes: notes.each_mut().map(|array| array.next().unwrap_or_default()),
        };
        (0..frames).map(place).collect()
    }
}

impl Place<'_> {
    fn fill(&mut self, stripe: &uwscan::stripe::Stripe) {
        let from: [&[f32]; VALUES] = [
            &stripe.position_px,
            &stripe.sigma_px,
            &stripe.amplitude,
            &stripe.width_px,
            &stripe.background,
            &stripe.chi2,
            &stripe.rival_ratio,
        ];
        self.values.iter_mut().zip(from).for_each(|(to, from)| to.copy_from_slice(from));
        let [flags, rejects] = &mut self.notes;
        flags.iter_mut().zip(&stripe.flags).for_each(|(to, flags)| *to = flags.bits());
        rejects.iter_mut().zip(&stripe.reject).for_each(|(to, reason)| *to = reason.map_or(0, number));
    }
}

/// A reason's number: its place among all, from 1.
fn number(reason: Reject) -> u16 {
    Reject::ALL.iter().position(|r| *r == reason).map_or(u16::MAX, |at| at as u16 + 1)
}

/// An extractor with these settings that has learned nothing from other images.
fn extractor(options: &Options) -> Result<Extractor, StripeError> {
    let kept = EXTRACTORS.with_borrow_mut(|kept| {
        let at = kept.iter().position(|e| e.options() == options)?;
        Some(kept.remove(at))
    });
    match kept {
        Some(mut extractor) => {
            // With both given there is nothing to forget, and filters need not be made anew.
            if options.noise.is_none() || options.width_px.is_none() {
                extractor.forget();
            }
            Ok(extractor)
        }
        None => Extractor::new(options.clone()),
    }
}

fn keep(extractor: Extractor) {
    EXTRACTORS.with_borrow_mut(|kept| {
        kept.insert(0, extractor);
        kept.truncate(KEPT);
    });
}

/// The names of flags and reasons with their numbers, which ``uwscan.StripeFlags`` and ``uwscan.StripeReject`` are held against.
#[pyfunction]
pub fn stripe_codes(py: Python<'_>) -> PyResult<(Bound<'_, PyDict>, Bound<'_, PyDict>)> {
    let (flags, reasons) = (PyDict::new(py), PyDict::new(py));
    for (name, flag) in [
        ("SATURATED", Flags::SATURATED),
        ("SEVERAL_PEAKS", Flags::SEVERAL_PEAKS),
        ("EDGE", Flags::EDGE),
        ("NOT_CONVERGED", Flags::NOT_CONVERGED),
        ("BORDER", Flags::BORDER),
        ("POOR_FIT", Flags::POOR_FIT),
        ("TRACK_LOST", Flags::TRACK_LOST),
    ] {
        flags.set_item(name, flag.bits())?;
    }
    for reason in Reject::ALL {
        reasons.set_item(reason.name().to_uppercase(), number(reason))?;
    }
    Ok((flags, reasons))
}
