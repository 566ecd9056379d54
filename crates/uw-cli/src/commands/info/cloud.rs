//! What a point cloud holds.

use std::path::Path;

use serde::Serialize;
use uwscan::{
    cloud::PointCloud,
    io::{self, clouds},
};

use super::{Content, What};

#[derive(Serialize)]
pub(super) struct Record {
    points: usize,
    frame: &'static str,
    attributes: Vec<&'static str>,
    low_mm: Option<[f64; 3]>,
    high_mm: Option<[f64; 3]>,
    median_sigma_mm: Option<f32>,
}

pub(super) fn look(path: &Path) -> Result<Content, io::Error> {
    let (cloud, problems) = clouds::read(path)?;
    let record = record(&cloud);
    let none = "none but the positions".to_owned();
    let attributes = if record.attributes.is_empty() { none } else { record.attributes.join(", ") };
    let mut text = format!(
        "cloud\n  points      {}\n  frame       {}\n  attributes  {attributes}\n",
        record.points, record.frame
    );
    if let Some((low, high)) = record.low_mm.zip(record.high_mm) {
        let size: Vec<String> = std::iter::zip(low, high).map(|(l, h)| format!("{l:.2} to {h:.2}")).collect();
        text += &format!("  extent      {} mm\n", size.join(", "));
    }
    if let Some(sigma) = record.median_sigma_mm {
        text += &format!("  sigma       {sigma:.4} mm (median)\n");
    }
    let warnings = if cloud.is_empty() { vec!["the cloud has no points".to_owned()] } else { Vec::new() };
    Ok(Content { what: What::Cloud(record), text, warnings, problems })
}

fn record(cloud: &PointCloud) -> Record {
    let attributes = [
        ("intensity", cloud.intensities().is_some()),
        ("frame", cloud.frame_rows().is_some()),
        ("pixel", cloud.pixels().is_some()),
        ("sigma", cloud.sigmas_mm().is_some()),
        ("covariance", cloud.covariances_mm2().is_some()),
        ("shared", cloud.shared_mm().is_some()),
        ("normal", cloud.normals().is_some()),
        ("deviation", cloud.deviations_mm().is_some()),
        ("color", cloud.colors().is_some()),
    ];
    let (low_mm, high_mm) = cloud.bounding_box_mm().unzip();
    let median = |sigmas: &[f32]| {
        let mut sigmas = sigmas.to_vec();
        let middle = sigmas.len() / 2;
        (middle < sigmas.len()).then(|| *sigmas.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    Record {
        points: cloud.len(),
        frame: cloud.frame().name(),
        attributes: attributes.into_iter().filter_map(|(name, there)| there.then_some(name)).collect(),
        low_mm,
        high_mm,
        median_sigma_mm: cloud.sigmas_mm().and_then(median),
    }
}
