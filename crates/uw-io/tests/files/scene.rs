use std::path::Path;

use uw_io::{
    Error, Kind, Medium,
    scene::{SceneFile, ShapeRecord},
};

use crate::samples::says;

const SCENE: &str = r#"
format  = "uwscan-scene"
version = 1
[capture]
kind   = "scan"
medium = "water"
sweep  = { from_v = -1.0, to_v = 1.0, steps = 5 }
[instrument]
rig            = "rig.toml"
axis_point_mm  = [430.0, 0.0, -13.0]
axis_direction = [0.0, -1.0, 0.0]
beam_direction = [-0.4, 0.0, 0.9]
[[object]]
name        = "ball"
shape       = "sphere"
radius_mm   = 20.0
position_mm = [0.0, 1.0, 800.0]
"#;

fn parse(text: &str) -> Result<SceneFile, Error> {
    SceneFile::parse(Path::new("scene.toml"), text).map(|(scene, _)| scene)
}

#[test]
fn a_scene_is_read_whole_with_its_defaults() {
    let scene = parse(SCENE).unwrap();
    assert_eq!((scene.capture.kind, scene.capture.medium, scene.seed), (Kind::Scan, Medium::Water, 1));
    assert_eq!(scene.capture.voltages().map_bits(), [-1.0_f64, -0.5, 0.0, 0.5, 1.0].map(f64::to_bits));
    assert_eq!(scene.objects[0].shape(), Ok(ShapeRecord::Sphere { radius_mm: 20.0 }));
    assert!((scene.lens.blur_px - 0.6).abs() < 1e-12 && scene.instrument.differs_by_seed.is_none());
}

trait Bits {
    fn map_bits(&self) -> Vec<u64>;
}

impl Bits for Vec<f64> {
    fn map_bits(&self) -> Vec<u64> {
        self.iter().map(|x| x.to_bits()).collect()
    }
}

#[test]
fn what_no_scene_says_is_refused_with_place_and_mend() {
    for (from, to, wanted) in [
        ("uwscan-scene", "uwscan-rig", "uwscan-scene"),
        ("steps = 5", "steps = 0", "0 steps"),
        ("sweep  = { from_v = -1.0, to_v = 1.0, steps = 5 }", "", "at which voltages"),
        ("kind   = \"scan\"", "kind   = \"calibration\"", "needs its target"),
        ("rig            = \"rig.toml\"", "", "which instrument"),
        ("axis_point_mm  = [430.0, 0.0, -13.0]", "", "axis_point_mm"),
        ("axis_direction = [0.0, -1.0, 0.0]", "axis_direction = [0.0, 0.0, 0.0]", "not all zero"),
        ("radius_mm   = 20.0", "", "add a line: radius_mm"),
        ("radius_mm   = 20.0", "radius_mm = 20.0\nsides_mm = [1.0, 2.0]", "means nothing for this shape"),
        ("radius_mm   = 20.0", "radius_mm = 20.0\nalbedo = 1.5", "no share of the light"),
        ("\"sphere\"", "\"spere\"", "sphere"),
        ("[[object]]", "[lens]\nblur_px = -1.0\n[[object]]", "blur_px"),
        ("[[object]]", "[lens]\nblurr_px = 1.0\n[[object]]", "did you mean `blur_px`?"),
        ("position_mm = [0.0, 1.0, 800.0]", "position_mm = [0.0, 1.0]", "3 values"),
    ] {
        let text = SCENE.replacen(from, to, 1);
        assert_ne!(text, SCENE, "{from}");
        let error = parse(&text).map(drop).unwrap_err();
        says(&error.to_string(), &["scene.toml", wanted]);
    }
}

#[test]
fn a_new_folder_is_there_whole_or_not_at_all() {
    use uw_io::{NewFolder, Overwrite};
    let dir = tempfile::TempDir::new().unwrap();
    let target = dir.path().join("out");
    let begin = |overwrite| NewFolder::begin(&target, overwrite, "mark");
    let first = begin(Overwrite::Refuse).unwrap();
    std::fs::write(first.path().join("mark"), "1").unwrap();
    drop(first);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "a folder that was given up is gone");
    let write = |text: &str, overwrite| {
        let folder = begin(overwrite)?;
        std::fs::write(folder.path().join("mark"), text).unwrap();
        folder.finish()
    };
    write("2", Overwrite::Refuse).unwrap();
    assert!(matches!(write("3", Overwrite::Refuse), Err(Error::Exists { .. })));
    write("4", Overwrite::Replace).unwrap();
    assert_eq!(std::fs::read_to_string(target.join("mark")).unwrap(), "4");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "nothing is left beside it");
    // What holds other things is somebody else's.
    std::fs::remove_file(target.join("mark")).unwrap();
    std::fs::write(target.join("thesis.tex"), "dear").unwrap();
    says(&write("5", Overwrite::Replace).unwrap_err().to_string(), &["out", "mark"]);
    assert!(target.join("thesis.tex").exists());
}
