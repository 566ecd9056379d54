//! A capture folder: images of a target or of a scene, each with its voltage.

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
    frames,
    rig::Rig,
    toml_file::{TomlFile, exactly},
};

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
    /// 0-based data row of frames.csv: the `frame` of a point.
    pub row: usize,
    /// 1-based line of frames.csv, for messages.
    pub line: u32,
    /// Path of the image as frames.csv gives it, relative to the capture folder.
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

/// A capture folder, checked as far as that goes without decoding an image.
#[derive(Debug)]
#[non_exhaustive]
pub struct Capture {
    /// The folder.
    pub dir: PathBuf,
    /// What it is for.
    pub kind: Kind,
    /// What is outside the ports.
    pub medium: Medium,
    /// The target; `Some` exactly in a calibration.
    pub target: Option<Target>,
    /// The images in the order of capture, one a data row; those that are missing too (see [`Capture::problems`]).
    pub frames: Vec<FrameRecord>,
    /// The capture's own rig; `None` where it has no rig.toml.
    pub rig: Option<Rig>,
    problems: Vec<Problem>,
    missing: BTreeSet<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaptureRecord {
    kind: Kind,
    medium: Medium,
    target: Option<Target>,
}

impl Capture {
    /// The capture in folder `dir` with its own rig.toml, if it has one.
    ///
    /// # Errors
    /// [`Error`] where the folder holds no capture, or one of its text files is wrong. An image that is missing is
    /// no error but a [`Problem`], unless all are.
    pub fn open(dir: &Path) -> Result<Self, Error> {
        Self::open_with_rig(dir, None)
    }

    /// The capture in folder `dir` with the rig of another file, which replaces its own rig.toml whole: that one is
    /// not even read.
    ///
    /// # Errors
    /// As [`Capture::open`], and where the rig file is wrong.
    pub fn open_with_rig(dir: &Path, rig: Option<&Path>) -> Result<Self, Error> {
        Self::open_noting(dir, rig, &mut Vec::new())
    }

