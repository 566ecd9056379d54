//! What is known beforehand, as residuals: (value − drawing) / sigma.

use crate::data::{BoardView, Outside, Rig};
use crate::parameters::{Instrument, square_to};
use uw_geom::{Port, Real, lift};

/// Standard deviation of k₂ and k₃, which images with little in their corners leave open: ten times what lenses have.
const HIGH_DISTORTION_SIGMA: f64 = 1.0;
/// Standard deviation of an apex distance that the rig file leaves open, mm, about [`UNKNOWN_APEX_MM`].
const UNKNOWN_APEX_SIGMA_MM: f64 = 60.0;
/// Middle of what is built, for a rig file without `apex_mm`.
pub(crate) const UNKNOWN_APEX_MM: f64 = 90.0;
/// Standard deviation of the difference of water's index between two wavelengths: Quan and Fry's formula is good to a few
/// 1e-5, and the board's light is not monochromatic.
const DISPERSION_SIGMA: f64 = 1e-4;
/// The same where the captures say that one index serves both: as good as fixed.
const ONE_INDEX_SIGMA: f64 = 1e-10;

/// Standard deviation of how much the index at the board's light differs from its nominal value, beyond the laser's.
pub(crate) fn dispersion_sigma(views: &[BoardView]) -> f64 {
    let one = |v: &BoardView| match v.outside {
        Outside::Air => true,
        Outside::Water { laser_index, board_index } => (laser_index - board_index).abs() <= ONE_INDEX_SIGMA,
    };
    if views.iter().all(one) { ONE_INDEX_SIGMA } else { DISPERSION_SIGMA }
}

/// The priors' whitened residuals.
pub(crate) fn residuals<T: Real>(instrument: &Instrument<T>, rig: &Rig, dispersion_sigma: f64) -> Vec<T> {
    let p = &rig.priors;
    let s = &instrument.scanner;
    let mut rows = Vec::with_capacity(24);
    let mut say = |value: T, expected: f64, sigma: f64| {
        rows.push((value - T::constant(expected)).scale(1.0 / sigma));
    };
    let windows = [
        (&s.camera_port, &rig.camera_port, p.camera_port_distance_mm),
        (&s.laser_port, &rig.laser_port, p.laser_port_distance_mm),
    ];
    for (port, drawn, distance_sigma) in windows {
        window(port, drawn, distance_sigma, p.thickness_mm, p.glass_index, p.normal_deg, &mut say);
    }
    say(instrument.water_offset, 0.0, p.water_index);
    say(instrument.dispersion_offset, 0.0, dispersion_sigma);
    say(s.camera.distortion.k2, 0.0, HIGH_DISTORTION_SIGMA);
    say(s.camera.distortion.k3, 0.0, HIGH_DISTORTION_SIGMA);
    let f = &s.fan;
    match rig.apex_mm {
        Some(apex) => say(-f.apex_mm.z, apex, p.apex_mm),
        None => say(-f.apex_mm.z, UNKNOWN_APEX_MM, UNKNOWN_APEX_SIGMA_MM),
    }
    say(f.apex_mm.x, 0.0, p.apex_along_axis_mm);
    say(f.apex_mm.y, 0.0, p.fan_offset_mm);
    say(f.tilt_rad, 0.0, p.fan_tilt_deg.to_radians());
    say(f.mirror_offset_mm, 0.0, p.mirror_offset_mm);
    let g = &s.galvo;
    say(g.radians_per_volt, rig.radians_per_volt, rig.radians_per_volt * p.degrees_per_volt_rel);
    say(g.quadratic, 0.0, p.galvo_c2.to_radians());
    say(g.cubic, 0.0, p.galvo_c3.to_radians());
    rows
}

fn window<T: Real>(
    port: &Port<T>,
    drawn: &Port,
    distance_sigma: f64,
    thickness_sigma: f64,
    index_sigma: f64,
    normal_sigma_deg: f64,
    say: &mut impl FnMut(T, f64, f64),
) {
    let (e, f) = square_to(&drawn.normal);
    for direction in [e, f] {
        say(lift::<T>(&direction).dot(&port.normal), 0.0, normal_sigma_deg.to_radians());
    }
    say(port.distance_mm, drawn.distance_mm, distance_sigma);
    say(port.thickness_mm, drawn.thickness_mm, thickness_sigma);
    say(port.glass.index, drawn.glass.index, index_sigma);
}
