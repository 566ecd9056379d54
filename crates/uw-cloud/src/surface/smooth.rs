//! Smoothing that knows each point's sigma: vertices moved to what they and their neighbours say together.

use super::noise::Noise;
use super::normals::Incident;
use crate::cloud::PointCloud;
use crate::plane::square_to;
use crate::robust::{median, rejection_limit};
use nalgebra::{SMatrix, SVector, Unit, Vector3};

/// A quadratic height over a plane: 1, x, y, x², xy, y².
const TERMS: usize = 6;

/// Neighbours beyond the terms from which on a fit says how well it holds.
const LEAST_SPARE: usize = 4;

/// Rounds of leaving out what does not belong to the vertex's face.
const ROUNDS: usize = 3;

/// The fewest rings of neighbours of a fit, and the most: of five, some ninety points, the height has a fifth of a point's sigma left, and errors that points share are more.
const FEWEST_RINGS: usize = 2;
const MOST_RINGS: usize = 5;

/// Cosine of the angle between a vertex's normal and the light beyond which its point, which moves along the light, says little of the surface's height.
const GRAZING_COS: f64 = 0.1;

/// A vertex's step along the direction in which its point is uncertain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) move_mm: Vector3<f64>,
    /// Sigma after it by the sigma before.
    pub(super) sigma_ratio: f64,
}

/// A quadratic surface through a vertex's neighbourhood, at the vertex.
struct Local {
    /// Its height over the vertex along the normal, mm.
    height_mm: f64,
    /// Variance of the vertex's point along the normal, mm², and the share of it that is left.
    variance: f64,
    leverage: f64,
    chi2_by_dof: f64,
    dof: f64,
    normal: Unit<Vector3<f64>>,
}

/// Returns how each vertex moves, `None` for those that stay: whose neighbours are few, or not on one smooth surface with it as far as
/// their sigmas tell.
///
/// Heights of rings of neighbours over the tangent plane are fitted by a quadratic surface, each by its own variance along the normal; a curvature
/// is thus not flattened. Of two rings to five, each vertex has as many as its height is expected to err least with, by the noise that is left and by what wider fits of the vertices about it are
/// off (as C. Stein, Ann. Statist. 9 (1981) 1135, estimates a risk). Only triangles that were kept connect, so that nothing is smoothed across a step or a hole. A vertex moves along its
/// point's light and by what the surface says of it; its sigma shrinks by the root of that risk. Sigmas that are too small or too large throughout are
/// made up for by the median of chi²/dof.
pub(super) fn steps(
    cloud: &PointCloud,
    points: &[u32],
    triangles: &[[u32; 3]],
    normals: &[[f32; 3]],
    noise: &Noise<'_>,
) -> Vec<Option<Step>> {
    let incident = Incident::new(triangles, points.len());
    let mut about = About { cloud, points, incident, triangles, noise, rings: Rings::new(points.len()) };
    let first: Vec<Option<Local>> = (0..points.len())
        .map(|v| {
            let normal = Unit::try_new(Vector3::from(normals[v].map(f64::from)), 0.5)?;
            about.fitted(v as u32, normal, FEWEST_RINGS)
        })
        .collect();
    let typical = Typical {
        chi2_by_dof: median(&mut first.iter().flatten().map(|fit| fit.chi2_by_dof).collect::<Vec<_>>()),
        limit: rejection_limit(points.len()),
    };
    let first: Vec<Option<Local>> = first.into_iter().map(|fit| fit.filter(|fit| typical.has(fit))).collect();
    let heights = about.heights(&first, &typical);
    let step = |(v, (fit, height)): (usize, (&Option<Local>, &Option<Height>))| {
        let (fit, height) = (fit.as_ref()?, height.as_ref()?);
        let along = noise.light(points[v]).unwrap_or(fit.normal.into_inner());
        let cosine = along.dot(&fit.normal);
        (cosine.abs() > GRAZING_COS)
            .then(|| Step { move_mm: along * (height.mm / cosine), sigma_ratio: height.left.sqrt() })
    };
    first.iter().zip(&heights).enumerate().map(step).collect()
}

