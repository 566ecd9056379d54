//! The result: one measurement a line, as a structure of arrays, with flags and reasons.

use crate::{Axis, NoiseModel};

/// What is noteworthy about a measurement. Flags inform; only a [`Reject`] takes a measurement out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Flags(u16);

impl Flags {
    /// Nothing noteworthy.
    pub const NONE: Self = Self(0);
    /// Clipped pixels in the window; they were taken as lower bounds.
    pub const SATURATED: Self = Self(1);
    /// A second stripe-like peak on the line; `rival_ratio` says how strong.
    pub const SEVERAL_PEAKS: Self = Self(1 << 1);
    /// The profile is lopsided, or its strength jumps along the stripe: an albedo edge crosses it, and the centre may
    /// be off by more than `sigma_px`.
    pub const EDGE: Self = Self(1 << 2);
    /// The refinement used up its iterations; position and sigma are those of the last one.
    pub const NOT_CONVERGED: Self = Self(1 << 3);
    /// The window was cut by the image's or region's border.
    pub const BORDER: Self = Self(1 << 4);
    /// The residuals are larger than noise explains; `sigma_px` was widened accordingly.
    pub const POOR_FIT: Self = Self(1 << 5);
    /// The stripe was not where the last image had it, and the whole line was searched ([`Tracking`](crate::Tracking)).
    pub const TRACK_LOST: Self = Self(1 << 6);

    /// True when every flag of `other` is set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    pub(crate) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The bits, for storage: the constants above, or-ed.
    pub fn bits(self) -> u16 {
        self.0
    }
}

/// All that some lines are flagged with: without an early end, which vectors do not have.
#[inline(always)]
pub(crate) fn union(flags: &[Flags]) -> Flags {
    flags.iter().fold(Flags::NONE, |all, flags| all | *flags)
}

impl std::ops::BitOr for Flags {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl std::ops::BitOrAssign for Flags {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// Why a line yields no position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Reject {
    /// The line lies outside the region of interest.
    OutsideRoi,
    /// Nothing on the line stands out of the noise.
    NoSignal,
    /// Something stands out, but less than [`min_snr`](crate::Options::min_snr).
    BelowThreshold,
    /// Wider than [`max_width_px`](crate::Options::max_width_px): glare or haze, not a stripe.
    TooWide,
    /// Narrower than any lens would draw it: a hot pixel.
    TooNarrow,
    /// The centre lies on, or beyond, the border of the image or region.
    AtBorder,
    /// Clipped so far that the flanks no longer fix the centre.
    Saturated,
    /// At the end of a run, where the light falls off because part of the beam went past the surface; or flagged
    /// [`Flags::EDGE`] while [`reject_edges`](crate::Options::reject_edges) is set.
    Edge,
    /// No neighbours along the stripe agree with it.
    Inconsistent,
    /// The refinement left the candidate it started from.
    NotConverged,
    /// The predicted sigma exceeds [`max_sigma_px`](crate::Options::max_sigma_px).
    Imprecise,
    /// Another stripe lies so near that the two centres are not told apart ([`Extractor::extract_all`](crate::Extractor::extract_all)).
    Merged,
    /// The line cuts a bend of the stripe so steeply that blur moves the centre by more than can be corrected.
    Bent,
}

impl Reject {
    /// Every reason, in the order of their declaration.
    pub const ALL: [Self; 13] = [
        Self::OutsideRoi,
        Self::NoSignal,
        Self::BelowThreshold,
        Self::TooWide,
        Self::TooNarrow,
        Self::AtBorder,
        Self::Saturated,
        Self::Edge,
        Self::Inconsistent,
        Self::NotConverged,
        Self::Imprecise,
        Self::Merged,
        Self::Bent,
    ];

    /// Stable name for reports, in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::OutsideRoi => "outside_roi",
            Self::NoSignal => "no_signal",
            Self::BelowThreshold => "below_threshold",
            Self::TooWide => "too_wide",
            Self::TooNarrow => "too_narrow",
            Self::AtBorder => "at_border",
            Self::Saturated => "saturated",
            Self::Edge => "edge",
            Self::Inconsistent => "inconsistent",
            Self::NotConverged => "not_converged",
            Self::Imprecise => "imprecise",
            Self::Merged => "merged",
            Self::Bent => "bent",
        }
    }
}

/// One valid measurement of a [`Stripe`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// Line of the image: the row for [`Axis::PerRow`], the column for [`Axis::PerColumn`].
    pub line: usize,
    /// Centre along the line, px; 0 is the centre of the line's first pixel in the whole image.
    pub position_px: f64,
    /// Predicted standard deviation of the position, px.
    pub sigma_px: f64,
    /// Peak height above the background, DN.
    pub amplitude: f64,
    /// Notes.
    pub flags: Flags,
}

