//! The folder of a guided capture: whole after every placement.

use super::{Image, Wanted, stamp_ns};
use crate::Error;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use uw_hw::{Frame, Pixels};
use uw_io::{FrameRecord, GrayImage, Kind, NewFolder, Overwrite, Rig, atomic, capture, images};

/// A capture folder, and the rows of its frames.csv.
pub(super) struct Files {
    folder: PathBuf,
    rows: Vec<FrameRecord>,
    poses: u32,
}

impl Files {
    /// Makes the folder, which may be there if it is empty, with all but its images.
    ///
    /// # Errors
    /// [`Error::File`] where it holds anything, or can't be made.
    pub(super) fn begin(folder: &Path, rig: &Rig, wanted: &Wanted) -> Result<Self, Error> {
        let new = NewFolder::begin_anew(folder)?;
        let write = |name: &str, text: &str| {
            let path = new.path().join(name);
            std::fs::write(&path, text).map_err(uw_io::Error::file(&path, "write"))
        };
        write(
            "capture.toml",
            &capture::capture_text(Kind::Calibration, wanted.medium, Some(&wanted.target)),
        )?;
        write("rig.toml", &rig.to_toml()?)?;
        let images = new.path().join("images");
        std::fs::create_dir(&images).map_err(uw_io::Error::file(&images, "make the folder"))?;
        new.finish()?;
        Ok(Self { folder: folder.to_owned(), rows: Vec::new(), poses: 0 })
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn poses(&self) -> usize {
        self.poses as usize
    }

    pub(super) fn images(&self) -> usize {
        self.rows.len()
    }

    /// Adds a placement: its images first, then the table that names them, in one step. Gives its number.
    ///
    /// # Errors
    /// [`Error::File`] where they can't be written: the folder then holds the placements before.
    pub(super) fn add(&mut self, dark: &Image, lit: &[Image]) -> Result<u32, Error> {
        let pose = self.poses;
        let all: Vec<&Image> = std::iter::once(dark).chain(lit).collect();
        let rows: Vec<FrameRecord> = all
            .iter()
            .enumerate()
            .map(|(i, (voltage_v, frame))| {
                let row = self.rows.len() + i;
                FrameRecord {
                    row,
                    line: row as u32 + 2,
                    file: format!("images/{pose:03}-{i:02}.png"),
                    pose: Some(pose),
                    laser_on: voltage_v.is_some(),
                    voltage_v: *voltage_v,
                    stamp_ns: stamp_ns(frame),
                }
            })
            .collect();
        let folder = &self.folder;
        rows.par_iter().zip(&all).try_for_each(|(row, (_, frame))| {
            let path = folder.join(&row.file);
            let png = images::encode_png(&gray(frame), &path)?;
            // One of a placement that was given up half way may be there.
            atomic::write(&path, Overwrite::Replace, |out| out.write_all(&png))
        })?;
        let path = folder.join("frames.csv");
        let table = self.rows.iter().chain(&rows).map(|row| (row.file.as_str(), row));
        let text = capture::frames_text(table, &path)?;
        atomic::write(&path, Overwrite::Replace, |out| out.write_all(&text))?;
        self.rows.extend(rows);
        self.poses += 1;
        Ok(pose)
    }
}

/// A frame as an image file has it.
fn gray(frame: &Frame) -> GrayImage {
    let (width, height, stride) = (frame.width() as usize, frame.height() as usize, frame.stride());
    fn packed<P: Copy>(values: &[P], [width, height, stride]: [usize; 3]) -> Vec<P> {
        (0..height).flat_map(|row| &values[row * stride..row * stride + width]).copied().collect()
    }
    let (data, full_scale) = match frame.pixels() {
        Pixels::U8(values) => (uw_io::Pixels::U8(packed(values, [width, height, stride])), 0xff),
        Pixels::U16(values) => (uw_io::Pixels::U16(packed(values, [width, height, stride])), 0xffff),
    };
    GrayImage { width: frame.width(), height: frame.height(), data, full_scale }
}
