use crate::lm::LmError;

/// Why there is no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibError {
    /// Too few placements of the board.
    #[error(
        "{got} usable placements of the board, at least {needed} are needed: capture more, tilted to all sides"
    )]
    TooFewPoses {
        /// At least.
        needed: usize,
        /// Usable ones.
        got: usize,
    },
    /// All boards stand parallel: focal length and distance can't be told apart.
    #[error(
        "all boards stand within {spread_deg:.1}° of each other, which leaves the focal length open: \
         capture poses tilted by 20° and more to different sides"
    )]
    ParallelBoards {
        /// Largest angle between two boards.
        spread_deg: f64,
    },
    /// The mirror's axis is not determined.
    #[error(
        "the laser was seen on at least two boards at only {got} voltages, {needed} are needed to find the mirror's axis: \
         capture more voltages, each on boards at different distances"
    )]
    TooFewVoltages {
        /// At least.
        needed: usize,
        /// Usable ones.
        got: usize,
    },
    /// A corner's pixel has no ray: start values or data are far off.
    #[error("{file}: the board's pose can't be found from its corners; is the rig file that of this camera?")]
    Pose {
        /// The board's image.
        file: String,
    },
    /// The laser's planes do not turn with the voltage as the rig file says.
    #[error(
        "the laser turns {got_deg_per_v:.3}° (mechanical) per volt, the rig file says {expected_deg_per_v:.3}: \
         are the voltages in frames.csv those of these images?"
    )]
    Gain {
        /// As the planes have it.
        got_deg_per_v: f64,
        /// As the rig file has it.
        expected_deg_per_v: f64,
    },
    /// The rig file describes no instrument.
    #[error("the rig file describes no instrument: {0}")]
    Rig(#[from] uw_geom::GeomError),
    /// The adjustment has no solution.
    #[error("the adjustment has no solution: {0}")]
    Adjustment(#[from] LmError),
    /// The adjustment came to no end.
    #[error("the adjustment did not converge in {iterations} iterations; the worst image is {worst_file}")]
    NotConverged {
        /// Iterations made.
        iterations: usize,
        /// The image with the largest residuals.
        worst_file: String,
    },
}