/// The stripe in one image: one entry a line of the whole image in every array.
///
/// `position_px[i]` is NaN exactly where `reject[i]` is a reason. The other arrays keep what was measured up to the
/// rejection, and are NaN where nothing was. Every method gives position, sigma, height and background; of the rest:
///
/// | | `Fast`, `Cog`, `BlaisRioux` | `Robust`, and `Ridge` from it | `Precise`, and [`Extractor::extract_all`](crate::Extractor::extract_all) |
/// |---|---|---|---|
/// | `width_px` | that of the filters | measured | measured |
/// | `chi2` | NaN | of two shapes that filters lack; of the fit, where a line was refined | of the fit |
/// | `rival_ratio` | NaN | of the second candidate's height | of the next candidate's light |
/// | `scatter_widths` | 0 | measured | measured |
/// | `unbent_px` | 0 | measured; 0 of ridges, which the smoothing bends, not the lens | measured |
/// | [`Flags::SATURATED`] | flagged, not corrected | corrected by refinement | corrected |
/// | [`Flags::SEVERAL_PEAKS`], [`Flags::EDGE`] | never | yes | yes |
/// | [`Flags::NOT_CONVERGED`], [`Flags::POOR_FIT`] | never | of refined lines | yes |
/// | [`Flags::BORDER`] | yes | yes | yes |
/// | [`Flags::TRACK_LOST`] | where tracked | where tracked | never |
///
/// `Ridge` replaces position, sigma, height and background by its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Stripe {
    /// Direction of the lines.
    pub axis: Axis,
    /// Centre along the line, px in the whole image; NaN: none.
    pub position_px: Vec<f32>,
    /// Predicted standard deviation of the position, px.
    pub sigma_px: Vec<f32>,
    /// Peak height above the background, DN.
    pub amplitude: Vec<f32>,
    /// Standard deviation of the Gaussian cross section along the line, before integration over pixels, px.
    pub width_px: Vec<f32>,
    /// Background under the centre (of the difference image, if a background was subtracted), DN.
    pub background: Vec<f32>,
    /// Chi-square of the fit by its degrees of freedom; where filters were enough, over two shapes that they lack: a sloping background and
    /// another width. NaN: not measured.
    pub chi2: Vec<f32>,
    /// Strength of the strongest other peak of the line by that of the one taken, as seen above the noise; 0: no other; NaN: not looked for.
    pub rival_ratio: Vec<f32>,
    /// Notes on each measurement.
    pub flags: Vec<Flags>,
    /// Why there is no position; `None`: there is one.
    pub reject: Vec<Option<Reject>>,
    /// The noise that thresholds and sigmas rest on: the given one, or the image's own estimate.
    pub noise: NoiseModel,
    /// Scatter of the centres along the stripe beyond what the fits predict, in widths; part of every `sigma_px`.
    pub scatter_widths: f32,
    /// What was taken back of the position where blur along the stripe bends it, px; 0: nothing. What part of the width that blur has, and what the sheet of light,
    /// one image hardly tells: a share of this ([`UNBENT_UNSURE`](crate::UNBENT_UNSURE)) is in `sigma_px`.
    pub unbent_px: Vec<f32>,
}

impl Stripe {
    pub(crate) fn empty() -> Self {
        Self {
            axis: Axis::PerRow,
            position_px: Vec::new(),
            sigma_px: Vec::new(),
            amplitude: Vec::new(),
            width_px: Vec::new(),
            background: Vec::new(),
            chi2: Vec::new(),
            rival_ratio: Vec::new(),
            flags: Vec::new(),
            reject: Vec::new(),
            noise: NoiseModel::start(255.0),
            scatter_widths: 0.0,
            unbent_px: Vec::new(),
        }
    }

    /// Clears to `lines` entries that lie outside the region, keeping the buffers.
    pub(crate) fn reset(&mut self, axis: Axis, lines: usize) {
        self.axis = axis;
        for array in [
            &mut self.position_px,
            &mut self.sigma_px,
            &mut self.amplitude,
            &mut self.width_px,
            &mut self.background,
            &mut self.chi2,
            &mut self.rival_ratio,
        ] {
            array.clear();
            array.resize(lines, f32::NAN);
        }
        self.unbent_px.clear();
        self.unbent_px.resize(lines, 0.0);
        self.flags.clear();
        self.flags.resize(lines, Flags::NONE);
        self.reject.clear();
        self.reject.resize(lines, Some(Reject::OutsideRoi));
    }

    /// Takes the position of a line out again.
    pub(crate) fn drop_line(&mut self, line: usize, reason: Reject) {
        self.reject[line] = Some(reason);
        self.position_px[line] = f32::NAN;
    }

    /// Number of lines, with and without a position.
    pub fn len(&self) -> usize {
        self.position_px.len()
    }

    /// True before the first image.
    pub fn is_empty(&self) -> bool {
        self.position_px.is_empty()
    }

    /// The valid measurements, in the order of the lines.
    pub fn measurements(&self) -> impl Iterator<Item = Measurement> + '_ {
        (0..self.len()).filter(|&i| self.reject[i].is_none()).map(|i| Measurement {
            line: i,
            position_px: f64::from(self.position_px[i]),
            sigma_px: f64::from(self.sigma_px[i]),
            amplitude: f64::from(self.amplitude[i]),
            flags: self.flags[i],
        })
    }

    /// Number of valid measurements.
    pub fn found(&self) -> usize {
        self.reject.iter().filter(|r| r.is_none()).count()
    }

    /// Number of lines rejected for each reason of [`Reject::ALL`], zeros included.
    pub fn rejected(&self) -> impl Iterator<Item = (Reject, usize)> + '_ {
        Reject::ALL.into_iter().map(|r| (r, self.reject.iter().filter(|&&x| x == Some(r)).count()))
    }
}
