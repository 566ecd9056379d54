//! The true instrument of a simulation: from drawing values and what they can't say, or from a calibration.

use crate::Error;
use nalgebra::Vector3;
use uw_geom::{Camera, Distortion, Fan, Galvo, Medium, Port, Scanner, galvo_frame};
use uw_io::scene::SceneFile;
use uw_io::{Priors, Rig};
use uw_sim::{Beam, Draws, Instrument, Lens, Sensor};

/// Where the parts are that a rig file does not place, camera frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placement {
    pub(crate) axis_point_mm: Vector3<f64>,
    pub(crate) axis: Vector3<f64>,
    /// The fan's middle inside the housing at the reference voltage.
    pub(crate) beam: Vector3<f64>,
}

/// What a lens may differ by from its drawing: focal length (relative), principal point (of the image's size), k₁, k₂, p₁ and p₂. A
/// rig file has no priors for these: calibration finds them by itself.
const FOCAL: f64 = 0.005;
const CENTRE: f64 = 0.01;
const RADIAL: [f64; 2] = [0.1, 0.03];
const DECENTERING: f64 = 4e-4;
/// A window's normal, turned about two axes across it.
fn turned(d: &mut Draws, normal: [f64; 3], sigma_deg: f64) -> Vector3<f64> {
    let n = Vector3::from(normal);
    let (a, b) = (d.next(sigma_deg.to_radians()), d.next(sigma_deg.to_radians()));
    let across = n.cross(&if n.x.abs() < 0.5 { Vector3::x() } else { Vector3::y() }).normalize();
    (n + across * a.tan() + n.cross(&across) * b.tan()).normalize()
}

fn window(d: &mut Draws, port: &uw_io::rig::Port, distance_sigma: f64, p: &Priors) -> Result<Port, Error> {
    let normal = turned(d, port.normal, p.normal_deg);
    let distance_mm = (port.distance_mm + d.next(distance_sigma)).max(0.0);
    let thickness_mm = (port.thickness_mm + d.next(p.thickness_mm)).max(0.0);
    let glass = Medium::of_index((port.index + d.next(p.glass_index)).max(1.0));
    Port::new(normal, distance_mm, thickness_mm, glass).map_err(fault)
}

fn fault(error: impl Into<uw_sim::SimError>) -> Error {
    Error::Simulation(error.into())
}

/// An apex of unknown distance stands here, mm.
const APEX_MM: f64 = 90.0;

/// The true instrument as drawn, or as `seed` draws it from the rig's priors.
///
/// # Errors
/// [`Error::Simulation`] for a placement that no instrument has.
pub(crate) fn drawn(rig: &Rig, place: &Placement, seed: Option<u64>) -> Result<uw_calib::Instrument, Error> {
    let mut d = Draws::new(seed);
    let p = &rig.priors;
    let c = &rig.camera;
    let lens = 1.0 + d.next(FOCAL);
    let [fx, fy] = c.pixel_um.map(|pitch| c.focal_mm * 1000.0 * lens / pitch);
    let [w, h] = [c.width, c.height].map(f64::from);
    let camera = Camera {
        fx,
        fy,
        cx: 0.5 * (w - 1.0) + d.next(CENTRE * w),
        cy: 0.5 * (h - 1.0) + d.next(CENTRE * h),
        distortion: Distortion {
            k1: d.next(RADIAL[0]),
            k2: d.next(RADIAL[1]),
            p1: d.next(DECENTERING),
            p2: d.next(DECENTERING),
            k3: 0.0,
        },
    };
    let camera_port = window(&mut d, &c.port, p.camera_port_distance_mm, p)?;
    let plane = place.axis.cross(&place.beam);
    let (origin_mm, axes) =
        galvo_frame(&place.axis_point_mm, &place.axis, &plane, &place.beam).map_err(fault)?;
    let galvo = Galvo {
        origin_mm,
        axes,
        radians_per_volt: rig.galvo.degrees_per_volt.to_radians() * (1.0 + d.next(p.degrees_per_volt_rel)),
        quadratic: d.next(p.galvo_c2).to_radians(),
        cubic: d.next(p.galvo_c3).to_radians(),
        reference_v: rig.galvo.reference_v,
    };
    let apex = rig.laser.apex_mm.unwrap_or(APEX_MM) + d.next(p.apex_mm);
    let fan = Fan {
        apex_mm: Vector3::new(d.next(p.apex_along_axis_mm.min(5.0)), d.next(p.fan_offset_mm), -apex),
        tilt_rad: d.next(p.fan_tilt_deg).to_radians(),
        mirror_offset_mm: d.next(p.mirror_offset_mm),
        mirror_normal_rad: galvo.mirror_normal_rad(),
    };
    let laser_port = window(&mut d, &rig.laser.port, p.laser_port_distance_mm, p)?;
    let scanner = Scanner { camera, camera_port, galvo, fan, laser_port };
    Ok(uw_calib::Instrument { scanner, water_offset: d.next(p.water_index), dispersion_offset: 0.0 })
}

/// The whole instrument: geometry, and the scene file's light, lens and sensor.
///
/// # Errors
/// [`Error::Simulation`] names the first figure that no instrument has.
pub(crate) fn instrument(
    scanner: Scanner,
    rig: &Rig,
    beam: Option<&Vector3<f64>>,
    file: &SceneFile,
) -> Result<Instrument, Error> {
    // In the fan's plane, from z towards x of the galvanometer's frame.
    let middle_rad = beam.map_or(0.0, |beam| {
        let local = scanner.galvo.axes.tr_mul(beam);
        local.x.atan2(local.z)
    });
    let full = f64::from((1_u32 << rig.camera.bits) - 1);
    let instrument = Instrument {
        scanner,
        size: [rig.camera.width, rig.camera.height],
        beam: Beam {
            half_angle_rad: file.beam.half_angle_deg.to_radians(),
            middle_rad,
            waist_radius_mm: file.beam.waist_radius_mm,
            waist_at_mm: file.beam.waist_at_mm,
            wavelength_nm: rig.laser.wavelength_nm,
            level: file.beam.level,
        },
        lens: Lens {
            blur_px: file.lens.blur_px,
            halo: file.lens.halo,
            halo_px: file.lens.halo_px,
            vignetting: file.lens.vignetting,
        },
        sensor: Sensor {
            bits: rig.camera.bits,
            electrons_per_dn: file.sensor.full_well / full,
            read_noise_dn: file.sensor.read_noise * full,
            offset_dn: file.sensor.offset * full,
            speckle: file.sensor.speckle,
            speckle_px: file.sensor.speckle_px,
        },
    };
    instrument.check().map_err(Error::Simulation)?;
    Ok(instrument)
}
