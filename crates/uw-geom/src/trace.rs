//! Where a ray meets a sheet of light.

use crate::error::GeomError;
use crate::fan::{Sheet, across_trace};
use crate::ray::Ray;
use crate::real::{Real, values};
use nalgebra::{Scalar, Vector3};

/// A sheet made ready for rays to meet it.
///
/// In a frame whose third axis is the window's normal and whose second runs along the fan's trace on the window, the fan's
/// air directions are (κ, y, 1): κ is the sheet's own, y says which of its rays. With q² = κ² + y²,
/// A = h + t/√(n_g² + (n_g² − 1) q²) and B = 1/√(n² + (n² − 1) q²), that ray passes at depth d outside the window through
/// (κ, y)(A + B d). A camera's ray is (α + β t, δ + ρ t) in the same frame. The first coordinate gives t = N/S with
/// N = α₁ − κC, S = κE − β₁, C = A + Bδ, E = Bρ; put into the second and multiplied by S:
///
/// F(y) = y (E α₁ − β₁ C) − κ (α₂ E − β₂ C) + α₂β₁ − β₂α₁ = 0,
///
/// not linear only through the slow change of A and B with y².
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tracer<T: Scalar = f64> {
    apex_mm: Vector3<T>,
    /// Unit vectors across the trace, along it, and out through the window.
    axes: [Vector3<T>; 3],
    /// κ, the tangent of the angle between fan and window normal.
    tangent: T,
    distance_mm: T,
    thickness_mm: T,
    /// n_g² and n².
    squared_indices: [T; 2],
}

/// A ray in a sheet's frame, (α₁, α₂, δ) and (β₁, β₂, ρ).
struct Line<T> {
    start: [T; 3],
    rate: [T; 3],
}

/// A and B at a ray of the fan, and their derivatives to y.
struct Reach {
    at: [f64; 2],
    per_y: [f64; 2],
}

/// A step of y, relative, behind which the next is below rounding, as Newton doubles the digits.
const SETTLED: f64 = 2e-6;
/// Newton steps after which the search is given up.
const MAX_STEPS: u32 = 30;

impl<T: Real> Tracer<T> {
    /// # Errors
    /// [`GeomError::NotThroughWindow`] for a fan that lies along its window, [`GeomError::Invalid`] for an apex in front of it.
    pub(crate) fn new(sheet: &Sheet<T>) -> Result<Self, GeomError> {
        let port = &sheet.port;
        let out = port.normal;
        let across = across_trace(&sheet.normal, &out)?;
        port.is_ahead()?;
        Ok(Self {
            apex_mm: sheet.apex_mm,
            axes: [across, out.cross(&across), out],
            tangent: -sheet.normal.dot(&out) / sheet.normal.dot(&across),
            distance_mm: port.distance_mm,
            thickness_mm: port.thickness_mm,
            squared_indices: [port.glass.index, sheet.outside.index].map(|n| n * n),
        })
    }

    /// The tracer without derivatives.
    pub(crate) fn value(&self) -> Tracer {
        Tracer {
            apex_mm: values(&self.apex_mm),
            axes: self.axes.map(|a| values(&a)),
            tangent: self.tangent.value(),
            distance_mm: self.distance_mm.value(),
            thickness_mm: self.thickness_mm.value(),
            squared_indices: self.squared_indices.map(T::value),
        }
    }

    /// The point where `ray` meets the sheet, from its solution in `f64`: one Newton step in the scalar, which carries the
    /// exact derivatives.
    pub(crate) fn meet(&self, ray: &Ray<T>, found: &Solution) -> Vector3<T> {
        let Line { start: [a1, a2, depth], rate: [b1, b2, rise] } = self.line(ray);
        let y = T::constant(found.y);
        let q_squared = self.tangent * self.tangent + y * y;
        let one = T::constant(1.0);
        let [glass, b] = self.squared_indices.map(|nn| one / (nn + (nn - one) * q_squared).sqrt());
        let (c, e) = (self.distance_mm + self.thickness_mm * glass + b * depth, b * rise);
        let excess = (e * a1 - b1 * c) * y - self.tangent * (a2 * e - b2 * c) + a2 * b1 - b2 * a1;
        let t = (a1 - self.tangent * c) / (self.tangent * e - b1);
        ray.at(t - excess.scale(found.t_per_y / found.excess_per_y))
    }

