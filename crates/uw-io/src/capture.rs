//! A capture: images of a target or of a scene, each with its voltage, in a folder or in a recording.

mod folder;
mod recorded;

mod write;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::{
    error::{Error, Place, Problem},
    images::{self, Expect, GrayImage, Reduce, Stored},
    recording::{Head, Other, Topic, reader::Recording},
    rig::Rig,
    toml_file::exactly,
};

pub use write::{capture_text, frames_text};

/// The `format` of a capture.
pub const FORMAT: &str = "uwscan-capture";
/// The newest version of a capture that is read.
pub const VERSION: u32 = 1;

/// What a capture is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Placements of a target, each without the laser and with stripes on it.
    Calibration,
    /// A sweep over a scene.
    Scan,
}

impl Kind {
    /// The kind's name as files carry it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Scan => "scan",
        }
    }

    /// The kind of this name; `None` where there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Calibration, Self::Scan].into_iter().find(|kind| kind.name() == name)
    }
}

/// What is outside the ports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Medium {
    /// On land.
    Air,
    /// Submerged.
    Water,
}

impl Medium {
    /// The medium's name as files carry it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Air => "air",
            Self::Water => "water",
        }
    }

    /// The medium of this name; `None` where there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Air, Self::Water].into_iter().find(|medium| medium.name() == name)
    }
}

/// The kind of target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pattern {
    /// Squares of two colours.
    Chessboard,
}

/// The calibration's target.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// What is on it.
    pub pattern: Pattern,
    /// Inner corners along a row, and along a column.
    #[serde(deserialize_with = "exactly")]
    pub inner_corners: [u32; 2],
    /// Side of a square.
    pub square_mm: f64,
    /// Wavelength of the light on the board; `None`: the laser's, and one index of water serves both.
    pub wavelength_nm: Option<f64>,
}

/// One image of a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameRecord {
    /// 0-based data row of frames.csv, or number in the recording: the `frame` of a point.
    pub row: usize,
    /// 1-based line of frames.csv, for messages; 0 in a recording.
    pub line: u32,
    /// Path of the image as frames.csv gives it, relative to the capture folder; in a recording, what it would be in one.
    pub file: String,
    /// Which placement of the target the image shows; `None` in a scan.
    pub pose: Option<u32>,
    /// Whether the laser was on.
    pub laser_on: bool,
    /// The galvanometer's voltage, finite; `None` exactly where the laser is off.
    pub voltage_v: Option<f64>,
    /// Start of the exposure, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
}

/// Where the images are.
#[derive(Debug)]
enum Source {
    Folder,
    Recording(Box<Recording>),
}

/// A capture folder or a recording, checked as far as that goes without decoding an image.
#[derive(Debug)]
#[non_exhaustive]
pub struct Capture {
    /// The folder, or the recording's file.
    pub path: PathBuf,
    /// What it is for.
    pub kind: Kind,
    /// What is outside the ports.
    pub medium: Medium,
    /// The target; `Some` exactly in a calibration.
    pub target: Option<Target>,
    /// The images in the order of capture, one a data row; those that are missing too (see [`Capture::problems`]).
    pub frames: Vec<FrameRecord>,
    /// The capture's own rig; `None` where it has none.
    pub rig: Option<Rig>,
    problems: Vec<Problem>,
    missing: BTreeSet<usize>,
    source: Source,
}

impl Capture {
    /// The capture in a folder or a recording, with its own rig if it has one.
    ///
    /// # Errors
    /// [`Error`] where there is no capture, or one of its text files is wrong. An image that is missing, and what a recording
    /// that was cut off lacks, is no error but a [`Problem`], unless all is missing.
    pub fn open(path: &Path) -> Result<Self, Error> {
        Self::open_with_rig(path, None)
    }

    /// The capture in a folder or a recording, with the rig of another file, which replaces its own rig.toml whole: that one is
    /// not even read.
    ///
    /// # Errors
    /// As [`Capture::open`], and where the rig file is wrong.
    pub fn open_with_rig(path: &Path, rig: Option<&Path>) -> Result<Self, Error> {
        Self::open_noting(path, rig, &mut Vec::new())
    }

