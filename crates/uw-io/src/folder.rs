//! Folders that are there whole or not at all.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use tempfile::{Builder, TempDir};

use crate::{
    atomic::Overwrite,
    error::{Error, Place},
};

/// A folder that is being filled beside its final place, and gone again unless it is [put there](NewFolder::finish).
#[derive(Debug)]
pub struct NewFolder {
    filling: TempDir,
    target: PathBuf,
    overwrite: Overwrite,
    marker: Option<&'static str>,
}

impl NewFolder {
    /// Begins a folder. One that exists is replaced only with [`Overwrite::Replace`], and only if it is empty or holds a file named
    /// `marker`: anything else is somebody's, and nothing that this program made.
    ///
    /// # Errors
    /// [`Error::Exists`] where it may not be replaced, [`Error`] where it is no folder of ours or can't be made.
    pub fn begin(target: &Path, overwrite: Overwrite, marker: &'static str) -> Result<Self, Error> {
        Self::beside(target, overwrite, Some(marker))
    }

    /// Begins a folder that does not exist yet, or is empty.
    ///
    /// # Errors
    /// [`Error`] where it holds anything, is no folder, or can't be made.
    pub fn begin_anew(target: &Path) -> Result<Self, Error> {
        Self::beside(target, Overwrite::Replace, None)
    }

    fn beside(target: &Path, overwrite: Overwrite, marker: Option<&'static str>) -> Result<Self, Error> {
        check(target, overwrite, marker)?;
        let beside = beside(target);
        let mut builder = Builder::new();
        builder.prefix(".uwscan-").suffix(".tmp");
        // A temporary folder is private by default; an output is as readable as any other that the user makes.
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            builder.permissions(fs::Permissions::from_mode(0o777));
        }
        let filling = builder.tempdir_in(beside).map_err(Error::file(beside, "make a folder in"))?;
        Ok(Self { filling, target: target.to_owned(), overwrite, marker })
    }

    /// Where to write meanwhile.
    pub fn path(&self) -> &Path {
        self.filling.path()
    }

    /// An error about a file in here, by the name that it would have had in place: the folder that it was written into is gone by the time that
    /// somebody reads of it.
    pub fn told(&self, error: Error) -> Error {
        match error.path().strip_prefix(self.path()) {
            Ok(inside) => {
                let name = self.target.join(inside);
                error.about(name)
            }
            Err(_) => error,
        }
    }

    /// Puts the folder in place.
    ///
    /// # Errors
    /// [`Error`] where that fails: what was there before is there still.
    pub fn finish(self) -> Result<(), Error> {
        let failed = |action| Error::file(&self.target, action);
        check(&self.target, self.overwrite, self.marker)?;
        // No system renames over a folder that holds something: what was there steps aside first, and comes back if that was in vain.
        let aside = self.target.symlink_metadata().is_ok().then(|| {
            let mut name = self.filling.path().as_os_str().to_owned();
            name.push(".old");
            PathBuf::from(name)
        });
        if let Some(aside) = &aside {
            fs::rename(&self.target, aside).map_err(failed("move the old folder aside"))?;
        }
        if let Err(error) = fs::rename(self.filling.path(), &self.target) {
            if let Some(aside) = &aside {
                fs::rename(aside, &self.target).map_err(failed("put the old folder back"))?;
            }
            return Err(failed("put the finished folder in place")(error));
        }
        // It is no longer a temporary one, and not to be removed.
        let _ = self.filling.keep();
        if let Some(aside) = &aside {
            fs::remove_dir_all(aside).map_err(Error::file(aside, "remove the old folder"))?;
        }
        Ok(())
    }
}

fn beside(target: &Path) -> &Path {
    target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn check(target: &Path, overwrite: Overwrite, marker: Option<&str>) -> Result<(), Error> {
    let content = |what: String, mend: &str| Err(Error::content(Place::file(target), what, mend));
    if target.file_name().is_none() {
        return content("is no name of a folder".into(), "give the name of a folder to write");
    }
    match fs::symlink_metadata(target) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {}
        Err(e) => return Err(Error::file(target, "write")(e)),
        Ok(_) if overwrite == Overwrite::Refuse => return Err(Error::Exists { path: target.into() }),
        Ok(meta) if !meta.is_dir() => {
            return content("is a file, not a folder".into(), "write to another place");
        }
        Ok(_) => {
            let mut entries = fs::read_dir(target).map_err(Error::file(target, "look into the folder"))?;
            match marker {
                _ if entries.next().is_none() => {}
                None => {
                    let what = "exists already, and a folder is not replaced".into();
                    return content(what, "give the name of a new folder");
                }
                Some(marker) if !target.join(marker).exists() => {
                    let what = format!("holds files but no {marker}: it is not what would be written anew");
                    return content(what, "write to another place, or remove it yourself");
                }
                Some(_) => {}
            }
        }
    }
    let beside = beside(target);
    if !beside.is_dir() {
        let what = format!("there is no such folder to write {} into", target.display());
        return Err(Error::content(Place::file(beside), what, "make it first, or check the path"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_files_by_their_places_to_be() {
        let beside = tempfile::tempdir().unwrap();
        let (target, other) = (beside.path().join("demo"), beside.path().join("rig.toml"));
        let folder = NewFolder::begin_anew(&target).unwrap();
        let full = |path: &Path| Error::file(path, "write")(io::ErrorKind::StorageFull.into());
        assert_eq!(
            folder.told(full(&folder.path().join("images/3.png"))).path(),
            target.join("images/3.png")
        );
        assert_eq!(folder.told(full(&other)).path(), other);
    }
}
