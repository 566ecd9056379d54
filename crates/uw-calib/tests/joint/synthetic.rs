//! An instrument drawn from the priors of a rig file, and what it would observe: no images, exact places plus noise.
//!
//! Places of stripes are found by bisection along a row on the sign of `Sheet::off_sheet`, not by the calibration's code.

use nalgebra::{Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector2, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use uw_calib::{
    Across, BoardView, CornerPoint, Instrument, Observations, Outside, Priors, Rig, StripePoint, StripeView,
};
use uw_geom::frame::{Board, Camera as CameraFrame};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Rigid, Scanner, galvo_frame};

/// Standard deviation of the corners, px.
pub const CORNER_SIGMA_PX: f64 = 0.05;
/// Standard deviation of the stripes, px.
pub const STRIPE_SIGMA_PX: f64 = 0.1;
/// Nominal index of the water at the laser's wavelength, and at the board's light.
pub const NOMINAL: f64 = 1.335;
const NOMINAL_BOARD: f64 = 1.3345;
const IMAGE: [u32; 2] = [768, 576];
const COLUMNS: usize = 11;
const ROWS: usize = 8;

/// What is captured.
#[derive(Clone, Debug)]
pub struct Plan {
    pub air_poses: usize,
    pub water_poses: usize,
    pub voltages: Vec<f64>,
    /// Largest tilt of the boards, degrees.
    pub tilt_deg: f64,
    /// Nearest and farthest board, mm.
    pub depth_mm: [f64; 2],
    /// Every how many rows a stripe is measured.
    pub row_step: usize,
}

impl Default for Plan {
    fn default() -> Self {
        Self {
            air_poses: 10,
            water_poses: 6,
            voltages: vec![-2.2, -1.0, 0.2, 1.4],
            tilt_deg: 35.0,
            depth_mm: [700.0, 1050.0],
            row_step: 12,
        }
    }
}

pub struct World {
    pub rig: Rig,
    pub truth: Instrument,
    pub observations: Observations,
}

struct Dice(StdRng);

impl Dice {
    fn normal(&mut self, mean: f64, sigma: f64) -> f64 {
        let z: f64 = StandardNormal.sample(&mut self.0);
        mean + sigma * z
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }
}

pub fn rig() -> Rig {
    let glass = Medium::of_index(1.5195);
    Rig {
        image_size: IMAGE,
        focal_px: [12_000.0 / 8.6, 12_000.0 / 8.3],
        camera_port: Port::new(Vector3::z(), 10.0, 8.0, glass).unwrap(),
        laser_port: Port::new(Vector3::z(), 35.0, 8.0, glass).unwrap(),
        apex_mm: Some(90.0),
        radians_per_volt: 2f64.to_radians(),
        reference_v: -1.6,
        // A scan's middle fixes where along the axis the fan leaves; drawn like everything else.
        priors: Priors { apex_along_axis_mm: 5.0, ..Priors::default() },
    }
}

/// An instrument drawn from the rig file's priors.
fn draw(rig: &Rig, dice: &mut Dice) -> Instrument {
    let p = &rig.priors;
    let mut port = |drawn: &Port, distance_sigma: f64| {
        let tilt = p.normal_deg.to_radians();
        let normal = Vector3::new(dice.normal(0.0, tilt), dice.normal(0.0, tilt), 1.0).normalize();
        Port {
            normal,
            distance_mm: dice.normal(drawn.distance_mm, distance_sigma),
            thickness_mm: dice.normal(drawn.thickness_mm, p.thickness_mm),
            glass: Medium::of_index(dice.normal(drawn.glass.index, p.glass_index)),
        }
    };
    let camera_port = port(&rig.camera_port, p.camera_port_distance_mm);
    let laser_port = port(&rig.laser_port, p.laser_port_distance_mm);
    let axis_point = Vector3::new(430.0 + dice.normal(0.0, 3.0), 0.0, -12.0 + dice.normal(0.0, 3.0));
    let axis = Vector3::new(dice.normal(0.0, 0.01), -1.0, dice.normal(0.0, 0.01)).normalize();
    // At the reference voltage the sheet leaves 25° towards the camera's side.
    let z = Vector3::new(-(25f64.to_radians() + dice.normal(0.0, 0.01)).sin(), 0.0, 25f64.to_radians().cos());
    let (origin_mm, axes) = galvo_frame(&axis_point, &axis, &z.cross(&axis), &Vector3::z()).unwrap();
    let camera = Camera {
        fx: rig.focal_px[0] * (1.0 + dice.normal(0.0, 0.01)),
        fy: rig.focal_px[1] * (1.0 + dice.normal(0.0, 0.01)),
        cx: dice.normal(384.0, 6.0),
        cy: dice.normal(288.0, 6.0),
        distortion: Distortion {
            k1: dice.normal(-0.2, 0.05),
            k2: dice.normal(0.0, 1.0),
            p1: dice.normal(0.0, 1e-3),
            p2: dice.normal(0.0, 1e-3),
            k3: dice.normal(0.0, 1.0),
        },
    };
    let galvo = Galvo {
        origin_mm,
        axes,
        radians_per_volt: rig.radians_per_volt * (1.0 + dice.normal(0.0, p.degrees_per_volt_rel)),
        quadratic: dice.normal(0.0, p.galvo_c2.to_radians()),
        cubic: dice.normal(0.0, p.galvo_c3.to_radians()),
        reference_v: rig.reference_v,
    };
    let fan = Fan {
        apex_mm: Vector3::new(
            dice.normal(0.0, p.apex_along_axis_mm),
            dice.normal(0.0, p.fan_offset_mm),
            -dice.normal(90.0, p.apex_mm),
        ),
        tilt_rad: dice.normal(0.0, p.fan_tilt_deg.to_radians()),
        mirror_offset_mm: dice.normal(0.0, p.mirror_offset_mm),
        mirror_normal_rad: -std::f64::consts::FRAC_PI_4,
    };
    Instrument {
        scanner: Scanner { camera, camera_port, galvo, fan, laser_port },
        water_offset: dice.normal(0.0, p.water_index),
        dispersion_offset: dice.normal(0.0, 1e-4),
    }
}

