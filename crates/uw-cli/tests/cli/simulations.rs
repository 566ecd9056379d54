//! `simulate` and `demo`.

use std::fs;

use tempfile::TempDir;

use crate::samples::{edit, fixture, uwscan};

/// What a small scene is changed to: half the image and five voltages, so that it is quick.
fn small(dir: &TempDir) -> String {
    let scenes = fixture("scenes");
    let rig = fs::read_to_string(scenes.join("rig.toml")).unwrap();
    let rig = rig.replace("width  = 768", "width  = 384").replace("height = 576", "height = 288");
    fs::write(dir.path().join("rig.toml"), rig.replace("[8.6, 8.3]", "[17.2, 16.6]")).unwrap();
    let scene = fs::read_to_string(scenes.join("ball.toml")).unwrap();
    let line = scene.lines().find(|line| line.starts_with("sweep")).unwrap();
    let scene = scene.replace(line, "sweep = { from_v = 0.8, to_v = 1.1, steps = 5 }");
    let path = dir.path().join("scene.toml");
    fs::write(&path, scene).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn simulate_makes_a_sound_capture_with_its_truth_the_same_on_any_number_of_threads() {
    let dir = TempDir::new().unwrap();
    let scene = small(&dir);
    let out = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let (one, many) = (out("one"), out("many"));
    let made = uwscan(["simulate", &scene, "-o", &one, "--threads", "1", "--json"]).json(0);
    assert_eq!(made["frames"], 5);
    assert!(made["stripe_points"].as_u64().unwrap() > 50, "{made}");
    uwscan(["simulate", &scene, "-o", &many, "--threads", "4"]).text();
    for k in 0..5 {
        let image = |folder: &str| fs::read(format!("{folder}/images/{k:05}.png")).unwrap();
        assert_eq!(image(&one), image(&many), "image {k}");
    }
    assert!(uwscan(["info", &one]).text().contains("sound"));
    let truth: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(format!("{one}/truth/truth.json")).unwrap()).unwrap();
    assert_eq!(truth["objects"][0]["radius_mm"], 20.0175);
    let stripes = fs::read_to_string(format!("{one}/truth/stripes.csv")).unwrap();
    assert_eq!(stripes.lines().count() as u64, 1 + made["stripe_points"].as_u64().unwrap());

    // An output that exists stays, and one that is somebody else's stays whatever is asked.
    uwscan(["simulate", &scene, "-o", &one]).fails(&["one", "--force"]);
    uwscan(["simulate", &scene, "-o", &one, "--force"]).text();
    fs::remove_file(format!("{one}/capture.toml")).unwrap();
    uwscan(["simulate", &scene, "-o", &one, "--force"]).fails(&["capture.toml"]);
}

#[test]
fn simulate_records_what_it_writes_into_folders() {
    let dir = TempDir::new().unwrap();
    let scene = small(&dir);
    let target = dir.path().join("scan.mcap");
    uwscan(["simulate".as_ref(), scene.as_ref(), "-o".as_ref(), target.as_os_str()]).text();
    let bytes = fs::read(&target).unwrap();
    // Both ends of a whole MCAP file (its specification, "Magic").
    assert!(bytes.starts_with(b"\x89MCAP0\r\n") && bytes.ends_with(b"\x89MCAP0\r\n"));
    assert!(bytes.len() > 5 * 384 * 288, "{} bytes", bytes.len());
    assert!(dir.path().join("scan.truth/stripes.csv").exists());
    let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 4, "{left:?}");
}

#[test]
fn what_cannot_be_simulated_is_said_with_its_place() {
    let dir = TempDir::new().unwrap();
    let scene = small(&dir);
    let good = fs::read_to_string(&scene).unwrap();
    for (from, to, wanted) in [
        ("\"sphere\"", "\"spher\"", "did you mean \"sphere\"?"),
        ("radius_mm   = 20.0175", "radius_mm   = -1.0", "object \"ball\": a sphere's radius"),
        ("to_v = 1.1", "to_v = 60.0", "window"),
        ("\"water\"", "\"oil\"", "use one of the names"),
        ("\"water\"", "3", "write one of its names between quotation marks"),
        ("[0.0, -1.0, 0.0]", "0.0", "write 3 values between brackets"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from}");
        fs::write(&scene, text).unwrap();
        let target = dir.path().join("out");
        let run = uwscan(["simulate".as_ref(), scene.as_ref(), "-o".as_ref(), target.as_os_str()]);
        run.fails(&[&scene, wanted]);
        assert!(!target.exists());
    }
    let spoilt = |file: &str, from: &str, to: &str, wanted: &[&str]| {
        fs::write(&scene, &good).unwrap();
        edit(dir.path(), file, from, to);
        uwscan(["simulate", &scene, "-o", dir.path().join("out").to_str().unwrap()]).fails(wanted);
    };
    spoilt("rig.toml", "[water]\nindex = 1.3351\n", "", &[&scene, "the water's index"]);
    spoilt("scene.toml", "\"rig.toml\"", "\"rog.toml\"", &["rog.toml"]);
}

