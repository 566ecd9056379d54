use std::fs;

use proptest::prelude::*;
use tempfile::TempDir;
use uw_io::{Capture, Error, Kind, Medium, Severity, capture::Pattern};

use crate::samples::{CAPTURE, FRAMES, RIG, capture, edit, says, write};

/// The message that opening ends with once one text file has been changed.
fn refusal(file: &str, text: impl AsRef<[u8]>) -> String {
    let dir = capture();
    write(dir.path(), file, text);
    let message = Capture::open(dir.path()).unwrap_err().to_string();
    says(&message, &[dir.path().join(file).to_str().unwrap()]);
    message
}

/// The capture once frames.csv has been changed, with its problems as text.
fn opened(frames: impl AsRef<[u8]>) -> (TempDir, Capture, Vec<String>) {
    let dir = capture();
    write(dir.path(), "frames.csv", frames);
    let capture = Capture::open(dir.path()).unwrap();
    let problems = capture.problems().iter().map(ToString::to_string).collect();
    (dir, capture, problems)
}

#[test]
fn a_sound_capture_is_read_whole() {
    let (dir, capture, problems) = opened(FRAMES);
    assert_eq!(problems, [""; 0]);
    assert_eq!((capture.kind, capture.medium), (Kind::Calibration, Medium::Water));
    let target = capture.target.as_ref().unwrap();
    assert_eq!(
        (target.pattern, target.inner_corners, target.wavelength_nm),
        (Pattern::Chessboard, [11, 8], None)
    );
    assert_eq!(target.square_mm.to_bits(), 24.0_f64.to_bits());
    assert_eq!(capture.rig.as_ref().unwrap().camera.width, 8);
    let rows: Vec<_> =
        capture.frames.iter().map(|f| (f.row, f.line, f.pose, f.laser_on, f.voltage_v)).collect();
    assert_eq!(
        rows,
        [
            (0, 2, Some(0), false, None),
            (1, 3, Some(0), true, Some(-2.225)),
            (2, 4, Some(1), false, None),
            (3, 5, Some(1), true, Some(1.5))
        ]
    );
    assert_eq!(capture.frames[3].stamp_ns, 1_700_000_000_120_000_000);
    assert_eq!(capture.image_path(&capture.frames[2]), dir.path().join("images/2.png"));
    assert_eq!(capture.present().count(), 4);
}

#[test]
fn what_editors_and_spreadsheets_do_changes_nothing() {
    let (_a, plain, _) = opened(FRAMES);
    let spaced = FRAMES.replace(',', " , ");
    let reordered: String = FRAMES
        .lines()
        .map(|l| {
            let f: Vec<_> = l.split(',').collect();
            format!("{},{},\"{}\",{},{}\n", f[4], f[2], f[0], f[3], f[1])
        })
        .collect();
    for variant in [
        format!("\u{feff}{FRAMES}"),
        FRAMES.replace('\n', "\r\n"),
        FRAMES.trim_end().to_owned(),
        FRAMES.replace("file,pose,laser", "File,Pose,Laser").replace("on", "ON"),
        spaced,
        reordered,
        format!("{FRAMES},,,,\n"),
    ] {
        let (_dir, capture, problems) = opened(&variant);
        assert_eq!(problems, [""; 0], "{variant}");
        assert_eq!(capture.frames, plain.frames, "{variant}");
    }
    let (_dir, capture, _) = opened(FRAMES.replace('\n', "\n\n"));
    assert_eq!((capture.frames[3].row, capture.frames[3].line), (3, 9), "blank lines are no rows, but lines");
    let dir = self::capture();
    write(dir.path(), "capture.toml", format!("\u{feff}{}", CAPTURE.replace('\n', "\r\n")));
    assert_eq!(Capture::open(dir.path()).unwrap().frames, plain.frames);
}

