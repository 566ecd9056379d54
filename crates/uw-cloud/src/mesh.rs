//! The triangle mesh: vertices, triangles, what some meshes know of each vertex, and what hangs together.

use crate::cloud::Frame;
use crate::error::MeshError;
use nalgebra::{Isometry3, Point3, Vector3};
use std::f64::consts::PI;

/// No half-edge: the other side of a border.
pub(crate) const NONE: u32 = u32::MAX;

/// Triangles on shared vertices, mm; counter-clockwise as seen from outside or from the sensor.
///
/// Attributes each exist for all vertices or for none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    frame: Frame,
    vertices_mm: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    normals: Option<Vec<[f32; 3]>>,
    sigmas_mm: Option<Vec<f32>>,
    intensities: Option<Vec<f32>>,
    deviations_mm: Option<Vec<f32>>,
    colors: Option<Vec<[u8; 3]>>,
}

/// What a mesh's edges tell of its soundness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Topology {
    /// Closed chains of edges that have one triangle: outer borders and holes.
    pub boundary_loops: usize,
    /// Edges with one triangle.
    pub boundary_edges: usize,
    /// Edges with three triangles or more.
    pub crowded_edges: usize,
    /// Edges whose two triangles do not agree about which side is out.
    pub flipped_edges: usize,
    /// Parts that no edge connects.
    pub components: usize,
}

impl Topology {
    /// Returns whether the mesh encloses a volume: no border, at most two triangles an edge, all agreeing.
    pub fn is_closed(&self) -> bool {
        self.boundary_edges == 0 && self.crowded_edges == 0 && self.flipped_edges == 0 && self.components > 0
    }
}

/// Defines one attribute's reader and its checked setter.
macro_rules! attribute {
    ($field:ident, $with:ident, $type:ty, $what:literal) => {
        #[doc = concat!("Returns ", $what, ", one entry a vertex; `None` where the mesh has none.")]
        pub fn $field(&self) -> Option<&[$type]> {
            self.$field.as_deref()
        }

        #[doc = concat!("Returns the mesh with ", $what, ".")]
        ///
        /// # Errors
        /// [`MeshError::LengthMismatch`] unless there is one entry a vertex.
        pub fn $with(mut self, values: Vec<$type>) -> Result<Self, MeshError> {
            let (needed, got) = (self.vertices_mm.len(), values.len());
            if needed != got {
                return Err(MeshError::LengthMismatch { attribute: stringify!($field), needed, got });
            }
            self.$field = Some(values);
            Ok(self)
        }
    };
}

