//! The paper's experiments as scenes: its instrument, boards, balls and cover, each with the voltages that pass over it.

use crate::Error;
use crate::pipeline::demo;
use crate::pipeline::reproduce::published;
use crate::pipeline::simulate::Plan;
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;
use uw_geom::{Medium, Scanner};
use uw_io::Rig;
use uw_io::scene::SceneFile;

const RIG: &str = include_str!("rig.toml");
const BALL: &str = include_str!("ball.toml");
const THREE: &str = include_str!("three-ball.toml");
const COVER: &str = include_str!("cover.toml");

/// The paper's step: 0.09° of the beam, which turns by 4° a volt.
const STEP_V: f64 = 0.0225;
/// Of the three balls: their sweep is twice as wide.
const WIDE_STEP_V: f64 = 0.045;
/// Voltages that a thing is looked for in: beyond them the fan does not reach the camera's view.
const SEARCHED_V: [f64; 2] = [-8.0, 8.0];
const SEARCH_STEPS: usize = 321;
/// What is swept beyond a thing on either side, mm.
const BESIDE_MM: f64 = 2.0;

/// Turns of the three balls' board: about the line upwards, to the right, and towards the camera, degrees; and where the middle of the
/// triangle stands, camera frame, mm. In the second and third, distances run along the depth, where the paper's errors were largest.
const THREE_POSES: [([f64; 3], [f64; 3]); 3] = [
    ([0.0, 0.0, 4.0], [0.0, 0.0, 1000.0]),
    ([28.0, 0.0, -6.0], [0.0, 0.0, 1010.0]),
    ([-22.0, 18.0, 8.0], [0.0, 0.0, 1010.0]),
];
/// Where the cover stands, camera frame, mm.
const COVER_AT_MM: [f64; 3] = [-5.0, 2.0, 1000.0];

/// The plans of all experiments.
#[derive(Debug)]
pub(crate) struct Experiments {
    pub(crate) air: Plan,
    pub(crate) water: Plan,
    pub(crate) balls: Vec<Plan>,
    pub(crate) three: Vec<Plan>,
    pub(crate) cover: Plan,
}

impl Experiments {
    /// The experiments with the instrument that a seed draws.
    pub(crate) fn new(seed: u64) -> Result<Self, Error> {
        let scan = |name: &str, text: &str| -> Result<SceneFile, Error> {
            let (mut file, _) = SceneFile::parse(&Path::new(name).with_extension("toml"), text)?;
            file.instrument.differs_by_seed = Some(seed);
            Ok(file)
        };
        let (ball, three, cover) = (scan("ball", BALL)?, scan("three-ball", THREE)?, scan("cover", COVER)?);
        let [air, water] = demo::CALIBRATIONS.map(|(name, text)| -> Result<Plan, Error> {
            let mut file = scan(name, text)?;
            file.instrument = ball.instrument.clone();
            file.seed = seed.wrapping_mul(1000).wrapping_add(file.seed);
            plan(name, file)
        });
        // Any plan tells where the true instrument is.
        let any = plan("ball", ball.clone())?;
        let galvo = &any.instrument.scanner.galvo;
        let mut at = Sweeper {
            scanner: &any.instrument.scanner,
            water: any.scenes[0].water.laser,
            seed: seed.wrapping_mul(1000),
        };

        let balls = published::BALLS.iter().enumerate().map(|(k, row)| {
            let center = galvo.origin_mm + galvo.axes * Vector3::from(row.center_mm);
            let mut file = ball.clone();
            file.objects[0].position_mm = center.into();
            at.swept(&format!("ball-{:02}", k + 1), file, (center, published::BALL_RADIUS_MM), STEP_V)
        });
        let balls = balls.collect::<Result<_, _>>()?;
        let three = THREE_POSES.iter().enumerate().map(|(k, (turns, middle))| {
            let mut file = three.clone();
            let (turn, position, reach) = board(*turns, *middle);
            file.objects[0].position_mm = position.into();
            file.objects[0].rotation_deg = turn.scaled_axis().map(f64::to_degrees).into();
            at.swept(&format!("three-ball-{}", k + 1), file, (Vector3::from(*middle), reach), WIDE_STEP_V)
        });
        let three = three.collect::<Result<_, _>>()?;
        let mut file = cover;
        file.objects[0].position_mm = COVER_AT_MM;
        let cover = at.swept("cover", file, (COVER_AT_MM.into(), 80.0), STEP_V)?;
        Ok(Self { air: air?, water: water?, balls, three, cover })
    }
}

fn plan(name: &str, file: SceneFile) -> Result<Plan, Error> {
    let (rig, _) = Rig::parse(Path::new("rig.toml"), RIG)?;
    Plan::new(name, file, rig, None, Path::new(""), &mut Vec::new())
}