    fn line(&self, ray: &Ray<T>) -> Line<T> {
        let from_apex = ray.origin - self.apex_mm;
        let mut start = self.axes.map(|axis| axis.dot(&from_apex));
        start[2] = start[2] - self.distance_mm - self.thickness_mm;
        Line { start, rate: self.axes.map(|axis| axis.dot(&ray.direction)) }
    }
}

/// Where a ray meets a sheet: the distance along the ray (mm), which of the fan's rays it is, and the slopes there.
pub(crate) struct Solution {
    pub(crate) distance_mm: f64,
    y: f64,
    t_per_y: f64,
    excess_per_y: f64,
}

/// The search for the meeting, with what it needs of a sheet worked out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solver {
    tracer: Tracer,
    /// A and B as series in y² about the fan's middle, for the start.
    series: [[f64; 3]; 2],
}

impl Solver {
    pub(crate) fn new(tracer: &Tracer) -> Self {
        // (g + e y²)^(−1/2) = g^(−1/2) (1 − x/2 + 3x²/8 …), x = e y²/g.
        let root = |nn: f64| {
            let e = nn - 1.0;
            let g = nn + e * tracer.tangent * tracer.tangent;
            let (x, one) = (e / g, 1.0 / g.sqrt());
            [one, -0.5 * x * one, 0.375 * x * x * one]
        };
        let [glass, outside] = tracer.squared_indices.map(root);
        let mut a = glass.map(|c| c * tracer.thickness_mm);
        a[0] += tracer.distance_mm;
        Self { tracer: *tracer, series: [a, outside] }
    }

    /// # Errors
    /// [`GeomError::NoIntersection`].
    #[inline(always)]
    pub(crate) fn solve(&self, ray: &Ray) -> Result<Solution, GeomError> {
        let line = self.tracer.line(ray);
        let mut y = self.start(&line);
        for _ in 0..MAX_STEPS {
            let reach = self.reach(y);
            let (change, excess_per_y) = self.step(&line, y, &reach);
            if change.abs() <= SETTLED * (1.0 + y.abs()) {
                return self
                    .ahead(&line, y, change, excess_per_y, &reach)
                    .map_or_else(|| self.search(&line), Ok);
            }
            y += change;
        }
        self.search(&line)
    }

    /// A start that leaves one step to make for any ray in sight: the meeting with the plane that touches the sheet in its
    /// middle, and from there Newton's step on the series (A and B being even in y), without a second division.
    #[inline]
    fn start(&self, line: &Line<f64>) -> f64 {
        let ([a1, a2, depth], [b1, b2, rise], k) = (line.start, line.rate, self.tracer.tangent);
        let [[a, a_2, a_4], [b, b_2, b_4]] = self.series;
        let (c, e) = (a + b * depth, b * rise);
        let inverse = 1.0 / (e * a1 - b1 * c);
        let y = (k * (a2 * e - b2 * c) - (a2 * b1 - b2 * a1)) * inverse;
        let z = y * y;
        let (a_z, b_z) = (a_2 + z * a_4, b_2 + z * b_4);
        let (c_z, e_z) = (a_z + b_z * depth, b_z * rise);
        let (own, sheets) = (e_z * a1 - b1 * c_z, k * (a2 * e_z - b2 * c_z));
        // F = y³ own − y² sheets here, and F′ = (1 + x) / inverse.
        let x = y * (3.0 * y * own - 2.0 * sheets) * inverse;
        let better = y - z * (y * own - sheets) * inverse * (1.0 - x + x * x);
        if better.abs() < MOST { better } else { 0.0 }
    }

