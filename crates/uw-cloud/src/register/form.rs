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
}

impl Bends {
    fn of(mesh: &TriangleMesh, normals: &[Option<Vector3<f64>>]) -> Vec<Self> {
        let none = |normal: &Option<Vector3<f64>>| Self {
            tangents: normal.map_or([Vector3::zeros(); 2], |normal| square_to(&normal)),
            edges: Matrix2::zeros(),
            turns: [Vector3::zeros(); 2],
            longest2: 0.0,
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
    }

    fn form(&self, normal: Vector3<f64>) -> Form {
        let [u, v] = self.tangents;
        let bend = self.edges.try_inverse().map_or_else(Matrix3::zeros, |inverse| {
            let [of_u, of_v] = self.turns;
            let by_u = of_u * inverse[(0, 0)] + of_v * inverse[(1, 0)];
            let by_v = of_u * inverse[(0, 1)] + of_v * inverse[(1, 1)];
            by_u * u.transpose() + by_v * v.transpose()
        });
        Form { normal, bend, reach_mm: ROUNDS as f64 * self.longest2.sqrt() }
    }
}
