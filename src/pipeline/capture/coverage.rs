//! Which placements a calibration still lacks: number, tilts to all sides, distances, parts of the view, voltages.
//!
//! How a board stands is told roughly, from its corners and the drawing's focal length; calibration's own diagnostics judge the whole set
//! at the end.

use nalgebra::Vector3;
use uw_calib::{CornerPoint, rough_pose};
use uw_geom::{Camera, Distortion};
use uw_io::{Medium, Rig};

/// Placements that a set should have.
const ENOUGH_IN_AIR: usize = 12;
const ENOUGH_IN_WATER: usize = 8;
/// A board is tilted to a side from this angle on.
const TILTED_DEG: f64 = 15.0;
/// Placements that should be tilted to each side.
const TILTED_EACH: usize = 1;
/// The farthest board should be so many times as far away as the nearest.
const DEPTH_RATIO: f64 = 1.25;
/// A voltage should have its stripe on the board in so many placements.
const STRIPES_EACH: usize = 3;
/// The view is looked at in so many parts a side.
const PARTS: usize = 3;
const PART_NAMES: [[&str; PARTS]; PARTS] = [
    ["the top left", "the top", "the top right"],
    ["the left", "the middle", "the right"],
    ["the bottom left", "the bottom", "the bottom right"],
];
/// The board's four sides, as the camera sees them: which is farther away, and the sign of its normal's x and y then.
const SIDES: [(&str, usize, f64); 4] =
    [("left", 0, -1.0), ("right", 0, 1.0), ("upper", 1, -1.0), ("lower", 1, 1.0)];

/// How one board stands, roughly.
#[derive(Clone, Debug)]
pub struct Stance {
    /// From the camera to the board's middle along the optical axis, mm.
    pub distance_mm: f64,
    /// Between the board's normal and the optical axis, degrees.
    pub tilt_deg: f64,
    /// Unit normal towards the camera, camera frame.
    normal: Vector3<f64>,
    /// Parts of the view that hold a corner.
    parts: [[bool; PARTS]; PARTS],
    /// For each voltage whether its stripe lies on the board.
    pub stripes: Vec<bool>,
}

impl Stance {
    /// How a board stands; `None` where its corners don't tell.
    pub(super) fn of(corners: &[CornerPoint], rig: &Rig, medium: Medium, stripes: Vec<bool>) -> Option<Self> {
        let c = &rig.camera;
        // Behind a flat window water makes things look nearer, by its index: as a longer lens would.
        let index = if medium == Medium::Water { rig.water_index().unwrap_or(1.33) } else { 1.0 };
        let [fx, fy] = c.pixel_um.map(|pitch| c.focal_mm * 1000.0 / pitch * index);
        let [w, h] = [c.width, c.height].map(f64::from);
        let camera =
            Camera { fx, fy, cx: 0.5 * (w - 1.0), cy: 0.5 * (h - 1.0), distortion: Distortion::none() };
        let camera_from_board = rough_pose(corners, &camera)?;
        let axis = camera_from_board.rotation_matrix().column(2).into_owned();
        // A board's z leads away from a camera that sees its printed side.
        let normal = if axis.z > 0.0 { -axis } else { axis };
        let middle =
            corners.iter().map(|c| c.board_mm).sum::<nalgebra::Vector2<f64>>() / corners.len() as f64;
        let mut parts = [[false; PARTS]; PARTS];
        for corner in corners {
            let part = |at: f64, size: f64| ((at / size * PARTS as f64) as usize).min(PARTS - 1);
            parts[part(corner.pixel.y, h)][part(corner.pixel.x, w)] = true;
        }
        Some(Self {
            distance_mm: camera_from_board.transform_point(&middle.push(0.0)).z,
            tilt_deg: (-normal.z).clamp(-1.0, 1.0).acos().to_degrees(),
            normal,
            parts,
            stripes,
        })
    }

    /// Whether a side of the board is farther away than the other.
    fn leans(&self, axis: usize, sign: f64) -> bool {
        self.normal[axis] * sign > TILTED_DEG.to_radians().sin()
    }
}

