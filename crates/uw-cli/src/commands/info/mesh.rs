//! What a mesh holds.

use std::path::Path;

use serde::Serialize;
use uwscan::io::{self, meshes};

use super::{Content, What};
use crate::text::many;

#[derive(Serialize)]
pub(super) struct Record {
    vertices: usize,
    triangles: usize,
    area_mm2: f64,
    volume_mm3: Option<f64>,
    boundary_loops: usize,
    boundary_edges: usize,
    crowded_edges: usize,
    flipped_edges: usize,
    components: usize,
    frame: &'static str,
    attributes: Vec<&'static str>,
    low_mm: Option<[f64; 3]>,
    high_mm: Option<[f64; 3]>,
}

pub(super) fn look(path: &Path) -> Result<Content, io::Error> {
    let (mesh, problems) = meshes::read(path)?;
    let topology = mesh.topology();
    let attributes = [
        ("normal", mesh.normals().is_some()),
        ("sigma", mesh.sigmas_mm().is_some()),
        ("intensity", mesh.intensities().is_some()),
        ("deviation", mesh.deviations_mm().is_some()),
        ("color", mesh.colors().is_some()),
    ];
    let (low_mm, high_mm) = mesh.bounding_box_mm().unzip();
    let record = Record {
        vertices: mesh.vertices_mm().len(),
        triangles: mesh.triangles().len(),
        area_mm2: mesh.area_mm2(),
        volume_mm3: topology.is_closed().then(|| mesh.volume_mm3()),
        boundary_loops: topology.boundary_loops,
        boundary_edges: topology.boundary_edges,
        crowded_edges: topology.crowded_edges,
        flipped_edges: topology.flipped_edges,
        components: topology.components,
        frame: mesh.frame().name(),
        attributes: attributes.into_iter().filter_map(|(name, there)| there.then_some(name)).collect(),
        low_mm,
        high_mm,
    };
    let none = "none but the positions".to_owned();
    let attributes = if record.attributes.is_empty() { none } else { record.attributes.join(", ") };
    let shut = match record.volume_mm3 {
        Some(volume) => format!("closed, {volume:.1} mm³"),
        None => format!("open, {} of {} edges", many(record.boundary_loops, "loop"), record.boundary_edges),
    };
    let mut text = format!(
        "mesh\n  triangles   {} on {} vertices, {:.1} mm², {}\n  surface     {shut}\n  frame       {}\n  \
         attributes  {attributes}\n",
        record.triangles,
        record.vertices,
        record.area_mm2,
        many(record.components, "part"),
        record.frame
    );
    if let Some((low, high)) = record.low_mm.zip(record.high_mm) {
        let size: Vec<String> = std::iter::zip(low, high).map(|(l, h)| format!("{l:.2} to {h:.2}")).collect();
        text += &format!("  extent      {} mm\n", size.join(", "));
    }
    let mut warnings = Vec::new();
    if record.crowded_edges > 0 {
        warnings.push(format!("{} edges have more than two triangles", record.crowded_edges));
    }
    if record.flipped_edges > 0 {
        warnings.push(format!(
            "at {} edges the triangles disagree about which side is out",
            record.flipped_edges
        ));
    }
    if record.volume_mm3.is_some_and(|volume| volume < 0.0) {
        warnings.push("the triangles face inwards".to_owned());
    }
    Ok(Content { what: What::Mesh(record), text, warnings, problems })
}