    /// As [`Capture::open_with_rig`]; where it fails, what was warned of before is added to `noted`.
    ///
    /// # Errors
    /// As [`Capture::open_with_rig`].
    pub fn open_noting(path: &Path, rig: Option<&Path>, noted: &mut Vec<Problem>) -> Result<Self, Error> {
        let mut warnings = Vec::new();
        let folder = fs::metadata(path).map_err(Error::file(path, "open the capture"))?.is_dir();
        let opened = match folder {
            true => Self::of_folder(path, rig, &mut warnings),
            false => Self::of_recording(path, rig, &mut warnings),
        };
        match opened {
            Ok(mut capture) => {
                capture.problems.splice(..0, warnings);
                Ok(capture)
            }
            Err(error) => {
                noted.append(&mut warnings);
                Err(error)
            }
        }
    }

    /// What a recording says of itself; `None` for a folder.
    pub fn head(&self) -> Option<&Head> {
        match &self.source {
            Source::Folder => None,
            Source::Recording(recording) => Some(&recording.head),
        }
    }

    /// What there is of each of a recording's topics, by their names; empty for a folder.
    pub fn topics(&self) -> impl Iterator<Item = (&str, &Topic)> {
        let topics = match &self.source {
            Source::Folder => None,
            Source::Recording(recording) => Some(&recording.topics),
        };
        topics.into_iter().flatten().map(|(name, topic)| (name.as_str(), topic))
    }

    /// Shows every message of a recording that is neither an image nor its row.
    pub(crate) fn others(&self, visit: &mut dyn FnMut(Other<'_>) -> Result<(), Error>) -> Result<(), Error> {
        match &self.source {
            Source::Folder => Ok(()),
            Source::Recording(recording) => recording.others(visit),
        }
    }

    /// The image of a frame as it is stored: a file's bytes, or values.
    pub(crate) fn stored(&self, frame: &FrameRecord) -> Result<Stored, Error> {
        let path = self.image_path(frame);
        match &self.source {
            Source::Folder => images::stored(&path),
            Source::Recording(recording) => recording.stored(frame.row, &path),
        }
    }

    /// What is wrong but can be gone on with: warnings, and images that are lost.
    pub fn problems(&self) -> &[Problem] {
        &self.problems
    }

    /// What [`Capture::problems`] shows, to keep: the capture has none afterwards.
    pub fn take_problems(&mut self) -> Vec<Problem> {
        std::mem::take(&mut self.problems)
    }

    /// The frames whose image is there, in the order of capture.
    pub fn present(&self) -> impl Iterator<Item = &FrameRecord> {
        self.frames.iter().filter(|f| !self.missing.contains(&f.row))
    }

    /// What a frame's image is called in messages: its path, also where it is in a recording.
    pub fn image_path(&self, frame: &FrameRecord) -> PathBuf {
        self.path.join(&frame.file)
    }

    /// The image of a frame in one channel, held against what is known of its camera where that is given; decoded on the
    /// thread that calls.
    ///
    /// # Errors
    /// As [`images::read`], and [`Error::Image`] where a recording's image is damaged.
    pub fn image(
        &self,
        frame: &FrameRecord,
        reduce: Reduce,
        expect: Option<Expect>,
    ) -> Result<GrayImage, Error> {
        let path = self.image_path(frame);
        match &self.source {
            Source::Folder => images::read(&path, reduce, expect),
            Source::Recording(recording) => recording.image(frame.row, &path, reduce, expect),
        }
    }

    /// SHA-256, in hexadecimal, of all that the capture says. Of a folder: capture.toml, frames.csv, its own rig.toml if
    /// it has one, and every image's bytes in the order of frames.csv, each with its name and its length, or with
    /// its absence; neither the folder's own name nor a file that frames.csv doesn't name counts. Of a recording: its bytes.
    ///
    /// # Errors
    /// [`Error::File`] where a file cannot be read.
    pub fn content_hash(&self) -> Result<String, Error> {
        match &self.source {
            Source::Folder => self.folder_hash(),
            Source::Recording(_) => file_hash(&self.path),
        }
    }

    /// Where a frame's row is, for messages.
    fn place(&self, frame: &FrameRecord, column: &str) -> Place {
        match &self.source {
            Source::Folder => Place::line(&self.path.join("frames.csv"), frame.line).key(column),
            Source::Recording(_) => {
                Place::file(&self.path).key(&format!("frame {}", frame.row)).key_below(column)
            }
        }
    }

    /// Warns of placements whose stripes have no image of the target.
    fn check_poses(&mut self) {
        let mut first = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for frame in &self.frames {
            match frame.pose {
                Some(pose) if frame.laser_on => _ = first.entry(pose).or_insert(frame),
                Some(pose) if !self.missing.contains(&frame.row) => _ = seen.insert(pose),
                _ => {}
            }
        }
        let unseen = first.into_iter().filter(|(pose, _)| !seen.contains(pose));
        let warnings: Vec<Problem> = unseen
            .map(|(pose, frame)| {
                let what = format!("pose {pose} has stripes but no image of the target (laser off)");
                let mend = "its stripes can't be used; add that image";
                Problem::warning(self.place(frame, "pose"), what, mend)
            })
            .collect();
        self.problems.extend(warnings);
    }

    /// Warns of voltages that the rig's galvanometer doesn't reach.
    fn check_voltages(&mut self) {
        let Some(rig) = &self.rig else { return };
        let [low, high] = rig.galvo.range_v;
        let mut outside =
            self.frames.iter().filter(|f| f.voltage_v.is_some_and(|v| !(low..=high).contains(&v)));
        let Some(first) = outside.next() else { return };
        let what = format!(
            "{} V is outside the galvanometer's range_v [{low}, {high}] ({} such rows)",
            first.voltage_v.unwrap_or_default(),
            1 + outside.count()
        );
        let place = self.place(first, "voltage_v");
        self.problems.push(Problem::warning(place, what, "check the unit, and range_v in rig.toml"));
    }
}

/// Adds all that a file holds; its length.
fn feed(hash: &mut Sha256, file: &mut File, path: &Path) -> Result<u64, Error> {
    let mut buffer = vec![0; 1 << 18];
    let mut length = 0_u64;
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok(length),
            Ok(read) => {
                length += read as u64;
                hash.update(&buffer[..read]);
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(Error::file(path, "read")(e)),
        }
    }
}

