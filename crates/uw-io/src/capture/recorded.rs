//! A capture as a recording.

use std::path::Path;

use super::{Capture, Source};
use crate::{
    error::{Error, Place, Problem},
    recording::reader::Recording,
    rig::Rig,
};

impl Capture {
    /// The capture in a recording; what is odd in the files attached goes to `problems`.
    pub(super) fn of_recording(
        path: &Path,
        rig: Option<&Path>,
        problems: &mut Vec<Problem>,
    ) -> Result<Self, Error> {
        let mut recording = Recording::open(path)?;
        problems.append(&mut recording.problems);
        let head = &recording.head;
        if let Some(target) = &head.target {
            let at = |key: &str| Place::file(path).key(&format!("metadata uwscan.{key}"));
            target.check().map_err(|(key, what, mend)| Error::content(at(key), what, mend))?;
        }
        let read = match (rig, &head.rig) {
            (Some(path), _) => Some(Rig::read(path)?),
            (None, Some(text)) => Some(Rig::parse(&path.join("rig.toml"), text)?),
            (None, None) => None,
        };
        let rig = read.map(|(rig, warnings)| {
            problems.extend(warnings);
            rig
        });
        let frames = std::mem::take(&mut recording.frames);
        let missing = frames.iter().map(|f| f.row).filter(|row| !recording.has(*row)).collect();
        let mut capture = Self {
            path: path.to_owned(),
            kind: head.kind,
            medium: head.medium,
            target: head.target.clone(),
            frames,
            rig,
            problems: Vec::new(),
            missing,
            source: Source::Recording(Box::new(recording)),
        };
        if capture.present().next().is_none() {
            let what = "holds no image that can be used";
            return Err(Error::content(Place::file(path), what, "check that this is the recording meant"));
        }
        capture.check_poses();
        capture.check_voltages();
        Ok(capture)
    }
}
