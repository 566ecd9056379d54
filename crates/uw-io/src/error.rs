//! What can be wrong with a file, said so that a person can mend it.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// Where in a file something is wrong. Lines and columns count from 1; a column counts characters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file.
    pub path: PathBuf,
    /// Line, where the file is text.
    pub line: Option<u32>,
    /// Character of that line, where it is known.
    pub column: Option<u32>,
    /// Key of a TOML file (`camera.port.normal`), column of a table (`voltage_v`) or property of a cloud.
    pub key: Option<String>,
}

impl Place {
    /// The file as a whole.
    pub fn file(path: &Path) -> Self {
        Self { path: path.to_owned(), line: None, column: None, key: None }
    }

    pub(crate) fn line(path: &Path, line: u32) -> Self {
        Self { line: Some(line), ..Self::file(path) }
    }

    pub(crate) fn key(self, key: &str) -> Self {
        Self { key: Some(key.to_owned()), ..self }
    }

    pub(crate) fn key_below(self, key: &str) -> Self {
        Self { key: Some(self.key.map_or_else(|| key.to_owned(), |above| format!("{above}: {key}"))), ..self }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.path.display())?;
        for number in [self.line, self.column].into_iter().flatten() {
            write!(f, ":{number}")?;
        }
        self.key.iter().try_for_each(|key| write!(f, ": {key}"))
    }
}

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}{}", path.display(), mend_io(source))]
    File {
        /// The file or folder.
        path: PathBuf,
        /// What was being done, as an infinitive.
        action: &'static str,
        /// The system's own reason.
        source: io::Error,
    },
    /// The file declares another format than the one needed here.
    #[error(
        "{place}: this is {got}, but a file of format \"{needed}\" is needed; give the right file, or begin it with: format = \"{needed}\""
    )]
    Format {
        /// Where it says so.
        place: Place,
        /// The format that is read here.
        needed: &'static str,
        /// What was found.
        got: String,
    },
    /// The file was made by a later version of the software.
    #[error(
        "{place}: version {got} of this format is newer than version {needed}, the newest known here; update uwscan"
    )]
    Version {
        /// Where it says so.
        place: Place,
        /// The newest version that is read here.
        needed: u32,
        /// What was found.
        got: i64,
    },
    /// Something in the file is wrong.
    #[error("{place}: {what}; {mend}")]
    Content {
        /// Where.
        place: Place,
        /// What is wrong.
        what: String,
        /// What to do.
        mend: String,
    },
    /// An image cannot be decoded, or holds what it must not.
    #[error("{}: {what}; {mend}", path.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do.
        mend: String,
    },
    /// An image has another size than its camera.
    #[error(
        "{}: the image is {} x {} pixels, but {} x {} {}", path.display(), got[0], got[1], needed[0], needed[1], said_by.size()
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// Width and height that were expected, pixels.
        needed: [u32; 2],
        /// Width and height of the image, pixels.
        got: [u32; 2],
        /// What made expect them.
        said_by: SaidBy,
    },
    /// A point cloud's name has no ending that tells its format.
    #[error("{}: a point cloud's name ends in {}", path.display(), crate::clouds::ENDINGS)]
    Ending {
        /// The cloud.
        path: PathBuf,
    },
    /// A mesh's name has no ending that tells its format.
    #[error("{}: a mesh's name ends in {}", path.display(), crate::meshes::ENDINGS)]
    MeshEnding {
        /// The mesh.
        path: PathBuf,
    },
    /// The output exists and may not be replaced.
    #[error("{}: exists already; give another name, or --force to replace it", path.display())]
    Exists {
        /// The output.
        path: PathBuf,
    },
}

impl Error {
    /// The file that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::File { path, .. }
            | Self::Image { path, .. }
            | Self::ImageSize { path, .. }
            | Self::Ending { path }
            | Self::MeshEnding { path }
            | Self::Exists { path } => path,
            Self::Format { place, .. } | Self::Version { place, .. } | Self::Content { place, .. } => {
                &place.path
            }
        }
    }

    /// The same error about a file of another name.
    pub(crate) fn about(mut self, other: PathBuf) -> Self {
        match &mut self {
            Self::File { path, .. }
            | Self::Image { path, .. }
            | Self::ImageSize { path, .. }
            | Self::Ending { path }
            | Self::MeshEnding { path }
            | Self::Exists { path } => *path = other,
            Self::Format { place, .. } | Self::Version { place, .. } | Self::Content { place, .. } => {
                place.path = other;
            }
        }
        self
    }

    /// The error of a file for which the system refused an `action` ("write", "open"), from the system's own.
    pub fn file(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::File { path: path.to_owned(), action, source }
    }

    pub(crate) fn content(place: Place, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self::Content { place, what: what.into(), mend: mend.into() }
    }

    pub(crate) fn image(path: &Path, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self::Image { path: path.to_owned(), what: what.into(), mend: mend.into() }
    }
}

fn mend_io(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::NotFound => "; check the path",
        io::ErrorKind::PermissionDenied => "; check the permissions of the file and of its folder",
        io::ErrorKind::IsADirectory => "; give a file, not a folder",
        io::ErrorKind::NotADirectory => "; give a folder, or check the path",
        io::ErrorKind::StorageFull => "; free some space",
        io::ErrorKind::ReadOnlyFilesystem => "; write to another place",
        io::ErrorKind::InvalidFilename => "; give a shorter name",
        _ => "; check the path, its links and its disk",
    }
}

/// What says how a camera's images are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SaidBy {
    /// The rig file.
    Rig,
    /// The calibration.
    Calibration,
    /// The other images of the capture.
    Others,
}

impl SaidBy {
    fn size(self) -> &'static str {
        match self {
            Self::Rig => {
                "in the rig file; mend its width and height, or give the rig of this camera with --rig"
            }
            Self::Calibration => "in the calibration; give the calibration of this camera",
            Self::Others => "are most of the others; take it out, or put the whole one back",
        }
    }

    /// What to do about values with more bits than this says.
    pub(crate) fn bits(self) -> &'static str {
        match self {
            Self::Rig | Self::Others => {
                "mend bits in the rig file; values that the camera shifted to the left must be shifted back, or counted \
                 with bits = 16"
            }
            Self::Calibration => {
                "give the calibration of this camera; where the rig file had other bits than the camera has, mend it and \
                 calibrate again"
            }
        }
    }
}

/// What a [`Problem`] costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Nothing is lost, but the result may not be what was meant.
    Warning,
    /// An input is missing or unreadable; the rest can be used.
    Loss,
}

/// Something wrong that can be gone on with.
#[derive(Debug)]
pub struct Problem {
    /// What it costs.
    pub severity: Severity,
    /// The 0-based data row of frames.csv, or number in the recording, that is lost; `None` unless this is about one frame.
    pub row: Option<usize>,
    /// What is wrong, where, and how to mend it.
    pub error: Error,
}

impl Problem {
    /// A warning about a place in a file.
    pub fn warning(place: Place, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, row: None, error: Error::content(place, what, mend) }
    }

    /// The loss of one frame: its image is missing or unreadable.
    pub fn loss(row: usize, error: Error) -> Self {
        Self { severity: Severity::Loss, row: Some(row), error }
    }

    /// The loss of what is no single frame: a part of a recording.
    pub fn lost(error: Error) -> Self {
        Self { severity: Severity::Loss, row: None, error }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}
