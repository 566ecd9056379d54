//! The exact stripe: where the middle of the sheet meets what the camera sees.

use crate::mask::Mask;
use crate::sight::{Glimpse, Sight};
use nalgebra::{Vector2, Vector3};

/// Which coordinate of the stripe's centre is looked for on a line of the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Along {
    /// u, on each row: a stripe that runs down the image.
    Rows,
    /// v, on each column.
    Columns,
}

/// An exact point of the stripe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurvePoint {
    /// Where it is seen, px.
    pub pixel: Vector2<f64>,
    /// The surface point, camera frame, mm.
    pub point_mm: Vector3<f64>,
    /// Number of the object.
    pub object: usize,
}

/// Steps a pixel in which a line is searched.
const STEPS: usize = 2;
/// Nearness of an edge at which the search for a crossing beside it ends, px.
const EDGE_PX: f64 = 1e-4;
/// Nearness of a crossing to its true place, px.
const EXACT_PX: f64 = 1e-10;

/// All points of the stripe at whole rows (columns) that the laser lights and the camera sees, line by line.
pub(crate) fn points(sight: &Sight<'_>, along: Along) -> Vec<CurvePoint> {
    let mask = Mask::new(sight, 0);
    let mut found = Vec::new();
    let (lines, length) = match along {
        Along::Rows => (mask.height, mask.width),
        Along::Columns => (mask.width, mask.height),
    };
    for line in 0..lines {
        let marked: Vec<(usize, usize)> = match along {
            Along::Rows => mask.runs(line),
            Along::Columns => mask.column_runs(line),
        };
        let place = |x: f64| match along {
            Along::Rows => Vector2::new(x, line as f64),
            Along::Columns => Vector2::new(line as f64, x),
        };
        let look = |x: f64| sight.look(&place(x));
        for (first, end) in marked {
            let stations = (end - first) * STEPS;
            let at = |k: usize| first as f64 - 0.5 + k as f64 / STEPS as f64;
            let mut before = look(at(0));
            for k in 1..=stations {
                let after = look(at(k));
                search(&look, (at(k - 1), before), (at(k), after), &mut |x, g| {
                    if g.lit && x >= 0.0 && x <= (length - 1) as f64 {
                        found.push(CurvePoint { pixel: place(x), point_mm: g.point, object: g.object });
                    }
                });
                before = after;
            }
        }
    }
    found
}

/// Finds the crossings of the sheet's middle between two places.
fn search(
    look: &dyn Fn(f64) -> Option<Glimpse>,
    (a, at_a): (f64, Option<Glimpse>),
    (b, at_b): (f64, Option<Glimpse>),
    found: &mut dyn FnMut(f64, Glimpse),
) {
    let one_surface = match (&at_a, &at_b) {
        (None, None) => return,
        (Some(p), Some(q)) => p.same_surface(q),
        _ => false,
    };
    if let (true, Some(p), Some(q)) = (one_surface, at_a, at_b) {
        if (p.off_mm < 0.0) != (q.off_mm < 0.0)
            && let Some((x, g)) = crossing(look, (a, p), (b, q))
        {
            found(x, g);
        }
        return;
    }
    // An edge between: what is on either side of it is searched by itself.
    if b - a > EDGE_PX {
        let middle = 0.5 * (a + b);
        let at_middle = look(middle);
        search(look, (a, at_a), (middle, at_middle), found);
        search(look, (middle, at_middle), (b, at_b), found);
    }
}

/// Regula falsi with halved ends (Illinois), on one surface.
fn crossing(
    look: &dyn Fn(f64) -> Option<Glimpse>,
    (mut a, p): (f64, Glimpse),
    (mut b, q): (f64, Glimpse),
) -> Option<(f64, Glimpse)> {
    let (mut fa, mut fb) = (p.off_mm, q.off_mm);
    let mut best = if fa.abs() < fb.abs() { (a, p) } else { (b, q) };
    for _ in 0..60 {
        if (b - a).abs() <= EXACT_PX || best.1.off_mm.abs() <= 0.0 {
            break;
        }
        let x = a - fa * (b - a) / (fb - fa);
        let g = look(x)?;
        let f = g.off_mm;
        let moved = (x - best.0).abs();
        best = (x, g);
        if moved <= EXACT_PX {
            break;
        }
        if (f < 0.0) == (fb < 0.0) {
            fa *= 0.5;
        } else {
            (a, fa) = (b, fb);
        }
        (b, fb) = (x, f);
    }
    Some(best)
}
