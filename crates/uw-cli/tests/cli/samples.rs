//! Runs of the binary, and small inputs for it.

use std::{
    ffi::OsStr,
    fmt::Write,
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use assert_cmd::cargo::cargo_bin_cmd;
use serde_json::Value;
use tempfile::TempDir;

/// Far longer than any run here takes, s: a hang is a failure, not a suite that never ends.
const HANG_S: u64 = 240;

pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// Runs `uwscan` to its end.
pub fn uwscan<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Run {
    let output = cargo_bin_cmd!("uwscan").args(args).timeout(Duration::from_secs(HANG_S)).output().unwrap();
    let run = Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    };
    assert!(!run.stderr.contains("panicked"), "{}", run.stderr);
    run
}

impl Run {
    /// The one JSON object on stdout of a run that ended with `code`.
    #[track_caller]
    pub fn json(&self, code: i32) -> Value {
        assert_eq!(self.code, Some(code), "{}", self.stderr);
        let value: Value = serde_json::from_str(&self.stdout).unwrap();
        assert!(value.is_object(), "{value}");
        value
    }

    /// Stdout of a run that ended well and had nothing to warn of.
    #[track_caller]
    pub fn text(&self) -> &str {
        assert_eq!(self.code, Some(0), "{}", self.stderr);
        assert!(!self.stderr.contains("warning:"), "{}", self.stderr);
        &self.stdout
    }

    /// A run that failed: one `error:` line with all the `parts`, and nothing on stdout.
    #[track_caller]
    pub fn fails(&self, parts: &[&str]) {
        assert_eq!((self.code, self.stdout.as_str()), (Some(1), ""), "{}", self.stderr);
        let errors: Vec<&str> = self.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
        assert_eq!(errors.len(), 1, "{}", self.stderr);
        for part in parts {
            assert!(errors[0].contains(part), "{part:?} is not in {:?}", errors[0]);
        }
    }

    /// A run that was asked wrongly: exit code 2, nothing on stdout, the `parts` on stderr.
    #[track_caller]
    pub fn is_misused(&self, parts: &[&str]) {
        assert_eq!((self.code, self.stdout.as_str()), (Some(2), ""), "{}", self.stderr);
        assert!(self.stderr.starts_with("error: "), "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} is not in {:?}", self.stderr);
        }
    }
}

/// An object's keys, sorted.
pub fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// Whether a number stands at each of the pointers, as JSON has no NaN and a `null` would stand for one.
#[track_caller]
pub fn has_numbers(value: &Value, pointers: &[&str]) {
    for pointer in pointers {
        assert!(value.pointer(pointer).is_some_and(Value::is_number), "{pointer} in {value}");
    }
}

pub const CAPTURE: &str = "format = \"uwscan-capture\"\nversion = 1\nkind = \"calibration\"\nmedium = \"air\"\n\n\
    [target]\npattern = \"chessboard\"\ninner_corners = [11, 8]\nsquare_mm = 24.0\n";
pub const RIG: &str = "format = \"uwscan-rig\"\nversion = 1\n\n[camera]\nwidth = 64\nheight = 48\npixel_um = [8.6, 8.3]\n\
    focal_mm = 12.0\nbits = 8\n\n[camera.port]\ndistance_mm = 10.0\nthickness_mm = 8.0\nnormal = [0.0, 0.0, 1.0]\n\
    index = 1.49\n\n[laser]\nwavelength_nm = 532.0\n\n[laser.port]\ndistance_mm = 35.0\nthickness_mm = 8.0\n\
    normal = [0.0, 0.0, 1.0]\nindex = 1.49\n\n[galvo]\ndegrees_per_volt = 2.0\nrange_v = [-10.0, 10.0]\nreference_v = 0.0\n";
const POSES: u32 = 4;

/// A capture folder that is whole, of grey images that show nothing.
pub fn blank_capture() -> TempDir {
    let dir = TempDir::new().unwrap();
    fs::create_dir(dir.path().join("images")).unwrap();
    let mut frames = String::from("file,pose,laser,voltage_v,stamp_ns\n");
    for i in 0..2 * POSES {
        let (pose, time) = (i / 2, 1_000 * u64::from(i));
        let laser = if i.is_multiple_of(2) { "off,".to_owned() } else { format!("on,{pose}.5") };
        writeln!(frames, "images/{i}.pgm,{pose},{laser},{time}").unwrap();
        write_grey(&dir.path().join(format!("images/{i}.pgm")), 64, 48);
    }
    fs::write(dir.path().join("frames.csv"), frames).unwrap();
    fs::write(dir.path().join("capture.toml"), CAPTURE).unwrap();
    fs::write(dir.path().join("rig.toml"), RIG).unwrap();
    dir
}

/// Writes a grey image with a slight, regular texture.
pub fn write_grey(path: &Path, width: usize, height: usize) {
    let mut bytes = format!("P5\n{width} {height}\n255\n").into_bytes();
    bytes.extend((0..width * height).map(|i| 40 + (i * 7 % 11) as u8));
    fs::write(path, bytes).unwrap();
}

/// Replaces the first `from` in a file of a folder, which must have one.
#[track_caller]
pub fn edit(dir: &Path, file: &str, from: &str, to: &str) {
    let path = dir.join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from:?} is not in {text:?}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// A capture that the repository holds.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures").join(name)
}

/// A copy of a fixture with the rows that are `kept`.
pub fn part_of(name: &str, kept: impl Fn(usize, &str) -> bool) -> TempDir {
    let (from, dir) = (fixture(name), TempDir::new().unwrap());
    fs::create_dir(dir.path().join("images")).unwrap();
    let frames = fs::read_to_string(from.join("frames.csv")).unwrap();
    let (header, rows) = frames.split_once('\n').unwrap();
    let rows: Vec<&str> =
        rows.lines().enumerate().filter(|(i, row)| kept(*i, row)).map(|(_, row)| row).collect();
    for row in &rows {
        let file = row.split(',').next().unwrap();
        fs::copy(from.join(file), dir.path().join(file)).unwrap();
    }
    fs::write(dir.path().join("frames.csv"), format!("{header}\n{}\n", rows.join("\n"))).unwrap();
    for file in ["capture.toml", "rig.toml"] {
        fs::copy(from.join(file), dir.path().join(file)).unwrap();
    }
    dir
}

/// The names in a folder, sorted.
pub fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort_unstable();
    names
}
