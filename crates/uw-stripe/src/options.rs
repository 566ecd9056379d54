//! What to extract and how to judge it.

use crate::engine::Tracking;
use crate::precise::several::MOST as MOST_STRIPES;
use crate::{Axis, NoiseModel, Roi, StripeError};

/// Widest stripe and longest pooling, px and lines: beyond any camera's.
const LARGEST_EXTENT: f32 = 1000.0;

/// How the centre of the stripe is estimated.
///
/// RMS errors below are over the Cramér–Rao bound of a single line, on the scenes of `examples/accuracy.rs` with the camera's noise given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
#[non_exhaustive]
pub enum Method {
    /// The strongest candidate of each line, through filters matched to width and noise. For kHz cameras and weak computers: no second
    /// candidate, no chi-square, saturation flagged and not corrected. At the bound in clear water (0.99; 1.01 at low signal; 0.99 at slope
    /// 1.2); a lopsided haze biases it by a tenth of a pixel and more, and a brighter glint wins.
    Fast,
    /// Two candidates a line and the neighbours' say in which is taken, the stripe followed behind what outshines it, the same filters, a
    /// sloping background taken out; lines that are saturated, lopsided or of another width are refined as by `Precise`. Where neighbours
    /// show an edge of brightness, speckle or a bend, sigmas are widened and bends corrected as by `Precise`. As `Fast` in clear water,
    /// 0.98 in haze (bias 0.002 px; with long tails 1.02 and 0.012 px), no wrong peak among glints half as bright again.
    #[default]
    Robust,
    /// Maximum likelihood of every line with a smooth background and free width, pixels at full scale as bounds, widths and noise from the
    /// image itself: every result depends on its image alone. 1.00 to 1.04 in clear water, haze, saturation, and on steep stripes; 1.07 in haze
    /// with long tails.
    Precise,
    /// Steger's ridge detector at the candidates of `Robust`, which pools along the stripe: for steep ones and those of low signal. 0.5 in
    /// clear water and at low signal, 0.64 at slope 1.2, at the price of resolution along the stripe. What haze makes of it is taken back by
    /// the mean difference from `Robust` along the stripe.
    Ridge,
    /// Centre of gravity of the strongest candidate, for comparison.
    Cog,
    /// Zero crossing of Blais and Rioux's filter at the strongest candidate, for comparison.
    BlaisRioux,
}

impl Method {
    /// Every method, in the order of their declaration.
    pub const ALL: [Self; 6] =
        [Self::Fast, Self::Robust, Self::Precise, Self::Ridge, Self::Cog, Self::BlaisRioux];

    /// Stable name for reports and command lines, in kebab case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Robust => "robust",
            Self::Precise => "precise",
            Self::Ridge => "ridge",
            Self::Cog => "cog",
            Self::BlaisRioux => "blais-rioux",
        }
    }
}

/// What to extract and how to judge it.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// How the centre is estimated.
    pub method: Method,
    /// Direction of the lines.
    pub axis: Axis,
    /// Region looked at; `None`: the whole image.
    pub roi: Option<Roi>,
    /// The camera's noise; `None`: estimated, by [`Method::Precise`] from each image, by the others as [`width_px`](Self::width_px).
    ///
    /// One without speckle is the camera's alone: where a stripe is several times as rough as it says, the noise is read off the image
    /// where the width is.
    pub noise: Option<NoiseModel>,
    /// Standard deviation of the stripe's cross section, at most 1000 px; `None`: estimated, by [`Method::Precise`] from each image, by the
    /// others from the first image that shows enough of a stripe, and again after [`Extractor::forget`](crate::Extractor::forget).
    pub width_px: Option<f32>,
    /// Looks only around the last image's positions; `None`: at all pixels of every image. Not with [`Method::Precise`].
    pub track: Option<Tracking>,
    /// Stripes that [`Extractor::extract_all`](crate::Extractor::extract_all) looks for, 1 to 16.
    pub stripes: usize,
    /// Pools positions along the stripe, under a Gaussian of this standard deviation in lines, at most 1000, against speckle and at the price of
    /// resolution; `None`: each line for itself.
    pub pool_lines: Option<f32>,
    /// Clipping value where `noise` is not given, DN; `None`: the least 2ⁿ − 1 that the image does not exceed.
    pub full_scale_dn: Option<f32>,
    /// Least ratio of the fitted flux to its sigma.
    pub min_snr: f32,
    /// Largest standard deviation of the cross section, at most 1000 px.
    pub max_width_px: f32,
    /// Largest predicted sigma of the position, px.
    pub max_sigma_px: f32,
    /// Take measurements flagged [`Flags::EDGE`](crate::Flags::EDGE) out, as a calibration board's squares want it.
    pub reject_edges: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::default(),
            axis: Axis::PerRow,
            roi: None,
            noise: None,
            width_px: None,
            track: None,
            stripes: 1,
            pool_lines: None,
            full_scale_dn: None,
            min_snr: 5.0,
            max_width_px: 8.0,
            max_sigma_px: 1.0,
            reject_edges: false,
        }
    }
}

impl Options {
    pub(crate) fn check(&self) -> Result<(), StripeError> {
        let positive = |name, got: f32| {
            if got.is_finite() && got > 0.0 {
                Ok(())
            } else {
                Err(StripeError::InvalidOption { name, needed: "finite and positive", got: f64::from(got) })
            }
        };
        // What memory is taken by.
        let extent = |name, got: f32| {
            if got > LARGEST_EXTENT {
                return Err(StripeError::InvalidOption { name, needed: "at most 1000", got: f64::from(got) });
            }
            positive(name, got)
        };
        positive("min_snr", self.min_snr)?;
        extent("max_width_px", self.max_width_px)?;
        positive("max_sigma_px", self.max_sigma_px)?;
        if let Some(width) = self.width_px {
            extent("width_px", width)?;
        }
        if let Some(lines) = self.pool_lines {
            extent("pool_lines", lines)?;
        }
        if let Some(track) = self.track {
            positive("full_every", track.full_every as f32)?;
        }
        if !(1..=MOST_STRIPES).contains(&self.stripes) {
            let got = self.stripes as f64;
            return Err(StripeError::InvalidOption { name: "stripes", needed: "from 1 to 16", got });
        }
        if let Some(full_scale) = self.full_scale_dn {
            positive("full_scale_dn", full_scale)?;
        }
        self.noise.map_or(Ok(()), |n| n.checked().map(|_| ()))
    }
}
