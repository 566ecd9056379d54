//! Outputs that are there whole or not at all.

use std::{
    fs,
    io::{self, BufWriter, Write},
    path::Path,
};

use tempfile::{Builder, NamedTempFile};

use crate::error::{Error, Place};

/// What becomes of an output that exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Overwrite {
    /// It stays, and writing is an error.
    Refuse,
    /// It is replaced, in one step.
    Replace,
}

/// Writes a file through `fill`: to a temporary file beside it, made durable, then renamed. Whatever fails, the
/// target is what it was before.
///
/// # Errors
/// [`Error::Exists`] where it exists and may not be replaced, [`Error::File`] or [`Error::Content`] where it cannot
/// be written, or `fill` fails.
pub fn write(
    path: &Path,
    overwrite: Overwrite,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Error> {
    write_through(path, overwrite, |out| fill(out).map_err(Error::file(path, "write")))
}

/// As [`write()`], where `fill` says itself what failed; what it returns.
///
/// # Errors
/// As [`write()`].
pub fn write_through<T, E: From<Error>>(
    path: &Path,
    overwrite: Overwrite,
    fill: impl FnOnce(&mut dyn Write) -> Result<T, E>,
) -> Result<T, E> {
    check(path, overwrite)?;
    let folder = folder(path);
    let failed = |action| Error::file(path, action);
    let mut temporary = temporary(folder)?;
    let mut buffer = BufWriter::with_capacity(1 << 18, temporary.as_file_mut());
    let filled = fill(&mut buffer)?;
    buffer.flush().map_err(failed("write"))?;
    drop(buffer);
    temporary.as_file().sync_all().map_err(failed("write"))?;
    let persisted = match overwrite {
        Overwrite::Replace => temporary.persist(path),
        // Somebody may have made the file since it was looked for: this refuses then, too.
        Overwrite::Refuse => temporary.persist_noclobber(path),
    };
    match persisted {
        Ok(_) => {}
        Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => {
            return Err(Error::Exists { path: path.into() }.into());
        }
        Err(e) => return Err(failed("put the finished file in place")(e.error).into()),
    }
    // The rename itself lasts once the folder is on disk; not every system can do that, and the data are safe.
    if let Ok(folder) = fs::File::open(folder) {
        let _ = folder.sync_all();
    }
    Ok(filled)
}

/// Whether an output can be written, as far as that can be told before the work that makes it: its folder is there and
/// can be written into, it is no folder or device itself, and it doesn't exist or may be replaced.
///
/// # Errors
/// As [`write()`].
pub fn check(path: &Path, overwrite: Overwrite) -> Result<(), Error> {
    if path.file_name().is_none() || path.is_dir() {
        return Err(Error::content(Place::file(path), "is a folder", "give the name of a file to write"));
    }
    let folder = folder(path);
    match fs::metadata(folder) {
        Ok(meta) if !meta.is_dir() => {
            return Err(Error::content(
                Place::file(folder),
                "is a file, not a folder",
                "write to another place",
            ));
        }
        Ok(_) => {}
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            let what = format!("there is no such folder to write {} into", path.display());
            return Err(Error::content(Place::file(folder), what, "make it first, or check the path"));
        }
        Err(e) => return Err(Error::file(folder, "open the folder")(e)),
    }
    match path.symlink_metadata() {
        Ok(_) if overwrite == Overwrite::Refuse => return Err(Error::Exists { path: path.to_owned() }),
        // Renaming over a device would take it away from everybody.
        Ok(meta) if !meta.is_file() && !meta.is_symlink() => {
            let what = "is a device, not a file";
            return Err(Error::content(Place::file(path), what, "give the name of a file to write"));
        }
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(Error::file(path, "write")(e)),
        _ => {}
    }
    temporary(folder).map(drop)
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file without a lasting name, which is gone when it is dropped.
fn temporary(folder: &Path) -> Result<NamedTempFile, Error> {
    let mut builder = Builder::new();
    builder.prefix(".uwscan-").suffix(".tmp");
    // A temporary file is private by default; an output is as readable as any other that the user makes.
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(Error::file(folder, "write into the folder"))
}
