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
    #[error(
        "no {shape} that {needed} of the {points} points agree with, at most {got} do: crop the cloud to the {shape}, or have all shapes found \
         (uwscan shapes, find_shapes)"
    )]
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
         parameter is noise (at most {allowed:.2} is accepted); measure a larger part of it or, where most points lie on \
         something else, crop the cloud to the {shape} or have all shapes found (uwscan shapes, find_shapes)"
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
    /// The points keep hardly nearer to the best shape of its kind than those would that fill it.
    #[error(
        "the points are no {shape}: they scatter by {rms_mm:.3} mm about the best one, of radius {radius_mm:.3} mm; crop the cloud to the {shape}, \
         or have all shapes found (uwscan shapes, find_shapes)"
    )]
    NoShape {
        /// The shape.
        shape: &'static str,
        /// The points' distances from it, root mean square.
        rms_mm: f64,
        /// Its radius.
        radius_mm: f64,
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
    #[error(
        "the fit of a {shape} did not converge in {iterations} iterations: most points may lie on something else; crop the cloud to the {shape}, or \
         have all shapes found (uwscan shapes, find_shapes)"
    )]
    NotConverged {
        /// The shape.
        shape: &'static str,
        /// Iterations done.
        iterations: usize,
    },
}

/// Triangles that are no mesh.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// An attribute has another number of entries than the mesh has vertices.
    #[error("attribute {attribute} has {got} entries for {needed} vertices")]
    LengthMismatch {
        /// The attribute's name.
        attribute: &'static str,
        /// Vertices of the mesh.
        needed: usize,
        /// Entries of the attribute.
        got: usize,
    },
    /// A vertex is infinite or not a number.
    #[error("vertex {index} is not finite")]
    NonFinite {
        /// Which vertex, from 0.
        index: usize,
    },
    /// A triangle has a corner that is none of the vertices.
    #[error("triangle {index} has a corner that is none of the {vertices} vertices")]
    NoSuchVertex {
        /// Which triangle, from 0.
        index: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// More vertices or triangles than are numbered.
    #[error("a mesh has at most {allowed} vertices and triangles")]
    TooLarge {
        /// The most that are allowed.
        allowed: usize,
    },
}

/// Why a cloud gives no surface.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// The cloud holds something that no surface can use.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// The mesh would be none.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// No triangle without three points.
    #[error("a surface needs at least 3 points, got {got}")]
    TooFewPoints {
        /// Points given.
        got: usize,
    },
    /// More points than are numbered.
    #[error("a surface has at most {allowed} points, got {got}: thin the cloud first")]
    TooManyPoints {
        /// The most that are allowed.
        allowed: usize,
        /// Points given.
        got: usize,
    },
    /// Some points lie beside or behind the sensor, seen from which the others lie in front.
    #[error(
        "{behind} of the {points} points are not in front of the sensor, so that they are not what it saw from there: \
         say where the sensor was"
    )]
    Surrounded {
        /// Points beside or behind the sensor.
        behind: usize,
        /// Points given.
        points: usize,
    },
    /// All points are seen on one line.
    #[error("the points, as the sensor sees them, lie on one line: there is no surface between them")]
    NoArea,
    /// Smoothing asks how well each point is known.
    #[error(
        "the cloud has no sigmas, by which smoothing weighs its points: mesh a cloud that has them, or don't smooth"
    )]
    NoSigmas,
    /// Every triangle was left out.
    #[error(
        "no triangle is left: {} span voids, {} what was not seen, {} stand along the line of sight or the light, {} lead across steps",
        cut.voids, cut.unseen, cut.grazing, cut.steps
    )]
    NothingLeft {
        /// Triangles by the reason that they were left out for.
        cut: crate::surface::Cut,
    },
}

/// Why a cloud was not moved onto a mesh.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegisterError {
    /// The cloud holds something that cannot be used.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// A pose has six unknowns.
    #[error("an alignment needs at least 6 points, got {got}")]
    TooFewPoints {
        /// Points given.
        got: usize,
    },
    /// All points lie in one spot.
    #[error("all points lie in one place")]
    OnePlace,
    /// Too few of the points come to lie on the mesh.
    #[error(
        "only {:.0} % of the points come to lie on the other surface, {:.0} % are needed: they do not overlap, or the search began too far off",
        100.0 * overlap, 100.0 * needed
    )]
    LittleOverlap {
        /// Share of the points that do.
        overlap: f64,
        /// Share that is needed.
        needed: f64,
    },
    /// The best pose leaves the points scattered about the mesh: it is another form, or the right pose was not found.
    #[error(
        "no pose fits: in the best one the points scatter by {scatter_mm:.3} mm about the other surface, {allowed_mm:.3} mm is accepted; where the \
         pose is about right already, begin from there"
    )]
    Scattered {
        /// What the residuals scatter by beyond the sigmas.
        scatter_mm: f64,
        /// What is accepted, by the cloud's size.
        allowed_mm: f64,
    },
}

/// Why a cloud was not compared with a reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// The cloud holds something that cannot be used.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// No triangle of the reference has an area.
    #[error("no triangle of the reference has an area")]
    NoArea,
    /// The cloud was not brought onto it.
    #[error("not aligned: {cause}; {hint}")]
    NotAligned {
        /// Why.
        cause: RegisterError,
        /// Sizes of both, and what they may be a sign of.
        hint: String,
    },
    /// Every point lies beyond the reference's border.
    #[error("none of the {points} points lies beside the reference, all are beyond its border")]
    NothingBeside {
        /// Points given.
        points: usize,
    },
}

/// Why clouds were not merged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MergeError {
    /// Nothing to merge with.
    #[error("merging takes at least 2 clouds, got {got}")]
    TooFew {
        /// Clouds given.
        got: usize,
    },
    /// A cloud that no surface goes through.
    #[error("cloud {} has no surface: {cause}", index + 1)]
    NoSurface {
        /// Which cloud, from 0.
        index: usize,
        /// Why.
        cause: SurfaceError,
    },
    /// A cloud holds something that cannot be used.
    #[error(transparent)]
    Register(#[from] RegisterError),
    /// A cloud of which nothing lies on the others.
    #[error(
        "no overlap of cloud {} with the others is found: {:.0} % of its points have to come to lie on the surface of one of them", index + 1,
        100.0 * needed
    )]
    NoOverlap {
        /// Which cloud, from 0.
        index: usize,
        /// Share that is needed.
        needed: f64,
    },
    /// A cloud that fits in several ways.
    #[error(
        "cloud {} fits the others in {poses} ways equally well: where its coordinates are about right already, say to within what", index + 1
    )]
    Ambiguous {
        /// Which cloud, from 0.
        index: usize,
        /// Poses that fit.
        poses: usize,
    },
    /// A cloud whose overlap leaves it free to move.
    #[error(
        "the overlap of cloud {} with the others does not determine {motions}: where its coordinates are about right already, say to within \
         what", index + 1
    )]
    Undetermined {
        /// Which cloud, from 0.
        index: usize,
        /// Motions that lose nothing.
        motions: String,
    },
}
