use std::{fs, path::PathBuf};

use proptest::prelude::*;
use tempfile::TempDir;
use uw_cloud::{CloudPoint, Frame, PointCloud};
use uw_io::{Error, Overwrite, clouds, clouds::Format, ply, xyz};

use crate::samples::says;

type Read = (PointCloud, Vec<String>);

fn read_ply(bytes: impl AsRef<[u8]>) -> Result<Read, Error> {
    let (_dir, path) = file("cloud.ply", bytes);
    ply::read(&path).map(|(cloud, p)| (cloud, p.iter().map(ToString::to_string).collect()))
}

fn read_xyz(bytes: impl AsRef<[u8]>) -> Result<Read, Error> {
    let (_dir, path) = file("cloud.xyz", bytes);
    xyz::read(&path).map(|(cloud, p)| (cloud, p.iter().map(ToString::to_string).collect()))
}

fn file(name: &str, bytes: impl AsRef<[u8]>) -> (TempDir, PathBuf) {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join(name);
    fs::write(&path, bytes).unwrap();
    (dir, path)
}

fn cloud() -> PointCloud {
    let point = |n: f32| CloudPoint {
        position_mm: [0.1 * f64::from(n), -1.0 / 3.0, 1e-300],
        intensity: 200.5 + n,
        frame_row: n as u32,
        pixel: [n, 1.0 / 3.0],
        sigma_mm: 0.01,
        covariance_mm2: [1e-4, n, 0.0, 2e-4, -3e-9, f32::MIN_POSITIVE],
        shared_mm: Some([1e-3, 2e-3, -3e-3]),
    };
    PointCloud::from_points(Frame::Galvo, &[point(0.0), point(7.0), point(143.0)])
}

