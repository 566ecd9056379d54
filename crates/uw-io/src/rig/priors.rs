//! How far an instrument may be from its drawing.

use serde::{Deserialize, Serialize};

/// Standard deviations of a rig's drawing values, one key each in `[priors]`; all positive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Priors {
    /// Of the camera's port's distance.
    pub camera_port_distance_mm: f64,
    /// Of the laser's port's distance.
    pub laser_port_distance_mm: f64,
    /// Of either window's thickness.
    pub thickness_mm: f64,
    /// Of either window's normal, along each of the two directions across it.
    pub normal_deg: f64,
    /// Of the glass's index.
    pub glass_index: f64,
    /// Of the water's index.
    pub water_index: f64,
    /// Of the apex's distance.
    pub apex_mm: f64,
    /// Of the degrees per volt, as a fraction of them: 0.005 is half a per cent.
    pub degrees_per_volt_rel: f64,
    /// Of the galvanometer's quadratic term, degrees per square volt.
    pub galvo_c2: f64,
    /// Of the galvanometer's cubic term, degrees per cubic volt.
    pub galvo_c3: f64,
    /// Of the mirror's surface beside its axis.
    pub mirror_offset_mm: f64,
    /// Of the fan's plane against the axis.
    pub fan_tilt_deg: f64,
    /// By how much the fan's plane misses the mirror's axis.
    pub fan_offset_mm: f64,
    /// Of where along the axis the fan's apex lies, from the axis's point closest to the optical centre.
    pub apex_along_axis_mm: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            camera_port_distance_mm: 0.5,
            laser_port_distance_mm: 0.5,
            thickness_mm: 0.05,
            normal_deg: 0.5,
            glass_index: 0.0005,
            water_index: 0.0005,
            apex_mm: 3.0,
            degrees_per_volt_rel: 0.005,
            galvo_c2: 3e-4,
            galvo_c3: 3e-4,
            mirror_offset_mm: 0.3,
            fan_tilt_deg: 0.3,
            fan_offset_mm: 0.5,
            apex_along_axis_mm: 30.0,
        }
    }
}

impl Priors {
    /// Each sigma with its key.
    pub(super) fn named(&self) -> [(&'static str, f64); 14] {
        [
            ("camera_port_distance_mm", self.camera_port_distance_mm),
            ("laser_port_distance_mm", self.laser_port_distance_mm),
            ("thickness_mm", self.thickness_mm),
            ("normal_deg", self.normal_deg),
            ("glass_index", self.glass_index),
            ("water_index", self.water_index),
            ("apex_mm", self.apex_mm),
            ("degrees_per_volt_rel", self.degrees_per_volt_rel),
            ("galvo_c2", self.galvo_c2),
            ("galvo_c3", self.galvo_c3),
            ("mirror_offset_mm", self.mirror_offset_mm),
            ("fan_tilt_deg", self.fan_tilt_deg),
            ("fan_offset_mm", self.fan_offset_mm),
            ("apex_along_axis_mm", self.apex_along_axis_mm),
        ]
    }
}
