//! A point cloud's file as an argument: its name's ending says the format.

use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser};
use uwscan::io::clouds::Format;

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
}
