//! The calibration file's keys, and how they follow from the domain's types and back.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Deserializer, Serialize};
use uw_calib::{Across, Calibration, GLOBALS, Instrument, Method, NAMES, Quantity, quantities};
use uw_geom::{Distortion, Fan, Galvo, GeomError, Medium, Port, Scanner};

use super::{CalibrationFile, CaptureSource, Fault, check, statistics::StatisticsRecord};
use crate::{rig::Rig, toml_file::exactly};

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    pub software: String,
    #[serde(with = "MethodName")]
    pub method: Method,
    /// The pixel coordinate along which stripes are measured.
    #[serde(with = "AcrossName")]
    pub stripe_measured_along: Across,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    pub camera: CameraRecord,
    pub galvo: GalvoRecord,
    pub laser: LaserRecord,
    pub water: WaterRecord,
    pub statistics: StatisticsRecord,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub captures: Vec<CaptureSource>,
    pub rig: Rig,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<CovarianceRecord>,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Method", rename_all = "lowercase")]
enum MethodName {
    Joint,
    Paper,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Across", rename_all = "lowercase")]
enum AcrossName {
    U,
    V,
}

/// Three components, neither fewer nor more.
#[derive(Clone, Copy, Serialize)]
pub(super) struct Three(pub [f64; 3]);

impl<'de> Deserialize<'de> for Three {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        exactly(from).map(Self)
    }
}

impl From<Vector3<f64>> for Three {
    fn from(v: Vector3<f64>) -> Self {
        Self(v.into())
    }
}

/// A section of the file: keys that are as they are, then figures that were estimated, each with the key of its standard
/// deviation, which is absent where there is no covariance.
macro_rules! section {
    ($name:ident { $($fixed:ident: $fixed_type:ty,)* } estimated { $($key:ident, $sigma:ident: $type:ty,)* } $({ $($part:ident: $part_type:ty,)* })?) => {
        #[derive(Clone, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct $name {
            $(pub $fixed: $fixed_type,)*
            $(
                pub $key: $type,
                #[serde(default, skip_serializing_if = "Option::is_none")]
                pub $sigma: Option<$type>,
            )*
            $($(pub $part: $part_type,)*)?
        }
    };
}

section! {
    CameraRecord { width: u32, height: u32, }
    estimated {
        fx_px, sigma_fx_px: f64,
        fy_px, sigma_fy_px: f64,
        cx_px, sigma_cx_px: f64,
        cy_px, sigma_cy_px: f64,
        k1, sigma_k1: f64,
        k2, sigma_k2: f64,
        p1, sigma_p1: f64,
        p2, sigma_p2: f64,
        k3, sigma_k3: f64,
    }
    { port: PortRecord, }
}

section! {
    PortRecord {}
    estimated {
        normal, sigma_normal: Three,
        distance_mm, sigma_distance_mm: f64,
        thickness_mm, sigma_thickness_mm: f64,
        index, sigma_index: f64,
    }
}

section! {
    GalvoRecord { reference_v: f64, mirror_normal_deg: f64, y_axis: Three, }
    estimated {
        axis_point_mm, sigma_axis_point_mm: Three,
        axis_direction, sigma_axis_direction: Three,
        z_axis, sigma_z_axis: Three,
        degrees_per_volt, sigma_degrees_per_volt: f64,
        c2_deg_per_v2, sigma_c2_deg_per_v2: f64,
        c3_deg_per_v3, sigma_c3_deg_per_v3: f64,
        mirror_offset_mm, sigma_mirror_offset_mm: f64,
    }
}

