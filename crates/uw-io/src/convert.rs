//! Captures from a folder into a recording and back, without loss.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use image::ImageFormat;

use crate::{
    atomic::{self, Overwrite},
    capture::{Capture, FORMAT, FrameRecord, Target, VERSION},
    error::{Error, Place, Problem},
    images::{self, FileFormat, Pixels, Stored},
    recording::{Head, Options, Picture, Recorder, Shot, Through, topics},
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
    let attached = |name: &str| {
        let path = capture.path.join(name);
        match fs::read_to_string(&path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            read => read.map(Some).map_err(Error::file(&path, "read")),
        }
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
                    let (width, height) = (image.width, image.height);
                    let picture = match &image.data {
                        Pixels::U8(pixels) => Picture::U8 { width, height, pixels },
                        Pixels::U16(pixels) => Picture::U16 { width, height, pixels },
                    };
                    let bits = (u32::from(image.full_scale) + 1).ilog2() as u8;
                    recorder.frame(&Shot { bits, ..shot }, &picture, at)?;
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
        put(&new.join("capture.toml"), capture_toml(capture).as_bytes())?;
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
        put(&new.join("frames.csv"), &frames_csv(&rows, out)?)?;
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

/// Fills a folder that must not exist yet, whole or not at all; what `fill` returns.
pub(crate) fn new_folder<T>(out: &Path, fill: impl FnOnce(&Path) -> Result<T, Error>) -> Result<T, Error> {
    let used = match fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(e) => e.kind() != io::ErrorKind::NotFound,
    };
    if used {
        let what = "exists already, and a folder is not replaced";
        return Err(Error::content(Place::file(out), what, "give the name of a new folder"));
    }
    let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let temporary = tempfile::Builder::new()
        .prefix(".uwscan-")
        .tempdir_in(parent)
        .map_err(Error::file(parent, "write into the folder"))?;
    let filled = fill(temporary.path())?;
    // An empty folder of that name is replaced by renaming.
    fs::rename(temporary.path(), out).map_err(Error::file(out, "put the finished folder in place"))?;
    // It has another name now: there is nothing left to remove.
    let _ = temporary.keep();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        fs::set_permissions(out, fs::Permissions::from_mode(0o755)).map_err(Error::file(out, "write"))?;
    }
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

fn capture_toml(capture: &Capture) -> String {
    let (kind, medium) = (capture.kind.name(), capture.medium.name());
    let mut text = format!(
        "format  = \"{FORMAT}\"\nversion = {VERSION}\nkind    = \"{kind}\"\nmedium  = \"{medium}\"\n"
    );
    if let Some(Target { inner_corners: [columns, rows], square_mm, wavelength_nm, .. }) = &capture.target {
        text += &format!(
            "\n[target]\npattern       = \"chessboard\"\ninner_corners = [{columns}, {rows}]\nsquare_mm     = {square_mm:?}\n"
        );
        if let Some(nm) = wavelength_nm {
            text += &format!("wavelength_nm = {nm:?}\n");
        }
    }
    text
}

fn frames_csv(rows: &[(String, &FrameRecord)], out: &Path) -> Result<Vec<u8>, Error> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let path = PathBuf::from(out).join("frames.csv");
    let failed = |e: csv::Error| Error::content(Place::file(&path), e.to_string(), "report this");
    csv.write_record(["file", "pose", "laser", "voltage_v", "stamp_ns"]).map_err(failed)?;
    for (file, frame) in rows {
        let record = [
            file.clone(),
            frame.pose.map(|pose| pose.to_string()).unwrap_or_default(),
            if frame.laser_on { "on" } else { "off" }.to_owned(),
            frame.voltage_v.map(|volts| format!("{volts:?}")).unwrap_or_default(),
            frame.stamp_ns.to_string(),
        ];
        csv.write_record(record).map_err(failed)?;
    }
    csv.into_inner().map_err(|e| Error::file(&path, "write")(e.into_error()))
}
