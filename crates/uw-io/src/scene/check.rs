//! What a scene file can't say.

use super::{ObjectRecord, SceneFile};
use crate::{
    capture::Kind,
    error::{Error, Problem},
    toml_file::TomlFile,
};

/// Images of a capture: more is a slip of typing.
const MOST_IMAGES: usize = 100_000;
/// Ten kilometres: nothing is farther.
const FARTHEST_MM: f64 = 1e7;

pub(super) fn check(file: &TomlFile, scene: &SceneFile) -> Result<Vec<Problem>, Error> {
    voltages(file, scene)?;
    figures(file, scene)?;
    let warnings = kind(file, scene)?;
    instrument(file, scene)?;
    if let Some(k) = scene.poses.iter().position(|p| !(finite(&p.position_mm) && finite(&p.rotation_deg))) {
        return Err(file.error("pose", format!("placement {k} is nowhere"), "give finite numbers"));
    }
    scene.objects.iter().try_for_each(|o| object(file, o))?;
    Ok(warnings)
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|x| x.abs() <= FARTHEST_MM)
}

fn voltages(file: &TomlFile, scene: &SceneFile) -> Result<(), Error> {
    let c = &scene.capture;
    if let Some(sweep) = c.sweep {
        if !c.voltages_v.is_empty() {
            let what = "both voltages_v and sweep say which voltages to take";
            return Err(file.error("capture.sweep", what, "remove one of them"));
        }
        if !(1..=MOST_IMAGES as u32).contains(&sweep.steps) {
            let what = format!("{} steps can't be taken", sweep.steps);
            return Err(file.error("capture.sweep", what, format!("give 1 to {MOST_IMAGES}")));
        }
    }
    let voltages = c.voltages();
    if voltages.is_empty() {
        let what = "nothing says at which voltages to take images";
        let mend = "add sweep = { from_v = -1.5, to_v = 1.5, steps = 100 }, or voltages_v";
        return Err(file.error("capture", what, mend));
    }
    if let Some(bad) = voltages.iter().find(|v| v.is_nan() || v.abs() > 1e3) {
        let what = format!("{bad} V is no galvanometer's voltage");
        return Err(file.error("capture", what, "mend the voltages"));
    }
    if voltages.len().saturating_mul(scene.poses.len().max(1)) > MOST_IMAGES {
        return Err(file.error(
            "capture",
            "these are too many images",
            format!("take {MOST_IMAGES} at most"),
        ));
    }
    Ok(())
}

fn figures(file: &TomlFile, scene: &SceneFile) -> Result<(), Error> {
    let SceneFile { capture: c, beam, lens, sensor, water, ambient, .. } = scene;
    let longest = c.interval_ms.max(0.001);
    for (key, value, range, unit) in [
        ("capture.interval_ms", c.interval_ms, 0.01..=1e6, "from 0.01 to 1e6 ms"),
        ("capture.exposure_ms", c.exposure_ms, 0.001..=longest, "positive, and at most the interval"),
        ("beam.half_angle_deg", beam.half_angle_deg, 0.1..=80.0, "from 0.1 to 80 degrees"),
        ("beam.waist_radius_mm", beam.waist_radius_mm, 1e-3..=100.0, "from 0.001 to 100 mm"),
        ("beam.waist_at_mm", beam.waist_at_mm, 0.0..=1e6, "from 0 to 1e6 mm"),
        ("beam.level", beam.level, 0.0..=1e4, "from 0 to 10000 of full scale"),
        ("lens.blur_px", lens.blur_px, 0.0..=20.0, "from 0 to 20 px"),
        ("lens.halo", lens.halo, 0.0..=1.0, "from 0 to 1"),
        ("lens.halo_px", lens.halo_px, 0.0..=200.0, "from 0 to 200 px"),
        ("lens.vignetting", lens.vignetting, 0.0..=1.0, "from 0 to 1"),
        ("sensor.full_well", sensor.full_well, 0.0..=1e9, "from 0 to 1e9 electrons"),
        ("sensor.read_noise", sensor.read_noise, 0.0..=1.0, "from 0 to 1 of full scale"),
        ("sensor.offset", sensor.offset, 0.0..=1.0, "from 0 to 1 of full scale"),
        ("sensor.speckle", sensor.speckle, 0.0..=1.0, "from 0 to 1"),
        ("sensor.speckle_px", sensor.speckle_px, 0.0..=10.0, "from 0 to 10 px"),
        ("water.attenuation_per_m", water.attenuation_per_m, 0.0..=1e3, "from 0 to 1000 a metre"),
        ("water.backscatter_per_m", water.backscatter_per_m, 0.0..=1e3, "from 0 to 1000 a metre"),
        ("ambient.laser_off", ambient.laser_off, 0.0..=1e3, "from 0 to 1000 of full scale"),
        ("ambient.laser_on", ambient.laser_on, 0.0..=1e3, "from 0 to 1000 of full scale"),
    ] {
        // NaN is in no range.
        if !range.contains(&value) {
            return Err(file.error(key, format!("{value} can't be"), format!("give a number {unit}")));
        }
    }
    if !finite(&scene.instrument.velocity_mm_s) {
        let what = "is no velocity";
        return Err(file.error("instrument.velocity_mm_s", what, "give three finite numbers"));
    }
    Ok(())
}

