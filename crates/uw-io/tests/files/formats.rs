//! PCD, E57 and LAS: our clouds there and back, others' files in, damaged ones refused.

use std::fs;

use tempfile::TempDir;
use uw_cloud::{CloudPoint, Frame, PointCloud};
use uw_io::{Error, Overwrite, clouds, clouds::Format, pcd};

use crate::samples::says;

/// Floats of four bytes at a metre are this coarse, mm.
const FLOAT_MM: f64 = 6.2e-5;

/// A sweep of three images, two lines missing, with all that is known of its points.
fn sweep() -> PointCloud {
    let mut points = Vec::new();
    for (frame, line) in [(4, 10), (4, 11), (4, 12), (5, 10), (5, 12), (6, 11), (6, 12)] {
        points.push(CloudPoint {
            position_mm: [f64::from(line) * 0.7, f64::from(frame) / 3.0, 900.0 + f64::from(line) / 7.0],
            intensity: 100.0 + line as f32,
            frame_row: frame,
            pixel: [300.25 + frame as f32, line as f32],
            sigma_mm: 0.01 * line as f32,
            covariance_mm2: [1e-4, 1e-5, -2e-5, 3e-4, 0.0, 4e-4],
            shared_mm: Some([1e-3, 2e-3, -3e-3]),
        });
    }
    let count = points.len();
    PointCloud::from_points(Frame::Galvo, &points)
        .with_normals(vec![[0.0, 0.6, -0.8]; count])
        .and_then(|c| c.with_deviations_mm(vec![-0.25; count]))
        .and_then(|c| c.with_colors((0..count as u8).map(|n| [n, 100 + n, 255]).collect()))
        .unwrap()
}

/// Whether two clouds hold the same, positions to within a tolerance.
fn is_same(a: &PointCloud, b: &PointCloud, tolerance_mm: f64) {
    let near =
        |(p, q): (&[f64; 3], &[f64; 3])| std::iter::zip(p, q).all(|(p, q)| (p - q).abs() <= tolerance_mm);
    assert!(a.len() == b.len() && a.positions_mm().iter().zip(b.positions_mm()).all(near), "{b:?}");
    assert_eq!(a.frame(), b.frame());
    assert_eq!((a.intensities(), a.frame_rows(), a.pixels()), (b.intensities(), b.frame_rows(), b.pixels()));
    assert_eq!((a.sigmas_mm(), a.covariances_mm2()), (b.sigmas_mm(), b.covariances_mm2()));
    assert_eq!(a.shared_mm(), b.shared_mm());
    assert_eq!((a.normals(), a.deviations_mm(), a.colors()), (b.normals(), b.deviations_mm(), b.colors()));
}

fn read_pcd(bytes: impl AsRef<[u8]>) -> Result<PointCloud, Error> {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.pcd");
    fs::write(&path, bytes).unwrap();
    pcd::read(&path).map(|(cloud, _)| cloud)
}

#[test]
fn clouds_come_back_from_every_format_as_they_were() {
    let dir = TempDir::new().unwrap();
    let mut names = vec![("a.ply", 0.0), ("a.csv", 0.0), ("a.pcd", FLOAT_MM), ("a.e57", 1e-12)];
    if cfg!(feature = "las") {
        // Steps of a micrometre, rounded.
        names.extend([("a.las", 5.1e-4), ("a.laz", 5.1e-4)]);
    }
    for (name, tolerance) in names {
        let path = dir.path().join(name);
        let format = Format::of(&path).unwrap();
        clouds::write(&path, Overwrite::Refuse, &sweep(), format).unwrap();
        let (back, problems) = clouds::read(&path).unwrap();
        assert!(problems.is_empty(), "{name}: {problems:?}");
        is_same(&sweep(), &back, tolerance);
        clouds::write(&path, Overwrite::Replace, &sweep(), format.as_text()).unwrap();
        is_same(&sweep(), &clouds::read(&path).unwrap().0, tolerance);
        // Bare positions, far from the origin.
        let bare =
            PointCloud::new(Frame::Camera, vec![[123_456.75, -9.5e5, 0.125], [123_457.0, -9.5e5, 0.25]]);
        clouds::write(&path, Overwrite::Replace, &bare, format).unwrap();
        let back = clouds::read(&path).unwrap().0;
        is_same(
            &PointCloud::new(Frame::Camera, back.positions_mm().to_vec()),
            &bare,
            tolerance.clamp(1e-9, 5.1e-4),
        );
    }
}

#[test]
fn a_sweep_is_organised_by_image_and_line_in_pcd() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.pcd");
    pcd::write(&path, Overwrite::Refuse, &sweep(), uw_io::ply::Encoding::Ascii).unwrap();
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains("WIDTH 3\nHEIGHT 3\n") && text.contains("POINTS 9\n"), "{text}");
    assert!(text.contains("rgb") && text.contains("normal_x") && text.contains("# frame galvo"), "{text}");
    assert_eq!(text.lines().filter(|line| line.starts_with("nan nan nan")).count(), 2, "{text}");
    // Two points in a place, and the sweep is a list.
    let twice = PointCloud::joined(&[sweep()])
        .with_frame_rows(vec![4; 7])
        .and_then(|c| c.with_pixels(vec![[300.5, 10.0]; 7]))
        .unwrap();
    pcd::write(&path, Overwrite::Replace, &twice, uw_io::ply::Encoding::Binary).unwrap();
    assert!(String::from_utf8_lossy(&fs::read(&path).unwrap()).contains("WIDTH 7\nHEIGHT 1\n"));
}