/// The SHA-256 of a file's bytes, hexadecimal.
///
/// # Errors
/// [`Error::File`] where it can't be read.
pub fn file_hash(path: &Path) -> Result<String, Error> {
    let mut hash = Sha256::new();
    let mut file = File::open(path).map_err(Error::file(path, "open"))?;
    feed(&mut hash, &mut file, path)?;
    Ok(hexadecimal(hash))
}

fn hexadecimal(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// More corners than this are a slip of typing, and a list of them would not fit.
const MOST_CORNERS: u32 = 1000;

impl Target {
    /// Refuses what no target is: the key, what is wrong, and how to mend it.
    pub(crate) fn check(&self) -> Result<(), (&'static str, String, &'static str)> {
        let [columns, rows] = self.inner_corners;
        if [columns, rows].iter().any(|n| !(3..=MOST_CORNERS).contains(n)) {
            let what = format!("a chessboard of {columns} x {rows} inner corners can't be used");
            let mend =
                "count the corners where four squares meet, along a row and along a column: at least 3 each";
            return Err(("target.inner_corners", what, mend));
        }
        if !(self.square_mm > 0.0 && self.square_mm.is_finite()) {
            let what = format!("{} is no square's side", self.square_mm);
            return Err(("target.square_mm", what, "give the side of a square in mm"));
        }
        if let Some(nm) = self.wavelength_nm.filter(|nm| !(200.0..=2000.0).contains(nm)) {
            let what = format!("{nm} is no wavelength of light");
            return Err(("target.wavelength_nm", what, "give it in nanometres, such as 550.0"));
        }
        Ok(())
    }
}