/// A vertex's height by a fit.
#[derive(Clone, Copy)]
struct Height {
    mm: f64,
    /// The square of what it is off, expected, by its point's variance.
    left: f64,
}

impl Local {
    fn height(&self) -> Height {
        Height { mm: self.height_mm, left: self.leverage }
    }
}

/// What chi² of the vertices' fits is like: by how much their sigmas are too small or too large.
struct Typical {
    chi2_by_dof: f64,
    limit: f64,
}

impl Typical {
    /// Whether a fit's neighbours lie on it as far as their sigmas tell.
    fn has(&self, fit: &Local) -> bool {
        // chi² of d degrees of freedom spreads by sqrt(2 d).
        fit.chi2_by_dof <= self.chi2_by_dof * (1.0 + self.limit * (2.0 / fit.dof).sqrt())
    }

    /// What a wider fit's height is off by the form, squared, in the vertex's variances: what it differs by from that of a narrow one, less what noise makes them differ by. By itself it is worth little, and need not be positive.
    fn off(&self, narrow: &Local, wider: &Height) -> f64 {
        let variance = (self.chi2_by_dof * narrow.variance).max(f64::MIN_POSITIVE);
        (wider.mm - narrow.height_mm).powi(2) / variance - (narrow.leverage - wider.left)
    }
}

/// A mesh's vertices with what is known of their points.
struct About<'a> {
    cloud: &'a PointCloud,
    points: &'a [u32],
    incident: Incident,
    triangles: &'a [[u32; 3]],
    noise: &'a Noise<'a>,
    rings: Rings,
}

impl About<'_> {
    /// The heights of vertices that have first fits: of the fits that are expected to err least.
    fn heights(&mut self, first: &[Option<Local>], typical: &Typical) -> Vec<Option<Height>> {
        let mut best: Vec<Option<Height>> = first.iter().map(|fit| fit.as_ref().map(Local::height)).collect();
        let mut widest = best.clone();
        for rings in FEWEST_RINGS + 1..=MOST_RINGS {
            let vertices = (0..).zip(&mut widest).zip(first);
            for ((v, own), fit) in vertices.filter(|((_, own), _)| own.is_some()) {
                let wider = fit.as_ref().and_then(|fit| self.fitted(v, fit.normal, rings));
                *own = wider.filter(|fit| typical.has(fit)).as_ref().map(Local::height);
            }
            let both = first.iter().zip(&widest);
            let off: Vec<Option<f64>> =
                both.map(|(fit, wider)| Some(typical.off(fit.as_ref()?, wider.as_ref()?))).collect();
            for ((best, wider), off) in best.iter_mut().zip(&widest).zip(self.means(&off, rings)) {
                let (Some(best), Some(wider)) = (best, wider) else { continue };
                let left = wider.left + off.max(0.0);
                if left < best.left {
                    *best = Height { left, ..*wider };
                }
            }
        }
        best
    }

    /// The fit to a vertex and some rings about it.
    fn fitted(&mut self, v: u32, normal: Unit<Vector3<f64>>, rings: usize) -> Option<Local> {
        self.rings.begin(v);
        (0..rings).for_each(|_| self.rings.add(&self.incident, self.triangles));
        let at = |v: u32| self.cloud.vector(self.points[v as usize] as usize);
        let variance = |w: u32| self.noise.along(self.points[w as usize], &normal);
        let sample = |&w: &u32| (at(w) - at(v), variance(w), w == v);
        local(normal, self.rings.vertices.iter().map(sample).collect())
    }

    /// Means of what is known over so many rings about each vertex, the nearer ones counting for more; nil where nothing is.
    fn means(&self, values: &[Option<f64>], rings: usize) -> Vec<f64> {
        let own = |value: &Option<f64>| value.map_or([0.0, 0.0], |value| [value, 1.0]);
        let mut sums: Vec<[f64; 2]> = values.iter().map(own).collect();
        for _ in 0..rings {
            let mut wider = vec![[0.0, 0.0]; sums.len()];
            for corners in self.triangles {
                let [a, b, c] = corners.map(|v| sums[v as usize]);
                let sum = [a[0] + b[0] + c[0], a[1] + b[1] + c[1]];
                for &v in corners {
                    wider[v as usize][0] += sum[0];
                    wider[v as usize][1] += sum[1];
                }
            }
            sums = wider;
        }
        sums.iter().map(|[sum, count]| if *count > 0.0 { sum / count } else { 0.0 }).collect()
    }
}