impl TriangleMesh {
    /// Returns the mesh of these triangles, corners as positions in `vertices_mm`.
    ///
    /// # Errors
    /// [`MeshError`] where a position is not finite, a corner names no vertex, or there are too many to be counted.
    pub fn new(
        frame: Frame,
        vertices_mm: Vec<[f64; 3]>,
        triangles: Vec<[u32; 3]>,
    ) -> Result<Self, MeshError> {
        if let Some(index) = vertices_mm.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
            return Err(MeshError::NonFinite { index });
        }
        let most = (NONE / 3) as usize;
        if vertices_mm.len() > most || triangles.len() > most {
            return Err(MeshError::TooLarge { allowed: most });
        }
        let vertices = vertices_mm.len();
        if let Some(index) = triangles.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) {
            return Err(MeshError::NoSuchVertex { index, vertices });
        }
        Ok(Self { frame, vertices_mm, triangles, ..Self::default() })
    }

    attribute!(normals, with_normals, [f32; 3], "unit normals");
    attribute!(
        sigmas_mm,
        with_sigmas_mm,
        f32,
        "the standard deviation along the least certain direction, mm"
    );
    attribute!(intensities, with_intensities, f32, "the stripe's brightness, in grey levels");
    attribute!(deviations_mm, with_deviations_mm, f32, "signed distances to a reference, mm");
    attribute!(colors, with_colors, [u8; 3], "colours (red, green, blue)");

    /// Returns the frame that the coordinates refer to.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Returns the positions of the vertices, mm.
    pub fn vertices_mm(&self) -> &[[f64; 3]] {
        &self.vertices_mm
    }

    /// Returns the triangles, corners as positions in [`TriangleMesh::vertices_mm`].
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Returns the corners of a triangle, mm.
    #[inline]
    pub(crate) fn corners(&self, triangle: usize) -> [Vector3<f64>; 3] {
        // One by one: an array that is mapped is not put together in the processor's registers.
        let at = |v: u32| Vector3::from(self.vertices_mm[v as usize]);
        let [a, b, c] = self.triangles[triangle];
        [at(a), at(b), at(c)]
    }

    /// Returns twice a triangle's area along its normal, mm²; of no length for one without an area.
    pub(crate) fn area_vector(&self, triangle: usize) -> Vector3<f64> {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(&(c - a))
    }

    /// Returns the area, mm².
    pub fn area_mm2(&self) -> f64 {
        (0..self.triangles.len()).map(|t| 0.5 * self.area_vector(t).norm()).sum()
    }

    /// Returns the volume that the triangles enclose, mm³: negative where they face inwards, and of no meaning unless
    /// the mesh is closed.
    pub fn volume_mm3(&self) -> f64 {
        let Some(&origin) = self.vertices_mm.first() else { return 0.0 };
        let origin = Vector3::from(origin);
        let share = |t: usize| {
            let [a, b, c] = self.corners(t).map(|p| p - origin);
            a.dot(&b.cross(&c)) / 6.0
        };
        (0..self.triangles.len()).map(share).sum()
    }

    /// Returns the lowest and the highest corner of the box around all vertices, mm; `None` without vertices.
    pub fn bounding_box_mm(&self) -> Option<([f64; 3], [f64; 3])> {
        let first = *self.vertices_mm.first()?;
        Some(self.vertices_mm.iter().fold((first, first), |(low, high), p| {
            (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
        }))
    }

    /// Returns the mesh with unit normals at the vertices: the triangles' normals weighted by their angles there (G. Thürmer,
    /// C. Wüthrich, J. Graphics Tools 3 (1998) 43), so that they do not depend on how a face is cut into triangles. Vertices
    /// without a triangle that has an area get a zero vector.
    pub fn with_vertex_normals(mut self) -> Self {
        let mut sums = vec![Vector3::<f64>::zeros(); self.vertices_mm.len()];
        for (t, triangle) in self.triangles.iter().enumerate() {
            let corners @ [a, b, c] = self.corners(t);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
            for (&v, angle) in triangle.iter().zip(corner_angles(corners)) {
                sums[v as usize] += normal * angle;
            }
        }
        let unit = |sum: &Vector3<f64>| {
            sum.try_normalize(0.0).map_or([0.0; 3], |n| [n.x as f32, n.y as f32, n.z as f32])
        };
        self.normals = Some(sums.iter().map(unit).collect());
        self
    }

    /// Returns the mesh moved rigidly into another frame.
    pub fn transformed(mut self, frame: Frame, frame_from_mesh: &Isometry3<f64>) -> Self {
        for position in &mut self.vertices_mm {
            *position = (frame_from_mesh * Point3::from(*position)).coords.into();
        }
        for normal in self.normals.iter_mut().flatten() {
            let turned = frame_from_mesh.rotation * Vector3::from(normal.map(f64::from));
            *normal = [turned.x as f32, turned.y as f32, turned.z as f32];
        }
        self.frame = frame;
        self
    }

    /// Returns what the edges tell.
    pub fn topology(&self) -> Topology {
        let links = Links::new(&self.triangles, self.vertices_mm.len());
        let boundary = links.twins.iter().filter(|&&twin| twin == NONE).count() - links.unpaired;
        Topology {
            boundary_loops: links.loops().len(),
            boundary_edges: boundary,
            crowded_edges: links.crowded,
            flipped_edges: links.flipped,
            components: links.components(),
        }
    }
}

/// Returns a triangle's angles at its corners, rad, to 4e-8; of no meaning where it has no area.
#[inline]
pub(crate) fn corner_angles([a, b, c]: [Vector3<f64>; 3]) -> [f64; 3] {
    let sides = [b - a, c - b, a - c];
    let lengths = sides.map(|side| side.norm());
    let angle = |from: usize, to: usize| {
        let cosine = -sides[from].dot(&sides[to]) / (lengths[from] * lengths[to]);
        arc_cosine(cosine.clamp(-1.0, 1.0))
    };
    let (first, second) = (angle(2, 0), angle(0, 1));
    [first, second, (PI - first - second).max(0.0)]
}