    /// The solution a last step `change` from y, unless it lies behind the window or the ray's origin.
    #[inline]
    fn ahead(
        &self,
        line: &Line<f64>,
        y: f64,
        change: f64,
        excess_per_y: f64,
        reach: &Reach,
    ) -> Option<Solution> {
        let ([a1, _, depth], [b1, _, rise], k) = (line.start, line.rate, self.tracer.tangent);
        let ([a, b], [a_per_y, b_per_y]) = (reach.at, reach.per_y);
        let (c_per_y, e_per_y) = (a_per_y + b_per_y * depth, b_per_y * rise);
        let (c, e) = (a + b * depth + c_per_y * change, b * rise + e_per_y * change);
        let steepness = 1.0 / (k * e - b1);
        let distance_mm = (a1 - k * c) * steepness;
        let t_per_y = -k * (c_per_y + e_per_y * distance_mm) * steepness;
        // A ray along the sheet has no distance at all.
        let ahead = distance_mm > 0.0 && depth + rise * distance_mm > 0.0 && distance_mm.is_finite();
        ahead.then_some(Solution { distance_mm, y: y + change, t_per_y, excess_per_y })
    }

    /// The nearest meeting ahead, wherever on the fan it is: for rays that graze the sheet, on which Newton's steps from the
    /// middle run off or end behind the window.
    #[cold]
    fn search(&self, line: &Line<f64>) -> Result<Solution, GeomError> {
        let excess = |y: f64| {
            let reach = self.reach(y);
            let (change, per_y) = self.step(line, y, &reach);
            -change * per_y
        };
        let station = |i: i32| (f64::from(i) / f64::from(STATIONS) * WIDEST_RAD).tan();
        let mut nearest: Option<Solution> = None;
        let mut before = excess(station(-STATIONS));
        for i in 1 - STATIONS..=STATIONS {
            let after = excess(station(i));
            if before * after <= 0.0 {
                let (mut low, mut high) = (station(i - 1), station(i));
                for _ in 0..BISECTIONS {
                    let middle = 0.5 * (low + high);
                    if excess(middle) * before > 0.0 {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let y = 0.5 * (low + high);
                let reach = self.reach(y);
                let (change, per_y) = self.step(line, y, &reach);
                let found = self.ahead(line, y, change.clamp(low - y, high - y), per_y, &reach);
                nearest = match (nearest, found) {
                    (Some(a), Some(b)) if a.distance_mm < b.distance_mm => Some(a),
                    (a, b) => b.or(a),
                };
            }
            before = after;
        }
        nearest.ok_or(GeomError::NoIntersection)
    }

    /// Newton's step of y, and F′.
    #[inline]
    fn step(&self, line: &Line<f64>, y: f64, reach: &Reach) -> (f64, f64) {
        let ([a1, a2, depth], [b1, b2, rise], k) = (line.start, line.rate, self.tracer.tangent);
        let [a, b] = reach.at;
        let [a_per_y, b_per_y] = reach.per_y;
        let (c, e) = (a + b * depth, b * rise);
        let (c_per_y, e_per_y) = (a_per_y + b_per_y * depth, b_per_y * rise);
        let linear = e * a1 - b1 * c;
        let excess = y * linear - k * (a2 * e - b2 * c) + (a2 * b1 - b2 * a1);
        let per_y = linear + y * (e_per_y * a1 - b1 * c_per_y) - k * (a2 * e_per_y - b2 * c_per_y);
        (-excess / per_y, per_y)
    }

    #[inline]
    fn reach(&self, y: f64) -> Reach {
        let Tracer { tangent, distance_mm, thickness_mm, squared_indices, .. } = self.tracer;
        let q_squared = tangent * tangent + y * y;
        let [(glass, glass_per_y), (b, b_per_y)] = squared_indices.map(|nn| {
            let inverse = 1.0 / (nn + (nn - 1.0) * q_squared);
            let root = inverse.sqrt();
            (root, -y * (nn - 1.0) * inverse * root)
        });
        Reach { at: [distance_mm + thickness_mm * glass, b], per_y: [thickness_mm * glass_per_y, b_per_y] }
    }
}

/// Stations of the search to each side of the fan's middle, out to this angle.
const STATIONS: i32 = 64;
const WIDEST_RAD: f64 = 1.565;
/// Halvings that bring a station's width to rounding, nearly.
const BISECTIONS: u32 = 45;

/// Largest |y| for which the series is trusted as a start.
const MOST: f64 = 1.0;
