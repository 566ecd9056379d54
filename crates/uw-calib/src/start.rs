//! Start values of the joint adjustment: poses from homographies, sheets from the stripes, the axis from the sheets.

use crate::data::{Observations, Outside, Rig};
use crate::error::CalibError;
use crate::homography::homography;
use crate::joint::State;
use crate::parameters::Instrument;
use crate::priors::UNKNOWN_APEX_MM;
use crate::sheets::{VoltagePlane, axis_of, robust_plane};
use crate::sight::Pose;
use crate::zhang::closed_form;
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use std::f64::consts::FRAC_PI_4;
use uw_geom::frame::{Board, Camera as CameraFrame};
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Rigid, Scanner};

/// A gain that differs from the rig file's by more than this factor is no inaccuracy but a mistake.
const GAIN_FACTOR: f64 = 1.5;
/// At most so many points of a stripe go into a start plane.
const POINTS_A_STRIPE: usize = 60;

/// The camera of the rig file: its focal length, the image's middle, no distortion.
fn drawn_camera(rig: &Rig) -> Camera {
    let [width, height] = rig.image_size.map(f64::from);
    Camera {
        fx: rig.focal_px[0],
        fy: rig.focal_px[1],
        cx: 0.5 * (width - 1.0),
        cy: 0.5 * (height - 1.0),
        distortion: Distortion::none(),
    }
}

/// How far Zhang's focal lengths may lie from the rig file's to be believed, as a factor.
const FOCAL_FACTOR: f64 = 1.5;

/// Zhang's closed form from the views in air, where it has a solution near the drawing; else the drawing's camera. The glass
/// in the path shifts the viewpoint by millimetres, which a start value stands.
pub(crate) fn zhang_camera(observations: &Observations, rig: &Rig) -> Camera {
    let in_air: Vec<_> = observations.views.iter().filter(|v| v.outside == Outside::Air).cloned().collect();
    let near = |got: f64, drawn: f64| (1.0 / FOCAL_FACTOR..=FOCAL_FACTOR).contains(&(got / drawn));
    closed_form(&in_air, rig.image_size)
        .filter(|c| near(c.fx, rig.focal_px[0]) && near(c.fy, rig.focal_px[1]))
        .unwrap_or_else(|| drawn_camera(rig))
}

/// The instrument of the rig file around a camera; its galvanometer stands at the origin.
pub(crate) fn drawn_instrument(rig: &Rig, camera: Camera) -> Instrument {
    Instrument {
        scanner: Scanner {
            camera,
            camera_port: rig.camera_port,
            galvo: Galvo {
                origin_mm: Vector3::zeros(),
                axes: Matrix3::identity(),
                radians_per_volt: rig.radians_per_volt,
                quadratic: 0.0,
                cubic: 0.0,
                reference_v: rig.reference_v,
            },
            fan: Fan {
                apex_mm: Vector3::new(0.0, 0.0, -rig.apex_mm.unwrap_or(UNKNOWN_APEX_MM)),
                tilt_rad: 0.0,
                mirror_offset_mm: 0.0,
                mirror_normal_rad: FRAC_PI_4,
            },
            laser_port: rig.laser_port,
        },
        water_offset: 0.0,
        dispersion_offset: 0.0,
    }
}

/// The whole state: camera, poses, galvanometer.
pub(crate) fn start(observations: &Observations, rig: &Rig) -> Result<State, CalibError> {
    let mut instrument = drawn_instrument(rig, zhang_camera(observations, rig));
    let poses = poses(observations, &instrument)?;
    let planes = planes(observations, rig, &instrument, &poses);
    instrument.scanner.galvo = galvo(rig, &planes)?;
    instrument.scanner.fan.mirror_normal_rad = instrument.scanner.galvo.mirror_normal_rad();
    Ok(State { instrument, poses })
}

fn poses(
    observations: &Observations,
    instrument: &Instrument,
) -> Result<Vec<Rigid<CameraFrame, Board>>, CalibError> {
    observations
        .views
        .iter()
        .map(|view| {
            let medium = instrument.board_medium(view.outside);
            let pairs: Option<Vec<_>> = view
                .corners
                .iter()
                .map(|c| {
                    let d = instrument.scanner.pixel_ray(&c.pixel, medium).ok()?.direction;
                    Some(([c.board_mm.x, c.board_mm.y], [d.x / d.z, d.y / d.z]))
                })
                .collect();
            let pose = pairs.and_then(|p| homography(&p)).and_then(|h| pose_of(&h));
            pose.ok_or_else(|| CalibError::Pose { file: view.file.clone() })
        })
        .collect()
}

