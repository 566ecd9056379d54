//! A calibration's camera as ROS's and OpenCV's YAML. scripts/recordings.sh shows it to readers that are not ours.

use std::fs;

use tempfile::TempDir;

use crate::{
    job::calibration,
    samples::{fixture, uwscan},
};

/// The same numbers, but for the last place, which `serde_json` may lose as it reads.
fn same(left: &[f64], right: &[f64]) {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 4.0 * f64::EPSILON * b.abs();
    assert!(left.len() == right.len() && left.iter().zip(right).all(near), "{left:?} {right:?}");
}

/// The numbers of a matrix in such a file.
fn matrix(text: &str, name: &str) -> Vec<f64> {
    let after = &text[text.find(&format!("{name}:")).unwrap()..];
    let (_, data) = after.split_once("data: [").unwrap();
    let (data, _) = data.split_once(']').unwrap();
    data.split(',').map(|number| number.trim().parse().unwrap()).collect()
}

#[test]
fn a_calibrations_camera_goes_out_as_ros_and_as_opencv_and_what_is_lost_is_said() {
    let dir = TempDir::new().unwrap();
    let camera = uwscan(["info", &calibration(), "--json"]).json(0)["camera"].clone();
    let of = |keys: &[&str]| keys.iter().map(|key| camera[*key].as_f64().unwrap()).collect::<Vec<_>>();
    for (to, first) in [("ros", "# By uwscan"), ("opencv", "%YAML:1.0\n---\n")] {
        let target = dir.path().join(to).with_extension("yaml");
        let run = uwscan(["convert", &calibration(), target.to_str().unwrap(), "--to", to]);
        assert_eq!(run.code, Some(0), "{}", run.stderr);
        assert!(
            run.stderr.contains("without its window") && run.stderr.contains("galvanometer"),
            "{}",
            run.stderr
        );
        let text = fs::read_to_string(&target).unwrap();
        assert!(text.starts_with(first) && text.contains("both windows"), "{text}");
        assert!(text.contains("image_width: 768\nimage_height: 576\n"), "{text}");
        let k = matrix(&text, "camera_matrix");
        same(&[k[0], k[4], k[2], k[5]], &of(&["fx", "fy", "cx", "cy"]));
        same(&matrix(&text, "distortion_coefficients"), &of(&["k1", "k2", "p1", "p2", "k3"]));
        if to == "ros" {
            assert_eq!(matrix(&text, "projection_matrix").len(), 12);
        }
        uwscan(["convert", &calibration(), target.to_str().unwrap(), "--to", to]).fails(&["--force"]);
        // And none comes in.
        let back = dir.path().join("back.toml");
        uwscan(["convert", target.to_str().unwrap(), back.to_str().unwrap()])
            .fails(&["becomes no calibration", "windows"]);
    }
    let target = dir.path().join("x.yaml");
    let target = target.to_str().unwrap();
    uwscan(["convert", &calibration(), target]).is_misused(&["--to ros", "--to opencv"]);
    uwscan(["convert", &calibration(), target, "--to", "ros2"]).is_misused(&["capture folder"]);
    uwscan(["convert", fixture("ball").to_str().unwrap(), target, "--to", "ros"])
        .is_misused(&["take a calibration"]);
}