/// Draws an instrument and captures with it what `plan` says.
pub fn world(plan: &Plan, seed: u64) -> World {
    let mut dice = Dice(StdRng::seed_from_u64(seed));
    let rig = rig();
    let truth = draw(&rig, &mut dice);
    let mut views = Vec::new();
    for k in 0..plan.air_poses + plan.water_poses {
        let (outside, square_mm) = if k < plan.air_poses {
            (Outside::Air, 24.0)
        } else {
            (Outside::Water { laser_index: NOMINAL, board_index: NOMINAL_BOARD }, 18.0)
        };
        views.push(place(&truth, outside, square_mm, plan, k, &mut dice));
    }
    World { rig, truth, observations: Observations { across: Across::U, views } }
}

fn index(truth: &Instrument, outside: Outside) -> (Medium, Medium) {
    match outside {
        Outside::Air => (Medium::air(), Medium::air()),
        Outside::Water { laser_index, board_index } => (
            Medium::of_index(laser_index + truth.water_offset),
            Medium::of_index(board_index + truth.water_offset + truth.dispersion_offset),
        ),
    }
}

/// A board in view, its corners and stripes.
fn place(
    truth: &Instrument,
    outside: Outside,
    square_mm: f64,
    plan: &Plan,
    k: usize,
    dice: &mut Dice,
) -> BoardView {
    let (laser, board) = index(truth, outside);
    let half = Vector3::new(0.5 * (COLUMNS - 1) as f64, 0.5 * (ROWS - 1) as f64, 0.0) * square_mm;
    loop {
        let tilt = plan.tilt_deg.to_radians();
        let turn = UnitQuaternion::from_euler_angles(
            dice.between(-tilt, tilt),
            dice.between(-tilt, tilt),
            dice.between(-0.3, 0.3),
        );
        let aim = Vector2::new(dice.between(250.0, 520.0), dice.between(200.0, 380.0));
        let ray = truth.scanner.pixel_ray(&aim, board).unwrap();
        let depth = dice.between(plan.depth_mm[0], plan.depth_mm[1]);
        let middle = ray.at((depth - ray.origin.z) / ray.direction.z);
        let pose: Rigid<CameraFrame, Board> = Rigid::new(turn, middle - turn * half);
        let noise = Matrix2::identity() * CORNER_SIGMA_PX.powi(2);
        let corners: Vec<CornerPoint> = (0..COLUMNS * ROWS)
            .filter_map(|i| {
                let board_mm = Vector2::new((i % COLUMNS) as f64, (i / COLUMNS) as f64) * square_mm;
                let at = pose.transform_point(&board_mm.push(0.0));
                let exact = truth.scanner.project(&at, board).ok()?;
                let inside = |x: f64, size: u32| (5.0..f64::from(size) - 6.0).contains(&x);
                (inside(exact.x, IMAGE[0]) && inside(exact.y, IMAGE[1])).then(|| {
                    let pixel = exact.map(|x| dice.normal(x, CORNER_SIGMA_PX));
                    CornerPoint { board_mm, pixel, covariance: noise }
                })
            })
            .collect();
        if corners.len() < COLUMNS * ROWS * 3 / 4 {
            continue;
        }
        let stripes = (plan.voltages.iter())
            .map(|&voltage_v| StripeView {
                file: format!("pose {k}, {voltage_v} V"),
                voltage_v,
                points: stripe(truth, &pose, laser, voltage_v, plan.row_step, dice),
            })
            .collect();
        return BoardView { file: format!("pose {k}"), outside, square_mm, corners, stripes };
    }
}

fn stripe(
    truth: &Instrument,
    pose: &Rigid<CameraFrame, Board>,
    medium: Medium,
    voltage_v: f64,
    row_step: usize,
    dice: &mut Dice,
) -> Vec<StripePoint> {
    let sheet = truth.scanner.sheet(voltage_v, medium);
    let rotation: Matrix3<f64> = Rotation3::from(pose.rotation()).into_inner();
    let normal: Vector3<f64> = rotation.column(2).into_owned();
    let before = |u: f64, v: f64| {
        let ray = truth.scanner.pixel_ray(&Vector2::new(u, v), medium).ok()?;
        let t = normal.dot(&(pose.translation_mm() - ray.origin)) / normal.dot(&ray.direction);
        sheet.off_sheet(&ray.at(t)).ok().map(f64::is_sign_positive)
    };
    (0..IMAGE[1])
        .step_by(row_step)
        .filter_map(|row| {
            let v = f64::from(row);
            let (mut a, mut b) = (0.0, f64::from(IMAGE[0]) - 1.0);
            let side = before(a, v)?;
            if before(b, v)? == side {
                return None;
            }
            for _ in 0..50 {
                let m = 0.5 * (a + b);
                if before(m, v)? == side { a = m } else { b = m }
            }
            Some(StripePoint {
                pixel: Vector2::new(dice.normal(0.5 * (a + b), STRIPE_SIGMA_PX), v),
                sigma_px: STRIPE_SIGMA_PX,
                width_px: 1.0,
            })
        })
        .collect()
}