/// Points, vectors and rows of every size, each attribute there or not.
fn clouds() -> impl Strategy<Value = PointCloud> {
    let number = prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::SUBNORMAL;
    let point = (
        prop::array::uniform3(prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL),
        number,
        0..i32::MAX as u32,
        prop::array::uniform2(number),
        number,
        prop::array::uniform6(number),
        prop::array::uniform3(number),
    );
    (prop::collection::vec(point, 1..30), any::<[bool; 7]>()).prop_map(|(points, given)| {
        let frame = if given[5] { Frame::Camera } else { Frame::Galvo };
        let mut cloud = PointCloud::new(frame, points.iter().map(|p| p.0).collect());
        if given[0] {
            cloud = cloud.with_intensities(points.iter().map(|p| p.1).collect()).unwrap();
        }
        if given[1] {
            cloud = cloud.with_frame_rows(points.iter().map(|p| p.2).collect()).unwrap();
        }
        if given[2] {
            cloud = cloud.with_pixels(points.iter().map(|p| p.3).collect()).unwrap();
        }
        if given[3] {
            cloud = cloud.with_sigmas_mm(points.iter().map(|p| p.4).collect()).unwrap();
        }
        if given[4] {
            cloud = cloud.with_covariances_mm2(points.iter().map(|p| p.5).collect()).unwrap();
        }
        if given[6] {
            cloud = cloud.with_shared_mm(points.iter().map(|p| p.6).collect()).unwrap();
        }
        cloud
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_cloud_comes_back_bit_for_bit(cloud in clouds()) {
        let dir = TempDir::new().unwrap();
        let path = dir.path().join("cloud");
        for encoding in [ply::Encoding::Binary, ply::Encoding::Ascii] {
            ply::write(&path, Overwrite::Replace, &cloud, encoding).unwrap();
            let (back, problems) = ply::read(&path).unwrap();
            prop_assert_eq!(&back, &cloud);
            prop_assert!(problems.is_empty());
        }
        for separator in [xyz::Separator::Space, xyz::Separator::Comma] {
            xyz::write(&path, Overwrite::Replace, &cloud, separator).unwrap();
            let (back, problems) = xyz::read(&path).unwrap();
            prop_assert_eq!(&back, &cloud);
            prop_assert!(problems.is_empty());
        }
    }

    /// Whatever happens to a file, reading returns, and a cloud only where every point was there.
    #[test]
    fn damage_never_panics(at in any::<prop::sample::Index>(), to in any::<u8>(), ascii in any::<bool>(), cut in 0..40_usize) {
        let dir = TempDir::new().unwrap();
        let path = dir.path().join("cloud");
        let encoding = if ascii { ply::Encoding::Ascii } else { ply::Encoding::Binary };
        ply::write(&path, Overwrite::Replace, &cloud(), encoding).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = to;
        bytes.truncate(bytes.len() - cut.saturating_sub(20));
        if let Ok((read, _)) = read_ply(&bytes) {
            prop_assert!(read.check_finite().is_ok());
        }
        let _ = read_xyz(&bytes).map(|(read, _)| read.check_finite().unwrap());
    }
}

#[test]
fn a_binary_ply_has_the_documented_header_and_layout() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("cloud.ply");
    ply::write(&path, Overwrite::Refuse, &cloud(), ply::Encoding::default()).unwrap();
    let bytes = fs::read(&path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let head = std::str::from_utf8(&bytes[..end]).unwrap();
    let version = env!("CARGO_PKG_VERSION");
    let mut expected = format!(
        "ply\nformat binary_little_endian 1.0\ncomment uwscan {version}\ncomment frame galvo\ncomment unit mm\nelement vertex 3\n"
    );
    for (kind, names) in [
        ("double", "x y z"),
        ("float", "intensity"),
        ("int", "frame"),
        ("float", "u v sigma cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz shared_x shared_y shared_z"),
    ] {
        names.split(' ').for_each(|name| expected += &format!("property {kind} {name}\n"));
    }
    assert_eq!(head, expected + "end_header\n");
    const STRIDE: usize = 3 * 8 + 4 + 4 + 3 * 4 + 6 * 4 + 3 * 4;
    assert_eq!(bytes.len(), end + 3 * STRIDE);
    let second = &bytes[end + STRIDE..];
    assert_eq!(&second[8..16], (-1.0 / 3.0_f64).to_le_bytes());
    assert_eq!(&second[28..32], 7_i32.to_le_bytes());
    assert!(matches!(
        ply::write(&path, Overwrite::Refuse, &cloud(), ply::Encoding::Ascii),
        Err(Error::Exists { .. })
    ));
}

#[test]
fn clouds_of_any_origin_are_read() {
    let positions = [[1.0, 2.0, 3.0], [-4.0, 5.5, 6.0]];
    let ascii = "ply\r\nformat ascii 1.0\r\ncomment made elsewhere\r\nelement camera 1\r\nproperty float view_px\r\n\
        property list uchar int ids\r\nelement vertex 2\r\nproperty uchar red\r\nproperty float32 z\r\nproperty list int float32 n\r\n\
        property int16 y\r\nproperty double x\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\
        0.5 2 7 8\r\n255 3 0 2 1\r\n\r\n0 6 2 0.1 0.2 5.5 -4\r\n3 0 1 1\r\n";
    let (cloud, problems) = read_ply(ascii).unwrap();
    assert_eq!((cloud.positions_mm(), cloud.frame(), problems.len()), (&positions[..], Frame::Camera, 0));
    assert_eq!((cloud.intensities(), cloud.pixels()), (None, None));

    for little in [true, false] {
        let name = if little { "binary_little_endian" } else { "binary_big_endian" };
        let mut bytes = format!(
            "ply\nformat {name} 1.0\nelement camera 1\nproperty list ushort double ids\nelement vertex 2\nproperty uchar red\n\
             property float z\nproperty short y\nproperty double x\nproperty int frame\nproperty char c\nproperty uint w\nend_header\n"
        )
        .into_bytes();
        let mut put = |le: &[u8]| if little { bytes.extend(le) } else { bytes.extend(le.iter().rev()) };
        put(&2_u16.to_le_bytes());
        put(&0.1_f64.to_le_bytes());
        put(&0.2_f64.to_le_bytes());
        for [x, y, z] in [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0_f64]] {
            put(&[200]);
            put(&(z as f32).to_le_bytes());
            put(&(y as i16).to_le_bytes());
            put(&x.to_le_bytes());
            put(&70_000_i32.to_le_bytes());
            put(&[255]);
            put(&u32::MAX.to_le_bytes());
        }
        let (cloud, _) = read_ply(bytes).unwrap();
        assert_eq!(cloud.positions_mm(), [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]]);
        assert_eq!(cloud.frame_rows(), Some(&[70_000, 70_000][..]));
    }

    for text in [
        "1 2 3\n-4 5.5 6\n",
        "\u{feff}# some comment\r\n1,2,3\r\n\r\n-4,5.5,6",
        "x;y;z\n1;2;3\n-4;5.5;6\n",
        "// X Y Z\n1\t2\t3\n-4\t5.5\t6\n",
        "1 2 3 255 0 0\n-4 5.5 6 0 0 0\n",
        "\"x\",\"y\",\"z\",\"red\"\n1,2,3,9\n-4,5.5,6,9\n",
    ] {
        let (cloud, _) = read_xyz(text).unwrap();
        assert_eq!(cloud.positions_mm(), positions, "{text}");
        assert_eq!(cloud.intensities(), None);
    }
}