/// The three balls' turn (camera from body) and the position of ball A, so that the middle of their triangle is where it should be; and how far
/// the farthest point of a ball is from there.
fn board(turns_deg: [f64; 3], middle_mm: [f64; 3]) -> (UnitQuaternion<f64>, Vector3<f64>, f64) {
    let [_, _, _, ab, ac, bc] = published::THREE_NOMINAL_MM;
    let x = (ab * ab + ac * ac - bc * bc) / (2.0 * ab);
    let (b, c) = (Vector3::new(ab, 0.0, 0.0), Vector3::new(x, (ac * ac - x * x).sqrt(), 0.0));
    let middle = 0.5 * (0.5 * b + c);
    let [about_up, about_right, roll] = turns_deg.map(f64::to_radians);
    let turn = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    // The board faces the camera with its longer side along the rows: x of the body downwards, y to the left.
    let facing = turn(Vector3::z(), std::f64::consts::FRAC_PI_2) * turn(Vector3::x(), std::f64::consts::PI);
    let whole =
        turn(Vector3::y(), about_up) * turn(Vector3::x(), about_right) * turn(Vector3::z(), roll) * facing;
    let reach = [Vector3::zeros(), b, c].iter().map(|ball| (ball - middle).norm()).fold(0.0, f64::max);
    (whole, Vector3::from(middle_mm) - whole * middle, reach + published::THREE_NOMINAL_MM[0])
}

/// Makes plans of things with the voltages that pass over them.
struct Sweeper<'a> {
    scanner: &'a Scanner,
    water: Medium,
    seed: u64,
}

impl Sweeper<'_> {
    fn swept(
        &mut self,
        name: &str,
        mut file: SceneFile,
        (middle, radius): (Vector3<f64>, f64),
        step_v: f64,
    ) -> Result<Plan, Error> {
        let [from, to] = self.reach(&middle, radius + BESIDE_MM);
        let steps = ((to - from) / step_v).ceil().max(1.0) as usize;
        file.capture.sweep = None;
        file.capture.voltages_v = (0..=steps).map(|k| from + step_v * k as f64).collect();
        self.seed = self.seed.wrapping_add(1);
        file.seed = self.seed;
        plan(name, file)
    }

    /// The voltages between which the sheet passes within `radius` of a point: where it comes nearest, and from there to either side.
    fn reach(&self, middle: &Vector3<f64>, radius: f64) -> [f64; 2] {
        let [low, high] = SEARCHED_V;
        // The sine of the angle by which the point is off the sheet, times its distance from the apex, is a distance near the sheet.
        let off = |v: f64| {
            let sheet = self.scanner.sheet(v, self.water);
            let sine = sheet.off_sheet(middle).unwrap_or(f64::INFINITY);
            // In water the angle is smaller by the index.
            sine / self.water.index * (middle - sheet.apex_mm).norm()
        };
        let step = (high - low) / (SEARCH_STEPS - 1) as f64;
        let near = |v: &f64| off(*v).abs() <= radius;
        let passed: Vec<f64> = (0..SEARCH_STEPS).map(|k| low + step * k as f64).filter(near).collect();
        match (passed.first(), passed.last()) {
            (Some(first), Some(last)) => [first - step, last + step],
            // Nowhere near: one image will show that.
            _ => [0.0, 0.0],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_thing_is_swept_whole() {
        let all = Experiments::new(1).unwrap();
        for plan in all.balls.iter().chain(&all.three).chain([&all.cover]) {
            let frames: Vec<f64> = plan.frames.iter().filter_map(|f| f.shot.voltage).collect();
            assert!((20..400).contains(&frames.len()), "{}: {} images", plan.name, frames.len());
            let scanner = &plan.instrument.scanner;
            let water = plan.scenes[0].water.laser;
            // The first sheet passes on one side of all that is seen, the last on the other.
            for object in plan.scenes[0]
                .objects
                .iter()
                .filter(|o| !o.name.contains("plate") && !o.name.contains("stem"))
            {
                let uw_sim::Shape::Sphere { radius_mm } = object.shape else { continue };
                let center = object.camera_from_body.translation_mm();
                for x in [-radius_mm, radius_mm] {
                    let edge = center + Vector3::new(x, 0.0, 0.0);
                    let sides = [frames[0], frames[frames.len() - 1]]
                        .map(|v| scanner.sheet(v, water).off_sheet(&edge).unwrap() > 0.0);
                    assert_ne!(sides[0], sides[1], "{}: {} at {x}", plan.name, object.name);
                }
                let pixel = scanner.project(&center, water).unwrap();
                let inside = (60.0..708.0).contains(&pixel.x) && (60.0..516.0).contains(&pixel.y);
                assert!(inside, "{}: {} is seen at {pixel}", plan.name, object.name);
            }
        }
    }

    #[test]
    fn the_balls_stand_where_the_paper_had_them() {
        let all = Experiments::new(3).unwrap();
        for (plan, row) in all.balls.iter().zip(published::BALLS) {
            let galvo = &plan.instrument.scanner.galvo;
            let center = plan.scenes[0].objects[0].camera_from_body.translation_mm();
            let local = galvo.axes.transpose() * (center - galvo.origin_mm);
            assert!((local - Vector3::from(row.center_mm)).norm() < 1e-9);
        }
    }
}
