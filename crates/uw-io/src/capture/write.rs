//! The text files of a capture folder, as [`super::Capture`] reads them.

use std::path::Path;

use super::{FORMAT, FrameRecord, Kind, Medium, Target, VERSION};
use crate::error::{Error, Place};

/// The text of capture.toml.
pub fn capture_text(kind: Kind, medium: Medium, target: Option<&Target>) -> String {
    let (kind, medium) = (kind.name(), medium.name());
    let mut text = format!(
        "format  = \"{FORMAT}\"\nversion = {VERSION}\nkind    = \"{kind}\"\nmedium  = \"{medium}\"\n"
    );
    if let Some(Target { inner_corners: [columns, rows], square_mm, wavelength_nm, .. }) = target {
        text += &format!(
            "\n[target]\npattern       = \"chessboard\"\ninner_corners = [{columns}, {rows}]\nsquare_mm     = {square_mm:?}\n"
        );
        if let Some(nm) = wavelength_nm {
            text += &format!("wavelength_nm = {nm:?}\n");
        }
    }
    text
}

/// The bytes of frames.csv, of each image's file and its record; `path` names it in errors.
///
/// # Errors
/// [`Error`] where a row can't be written as CSV.
pub fn frames_text<'a>(
    frames: impl IntoIterator<Item = (&'a str, &'a FrameRecord)>,
    path: &Path,
) -> Result<Vec<u8>, Error> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let failed = |e: csv::Error| Error::content(Place::file(path), e.to_string(), "report this");
    csv.write_record(["file", "pose", "laser", "voltage_v", "stamp_ns"]).map_err(failed)?;
    for (file, frame) in frames {
        let pose = frame.pose.map(|pose| pose.to_string()).unwrap_or_default();
        let voltage = frame.voltage_v.map(|volts| format!("{volts:?}")).unwrap_or_default();
        let laser = if frame.laser_on { "on" } else { "off" };
        csv.write_record([file, &pose, laser, &voltage, &frame.stamp_ns.to_string()]).map_err(failed)?;
    }
    csv.into_inner().map_err(|e| Error::file(path, "write")(e.into_error()))
}
