//! What is in a plot.

use crate::colour::{Rgb, Scale};

/// A plot in the plane.
#[derive(Debug, Clone)]
pub struct Plot {
    /// Its name.
    pub title: String,
    /// What it shows in words, for whoever does not see it.
    pub description: String,
    /// From left to right.
    pub x: Axis,
    /// From the bottom up.
    pub y: Axis,
    /// Drawn in this order, one over the other.
    pub layers: Vec<Layer>,
    /// A unit is as long along x as along y: the intervals are widened for that.
    pub equal: bool,
    /// What the cells' colours mean: the scale and its unit.
    pub scale: Option<(Scale, String)>,
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it shows, with its unit.
    pub label: String,
    /// Where it begins and ends; y may go down.
    pub range: [f64; 2],
}

impl Axis {
    /// An axis that holds all the values, with a margin of a twentieth on either side.
    pub fn around(label: impl Into<String>, values: impl IntoIterator<Item = f64>) -> Self {
        let finite = values.into_iter().filter(|v| v.is_finite());
        let (low, high) =
            finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        let range = match high - low {
            span if span > 0.0 && span.is_finite() => [low - 0.05 * span, high + 0.05 * span],
            // One value, or none.
            _ if low.is_finite() => [low - low.abs().max(1.0) * 0.05, low + low.abs().max(1.0) * 0.05],
            _ => [0.0, 1.0],
        };
        Self { label: label.into(), range }
    }
}

/// A colour of the page, which its style says: `Series` of the eight that the colour-blind tell apart (M. Okabe, K. Ito).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Ink {
    /// That of text.
    Text,
    /// Of what stands back.
    Faint,
    /// One of the eight series, from 0; more begin anew.
    Series(u8),
}

/// The form of a point's mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marker {
    /// A disc.
    Disc,
    /// A triangle.
    Triangle,
    /// A cross.
    Cross,
    /// A square.
    Square,
}

/// Marks of one kind.
#[derive(Debug, Clone)]
pub enum Layer {
    /// Points, with bars of one sigma to either side along y where there are any.
    Points {
        /// In the legend; empty: not there.
        name: String,
        /// Colour.
        ink: Ink,
        /// Form.
        marker: Marker,
        /// Where.
        at: Vec<[f64; 2]>,
        /// A sigma a point, or none at all.
        sigmas: Vec<f64>,
    },
    /// A line from point to point.
    Line {
        /// In the legend; empty: not there.
        name: String,
        /// Colour.
        ink: Ink,
        /// Where.
        at: Vec<[f64; 2]>,
    },
    /// Rectangles [x from, x to, y from, y to].
    Bars {
        /// In the legend; empty: not there.
        name: String,
        /// Colour.
        ink: Ink,
        /// Where.
        bars: Vec<[f64; 4]>,
    },
    /// Rectangles, each of its own colour.
    Cells {
        /// Where, and which colour.
        cells: Vec<([f64; 4], Rgb)>,
    },
    /// Arrows [x from, y from, x to, y to].
    Arrows {
        /// In the legend; empty: not there.
        name: String,
        /// Colour.
        ink: Ink,
        /// Where.
        arrows: Vec<[f64; 4]>,
    },
}

impl Layer {
    /// Name, colour and form in the legend; `None` for what is not there.
    pub(crate) fn key(&self) -> Option<(&str, Ink, Key)> {
        let (name, ink, key) = match self {
            Self::Points { name, ink, marker, .. } => (name, *ink, Key::Marker(*marker)),
            Self::Line { name, ink, .. } | Self::Arrows { name, ink, .. } => (name, *ink, Key::Line),
            Self::Bars { name, ink, .. } => (name, *ink, Key::Marker(Marker::Square)),
            Self::Cells { .. } => return None,
        };
        (!name.is_empty()).then_some((name.as_str(), ink, key))
    }
}

/// The form of a legend's entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Key {
    Marker(Marker),
    Line,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[expect(clippy::float_cmp, reason = "sums of a few halves are exact")]
    fn an_axis_holds_its_values_with_a_margin() {
        assert_eq!(Axis::around("x", [0.0, 10.0, f64::NAN]).range, [-0.5, 10.5]);
        assert_eq!(Axis::around("x", [100.0]).range, [95.0, 105.0]);
        assert_eq!(Axis::around("x", []).range, [0.0, 1.0]);
    }
}
