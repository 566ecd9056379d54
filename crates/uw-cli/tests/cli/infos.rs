use std::fs;

use tempfile::TempDir;

use crate::samples::{RIG, blank_capture, edit, keys, uwscan, write_grey};

#[test]
fn a_sound_capture_is_told_with_all_that_it_holds() {
    let dir = blank_capture();
    let path = dir.path().to_str().unwrap();
    let info = uwscan(["info", path, "--json"]).json(0);
    assert_eq!((&info["sound"], &info["kind"]), (&true.into(), &"capture".into()));
    assert_eq!((&info["purpose"], &info["medium"]), (&"calibration".into(), &"air".into()));
    assert_eq!((&info["images"], &info["laser_on"], &info["poses"]), (&8.into(), &4.into(), &4.into()));
    assert_eq!(info["image_size"], serde_json::json!([64, 48]));
    assert_eq!(info["voltage_range_v"], serde_json::json!([0.5, 3.5]));
    let run = uwscan(["info", path]);
    for part in ["sound", "11 x 8 inner corners", "24 mm squares", "64 x 48", "12 mm lens"] {
        assert!(run.text().contains(part), "{part} in {}", run.stdout);
    }
    let by_file =
        uwscan(["info".as_ref(), dir.path().join("capture.toml").as_os_str(), "--json".as_ref()]).json(0);
    assert_eq!(by_file["sha256"], info["sha256"]);
    fs::remove_file(dir.path().join("rig.toml")).unwrap();
    let without = uwscan(["info", path, "--json"]).json(0);
    assert_eq!(without["rig"], false);
    assert!(without["warnings"][0].as_str().unwrap().contains("--rig"), "{without}");
}

#[test]
fn lost_images_end_with_3_and_are_named() {
    let dir = blank_capture();
    fs::remove_file(dir.path().join("images/0.pgm")).unwrap();
    fs::write(dir.path().join("images/3.pgm"), "P5\n64 48\n255\ntorn").unwrap();
    write_grey(&dir.path().join("images/5.pgm"), 64, 47);
    for rig in [true, false] {
        if !rig {
            fs::remove_file(dir.path().join("rig.toml")).unwrap();
        }
        let run = uwscan(["info".as_ref(), dir.path().as_os_str(), "--json".as_ref()]);
        let info = run.json(3);
        assert_eq!(info["sound"], false);
        let lost: Vec<&str> =
            info["lost"].as_array().unwrap().iter().map(|l| l["file"].as_str().unwrap()).collect();
        assert_eq!(lost.len(), 3, "{lost:?}");
        for name in ["images/0.pgm", "images/3.pgm", "images/5.pgm"] {
            assert!(lost.iter().any(|file| file.ends_with(name)), "{name} in {lost:?}");
            assert!(run.stderr.contains(name), "{name} in {}", run.stderr);
        }
    }
    let quiet = uwscan(["info".as_ref(), dir.path().as_os_str(), "-qq".as_ref()]);
    assert_eq!((quiet.code, quiet.stderr.as_str()), (Some(3), ""));
}

#[test]
fn what_is_not_sound_ends_with_1_and_says_so_in_json_too() {
    let dir = blank_capture();
    edit(dir.path(), "frames.csv", "on,0.5", "on,many");
    uwscan(["info".as_ref(), dir.path().as_os_str()]).fails(&["frames.csv:3: voltage_v", "many"]);
    let info = uwscan(["info".as_ref(), dir.path().as_os_str(), "--json".as_ref()]).json(1);
    assert_eq!(keys(&info), ["error", "file", "lost", "sound", "warnings"]);
    assert_eq!(info["sound"], false);
    assert!(info["error"].as_str().unwrap().contains("many"));
}

#[test]
fn a_capture_none_of_whose_images_can_be_decoded_is_not_sound() {
    let dir = blank_capture();
    (0..8).for_each(|i| fs::write(dir.path().join(format!("images/{i}.pgm")), "").unwrap());
    uwscan(["info".as_ref(), dir.path().as_os_str()]).fails(&["none of its 8 images", "empty file"]);
}

#[test]
fn files_are_known_by_what_they_say() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let info = |name: &str| uwscan(["info".as_ref(), path(name).as_os_str(), "--json".as_ref()]);
    fs::write(path("instrument.toml"), RIG).unwrap();
    let rig = info("instrument.toml").json(0);
    assert_eq!((&rig["kind"], &rig["rig"]["camera"]["width"]), (&"rig".into(), &64.into()));
    fs::write(path("instrument.toml"), RIG.replace("bits = 8", "bits = 99")).unwrap();
    assert!(info("instrument.toml").json(1)["error"].as_str().unwrap().contains("camera.bits"));

    fs::write(path("cloud.xyz"), "# frame galvo\n1 2 3\n4 5 -6\n").unwrap();
    let cloud = info("cloud.xyz").json(0);
    assert_eq!(
        (&cloud["kind"], &cloud["points"], &cloud["frame"]),
        (&"cloud".into(), &2.into(), &"galvo".into())
    );
    assert_eq!(
        (&cloud["low_mm"], &cloud["high_mm"]),
        (&serde_json::json!([1.0, 2.0, -6.0]), &serde_json::json!([4.0, 5.0, 3.0]))
    );

    for (name, text, part) in [
        ("other.toml", "format = \"cookbook\"\nversion = 1\n", "cookbook"),
        ("torn.toml", "format = \"uwscan-cal", "torn.toml"),
        ("bare.toml", "", "without `format`"),
        (
            "torn.ply",
            "ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\nxx",
            "torn.ply",
        ),
        ("notes.txt", "hello", "neither a capture folder nor"),
        ("empty.csv", "", "holds no points"),
    ] {
        fs::write(path(name), text).unwrap();
        uwscan(["info".as_ref(), path(name).as_os_str()]).fails(&[name, part]);
    }
    for name in ["nowhere", "nowhere.ply", "nowhere.mcap", "nowhere.toml"] {
        uwscan(["info".as_ref(), path(name).as_os_str()]).fails(&[name, "cannot open", "check the path"]);
    }
}