#[test]
fn what_is_no_sound_ply_is_refused_with_its_reason() {
    let head = |vertex: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertex}\nproperty float x\nproperty float y\nproperty float z\n"
        )
    };
    let cases: &[(String, &[&str])] = &[
        (String::new(), &[":1:", "does not begin"]),
        ("plywood\n".into(), &[":1:", "does not begin"]),
        ("ply\n".into(), &["header does not end"]),
        (format!("ply\n{}", "a".repeat(100_000)), &[":2:", "header does not end"]),
        (format!("ply\n{}", "comment\n".repeat(20_000)), &["header does not end"]),
        ("ply\nformat ascii 2.0\nend_header\n".into(), &[":2:", "no line of a PLY header"]),
        ("ply\nformat binary_middle_endian 1.0\n".into(), &[":2:", "binary_middle_endian"]),
        ("ply\nelement vertex 0\nend_header\n".into(), &["no format line"]),
        ("ply\nproperty float x\n".into(), &[":2:", "before any element"]),
        ("ply\nelement vertex many\n".into(), &[":2:", "\"many\""]),
        ("ply\nelement vertex -1\n".into(), &[":2:", "\"-1\""]),
        ("ply\nelement vertex 99999999999999999999\n".into(), &[":2:"]),
        ("ply\nelement vertex 1\nelement vertex 1\n".into(), &[":3:", "twice"]),
        (format!("{}property float x\nend_header\n", head("1")), &[":7:", "twice"]),
        (format!("{}property half h\nend_header\n", head("1")), &[":7:", "no known type"]),
        (format!("{}property list float int h\nend_header\n", head("1")), &[":7:", "no known type"]),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n".into(),
            &["x, y and z"],
        ),
        ("ply\nformat ascii 1.0\nend_header\n".into(), &["x, y and z"]),
        (format!("{}end_header\n1 2 3\n", head("2")), &["ends after 1 of 2"]),
        (
            format!("{}end_header\n1 2 3\n", head("18446744073709551615")),
            &["ends after 1 of 18446744073709551615"],
        ),
        (format!("{}end_header\n1 2\n", head("1")), &[":8:", "value of z is missing"]),
        (format!("{}end_header\n1 two 3\n", head("1")), &[":8:", "y: \"two\""]),
        (format!("{}end_header\n1 2 nan\n", head("1")), &[":8:", "NaN"]),
        (format!("{}end_header\n1 inf 3\n", head("1")), &[":8:", "inf"]),
        (format!("{}property float sigma\nend_header\n1 2 3 nan\n", head("1")), &["sigma of point 0"]),
        (
            format!("{}property list int int a\nend_header\n1 2 3 2000000000 1\n", head("1")),
            &[":9:", "value of a is missing"],
        ),
        (format!("{}comment unit m\nend_header\n1 2 3\n", head("1")), &["unit is \"m\"", "convert"]),
    ];
    for (text, parts) in cases {
        let message = read_ply(text).unwrap_err().to_string();
        says(&message, parts);
        says(&message, &["cloud.ply"]);
    }
    let long = format!("{}end_header\n1 2 {}\n", head("2"), "3 ".repeat(1 << 20));
    says(&read_ply(long).unwrap_err().to_string(), &[":8:", "longer than"]);
    let binary = head("4000000000").replace("ascii", "binary_little_endian") + "end_header\nabc";
    says(&read_ply(&binary).unwrap_err().to_string(), &["ends after 0 of 4000000000"]);
    let list = binary
        .replace("property float x", "property list uint double ids\nproperty float x")
        .replace("abc", "\u{7f}\u{7f}\u{7f}\u{7f}abc");
    says(&read_ply(&list).unwrap_err().to_string(), &["ends after 0 of 4000000000"]);
    let (_, problems) = read_ply(format!("{}comment frame world\nend_header\n1 2 3\n", head("1"))).unwrap();
    says(&problems[0], &["\"world\"", "taken as the camera's"]);
    for value in ["-1", "0.5", "nan", "5e9"] {
        let text =
            format!("{}property float frame\nend_header\n1 2 3 0\n4 5 6 {value}\n7 8 9 0\n", head("3"));
        let (cloud, problems) = read_ply(text).unwrap();
        assert_eq!((cloud.len(), cloud.frame_rows()), (3, None));
        says(&problems[0], &["no row of frames.csv", "ignored"]);
    }
}