fn kind(file: &TomlFile, scene: &SceneFile) -> Result<Vec<Problem>, Error> {
    match (scene.capture.kind, &scene.capture.target) {
        (Kind::Calibration, None) => {
            let mend = "add [capture.target] with pattern, inner_corners and square_mm";
            Err(file.error("capture.target", "a calibration needs its target", mend))
        }
        (Kind::Calibration, Some(target)) => {
            let wrong = |(key, what, mend)| file.error(&format!("capture.{key}"), what, mend);
            target.check().map_err(wrong)?;
            if scene.poses.is_empty() {
                let mend = "add [[pose]] with position_mm and rotation_deg, once for each";
                return Err(file.error("pose", "a calibration needs placements of its target", mend));
            }
            Ok(Vec::new())
        }
        (Kind::Scan, _) if scene.objects.is_empty() => {
            let mend = "add [[object]] with name, shape and position_mm";
            Err(file.error("object", "there is nothing to scan", mend))
        }
        (Kind::Scan, target) if target.is_some() || !scene.poses.is_empty() => {
            let what = "a scan has no target and no poses: they are ignored";
            Ok(vec![file.warning("capture.target", what, "remove [capture.target] and [[pose]]")])
        }
        (Kind::Scan, _) => Ok(Vec::new()),
    }
}

fn object(file: &TomlFile, o: &ObjectRecord) -> Result<(), Error> {
    let at = |key: &str, what: &str, mend: &str| {
        file.error("object", format!("\"{}\": {key} {what}", o.name), mend)
    };
    o.shape().map_err(|(key, what, mend)| at(key, &what, &mend))?;
    for (key, values) in [
        ("position_mm", o.position_mm),
        ("rotation_deg", o.rotation_deg),
        ("velocity_mm_s", o.velocity_mm_s),
        ("turn_deg_s", o.turn_deg_s),
    ] {
        if !finite(&values) {
            return Err(at(key, &format!("is {values:?}"), "give three finite numbers"));
        }
    }
    for (key, value) in [("albedo", o.albedo), ("specular", o.specular)] {
        if !(0.0..=1.0).contains(&value) {
            return Err(at(key, &format!("{value} is no share of the light"), "give a number from 0 to 1"));
        }
    }
    Ok(())
}

fn instrument(file: &TomlFile, scene: &SceneFile) -> Result<(), Error> {
    let i = &scene.instrument;
    let placed = [
        ("instrument.axis_point_mm", i.axis_point_mm),
        ("instrument.axis_direction", i.axis_direction),
        ("instrument.beam_direction", i.beam_direction),
    ];
    match (&i.rig, &i.calibration) {
        (None, None) => {
            let mend = "add rig = \"rig.toml\", or calibration = \"calibration.toml\"";
            Err(file.error("instrument", "nothing says which instrument takes the images", mend))
        }
        (Some(_), Some(_)) => {
            let what = "both a rig and a calibration are given";
            Err(file.error("instrument.calibration", what, "remove one of them"))
        }
        (None, Some(_)) => match placed.iter().find(|(_, given)| given.is_some()) {
            Some((key, _)) => Err(file.error(key, "a calibration says this itself", "remove it")),
            None => Ok(()),
        },
        (Some(_), None) => placed.into_iter().try_for_each(|(key, given)| {
            let Some(values) = given else {
                let mend = "give it in the camera's frame, such as [430.0, 0.0, -13.0]";
                return Err(file.error(key, "is missing: a rig file does not say it", mend));
            };
            let long = values.iter().any(|x| x.abs() > 1e-6) || key.ends_with("mm");
            if finite(&values) && long {
                return Ok(());
            }
            Err(file.error(key, format!("{values:?} is none"), "give three finite numbers, not all zero"))
        }),
    }
}
