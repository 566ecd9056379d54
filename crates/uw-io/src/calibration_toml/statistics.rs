//! The `[statistics]` of a calibration file.

use serde::{Deserialize, Serialize};
use uw_calib::{CorrelatedPair, Rejected, Statistics, WorstImage};

use super::{Fault, check};

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StatisticsRecord {
    pub reprojection_rms_px: f64,
    pub stripe_rms_px: f64,
    pub stripe_rms_mm: f64,
    pub corner_scale: f64,
    pub stripe_scale: f64,
    pub corners: usize,
    pub corners_rejected: usize,
    pub stripe_points: usize,
    pub stripe_points_rejected: usize,
    pub poses_used: usize,
    pub frames_used: usize,
    pub iterations: usize,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rejected: Vec<RejectedRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub worst: Vec<WorstRecord>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub correlated: Vec<CorrelatedRecord>,
}

/// An image that was left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RejectedRecord {
    /// Which.
    pub file: String,
    /// Why.
    pub reason: String,
}

impl From<&Rejected> for RejectedRecord {
    fn from(r: &Rejected) -> Self {
        Self { file: r.file.clone(), reason: r.reason.clone() }
    }
}

/// An image by its residuals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorstRecord {
    /// Which.
    pub file: String,
    /// Root mean square, px.
    pub rms_px: f64,
    /// Largest, px.
    pub max_px: f64,
}

impl From<&WorstImage> for WorstRecord {
    fn from(w: &WorstImage) -> Self {
        Self { file: w.file.clone(), rms_px: w.rms_px, max_px: w.max_px }
    }
}

/// A pair of parameters that the data hardly tell apart.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrelatedRecord {
    /// One.
    pub a: String,
    /// The other.
    pub b: String,
    /// Their correlation.
    pub correlation: f64,
}

impl From<&CorrelatedPair> for CorrelatedRecord {
    fn from(p: &CorrelatedPair) -> Self {
        Self { a: p.a.into(), b: p.b.into(), correlation: p.correlation }
    }
}

impl From<&Statistics> for StatisticsRecord {
    fn from(s: &Statistics) -> Self {
        Self {
            reprojection_rms_px: s.reprojection_rms_px,
            stripe_rms_px: s.stripe_rms_px,
            stripe_rms_mm: s.stripe_rms_mm,
            corner_scale: s.corner_scale,
            stripe_scale: s.stripe_scale,
            corners: s.corners,
            corners_rejected: s.corners_rejected,
            stripe_points: s.stripe_points,
            stripe_points_rejected: s.stripe_points_rejected,
            poses_used: s.poses_used,
            frames_used: s.frames_used,
            iterations: s.iterations,
            rejected: s.rejected.iter().map(Into::into).collect(),
            worst: s.worst.iter().map(Into::into).collect(),
            correlated: s.correlated.iter().map(Into::into).collect(),
        }
    }
}

impl StatisticsRecord {
    pub fn into_domain(self) -> Result<Statistics, Fault> {
        let pair = |p: CorrelatedRecord| {
            let [a, b] = [&p.a, &p.b].map(|name| check::parameter("statistics.correlated", name));
            Ok(CorrelatedPair { a: a?, b: b?, correlation: p.correlation })
        };
        Ok(Statistics {
            reprojection_rms_px: self.reprojection_rms_px,
            stripe_rms_px: self.stripe_rms_px,
            stripe_rms_mm: self.stripe_rms_mm,
            corners: self.corners,
            stripe_points: self.stripe_points,
            corners_rejected: self.corners_rejected,
            stripe_points_rejected: self.stripe_points_rejected,
            poses_used: self.poses_used,
            frames_used: self.frames_used,
            rejected: self
                .rejected
                .into_iter()
                .map(|r| Rejected { file: r.file, reason: r.reason })
                .collect(),
            worst: self
                .worst
                .into_iter()
                .map(|w| WorstImage { file: w.file, rms_px: w.rms_px, max_px: w.max_px })
                .collect(),
            correlated: self.correlated.into_iter().map(pair).collect::<Result<_, _>>()?,
            corner_scale: self.corner_scale,
            stripe_scale: self.stripe_scale,
            iterations: self.iterations,
        })
    }
}