/// What a set still lacks, each as what to do next; none where it is complete.
pub(super) fn missing(set: &[Stance], voltages: &[f64], medium: Medium) -> Vec<String> {
    let mut said = Vec::new();
    let enough = if medium == Medium::Water { ENOUGH_IN_WATER } else { ENOUGH_IN_AIR };
    if let Some(more @ 1..) = enough.checked_sub(set.len()) {
        said.push(format!("{more} more placements"));
    }
    let flat = SIDES.iter().filter(|(_, axis, sign)| {
        set.iter().filter(|stance| stance.leans(*axis, *sign)).count() < TILTED_EACH
    });
    let sides: Vec<&str> = flat.map(|(side, ..)| *side).collect();
    if !sides.is_empty() {
        said.push(format!(
            "placements tilted by 20 to 40° with this side of the board farther away: {}",
            sides.join(", ")
        ));
    }
    let (near, far) = set.iter().fold((f64::INFINITY, 0.0_f64), |(near, far), stance| {
        (near.min(stance.distance_mm), far.max(stance.distance_mm))
    });
    if far < near * DEPTH_RATIO {
        said.push(match set.is_empty() {
            true => "placements from near to far, over the whole working range".to_owned(),
            false => format!("placements nearer and farther, over the whole working range: all stand {near:.0} to {far:.0} mm away so far"),
        });
    }
    let empty: Vec<&str> = (0..PARTS * PARTS)
        .map(|i| (i / PARTS, i % PARTS))
        .filter(|&(row, column)| !set.iter().any(|stance| stance.parts[row][column]))
        .map(|(row, column)| PART_NAMES[row][column])
        .collect();
    if !empty.is_empty() && !set.is_empty() {
        said.push(format!("a board in these parts of the view: {}", empty.join(", ")));
    }
    let seldom: Vec<String> = voltages
        .iter()
        .enumerate()
        .filter(|(i, _)| {
            set.iter().filter(|stance| stance.stripes.get(*i) == Some(&true)).count() < STRIPES_EACH
        })
        .map(|(_, volts)| format!("{volts:.3}"))
        .collect();
    if !seldom.is_empty() && set.len() >= STRIPES_EACH {
        said.push(format!(
            "a board where the stripe is at these voltages, {STRIPES_EACH} times each: {} V",
            seldom.join(", ")
        ));
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, UnitQuaternion, Vector2};

    fn rig() -> Rig {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/cal-air/rig.toml");
        Rig::read(&path).unwrap().0
    }

    /// Corners of a board of 11 × 8 squares of 24 mm by the drawing's camera in air, its middle at a place, turned about x then y.
    fn stance(place: [f64; 3], turn_deg: [f64; 2], stripes: Vec<bool>) -> Stance {
        let rig = rig();
        let turn = UnitQuaternion::from_euler_angles(turn_deg[0].to_radians(), turn_deg[1].to_radians(), 0.0);
        let focal = rig.camera.pixel_um.map(|pitch| rig.camera.focal_mm * 1000.0 / pitch);
        let corners = (0..88).map(|i| {
            let board_mm = Vector2::new(f64::from(i % 11) * 24.0, f64::from(i / 11) * 24.0);
            let p = Vector3::from(place) + turn * (board_mm - Vector2::new(120.0, 84.0)).push(0.0);
            let pixel = Vector2::new(383.5 + focal[0] * p.x / p.z, 287.5 + focal[1] * p.y / p.z);
            CornerPoint { board_mm, pixel, covariance: Matrix2::identity() * 1e-4 }
        });
        Stance::of(&corners.collect::<Vec<_>>(), &rig, Medium::Air, stripes).unwrap()
    }

    #[test]
    fn tilt_and_distance_are_those_of_the_board() {
        let all = stance([10.0, -20.0, 900.0], [20.0, 0.0], vec![]);
        // The drawing's camera was used both ways: what is left is rounding, mm and degrees.
        assert!((all.distance_mm - 900.0).abs() < 1e-6 && (all.tilt_deg - 20.0).abs() < 1e-6, "{all:?}");
    }

    #[test]
    fn a_side_that_is_farther_away_is_known_by_its_name() {
        // Turned about x by a positive angle, y (down) moves away: the lower side is farther. About y: x towards the camera, left farther.
        for (turn, side) in
            [([20.0, 0.0], "lower"), ([-20.0, 0.0], "upper"), ([0.0, 20.0], "left"), ([0.0, -20.0], "right")]
        {
            let set = [stance([0.0, 0.0, 900.0], turn, vec![])];
            let said = missing(&set, &[], Medium::Air);
            let sides = said.iter().find(|line| line.contains("tilted")).unwrap();
            assert!(!sides.contains(side) && sides.matches(", ").count() == 2, "{side}: {sides}");
        }
    }

    #[test]
    fn a_set_lacks_less_and_less_until_it_is_complete() {
        let empty = missing(&[], &[0.0], Medium::Water);
        assert!(empty[0].contains("8 more placements") && empty.len() == 3, "{empty:?}");
        let mut set = vec![stance([-100.0, -80.0, 900.0], [0.0, 0.0], vec![true, false]); 3];
        let said = missing(&set, &[-1.0, 1.5], Medium::Water);
        for part in
            ["5 more placements", "left, right, upper, lower", "900 to 900 mm", "the bottom right", "1.500 V"]
        {
            assert!(said.iter().any(|line| line.contains(part)), "{part}: {said:?}");
        }
        assert!(!said.iter().any(|line| line.contains("-1.000")), "{said:?}");
        for (place, turn) in [
            ([-160.0, -120.0, 700.0], [25.0, 0.0]),
            ([160.0, -120.0, 1100.0], [-25.0, 0.0]),
            ([-160.0, 120.0, 800.0], [0.0, 25.0]),
            ([160.0, 120.0, 900.0], [0.0, -25.0]),
            ([0.0, 0.0, 1000.0], [20.0, 20.0]),
        ] {
            set.push(stance(place, turn, vec![true, true]));
        }
        assert_eq!(missing(&set, &[-1.0, 1.5], Medium::Water), [""; 0]);
    }
}
