//! The form of a measured surface about its vertices: which way it faces there, and how it bends.
//!
//! Neighbours are those of the surface, not the nearest in space: nothing is taken from beyond a step, a stripe's points count with those of the stripes beside
//! it however close they lie, and nobody has to look for them.

use crate::mesh::TriangleMesh;
use crate::plane::square_to;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Rounds of taking means over triangles and vertices in turn: after three a normal has of the points' noise what one of the plane through the 24 nearest has.
const ROUNDS: usize = 3;

/// The form about a vertex.
#[derive(Clone, Copy)]
pub(super) struct Form {
    /// Unit normal.
    pub(super) normal: Vector3<f64>,
    /// What the normal changes by with the way along the surface, mm⁻¹.
    pub(super) bend: Matrix3<f64>,
    /// As far as anything that had a say in it may lie, mm.
    pub(super) reach_mm: f64,
    /// Half of the way to the neighbours on the surface, root mean square, squared, mm².
    pub(super) own_mm2: f64,
}

/// Returns the form about each vertex of a mesh; `None` where its triangles have no area.
///
/// The sum of triangles' area vectors depends on the rim of the patch only, and a sum with weights that fall off from ring to ring on where their weights change: the noise of what lies inside cancels.
/// A normal is thus the plane's by least squares, with such weights.
pub(super) fn forms(mesh: &TriangleMesh) -> Vec<Option<Form>> {
    let triangles = mesh.triangles();
    let mut shares = vec![0.0_f64; mesh.vertices_mm().len()];
    triangles.iter().flatten().for_each(|&v| shares[v as usize] += 1.0);
    shares.iter_mut().for_each(|share| *share = 1.0 / share.max(1.0));
    let mut means = vec![Vector3::zeros(); shares.len()];
    let mut before: Vec<Vector3<f64>> = Vec::new();
    for round in 0..=ROUNDS {
        std::mem::swap(&mut means, &mut before);
        means.clear();
        means.resize(shares.len(), Vector3::zeros());
        for (t, corners) in triangles.iter().enumerate() {
            let of = if round == 0 {
                mesh.area_vector(t)
            } else {
                corners.iter().map(|&v| before[v as usize]).sum::<Vector3<f64>>()
            };
            corners.iter().for_each(|&v| means[v as usize] += of);
        }
        means.iter_mut().zip(&shares).for_each(|(mean, share)| *mean *= *share);
    }
    let normals: Vec<Option<Vector3<f64>>> = means.iter().map(|mean| mean.try_normalize(0.0)).collect();
    let bends = Bends::of(mesh, &normals);
    normals.iter().zip(bends).map(|(normal, bend)| Some(bend.form((*normal)?))).collect()
}

/// Sums over the edges at a vertex, from which its bend comes by least squares.
#[derive(Clone, Copy)]
struct Bends {
    tangents: [Vector3<f64>; 2],
    /// Σ d dᵀ of the edges, along the tangents.
    edges: Matrix2<f64>,
    /// Σ (n′ − n) dᵀ, with n and n′ the normals at both ends.
    turns: [Vector3<f64>; 2],
    longest2: f64,
    count: f64,
}

impl Bends {
    fn of(mesh: &TriangleMesh, normals: &[Option<Vector3<f64>>]) -> Vec<Self> {
        let none = |normal: &Option<Vector3<f64>>| Self {
            tangents: normal.map_or([Vector3::zeros(); 2], |normal| square_to(&normal)),
            edges: Matrix2::zeros(),
            turns: [Vector3::zeros(); 2],
            longest2: 0.0,
            count: 0.0,
        };
        let mut bends: Vec<Self> = normals.iter().map(none).collect();
        for (t, corners) in mesh.triangles().iter().enumerate() {
            let places = mesh.corners(t);
            for k in 0..3 {
                let next = (k + 1) % 3;
                let [from, to] = [k, next].map(|k| corners[k] as usize);
                let (Some(here), Some(there)) = (normals[from], normals[to]) else { continue };
                // The triangle on the edge's other side has it the other way round.
                bends[from].add(&(places[next] - places[k]), &(there - here));
            }
        }
        bends
    }

    fn add(&mut self, edge: &Vector3<f64>, turn: &Vector3<f64>) {
        let along = Vector2::from(self.tangents.map(|tangent| tangent.dot(edge)));
        self.edges += along * along.transpose();
        self.turns[0] += turn * along.x;
        self.turns[1] += turn * along.y;
        self.longest2 = self.longest2.max(edge.norm_squared());
        self.count += 1.0;
    }

