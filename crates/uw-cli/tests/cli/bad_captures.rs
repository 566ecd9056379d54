use std::{fs, path::Path};

use tempfile::TempDir;

use crate::samples::{blank_capture, edit, names, part_of, uwscan, write_grey};

/// Calibrates a blank capture that was spoilt; the run must fail with the `parts` and leave nothing behind.
#[track_caller]
fn refused(spoil: impl FnOnce(&Path), parts: &[&str]) {
    let (dir, out) = (blank_capture(), TempDir::new().unwrap());
    spoil(dir.path());
    let file = out.path().join("calibration.toml");
    uwscan(["calibrate".as_ref(), dir.path().as_os_str(), "-o".as_ref(), file.as_os_str()]).fails(parts);
    assert_eq!(names(out.path()), [""; 0], "something was left of an output that failed");
}

/// Spoils one text file by an edit.
#[track_caller]
fn edited(file: &str, from: &str, to: &str, parts: &[&str]) {
    let mut all = vec![file];
    all.extend(parts);
    refused(|dir| edit(dir, file, from, to), &all);
}

#[test]
fn folders_that_are_no_capture() {
    for file in ["frames.csv", "capture.toml", "rig.toml"] {
        refused(
            |dir| fs::remove_file(dir.join(file)).unwrap(),
            &[file, if file == "rig.toml" { "--rig" } else { "check" }],
        );
    }
    refused(
        |dir| fs::remove_dir_all(dir.join("images")).unwrap(),
        &["frames.csv", "none of its 8 images is there"],
    );
    refused(
        |dir| {
            fs::remove_dir_all(dir.join("images")).unwrap();
            fs::write(dir.join("images"), "no folder").unwrap();
        },
        &["images/0.pgm", "cannot find the image", "check the path"],
    );
    refused(|dir| fs::remove_dir_all(dir).unwrap(), &["cannot open the capture", "check the path"]);
    let out = TempDir::new().unwrap();
    let target = out.path().join("c.toml");
    fs::write(out.path().join("scan.mcap"), "x").unwrap();
    let file = out.path().join("scan.mcap");
    uwscan(["calibrate".as_ref(), file.as_os_str(), "-o".as_ref(), target.as_os_str()])
        .fails(&["scan.mcap", "neither a capture folder nor a recording"]);
}

#[test]
fn slips_in_capture_toml() {
    for (from, to, parts) in [
        ("uwscan-capture", "something-else", &["\"something-else\"", "uwscan-capture"][..]),
        ("version = 1", "version = 99", &["99", "update uwscan"]),
        ("version = 1", "version = \"new\"", &["version = 1"]),
        ("kind = \"calibration\"", "kind = \"picnic\"", &[":3:", "picnic", "scan"]),
        ("medium = \"air\"", "medium = \"oil\"", &[":4:", "oil"]),
        ("square_mm = 24.0", "square_mm = nan", &["target.square_mm"]),
        ("[11, 8]", "[11, 8, 3]", &[":8:17: target.inner_corners", "expected 2 values", "write 2 values"]),
        ("[11, 8]", "[11, 1]", &["inner_corners", "at least 3"]),
        ("square_mm", "squaremm", &["squaremm"]),
        ("[target]", "[target", &[":6:"]),
    ] {
        edited("capture.toml", from, to, parts);
    }
    let scan = |dir: &Path| edit(dir, "capture.toml", "\"calibration\"", "\"scan\"");
    refused(scan, &["this capture is a scan", "a calibration is needed"]);
}

#[test]
fn slips_in_frames_csv() {
    for (from, to, parts) in [
        ("on,0.5", "on,volt0.5", &[":3: voltage_v", "volt0.5"][..]),
        ("on,0.5", "on,", &[":3: voltage_v", "missing"]),
        ("on,0.5", "on,inf", &[":3: voltage_v"]),
        ("on,0.5", "dim,0.5", &[":3: laser", "on or off"]),
        ("images/0.pgm,0", "images/0.pgm,first", &[":2: pose", "first"]),
        ("images/0.pgm", "../../../../etc/passwd", &[":2: file", "leads out of the capture folder"]),
        ("images/0.pgm", "/etc/passwd", &[":2: file", "absolute path"]),
        ("images/0.pgm", "images/1.pgm", &[":3: file", "line 2"]),
        ("off,,0", "off,,yesterday", &[":2: stamp_ns", "yesterday"]),
        ("voltage_v", "volts", &[":1:", "voltage_v"]),
        ("images/0.pgm,0,off,,0", "images/0.pgm,0", &[":2:"]),
    ] {
        edited("frames.csv", from, to, parts);
    }
    let header = "file,pose,laser,voltage_v,stamp_ns\n";
    refused(|dir| fs::write(dir.join("frames.csv"), header).unwrap(), &["frames.csv", "names no image"]);
    refused(|dir| fs::write(dir.join("frames.csv"), "").unwrap(), &["frames.csv", "is empty"]);
    refused(|dir| fs::write(dir.join("frames.csv"), [0xff, 0xfe, 0, 1, 2]).unwrap(), &["frames.csv"]);
}

