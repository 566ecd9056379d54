//! A report's figures as a table: a line each.

use crate::pipeline::report::record::{FigureRecord, Record};

const HEADER: [&str; 9] =
    ["scan", "of", "with", "quantity", "value", "sigma", "sigma_total", "nominal", "error"];

/// The table as CSV (RFC 4180): `of` is a shape's label, or that of the first of two; what is not known is empty.
pub(crate) fn csv(record: &Record) -> String {
    let mut rows = vec![HEADER.map(str::to_owned).to_vec()];
    let mut add = |scan: &str, of: &str, with: &str, f: &FigureRecord| {
        let or_empty = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        let words = [scan, of, with, &f.name].map(str::to_owned);
        let numbers = [Some(f.value), f.sigma, f.sigma_total, f.nominal, f.error].map(or_empty);
        rows.push(words.into_iter().chain(numbers).collect());
    };
    let bare = |name: &str, value: f64| FigureRecord {
        name: name.to_owned(),
        value,
        sigma: None,
        sigma_total: None,
        nominal: None,
        error: None,
    };
    for scan in &record.scans {
        for shape in &scan.shapes {
            let label = &shape.label;
            shape.figures.iter().for_each(|f| add(&scan.name, label, "", f));
            add(&scan.name, label, "", &bare("rms_mm", shape.rms_mm));
            add(&scan.name, label, "", &bare("max_outside_mm", shape.max_outside_mm));
            add(&scan.name, label, "", &bare("max_inside_mm", shape.max_inside_mm));
            add(&scan.name, label, "", &bare("points", shape.points as f64));
        }
        for r in scan.distances.iter().chain(&scan.angles) {
            add(&scan.name, &r.a, &r.b, &r.figure);
        }
        if let Some(d) = &scan.deviations {
            for (name, value) in [
                ("deviation_mean_mm", d.mean_mm),
                ("deviation_rms_mm", d.rms_mm),
                ("deviation_robust_sigma_mm", d.robust_sigma_mm),
            ] {
                add(&scan.name, "", "", &bare(name, value));
            }
        }
    }
    let of_scan = |at: usize| record.scans.get(at).map_or("", |scan| scan.name.as_str());
    for p in &record.probing {
        add(of_scan(p.scan), &p.ball, "", &bare("probing_form_mm", p.form_mm));
        if let Some(size) = p.size_mm {
            add(of_scan(p.scan), &p.ball, "", &bare("probing_size_mm", size));
        }
    }
    for s in &record.spacing {
        let figure = bare("sphere_spacing_mm", s.distance_mm).against(Some(s.nominal_mm));
        add(of_scan(s.scan), &s.a, &s.b, &figure);
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    // Writing to memory can't fail, and all rows are of one length.
    let written = rows.iter().try_for_each(|row| writer.write_record(row));
    debug_assert!(written.is_ok());
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}
