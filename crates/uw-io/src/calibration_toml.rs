//! The calibration file, `calibration.toml`: the instrument as estimated, its covariance, the rig and the captures that
//! it came from (FORMATS §3).
//!
//! Self-contained: all that comes after calibration needs no other file. Numbers are written with as many digits as tell
//! them apart, so a calibration reads back bit for bit; angles stand in degrees and read back within one unit in the last
//! place (1.2e-16 to 2.3e-16 of themselves), and bit for bit once they were read from a file.

mod check;
mod record;
mod statistics;

use std::path::Path;

use serde::{Deserialize, Serialize, Serializer};

use crate::{
    atomic::{self, Overwrite},
    capture::Medium,
    error::{Error, Place, Problem},
    rig::Rig,
    toml_file::{self, TomlFile},
};
use record::Record;

pub use statistics::{CorrelatedRecord, RejectedRecord, WorstRecord};

/// The `format` of a calibration file.
pub const FORMAT: &str = "uwscan-calibration";
/// The newest version of the calibration file that is read, and the one that is written.
pub const VERSION: u32 = 1;
/// The name and version of this software, for [`CalibrationFile::software`].
pub const SOFTWARE: &str = concat!("uwscan ", env!("CARGO_PKG_VERSION"));

/// All that a calibration file holds.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationFile {
    /// The instrument, how well it is known, and what remained; camera frame, millimetres, radians, pixels, volts.
    pub calibration: uw_calib::Calibration,
    /// The rig that the priors came from.
    pub rig: Rig,
    /// The captures that took part.
    pub captures: Vec<CaptureSource>,
    /// Name and version of the software that made it, such as [`SOFTWARE`].
    pub software: String,
}

/// A capture that a calibration came from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaptureSource {
    /// What the user calls it: its folder or recording.
    pub name: String,
    /// Hash of its content, 64 hexadecimal digits ([`crate::Capture::content_hash`]).
    pub sha256: String,
    /// What was outside the ports.
    #[serde(serialize_with = "medium_name")]
    pub medium: Medium,
}

fn medium_name<S: Serializer>(medium: &Medium, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(medium.name())
}

/// Something that a calibration can't be: the dotted key, what is wrong, and how to mend it.
struct Fault {
    key: String,
    what: String,
    mend: String,
}

impl Fault {
    fn new(key: impl Into<String>, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { key: key.into(), what: what.into(), mend: mend.into() }
    }
}

/// The calibration of a file, checked, with warnings about values of its rig that are possible but unlikely.
///
/// The standard deviations beside the figures are for people: what counts is the covariance.
///
/// # Errors
/// [`Error`] where the file cannot be read, is of another format or a later version, holds an unknown key, or what no
/// calibration holds: numbers that are not finite, axes that are not square to each other, a covariance that is none.
pub fn read(path: &Path) -> Result<(CalibrationFile, Vec<Problem>), Error> {
    checked(&TomlFile::read(path, FORMAT, VERSION)?)
}

/// The text of a calibration file, for who keeps it beside what [`parse`] reads in it.
///
/// # Errors
/// [`Error`] where the file cannot be read, or is no text.
pub fn text(path: &Path) -> Result<String, Error> {
    toml_file::text(path)
}

/// The calibration in a file's text, as [`read`]; `path` names it in errors.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, text: &str) -> Result<(CalibrationFile, Vec<Problem>), Error> {
    checked(&TomlFile::of_text(path, text.to_owned(), FORMAT, VERSION)?)
}

fn checked(file: &TomlFile) -> Result<(CalibrationFile, Vec<Problem>), Error> {
    let at_place = |fault: Fault| file.error(&fault.key, fault.what, fault.mend);
    check::finite("", &file.parse::<toml::Table>()?.into()).map_err(at_place)?;
    let mut record: Record = file.parse()?;
    let problems = record.rig.check(file, "rig.")?;
    check::record(&record).map_err(at_place)?;
    Ok((record.into_file().map_err(at_place)?, problems))
}

/// Writes a calibration file, whole or not at all.
///
/// # Errors
/// [`Error::Content`] for a calibration that [`read`] would refuse; else as [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, file: &CalibrationFile) -> Result<(), Error> {
    let refused = |fault: Fault| {
        let what = format!("the calibration can't be stored: {}", fault.what);
        Error::content(Place::file(path).key(&fault.key), what, fault.mend)
    };
    let text = to_toml(file).map_err(refused)?;
    atomic::write(path, overwrite, |out| out.write_all(text.as_bytes()))
}

/// What a section is about, written above it.
const COMMENTS: [(&str, &str); 8] = [
    ("[camera]", "Pixel (0, 0) is the centre of the top-left pixel. Distortion as OpenCV's."),
    (
        "[camera.port]",
        "The camera's window: distance from the optical centre to its inner face, along the normal.",
    ),
    (
        "[galvo]",
        "Camera frame: x right, y down, z forward. The axis's point is the closest to the optical centre.\n\
         # y_axis is z_axis x axis_direction. The mirror turns by d V + c2 V^2 + c3 V^3 degrees (the beam by twice as much), less the same at reference_v.",
    ),
    ("[laser]", "The fan's virtual apex at reference_v, in the galvanometer frame."),
    (
        "[laser.port]",
        "The laser's window: distance from the axis's point to its inner face; normal in the camera frame.",
    ),
    (
        "[water]",
        "What was added to the nominal index, at the laser's wavelength, and at the board's light besides.",
    ),
    ("[statistics]", "What remained, and how many took part."),
    ("[rig.camera]", "From here to the priors, the rig file: drawing values, not estimates."),
];

fn to_toml(file: &CalibrationFile) -> Result<String, Fault> {
    let unwritable = |e: toml::ser::Error| Fault::new("", e.to_string(), "report this");
    let mut record = Record::from_file(file);
    check::finite("", &toml::Value::try_from(&record).map_err(unwritable)?)?;
    check::record(&record)?;
    record.clone().into_file()?;
    let covariance = record.covariance.take();
    let warnings = std::mem::take(&mut record.warnings);
    let body = toml::to_string(&record).map_err(unwritable)?;
    let (top, sections) = body.split_once("\n\n").unwrap_or((&body, ""));
    let mut text = format!("format = \"{FORMAT}\"\nversion = {VERSION}\n{top}\n");
    if !warnings.is_empty() {
        list(&mut text, "warnings", warnings.into_iter().map(|said| toml::Value::from(said).to_string()));
    }
    text.push('\n');
    for line in sections.lines() {
        if let Some((_, comment)) = COMMENTS.iter().find(|(header, _)| *header == line) {
            text += &format!("# {comment}\n");
        }
        text += line;
        text.push('\n');
    }
    if let Some(covariance) = covariance {
        text += "\n# Of small changes of the instrument; tilts about two directions square to a window's normal, turns and\n\
                 # moves in the galvanometer frame. A row and a column for each name.\n[covariance]\n";
        list(&mut text, "names", covariance.names.iter().map(|name| format!("\"{name}\"")));
        list(&mut text, "rows", covariance.rows.iter().map(|row| format!("{row:?}")));
    }
    Ok(text)
}

/// An array with a line for each element.
fn list(text: &mut String, key: &str, elements: impl Iterator<Item = String>) {
    *text += &format!("{key} = [\n");
    for element in elements {
        *text += &format!("    {element},\n");
    }
    *text += "]\n";
}
