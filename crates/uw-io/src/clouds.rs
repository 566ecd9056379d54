//! Point clouds in the format that a file's name tells by its ending.

use std::path::Path;

use uw_cloud::PointCloud;

use crate::{
    atomic::Overwrite,
    error::{Error, Problem},
    ply, xyz,
};

/// The endings that are read and written, as messages say them.
pub const ENDINGS: &str = ".ply, .xyz or .csv";

/// A format of point clouds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// PLY (`.ply`), written in this encoding.
    Ply(ply::Encoding),
    /// Text, one line a point (`.xyz`, `.csv`).
    Text(xyz::Separator),
}

impl Format {
    /// The format that the ending of a file's name tells, upper or lower case; a PLY is [`ply::Encoding::Binary`].
    ///
    /// # Errors
    /// [`Error::Ending`] for another ending, or none.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let ending = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
        match ending.as_ref().and_then(|e| e.to_str()) {
            Some("ply") => Ok(Self::Ply(ply::Encoding::Binary)),
            Some("xyz") => Ok(Self::Text(xyz::Separator::Space)),
            Some("csv") => Ok(Self::Text(xyz::Separator::Comma)),
            _ => Err(Error::Ending { path: path.to_owned() }),
        }
    }

    /// The same format, a PLY as text rather than binary.
    pub fn as_text(self) -> Self {
        match self {
            Self::Ply(_) => Self::Ply(ply::Encoding::Ascii),
            text @ Self::Text(_) => text,
        }
    }
}

/// The cloud in a file, of the format that its name tells, with warnings about what had to be assumed.
///
/// # Errors
/// [`Error::Ending`], or as [`ply::read`] and [`xyz::read`].
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    match Format::of(path)? {
        Format::Ply(_) => ply::read(path),
        Format::Text(_) => xyz::read(path),
    }
}

/// Writes a cloud in a format ([`Format::of`] tells it from the name), whole or not at all.
///
/// # Errors
/// As [`atomic::write`](crate::atomic::write()).
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, format: Format) -> Result<(), Error> {
    match format {
        Format::Ply(encoding) => ply::write(path, overwrite, cloud, encoding),
        Format::Text(separator) => xyz::write(path, overwrite, cloud, separator),
    }
}
