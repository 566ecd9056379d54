//! The text files of a capture folder, as [`super::Capture`] reads them.

use super::{FORMAT, FrameRecord, Kind, Medium, Target, VERSION};

/// The text of capture.toml.
pub fn capture_text(kind: Kind, medium: Medium, target: Option<&Target>) -> String {
    let (kind, medium) = (kind.name(), medium.name());
    let mut text =
        format!("format = \"{FORMAT}\"\nversion = {VERSION}\nkind = \"{kind}\"\nmedium = \"{medium}\"\n");
    if let Some(Target { inner_corners: [columns, rows], square_mm, wavelength_nm, .. }) = target {
        text += &format!(
            "\n[target]\npattern = \"chessboard\"\ninner_corners = [{columns}, {rows}]\nsquare_mm = {square_mm:?}\n"
        );
        if let Some(nm) = wavelength_nm {
            text += &format!("wavelength_nm = {nm:?}\n");
        }
    }
    text
}

/// The text of frames.csv.
pub fn frames_text<'a>(frames: impl IntoIterator<Item = &'a FrameRecord>) -> String {
    let mut text = String::from("file,pose,laser,voltage_v,stamp_ns\n");
    for f in frames {
        let pose = f.pose.map_or(String::new(), |pose| pose.to_string());
        let voltage = f.voltage_v.map_or(String::new(), |v| v.to_string());
        let laser = if f.laser_on { "on" } else { "off" };
        text += &format!("{},{pose},{laser},{voltage},{}\n", f.file, f.stamp_ns);
    }
    text
}
