use std::{fs, io, path::Path};

use tempfile::TempDir;
use uw_io::{Error, Overwrite, atomic};

use crate::samples::says;

fn put(path: &Path, overwrite: Overwrite, text: &str) -> Result<(), Error> {
    atomic::write(path, overwrite, |w| w.write_all(text.as_bytes()))
}

fn names(dir: &TempDir) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn an_output_is_written_once_and_replaced_on_demand() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("cloud.ply");
    put(&path, Overwrite::Refuse, "first").unwrap();
    let error = put(&path, Overwrite::Refuse, "second").unwrap_err();
    assert!(matches!(error, Error::Exists { .. }));
    says(&error.to_string(), &["cloud.ply", "--force"]);
    assert_eq!(fs::read_to_string(&path).unwrap(), "first");
    put(&path, Overwrite::Replace, "second").unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), "second");
    assert_eq!(names(&dir), ["cloud.ply"]);
}

#[test]
fn what_fails_halfway_leaves_everything_as_it_was() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("cloud.ply");
    put(&path, Overwrite::Refuse, "first").unwrap();
    let error = atomic::write(&path, Overwrite::Replace, |w| {
        w.write_all(b"half")?;
        Err(io::Error::from(io::ErrorKind::StorageFull))
    });
    says(&error.unwrap_err().to_string(), &["cloud.ply", "cannot write", "free some space"]);
    assert_eq!(fs::read_to_string(&path).unwrap(), "first");
    assert_eq!(names(&dir), ["cloud.ply"], "no temporary file stays");
}

#[test]
fn somebody_elses_file_made_meanwhile_is_not_replaced() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("cloud.ply");
    let error = atomic::write(&path, Overwrite::Refuse, |w| {
        fs::write(&path, "theirs")?;
        w.write_all(b"ours")
    });
    assert!(matches!(error, Err(Error::Exists { .. })));
    assert_eq!(fs::read_to_string(&path).unwrap(), "theirs");
    assert_eq!(names(&dir), ["cloud.ply"]);
}

#[test]
fn places_that_cannot_be_written_to_are_said_before_the_work() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("file"), "").unwrap();
    for (name, parts) in [
        ("no/such/cloud.ply", &["no/such", "no such folder", "make it first"][..]),
        ("file/cloud.ply", &["file", "not a folder"]),
        (".", &["is a folder"]),
        ("", &["is a folder"]),
    ] {
        let path = dir.path().join(name);
        says(&atomic::check(&path, Overwrite::Replace).unwrap_err().to_string(), parts);
        says(&put(&path, Overwrite::Replace, "x").unwrap_err().to_string(), parts);
    }
    assert_eq!(names(&dir), ["file"]);
}

#[cfg(unix)]
#[test]
fn an_output_is_as_readable_as_any_other_file() {
    use std::os::unix::fs::PermissionsExt;
    let dir = TempDir::new().unwrap();
    let (ours, plain) = (dir.path().join("ours"), dir.path().join("plain"));
    put(&ours, Overwrite::Refuse, "x").unwrap();
    fs::write(&plain, "x").unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&plain));
}

#[test]
fn names_and_devices_that_cannot_become_files_are_said_before_the_work() {
    let dir = TempDir::new().unwrap();
    let long = dir.path().join("a".repeat(300));
    for overwrite in [Overwrite::Refuse, Overwrite::Replace] {
        says(&atomic::check(&long, overwrite).unwrap_err().to_string(), &["aaaa", "shorter name"]);
    }
    #[cfg(target_os = "linux")]
    {
        let error = put(Path::new("/dev/null"), Overwrite::Replace, "x").unwrap_err();
        says(&error.to_string(), &["/dev/null", "is a device"]);
        let error = atomic::check(Path::new("/proc/a.ply"), Overwrite::Refuse).unwrap_err();
        says(&error.to_string(), &["/proc", "write into the folder"]);
    }
    assert_eq!(names(&dir), [""; 0]);
}
