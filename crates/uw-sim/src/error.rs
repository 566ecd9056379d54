use uw_geom::GeomError;

/// Why a scene or an instrument can't be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// A figure that no scene or instrument has.
    #[error("{what} must be {needed}, got {got}")]
    Invalid {
        /// Which figure.
        what: &'static str,
        /// What is needed of it.
        needed: &'static str,
        /// What was given.
        got: f64,
    },
    /// A mesh whose triangles name vertices that it has not.
    #[error("triangle {triangle} names vertex {vertex}, the mesh has {vertices}")]
    Mesh {
        /// 0-based number of the triangle.
        triangle: usize,
        /// The vertex that it names.
        vertex: usize,
        /// How many there are.
        vertices: usize,
    },
    /// One of the scene's objects can't be.
    #[error("object \"{object}\": {source}")]
    Object {
        /// Its name.
        object: String,
        /// What is wrong with it.
        source: Box<SimError>,
    },
    /// The instrument's model can't be evaluated: a fan that does not leave through its window, and the like.
    #[error(transparent)]
    Geometry(#[from] GeomError),
}

/// `value`, if it lies in `range`.
pub(crate) fn within(
    what: &'static str,
    needed: &'static str,
    range: std::ops::RangeInclusive<f64>,
    value: f64,
) -> Result<f64, SimError> {
    // NaN is in no range.
    if range.contains(&value) { Ok(value) } else { Err(SimError::Invalid { what, needed, got: value }) }
}