#[test]
fn each_slip_in_frames_csv_is_named_with_its_line_and_column() {
    let row = |from: &str, to: &str| edit(FRAMES, from, to);
    let cases: &[(String, &[&str])] = &[
        (String::new(), &["is empty", "file,pose,laser,voltage_v,stamp_ns"]),
        (FRAMES[..FRAMES.find('\n').unwrap()].into(), &["names no image", "one row an image"]),
        (FRAMES[FRAMES.find('\n').unwrap() + 1..].into(), &[":1:", "no column file", "first line must be"]),
        (FRAMES.replace(',', ";"), &[":1:", "commas"]),
        (FRAMES.replace(',', "\t"), &[":1:", "commas"]),
        (row("pose", "file"), &[":1: file", "twice"]),
        (row("voltage_v", "voltage"), &[":1:", "no column voltage_v"]),
        (row("-2.2250", "volt-2.2250"), &[":3: voltage_v", "\"volt-2.2250\" is no voltage", "-1.25"]),
        (row("-2.2250", "nan"), &[":3: voltage_v", "\"nan\""]),
        (row("-2.2250", "1e999"), &[":3: voltage_v"]),
        (row("-2.2250", ""), &[":3: voltage_v", "missing", "laser is on"]),
        (row("-2.2250", "\"-2,2250\""), &[":3: voltage_v", "-2,2250"]),
        (row("-2.2250", "-2,2250"), &[":3:", "has 6 fields, the header 5"]),
        (row("1.5,17", "17"), &[":5:", "has 4 fields, the header 5"]),
        (row(",off,,", ",off,inf,"), &[":2: voltage_v", "\"inf\""]),
        (row("images/2.png,1", "images/2.png,"), &[":4: pose", "needs the number"]),
        (row("images/2.png,1", "images/2.png,-1"), &[":4: pose", "\"-1\"", "0, 1"]),
        (row("images/2.png,1", "images/2.png,1.5"), &[":4: pose", "\"1.5\""]),
        (row("images/2.png,1", "images/2.png,4294967296"), &[":4: pose"]),
        (row("1,on", "1,yes"), &[":5: laser", "neither on nor off"]),
        (row("1700000000120000000", "soon"), &[":5: stamp_ns", "\"soon\"", "nanoseconds"]),
        (row("1700000000120000000", "-5"), &[":5: stamp_ns"]),
        (row("1700000000120000000", "1.7e18"), &[":5: stamp_ns"]),
        (row("images/3.png", "images/./1.png"), &[":5: file", "line 3 already"]),
        (row("images/3.png", "../3.png"), &[":5: file", "out of the capture folder"]),
        (row("images/3.png", "images/../../3.png"), &[":5: file", "out of the capture folder"]),
        (row("images/3.png", "images\\..\\..\\3.png"), &[":5: file", "out of the capture folder"]),
        (row("images/3.png", "/etc/passwd"), &[":5: file", "absolute"]),
        (row("images/3.png", "C:\\images\\3.png"), &[":5: file", "absolute"]),
        (row("images/3.png", ""), &[":5: file", "names no image"]),
        (row("images/3.png", "."), &[":5: file", "names no image"]),
        (FRAMES.replace("images/", "pictures/"), &["none of its 4 images"]),
    ];
    for (text, parts) in cases {
        says(&refusal("frames.csv", text), parts);
    }
    says(&refusal("frames.csv", b"file,pose\n\xff\xfe,1"), &[":2:", "UTF-8"]);
}

#[test]
fn oddities_are_warned_of_once_and_gone_on_with() {
    let twice = FRAMES.replace(",off,,", ",off,0.5,");
    let (_dir, capture, problems) = opened(twice);
    assert_eq!(problems.len(), 1, "{problems:?}");
    says(&problems[0], &[":2: voltage_v", "laser is off", "2 rows"]);
    assert_eq!(capture.frames[0].voltage_v, None);

    let (_dir, _, problems) = opened(edit(FRAMES, "1700000000040000000", "1600000000000000000"));
    says(&problems[0], &[":3: stamp_ns", "earlier"]);
    let (_dir, _, problems) = opened(edit(FRAMES, "1,off", "2,off"));
    says(&problems[0], &[":5: pose", "pose 1 has stripes but no image of the target"]);
    let (_dir, _, problems) = opened(edit(FRAMES, "-2.2250", "-12.5"));
    says(&problems[0], &[":3: voltage_v", "-12.5 V is outside", "[-10, 10]", "1 such"]);
    let (_dir, _, problems) = opened(FRAMES.replace('\n', ",1\n").replacen(",1\n", ",exposur\n", 1));
    assert_eq!(problems.len(), 1);
    says(&problems[0], &[":1: exposur", "unknown column"]);
}

