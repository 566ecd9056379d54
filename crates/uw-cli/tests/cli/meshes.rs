use std::fs::{self, read_to_string};

use tempfile::TempDir;

use crate::samples::{has_numbers, uwscan};

/// A step of 20 mm between two halves of a grid at about a metre, as an ascii cloud.
fn step(dir: &TempDir) -> String {
    let mut text = String::new();
    for i in 0..40 {
        for j in 0..50 {
            let z = if i < 20 { 1000.0 } else { 980.0 };
            text += &format!("{} {} {z}\n", f64::from(i) * 1.5 - 30.0, f64::from(j) * 0.8 - 20.0);
        }
    }
    let path = dir.path().join("step.xyz");
    fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_surface_is_written_in_every_format_and_told_as_json() {
    let dir = TempDir::new().unwrap();
    let cloud = step(&dir);
    for ending in ["ply", "stl", "obj", "glb"] {
        let out = dir.path().join(format!("mesh.{ending}"));
        let out = out.to_str().unwrap();
        let mesh = uwscan(["mesh", &cloud, "-o", out, "--json"]).json(0);
        has_numbers(&mesh, &["/vertices", "/triangles", "/area_mm2", "/boundary_loops", "/seconds"]);
        assert_eq!(mesh["vertices"], 2000);
        // Two halves of 19 by 49 cells, nothing across the step.
        assert_eq!(
            (&mesh["triangles"], &mesh["boundary_loops"]),
            (&(2 * 2 * 19 * 49).into(), &2.into()),
            "{mesh}"
        );
        assert_eq!(mesh["components"], 2);
        assert!((mesh["area_mm2"].as_f64().unwrap() - 2.0 * 28.5 * 39.2).abs() < 1e-6, "{mesh}");
        uwscan(["mesh", &cloud, "-o", out]).fails(&["exists already"]);
        assert!(uwscan(["mesh", &cloud, "-o", out, "--force"]).text().contains("2 loops"));
    }
    let text = dir.path().join("text.stl");
    uwscan(["mesh", &cloud, "-o", text.to_str().unwrap(), "--ascii"]).text();
    assert!(read_to_string(text).unwrap().starts_with("solid"));
}

#[test]
fn meshes_are_told_of_by_info() {
    let dir = TempDir::new().unwrap();
    let cloud = step(&dir);
    for ending in ["ply", "stl", "obj"] {
        let out = dir.path().join(format!("mesh.{ending}"));
        let out = out.to_str().unwrap();
        uwscan(["mesh", &cloud, "-o", out, "-q"]).text();
        let info = uwscan(["info", out, "--json"]).json(0);
        assert_eq!((&info["kind"], &info["vertices"]), (&"mesh".into(), &2000.into()), "{info}");
        assert_eq!((&info["boundary_loops"], &info["crowded_edges"]), (&2.into(), &0.into()), "{info}");
        assert!(uwscan(["info", out]).text().contains("open"), "{out}");
    }
}

#[test]
fn clouds_without_a_surface_and_wrong_arguments_are_refused() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("line.xyz");
    fs::write(&path, "0 0 100\n1 0 100\n2 0 100\n").unwrap();
    let (line, out) = (path.to_str().unwrap(), dir.path().join("m.ply"));
    let out = out.to_str().unwrap();
    uwscan(["mesh", line, "-o", out]).fails(&["line.xyz", "one line"]);
    fs::write(&path, "0 0 100\n1 0 -100\n2 5 100\n").unwrap();
    uwscan(["mesh", line, "-o", out]).fails(&["line.xyz", "in front of the sensor"]);
    uwscan(["mesh", line, "-o", "mesh.txt"]).is_misused(&[".glb"]);
    uwscan(["mesh", line, "-o", out, "--sensor", "1,2"]).is_misused(&["3 numbers"]);
    assert!(!dir.path().join("m.ply").exists());
}
