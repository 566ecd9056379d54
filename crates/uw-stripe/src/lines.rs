//! The image as lines along which the stripe is looked for, whatever its type, axis and background.

use crate::lone::{Lone, without_runs};
use crate::{Axis, Pixel, Roi, View};

/// Whether a pixel shows its value or only a bound of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Clip {
    /// The value itself.
    No,
    /// At full scale: the light was at least that.
    Full,
    /// At zero: the light was at most that, since the converter shows nothing below.
    Floor,
}

impl Clip {
    /// What a grey value shows, DN.
    pub fn of(value: f32, full_scale_dn: f32) -> Self {
        if value >= full_scale_dn {
            Self::Full
        } else if value <= 0.0 {
            Self::Floor
        } else {
            Self::No
        }
    }
}

/// Lines of equal length, one after the other.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    /// Pixels a line.
    pub length: usize,
    /// Image line of the first one.
    pub first_line: usize,
    /// Position of the first pixel along the image's line.
    pub first_pixel: usize,
    /// Grey values, background subtracted, DN.
    pub value: Vec<f32>,
    /// Bounds; same layout.
    pub clip: Vec<Clip>,
    /// The background that was subtracted, DN; empty when none was.
    pub pedestal: Vec<f32>,
    /// Light of other stripes that was subtracted, DN: known, but for the shot noise that it left; empty when none was.
    pub light: Vec<f32>,
}

/// One line of [`Lines`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Line<'a> {
    pub value: &'a [f32],
    pub clip: &'a [Clip],
    pedestal: &'a [f32],
    light: &'a [f32],
}

impl<'a> Line<'a> {
    /// A line from which no background was subtracted.
    pub fn plain(value: &'a [f32], clip: &'a [Clip]) -> Self {
        Self { value, clip, pedestal: &[], light: &[] }
    }

    /// Whether anything was subtracted from its pixels.
    pub fn something_known(&self) -> bool {
        !(self.pedestal.is_empty() && self.light.is_empty())
    }

    /// What was subtracted from pixel `i`, DN.
    pub fn pedestal(&self, i: usize) -> f64 {
        self.pedestal.get(i).copied().map_or(0.0, f64::from)
    }

    /// Light of other stripes that was subtracted from pixel `i`, DN.
    pub fn light(&self, i: usize) -> f64 {
        self.light.get(i).copied().map_or(0.0, f64::from)
    }
}

impl Lines {
    /// Number of lines.
    pub fn count(&self) -> usize {
        self.value.len() / self.length.max(1)
    }

    /// Line `i`, counted from the region's first.
    pub fn line(&self, i: usize) -> Line<'_> {
        let range = i * self.length..(i + 1) * self.length;
        let part = |all: &'_ [f32]| if all.is_empty() { 0..0 } else { range.clone() };
        let (pedestal, light) = (&self.pedestal[part(&self.pedestal)], &self.light[part(&self.light)]);
        Line { value: &self.value[range.clone()], clip: &self.clip[range.clone()], pedestal, light }
    }

    /// Fills the lines from a region that lies inside the image (and a background of the same size).
    pub fn load<P: Pixel>(
        &mut self,
        image: &View<'_, P>,
        background: Option<&View<'_, P>>,
        roi: Roi,
        axis: Axis,
        full_scale_dn: f32,
    ) {
        (self.length, self.first_line, self.first_pixel) = match axis {
            Axis::PerRow => (roi.width, roi.y, roi.x),
            Axis::PerColumn => (roi.height, roi.x, roi.y),
        };
        copy(image, roi, axis, &mut self.value);
        self.clip.clear();
        self.clip.extend(self.value.iter().map(|&v| Clip::of(v, full_scale_dn)));
        self.light.clear();
        self.pedestal.clear();
        if let Some(background) = background {
            copy(background, roi, axis, &mut self.pedestal);
            for (v, b) in self.value.iter_mut().zip(&self.pedestal) {
                *v -= b;
            }
        }
    }

    /// Puts the mean of those beside it in place of every pixel that stands alone; gives the lines that have some.
    pub fn clean(&mut self, lone: &Lone) -> Vec<usize> {
        let length = self.length.max(1);
        let mut places = Vec::new();
        for (l, value) in self.value.chunks_exact(length).enumerate().filter(|(_, value)| lone.may_be(value))
        {
            places.extend((1..length.saturating_sub(1)).map(|i| (l, i)).filter(|(_, i)| {
                let beneath = self.pedestal.get(l * length + i).copied().unwrap_or(0.0);
                lone.is([value[i - 1], value[*i], value[i + 1]], beneath)
            }));
        }
        without_runs(&mut places);
        let mut lines: Vec<usize> = Vec::new();
        for (l, i) in places {
            let at = l * length + i;
            (self.value[at], self.clip[at]) = (0.5 * (self.value[at - 1] + self.value[at + 1]), Clip::No);
            if lines.last() != Some(&l) {
                lines.push(l);
            }
        }
        lines
    }
}

/// Copies a region as lines, transposed for columns in square tiles so that both sides stay in the cache.
fn copy<P: Pixel>(image: &View<'_, P>, roi: Roi, axis: Axis, out: &mut Vec<f32>) {
    const TILE: usize = 32;
    out.clear();
    let row = |y: usize| &image.row(roi.y + y)[roi.x..roi.x + roi.width];
    match axis {
        Axis::PerRow => (0..roi.height).for_each(|y| out.extend(row(y).iter().map(|p| p.dn()))),
        Axis::PerColumn => {
            out.resize(roi.width * roi.height, 0.0);
            for top in (0..roi.height).step_by(TILE) {
                for left in (0..roi.width).step_by(TILE) {
                    for y in top..(top + TILE).min(roi.height) {
                        let right = (left + TILE).min(roi.width);
                        for (x, p) in (left..right).zip(&row(y)[left..right]) {
                            out[x * roi.height + y] = p.dn();
                        }
                    }
                }
            }
        }
    }
}
