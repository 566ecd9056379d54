//! Meshes out and in again, and files that are none.

use std::fs;

use tempfile::TempDir;
use uw_cloud::{Frame, TriangleMesh};
use uw_io::{Overwrite, meshes};

/// STL holds floats of four bytes, as text the shortest that reads back as the same: a unit in the last place near 1000, mm.
const SINGLE_MM: f64 = 6.2e-5;

/// A tent of four triangles over a square, with all that a mesh can have.
fn tent() -> TriangleMesh {
    let vertices = vec![
        [0.1, 0.2, 1000.0],
        [10.3, 0.0, 1000.7],
        [10.0, 9.9, 1001.0],
        [0.0, 10.0, 999.3],
        [5.0, 5.0, 1.0 / 3.0 + 990.0],
    ];
    let triangles = vec![[1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]];
    let mesh = TriangleMesh::new(Frame::Galvo, vertices, triangles).unwrap().with_vertex_normals();
    let mesh = mesh.with_sigmas_mm(vec![0.01, 0.02, 0.03, 0.04, 0.05]).unwrap();
    let mesh = mesh.with_intensities(vec![1.0, 2.0, 3.0, 4.0, 255.0]).unwrap();
    mesh.with_deviations_mm(vec![-0.5, 0.25, 0.0, 1e-9, 3.0]).unwrap()
}

#[test]
fn ply_gives_back_all_of_a_mesh_in_either_encoding() {
    let dir = TempDir::new().unwrap();
    for (name, text) in [("binary.ply", false), ("ascii.PLY", true)] {
        let path = dir.path().join(name);
        let format = meshes::Format::of(&path).unwrap();
        let format = if text { format.as_text() } else { format };
        meshes::write(&path, Overwrite::Refuse, &tent(), format).unwrap();
        assert!(meshes::is_mesh(&path).unwrap());
        let (mesh, problems) = meshes::read(&path).unwrap();
        assert_eq!((mesh, problems.len()), (tent(), 0), "{name}");
        assert_eq!(fs::read(&path).unwrap().is_ascii(), text);
        // Its vertices are a cloud for what takes one.
        assert_eq!(uw_io::clouds::read(&path).unwrap().0.len(), 5);
    }
}

