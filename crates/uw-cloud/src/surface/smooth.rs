//! Smoothing that knows each point's sigma: vertices moved to what they and their neighbours say together.

use super::noise::Noise;
use super::normals::Incident;
use super::quadric::{Neighbour, Quadric, Sums};
use crate::mesh::NONE;
use crate::plane::square_to;
use crate::robust::{median, rejection_limit};
use nalgebra::{Unit, Vector3};

/// The fewest rings of neighbours of a fit, and the most: of five, some ninety points, the height has a fifth of a point's sigma left, and errors that points share are more.
const FEWEST_RINGS: usize = 2;
const MOST_RINGS: usize = 5;

/// Fits of a vertex: of the fewest rings first.
const FITS: usize = MOST_RINGS - FEWEST_RINGS + 1;

/// Cosine of the angle between a vertex's normal and the light beyond which its point, which moves along the light, says little of the surface's height.
const GRAZING_COS: f64 = 0.1;

/// A vertex's step along the direction in which its point is uncertain.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    pub(super) move_mm: Vector3<f64>,
    /// Sigma after it by the sigma before.
    pub(super) sigma_ratio: f64,
}

/// What is fitted to a vertex's neighbourhood.
#[derive(Clone, Copy, Default)]
struct Fits {
    /// Variance of the vertex's point along the normal, mm².
    variance: f64,
    /// Of the fewest rings first, up to the first that there is none of.
    surfaces: [Option<Quadric>; FITS],
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
    positions_mm: &[[f64; 3]],
    points: &[u32],
    triangles: &[[u32; 3]],
    normals: &[[f32; 3]],
    noise: &Noise<'_>,
) -> Vec<Option<Step>> {
    let normal = |v: usize| Unit::try_new(Vector3::from(normals[v].map(f64::from)), 0.5);
    let mut about = About {
        positions_mm,
        points,
        noise,
        rings: Rings::new(triangles, points.len()),
        neighbours: Vec::new(),
    };
    let fits = |v: usize| normal(v).map_or_else(Fits::default, |normal| about.fits(v as u32, &normal));
    let mut fits: Vec<Fits> = (0..points.len()).map(fits).collect();
    let chi2 = |fits: &Fits| fits.surfaces[0].as_ref().map(|narrow| narrow.chi2_by_dof);
    let typical = Typical {
        chi2_by_dof: median(&mut fits.iter().filter_map(chi2).collect::<Vec<_>>()),
        limit: rejection_limit(points.len()),
    };
    fits.iter_mut().for_each(|fits| typical.keep(&mut fits.surfaces));
    let step = |(v, height): (usize, Option<Height>)| {
        let (height, normal) = (height?, normal(v)?);
        let along = noise.light(points[v]).unwrap_or(normal.into_inner());
        let cosine = along.dot(&normal);
        (cosine.abs() > GRAZING_COS)
            .then(|| Step { move_mm: along * (height.mm / cosine), sigma_ratio: height.left.sqrt() })
    };
    heights(&fits, &typical, triangles).into_iter().enumerate().map(step).collect()
}

/// A vertex's height by a fit.
#[derive(Clone, Copy)]
struct Height {
    mm: f64,
    /// The square of what it is off, expected, by its point's variance.
    left: f64,
}

impl Fits {
    /// The height by one of the fits; what it is off by the form is not known of it.
    fn height(&self, fit: usize) -> Option<Height> {
        let surface = self.surfaces[fit].as_ref()?;
        Some(Height { mm: surface.height, left: (surface.variance / self.variance).min(1.0) })
    }
}

/// What chi² of the vertices' fits is like: by how much their sigmas are too small or too large.
struct Typical {
    chi2_by_dof: f64,
    limit: f64,
}

impl Typical {
    /// Whether a fit's neighbours lie on it as far as their sigmas tell.
    fn has(&self, fit: &Quadric) -> bool {
        // chi² of d degrees of freedom spreads by sqrt(2 d).
        fit.chi2_by_dof <= self.chi2_by_dof * (1.0 + self.limit * (2.0 / fit.dof).sqrt())
    }

    /// Keeps those of a vertex's fits that hold, up to the first that does not.
    fn keep(&self, fits: &mut [Option<Quadric>]) {
        let holding = fits.iter().take_while(|fit| fit.as_ref().is_some_and(|fit| self.has(fit))).count();
        fits[holding..].fill(None);
    }

    /// What a wider fit's height is off by the form, squared, in the vertex's variances: what it differs by from that of a narrow one, less what noise makes them differ by. By itself it is worth little, and need not be positive.
    fn off(&self, fits: &Fits, wider: usize) -> Option<f64> {
        let (narrow, wider) = (fits.height(0)?, fits.height(wider)?);
        let variance = (self.chi2_by_dof * fits.variance).max(f64::MIN_POSITIVE);
        Some((wider.mm - narrow.mm).powi(2) / variance - (narrow.left - wider.left))
    }
}