#[test]
fn a_scan_has_neither_target_nor_poses() {
    let dir = capture();
    write(dir.path(), "capture.toml", CAPTURE.replace("calibration", "scan"));
    let scan = Capture::open(dir.path()).unwrap();
    assert_eq!(scan.target, None);
    assert!(scan.frames.iter().all(|f| f.pose.is_none()));
    let problems: Vec<_> = scan.problems().iter().map(ToString::to_string).collect();
    assert_eq!(problems.len(), 2, "{problems:?}");
    says(&problems[0], &["capture.toml:6:2: target", "ignored"]);
    says(&problems[1], &["frames.csv:2: pose", "4 rows"]);

    write(
        dir.path(),
        "capture.toml",
        CAPTURE[..CAPTURE.find("[target]").unwrap()].replace("calibration", "scan"),
    );
    write(dir.path(), "frames.csv", FRAMES.replace(".png,0", ".png,").replace(".png,1", ".png,"));
    assert_eq!(Capture::open(dir.path()).unwrap().problems().len(), 0);
}

#[test]
fn lost_images_are_told_one_by_one_and_the_rest_is_kept() {
    let dir = capture();
    fs::remove_file(dir.path().join("images/1.png")).unwrap();
    fs::remove_file(dir.path().join("images/3.png")).unwrap();
    fs::create_dir(dir.path().join("images/3.png")).unwrap();
    let capture = Capture::open(dir.path()).unwrap();
    let lost: Vec<_> = capture.problems().iter().map(|p| (p.severity, p.row)).collect();
    assert_eq!(lost, [(Severity::Loss, Some(1)), (Severity::Loss, Some(3))]);
    says(&capture.problems()[0].to_string(), &["images/1.png", "is missing", "line 3 of frames.csv"]);
    says(&capture.problems()[1].to_string(), &["images/3.png", "is a folder", "line 5 of frames.csv"]);
    assert_eq!(capture.present().map(|f| f.row).collect::<Vec<_>>(), [0, 2]);
    assert_eq!(capture.frames.len(), 4, "rows keep their numbers");

    let (_dir, capture, problems) = opened(FRAMES.replacen("images/", "images\\", 1));
    says(&problems[0], &["write / between folders"]);
    assert_eq!(capture.present().count(), 3);
}

#[cfg(unix)]
#[test]
fn links_may_not_lead_out_of_the_folder() {
    use std::os::unix::fs::symlink;
    let other = capture();
    let dir = capture();
    let image = dir.path().join("images/2.png");
    fs::remove_file(&image).unwrap();
    symlink(other.path().join("images/2.png"), &image).unwrap();
    let message = Capture::open(dir.path()).unwrap_err().to_string();
    says(&message, &["frames.csv:4: file", "symbolic link"]);

    fs::remove_file(&image).unwrap();
    symlink("3.png", &image).unwrap();
    assert_eq!(Capture::open(dir.path()).unwrap().problems().len(), 0, "a link inside the folder is fine");

    fs::remove_file(&image).unwrap();
    symlink("2.png", &image).unwrap();
    let capture = Capture::open(dir.path()).unwrap();
    assert_eq!(capture.problems()[0].severity, Severity::Loss, "a link to itself is a lost image");

    let link = other.path().join("link");
    symlink(dir.path(), &link).unwrap();
    assert_eq!(Capture::open(&link).unwrap().frames.len(), 4, "the folder itself may be reached by a link");
}