#[test]
fn obj_keeps_every_digit_and_stl_those_of_a_float() {
    let dir = TempDir::new().unwrap();
    let obj = dir.path().join("tent.obj");
    meshes::write(&obj, Overwrite::Refuse, &tent(), meshes::Format::Obj).unwrap();
    let (mesh, _) = meshes::read(&obj).unwrap();
    assert_eq!((mesh.vertices_mm(), mesh.triangles()), (tent().vertices_mm(), tent().triangles()));
    assert_eq!(mesh.frame(), Frame::Galvo);
    for text in [false, true] {
        let stl = dir.path().join("tent.stl");
        let format = meshes::Format::of(&stl).unwrap();
        let format = if text { format.as_text() } else { format };
        meshes::write(&stl, Overwrite::Replace, &tent(), format).unwrap();
        let (mesh, _) = meshes::read(&stl).unwrap();
        assert_eq!(mesh.triangles().len(), 4);
        assert_eq!(mesh.vertices_mm().len(), 5, "corners at one place are one vertex");
        assert_eq!(mesh.topology(), tent().topology());
        for (t, original) in mesh.triangles().iter().zip(tent().triangles()) {
            for (a, b) in t.iter().zip(original) {
                let (a, b) = (mesh.vertices_mm()[*a as usize], tent().vertices_mm()[*b as usize]);
                assert!((0..3).all(|k| (a[k] - b[k]).abs() <= SINGLE_MM), "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn glb_is_a_container_of_json_and_of_the_numbers_it_tells_of() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("tent.glb");
    meshes::write(&path, Overwrite::Refuse, &tent(), meshes::Format::Glb).unwrap();
    let bytes = fs::read(&path).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let json = word(12);
    assert_eq!((&bytes[16..20], &bytes[24 + json..28 + json], json % 4), (&b"JSON"[..], &b"BIN\0"[..], 0));
    // Four triangles of three indices of four bytes, five vertices with positions and normals of three floats.
    assert_eq!(word(20 + json), 4 * 12 + 5 * 24);
    assert_eq!(bytes.len(), 28 + json + 4 * 12 + 5 * 24);
    let text = std::str::from_utf8(&bytes[20..20 + json]).unwrap();
    for part in [r#""count":12"#, r#""count":5"#, r#""NORMAL":2"#, r#""byteLength":168"#] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let error = meshes::read(&path).unwrap_err().to_string();
    assert!(error.contains("tent.glb") && error.contains(".stl"), "{error}");
}

#[test]
fn polygons_of_others_become_triangles() {
    let dir = TempDir::new().unwrap();
    let ply = dir.path().join("quad.ply");
    let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
        property uchar red\nproperty list uchar uint vertex_index\nend_header\n";
    fs::write(&ply, format!("{header}0 0 0\n1 0 0\n1 1 0\n0 1 0\n255 4 0 1 2 3\n")).unwrap();
    assert_eq!(meshes::read(&ply).unwrap().0.triangles(), [[0, 1, 2], [0, 2, 3]]);
    let obj = dir.path().join("quad.obj");
    fs::write(&obj, "# a square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nusemtl stone\nf 1/1 2/1 3/1 4/1\nf -4 -3 -2\n").unwrap();
    assert_eq!(meshes::read(&obj).unwrap().0.triangles(), [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
}

#[test]
fn what_is_torn_or_no_mesh_is_refused_with_its_place() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let write = |name: &str, bytes: &[u8]| fs::write(path(name), bytes).unwrap();
    for name in ["whole.ply", "whole.stl", "whole.obj"] {
        meshes::write(&path(name), Overwrite::Refuse, &tent(), meshes::Format::of(&path(name)).unwrap())
            .unwrap();
    }
    let whole = |name: &str| fs::read(path(name)).unwrap();
    let (ply, stl) = (whole("whole.ply"), whole("whole.stl"));
    write("torn.ply", &ply[..ply.len() - 5]);
    write("torn.stl", &stl[..stl.len() - 5]);
    write("long.stl", &[stl.as_slice(), b"x"].concat());
    write("short.stl", b"solid");
    write("word.stl", b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 zero\n");
    write(
        "two.stl",
        b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid\n",
    );
    write("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n");
    write("faceless.obj", b"v 0 0 0\n");
    write("nan.obj", b"v 0 0 nan\n");
    write("cloud.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n");
    write("metres.obj", b"# unit m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    write("beyond.ply", b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n");
    for (name, parts) in [
        ("torn.ply", &["ends after 3 of 4", "face"][..]),
        ("torn.stl", &["4 triangles"]),
        ("long.stl", &["4 triangles"]),
        ("short.stl", &["endsolid"]),
        ("word.stl", &[":4", "three numbers"]),
        ("two.stl", &[":6", "three vertices"]),
        ("beyond.obj", &[":4", "not among the 3"]),
        ("faceless.obj", &["no faces"]),
        ("nan.obj", &[":1", "finite"]),
        ("cloud.ply", &["a cloud, not a mesh"]),
        ("metres.obj", &["millimetres"]),
        ("beyond.ply", &["none of the 3 vertices"]),
        ("nowhere.stl", &["check the path"]),
        ("mesh.txt", &[".glb"]),
    ] {
        let error = meshes::read(&path(name)).expect_err(name).to_string();
        for part in parts.iter().chain([&name]) {
            assert!(error.contains(part), "{part:?} in {error:?}");
        }
    }
    assert!(!meshes::is_mesh(&path("cloud.ply")).unwrap());
}
