//! Which format a point cloud's file has: its name's ending says.

use std::path::{Path, PathBuf};

use clap::builder::{PathBufValueParser, TypedValueParser};
use uwscan::{
    cloud::PointCloud,
    io::{self, Overwrite, Problem, ply, xyz},
};

/// The endings that are read and written, as messages say them.
const ENDINGS: &str = ".ply, .xyz or .csv";

/// A point cloud's file, of a format that is known.
#[derive(Clone, Debug)]
pub struct CloudFile {
    /// Where it is.
    pub path: PathBuf,
    format: Format,
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Ply,
    Text(xyz::Separator),
}

impl CloudFile {
    /// The file, if its name ends as that of a cloud.
    pub fn new(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        let format = match ending.as_str() {
            "ply" => Format::Ply,
            "xyz" => Format::Text(xyz::Separator::Space),
            "csv" => Format::Text(xyz::Separator::Comma),
            _ => return None,
        };
        Some(Self { path: path.to_owned(), format })
    }

    /// Takes an argument as a cloud's file; another ending is wrong usage.
    pub fn parser() -> impl TypedValueParser<Value = Self> {
        PathBufValueParser::new()
            .try_map(|path| Self::new(&path).ok_or(format!("a point cloud's name ends in {ENDINGS}")))
    }

    /// The cloud in the file, with warnings about what had to be assumed.
    ///
    /// # Errors
    /// As the format's reader.
    pub fn read(&self) -> Result<(PointCloud, Vec<Problem>), io::Error> {
        match self.format {
            Format::Ply => ply::read(&self.path),
            Format::Text(_) => xyz::read(&self.path),
        }
    }

    /// Writes a cloud, whole or not at all; `encoding` is that of a PLY.
    ///
    /// # Errors
    /// As the format's writer.
    pub fn write(
        &self,
        overwrite: Overwrite,
        cloud: &PointCloud,
        encoding: ply::Encoding,
    ) -> Result<(), io::Error> {
        match self.format {
            Format::Ply => ply::write(&self.path, overwrite, cloud, encoding),
            Format::Text(separator) => xyz::write(&self.path, overwrite, cloud, separator),
        }
    }
}
