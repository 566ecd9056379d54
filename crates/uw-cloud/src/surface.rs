//! A scan's points as a surface: triangulated in the scan's own parameters, cut where nothing was seen.

mod cut;
mod delaunay;
mod noise;
mod normals;
mod quadric;
mod smooth;
mod step;
mod view;
mod void;

use crate::cloud::PointCloud;
use crate::error::SurfaceError;
use crate::mesh::{NONE, TriangleMesh};
use nalgebra::{Matrix2, Vector2, Vector3};
use noise::Noise;

pub use cut::Cut;
pub use view::Parameters;

/// How a surface is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceOptions {
    /// Where the points were seen from, in the cloud's frame, mm: the frame's origin where this is `None`. With it, points are
    /// triangulated by their directions from there, even where they have pixels.
    pub sensor_mm: Option<[f64; 3]>,
    /// Angle between a triangle's normal and the line of sight or the laser's light from which on it is no surface, rad.
    pub steepest_rad: f64,
    /// Whether vertices are moved to what they and their neighbours say together, each by its sigma. It needs sigmas.
    pub smooth: bool,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self { sensor_mm: None, steepest_rad: 85_f64.to_radians(), smooth: false }
    }
}

/// A surface, and what of the cloud it does not show.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Surface {
    /// The triangles with normals at the vertices, towards the sensor, and with the points' sigmas and intensities as far as they
    /// have any.
    pub mesh: TriangleMesh,
    /// Which point each vertex is.
    pub points: Vec<u32>,
    /// What it was triangulated in.
    pub parameters: Parameters,
    /// Points that were seen in the very direction of another one.
    pub shared_places: usize,
    /// Points that no triangle has as a corner.
    pub loose_points: usize,
    /// Triangles that were left out.
    pub cut: Cut,
    /// What smoothing did, where it was asked for.
    pub smoothed: Option<Smoothed>,
}

/// What smoothing did to the vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Smoothed {
    /// Vertices that were moved. The others have few neighbours, or lie with them on no smooth surface.
    pub moved: usize,
    /// Root mean square of their moves, mm.
    pub rms_mm: f64,
}

/// Anisotropy of the points' spacing from which on they are triangulated again in units of it: to well above it, what counts as a
/// void does not depend on it.
const ANISOTROPY: f64 = 5.0;

/// Returns the surface through a cloud's points, none of them moved unless [`SurfaceOptions::smooth`] says so.
///
/// The points are triangulated in the plane that they were seen in: of the raw image where they have pixels, else of directions from
/// the sensor. Triangles are left out that span a void, stand along the line of sight or the light, or lead across a step (see
/// [`Cut`]); what is then open stays open. Every edge has at most two triangles, and all face the sensor.
/// Time grows as n log n.
///
/// # Errors
/// [`SurfaceError`] for fewer than three points, values that are not finite, points on one line or all in one direction, points about
/// the sensor, where no triangle is left, and for smoothing without sigmas.
pub fn triangulate(cloud: &PointCloud, options: &SurfaceOptions) -> Result<Surface, SurfaceError> {
    cloud.check_finite()?;
    if cloud.len() < 3 {
        return Err(SurfaceError::TooFewPoints { got: cloud.len() });
    }
    if cloud.len() >= (NONE / 6) as usize {
        return Err(SurfaceError::TooManyPoints { allowed: (NONE / 6) as usize, got: cloud.len() });
    }
    let noise = Noise::of(cloud);
    if options.smooth && !noise.is_told() {
        return Err(SurfaceError::NoSigmas);
    }
    let sensor_mm = Vector3::from(options.sensor_mm.unwrap_or_default());
    let (parameters, mut places) = view::places(cloud, sensor_mm, options.sensor_mm.is_none())?;
    let mut flat = delaunay::triangulate(&places);
    if let Some(isotropic) = isotropic(&places, &flat) {
        places = isotropic;
        flat = delaunay::triangulate(&places);
    }
    if flat.triangles.is_empty() {
        return Err(SurfaceError::NoArea);
    }
    let (kept, cut, away) = cut::cut(cloud, &places, &flat, &noise, sensor_mm, options.steepest_rad);
    let mut triangles: Vec<[u32; 3]> =
        flat.triangles.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(t, _)| *t).collect();
    let shared_places = flat.shared;
    drop((flat, kept, places));
    if triangles.is_empty() {
        return Err(SurfaceError::NothingLeft { cut });
    }
    let points = renumbered(&mut triangles, cloud.len());
    if away {
        triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
    }
    let of = |values: &[f32]| points.iter().map(|&p| values[p as usize]).collect::<Vec<_>>();
    let mut positions: Vec<[f64; 3]> = points.iter().map(|&p| cloud.positions_mm()[p as usize]).collect();
    let mut sigmas = cloud.sigmas_mm().map(of);
    let mut smoothed = None;
    if options.smooth {
        let rough =
            TriangleMesh::new(cloud.frame(), positions.clone(), triangles.clone())?.with_vertex_normals();
        let steps =
            smooth::steps(&positions, &points, &triangles, rough.normals().unwrap_or_default(), &noise);
        smoothed = Some(applied(&steps, &mut positions, sigmas.as_deref_mut()));
    }
    let mut mesh = TriangleMesh::new(cloud.frame(), positions, triangles)?.with_vertex_normals();
    if let Some(sigmas) = sigmas {
        mesh = mesh.with_sigmas_mm(sigmas)?;
    }
    if let Some(intensities) = cloud.intensities() {
        mesh = mesh.with_intensities(of(intensities))?;
    }
    let loose_points = cloud.len() - points.len();
    Ok(Surface { mesh, points, parameters, shared_places, loose_points, cut, smoothed })
}