/// A vertex and the rings of vertices about it, by triangles that connect them.
struct Rings {
    vertices: Vec<u32>,
    /// Where the outermost ring begins.
    outermost: usize,
    /// About which vertex each one was last taken in, counted from 1.
    taken: Vec<u32>,
    about: u32,
}

impl Rings {
    fn new(vertices: usize) -> Self {
        Self { vertices: Vec::new(), outermost: 0, taken: vec![0; vertices], about: 0 }
    }

    fn begin(&mut self, v: u32) {
        self.about += 1;
        self.taken[v as usize] = self.about;
        self.vertices.clear();
        self.vertices.push(v);
        self.outermost = 0;
    }

    /// Takes the next ring in.
    fn add(&mut self, incident: &Incident, triangles: &[[u32; 3]]) {
        let ring = self.outermost..self.vertices.len();
        self.outermost = ring.end;
        for at in ring {
            for &t in incident.of(self.vertices[at]) {
                for w in triangles[t as usize] {
                    if self.taken[w as usize] != self.about {
                        self.taken[w as usize] = self.about;
                        self.vertices.push(w);
                    }
                }
            }
        }
    }
}

/// Returns the quadratic surface through neighbours, given by their places, variances along the normal and which is the vertex itself.
fn local(normal: Unit<Vector3<f64>>, mut sample: Vec<(Vector3<f64>, f64, bool)>) -> Option<Local> {
    let tangents = square_to(&normal);
    let reach = sample.iter().map(|(arm, ..)| arm.norm()).fold(0.0, f64::max);
    let terms = |arm: &Vector3<f64>| {
        let [x, y] = tangents.map(|t| t.dot(arm) / reach);
        SVector::<f64, TERMS>::from([1.0, x, y, x * x, x * y, y * y])
    };
    for round in 0..ROUNDS {
        if sample.len() < TERMS + LEAST_SPARE || sample.iter().any(|(_, variance, _)| *variance <= 0.0) {
            return None;
        }
        let mut matrix = SMatrix::<f64, TERMS, TERMS>::zeros();
        let mut right = SVector::<f64, TERMS>::zeros();
        for (arm, variance, _) in &sample {
            let row = terms(arm);
            let weighed = row * variance.recip();
            matrix += row * weighed.transpose();
            right += weighed * normal.dot(arm);
        }
        let inverse = matrix.cholesky()?.inverse();
        let solution = inverse * right;
        let residual = |arm: &Vector3<f64>| normal.dot(arm) - terms(arm).dot(&solution);
        let chi2: f64 = sample.iter().map(|(arm, variance, _)| residual(arm).powi(2) / variance).sum();
        let dof = (sample.len() - TERMS) as f64;
        let worst = rejection_limit(sample.len()).powi(2) * (chi2 / dof).max(1.0);
        let before = sample.len();
        if round + 1 < ROUNDS {
            sample.retain(|(arm, variance, own)| *own || residual(arm).powi(2) <= worst * variance);
        }
        if sample.len() == before {
            let own = sample.iter().find(|(.., own)| *own)?;
            return Some(Local {
                height_mm: solution[0],
                variance: own.1,
                leverage: (inverse[(0, 0)] / own.1).min(1.0),
                chi2_by_dof: chi2 / dof,
                dof,
                normal,
            });
        }
    }
    None
}