    fn form(&self, normal: Vector3<f64>) -> Form {
        let [u, v] = self.tangents;
        let bend = self.edges.try_inverse().map_or_else(Matrix3::zeros, |inverse| {
            let [of_u, of_v] = self.turns;
            let by_u = of_u * inverse[(0, 0)] + of_v * inverse[(1, 0)];
            let by_v = of_u * inverse[(0, 1)] + of_v * inverse[(1, 1)];
            by_u * u.transpose() + by_v * v.transpose()
        });
        let own_mm2 = 0.25 * self.edges.trace() / self.count.max(1.0);
        Form { normal, bend, reach_mm: ROUNDS as f64 * self.longest2.sqrt(), own_mm2 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;
    use crate::robust::Random;

    /// Radius of a pipe along y, mm, and the spacing of its points.
    const RADIUS_MM: f64 = 40.0;
    const SPACING_MM: f64 = 1.0;
    const SIDE: u32 = 60;
    /// Of sums over some ten points.
    const ROUNDING: f64 = 1e-12;

    /// Part of the pipe, its points moved across it by noise.
    fn pipe(noise_mm: f64) -> TriangleMesh {
        let mut random = Random::new(2);
        let mut gauss = || (0..12).map(|_| random.share()).sum::<f64>() - 6.0;
        let mut at = |i: u32, j: u32| {
            let angle = SPACING_MM / RADIUS_MM * (f64::from(i) - 30.0);
            let radius = RADIUS_MM + noise_mm * gauss();
            [radius * angle.sin(), SPACING_MM * f64::from(j), -radius * angle.cos()]
        };
        let vertices =
            (0..SIDE).flat_map(|i| (0..SIDE).map(move |j| (i, j))).map(|(i, j)| at(i, j)).collect();
        let cells = (0..SIDE - 1).flat_map(|i| (0..SIDE - 1).map(move |j| i * SIDE + j));
        let triangles = cells.flat_map(|n| [[n, n + 1, n + SIDE], [n + 1, n + SIDE + 1, n + SIDE]]).collect();
        TriangleMesh::new(Frame::Camera, vertices, triangles).unwrap()
    }

    /// Forms of vertices that are no nearer to the border than what has a say, with the vertices' places.
    fn inner(mesh: &TriangleMesh) -> Vec<(Vector3<f64>, Form)> {
        let inside = |v: &u32| [v / SIDE, v % SIDE].iter().all(|k| (5..SIDE - 5).contains(k));
        let forms = forms(mesh);
        let of = |v: u32| (Vector3::from(mesh.vertices_mm()[v as usize]), forms[v as usize].unwrap());
        (0..SIDE * SIDE).filter(inside).map(of).collect()
    }

    fn radial(place: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(place.x, 0.0, place.z) / place.x.hypot(place.z)
    }

    #[test]
    fn a_pipe_has_its_radii_for_normals_and_bends_by_its_curvature() {
        for (place, form) in inner(&pipe(0.0)) {
            let normal = radial(&place);
            assert!(form.normal.cross(&normal).norm() < ROUNDING, "{} {normal}", form.normal);
            let around = Vector3::y().cross(&normal);
            let sign = form.normal.dot(&normal).signum();
            let turn = form.bend * around * sign * RADIUS_MM;
            assert!((turn - around).norm() < ROUNDING, "{turn} {around}");
            assert!((form.bend * Vector3::y()).norm() < ROUNDING, "{}", form.bend);
            // Half-way the normal is square to the chord but for its third power: what lies on the pipe lies at no distance along it.
            let other = RADIUS_MM * (normal * 0.05_f64.cos() + around * 0.05_f64.sin());
            let chord = other + Vector3::y() * place.y - place;
            let mean = (form.normal + form.bend * chord * 0.5).normalize();
            assert!(mean.dot(&chord).abs() < 1e-3 * form.normal.dot(&chord).abs(), "{chord}");
        }
    }

    #[test]
    fn normals_scatter_as_those_of_planes_through_24_neighbours() {
        const NOISE_MM: f64 = 0.05;
        let inner = inner(&pipe(NOISE_MM));
        let squares = inner.iter().map(|(place, form)| 1.0 - form.normal.dot(&radial(place)).powi(2));
        let tilt = (squares.sum::<f64>() / inner.len() as f64).sqrt();
        // Σ x² of 24 points one spacing apart is 24² / 4π, along each of two axes.
        let of_planes = NOISE_MM / SPACING_MM * (2.0 * 4.0 * std::f64::consts::PI / 24.0_f64.powi(2)).sqrt();
        assert!((0.7..1.3).contains(&(tilt / of_planes)), "{tilt} rad, {of_planes} rad");
    }
}