/// The bars are the demo's own: it fails where it misses them. Ten times the time that it takes on two quiet processors is still no hang.
#[test]
fn the_demo_finds_what_is_true_within_its_bars() {
    let dir = TempDir::new().unwrap();
    let target = dir.path().join("demo");
    let found = uwscan(["demo".as_ref(), "-o".as_ref(), target.as_os_str(), "--json".as_ref()]).json(0);
    assert_eq!(found["missed"].as_array().unwrap().len(), 0, "{found}");
    let radius = &found["ball"][0];
    assert_eq!((radius["name"].as_str(), radius["truth"].as_f64()), (Some("radius_mm"), Some(20.0175)));
    assert!((radius["value"].as_f64().unwrap() - 20.0175).abs() <= 0.03, "{radius}");
    assert!(found["cover_points"]["median_mm"].as_f64().unwrap() <= 0.06);
    assert!(found["cover_points"]["compared"].as_u64().unwrap() > 10_000);
    for name in ["calibration.toml", "ball.ply", "cover.ply", "cover/truth/truth.json"] {
        assert!(target.join(name).exists(), "{name}");
    }
}

/// A block of 60 × 60 × 20 mm about the origin: corners, and triangles that look outwards.
const BLOCK: [[f64; 3]; 8] = [
    [-30.0, -30.0, -10.0],
    [30.0, -30.0, -10.0],
    [30.0, 30.0, -10.0],
    [-30.0, 30.0, -10.0],
    [-30.0, -30.0, 10.0],
    [30.0, -30.0, 10.0],
    [30.0, 30.0, 10.0],
    [-30.0, 30.0, 10.0],
];
const FACES: [[usize; 3]; 12] = [
    [0, 2, 1],
    [0, 3, 2],
    [4, 5, 6],
    [4, 6, 7],
    [0, 1, 5],
    [0, 5, 4],
    [2, 3, 7],
    [2, 7, 6],
    [1, 2, 6],
    [1, 6, 5],
    [0, 4, 7],
    [0, 7, 3],
];

fn stl() -> String {
    let vertex = |i: &usize| format!("vertex {} {} {}\n", BLOCK[*i][0], BLOCK[*i][1], BLOCK[*i][2]);
    let facet = |face: &[usize; 3]| {
        let vertices: String = face.iter().map(vertex).collect();
        format!("facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n")
    };
    format!("solid block\n{}endsolid block\n", FACES.iter().map(facet).collect::<String>())
}

fn ply() -> String {
    let vertices: String = BLOCK.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let faces: String = FACES.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n\
         element face 12\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}"
    )
}

#[test]
fn a_mesh_from_either_file_is_simulated_into_folder_or_recording_and_reconstructed_where_it_stands() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    fs::write(path("block.stl"), stl()).unwrap();
    fs::write(path("block.ply"), ply()).unwrap();
    let scene = |mesh: &str| {
        let calibration = crate::job::calibration();
        let text = format!(
            "format = \"uwscan-scene\"\nversion = 1\nseed = 8\n\n[capture]\nkind = \"scan\"\nmedium = \"water\"\n\
             sweep = {{ from_v = 0.7, to_v = 1.1, steps = 5 }}\n\n[instrument]\ncalibration = {calibration:?}\n\n\
             [[object]]\nname = \"block\"\nshape = \"mesh\"\nfile = {mesh:?}\nposition_mm = [12.0, -21.0, 850.0]\nalbedo = 0.5\n"
        );
        fs::write(path("scene.toml"), text).unwrap();
        path("scene.toml")
    };
    for (mesh, output) in [("block.stl", "folder"), ("block.ply", "scan.mcap")] {
        let (scene, output) = (scene(mesh), path(output));
        uwscan(["simulate".as_ref(), scene.as_os_str(), "-o".as_ref(), output.as_os_str()]).text();
    }
    let info = uwscan(["info", path("scan.mcap").to_str().unwrap(), "--json"]).json(0);
    assert_eq!((&info["images"], &info["sound"]), (&5.into(), &true.into()), "{info}");
    crate::job::reconstruct(&path("folder"), &path("folder.ply"), &[]).text();
    crate::job::reconstruct(&path("scan.mcap"), &path("scan.ply"), &[]).text();
    assert!(fs::read(path("folder.ply")).unwrap() == fs::read(path("scan.ply")).unwrap());
    // The side that camera and laser see stands 10 mm before the block's middle.
    crate::job::reconstruct(&path("folder"), &path("folder.xyz"), &[]).text();
    let text = fs::read_to_string(path("folder.xyz")).unwrap();
    let depths = text.lines().filter(|line| !line.starts_with('#'));
    let mut depths: Vec<f64> = depths.map(|line| line.split(' ').nth(2).unwrap().parse().unwrap()).collect();
    depths.sort_by(f64::total_cmp);
    assert!(depths.len() > 300, "{} points", depths.len());
    let off = |share: f64| depths[(share * (depths.len() - 1) as f64) as usize] - 840.0;
    // Noise of single points, mm.
    assert!(
        off(0.5).abs() < 0.02 && off(0.05) > -0.3 && off(0.95) < 0.3,
        "{} {} {}",
        off(0.05),
        off(0.5),
        off(0.95)
    );
}