/// `x y z` of two points as PCL packs them: field after field, here in literal runs.
fn compressed(points: u32) -> Vec<u8> {
    let mut body = Vec::new();
    for value in [1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0] {
        body.extend(value.to_le_bytes());
    }
    let mut file = format!(
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA \
         binary_compressed\n"
    )
    .into_bytes();
    file.extend((body.len() as u32 + 1).to_le_bytes());
    file.extend((body.len() as u32).to_le_bytes());
    file.push(body.len() as u8 - 1);
    file.extend(body);
    file
}

#[test]
fn compressed_pcd_is_read_and_counts_that_lie_are_refused() {
    let cloud = read_pcd(compressed(2)).unwrap();
    assert_eq!(cloud.positions_mm(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
    for points in [1, 3, 4_000_000] {
        let error = read_pcd(compressed(points)).unwrap_err();
        says(&error.to_string(), &["a.pcd", "24 bytes of points"]);
    }
    let whole = compressed(2);
    for end in [whole.len() - 1, whole.len() - 20, whole.len() - 30] {
        assert!(read_pcd(&whole[..end]).is_err(), "torn after {end} bytes");
    }
}

#[test]
fn others_pcd_files_are_read() {
    let text = "VERSION .7\nFIELDS rgb x _ y z label\nSIZE 4 4 1 4 8 2\nTYPE U F U F F I\nCOUNT 1 1 3 1 1 1\n\
                WIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ascii\n";
    let points = "16711935 1 0 0 0 2 3 -5\n0 nan 0 0 0 nan nan 0\n255 4 0 0 0 5 6 7\n0 7 0 0 0 8 9 0\n";
    let cloud = read_pcd(format!("{text}{points}")).unwrap();
    assert_eq!(cloud.positions_mm(), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
    assert_eq!(cloud.colors().unwrap(), [[255, 0, 255], [0, 0, 255], [0, 0, 0]]);
    // The same as bytes.
    let mut binary = text.replace("ascii", "binary").into_bytes();
    for (color, x, y, z, label) in [
        (0x00ff_00ff_u32, 1.0_f32, 2.0_f32, 3.0_f64, -5_i16),
        (0, f32::NAN, 0.0, 0.0, 0),
        (255, 4.0, 5.0, 6.0, 7),
        (0, 7.0, 8.0, 9.0, 0),
    ] {
        binary.extend(color.to_le_bytes());
        binary.extend(x.to_le_bytes());
        binary.extend([0; 3]);
        binary.extend(y.to_le_bytes());
        binary.extend(z.to_le_bytes());
        binary.extend(label.to_le_bytes());
    }
    assert_eq!(read_pcd(&binary).unwrap(), cloud);
    says(&read_pcd(&binary[..binary.len() - 3]).unwrap_err().to_string(), &["3 of 4 points", "torn"]);
    for (from, to, said) in [
        ("SIZE 4 4 1 4 8 2", "SIZE 4 4 1", &["3 values for 6 fields"][..]),
        ("TYPE U", "TYPE Q", &["none of F, I and U"]),
        ("FIELDS rgb x", "FIELDS rgb q", &["no points with x, y and z"]),
        ("SIZE 4", "SIZE 3", &["rgb", "which no PCD has"]),
        ("POINTS 4", "POINTS 99999999999999999999", &["no whole number"]),
        ("DATA ascii", "DATA zipped", &["none of ascii"]),
        ("VERSION", "solid", &["begins no line"]),
    ] {
        let error = read_pcd(format!("{text}{points}").replacen(from, to, 1)).unwrap_err();
        says(&error.to_string(), said);
    }
}

#[test]
fn damaged_files_of_surveyors_are_refused_and_do_no_harm() {
    let dir = TempDir::new().unwrap();
    let names = if cfg!(feature = "las") { &["a.e57", "a.las", "a.laz"][..] } else { &["a.e57"] };
    for name in names {
        let path = dir.path().join(name);
        clouds::write(&path, Overwrite::Refuse, &sweep(), Format::of(&path).unwrap()).unwrap();
        let whole = fs::read(&path).unwrap();
        for end in [0, 10, 100, whole.len() / 2, whole.len() - 40] {
            fs::write(&path, &whole[..end]).unwrap();
            says(&clouds::read(&path).unwrap_err().to_string(), &[name]);
        }
        fs::write(&path, b"no such thing, but long enough to hold a header of any kind: ".repeat(20))
            .unwrap();
        says(&clouds::read(&path).unwrap_err().to_string(), &[name]);
        assert!(clouds::read(&dir.path().join(format!("missing-{name}"))).is_err());
    }
}
