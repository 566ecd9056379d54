//! Objects of a scene file as the simulator takes them.

use crate::Error;
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;
use uw_geom::Rigid;
use uw_geom::frame::Camera;
use uw_io::scene::{ObjectRecord, PoseRecord, ShapeRecord};
use uw_io::{Problem, Target};
use uw_sim::shape::{Holes, Mesh, Revolution};
use uw_sim::{Body, Motion, Object, Shape, Surface, Texture};

/// The samples' cover: radius and z of its profile's corners, mm, for a rim of 78 mm.
const COVER: [[f64; 2]; 16] = [
    [0.0, 26.0],
    [16.0, 26.0],
    [18.0, 24.0],
    [18.0, 12.0],
    [43.0, 12.0],
    [45.0, 14.0],
    [49.0, 14.0],
    [49.0, 10.5],
    [54.0, 10.5],
    [54.0, 14.0],
    [71.0, 14.0],
    [72.0, 18.0],
    [76.0, 18.0],
    [78.0, 16.0],
    [78.0, 0.0],
    [0.0, 0.0],
];
const COVER_RIM_MM: f64 = 78.0;
const COVER_HOLES: Holes = Holes { count: 8, circle_mm: 62.5, radius_mm: 4.5, mouth_mm: 14.0, floor_mm: 2.0 };

/// A cover of this rim radius.
fn cover(rim_radius_mm: f64) -> Revolution {
    let k = rim_radius_mm / COVER_RIM_MM;
    let Holes { count, circle_mm, radius_mm, mouth_mm, floor_mm } = COVER_HOLES;
    Revolution {
        profile_rz_mm: COVER.map(|corner| corner.map(|x| k * x)).to_vec(),
        holes: Some(Holes {
            count,
            circle_mm: k * circle_mm,
            radius_mm: k * radius_mm,
            mouth_mm: k * mouth_mm,
            floor_mm: k * floor_mm,
        }),
    }
}

fn pose(position_mm: [f64; 3], rotation_deg: [f64; 3]) -> Rigid<Camera, Body> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(rotation_deg).map(f64::to_radians));
    Rigid::new(turn, position_mm.into())
}

/// Radius of a ball's stem, and what a plate reaches beyond the balls, mm.
const STEM_RADIUS: f64 = 0.25;
const PLATE_BEYOND_MM: f64 = 20.0;
const PLATE_MM: f64 = 20.0;

