//! Captures from a folder into a recording and back, without loss.

use std::{fs, io, path::Path};

use image::ImageFormat;

use crate::{
    atomic::{self, Overwrite},
    capture::{Capture, FrameRecord, capture_text, frames_text},
    error::{Error, Place, Problem},
    folder::NewFolder,
    images::{self, FileFormat, Stored},
    recording::{Head, Options, Picture, Recorder, Shot, Through, topics},
    toml_file,
};

/// What came of a conversion.
#[derive(Debug, Default)]
pub struct Converted {
    /// Images carried over.
    pub images: usize,
    /// Losses: what the input lacked.
    pub problems: Vec<Problem>,
    /// What the other format has no place for.
    pub warnings: Vec<String>,
}

/// Writes a capture folder as a recording, whole or not at all: rows of frames.csv, images (a PNG or JPEG byte for byte, other
/// formats as PNG of the same values), rig.toml and calibration.toml as they are.
///
/// # Errors
/// [`Error`] where a file can't be read or written. An image that is missing is a loss in [`Converted::problems`].
pub fn to_recording(capture: &Capture, out: &Path, overwrite: Overwrite) -> Result<Converted, Error> {
    if capture.head().is_some() {
        let what = "is a recording already";
        return Err(Error::content(Place::file(&capture.path), what, "give a folder as the output"));
    }
    let attached = |name: &str| match toml_file::text(&capture.path.join(name)) {
        Err(Error::File { source, .. }) if source.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some),
    };
    let mut head = Head::new(capture.kind, capture.medium, capture.target.clone());
    head.scan_id = capture.content_hash()?;
    head.planned_frames = u32::try_from(capture.frames.len()).ok();
    head.rig = attached("rig.toml")?;
    head.calibration = attached("calibration.toml")?;
    let began_ns = capture.frames.iter().map(|f| f.stamp_ns).min().unwrap_or_default();
    let present: Vec<usize> = capture.present().map(|f| f.row).collect();
    let mut converted = Converted::default();
    atomic::write_through(out, overwrite, |file| {
        let mut recorder = Recorder::new(Through(file), out, &head, began_ns, Options::default())?;
        for frame in &capture.frames {
            let shot = shot(capture, frame)?;
            // Who received it when is not known: as it was exposed.
            let at = frame.stamp_ns;
            if present.binary_search(&frame.row).is_err() {
                recorder.lost_frame(&shot, "its image was missing when it was converted", at)?;
                continue;
            }
            match capture.stored(frame) {
                Ok(Stored::File { format: FileFormat::Png, bytes }) => {
                    recorder.frame(&shot, &Picture::Png(&bytes), at)?;
                }
                Ok(Stored::File { format: FileFormat::Jpeg, bytes }) => {
                    recorder.frame(&shot, &Picture::Jpeg(&bytes), at)?;
                }
                Ok(Stored::Grey(image)) => {
                    let bits = (u32::from(image.full_scale) + 1).ilog2() as u8;
                    recorder.frame(&Shot { bits, ..shot }, &Picture::of(&image), at)?;
                }
                Err(error) => {
                    recorder.lost_frame(&shot, &error.to_string(), at)?;
                    converted.problems.push(Problem::loss(frame.row, error));
                    continue;
                }
            }
            converted.images += 1;
        }
        recorder.finish()
    })?;
    Ok(converted)
}

fn shot<'f>(capture: &Capture, frame: &'f FrameRecord) -> Result<Shot<'f>, Error> {
    let number = u32::try_from(frame.row).map_err(|_| {
        let what = "has more images than a recording can number";
        Error::content(Place::file(&capture.path), what, "split it")
    })?;
    Ok(Shot {
        number,
        file: &frame.file,
        pose: frame.pose,
        laser_on: frame.laser_on,
        voltage_v: frame.voltage_v,
        stamp_ns: frame.stamp_ns,
        bits: capture.rig.as_ref().map_or(0, |rig| rig.camera.bits),
    })
}

/// Writes a recording as a capture folder, which must not exist yet, whole or not at all.
///
/// # Errors
/// [`Error`] where a file can't be read or written. An image that is missing or damaged is a loss in
/// [`Converted::problems`].
pub fn to_folder(capture: &Capture, out: &Path) -> Result<Converted, Error> {
    let Some(head) = capture.head() else {
        let what = "is a capture folder already";
        return Err(Error::content(
            Place::file(&capture.path),
            what,
            "give a name that ends in .mcap as the output",
        ));
    };
    new_folder(out, |new| {
        let mut converted = Converted::default();
        for (name, text) in [("rig.toml", &head.rig), ("calibration.toml", &head.calibration)] {
            if let Some(text) = text {
                put(&new.join(name), text.as_bytes())?;
            }
        }
        put(
            &new.join("capture.toml"),
            capture_text(capture.kind, capture.medium, capture.target.as_ref()).as_bytes(),
        )?;
        let present: Vec<usize> = capture.present().map(|f| f.row).collect();
        let mut rows = Vec::new();
        for frame in &capture.frames {
            let mut name = frame.file.clone();
            if present.binary_search(&frame.row).is_ok() {
                let written = capture.stored(frame).and_then(|image| {
                    let (file, format) = file_name(&name, &image);
                    name = file;
                    images::encoded(image, format, &capture.image_path(frame))
                });
                match written {
                    Ok(bytes) => {
                        put(&new.join(&name), &bytes)?;
                        converted.images += 1;
                    }
                    Err(error @ Error::File { .. }) => return Err(error),
                    Err(error) => converted.problems.push(Problem::loss(frame.row, error)),
                }
            }
            rows.push((name, frame));
        }
        let rows = rows.iter().map(|(name, frame): &(String, &FrameRecord)| (name.as_str(), *frame));
        put(&new.join("frames.csv"), &frames_text(rows, &out.join("frames.csv"))?)?;
        let carried = [topics::FRAME, topics::IMAGE, topics::CALIBRATION, topics::TRANSFORMS];
        let left: Vec<&str> =
            capture.topics().map(|(name, _)| name).filter(|name| !carried.contains(name)).collect();
        if !left.is_empty() {
            converted.warnings.push(format!(
                "{}: a capture folder has no place for {}: left out",
                capture.path.display(),
                left.join(", ")
            ));
        }
        Ok(converted)
    })
}

/// Fills a folder that must not exist yet, or be empty, whole or not at all; what `fill` returns.
pub(crate) fn new_folder<T>(out: &Path, fill: impl FnOnce(&Path) -> Result<T, Error>) -> Result<T, Error> {
    let folder = NewFolder::begin_anew(out)?;
    let filled = fill(folder.path()).map_err(|error| folder.told(error))?;
    folder.finish()?;
    Ok(filled)
}

pub(crate) fn put(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(Error::file(folder, "write into the folder"))?;
    }
    fs::write(path, bytes).map_err(Error::file(path, "write"))
}

/// The name of an image's file and its format: its own where that keeps every value, else a PNG.
fn file_name(name: &str, image: &Stored) -> (String, ImageFormat) {
    let jpeg = matches!(image, Stored::File { format: FileFormat::Jpeg, .. });
    match ImageFormat::from_path(name) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Tiff | ImageFormat::Pnm)) => (name.to_owned(), format),
        Ok(ImageFormat::Jpeg) if jpeg => (name.to_owned(), ImageFormat::Jpeg),
        _ => (format!("{name}.png"), ImageFormat::Png),
    }
}
