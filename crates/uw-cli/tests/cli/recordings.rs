//! Recordings wherever a capture is taken; `convert` and `recover`.

use std::{fs, path::Path};

use tempfile::TempDir;

use crate::{
    job::{calibration, reconstruct, thinned},
    samples::{Run, blank_capture, fixture, keys, part_of, uwscan},
};

fn convert(from: &Path, to: &Path) -> Run {
    uwscan(["convert", from.to_str().unwrap(), to.to_str().unwrap()])
}

#[test]
fn a_recording_gives_the_cloud_of_its_folder_bit_for_bit() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let made = convert(&fixture("ball"), &path("ball.mcap"));
    assert!(made.text().contains("images"), "{}", made.stdout);
    reconstruct(&fixture("ball"), &path("folder.ply"), &[]).text();
    reconstruct(&path("ball.mcap"), &path("recording.ply"), &[]).text();
    assert_eq!(fs::read(path("folder.ply")).unwrap(), fs::read(path("recording.ply")).unwrap());

    let info = uwscan(["info", path("ball.mcap").to_str().unwrap(), "--json"]).json(0);
    assert_eq!((&info["kind"], &info["purpose"]), (&"capture".into(), &"scan".into()));
    assert_eq!(info["recording"]["topics"]["/camera/image"], info["images"]);
    assert_eq!(keys(&info["recording"]["topics"]), ["/camera/image", "/scan/frame"]);
    convert(&path("ball.mcap"), &path("back")).text();
    reconstruct(&path("back"), &path("back.ply"), &[]).text();
    assert_eq!(fs::read(path("folder.ply")).unwrap(), fs::read(path("back.ply")).unwrap());

    // Torn in the middle: what is left is used, and said; recovered, it is the same again.
    let bytes = fs::read(path("ball.mcap")).unwrap();
    fs::write(path("torn.mcap"), &bytes[..bytes.len() * 3 / 5]).unwrap();
    let torn = uwscan(["info", path("torn.mcap").to_str().unwrap()]);
    assert_eq!(torn.code, Some(3), "{}", torn.stderr);
    for said in ["was cut off: after byte", "frames that were planned are missing"] {
        assert!(torn.stderr.contains(said), "{}", torn.stderr);
    }
    let torn = reconstruct(&path("torn.mcap"), &path("torn.ply"), &["--json"]).json(3);
    assert!(torn["lost"][0]["reason"].as_str().unwrap().contains("torn.mcap"), "{torn}");
    let recover = |to: &Path| {
        uwscan(["recover", path("torn.mcap").to_str().unwrap(), "-o", to.to_str().unwrap(), "--json"])
    };
    let recovered = recover(&path("whole.mcap")).json(3);
    assert!(recovered["messages"].as_u64().unwrap() > 10, "{recovered}");
    recover(&path("whole.mcap")).fails(&["exists already"]);
    let whole = reconstruct(&path("whole.mcap"), &path("whole.ply"), &["--json"]).json(3);
    assert_eq!(whole["points"], torn["points"]);
    assert_eq!(fs::read(path("torn.ply")).unwrap(), fs::read(path("whole.ply")).unwrap());
}

#[test]
fn a_calibration_from_recordings_is_that_from_their_folders() {
    let dir = TempDir::new().unwrap();
    let mut args = vec!["calibrate".to_owned()];
    for name in ["cal-air", "cal-water"] {
        let recording = dir.path().join(name).with_extension("mcap");
        convert(part_of(name, thinned).path(), &recording).text();
        args.push(recording.to_str().unwrap().to_owned());
    }
    let target = dir.path().join("calibration.toml");
    args.extend(["-o".to_owned(), target.to_str().unwrap().to_owned()]);
    assert_eq!(uwscan(&args).code, Some(0));
    // What the captures are called and their hashes aside.
    let figures = |path: &Path| {
        let text = fs::read_to_string(path).unwrap();
        let figures = |line: &&str| {
            line.contains(" = ") && !["name", "sha256", "image", "file"].iter().any(|key| line.contains(key))
        };
        text.lines().filter(figures).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(figures(&target), figures(Path::new(&calibration())));
}

/// What a recording holds of an image is no longer what was recorded, and its records are whole all the same.
#[test]
fn a_damaged_image_is_kept_and_told_of_by_recover() {
    let (dir, capture) = (TempDir::new().unwrap(), blank_capture());
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (damaged, kept) = (path("damaged.mcap"), path("kept.mcap"));
    convert(capture.path(), Path::new(&damaged)).text();
    assert!(uwscan(["recover", &damaged, "-o", &kept]).text().contains("nothing was missing or damaged"));
    let mut bytes = fs::read(&damaged).unwrap();
    // The first image's texture begins so.
    let pixels = bytes.windows(8).position(|eight| eight == [40, 47, 43, 50, 46, 42, 49, 45]).unwrap();
    bytes[pixels + 20] ^= 0xff;
    fs::write(&damaged, bytes).unwrap();
    let run = uwscan(["recover", &damaged, "-o", &kept, "--force", "--json"]);
    let lost = &run.json(3)["lost"];
    assert_eq!(lost.as_array().unwrap().len(), 1, "{lost}");
    assert!(run.stderr.contains("images/0.pgm") && run.stderr.contains("CRC-32"), "{}", run.stderr);
    let info = uwscan(["info", &kept, "--json"]).json(3);
    assert_eq!((&info["images"], info["lost"].as_array().unwrap().len()), (&8.into(), 1), "{info}");
    assert!(info["warnings"][0].as_str().unwrap().contains("the figures count all rows"), "{info}");
}

#[test]
fn what_cannot_be_converted_is_said() {
    let (dir, capture) = (TempDir::new().unwrap(), blank_capture());
    let path = |name: &str| dir.path().join(name);
    for name in ["nowhere", "nowhere.ply", "nowhere.stl", "nowhere.toml"] {
        convert(&path(name), &path("x.mcap")).fails(&[name, "cannot open", "check the path"]);
    }
    fs::write(capture.path().join("calibration.toml"), [0xff, 0xfe]).unwrap();
    convert(capture.path(), &path("c.mcap")).fails(&["calibration.toml:1", "is not UTF-8 text"]);
    fs::remove_file(capture.path().join("calibration.toml")).unwrap();
    convert(capture.path(), &path("there")).fails(&["becomes a recording", ".mcap"]);
    convert(capture.path(), &path("c.mcap")).text();
    convert(capture.path(), &path("c.mcap")).fails(&["exists already", "--force"]);
    convert(&path("c.mcap"), &path("back")).text();
    convert(&path("c.mcap"), &path("back")).fails(&["exists already", "new folder"]);
    assert_eq!(
        fs::read_to_string(path("back").join("frames.csv")).unwrap(),
        fs::read_to_string(capture.path().join("frames.csv")).unwrap()
    );
    fs::write(path("no.mcap"), "MCAP").unwrap();
    convert(&path("no.mcap"), &path("x")).fails(&["no.mcap", "neither a capture folder nor a recording"]);
    uwscan(["recover", path("no.mcap").to_str().unwrap(), "-o", path("y.mcap").to_str().unwrap()])
        .fails(&["no.mcap"]);
    assert!(!path("y.mcap").exists() && !path("x").exists());
    fs::write(path("a.xyz"), "1 2 3\n4 5 6\n").unwrap();
    assert!(convert(&path("a.xyz"), &path("a.ply")).stdout.contains("2 points"));
}
