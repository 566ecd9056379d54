//! A capture as a folder of plain files.

use std::{collections::BTreeSet, fs::File, io, path::Path};

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{Capture, FORMAT, Kind, Medium, Source, Target, VERSION};
use crate::{
    error::{Error, Place, Problem},
    frames,
    rig::Rig,
    toml_file::TomlFile,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaptureRecord {
    kind: Kind,
    medium: Medium,
    target: Option<Target>,
}

impl Capture {
    /// The capture in a folder, with the problems of its images; what is odd in its text files goes to `problems`.
    pub(super) fn of_folder(
        dir: &Path,
        rig: Option<&Path>,
        problems: &mut Vec<Problem>,
    ) -> Result<Self, Error> {
        let file = TomlFile::read(&dir.join("capture.toml"), FORMAT, VERSION)?;
        let CaptureRecord { kind, medium, mut target } = file.parse()?;
        match (kind, &target) {
            (Kind::Calibration, None) => {
                let mend = "add pattern, inner_corners and square_mm";
                return Err(file.error("target", "a calibration needs its target", mend));
            }
            (Kind::Calibration, Some(t)) => {
                let refused = |(key, what, mend): (&str, String, &str)| file.error(key, what, mend);
                t.check().map_err(refused)?;
            }
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
            path: dir.to_owned(),
            kind,
            medium,
            target,
            frames,
            rig,
            problems: Vec::new(),
            missing: BTreeSet::new(),
            source: Source::Folder,
        };
        capture.check_images()?;
        capture.check_poses();
        capture.check_voltages();
        Ok(capture)
    }

    /// Finds the images that are missing, and refuses those outside the folder.
    fn check_images(&mut self) -> Result<(), Error> {
        let csv = self.path.join("frames.csv");
        let root = self.path.canonicalize().map_err(Error::file(&self.path, "find the capture folder"))?;
        for frame in &self.frames {
            let path = self.path.join(&frame.file);
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
            // What the system refuses is not mended by copying.
            let refused = self.problems.iter().position(|p| matches!(p.error, Error::File { .. }));
            if let Some(at) = refused {
                return Err(self.problems.swap_remove(at).error);
            }
            let what = format!("none of its {} images is there", self.frames.len());
            let mend = "check that the images were copied with it, and the paths in frames.csv";
            return Err(Error::content(Place::file(&csv), what, mend));
        }
        Ok(())
    }

    /// The hash of all that a capture folder says ([`Capture::content_hash`]).
    pub(super) fn folder_hash(&self) -> Result<String, Error> {
        let mut hash = Sha256::new();
        let names = ["capture.toml", "frames.csv", "rig.toml"].into_iter();
        for name in names.chain(self.frames.iter().map(|f| f.file.as_str())) {
            let path = self.path.join(name);
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
            let length = super::feed(&mut hash, &mut file, &path)?;
            hash.update(length.to_le_bytes());
        }
        Ok(super::hexadecimal(hash))
    }
}
