use std::{
    fmt::Write,
    fs::{self, read_to_string},
    path::Path,
};

use tempfile::TempDir;

use crate::samples::{has_numbers, uwscan};

/// A relief that no motion maps onto itself, about 900 mm before the sensor.
fn relief(x: f64, y: f64) -> f64 {
    900.0 + 6.0 * (x / 17.0).sin() + 5.0 * (y / 13.0 + x / 40.0).cos() + 0.002 * x * y
}

/// The relief over ± 60 mm as an OBJ that faces the sensor, in units of so many millimetres.
fn reference(path: &Path, unit_mm: f64) -> String {
    const SIDE: i32 = 81;
    let at = |i: i32| f64::from(i) * 1.5 - 60.0;
    let mut text = String::new();
    for i in 0..SIDE {
        for j in 0..SIDE {
            let place = [at(i), at(j), relief(at(i), at(j))].map(|c| c / unit_mm);
            writeln!(text, "v {} {} {}", place[0], place[1], place[2]).unwrap();
        }
    }
    for n in (0..SIDE - 1).flat_map(|i| (0..SIDE - 1).map(move |j| i * SIDE + j + 1)) {
        writeln!(text, "f {} {} {}\nf {} {} {}", n, n + 1, n + SIDE, n + 1, n + SIDE + 1, n + SIDE).unwrap();
    }
    fs::write(path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Points of the relief over a range of x, turned by 0.05 rad about z and shifted along x and z as told.
fn cloud(path: &Path, x: std::ops::Range<i32>, shift: [f64; 2]) -> String {
    let (sin, cos) = if shift.iter().all(|s| *s == 0.0) { (0.0, 1.0) } else { 0.05_f64.sin_cos() };
    let mut text = String::from("# x y z sigma\n");
    for i in x {
        for j in -45..45 {
            let (x, y) = (f64::from(i) * 1.1, f64::from(j) * 1.1);
            let (u, v) = (x * cos - y * sin + shift[0], x * sin + y * cos);
            writeln!(text, "{u} {v} {} 0.02", relief(x, y) + shift[1]).unwrap();
        }
    }
    fs::write(path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

#[test]
fn a_cloud_is_aligned_with_its_reference_and_mapped() {
    let dir = TempDir::new().unwrap();
    let file = |name: &str| dir.path().join(name);
    let (mesh, points) = (reference(&file("part.obj"), 1.0), cloud(&file("scan.xyz"), -40..40, [25.0, -7.0]));
    let map = file("map.ply");
    let map = map.to_str().unwrap();
    let found = uwscan(["compare", &points, &mesh, "-o", map, "--json"]).json(0);
    has_numbers(
        &found,
        &[
            "/mean_mm",
            "/median_mm",
            "/rms_mm",
            "/within_95_mm",
            "/max_outside_mm",
            "/max_inside_mm",
            "/seconds",
        ],
    );
    // The facets of 1.5 mm sag by 0.02 mm at most.
    assert!(found["rms_mm"].as_f64().unwrap() < 0.02, "{found}");
    assert!(found["alignment"]["overlap"].as_f64().unwrap() > 0.95, "{found}");
    let matrix = &found["alignment"]["reference_from_cloud"];
    assert!((matrix[0][0].as_f64().unwrap() - 0.05_f64.cos()).abs() < 1e-3, "{matrix}");
    assert_eq!(
        found["histogram"]["counts"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum::<u64>(),
        found["compared"]
    );
    let info = uwscan(["info", map, "--json"]).json(0);
    assert_eq!(info["attributes"], serde_json::json!(["sigma", "deviation", "color"]), "{info}");
    uwscan(["compare", &points, &mesh, "-o", map]).fails(&["exists already"]);
    uwscan(["compare", "notes.txt", &mesh]).fails(&[
        "notes.txt",
        "neither a point cloud",
        ".pcd",
        "nor a mesh",
        ".stl",
    ]);
    let said = uwscan(["compare", &points, &mesh, "--no-align"]);
    // An open reference is warned of.
    assert!(
        said.stdout.contains("compared where it is") && said.stderr.contains("is open"),
        "{}",
        said.stderr
    );

    // In metres it is not found, and the unit is suspected; told, it is.
    let metres = reference(&file("metres.obj"), 1000.0);
    uwscan(["compare", &points, &metres]).fails(&["not aligned", "in metres"]);
    let about_right = cloud(&file("near.xyz"), -40..40, [2.0, -1.0]);
    let found = uwscan(["compare", &about_right, &metres, "--unit", "m", "--near", "20", "--json"]).json(0);
    assert!(found["rms_mm"].as_f64().unwrap() < 0.02, "{found}");

    // A mesh is compared by its vertices.
    let surface = file("surface.ply");
    let surface = surface.to_str().unwrap();
    uwscan(["mesh", &points, "-o", surface, "-q"]).text();
    let of_mesh = file("mesh-map.ply");
    uwscan(["compare", surface, &mesh, "-o", of_mesh.to_str().unwrap(), "--json"]).json(0);
    let info = uwscan(["info", of_mesh.to_str().unwrap(), "--json"]).json(0);
    assert!(
        info["attributes"].to_string().contains("deviation") && info["triangles"].as_u64() > Some(0),
        "{info}"
    );
}

#[test]
fn sweeps_are_merged_where_they_overlap_and_refused_where_not() {
    let dir = TempDir::new().unwrap();
    let file = |name: &str| dir.path().join(name);
    let (left, right) =
        (cloud(&file("a.xyz"), -45..10, [0.0; 2]), cloud(&file("b.xyz"), -12..45, [5.0, 4.0]));
    let out = file("all.ply");
    let out = out.to_str().unwrap();
    let merged = uwscan(["merge", &left, &right, "-o", out, "--near", "20", "--json"]).json(0);
    assert_eq!(merged["points"], (55 + 57) * 90);
    let matrix = &merged["clouds"][1]["first_from_cloud"];
    // The turn is taken back, and with it the shift.
    assert!((matrix[0][1].as_f64().unwrap() - 0.05_f64.sin()).abs() < 2e-4, "{merged}");
    assert!((matrix[2][3].as_f64().unwrap() + 4.0).abs() < 0.3, "{merged}");
    for pair in merged["pairs"].as_array().unwrap() {
        assert!(
            pair["rms_mm"].as_f64().unwrap() < 0.05 && pair["overlap"].as_f64().unwrap() > 0.25,
            "{pair}"
        );
    }
    let averaged =
        uwscan(["merge", &left, &right, "-o", out, "--near", "20", "--average", "2", "--force", "--json"])
            .json(0);
    assert!(averaged["points"].as_u64().unwrap() < 6000, "{averaged}");
    // Beside it there is nothing of the first.
    let apart = cloud(&file("c.xyz"), 20..45, [0.0; 2]);
    uwscan(["merge", &left, &apart, "-o", out, "--force", "--near", "5"]).fails(&["c.xyz", "no overlap"]);
    uwscan(["merge", &left, "-o", out]).is_misused(&["2"]);
    let few = dir.path().join("few.xyz");
    fs::write(&few, "0 0 900\n1 0 900\n0 1 900\n").unwrap();
    uwscan(["merge", few.to_str().unwrap(), &left, "-o", out, "--force"]).fails(&["few.xyz", "at least 6"]);
}

#[test]
fn clouds_are_cleaned_step_by_step() {
    let dir = TempDir::new().unwrap();
    let points = cloud(&dir.path().join("a.xyz"), -20..20, [0.0; 2]);
    let mut text = read_to_string(&points).unwrap();
    text += "0 0 700 0.02\n3 500 900 0.02\n";
    fs::write(&points, text).unwrap();
    let out = dir.path().join("out.ply");
    let out = out.to_str().unwrap();
    let cleaned = uwscan(["clean", &points, "-o", out, "--json"]).json(0);
    assert_eq!((&cleaned["lonely"], &cleaned["points"]), (&2.into(), &3600.into()), "{cleaned}");
    let cleaned = uwscan(["clean", &points, "-o", out, "--force", "--crop", "-5:5,,:897", "--json"]).json(0);
    assert!(cleaned["points"].as_u64().unwrap() < 900 && cleaned["lonely"] == 0, "{cleaned}");
    let args = ["clean", &points, "-o", out, "--force", "--outliers", "--normals", "--thin", "5", "--json"];
    let cleaned = uwscan(args).json(0);
    assert!(cleaned["thinned"].as_u64().unwrap() > 3000 && cleaned["without_normal"].is_u64(), "{cleaned}");
    let info = uwscan(["info", out, "--json"]).json(0);
    assert_eq!(info["attributes"], serde_json::json!(["sigma", "normal"]), "{info}");
    uwscan(["clean", &points, "-o", out, "--crop", "1,2,3"]).is_misused(&["three ranges"]);
    uwscan(["clean", &points, "-o", out, "--force", "--crop", "1e6:,,"]).fails(&["no point is left"]);
    // What has no square can't be judged by distances.
    let far = dir.path().join("far.xyz");
    fs::write(&far, "1e300 0 900\n1 0 900\n0 1 900\n").unwrap();
    uwscan(["clean", far.to_str().unwrap(), "-o", out, "--force"]).fails(&["far.xyz", "point 0"]);
}

#[test]
fn clouds_and_meshes_are_converted_by_their_endings() {
    let dir = TempDir::new().unwrap();
    let file = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    let mut from = cloud(&dir.path().join("a.xyz"), -20..20, [0.0; 2]);
    for ending in ["ply", "pcd", "e57", "csv"] {
        let to = file(&format!("b.{ending}"));
        let said = uwscan(["convert", &from, &to, "--json"]).json(0);
        assert_eq!(said["points"], 3600, "{ending}: {said}");
        let info = uwscan(["info", &to, "--json"]).json(0);
        assert_eq!(
            (&info["points"], &info["attributes"]),
            (&3600.into(), &serde_json::json!(["sigma"])),
            "{info}"
        );
        from = to;
    }
    uwscan(["convert", &from, &file("n.stl")]).fails(&["n.stl", "uwscan mesh"]);
    let mut from = reference(&dir.path().join("m.obj"), 1.0);
    for ending in ["stl", "ply", "obj"] {
        let to = file(&format!("n.{ending}"));
        assert_eq!(uwscan(["convert", &from, &to, "--json"]).json(0)["triangles"], 12800, "{ending}");
        from = to;
    }
}
