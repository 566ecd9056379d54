use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use tempfile::TempDir;

use crate::{
    job::calibration,
    samples::{part_of, uwscan},
};

/// Two short sweeps over the ball, one in a folder of its own, and a recording that is none.
fn archive(dir: &TempDir) -> PathBuf {
    let archive = dir.path().join("archive");
    for (name, first) in [("one", 10), ("deep/two", 20)] {
        let part = part_of("ball", |row, _| (first..first + 8).contains(&row));
        fs::create_dir_all(archive.join(name).join("images")).unwrap();
        for entry in ["capture.toml", "rig.toml", "frames.csv"] {
            fs::copy(part.path().join(entry), archive.join(name).join(entry)).unwrap();
        }
        for image in fs::read_dir(part.path().join("images")).unwrap() {
            let image = image.unwrap();
            fs::copy(image.path(), archive.join(name).join("images").join(image.file_name())).unwrap();
        }
    }
    fs::write(archive.join("torn.mcap"), b"\x89MCAP0\r\n, and then nothing that can be read").unwrap();
    archive
}

fn status<'v>(batch: &'v Value, recording: &str) -> &'v Value {
    let results = batch["results"].as_array().unwrap();
    &results.iter().find(|r| r["recording"] == recording).unwrap()["status"]
}

fn modified(path: &Path) -> std::time::SystemTime {
    fs::metadata(path).unwrap().modified().unwrap()
}

#[test]
fn an_archive_is_done_around_what_is_corrupt_and_a_second_run_does_what_is_missing() {
    let dir = TempDir::new().unwrap();
    let (archive, out) = (archive(&dir), dir.path().join("out"));
    let calibration = calibration();
    let args = |more: &[&str]| {
        let mut args = vec![
            "batch",
            archive.to_str().unwrap(),
            "-c",
            &calibration,
            "-o",
            out.to_str().unwrap(),
            "--json",
        ];
        args.extend(more);
        args.into_iter().map(str::to_owned).collect::<Vec<_>>()
    };
    let first = uwscan(args(&[])).json(3);
    assert_eq!(
        (&first["done"], &first["failed"], &first["kept"]),
        (&2.into(), &1.into(), &0.into()),
        "{first}"
    );
    assert_eq!(status(&first, "torn.mcap"), "failed");
    let table = fs::read_to_string(out.join("table.csv")).unwrap();
    assert_eq!(table.lines().count(), 4, "{table}");

    // What reconstruct makes of one by itself.
    let alone = dir.path().join("alone.ply");
    let one = archive.join("one");
    let run =
        uwscan(["reconstruct", one.to_str().unwrap(), "-c", &calibration, "-o", alone.to_str().unwrap()]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(fs::read(out.join("one.ply")).unwrap(), fs::read(&alone).unwrap());

    let (kept, redone) = (out.join("one.ply"), out.join("deep/two.ply"));
    let before = modified(&kept);
    fs::remove_file(&redone).unwrap();
    let second = uwscan(args(&[])).json(3);
    assert_eq!((&second["done"], &second["kept"]), (&2.into(), &1.into()), "{second}");
    assert!(redone.is_file());
    assert_eq!(modified(&kept), before);

    // Other settings are another key.
    let third = uwscan(args(&["--frame", "galvo"])).json(3);
    assert_eq!(third["kept"], 0, "{third}");
}

#[test]
fn a_folder_without_recordings_and_one_of_which_nothing_comes_fail() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("out");
    let calibration = calibration();
    let folder = dir.path().to_str().unwrap();
    uwscan(["batch", folder, "-c", &calibration, "-o", out.to_str().unwrap()]).fails(&["no recording"]);
    fs::write(dir.path().join("torn.mcap"), b"nothing \xff\xff").unwrap();
    let torn = dir.path().join("torn.mcap");
    uwscan(["batch", folder, "-c", torn.to_str().unwrap(), "-o", out.to_str().unwrap()])
        .fails(&["torn.mcap:1", "is not UTF-8 text"]);
    let run = uwscan(["batch", folder, "-c", &calibration, "-o", out.to_str().unwrap()]);
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("none of its recordings"), "{}", run.stderr);
}
