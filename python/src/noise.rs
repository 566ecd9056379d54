//! The camera's noise.

use crate::convert::{Frame, Images, stack};
use crate::errors::{OrRaise, input};
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use uwscan::stripe::{NoiseModel as Model, PhotonTransfer, Pixel, StripeError};

/// Noise of a grey value μ that holds a stripe's signal s: variance
/// ``read_noise_dn² + 1/12 + μ / gain_e_per_dn + (speckle_contrast · s)²``, DN².
///
/// Parameters
/// ----------
/// gain_e_per_dn : float
///     Electrons a DN.
/// read_noise_dn : float
///     Standard deviation in the dark, without rounding, DN.
/// speckle_contrast : float, default 0
///     Standard deviation over mean of the laser's speckle, per pixel.
/// full_scale_dn : float, default 255
///     Grey value at and above which pixels are clipped, DN.
///
/// Raises
/// ------
/// InputError
///     For a value that is not finite or out of range.
///
/// Examples
/// --------
/// >>> import uwscan
/// >>> noise = uwscan.NoiseModel(40.0, 1.0)
/// >>> round(noise.variance_dn2(100.0), 4)
/// 3.5833
#[pyclass(module = "uwscan", frozen, eq)]
#[derive(PartialEq)]
pub struct NoiseModel {
    pub model: Model,
    sigmas: Option<(f32, f32)>,
}

#[pymethods]
impl NoiseModel {
    #[new]
    #[pyo3(signature = (gain_e_per_dn, read_noise_dn, speckle_contrast = 0.0, full_scale_dn = 255.0))]
    fn new(
        py: Python<'_>,
        gain_e_per_dn: f32,
        read_noise_dn: f32,
        speckle_contrast: f32,
        full_scale_dn: f32,
    ) -> PyResult<Self> {
        let model = Model { gain_e_per_dn, read_noise_dn, speckle_contrast, full_scale_dn };
        Ok(Self { model: model.checked().or_raise(py)?, sigmas: None })
    }

    /// The camera's noise from frames of even light and of none: photon transfer.
    ///
    /// Parameters
    /// ----------
    /// images : sequence of numpy.ndarray
    ///     One stack (n, h, w) an exposure, n ≥ 2, uint8 or uint16, taken one after the other of the same light or of none; levels
    ///     should reach from the dark to near full scale. A single stack is one exposure, of which vignetting makes many levels.
    /// full_scale_dn : float, optional
    ///     Where pixels are clipped, for example 4095 for 12 bits; by default 255, and 65535 for uint16.
    ///
    /// Returns
    /// -------
    /// NoiseModel
    ///     With `sigma_gain_e_per_dn` and `sigma_read_noise_dn`.
    ///
    /// Raises
    /// ------
    /// InputError
    ///     Where the frames do not tell the gain.
    #[staticmethod]
    #[pyo3(signature = (images: "typing.Any", *, full_scale_dn = None) -> "NoiseModel")]
    fn from_flat_fields(images: &Bound<'_, PyAny>, full_scale_dn: Option<f32>) -> PyResult<Self> {
        let py = images.py();
        let single = Images::of("images", images).ok().filter(|i| i.shape().0.is_some());
        let exposures = match single {
            Some(stack) => vec![stack],
            None => images
                .try_iter()
                .map_err(|_| input(py, "images must be stacks (n, h, w), one an exposure"))?
                .map(|stack| Images::of("a stack of images", &stack?))
                .collect::<PyResult<Vec<_>>>()?,
        };
        let (mut narrow, mut wide) = (Vec::new(), Vec::new());
        for exposure in &exposures {
            match exposure {
                Images::U8(array) => narrow.push(array),
                Images::U16(array) => wide.push(array),
            }
        }
        let made = match (narrow.is_empty(), wide.is_empty()) {
            (false, true) => transfer(py, &narrow, full_scale_dn.unwrap_or(f32::from(u8::MAX))),
            (true, false) => transfer(py, &wide, full_scale_dn.unwrap_or(f32::from(u16::MAX))),
            (true, true) => return Err(input(py, "images holds no stack")),
            (false, false) => return Err(input(py, "all images must be of one type")),
        }?;
        Ok(Self { model: made.noise, sigmas: Some((made.sigma_gain_e_per_dn, made.sigma_read_noise_dn)) })
    }

    /// Electrons a DN.
    #[getter]
    fn gain_e_per_dn(&self) -> f32 {
        self.model.gain_e_per_dn
    }

    /// Standard deviation in the dark, without rounding, DN.
    #[getter]
    fn read_noise_dn(&self) -> f32 {
        self.model.read_noise_dn
    }

    /// Standard deviation over mean of the laser's speckle, per pixel.
    #[getter]
    fn speckle_contrast(&self) -> f32 {
        self.model.speckle_contrast
    }

    /// Grey value at and above which pixels are clipped, DN.
    #[getter]
    fn full_scale_dn(&self) -> f32 {
        self.model.full_scale_dn
    }

    /// Standard deviation of the gain, e⁻/DN; None unless it was estimated from flat fields.
    #[getter]
    fn sigma_gain_e_per_dn(&self) -> Option<f32> {
        self.sigmas.map(|s| s.0)
    }

    /// Standard deviation of the read noise, DN; None unless it was estimated from flat fields.
    #[getter]
    fn sigma_read_noise_dn(&self) -> Option<f32> {
        self.sigmas.map(|s| s.1)
    }

    /// Variance, DN², of a pixel whose expected grey value is `level_dn`, `signal_dn` of it the stripe's.
    #[pyo3(signature = (level_dn, signal_dn = 0.0))]
    fn variance_dn2(&self, level_dn: f64, signal_dn: f64) -> f64 {
        self.model.variance(level_dn, signal_dn)
    }

    fn __repr__(&self) -> String {
        let m = &self.model;
        format!(
            "NoiseModel(gain_e_per_dn={:?}, read_noise_dn={:?}, speckle_contrast={:?}, full_scale_dn={:?})",
            m.gain_e_per_dn, m.read_noise_dn, m.speckle_contrast, m.full_scale_dn
        )
    }
}

fn transfer<P: Pixel + numpy::Element>(
    py: Python<'_>,
    exposures: &[&PyReadonlyArrayDyn<'_, P>],
    full_scale_dn: f32,
) -> PyResult<PhotonTransfer> {
    let stacks: Option<Vec<_>> = exposures.iter().map(|array| stack(array)).collect();
    let Some(stacks) = stacks.filter(|_| exposures.iter().all(|e| e.ndim() == 3)) else {
        return Err(input(py, "each exposure must be a stack (n, h, w)"));
    };
    py.detach(|| {
        let frames =
            stacks.iter().map(|stack| stack.outer_iter().map(Frame::of).collect::<Result<Vec<_>, _>>());
        let frames = frames.collect::<Result<Vec<_>, StripeError>>()?;
        let views = frames.iter().map(|frames| frames.iter().map(Frame::view).collect::<Result<Vec<_>, _>>());
        let views = views.collect::<Result<Vec<_>, StripeError>>()?;
        let exposures: Vec<&[_]> = views.iter().map(Vec::as_slice).collect();
        Model::from_flat_frames(&exposures, full_scale_dn)
    })
    .or_raise(py)
}