#[test]
fn each_slip_in_capture_toml_is_named_with_its_line() {
    let cases: &[(String, &[&str])] = &[
        (String::new(), &["a file without `format`", "format = \"uwscan-capture\""]),
        (
            edit(CAPTURE, "uwscan-capture", "something-else"),
            &[":1:1: format", "\"something-else\"", "uwscan-capture"],
        ),
        (edit(CAPTURE, "\"uwscan-capture\"", "3"), &[":1:1: format"]),
        (edit(CAPTURE, "version = 1", "version = 99"), &[":2:1: version", "99", "newer", "update"]),
        (edit(CAPTURE, "version = 1", "version = 0"), &[":2:1: version", "whole number"]),
        (edit(CAPTURE, "version = 1", "version = \"1\""), &[":2:1: version", "version = 1"]),
        (edit(CAPTURE, "version = 1\n", ""), &["version"]),
        (edit(CAPTURE, "\"calibration\"", "\"calibratoin\""), &[":3:", "did you mean \"calibration\"?"]),
        (edit(CAPTURE, "\"calibration\"", "calibration"), &[":3:"]),
        (edit(CAPTURE, "medium  = \"water\"\n", ""), &["medium"]),
        (edit(CAPTURE, "\"water\"", "\"mud\""), &[":4:", "mud", "air"]),
        (edit(CAPTURE, "square_mm ", "squar_mm "), &[":9:1", "squar_mm", "did you mean `square_mm`?"]),
        (edit(CAPTURE, "24.0", "0.0"), &[":9:1: target.square_mm", "0 is no square's side"]),
        (edit(CAPTURE, "24.0", "nan"), &[":9:1: target.square_mm"]),
        (edit(CAPTURE, "24.0", "\"24\""), &[":9:", "invalid type"]),
        (edit(CAPTURE, "[11, 8]", "[11]"), &[":8:", "length"]),
        (edit(CAPTURE, "[11, 8]", "[11, -8]"), &[":8:"]),
        (edit(CAPTURE, "[11, 8]", "[11, 8, 3]"), &[":8:", "length 3"]),
        (edit(CAPTURE, "[11, 8]", "[11, 2]"), &[":8:1: target.inner_corners", "11 x 2"]),
        (edit(CAPTURE, "[11, 8]", "[11, 80000]"), &[":8:1: target.inner_corners"]),
        (edit(CAPTURE, "chessboard", "charuco"), &[":7:", "charuco", "chessboard"]),
        (CAPTURE[..CAPTURE.find("[target]").unwrap()].into(), &["target", "inner_corners"]),
        (format!("{CAPTURE}wavelength_nm = -5.0"), &[":10:1: target.wavelength_nm"]),
        (edit(CAPTURE, "[target]", "[target"), &[":6:"]),
        (format!("{CAPTURE}square_mm = 3.0"), &[":10:", "duplicate"]),
    ];
    for (text, parts) in cases {
        says(&refusal("capture.toml", text), parts);
    }
}

#[test]
fn what_is_no_capture_folder_is_said_so() {
    let dir = capture();
    let open = |name: &str| Capture::open(&dir.path().join(name)).unwrap_err();
    assert!(matches!(open("nowhere"), Error::File { .. }));
    says(&open("nowhere").to_string(), &["nowhere", "cannot open the capture", "check the path"]);
    says(&open("rig.toml").to_string(), &["rig.toml", "neither a capture folder nor a recording"]);
    says(&open("images").to_string(), &["capture.toml", "cannot open"]);
    fs::remove_file(dir.path().join("frames.csv")).unwrap();
    says(&open("").to_string(), &["frames.csv", "cannot open"]);
}

#[test]
fn warnings_outlive_the_error_that_comes_after_them() {
    let dir = capture();
    let rig = edit(RIG, "focal_mm = 12.0", "focal_mm = 0.012");
    write(dir.path(), "rig.toml", rig);
    let mut noted = Vec::new();
    let sound = Capture::open_noting(dir.path(), None, &mut noted).unwrap();
    assert_eq!((sound.problems().len(), noted.len()), (1, 0));
    write(dir.path(), "frames.csv", "file\n");
    Capture::open_noting(dir.path(), None, &mut noted).unwrap_err();
    assert_eq!(noted.len(), 1);
    says(&noted[0].to_string(), &["rig.toml:8:1: camera.focal_mm", "0.012 mm"]);
}