/// The objects of a record: most are one.
///
/// # Errors
/// [`Error::Scene`] for figures that make no such thing; [`Error::File`] for a mesh file that can't be read.
pub(crate) fn objects(
    record: &ObjectRecord,
    folder: &Path,
    problems: &mut Vec<Problem>,
) -> Result<Vec<Object>, Error> {
    let wrong = |what: String| Error::Scene { object: record.name.clone(), what };
    let shape = record.shape().map_err(|(key, what, mend)| wrong(format!("{key} {what}: {mend}")))?;
    let camera_from_body = pose(record.position_mm, record.rotation_deg);
    let motion = Motion {
        velocity_mm_s: record.velocity_mm_s.into(),
        turn_rad_s: Vector3::from(record.turn_deg_s).map(f64::to_radians),
    };
    let mut surface = Surface {
        albedo: record.albedo,
        specular: record.specular,
        shininess: record.shininess,
        texture: Texture::Plain,
    };
    let one = |name: String, shape, surface| Object { name, shape, camera_from_body, motion, surface };
    let shape = match shape {
        ShapeRecord::Sphere { radius_mm } => Shape::Sphere { radius_mm },
        ShapeRecord::Plane { sides_mm, tiles } => {
            if let Some([pitch_mm, joint_mm, dark]) = tiles {
                surface.texture = Texture::Tiles { pitch_mm, joint_mm, dark };
            }
            match sides_mm {
                None => Shape::Plane,
                Some(sides) => {
                    Shape::Rectangle { from_mm: sides.map(|s| -0.5 * s), to_mm: sides.map(|s| 0.5 * s) }
                }
            }
        }
        ShapeRecord::Box { sides_mm } => Shape::Block { half_mm: sides_mm.map(|s| 0.5 * s) },
        ShapeRecord::Revolution { profile_rz_mm } => {
            Shape::Revolution(Revolution { profile_rz_mm, holes: None })
        }
        ShapeRecord::Cover { rim_radius_mm } => Shape::Revolution(cover(rim_radius_mm)),
        ShapeRecord::Pipe { radius_mm: r, length_mm, flange_mm: [flange, thick] } => {
            if flange <= r || thick >= length_mm {
                return Err(wrong("a flange is wider than its pipe, and thinner than it is long".to_owned()));
            }
            let (l, t) = (0.5 * length_mm, 0.5 * thick);
            let profile = [[0.0, l], [r, l], [r, t], [flange, t], [flange, -t], [r, -t], [r, -l], [0.0, -l]];
            Shape::Revolution(Revolution { profile_rz_mm: profile.to_vec(), holes: None })
        }
        ShapeRecord::Mesh { file } => {
            let (mesh, warnings) = uw_io::meshes::read(&folder.join(file))?;
            problems.extend(warnings);
            Shape::Mesh(Mesh::new(mesh.vertices_mm(), mesh.triangles()).map_err(|e| wrong(e.to_string()))?)
        }
        ShapeRecord::ThreeBalls { radii_mm, distances_mm, stem_mm } => {
            let centres = triangle(distances_mm)
                .ok_or_else(|| wrong(format!("no triangle has the sides {distances_mm:?} mm")))?;
            let at = |p: Vector3<f64>| {
                Rigid::new(camera_from_body.rotation(), camera_from_body.transform_point(&p))
            };
            let mut all = Vec::new();
            let matt = Surface { specular: 0.0, ..surface };
            let (mut low, mut high) = (centres[0], centres[0]);
            for ((letter, centre), radius_mm) in ["A", "B", "C"].iter().zip(centres).zip(radii_mm) {
                let ball = Shape::Sphere { radius_mm };
                all.push(Object {
                    camera_from_body: at(centre),
                    ..one(format!("{} {letter}", record.name), ball, surface)
                });
                let r = STEM_RADIUS * radius_mm;
                let profile = vec![[0.0, 0.0], [r, 0.0], [r, -stem_mm], [0.0, -stem_mm]];
                let stem = Shape::Revolution(Revolution { profile_rz_mm: profile, holes: None });
                let name = format!("{} stem {letter}", record.name);
                all.push(Object { camera_from_body: at(centre), ..one(name, stem, matt) });
                let reach = Vector3::repeat(radius_mm + PLATE_BEYOND_MM);
                (low, high) = (low.inf(&(centre - reach)), high.sup(&(centre + reach)));
            }
            let middle =
                Vector3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), -stem_mm - 0.5 * PLATE_MM);
            let half = 0.5 * (high - low);
            let plate = Shape::Block { half_mm: [half.x, half.y, 0.5 * PLATE_MM] };
            let name = format!("{} plate", record.name);
            all.push(Object {
                camera_from_body: at(middle),
                ..one(name, plate, Surface { albedo: 0.4 * surface.albedo, ..matt })
            });
            return Ok(all);
        }
    };
    Ok(vec![one(record.name.clone(), shape, surface)])
}

/// Corners A, B, C of the triangle with sides AB, AC, BC: A at the origin, B along x, in z = 0; `None` where there is none.
fn triangle([ab, ac, bc]: [f64; 3]) -> Option<[Vector3<f64>; 3]> {
    let x = (ab * ab + ac * ac - bc * bc) / (2.0 * ab);
    let y2 = ac * ac - x * x;
    (ab > 0.0 && y2 > 0.0)
        .then(|| [Vector3::zeros(), Vector3::new(ab, 0.0, 0.0), Vector3::new(x, y2.sqrt(), 0.0)])
}

/// White margin around a board's squares, of a square's side.
const MARGIN: f64 = 0.5;
const BOARD: [f64; 2] = [0.9, 0.05];

/// The target at a placement, whose position is that of its middle.
pub(crate) fn board(target: &Target, placement: &PoseRecord) -> Object {
    let square_mm = target.square_mm;
    let [columns, rows] = target.inner_corners.map(f64::from);
    let shape = Shape::Rectangle {
        from_mm: [-(1.0 + MARGIN) * square_mm; 2],
        to_mm: [(columns + MARGIN) * square_mm, (rows + MARGIN) * square_mm],
    };
    let texture = Texture::Chessboard { inner_corners: target.inner_corners, square_mm, dark: BOARD[1] };
    let surface = Surface { texture, ..Surface::matt(BOARD[0]) };
    let middle = Vector3::new(columns - 1.0, rows - 1.0, 0.0) * (0.5 * square_mm);
    let turned = pose(placement.position_mm, placement.rotation_deg);
    let corner = turned.transform_point(&-middle);
    Object::fixed("board", shape, Rigid::new(turned.rotation(), corner), surface)
}
