/// What can go wrong between a pixel and a point.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GeomError {
    /// Total internal reflection: no ray leaves on the other side.
    #[error(
        "total internal reflection from index {from_index:.4} to {to_index:.4} at {incidence_deg:.2}° incidence"
    )]
    TotalReflection {
        /// Index on the side of the incoming ray.
        from_index: f64,
        /// Index on the far side.
        to_index: f64,
        /// Angle of incidence, degrees.
        incidence_deg: f64,
    },
    /// A ray runs along a window or away from it.
    #[error("the ray does not go out through the window (cosine to its normal {cosine:.3e})")]
    NotThroughWindow {
        /// Cosine between ray and outward normal.
        cosine: f64,
    },
    /// A point lies at or behind the outer face of a window.
    #[error("the point lies {behind_mm:.3} mm behind the window's outer face")]
    BehindWindow {
        /// How far behind, millimetres.
        behind_mm: f64,
    },
    /// A point at or behind the camera.
    #[error("the direction does not point forward (z = {z:.3e})")]
    BehindCamera {
        /// The direction's z.
        z: f64,
    },
    /// The lens distortion has no inverse at a pixel.
    #[error("the distortion has no inverse at normalised image point ({x:.3}, {y:.3})")]
    Undistortable {
        /// Distorted normalised x.
        x: f64,
        /// Distorted normalised y.
        y: f64,
    },
    /// A camera ray does not meet the laser sheet in front of the instrument.
    #[error("the camera's ray does not meet the laser sheet in front of the windows")]
    NoIntersection,
    /// An iteration did not settle.
    #[error("{what} did not converge in {iterations} iterations")]
    NotConverged {
        /// Which iteration.
        what: &'static str,
        /// How many were made.
        iterations: u32,
    },
    /// A quantity that must be finite, positive or of length 1 is not.
    #[error("{what} must be {needed}, got {got}")]
    Invalid {
        /// Which quantity.
        what: &'static str,
        /// What is needed of it.
        needed: &'static str,
        /// What was given.
        got: f64,
    },
}
