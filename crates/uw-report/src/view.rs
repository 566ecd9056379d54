//! Points and triangles in space, packed for the page's own viewer.

use crate::colour::{Rgb, Scale};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// Points or a surface that turn in the browser.
#[derive(Debug, Clone, Default)]
pub struct View {
    /// What it shows.
    pub caption: String,
    /// For whoever does not see it.
    pub description: String,
    /// Positions, mm. Whoever fills them decides how many there are: each takes six bytes, and three a colouring.
    pub points_mm: Vec<[f64; 3]>,
    /// Triangles between them; none: the points themselves are drawn.
    pub triangles: Vec<[u32; 3]>,
    /// Ways to colour them, the first is shown first.
    pub colourings: Vec<Colouring>,
    /// Which way is up on the page, in the points' frame.
    pub up: [f64; 3],
    /// Towards the eye at first, in the points' frame.
    pub towards_eye: [f64; 3],
}

/// A colour a point.
#[derive(Debug, Clone)]
pub struct Colouring {
    /// What the colours mean.
    pub name: String,
    /// Theirs, one a point.
    pub colours: Vec<Rgb>,
    /// The scale and its unit, where there is one.
    pub scale: Option<(Scale, String)>,
}

/// A view as the page carries it.
#[derive(Debug)]
pub(crate) struct Packed {
    /// Positions as three 16-bit shares of the box around all, little-endian, base64.
    pub(crate) positions: String,
    /// The box's middle and the length of its longest side, mm.
    pub(crate) middle_mm: [f64; 3],
    pub(crate) side_mm: f64,
    /// 32-bit indices, base64; empty: none.
    pub(crate) triangles: String,
    /// Three bytes a point, base64.
    pub(crate) colours: Vec<String>,
}

/// Largest share.
const STEPS: f64 = 65535.0;

impl View {
    pub(crate) fn packed(&self) -> Packed {
        let finite = || self.points_mm.iter().filter(|p| p.iter().all(|v| v.is_finite()));
        let ends = |axis: usize| {
            let values = finite().map(|p| p[axis]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        let ends = [0, 1, 2].map(ends).map(|e| if e.0 <= e.1 { e } else { (0.0, 0.0) });
        let middle_mm = ends.map(|(low, high)| 0.5 * (low + high));
        let side_mm =
            ends.iter().fold(0.0_f64, |side, (low, high)| side.max(high - low)).max(f64::MIN_POSITIVE);
        let share = |value: f64, axis: usize| {
            let share = (value - middle_mm[axis]) / side_mm + 0.5;
            if share.is_finite() { (share.clamp(0.0, 1.0) * STEPS).round() as u16 } else { 0 }
        };
        let positions: Vec<u8> = self
            .points_mm
            .iter()
            .flat_map(|p| [0, 1, 2].map(|axis| share(p[axis], axis)))
            .flat_map(u16::to_le_bytes)
            .collect();
        let triangles: Vec<u8> = self.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
        let colours = self.colourings.iter().map(|c| STANDARD.encode(c.colours.as_flattened())).collect();
        Packed {
            positions: STANDARD.encode(positions),
            middle_mm,
            side_mm,
            triangles: STANDARD.encode(triangles),
            colours,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_kept_to_a_part_of_the_box() {
        let view = View {
            points_mm: vec![[-10.0, 5.0, 900.0], [30.0, 5.0, 910.0], [0.0, f64::NAN, 905.0]],
            triangles: vec![[0, 1, 2]],
            colourings: vec![Colouring { name: "c".into(), colours: vec![[1, 2, 3]; 3], scale: None }],
            ..View::default()
        };
        let packed = view.packed();
        assert_eq!((packed.middle_mm, packed.side_mm), ([10.0, 5.0, 905.0], 40.0));
        let bytes = STANDARD.decode(&packed.positions).unwrap();
        let shares: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        let back = |i: usize, axis: usize| {
            (f64::from(shares[3 * i + axis]) / STEPS - 0.5) * packed.side_mm + packed.middle_mm[axis]
        };
        for (i, point) in view.points_mm.iter().take(2).enumerate() {
            for (axis, value) in point.iter().enumerate() {
                assert!((back(i, axis) - value).abs() <= 0.5 * packed.side_mm / STEPS);
            }
        }
        assert_eq!(STANDARD.decode(&packed.triangles).unwrap().len(), 12);
        assert_eq!(STANDARD.decode(&packed.colours[0]).unwrap(), [1, 2, 3, 1, 2, 3, 1, 2, 3]);
    }

    #[test]
    fn nothing_packs_to_nothing() {
        let packed = View::default().packed();
        assert!(packed.positions.is_empty() && packed.side_mm > 0.0);
    }
}