/// Returns the heights of vertices whose fits hold: of the fits that are expected to err least.
fn heights(fits: &[Fits], typical: &Typical, triangles: &[[u32; 3]]) -> Vec<Option<Height>> {
    let mut best: Vec<Option<Height>> = fits.iter().map(|fits| fits.height(0)).collect();
    for wider in 1..FITS {
        let off = means(fits.iter().map(|fits| typical.off(fits, wider)), triangles, FEWEST_RINGS + wider);
        for ((best, fits), off) in best.iter_mut().zip(fits).zip(off) {
            let (Some(best), Some(wider)) = (best, fits.height(wider)) else { continue };
            let left = wider.left + off.max(0.0);
            if left < best.left {
                *best = Height { left, ..wider };
            }
        }
    }
    best
}

/// Returns means of what is known over so many rings about each vertex, the nearer ones counting for more; nil where nothing is.
fn means(values: impl Iterator<Item = Option<f64>>, triangles: &[[u32; 3]], rings: usize) -> Vec<f64> {
    let mut sums: Vec<[f64; 2]> =
        values.map(|value| value.map_or([0.0, 0.0], |value| [value, 1.0])).collect();
    for _ in 0..rings {
        let mut wider = vec![[0.0, 0.0]; sums.len()];
        for corners in triangles {
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

/// A mesh's vertices with what is known of their points.
struct About<'a> {
    positions_mm: &'a [[f64; 3]],
    points: &'a [u32],
    noise: &'a Noise<'a>,
    rings: Rings,
    /// Of the vertex that is asked about: kept for the room that they have.
    neighbours: Vec<Neighbour>,
}

impl About<'_> {
    /// The fits to a vertex and the rings about it: a wider one is of what the one before was of, and of another ring.
    fn fits(&mut self, v: u32, normal: &Unit<Vector3<f64>>) -> Fits {
        let [right, up] = square_to(normal);
        let at = |v: u32| Vector3::from(self.positions_mm[v as usize]);
        let variance = |v: u32| self.noise.along(self.points[v as usize], normal);
        let middle = at(v);
        let mut fits = Fits { variance: variance(v), ..Fits::default() };
        let mut sums = Sums::default();
        self.rings.begin(v);
        self.neighbours.clear();
        for rings in 1..=MOST_RINGS {
            self.rings.add();
            let within = self.neighbours.len();
            for &w in &self.rings.vertices[within..self.rings.count] {
                let variance = variance(w);
                if variance <= 0.0 {
                    return fits;
                }
                let arm = at(w) - middle;
                self.neighbours.push(Neighbour {
                    along: [right.dot(&arm), up.dot(&arm)],
                    height: normal.dot(&arm),
                    weight: variance.recip(),
                });
            }
            sums.add(&self.neighbours[within..]);
            if rings >= FEWEST_RINGS {
                let fit = Quadric::through(&self.neighbours, &sums);
                fits.surfaces[rings - FEWEST_RINGS] = fit;
                if fit.is_none() {
                    break;
                }
            }
        }
        fits
    }
}

/// A vertex and the rings of vertices about it, by triangles that connect them.
struct Rings {
    /// Where each vertex's neighbours begin, and all of these.
    starts: Vec<u32>,
    beside: Vec<u32>,
    /// Those that were taken in are the first so many.
    vertices: Vec<u32>,
    count: usize,
    /// Where the outermost ring begins.
    outermost: usize,
    /// About which vertex each one was last taken in.
    taken: Vec<u32>,
    about: u32,
}

impl Rings {
    fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let incident = Incident::new(triangles, vertices);
        let mut starts = Vec::with_capacity(vertices + 1);
        starts.push(0);
        // Each edge from both of its ends: three for a triangle, and some more along borders.
        let mut beside = Vec::with_capacity(4 * triangles.len());
        let mut taken = vec![NONE; vertices];
        for v in 0..incident.vertices() {
            taken[v as usize] = v;
            for &w in incident.of(v).iter().flat_map(|&t| &triangles[t as usize]) {
                if std::mem::replace(&mut taken[w as usize], v) != v {
                    beside.push(w);
                }
            }
            starts.push(beside.len() as u32);
        }
        taken.fill(NONE);
        // What is not taken in is written behind the last one, too.
        Self {
            starts,
            beside,
            vertices: vec![NONE; vertices + 1],
            count: 0,
            outermost: 0,
            taken,
            about: NONE,
        }
    }

    fn begin(&mut self, v: u32) {
        self.about = v;
        self.taken[v as usize] = v;
        self.vertices[0] = v;
        (self.count, self.outermost) = (1, 0);
    }

    /// Takes the next ring in.
    fn add(&mut self) {
        let mut count = self.count;
        for at in self.outermost..self.count {
            let v = self.vertices[at] as usize;
            for &w in &self.beside[self.starts[v] as usize..self.starts[v + 1] as usize] {
                // Written in any case and kept if it is new: no branch has to be guessed.
                self.vertices[count] = w;
                count +=
                    usize::from(std::mem::replace(&mut self.taken[w as usize], self.about) != self.about);
            }
        }
        (self.outermost, self.count) = (self.count, count);
    }
}