section! {
    LaserRecord { wavelength_nm: f64, }
    estimated {
        apex_along_axis_mm, sigma_apex_along_axis_mm: f64,
        apex_across_mm, sigma_apex_across_mm: f64,
        apex_distance_mm, sigma_apex_distance_mm: f64,
        fan_tilt_deg, sigma_fan_tilt_deg: f64,
    }
    { port: PortRecord, }
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WaterRecord {
    /// Of the captures in water that took part; absent after a calibration on land.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal_index: Option<f64>,
    pub index_offset: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_index_offset: Option<f64>,
    pub dispersion_offset: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_dispersion_offset: Option<f64>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CovarianceRecord {
    pub names: Vec<String>,
    pub rows: Vec<Vec<f64>>,
}

/// Standard deviations by name; none without a covariance.
struct Sigmas(Vec<Quantity>);

impl Sigmas {
    /// To four digits: they are for people.
    fn of(&self, name: &str) -> Option<f64> {
        let sigma = self.0.iter().find(|q| q.name == name)?.sigma;
        Some(format!("{sigma:.3e}").parse().unwrap_or(sigma))
    }

    /// Of a vector, whose components carry x, y, z before the unit.
    fn three(&self, stem: &str, unit: &str) -> Option<Three> {
        let of = |axis| self.of(&format!("{stem}_{axis}{unit}"));
        Some(Three([of('x')?, of('y')?, of('z')?]))
    }

    fn port(&self, name: &str, port: &Port) -> PortRecord {
        let of = |key| self.of(&format!("{name}.{key}"));
        PortRecord {
            normal: port.normal.into(),
            sigma_normal: self.three(&format!("{name}.normal"), ""),
            distance_mm: port.distance_mm,
            sigma_distance_mm: of("distance_mm"),
            thickness_mm: port.thickness_mm,
            sigma_thickness_mm: of("thickness_mm"),
            index: port.glass.index,
            sigma_index: of("index"),
        }
    }
}

/// The degrees that come closest to `radians` when they are turned back. Four roundings lie between the two: the
/// right ones are at most two units in the last place away.
fn degrees(radians: f64) -> f64 {
    let first = radians.to_degrees();
    let miss = |degrees: &f64| (degrees.to_radians() - radians).abs();
    let (up, down) = (first.next_up(), first.next_down());
    [first, up, down, up.next_up(), down.next_down()]
        .into_iter()
        .min_by(|a, b| miss(a).total_cmp(&miss(b)))
        .unwrap_or(first)
}

impl Record {
    pub fn from_file(file: &CalibrationFile) -> Self {
        let CalibrationFile { calibration: c, rig, captures, software } = file;
        let covariance = c.covariance.as_ref();
        // A matrix of another size has no product with the derivatives; `check` refuses it.
        let sized = covariance.filter(|m| m.shape() == (GLOBALS, GLOBALS));
        let sigmas = Sigmas(sized.map(|m| quantities(&c.instrument, m)).unwrap_or_default());
        let of = |name| sigmas.of(name);
        let Scanner { camera, camera_port, galvo, fan, laser_port } = &c.instrument.scanner;
        let d = &camera.distortion;
        let [x, y, z] = [0, 1, 2].map(|k| Three(galvo.axes.column(k).into_owned().into()));
        Self {
            software: software.clone(),
            method: c.method,
            stripe_measured_along: c.across,
            warnings: c.warnings.clone(),
            camera: CameraRecord {
                width: c.image_size[0],
                height: c.image_size[1],
                fx_px: camera.fx,
                sigma_fx_px: of("camera.fx_px"),
                fy_px: camera.fy,
                sigma_fy_px: of("camera.fy_px"),
                cx_px: camera.cx,
                sigma_cx_px: of("camera.cx_px"),
                cy_px: camera.cy,
                sigma_cy_px: of("camera.cy_px"),
                k1: d.k1,
                sigma_k1: of("camera.k1"),
                k2: d.k2,
                sigma_k2: of("camera.k2"),
                p1: d.p1,
                sigma_p1: of("camera.p1"),
                p2: d.p2,
                sigma_p2: of("camera.p2"),
                k3: d.k3,
                sigma_k3: of("camera.k3"),
                port: sigmas.port("camera.port", camera_port),
            },
            galvo: GalvoRecord {
                reference_v: galvo.reference_v,
                mirror_normal_deg: degrees(fan.mirror_normal_rad),
                y_axis: y,
                axis_point_mm: galvo.origin_mm.into(),
                sigma_axis_point_mm: sigmas.three("galvo.axis_point", "_mm"),
                axis_direction: x,
                sigma_axis_direction: sigmas.three("galvo.axis_direction", ""),
                z_axis: z,
                sigma_z_axis: sigmas.three("galvo.z_axis", ""),
                degrees_per_volt: degrees(galvo.radians_per_volt),
                sigma_degrees_per_volt: of("galvo.degrees_per_volt"),
                c2_deg_per_v2: degrees(galvo.quadratic),
                sigma_c2_deg_per_v2: of("galvo.c2_deg_per_v2"),
                c3_deg_per_v3: degrees(galvo.cubic),
                sigma_c3_deg_per_v3: of("galvo.c3_deg_per_v3"),
                mirror_offset_mm: fan.mirror_offset_mm,
                sigma_mirror_offset_mm: of("galvo.mirror_offset_mm"),
            },
            laser: LaserRecord {
                wavelength_nm: rig.laser.wavelength_nm,
                apex_along_axis_mm: fan.apex_mm.x,
                sigma_apex_along_axis_mm: of("laser.apex_along_axis_mm"),
                apex_across_mm: fan.apex_mm.y,
                sigma_apex_across_mm: of("laser.apex_across_mm"),
                apex_distance_mm: -fan.apex_mm.z,
                sigma_apex_distance_mm: of("laser.apex_distance_mm"),
                fan_tilt_deg: degrees(fan.tilt_rad),
                sigma_fan_tilt_deg: of("laser.fan_tilt_deg"),
                port: sigmas.port("laser.port", laser_port),
            },
            water: WaterRecord {
                nominal_index: c.nominal_water_index,
                index_offset: c.instrument.water_offset,
                sigma_index_offset: of("water.index_offset"),
                dispersion_offset: c.instrument.dispersion_offset,
                sigma_dispersion_offset: of("water.dispersion_offset"),
            },
            statistics: (&c.statistics).into(),
            captures: captures.clone(),
            rig: rig.clone(),
            covariance: covariance.map(|m| CovarianceRecord {
                names: NAMES.map(str::to_owned).to_vec(),
                rows: m.row_iter().map(|row| row.iter().copied().collect()).collect(),
            }),
        }
    }

    pub fn into_file(self) -> Result<CalibrationFile, Fault> {
        let (c, g, l) = (&self.camera, &self.galvo, &self.laser);
        let instrument = Instrument {
            scanner: Scanner {
                camera: uw_geom::Camera {
                    fx: c.fx_px,
                    fy: c.fy_px,
                    cx: c.cx_px,
                    cy: c.cy_px,
                    distortion: Distortion { k1: c.k1, k2: c.k2, p1: c.p1, p2: c.p2, k3: c.k3 },
                },
                camera_port: port("camera.port", &c.port)?,
                galvo: Galvo {
                    origin_mm: g.axis_point_mm.0.into(),
                    axes: Matrix3::from_columns(&[g.axis_direction, g.y_axis, g.z_axis].map(|a| a.0.into())),
                    radians_per_volt: g.degrees_per_volt.to_radians(),
                    quadratic: g.c2_deg_per_v2.to_radians(),
                    cubic: g.c3_deg_per_v3.to_radians(),
                    reference_v: g.reference_v,
                },
                fan: Fan {
                    apex_mm: Vector3::new(l.apex_along_axis_mm, l.apex_across_mm, -l.apex_distance_mm),
                    tilt_rad: l.fan_tilt_deg.to_radians(),
                    mirror_offset_mm: g.mirror_offset_mm,
                    mirror_normal_rad: g.mirror_normal_deg.to_radians(),
                },
                laser_port: port("laser.port", &l.port)?,
            },
            water_offset: self.water.index_offset,
            dispersion_offset: self.water.dispersion_offset,
        };
        let covariance = self.covariance.as_ref().map(check::covariance).transpose()?;
        let calibration = Calibration {
            method: self.method,
            instrument,
            covariance,
            nominal_water_index: self.water.nominal_index,
            across: self.stripe_measured_along,
            image_size: [c.width, c.height],
            statistics: self.statistics.into_domain()?,
            warnings: self.warnings,
        };
        Ok(CalibrationFile { calibration, rig: self.rig, captures: self.captures, software: self.software })
    }
}

fn port(key: &str, record: &PortRecord) -> Result<Port, Fault> {
    let glass = Medium::of_index(record.index);
    Port::new(record.normal.0.into(), record.distance_mm, record.thickness_mm, glass).map_err(
        |e: GeomError| Fault::new(key, e.to_string(), "calibrate again, or mend the window's figures"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 20_000, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn angles_come_back_within_their_last_place(radians in -7.0..7.0f64, exponent in -12..1) {
            let radians = radians * 10f64.powi(exponent);
            let back = degrees(radians).to_radians();
            prop_assert!((back - radians).abs() <= f64::EPSILON * radians.abs());
            // What was read from a file is written so that it is the same again.
            prop_assert_eq!(degrees(back).to_radians().to_bits(), back.to_bits());
        }
    }
}