#[test]
fn another_rig_replaces_the_captures_own_unread() {
    let dir = capture();
    let other = dir.path().join("other.toml");
    fs::write(&other, edit(RIG, "focal_mm = 12.0", "focal_mm = 16.0")).unwrap();
    write(dir.path(), "rig.toml", "nonsense");
    assert!(Capture::open(dir.path()).is_err());
    let capture = Capture::open_with_rig(dir.path(), Some(&other)).unwrap();
    assert_eq!(capture.rig.unwrap().camera.focal_mm.to_bits(), 16.0_f64.to_bits());
    fs::remove_file(dir.path().join("rig.toml")).unwrap();
    assert_eq!(Capture::open(dir.path()).unwrap().rig, None);
}

#[test]
fn the_hash_follows_the_content_and_nothing_else() {
    let hash = |dir: &TempDir| Capture::open(dir.path()).unwrap().content_hash().unwrap();
    let (a, b) = (capture(), capture());
    let before = hash(&a);
    assert_eq!(before.len(), 64);
    assert_eq!(before, hash(&b), "the folder's name doesn't count");
    write(a.path(), "notes.txt", "a file that isn't named doesn't count");
    assert_eq!(before, hash(&a));

    let mut hashes = vec![before];
    let original = fs::read(a.path().join("images/3.png")).unwrap();
    let mut changed = original.clone();
    *changed.last_mut().unwrap() ^= 1;
    write(a.path(), "images/3.png", changed);
    hashes.push(hash(&a));
    fs::remove_file(a.path().join("images/3.png")).unwrap();
    hashes.push(hash(&a));
    write(a.path(), "images/3.png", []);
    hashes.push(hash(&a));
    write(a.path(), "images/3.png", original);
    write(a.path(), "rig.toml", format!("{RIG}\n"));
    hashes.push(hash(&a));
    fs::remove_file(a.path().join("rig.toml")).unwrap();
    hashes.push(hash(&a));
    write(a.path(), "frames.csv", FRAMES.replace("1.5", "1.50"));
    hashes.push(hash(&a));
    let count = hashes.len();
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), count, "each change gives another hash");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Voltages come back bit for bit, stamps whole, poses as written.
    #[test]
    fn rows_come_back_as_written(
        rows in prop::collection::vec((any::<u32>(), -10.0..10.0_f64, any::<u64>(), any::<bool>()), 1..20)
    ) {
        let dir = capture();
        let mut text = String::from("file,pose,laser,voltage_v,stamp_ns\n");
        for (n, (pose, voltage, stamp, on)) in rows.iter().enumerate() {
            let name = format!("images/{n}, \"é\".png");
            write(dir.path(), &name, "");
            let voltage = on.then(|| voltage.to_string()).unwrap_or_default();
            let laser = if *on { "on" } else { "off" };
            text += &format!("\"{}\",{pose},{laser},{voltage},{stamp}\n", name.replace('"', "\"\""));
        }
        write(dir.path(), "frames.csv", text);
        let capture = Capture::open(dir.path()).unwrap();
        prop_assert_eq!(capture.frames.len(), rows.len());
        for (n, (frame, (pose, voltage, stamp, on))) in capture.frames.iter().zip(&rows).enumerate() {
            prop_assert_eq!(&frame.file, &format!("images/{n}, \"é\".png"));
            prop_assert_eq!((frame.row, frame.pose, frame.stamp_ns, frame.laser_on), (n, Some(*pose), *stamp, *on));
            prop_assert_eq!(frame.voltage_v.map(f64::to_bits), on.then_some(voltage.to_bits()));
        }
    }

    /// Whatever the files hold, opening returns.
    #[test]
    fn rubbish_is_refused_without_a_panic(frames in "[a-z0-9,\"\n\r./\\\\-]{0,200}", head in "[a-z=\\[\\]\"\n .0-9]{0,80}") {
        let dir = capture();
        write(dir.path(), "frames.csv", format!("file,pose,laser,voltage_v,stamp_ns\n{frames}"));
        if let Ok(capture) = Capture::open(dir.path()) {
            prop_assert!(!capture.frames.is_empty());
        }
        write(dir.path(), "frames.csv", frames);
        prop_assert!(Capture::open(dir.path()).is_err());
        write(dir.path(), "capture.toml", format!("format = \"uwscan-capture\"\nversion = 1\n{head}"));
        prop_assert!(Capture::open(dir.path()).is_err());
    }
}