/// The arc cosine to 2e-8 rad, in a third of the library's time (M. Abramowitz, I. Stegun, 4.4.46).
fn arc_cosine(cosine: f64) -> f64 {
    const TERMS: [f64; 8] = [
        -0.001_262_491_1,
        0.006_670_090_1,
        -0.017_088_125_6,
        0.030_891_881_0,
        -0.050_174_304_6,
        0.088_978_987_4,
        -0.214_598_801_6,
        1.570_796_305_0,
    ];
    let size = cosine.abs();
    let angle = (1.0 - size).sqrt() * TERMS.iter().fold(0.0, |sum, term| sum * size + term);
    if cosine < 0.0 { PI - angle } else { angle }
}

/// Which half-edge lies on the other side of each: half-edge 3 t + k leads from corner k of triangle t to the next.
pub(crate) struct Links {
    /// The half-edge on the other side; [`NONE`] at a border and where an edge is crowded or flipped.
    pub(crate) twins: Vec<u32>,
    /// Whether a half-edge is alone on its edge.
    border: Vec<bool>,
    crowded: usize,
    flipped: usize,
    /// Half-edges of crowded and flipped edges.
    unpaired: usize,
}

impl Links {
    /// Pairs the half-edges; in time proportional to their number.
    pub(crate) fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let ends = |h: u32| {
            let t = &triangles[h as usize / 3];
            (t[h as usize % 3], t[(h as usize + 1) % 3])
        };
        let halves = 3 * triangles.len() as u32;
        // Sorted by the lower end by counting: the few of one vertex are then compared directly.
        let mut starts = vec![0_u32; vertices + 1];
        for h in 0..halves {
            let (a, b) = ends(h);
            starts[a.min(b) as usize + 1] += 1;
        }
        (0..vertices).for_each(|v| starts[v + 1] += starts[v]);
        let mut filled = starts.clone();
        let mut order = vec![0_u32; halves as usize];
        for h in 0..halves {
            let (a, b) = ends(h);
            let at = &mut filled[a.min(b) as usize];
            order[*at as usize] = h;
            *at += 1;
        }
        let mut links = Self {
            twins: vec![NONE; halves as usize],
            border: vec![false; halves as usize],
            crowded: 0,
            flipped: 0,
            unpaired: 0,
        };
        for v in 0..vertices {
            let own = &mut order[starts[v] as usize..starts[v + 1] as usize];
            let upper = |h: &u32| {
                let (a, b) = ends(*h);
                (a.max(b), *h)
            };
            own.sort_unstable_by_key(upper);
            for edge in own.chunk_by(|a, b| upper(a).0 == upper(b).0) {
                match edge {
                    [h] => links.border[*h as usize] = true,
                    [g, h] if ends(*g).0 == ends(*h).1 && ends(*g).0 != ends(*g).1 => {
                        links.twins[*g as usize] = *h;
                        links.twins[*h as usize] = *g;
                    }
                    [_, _] => {
                        links.flipped += 1;
                        links.unpaired += 2;
                    }
                    more => {
                        links.crowded += 1;
                        links.unpaired += more.len();
                    }
                }
            }
        }
        links
    }

    /// Closed chains of border half-edges. Where two parts touch in one vertex, each keeps its own chain.
    pub(crate) fn loops(&self) -> Vec<Vec<u32>> {
        let mut seen = vec![false; self.twins.len()];
        let mut loops = Vec::new();
        for first in 0..self.twins.len() {
            if !self.border[first] || seen[first] {
                continue;
            }
            let mut chain = Vec::new();
            let mut at = first;
            while !seen[at] {
                seen[at] = true;
                chain.push(at as u32);
                // Around the end's fan of triangles to where it is open.
                let mut next = at / 3 * 3 + (at + 1) % 3;
                while self.twins[next] != NONE {
                    let twin = self.twins[next] as usize;
                    next = twin / 3 * 3 + (twin + 1) % 3;
                }
                if !self.border[next] {
                    break;
                }
                at = next;
            }
            loops.push(chain);
        }
        loops
    }

    /// Parts that are connected through edges of two agreeing triangles.
    fn components(&self) -> usize {
        let mut seen = vec![false; self.twins.len() / 3];
        let mut open = Vec::new();
        let mut parts = 0;
        for first in 0..seen.len() {
            if std::mem::replace(&mut seen[first], true) {
                continue;
            }
            parts += 1;
            open.push(first);
            while let Some(t) = open.pop() {
                for &twin in &self.twins[3 * t..3 * t + 3] {
                    if twin != NONE && !std::mem::replace(&mut seen[twin as usize / 3], true) {
                        open.push(twin as usize / 3);
                    }
                }
            }
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit cube's corners by the bits of their numbers, and its twelve triangles seen from outside.
    fn cube() -> TriangleMesh {
        let corners = (0..8_u8).map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(f64::from)).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriangleMesh::new(Frame::Camera, corners, triangles).unwrap()
    }

    /// Rounding of sums of a few numbers near one.
    const ROUNDING: f64 = 1e-12;

    #[test]
    fn the_arc_cosine_is_as_near_as_its_source_says() {
        for k in -1000..=1000 {
            let cosine = f64::from(k) / 1000.0;
            // Two of the last digit that the terms are given to.
            assert!((arc_cosine(cosine) - cosine.acos()).abs() < 2.2e-8, "{cosine}");
        }
    }

    #[test]
    fn a_cube_is_closed_and_has_its_area_and_volume() {
        let cube = cube();
        assert_eq!(cube.topology(), Topology { components: 1, ..Topology::default() });
        assert!(cube.topology().is_closed());
        assert!((cube.area_mm2() - 6.0).abs() < ROUNDING);
        assert!((cube.volume_mm3() - 1.0).abs() < ROUNDING);
        let normals = cube.with_vertex_normals();
        let third = (1.0_f32 / 3.0).sqrt();
        for (vertex, normal) in normals.vertices_mm().iter().zip(normals.normals().unwrap()) {
            for (at, n) in vertex.iter().zip(normal) {
                let outwards = if *at > 0.5 { third } else { -third };
                assert!(
                    (n - outwards).abs() < 1e-6,
                    "angles weigh all three faces alike: {normal:?} at {vertex:?}"
                );
            }
        }
    }

    #[test]
    fn holes_borders_and_faults_are_counted() {
        let cube = cube();
        let with = |triangles: Vec<[u32; 3]>| {
            TriangleMesh::new(Frame::Camera, cube.vertices_mm().to_vec(), triangles).unwrap().topology()
        };
        let open: Vec<_> = cube.triangles()[1..11].to_vec();
        let topology = with(open.clone());
        // The first triangle is of one face, the last one of the opposite: two holes of three edges.
        assert_eq!((topology.boundary_loops, topology.boundary_edges), (2, 6));
        assert!(!topology.is_closed());
        let mut flipped = cube.triangles().to_vec();
        flipped[3].swap(0, 1);
        assert_eq!(with(flipped).flipped_edges, 3);
        let mut crowded = cube.triangles().to_vec();
        crowded.push(crowded[0]);
        assert_eq!(with(crowded).crowded_edges, 3);
        // Two triangles that touch in one vertex have a border each.
        let bow = with(vec![[0, 1, 2], [0, 4, 5]]);
        assert_eq!((bow.boundary_loops, bow.components), (2, 2));
    }

    #[test]
    fn what_is_no_mesh_is_refused() {
        let points = vec![[0.0; 3]; 3];
        let new = |points, triangles| TriangleMesh::new(Frame::Camera, points, triangles);
        assert_eq!(
            new(points.clone(), vec![[0, 1, 2], [0, 1, 3]]),
            Err(MeshError::NoSuchVertex { index: 1, vertices: 3 })
        );
        let mut bad = points.clone();
        bad[2][1] = f64::NAN;
        assert_eq!(new(bad, vec![]), Err(MeshError::NonFinite { index: 2 }));
        let mesh = new(points, vec![[0, 1, 2], [2, 2, 2]]).unwrap();
        assert!(mesh.area_mm2() < ROUNDING);
        assert!(mesh.clone().with_sigmas_mm(vec![1.0]).is_err());
        // A triangle on one vertex has edges that lead nowhere: counted, not followed.
        assert!(!mesh.topology().is_closed());
    }
}