#[test]
fn slips_in_rig_toml() {
    for (from, to, parts) in [
        ("focal_mm = 12.0", "focal_mm = nan", &["camera.focal_mm"][..]),
        ("bits = 8", "bits = 24", &["camera.bits", "24"]),
        ("width = 64", "width = 0", &["camera.width"]),
        ("index = 1.49", "index = -1.49", &["camera.port.index"]),
        ("normal = [0.0, 0.0, 1.0]", "normal = [0.0, 0.0, 0.0]", &["camera.port.normal"]),
        ("degrees_per_volt = 2.0", "degrees_per_volt = 0.0", &["galvo.degrees_per_volt"]),
        ("uwscan-rig", "uwscan-capture", &["uwscan-rig"]),
    ] {
        edited("rig.toml", from, to, parts);
    }
    let (dir, out) = (blank_capture(), TempDir::new().unwrap());
    let (rig, target) = (out.path().join("other.toml"), out.path().join("c.toml"));
    let args = ["calibrate".as_ref(), dir.path().as_os_str(), "--rig".as_ref(), rig.as_os_str()];
    uwscan(args.into_iter().chain(["-o".as_ref(), target.as_os_str()]))
        .fails(&["other.toml", "check the path"]);
}

#[test]
fn images_that_no_camera_made() {
    let all =
        |dir: &Path, spoil: &dyn Fn(&Path)| (0..8).for_each(|i| spoil(&dir.join(format!("images/{i}.pgm"))));
    refused(|dir| all(dir, &|image| fs::write(image, "").unwrap()), &["none of its images could be used"]);
    refused(
        |dir| all(dir, &|image| fs::write(image, "P5\n64 48\n255\nhalf").unwrap()),
        &["none of its images"],
    );
    refused(|dir| all(dir, &|image| write_grey(image, 65, 48)), &["none of its images"]);
    // Sound images, but nothing is on them.
    refused(|_| (), &["11 x 8", "no chessboard was found in any of 4 images", "inner_corners"]);
}

#[test]
fn a_board_of_another_size_is_named_by_what_is_seen() {
    let dir = part_of("cal-air", |_, row| row.contains(",off,"));
    edit(dir.path(), "capture.toml", "[11, 8]", "[17, 13]");
    let out = TempDir::new().unwrap();
    let target = out.path().join("calibration.toml");
    let run = uwscan(["calibrate".as_ref(), dir.path().as_os_str(), "-o".as_ref(), target.as_os_str()]);
    run.fails(&["17 x 13", "11 x 8", dir.path().to_str().unwrap()]);
    assert_eq!(names(out.path()), [""; 0]);
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_work() {
    let (dir, out) = (blank_capture(), TempDir::new().unwrap());
    let calibrate = |target: &Path| {
        uwscan(["calibrate".as_ref(), dir.path().as_os_str(), "-o".as_ref(), target.as_os_str()])
    };
    calibrate(out.path()).fails(&["is a folder"]);
    calibrate(&out.path().join("nowhere/c.toml")).fails(&["there is no such folder"]);
    let taken = out.path().join("taken.toml");
    fs::write(&taken, "precious").unwrap();
    let run = calibrate(&taken);
    run.fails(&["taken.toml", "--force"]);
    assert!(!run.stderr.contains("boards"), "work began: {}", run.stderr);
    // Even with leave to replace it, a run that fails leaves it as it was.
    let args = ["calibrate".as_ref(), dir.path().as_os_str(), "--force".as_ref()];
    uwscan(args.into_iter().chain(["-o".as_ref(), taken.as_os_str()])).fails(&["no chessboard was found"]);
    assert_eq!(fs::read_to_string(&taken).unwrap(), "precious");
}

#[test]
fn warnings_are_told_though_the_run_fails() {
    let (dir, out) = (blank_capture(), TempDir::new().unwrap());
    edit(dir.path(), "rig.toml", "focal_mm = 12.0", "focal_mm = 0.012");
    fs::write(dir.path().join("images/0.pgm"), "").unwrap();
    let target = out.path().join("c.toml");
    let calibrate =
        || uwscan(["calibrate".as_ref(), dir.path().as_os_str(), "-o".as_ref(), target.as_os_str()]);
    let told = |stderr: &str, parts: &[&str]| {
        let line = |part: &&str| {
            assert!(
                stderr.lines().any(|l| l.starts_with("warning: ") && l.contains(*part)),
                "{part}: {stderr}"
            );
        };
        parts.iter().for_each(line);
    };
    let run = calibrate();
    run.fails(&["no chessboard was found in any of 3 images"]);
    told(
        &run.stderr,
        &["focal_mm: 0.012 mm is an unusual", "lost: ", "0.pgm: is an empty file", "rejected: "],
    );
    edit(dir.path(), "frames.csv", "on,0.5", "dim,0.5");
    let run = calibrate();
    run.fails(&["frames.csv:3: laser"]);
    told(&run.stderr, &["focal_mm: 0.012 mm is an unusual"]);
    let info = uwscan(["info".as_ref(), dir.path().as_os_str(), "--json".as_ref()]).json(1);
    assert!(info["error"].as_str().unwrap().contains("frames.csv:3: laser"), "{info}");
    assert!(info["warnings"][0].as_str().unwrap().contains("focal_mm"), "{info}");
}

#[cfg(unix)]
#[test]
fn a_name_that_is_no_utf8_is_still_a_name() {
    use std::os::unix::ffi::OsStrExt;
    let dir = TempDir::new().unwrap();
    let file = dir.path().join(std::ffi::OsStr::from_bytes(b"\xff.xyz"));
    fs::write(&file, "1 2 3\n").unwrap();
    let info = uwscan(["info".as_ref(), file.as_os_str(), "--json".as_ref()]).json(0);
    assert!(info["file"].as_str().unwrap().ends_with(".xyz"), "{info}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_device_is_not_replaced() {
    let dir = blank_capture();
    let args = ["calibrate".as_ref(), dir.path().as_os_str(), "--force".as_ref(), "-o".as_ref()];
    let run = uwscan(args.into_iter().chain(["/dev/full".as_ref()]));
    run.fails(&["/dev/full", "is a device"]);
    assert!(!run.stderr.contains("boards"), "work began: {}", run.stderr);
}
