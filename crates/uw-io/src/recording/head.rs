//! What a recording says of itself before its first image: a metadata record, and files attached.

use std::{collections::BTreeMap, path::Path};

use crate::{
    capture::{Kind, Medium, Pattern, Target},
    error::{Error, Place},
};

/// Name of the metadata record.
pub(crate) const METADATA: &str = "uwscan";
/// What its key `format` says.
const FORMAT: &str = "uwscan-recording";
/// The newest version that is read, and the one that is written.
const VERSION: u32 = 1;
/// Name of the rig file attached.
pub(crate) const RIG: &str = "rig.toml";
/// Name of the calibration attached.
pub(crate) const CALIBRATION: &str = "calibration.toml";

/// What is known when a recording begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Head {
    /// What it is for.
    pub kind: Kind,
    /// What is outside the windows.
    pub medium: Medium,
    /// The target; `Some` exactly in a calibration.
    pub target: Option<Target>,
    /// Tells one scan from every other.
    pub scan_id: String,
    /// The software that records, with its version.
    pub software: String,
    /// Images that are meant to be recorded; `None` where nobody knows.
    pub planned_frames: Option<u32>,
    /// Further metadata, such as indices and versions; keys of the format's own are not taken from here.
    pub notes: BTreeMap<String, String>,
    /// Text of the rig file, attached as it is.
    pub rig: Option<String>,
    /// Text of the calibration file, attached as it is.
    pub calibration: Option<String>,
}

impl Head {
    /// A head with nothing but what every recording says.
    pub fn new(kind: Kind, medium: Medium, target: Option<Target>) -> Self {
        Self {
            kind,
            medium,
            target,
            scan_id: String::new(),
            software: concat!("uwscan ", env!("CARGO_PKG_VERSION")).to_owned(),
            planned_frames: None,
            notes: BTreeMap::new(),
            rig: None,
            calibration: None,
        }
    }

    /// The metadata record.
    pub(super) fn to_metadata(&self) -> BTreeMap<String, String> {
        let mut map = self.notes.clone();
        let mut put = |key: &str, value: String| _ = map.insert(key.to_owned(), value);
        put("format", FORMAT.to_owned());
        put("version", VERSION.to_string());
        put("kind", self.kind.name().to_owned());
        put("medium", self.medium.name().to_owned());
        put("scan_id", self.scan_id.clone());
        put("software", self.software.clone());
        if let Some(frames) = self.planned_frames {
            put("planned_frames", frames.to_string());
        }
        if let Some(target) = &self.target {
            let Target { pattern: Pattern::Chessboard, inner_corners: [columns, rows], .. } = target;
            put("target.pattern", "chessboard".to_owned());
            put("target.inner_corners", format!("{columns} {rows}"));
            put("target.square_mm", target.square_mm.to_string());
            if let Some(nm) = target.wavelength_nm {
                put("target.wavelength_nm", nm.to_string());
            }
        }
        map
    }

    /// The head that a metadata record tells, without the files attached.
    ///
    /// # Errors
    /// [`Error`] where a key is missing or says what it can't.
    pub(crate) fn from_metadata(path: &Path, map: &BTreeMap<String, String>) -> Result<Self, Error> {
        let place = |key: &str| Place::file(path).key(&format!("metadata {METADATA}.{key}"));
        let bad = |key: &str, got: &str| {
            let what = format!("\"{got}\" is nothing that a recording says here");
            Error::content(place(key), what, "record or convert it again")
        };
        let need = |key: &str| {
            map.get(key)
                .map(String::as_str)
                .ok_or_else(|| Error::content(place(key), "is missing", "record or convert it again"))
        };
        match need("format")? {
            FORMAT => {}
            got => {
                let got = format!("of format \"{got}\"");
                return Err(Error::Format { place: place("format"), needed: FORMAT, got });
            }
        }
        match need("version")?.parse::<i64>() {
            Ok(got) if got > i64::from(VERSION) => {
                return Err(Error::Version { place: place("version"), needed: VERSION, got });
            }
            Ok(1..) => {}
            _ => return Err(bad("version", need("version")?)),
        }
        let kind = Kind::from_name(need("kind")?).ok_or_else(|| bad("kind", &map["kind"]))?;
        let medium = Medium::from_name(need("medium")?).ok_or_else(|| bad("medium", &map["medium"]))?;
        let target = match kind {
            Kind::Scan => None,
            Kind::Calibration => Some(target(&need, &bad, map)?),
        };
        let planned = map.get("planned_frames");
        let planned_frames = planned.map(|n| n.parse().map_err(|_| bad("planned_frames", n))).transpose()?;
        let text = |key: &str| map.get(key).cloned().unwrap_or_default();
        let ours = |key: &str| {
            let keys = ["format", "version", "kind", "medium", "scan_id", "software", "planned_frames"];
            keys.contains(&key) || key.starts_with("target.")
        };
        let notes = map.iter().filter(|(key, _)| !ours(key)).map(|(k, v)| (k.clone(), v.clone())).collect();
        Ok(Self {
            scan_id: text("scan_id"),
            software: text("software"),
            planned_frames,
            notes,
            ..Self::new(kind, medium, target)
        })
    }
}

fn target<'m>(
    need: &impl Fn(&str) -> Result<&'m str, Error>,
    bad: &impl Fn(&str, &str) -> Error,
    map: &BTreeMap<String, String>,
) -> Result<Target, Error> {
    if need("target.pattern")? != "chessboard" {
        return Err(bad("target.pattern", need("target.pattern")?));
    }
    let corners = need("target.inner_corners")?;
    let counts: Vec<u32> = corners.split_whitespace().map_while(|n| n.parse().ok()).collect();
    let inner_corners = <[u32; 2]>::try_from(counts).map_err(|_| bad("target.inner_corners", corners))?;
    let number = |key: &str, text: &str| text.parse::<f64>().map_err(|_| bad(key, text));
    let square_mm = number("target.square_mm", need("target.square_mm")?)?;
    let wavelength_nm =
        map.get("target.wavelength_nm").map(|nm| number("target.wavelength_nm", nm)).transpose()?;
    Ok(Target { pattern: Pattern::Chessboard, inner_corners, square_mm, wavelength_nm })
}
