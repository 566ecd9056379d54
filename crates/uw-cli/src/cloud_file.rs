//! A point cloud's or a mesh's file as an argument: its name's ending says the format.

use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser};
use uwscan::io::{clouds::Format, meshes};

/// A point cloud's file, of a format that is known.
#[derive(Clone, Debug)]
pub struct CloudFile {
    /// Where it is.
    pub path: PathBuf,
    /// The format that its name tells.
    pub format: Format,
}

impl CloudFile {
    /// Takes an argument as a cloud's file; another ending is wrong usage.
    pub fn parser() -> impl TypedValueParser<Value = Self> {
        PathBufValueParser::new().try_map(|path| {
            let format = Format::of(&path)?;
            Ok::<_, uwscan::io::Error>(Self { path, format })
        })
    }

    /// The format to write: as text where that is asked for and the format has it.
    pub fn written_as(&self, text: bool) -> Format {
        if text { self.format.as_text() } else { self.format }
    }
}

/// A mesh's file, of a format that is known.
#[derive(Clone, Debug)]
pub struct MeshFile {
    /// Where it is.
    pub path: PathBuf,
    /// The format that its name tells.
    pub format: meshes::Format,
}

impl MeshFile {
    /// Takes an argument as a mesh's file; another ending is wrong usage.
    pub fn parser() -> impl TypedValueParser<Value = Self> {
        PathBufValueParser::new().try_map(|path| {
            let format = meshes::Format::of(&path)?;
            Ok::<_, uwscan::io::Error>(Self { path, format })
        })
    }

    /// The format to write, as [`CloudFile::written_as`].
    pub fn written_as(&self, text: bool) -> meshes::Format {
        if text { self.format.as_text() } else { self.format }
    }
}