/// Moves vertices by their steps, and returns how many and how far.
fn applied(
    steps: &[Option<smooth::Step>],
    positions: &mut [[f64; 3]],
    mut sigmas: Option<&mut [f32]>,
) -> Smoothed {
    let (mut moved, mut squares) = (0, 0.0);
    for (v, step) in steps.iter().enumerate() {
        let Some(step) = step else { continue };
        positions[v] = (Vector3::from(positions[v]) + step.move_mm).into();
        if let Some(sigma) = sigmas.as_deref_mut().and_then(|all| all.get_mut(v)) {
            *sigma *= step.sigma_ratio as f32;
        }
        moved += 1;
        squares += step.move_mm.norm_squared();
    }
    Smoothed { moved, rms_mm: (squares / moved.max(1) as f64).sqrt() }
}

/// Numbers the corners by the points that are used, in their order, and returns those points.
fn renumbered(triangles: &mut [[u32; 3]], points: usize) -> Vec<u32> {
    let mut number = vec![NONE; points];
    triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
    let mut used = Vec::new();
    for (number, point) in number.iter_mut().zip(0..).filter(|(number, _)| **number == 0) {
        *number = used.len() as u32;
        used.push(point);
    }
    triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    used
}

/// Returns the places in units of their typical spacing, which may differ by direction (rows lie closer than frames); `None` where it
/// hardly does.
///
/// The shape of the spacing is D. Tyler's estimate (Ann. Statist. 15 (1987) 234) from the edges, which long ones across voids do not
/// move.
fn isotropic(places: &[[f64; 2]], flat: &delaunay::Flat) -> Option<Vec<[f64; 2]>> {
    const MOST_TRIANGLES: usize = 500;
    const ROUNDS: usize = 20;
    let place = |v: u32| Vector2::from(places[v as usize]);
    let step = flat.triangles.len().div_ceil(MOST_TRIANGLES).max(1);
    let edges: Vec<Vector2<f64>> = flat
        .triangles
        .iter()
        .step_by(step)
        .flat_map(|&[a, b, c]| [place(b) - place(a), place(c) - place(b), place(a) - place(c)])
        .collect();
    let mut shape = Matrix2::<f64>::identity();
    for _ in 0..ROUNDS {
        let inverse = shape.try_inverse()?;
        let weighted = |e: &Vector2<f64>| e * e.transpose() / e.dot(&(inverse * e)).max(f64::MIN_POSITIVE);
        let sum: Matrix2<f64> = edges.iter().map(weighted).sum();
        let next = sum / sum.trace();
        if !next.iter().all(|value| value.is_finite()) {
            return None;
        }
        shape = next;
    }
    let eigen = shape.symmetric_eigen();
    let (least, most) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
    if !(least > 0.0 && most > ANISOTROPY * ANISOTROPY * least) {
        return None;
    }
    let whitening =
        Matrix2::from_diagonal(&eigen.eigenvalues.map(|e| 1.0 / e.sqrt())) * eigen.eigenvectors.transpose();
    // Kept a rotation, so that the order of corners stays what it was.
    let whitening =
        if whitening.determinant() < 0.0 { Matrix2::new(-1.0, 0.0, 0.0, 1.0) * whitening } else { whitening };
    Some(places.iter().map(|p| (whitening * Vector2::from(*p)).into()).collect())
}