/// The pose whose homography to normalised image points is `h`, up to its noise; `None` behind the camera or degenerate.
pub(crate) fn pose_of(h: &Matrix3<f64>) -> Option<Rigid<CameraFrame, Board>> {
    let scale = 0.5 * (h.column(0).norm() + h.column(1).norm());
    let h = h / scale.copysign(h[(2, 2)]);
    let (x, y): (Vector3<f64>, Vector3<f64>) = (h.column(0).into_owned(), h.column(1).into_owned());
    let rough = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    if !rough.iter().all(|v| v.is_finite()) || rough.determinant() <= 0.0 {
        return None;
    }
    let translation = h.column(2).into_owned();
    (translation.z > 0.0).then(|| Rigid::from_matrix(&rough, translation))
}

/// The laser's planes in air, one a voltage; from captures in air if those show two voltages or more.
fn planes(
    observations: &Observations,
    rig: &Rig,
    instrument: &Instrument,
    poses: &[Rigid<CameraFrame, Board>],
) -> Vec<VoltagePlane> {
    let in_air = planes_in(observations, instrument, poses, |o| o == Outside::Air);
    if in_air.len() >= 2 {
        return in_air;
    }
    let in_water = planes_in(observations, instrument, poses, |o| o != Outside::Air);
    let index = observations.views.iter().find_map(|v| match v.outside {
        Outside::Water { laser_index, .. } => Some(laser_index),
        Outside::Air => None,
    });
    let Some(index) = index else { return in_air };
    in_water.into_iter().filter_map(|p| p.taken_to_air(&rig.camera_port, Medium::of_index(index))).collect()
}

/// The laser's planes of the views that take part, one a voltage.
pub(crate) fn planes_in(
    observations: &Observations,
    instrument: &Instrument,
    poses: &[Rigid<CameraFrame, Board>],
    takes_part: impl Fn(Outside) -> bool,
) -> Vec<VoltagePlane> {
    let mut stripes: Vec<(f64, Vec<Vector3<f64>>)> = Vec::new();
    for (view, pose) in std::iter::zip(&observations.views, poses) {
        if !takes_part(view.outside) {
            continue;
        }
        let medium = instrument.laser_medium(view.outside);
        let pose = Pose::constant(pose);
        for stripe in &view.stripes {
            let every = stripe.points.len().div_ceil(POINTS_A_STRIPE).max(1);
            let points: Vec<_> = (stripe.points.iter().step_by(every))
                .filter_map(|p| instrument.on_board(&p.pixel, &pose, medium).ok())
                .collect();
            stripes.push((stripe.voltage_v, points));
        }
    }
    stripes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let same = |a: f64, b: f64| (a - b).abs() <= 1e-6 * (1.0 + a.abs());
    stripes
        .chunk_by(|a, b| same(a.0, b.0))
        .filter_map(|group| {
            let points: Vec<Vector3<f64>> = group.iter().flat_map(|(_, p)| p.iter().copied()).collect();
            let plane = robust_plane(&points)?;
            let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
            Some(VoltagePlane { voltage_v: group[0].0, plane, middle_mm: middle })
        })
        .collect()
}

/// The galvanometer's frame and gain from the laser's planes at two voltages or more.
pub(crate) fn galvo(rig: &Rig, planes: &[VoltagePlane]) -> Result<Galvo, CalibError> {
    let too_few = CalibError::TooFewVoltages { needed: 2, got: planes.len() };
    let (axis, point) = axis_of(planes).ok_or(too_few)?;
    let outwards = |p: &VoltagePlane| {
        let z = axis.cross(&p.plane.normal);
        z / z.norm() * z.dot(&(p.middle_mm - point)).signum()
    };
    let (first, rest) = (outwards(&planes[0]), &planes[1..]);
    // Angles of the planes about the axis, from the first, against their voltages: a straight line.
    let turned = rest.iter().map(|p| {
        let z = outwards(p);
        (p.voltage_v - planes[0].voltage_v, axis.dot(&first.cross(&z)).atan2(first.dot(&z)))
    });
    let (mut vv, mut va) = (0.0, 0.0);
    for (v, a) in turned {
        vv += v * v;
        va += v * a;
    }
    let slope = va / vv;
    let (axis, slope) = if slope < 0.0 { (-axis, -slope) } else { (axis, slope) };
    let gain = 0.5 * slope;
    let ratio = gain / rig.radians_per_volt;
    if !(1.0 / GAIN_FACTOR..=GAIN_FACTOR).contains(&ratio) {
        return Err(CalibError::Gain {
            got_deg_per_v: gain.to_degrees(),
            expected_deg_per_v: rig.radians_per_volt.to_degrees(),
        });
    }
    let to_reference = slope * (rig.reference_v - planes[0].voltage_v);
    let z = Rotation3::from_axis_angle(&Unit::new_unchecked(axis), to_reference) * first;
    Ok(Galvo {
        origin_mm: point - axis * axis.dot(&point),
        axes: Matrix3::from_columns(&[axis, z.cross(&axis), z]),
        radians_per_volt: gain,
        quadratic: 0.0,
        cubic: 0.0,
        reference_v: rig.reference_v,
    })
}
