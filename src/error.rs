use std::collections::BTreeMap;
use std::path::PathBuf;
use uw_calib::{CalibError, Rejected};
use uw_io::{NewFolder, Problem};
use uw_stripe::StripeError;

/// Why a job has no result, and what had been noticed by then, which may well be the cause.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct Failure {
    /// What stopped it.
    #[source]
    pub error: Box<Error>,
    /// All else that was noticed.
    pub notes: Notes,
}

impl Failure {
    /// The same, files in a folder that was being filled by the names that they would have had in place.
    pub fn told_by(self, folder: &NewFolder) -> Self {
        let error = Box::new(self.error.told_by(folder));
        Self { error, ..self }
    }
}

/// What a job notices besides its result.
#[derive(Debug, Default)]
pub struct Notes {
    /// Warnings about the files, and losses.
    pub problems: Vec<Problem>,
    /// What to know before trusting the result.
    pub warnings: Vec<String>,
    /// Images that tests of quality left out.
    pub rejected: Vec<Rejected>,
}

/// Why a stage of the pipeline has no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file can't be read or written, or does not say what it must.
    #[error(transparent)]
    File(#[from] uw_io::Error),
    /// A device does not do what a scan needs.
    #[error(transparent)]
    Instrument(#[from] uw_hw::Fault),
    /// The disk has less room than is to be left there.
    #[error(
        "{}: {:.0} MB are free on this disk, and disk.min_free_mb of the vehicle file leaves {:.0} MB there: free some space, or \
         lower it", path.display(), *free_bytes as f64 * 1e-6, *needed_bytes as f64 * 1e-6
    )]
    NoRoom {
        /// What was to be written.
        path: PathBuf,
        /// Bytes that are free.
        free_bytes: u64,
        /// Bytes that have to be.
        needed_bytes: u64,
    },
    /// There is nothing to scan.
    #[error(transparent)]
    Plan(#[from] crate::pipeline::record::plan::PlanError),
    /// The captures determine no calibration.
    #[error("calibration: {0}")]
    Calibration(#[from] CalibError),
    /// The stripe of an image can't be extracted.
    #[error("{}: stripe extraction: {source}", path.display())]
    Stripe {
        /// The image.
        path: PathBuf,
        /// What is wrong.
        source: StripeError,
    },
    /// A capture is not of the kind that a command needs.
    #[error("{}: this capture is a {got}, a {needed} is needed here", path.display())]
    Kind {
        /// The capture.
        path: PathBuf,
        /// What is needed.
        needed: &'static str,
        /// What it is.
        got: &'static str,
    },
    /// A capture holds no target to calibrate with, or a wrong one.
    #[error("{}: target: {source}", path.display())]
    Board {
        /// The capture.
        path: PathBuf,
        /// What is wrong with it.
        source: uw_calib::BoardError,
    },
    /// The declared board is nowhere seen whole.
    #[error("{}: {reason}", path.display())]
    BoardNotSeen {
        /// The capture.
        path: PathBuf,
        /// What was seen instead.
        reason: String,
    },
    /// Nothing is known of the instrument.
    #[error("{}: there is no rig.toml in the capture: give one with --rig FILE", path.display())]
    NoRig {
        /// The capture.
        path: PathBuf,
    },
    /// The water's index is not known.
    #[error(
        "{}: captured in water, but nothing says its index: give [water] in rig.toml, or --water-index, \
         or --temperature, --salinity and --depth", path.display()
    )]
    NoWaterIndex {
        /// The capture.
        path: PathBuf,
    },
    /// Captures of different cameras can't be calibrated together.
    #[error("{}: images of {} x {} px by its rig file, the other captures' have {} x {}: calibrate one camera at a time", path.display(), got[0], got[1], needed[0], needed[1])]
    ImageSize {
        /// The capture.
        path: PathBuf,
        /// The others' size.
        needed: [u32; 2],
        /// Its size.
        got: [u32; 2],
    },
    /// Exact refraction needs what the paper's method does not estimate.
    #[error(
        "the calibration was made by the paper's method, which neglects the windows: reconstruct with --refraction paper, \
         or calibrate with --method joint"
    )]
    PaperCalibration,
    /// A scan without a stripe.
    #[error("{}: no image has the laser on: a scan's stripes are in such images (column laser of frames.csv)", path.display())]
    LaserOff {
        /// The capture.
        path: PathBuf,
    },
    /// No image gave a point.
    #[error("{}: no point came out of {frames} images with the laser on; rows or columns by what they lack: {}", path.display(), counts(rejected))]
    NoPoint {
        /// The capture.
        path: PathBuf,
        /// Images looked at.
        frames: usize,
        /// Rows or columns without a point, by reason.
        rejected: BTreeMap<&'static str, usize>,
    },
    /// An instrument or scene that can't be simulated.
    #[error("simulation: {0}")]
    Simulation(uw_sim::SimError),
    /// A cloud holds no such shape.
    #[error("{0}")]
    Fit(uw_cloud::FitError),
    /// Shapes can't be looked for in a cloud.
    #[error("{}: {source}", path.display())]
    Shapes {
        /// The cloud or capture.
        path: PathBuf,
        /// What is wrong.
        source: uw_cloud::FitError,
    },
    /// A cloud has no surface.
    #[error("{}: {source}", path.display())]
    Surface {
        /// The cloud or capture.
        path: PathBuf,
        /// What is wrong.
        source: uw_cloud::SurfaceError,
    },
    /// A scan can't be held against a reference.
    #[error("{}: reference: {what}", path.display())]
    Reference {
        /// The reference.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// A mesh was given where a cloud is needed.
    #[error("{}: this is a mesh, and scans are clouds or captures: give it with --reference to hold scans against it", path.display())]
    MeshForCloud {
        /// The mesh.
        path: PathBuf,
    },
    /// A capture can't become points without a calibration.
    #[error("{}: a capture needs the calibration of its instrument: give it with -c calibration.toml", path.display())]
    CalibrationNeeded {
        /// The capture.
        path: PathBuf,
    },
    /// A page's name would be that of what is written beside it, or no page's.
    #[error("{}: a report's name ends in .html; figures go beside it into files ending in .json and .csv", path.display())]
    PageName {
        /// The page.
        path: PathBuf,
    },
    /// A file beside a page would replace what the page is made from.
    #[error("{}: is an input, and figures beside the report would go into a file of this name: give the report another name", path.display())]
    OwnInput {
        /// The input.
        path: PathBuf,
    },
    /// A plot can't be drawn.
    #[error(transparent)]
    Plot(uw_report::PlotError),
    /// A scene file asks for what can't be simulated.
    #[error("{}: {source}", path.display())]
    SceneFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<Error>,
    },
    /// A scene in water whose index nothing says.
    #[error("the scene is in water, but its rig file does not say the water's index: add [water] there")]
    SceneWithoutIndex,
    /// A thing of a scene that there can't be.
    #[error("object \"{object}\": {what}")]
    Scene {
        /// Its name.
        object: String,
        /// What is wrong with it.
        what: String,
    },
    /// All images that a stage needs are lost.
    #[error("{}: none of its images could be used; the first: {first}", path.display())]
    NothingLeft {
        /// The capture.
        path: PathBuf,
        /// What is wrong with the first of them, with the mend.
        first: Box<uw_io::Error>,
    },
    /// Nothing is known of a calibration's errors.
    #[error(
        "the calibration has no covariance, as the paper's method gives none: calibrate with --method joint"
    )]
    NoCovariance,
    /// A cloud does not tell what its points were made of.
    #[error(
        "the points have no pixels (u, v) and frames: a calibration's part of the uncertainty needs the PLY file that reconstruct wrote"
    )]
    NoPixels,
    /// A cloud was not made with a calibration, or not by exact refraction.
    #[error(
        "the points lie {miss_mm:.3} mm off where this calibration puts their pixels: give the calibration that the cloud was \
         reconstructed with, with --refraction exact"
    )]
    OtherCalibration {
        /// How far, mm.
        miss_mm: f64,
    },
    /// A folder without recordings.
    #[error("{}: there is no recording in it: capture folders (with capture.toml) and files that end in .mcap are looked for, in its folders too", path.display())]
    NoRecording {
        /// The folder.
        path: PathBuf,
    },
    /// The work was given up because [`crate::pipeline::Progress::cancelled`] said so.
    #[error("given up before the end, as asked")]
    Cancelled,
    /// A capture was given twice: its measurements would count as twice as many.
    #[error("{}: the same capture as {}: give each once", path.display(), other.display())]
    Twice {
        /// The capture.
        path: PathBuf,
        /// The one that it equals.
        other: PathBuf,
    },
}

impl Error {
    /// The same, a file in a folder that was being filled by the name that it would have had in place.
    pub fn told_by(self, folder: &NewFolder) -> Self {
        match self {
            Self::File(error) => Self::File(folder.told(error)),
            other => other,
        }
    }
}

/// The counts that are not zero, the largest first, and what the less obvious mean.
fn counts(rejected: &BTreeMap<&'static str, usize>) -> String {
    let mut counts: Vec<_> = rejected.iter().filter(|(_, count)| **count > 0).collect();
    counts.sort_by_key(|(reason, count)| (std::cmp::Reverse(**count), **reason));
    let said: Vec<String> = counts
        .into_iter()
        .map(|(reason, count)| match *reason {
            "no_signal" => format!("{count} no_signal (no stripe)"),
            "no_intersection" => format!(
                "{count} no_intersection (a stripe, but its ray misses the laser's sheet: check voltages, calibration and medium)"
            ),
            _ => format!("{count} {reason}"),
        })
        .collect();
    if said.is_empty() { "none".to_owned() } else { said.join(", ") }
}
