//! Point clouds in the format that a file's name tells by its ending.

use std::path::Path;

use uw_cloud::PointCloud;

use crate::{
    atomic::Overwrite,
    e57,
    error::{Error, Problem},
    pcd, ply, xyz,
};

/// The endings that are read and written, as messages say them.
#[cfg(feature = "las")]
pub const ENDINGS: &str = ".ply, .pcd, .xyz, .csv, .e57, .las or .laz";
/// The endings that are read and written, as messages say them.
#[cfg(not(feature = "las"))]
pub const ENDINGS: &str =
    ".ply, .pcd, .xyz, .csv or .e57 (.las and .laz where it is built with the feature las)";

/// A format of point clouds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// PLY (`.ply`), written in this encoding.
    Ply(ply::Encoding),
    /// PCD (`.pcd`), written in this encoding.
    Pcd(ply::Encoding),
    /// Text, one line a point (`.xyz`, `.csv`).
    Text(xyz::Separator),
    /// E57 (`.e57`).
    E57,
    /// LAS (`.las`), or LAZ (`.laz`), which is compressed.
    #[cfg(feature = "las")]
    Las {
        /// Whether it is.
        compressed: bool,
    },
}

impl Format {
    /// The format that the ending of a file's name tells, upper or lower case; a PLY or PCD is [`ply::Encoding::Binary`].
    ///
    /// # Errors
    /// [`Error::Ending`] for another ending, or none.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let ending = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
        match ending.as_ref().and_then(|e| e.to_str()) {
            Some("ply") => Ok(Self::Ply(ply::Encoding::Binary)),
            Some("pcd") => Ok(Self::Pcd(ply::Encoding::Binary)),
            Some("xyz") => Ok(Self::Text(xyz::Separator::Space)),
            Some("csv") => Ok(Self::Text(xyz::Separator::Comma)),
            Some("e57") => Ok(Self::E57),
            #[cfg(feature = "las")]
            Some("las") => Ok(Self::Las { compressed: false }),
            #[cfg(feature = "las")]
            Some("laz") => Ok(Self::Las { compressed: true }),
            _ => Err(Error::Ending { path: path.to_owned() }),
        }
    }

    /// The same format, a PLY or PCD as text rather than binary.
    pub fn as_text(self) -> Self {
        match self {
            Self::Ply(_) => Self::Ply(ply::Encoding::Ascii),
            Self::Pcd(_) => Self::Pcd(ply::Encoding::Ascii),
            other => other,
        }
    }
}

/// The cloud in a file, of the format that its name tells, with warnings about what had to be assumed.
///
/// # Errors
/// [`Error::Ending`], or as [`ply::read`], [`pcd::read`], [`xyz::read`] and [`e57::read`].
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    match Format::of(path)? {
        Format::Ply(_) => ply::read(path),
        Format::Pcd(_) => pcd::read(path),
        Format::Text(_) => xyz::read(path),
        Format::E57 => e57::read(path),
        #[cfg(feature = "las")]
        Format::Las { .. } => crate::las::read(path),
    }
}

/// Writes a cloud in a format ([`Format::of`] tells it from the name), whole or not at all.
///
/// # Errors
/// As [`atomic::write`](crate::atomic::write()).
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, format: Format) -> Result<(), Error> {
    match format {
        Format::Ply(encoding) => ply::write(path, overwrite, cloud, encoding),
        Format::Pcd(encoding) => pcd::write(path, overwrite, cloud, encoding),
        Format::Text(separator) => xyz::write(path, overwrite, cloud, separator),
        Format::E57 => e57::write(path, overwrite, cloud),
        #[cfg(feature = "las")]
        Format::Las { compressed } => crate::las::write(path, overwrite, cloud, compressed),
    }
}
