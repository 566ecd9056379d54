//! What can go wrong with a cloud or a fit.

/// A cloud whose parts do not belong together, or that holds values that are no numbers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CloudError {
    /// An attribute has another number of entries than the cloud has points.
    #[error("attribute {attribute} has {got} entries for {needed} points")]
    LengthMismatch {
        /// The attribute's name.
        attribute: &'static str,
        /// Points in the cloud.
        needed: usize,
        /// Entries of the attribute.
        got: usize,
    },
    /// A position or attribute is infinite or not a number.
    #[error("{attribute} of point {index} is not finite")]
    NonFinite {
        /// The attribute's name (`position` for the coordinates).
        attribute: &'static str,
        /// Which point, from 0.
        index: usize,
    },
    /// More points than an index of neighbours can hold.
    #[error("{got} points are more than can be indexed (2³² − 1)")]
    TooMany {
        /// Points given.
        got: usize,
    },
}

/// Why a shape was not fitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// The cloud holds something that no fit can use.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// A covariance is not one: it has a negative variance beyond rounding.
    #[error("the covariance of point {index} has a negative variance, {variance_mm2} mm²")]
    InvalidCovariance {
        /// Which point, from 0.
        index: usize,
        /// Its smallest eigenvalue.
        variance_mm2: f64,
    },
    /// The given radius is not a positive number.
    #[error("the radius must be a positive number of millimetres, got {radius_mm}")]
    InvalidRadius {
        /// What was given.
        radius_mm: f64,
    },
    /// Fewer distinct points than the shape needs. Without covariances one more is needed, as the points' own
    /// scatter must serve as their sigma.
    #[error("a {shape} needs {needed} distinct points, got {got}")]
    TooFewPoints {
        /// The shape.
        shape: &'static str,
        /// Distinct points needed.
        needed: usize,
        /// Distinct points given.
        got: usize,
    },
    /// No shape was found that enough of the points agree with.
    #[error("no {shape} that {needed} of the {points} points agree with, at most {got} do")]
    NoConsensus {
        /// The shape.
        shape: &'static str,
        /// Agreeing points needed.
        needed: usize,
        /// Agreeing points found.
        got: usize,
        /// Distinct points given.
        points: usize,
    },
    /// The points lie so (on one line, on one plane, in one spot) that they do not determine the shape: what they
    /// seem to say about its least certain parameter is as much as their noise alone would say.
    #[error(
        "the points do not determine a {shape}: {noise_share:.2} of what they say about its least certain \
         parameter is noise (at most {allowed:.2} is accepted); measure a larger part of it"
    )]
    Undetermined {
        /// The shape.
        shape: &'static str,
        /// Share of the least certain parameter's information that the noise alone would feign; 1 for an exactly
        /// singular arrangement.
        noise_share: f64,
        /// The largest share that is accepted.
        allowed: f64,
    },
    /// Two shapes fit the points equally well, such as two balls of known radius on either side of a small cap.
    #[error(
        "two {shape}s of the given radius fit the points, {separation_mm:.3} mm apart, and the points don't tell \
         which (chi-square differs by {chi2_difference:.1}, {needed:.1} is needed)"
    )]
    Ambiguous {
        /// The shape.
        shape: &'static str,
        /// Distance between the two.
        separation_mm: f64,
        /// By how much the other one fits worse, in units of the scale.
        chi2_difference: f64,
        /// The difference from which on the better one is trusted.
        needed: f64,
    },
    /// The refinement did not come to rest.
    #[error("the fit of a {shape} did not converge in {iterations} iterations")]
    NotConverged {
        /// The shape.
        shape: &'static str,
        /// Iterations done.
        iterations: usize,
    },
}
