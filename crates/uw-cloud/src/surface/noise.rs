//! What a cloud tells of its points' errors: how large they are in a direction, and where the light came from.

use crate::cloud::{PointCloud, unpacked};
use nalgebra::Vector3;

/// A cloud's errors of measurement.
pub(super) struct Noise<'a> {
    covariances: Option<&'a [[f32; 6]]>,
    sigmas: Option<&'a [f32]>,
    /// Each point's least certain direction, with a positive component along z: that of the laser's light, on which its stripe shifts it.
    light: Vec<Option<Vector3<f64>>>,
}

impl<'a> Noise<'a> {
    pub(super) fn of(cloud: &'a PointCloud) -> Self {
        let told = cloud.covariances_mm2().filter(|all| all.iter().flatten().any(|&c| c != 0.0));
        let light = told.into_iter().flatten().map(least_certain).collect();
        Self { covariances: told, sigmas: cloud.sigmas_mm(), light }
    }

    /// Variance of a point's position along a direction, mm²; nil where the cloud does not tell.
    #[inline]
    pub(super) fn along(&self, point: u32, direction: &Vector3<f64>) -> f64 {
        match (self.covariances, self.sigmas) {
            (Some(all), _) => {
                let [xx, xy, xz, yy, yz, zz] = all[point as usize].map(f64::from);
                let d = direction;
                let mixed = xy * d.x * d.y + xz * d.x * d.z + yz * d.y * d.z;
                (xx * d.x * d.x + yy * d.y * d.y + zz * d.z * d.z + 2.0 * mixed).max(0.0)
            }
            (None, Some(sigmas)) => f64::from(sigmas[point as usize]).powi(2),
            (None, None) => 0.0,
        }
    }

    /// Whether the cloud tells anything of its errors.
    pub(super) fn is_told(&self) -> bool {
        self.covariances.is_some() || self.sigmas.is_some_and(|all| all.iter().any(|&s| s > 0.0))
    }

    /// Whether it tells the light of any point.
    pub(super) fn tells_light(&self) -> bool {
        self.light.iter().any(Option::is_some)
    }

    /// The direction of the light that a point was seen by; `None` where the cloud does not tell.
    pub(super) fn light(&self, point: u32) -> Option<Vector3<f64>> {
        self.light.get(point as usize).copied().flatten()
    }
}

/// Share of a covariance's variance that has to lie along one direction for it to be the light's: a scanner's is all but of rank one.
const ALONG_LIGHT: f64 = 0.9;

/// The direction of a covariance's largest variance; `None` where it has none that stands out.
fn least_certain(covariance: &[f32; 6]) -> Option<Vector3<f64>> {
    let matrix = unpacked(covariance);
    let trace = matrix.trace();
    if trace.is_nan() || trace <= 0.0 {
        return None;
    }
    // Power iteration from the column of the largest variance, which is a third of the trace at least.
    let unit = matrix / trace;
    let mut axis = unit.column(unit.diagonal().imax()).into_owned();
    for _ in 0..4 {
        axis = unit * axis;
    }
    let axis = axis.try_normalize(0.0)?;
    let stands_out = axis.dot(&(unit * axis)) >= ALONG_LIGHT;
    stands_out.then(|| if axis.z < 0.0 { -axis } else { axis })
}