    /// As [`Capture::open_with_rig`]; where it fails, what was warned of before is added to `noted`.
    ///
    /// # Errors
    /// As [`Capture::open_with_rig`].
    pub fn open_noting(dir: &Path, rig: Option<&Path>, noted: &mut Vec<Problem>) -> Result<Self, Error> {
        let mut warnings = Vec::new();
        match Self::checked(dir, rig, &mut warnings) {
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

    /// The capture, with the problems of its images; what is odd in its text files goes to `problems`.
    fn checked(dir: &Path, rig: Option<&Path>, problems: &mut Vec<Problem>) -> Result<Self, Error> {
        let meta = fs::metadata(dir).map_err(Error::file(dir, "open the capture folder"))?;
        if !meta.is_dir() {
            let what = "is a file, not a capture folder";
            return Err(Error::content(Place::file(dir), what, "give the folder that holds capture.toml"));
        }
        let file = TomlFile::read(&dir.join("capture.toml"), FORMAT, VERSION)?;
        let CaptureRecord { kind, medium, mut target } = file.parse()?;
        match (kind, &target) {
            (Kind::Calibration, None) => {
                let mend = "add pattern, inner_corners and square_mm";
                return Err(file.error("target", "a calibration needs its target", mend));
            }
            (Kind::Calibration, Some(t)) => check_target(&file, t)?,
            (Kind::Scan, Some(_)) => {
                problems.push(file.warning(
                    "target",
                    "a scan has no target: it is ignored",
                    "remove [target]",
                ));
                target = None;
            }
            (Kind::Scan, None) => {}
        }
        let own_rig = dir.join("rig.toml");
        let rig = match rig {
            Some(path) => Some(Rig::read(path)?),
            // A link that leads nowhere is an error of opening, not the absence of a rig.
            None => own_rig.symlink_metadata().is_ok().then(|| Rig::read(&own_rig)).transpose()?,
        };
        let rig = rig.map(|(rig, warnings)| {
            problems.extend(warnings);
            rig
        });
        let (frames, warnings) = frames::read(&dir.join("frames.csv"), kind)?;
        problems.extend(warnings);
        let mut capture = Self {
            dir: dir.to_owned(),
            kind,
            medium,
            target,
            frames,
            rig,
            problems: Vec::new(),
            missing: BTreeSet::new(),
        };
        capture.check_images()?;
        capture.check_poses();
        if let Some(rig) = &capture.rig {
            let warnings = capture.check_voltages(rig);
            capture.problems.extend(warnings);
        }
        Ok(capture)
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

    /// The path of a frame's image.
    pub fn image_path(&self, frame: &FrameRecord) -> PathBuf {
        self.dir.join(&frame.file)
    }

    /// SHA-256, in hexadecimal, of all that the capture folder says: capture.toml, frames.csv, its own rig.toml if
    /// it has one, and every image's bytes in the order of frames.csv, each with its name and its length, or with
    /// its absence. Neither the folder's own name nor a file that frames.csv doesn't name counts.
    ///
    /// # Errors
    /// [`Error::File`] where a file cannot be read.
    pub fn content_hash(&self) -> Result<String, Error> {
        let mut hash = Sha256::new();
        let mut buffer = vec![0; 1 << 18];
        let names = ["capture.toml", "frames.csv", "rig.toml"].into_iter();
        for name in names.chain(self.frames.iter().map(|f| f.file.as_str())) {
            let path = self.dir.join(name);
            hash.update((name.len() as u64).to_le_bytes());
            hash.update(name.as_bytes());
            let mut file = match File::open(&path) {
                Ok(file) if file.metadata().is_ok_and(|m| m.is_file()) => file,
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(Error::file(&path, "open")(e)),
                _ => {
                    hash.update([0]);
                    continue;
                }
            };
            hash.update([1]);
            let mut length = 0_u64;
            loop {
                let read = match file.read(&mut buffer) {
                    Ok(0) => break,
                    Ok(read) => read,
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
                    Err(e) => return Err(Error::file(&path, "read")(e)),
                };
                length += read as u64;
                hash.update(&buffer[..read]);
            }
            hash.update(length.to_le_bytes());
        }
        Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }

    /// Finds the images that are missing, and refuses those outside the folder.
    fn check_images(&mut self) -> Result<(), Error> {
        let csv = self.dir.join("frames.csv");
        let root = self.dir.canonicalize().map_err(Error::file(&self.dir, "find the capture folder"))?;
        for frame in &self.frames {
            let path = self.dir.join(&frame.file);
            let error = match path.canonicalize() {
                Ok(real) if !real.starts_with(&root) => {
                    let what = format!("{} leads out of the capture folder by a symbolic link", frame.file);
                    let place = Place::line(&csv, frame.line).key("file");
                    return Err(Error::content(place, what, "put the image itself into the folder"));
                }
                Ok(real) if real.is_file() => continue,
                Ok(other) => {
                    let what = if other.is_dir() {
                        "is a folder, not an image"
                    } else {
                        "is no file that holds an image"
                    };
                    Error::image(&path, what, format!("mend line {} of frames.csv", frame.line))
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound && frame.file.contains('\\') => {
                    Error::image(&path, "is missing", "write / between folders, not \\, in frames.csv")
                }
                Err(e) if e.kind() == io::ErrorKind::NotFound => {
                    let mend = format!("put it back, or remove line {} of frames.csv", frame.line);
                    Error::image(&path, "is missing", mend)
                }
                Err(e) => Error::file(&path, "find the image")(e),
            };
            self.missing.insert(frame.row);
            self.problems.push(Problem::loss(frame.row, error));
        }
        if self.missing.len() == self.frames.len() {
            let what = format!("none of its {} images is there", self.frames.len());
            let mend = "check that the images were copied with it, and the paths in frames.csv";
            return Err(Error::content(Place::file(&csv), what, mend));
        }
        Ok(())
    }

    /// Warns of placements whose stripes have no image of the target.
    fn check_poses(&mut self) {
        let mut first_line = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for frame in &self.frames {
            match frame.pose {
                Some(pose) if frame.laser_on => _ = first_line.entry(pose).or_insert(frame.line),
                Some(pose) if !self.missing.contains(&frame.row) => _ = seen.insert(pose),
                _ => {}
            }
        }
        for (pose, line) in first_line.into_iter().filter(|(pose, _)| !seen.contains(pose)) {
            let place = Place::line(&self.dir.join("frames.csv"), line).key("pose");
            let what = format!("pose {pose} has stripes but no image of the target (laser off)");
            self.problems.push(Problem::warning(place, what, "its stripes can't be used; add that image"));
        }
    }

    /// Warnings about voltages that the rig's galvanometer doesn't reach.
    fn check_voltages(&self, rig: &Rig) -> Option<Problem> {
        let [low, high] = rig.galvo.range_v;
        let mut outside =
            self.frames.iter().filter(|f| f.voltage_v.is_some_and(|v| !(low..=high).contains(&v)));
        let first = outside.next()?;
        let place = Place::line(&self.dir.join("frames.csv"), first.line).key("voltage_v");
        let what = format!(
            "{} V is outside the galvanometer's range_v [{low}, {high}] ({} such rows)",
            first.voltage_v.unwrap_or_default(),
            1 + outside.count()
        );
        Some(Problem::warning(place, what, "check the unit, and range_v in rig.toml"))
    }
}

/// More corners than this are a slip of typing, and a list of them would not fit.
const MOST_CORNERS: u32 = 1000;

fn check_target(file: &TomlFile, target: &Target) -> Result<(), Error> {
    let [columns, rows] = target.inner_corners;
    if [columns, rows].iter().any(|n| !(3..=MOST_CORNERS).contains(n)) {
        let what = format!("a chessboard of {columns} x {rows} inner corners can't be used");
        let mend =
            "count the corners where four squares meet, along a row and along a column: at least 3 each";
        return Err(file.error("target.inner_corners", what, mend));
    }
    if !(target.square_mm > 0.0 && target.square_mm.is_finite()) {
        let what = format!("{} is no square's side", target.square_mm);
        return Err(file.error("target.square_mm", what, "give the side of a square in mm"));
    }
    if let Some(nm) = target.wavelength_nm.filter(|nm| !(200.0..=2000.0).contains(nm)) {
        let what = format!("{nm} is no wavelength of light");
        return Err(file.error("target.wavelength_nm", what, "give it in nanometres, such as 550.0"));
    }
    Ok(())
}
