//! Room where files go, and names for what goes there.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::error::{Error, Place};

/// Bytes that may still be written beside a path, whether it is there or not; `None` on systems that are not asked (all but Unix).
///
/// # Errors
/// [`Error::File`] where its folder is not there, or the system refuses.
pub fn free_bytes(path: &Path) -> Result<Option<u64>, Error> {
    let folder = match path.is_dir() {
        true => path,
        false => path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new(".")),
    };
    free_in(folder).map_err(Error::file(folder, "ask for free space in"))
}

#[cfg(unix)]
fn free_in(folder: &Path) -> std::io::Result<Option<u64>> {
    let said = rustix::fs::statvfs(folder)?;
    // What others than root may use.
    Ok(Some(said.f_bavail.saturating_mul(said.f_frsize)))
}

#[cfg(not(unix))]
fn free_in(_: &Path) -> std::io::Result<Option<u64>> {
    Ok(None)
}

/// A file in a folder that has no name, and is gone once it is closed: to see whether the folder can be written, and how fast.
///
/// # Errors
/// The system's own.
pub fn scratch_file(folder: &Path) -> std::io::Result<fs::File> {
    tempfile::tempfile_in(folder)
}

/// The name of the next recording in a folder: `scan-0001.mcap`, and one more than the highest number that is there.
///
/// # Errors
/// [`Error::File`] where there is no such folder, [`Error::Content`] where all names are taken.
pub fn next_recording(folder: &Path) -> Result<PathBuf, Error> {
    let mut highest = 0;
    for entry in fs::read_dir(folder).map_err(Error::file(folder, "look for scans in"))? {
        let name = entry.map_err(Error::file(folder, "look for scans in"))?.file_name();
        let number =
            name.to_str().and_then(|name| name.strip_prefix("scan-")?.split_once('.')?.0.parse().ok());
        highest = highest.max(number.unwrap_or(0_u32));
    }
    let next = highest.checked_add(1).ok_or_else(|| {
        Error::content(
            Place::file(folder),
            "holds a scan of the highest number there is",
            "use another folder",
        )
    })?;
    Ok(folder.join(format!("scan-{next:04}.mcap")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_numbered_on_from_the_highest() {
        let folder = tempfile::tempdir().unwrap();
        let next = || next_recording(folder.path()).unwrap().file_name().unwrap().to_owned();
        assert_eq!(next(), "scan-0001.mcap");
        for name in ["scan-0007.ply", "scan-3.mcap", "scan-x.mcap", "scan-00010", "ball.mcap"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(next(), "scan-0008.mcap");
        fs::write(folder.path().join("scan-12345.mcap"), "").unwrap();
        assert_eq!(next(), "scan-12346.mcap");
        assert!(next_recording(&folder.path().join("none")).is_err());
    }

    #[test]
    #[cfg(unix)]
    fn free_space_is_that_of_the_nearest_folder() {
        let folder = tempfile::tempdir().unwrap();
        let free = |path: &Path| free_bytes(path).map(|free| free.unwrap() > 0);
        assert!(free(folder.path()).unwrap());
        assert!(free(&folder.path().join("not-there.mcap")).unwrap());
        assert!(free(Path::new("not-there.mcap")).unwrap());
        assert!(free(&folder.path().join("no/folder")).is_err());
    }
}
