//! The water outside the windows, as a rig file gives it.

use serde::{Deserialize, Serialize};

/// What tells the index of the water, relative to air at the laser's wavelength.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "WaterRecord", into = "WaterRecord")]
pub enum Water {
    /// The index itself.
    Index(f64),
    /// What it follows from.
    Properties {
        /// Temperature, degrees Celsius.
        temperature_c: f64,
        /// Practical salinity.
        salinity_psu: f64,
        /// Depth below the surface, metres.
        depth_m: f64,
    },
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WaterRecord {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    index: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    temperature_c: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    salinity_psu: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    depth_m: Option<f64>,
}

impl TryFrom<WaterRecord> for Water {
    type Error = &'static str;

    fn try_from(r: WaterRecord) -> Result<Self, Self::Error> {
        match (r.index, r.temperature_c, r.salinity_psu, r.depth_m) {
            (Some(index), None, None, None) => Ok(Self::Index(index)),
            (None, Some(temperature_c), Some(salinity_psu), Some(depth_m)) => {
                Ok(Self::Properties { temperature_c, salinity_psu, depth_m })
            }
            (Some(_), ..) => Err("invalid [water]: it has both its index and what the index follows from"),
            (None, None, None, None) => Err(
                "invalid [water]: it is empty, but needs index, or all of temperature_c, salinity_psu and depth_m",
            ),
            (None, ..) => Err(
                "invalid [water]: it needs all of temperature_c, salinity_psu and depth_m, or index alone",
            ),
        }
    }
}

impl From<Water> for WaterRecord {
    fn from(water: Water) -> Self {
        let none = Self { index: None, temperature_c: None, salinity_psu: None, depth_m: None };
        match water {
            Water::Index(index) => Self { index: Some(index), ..none },
            Water::Properties { temperature_c, salinity_psu, depth_m } => Self {
                temperature_c: Some(temperature_c),
                salinity_psu: Some(salinity_psu),
                depth_m: Some(depth_m),
                ..none
            },
        }
    }
}

impl Water {
    /// The index relative to air: of water known by its index, that index, which is the one at the laser's wavelength;
    /// else Quan and Fry's at `wavelength_nm` (in air), with a term for depth ([`uw_geom::water::index`]).
    /// [`Rig::water_index_at`](super::Rig::water_index_at) serves any wavelength.
    pub fn index(&self, wavelength_nm: f64) -> f64 {
        match *self {
            Self::Index(index) => index,
            Self::Properties { temperature_c, salinity_psu, depth_m } => {
                uw_geom::water::index(temperature_c, salinity_psu, wavelength_nm, depth_m)
            }
        }
    }
}
