//! What a rig file or a calibration holds.

use serde::Serialize;
use uwscan::{
    calib::Across,
    io::{
        Problem, Rig,
        calibration_toml::{CalibrationFile, CaptureSource},
        rig::Port,
    },
};

use super::{Content, What};
use crate::{
    console::Console,
    figures::{Figures, Remains, figures_text, method_name, remains_text},
};

/// A calibration, as JSON has it.
#[derive(Serialize)]
pub(super) struct Record {
    method: &'static str,
    software: String,
    captures: Vec<CaptureSource>,
    stripe_along: &'static str,
    image_size: [u32; 2],
    nominal_water_index: Option<f64>,
    #[serde(flatten)]
    remains: serde_json::Value,
    #[serde(flatten)]
    values: Figures,
    sigmas: Option<Figures>,
}

pub(super) fn calibration((file, problems): (CalibrationFile, Vec<Problem>), console: &Console) -> Content {
    let calibration = &file.calibration;
    let s = &calibration.statistics;
    let quantities = calibration.quantities();
    let stripes = match calibration.across {
        Across::U => "columns",
        Across::V => "rows",
    };
    let mut text = format!(
        "calibration, {} method, by {}\n  images      {} x {} px, the stripe along the {stripes}\n",
        method_name(calibration.method),
        file.software,
        calibration.image_size[0],
        calibration.image_size[1],
    );
    for capture in &file.captures {
        let medium = super::capture::medium_name(capture.medium);
        text += &format!("  capture     {} (in {medium}, sha256 {:.12}…)\n", capture.name, capture.sha256);
    }
    text += &format!("  used        {} board poses, {} images\n", s.poses_used, s.frames_used);
    text += &remains_text(s, console.verbose());
    text += &figures_text(calibration, &quantities);
    let warnings = calibration.warnings.clone();
    let record = Record {
        method: method_name(calibration.method),
        stripe_along: stripes,
        image_size: calibration.image_size,
        nominal_water_index: calibration.nominal_water_index,
        remains: serde_json::to_value(Remains::new(s)).unwrap_or_default(),
        values: Figures::values(&quantities),
        sigmas: Figures::sigmas(calibration, &quantities),
        software: file.software,
        captures: file.captures,
    };
    Content { what: What::Calibration(Box::new(record)), text, warnings, problems }
}

pub(super) fn rig((rig, problems): (Rig, Vec<Problem>)) -> Content {
    let text = format!("rig\n{}", rig_text(&rig));
    Content { what: What::Rig { rig: Box::new(rig) }, text, warnings: Vec::new(), problems }
}

/// The instrument's drawing values, for people.
pub(super) fn rig_text(rig: &Rig) -> String {
    let (c, l, g) = (&rig.camera, &rig.laser, &rig.galvo);
    let port =
        |p: &Port| format!("{} mm behind {} mm of glass of index {}", p.distance_mm, p.thickness_mm, p.index);
    let apex =
        l.apex_mm.map_or("apex unknown".to_owned(), |mm| format!("apex {mm} mm from the mirror's axis"));
    let water = rig.water_index().map_or("none".to_owned(), |index| format!("index {index:.5}"));
    format!(
        "  camera      {} x {} px, {} bits, {} mm lens, {} x {} µm pixels, {}\n  laser       {} nm, {apex}, {}\n  \
         galvo       {}° per volt (mechanical), {} to {} V, reference {} V\n  water       {water}\n",
        c.width,
        c.height,
        c.bits,
        c.focal_mm,
        c.pixel_um[0],
        c.pixel_um[1],
        port(&c.port),
        l.wavelength_nm,
        port(&l.port),
        g.degrees_per_volt,
        g.range_v[0],
        g.range_v[1],
        g.reference_v,
    )
}