#[test]
fn what_is_no_sound_text_of_points_is_refused_with_its_reason() {
    for (text, parts) in [
        ("", &["holds no points"][..]),
        ("# x y z\n", &["holds no points"]),
        ("1 2\n", &[":1:", "2 values, not 3"]),
        ("1 2 3\n1 2 3 4\n", &[":2:", "4 values, not 3"]),
        ("x y z sigma\n1 2 3\n", &[":2:", "3 values, not 4"]),
        ("a b c\n1 2 3\n", &[":1:", "\"a\" is no number", "name the columns x, y and z"]),
        ("x y z\n1 2 b\n", &[":2:", "\"b\" is no number", "mend the line"]),
        (
            "x y z cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz\n1 2 3 1 0 0 -1 0 1\n",
            &[":2:", "cov_yy is -1", "not negative"],
        ),
        ("1 2 3\n1 2 nan\n", &[":2:", "NaN"]),
        ("# unit m\n1 2 3\n", &["unit is \"m\""]),
    ] {
        says(&read_xyz(text).unwrap_err().to_string(), parts);
    }
    let (cloud, _) = read_xyz("id;x;y;z\n7;1;2;3\n").unwrap();
    assert_eq!(cloud.positions_mm(), [[1.0, 2.0, 3.0]], "columns are found by their names");
    // What rounding makes of a variance that is nil, in another frame.
    let (cloud, _) =
        read_xyz("x y z cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz\n1 2 3 -5e-14 0 0 1e-4 0 1e-4\n").unwrap();
    assert_eq!(cloud.covariances_mm2().unwrap(), [[-5e-14, 0.0, 0.0, 1e-4, 0.0, 1e-4]]);
    says(&read_xyz(b"\xff\xfe1\0 \0").unwrap_err().to_string(), &[":1:", "no text"]);
    says(&read_xyz("1 ".repeat(1 << 20)).unwrap_err().to_string(), &[":1:", "longer than"]);
}

#[test]
fn a_names_ending_tells_the_format() {
    let dir = TempDir::new().unwrap();
    for (name, begins) in
        [("a.PLY", &b"ply\nformat binary"[..]), ("a.xyz", b"# frame"), ("a.csv", b"# frame")]
    {
        let path = dir.path().join(name);
        let format = Format::of(&path).unwrap();
        clouds::write(&path, Overwrite::Refuse, &cloud(), format).unwrap();
        assert!(fs::read(&path).unwrap().starts_with(begins), "{name}");
        assert_eq!(clouds::read(&path).unwrap().0, cloud(), "{name}");
        clouds::write(&path, Overwrite::Replace, &cloud(), format.as_text()).unwrap();
        assert!(String::from_utf8(fs::read(&path).unwrap()).is_ok(), "{name}");
        assert_eq!(clouds::read(&path).unwrap().0, cloud(), "{name}");
    }
    for name in ["a", "ply", ".ply", "a.stl", "a.ply.gz"] {
        let error = clouds::read(&dir.path().join(name)).unwrap_err();
        says(&error.to_string(), &[name, ".ply, .pcd, .xyz"]);
    }
}
