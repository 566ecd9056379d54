//! A plan's truth, for the files beside the images.

use crate::pipeline::simulate::plan::Plan;
use nalgebra::{Matrix3, Unit, Vector3};
use uw_geom::{Port, Rigid, rotation_about_x};
use uw_io::Kind;
use uw_io::truth::{
    Truth, TruthCamera, TruthFrame, TruthFrameAxes, TruthGalvo, TruthLaser, TruthObject, TruthPort,
    TruthPose, TruthRig, TruthTarget,
};
use uw_sim::{Object, Shape};

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)]))
}

fn array(v: &Vector3<f64>) -> [f64; 3] {
    [v.x, v.y, v.z]
}

fn port(port: &Port) -> TruthPort {
    TruthPort {
        normal: array(&port.normal),
        distance_mm: port.distance_mm,
        thickness_mm: port.thickness_mm,
        index: port.glass.index,
    }
}

fn rotation<A, B>(pose: &Rigid<A, B>) -> [[f64; 3]; 3] {
    rows(&pose.rotation_matrix())
}

fn object(object: &Object) -> TruthObject {
    let pose = &object.camera_from_body;
    TruthObject {
        name: object.name.clone(),
        rotation: rotation(pose),
        translation_mm: array(&pose.translation_mm()),
        velocity_mm_s: array(&object.motion.velocity_mm_s),
        radius_mm: match object.shape {
            Shape::Sphere { radius_mm } => Some(radius_mm),
            _ => None,
        },
        profile_rz_mm: match &object.shape {
            Shape::Revolution(revolution) => Some(revolution.profile_rz_mm.clone()),
            _ => None,
        },
    }
}

/// The instrument with its fan as it is before the mirror, which shows it mirrored.
fn rig(plan: &Plan) -> TruthRig {
    let scanner = &plan.instrument.scanner;
    let (c, galvo, fan, beam) = (&scanner.camera, &scanner.galvo, &scanner.fan, &plan.instrument.beam);
    let d = &c.distortion;
    let normal_at = |volts: f64| {
        let (s, c) = fan.mirror_normal_rad.sin_cos();
        galvo.axes * (rotation_about_x(galvo.mirror_angle(volts)) * Vector3::new(0.0, s, c))
    };
    let mirror = Unit::new_unchecked(normal_at(galvo.reference_v));
    let mirrored = |v: Vector3<f64>| v - mirror.into_inner() * (2.0 * v.dot(&mirror));
    let (ts, tc) = fan.tilt_rad.sin_cos();
    let normal = Vector3::new(ts, tc, 0.0);
    let (ms, mc) = beam.middle_rad.sin_cos();
    let middle = Vector3::z() * mc + normal.cross(&Vector3::z()) * ms;
    let water = &plan.scenes[0].water;
    TruthRig {
        medium: plan.file.capture.medium.name(),
        medium_index: water.laser.index,
        camera: TruthCamera {
            width: plan.instrument.size[0],
            height: plan.instrument.size[1],
            matrix: [[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, 1.0]],
            distortion_k1_k2_p1_p2_k3: [d.k1, d.k2, d.p1, d.p2, d.k3],
            port: port(&scanner.camera_port),
        },
        laser: TruthLaser {
            apex_mm: array(&(galvo.origin_mm + mirrored(galvo.axes * fan.apex_mm))),
            fan_normal: array(&mirrored(galvo.axes * normal)),
            fan_centre: array(&mirrored(galvo.axes * middle)),
            waist_radius_mm: beam.waist_radius_mm,
            waist_at_mm: beam.waist_at_mm,
            wavelength_nm: beam.wavelength_nm,
            half_angle_deg: beam.half_angle_rad.to_degrees(),
            port: port(&scanner.laser_port),
        },
        galvo: TruthGalvo {
            axis_point_mm: array(&galvo.origin_mm),
            axis_direction: array(&galvo.axes.column(0).into()),
            mirror_normal_at_0v: array(&normal_at(0.0)),
            mirror_offset_mm: fan.mirror_offset_mm,
            degrees_per_volt: galvo.radians_per_volt.to_degrees(),
            c2: galvo.quadratic.to_degrees(),
            c3: galvo.cubic.to_degrees(),
            reference_v: galvo.reference_v,
        },
        galvo_frame: TruthFrameAxes {
            rows_x_y_z_in_camera: rows(&galvo.axes.transpose()),
            origin_closest_to_camera_mm: array(&galvo.origin_mm),
        },
    }
}

/// The truth of a plan.
pub(crate) fn truth(plan: &Plan) -> Truth {
    let target = plan.file.capture.target.as_ref().filter(|_| plan.file.capture.kind == Kind::Calibration);
    let poses = || {
        plan.scenes.iter().enumerate().map(|(k, scene)| {
            let pose = &scene.objects[0].camera_from_body;
            TruthPose {
                pose: k as u32,
                rotation: rotation(pose),
                translation_mm: array(&pose.translation_mm()),
            }
        })
    };
    // A board is its own record.
    let things = &plan.scenes[0].objects[usize::from(target.is_some())..];
    Truth {
        name: plan.name.clone(),
        rig: rig(plan),
        attenuation_per_mm: plan.scenes[0].water.attenuation_per_mm,
        target: target.map(|target| TruthTarget {
            inner_corners: target.inner_corners,
            square_mm: target.square_mm,
            board_poses: poses().collect(),
        }),
        objects: things.iter().map(object).collect(),
        frames: plan
            .frames
            .iter()
            .map(|frame| TruthFrame {
                file: frame.record.file.clone(),
                pose: frame.record.pose,
                voltage_v: frame.record.voltage_v,
            })
            .collect(),
    }
}
