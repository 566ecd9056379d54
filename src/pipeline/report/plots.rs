//! The plots of a report.

use crate::pipeline::report::record::{HistogramRecord, ImageRecord, Record};
use crate::pipeline::report::scan::Scan;
use crate::pipeline::report::views::{across, reach};
use std::collections::BTreeMap;
use uw_report::{Axis, Ink, Layer, Marker, Plot, Scale};

/// Bars along a sweep; more images are added up.
const MOST_BARS: usize = 160;
/// Reasons with a colour of their own; the rarer ones share one.
const MOST_REASONS: usize = 6;
/// Cells of a map along its longer side.
const CELLS: f64 = 90.0;
/// Classes of a histogram of deviations.
const CLASSES: usize = 41;

/// What became of the rows of each image: points, and rejected ones by reason. Rows without a stripe are left out: they would dwarf all else.
pub(crate) fn stripes(images: &[ImageRecord]) -> Option<Plot> {
    let mut totals: BTreeMap<&str, usize> = BTreeMap::new();
    for (reason, count) in images.iter().flat_map(|i| &i.rejected).filter(|(r, _)| *r != "no_signal") {
        *totals.entry(reason).or_default() += count;
    }
    let mut reasons: Vec<(&str, usize)> = totals.into_iter().collect();
    reasons.sort_by_key(|(reason, count)| (std::cmp::Reverse(*count), *reason));
    let named: Vec<&str> = reasons.iter().take(MOST_REASONS).map(|(reason, _)| *reason).collect();
    let mut names = vec!["points"];
    names.extend(&named);
    if reasons.len() > named.len() {
        names.push("other reasons");
    }
    let class = |reason: &str| named.iter().position(|n| *n == reason).map_or(names.len() - 1, |at| at + 1);

    let together = images.len().div_ceil(MOST_BARS).max(1);
    let mut layers: Vec<Vec<[f64; 4]>> = vec![Vec::new(); names.len()];
    let mut highest = 0.0_f64;
    for (bar, group) in images.chunks(together).enumerate() {
        let mut counts = vec![0_usize; names.len()];
        for image in group {
            counts[0] += image.points;
            for (reason, count) in image.rejected.iter().filter(|(r, _)| *r != "no_signal") {
                counts[class(reason)] += count;
            }
        }
        let wide = group.len() as f64;
        let from = (bar * together) as f64 - 0.5 + 0.05 * wide;
        let to = from + 0.9 * wide;
        let mut top = 0.0;
        for (layer, count) in layers.iter_mut().zip(&counts) {
            if *count > 0 {
                // Images that were added up stand for one.
                let next = top + *count as f64 / group.len() as f64;
                layer.push([from, to, top, next]);
                top = next;
            }
        }
        highest = highest.max(top);
    }
    let last = images.len().checked_sub(1)? as f64;
    let listed: Vec<String> = reasons.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    let points: usize = images.iter().map(|i| i.points).sum();
    Some(Plot {
        title: "Stripes found and rejected, image by image".to_owned(),
        description: format!(
            "{points} rows with a point in {} images; rejected: {}. Rows without any stripe are not shown.",
            images.len(),
            if listed.is_empty() { "none".to_owned() } else { listed.join(", ") }
        ),
        x: Axis {
            label: "image with the laser on, in the order of capture".to_owned(),
            range: [-1.0, last + 1.0],
        },
        y: Axis { label: "rows".to_owned(), range: [0.0, (1.05 * highest).max(1.0)] },
        layers: names
            .iter()
            .zip(layers)
            .enumerate()
            .map(|(at, (name, bars))| Layer::Bars {
                name: (*name).to_owned(),
                ink: Ink::Series(at as u8),
                bars,
            })
            .collect(),
        equal: false,
        scale: None,
    })
}

/// Deviations across the view: each cell has the mean of its points'.
pub(crate) fn map(scan: &Scan, of: &str) -> Option<Plot> {
    let (places, [right, up]) = across(&scan.cloud);
    let known: Vec<([f64; 2], f64)> = places
        .into_iter()
        .zip(&scan.deviations_mm)
        .filter(|(_, d)| d.is_finite())
        .map(|(p, d)| (p, f64::from(*d)))
        .collect();
    let scale = Scale::diverging(reach(&scan.deviations_mm)?);
    let x = Axis::around(right, known.iter().map(|(p, _)| p[0]));
    let y = Axis::around(up, known.iter().map(|(p, _)| p[1]));
    let span = |axis: &Axis| axis.range[1] - axis.range[0];
    let side = span(&x).max(span(&y)) / CELLS;
    let mut cells: BTreeMap<(i64, i64), (f64, usize)> = BTreeMap::new();
    for (p, deviation) in &known {
        let cell = cells.entry(((p[0] / side).floor() as i64, (p[1] / side).floor() as i64)).or_default();
        *cell = (cell.0 + deviation, cell.1 + 1);
    }
    let coloured = cells.iter().map(|((i, j), (sum, count))| {
        let [x0, y0] = [*i as f64 * side, *j as f64 * side];
        ([x0, x0 + side, y0, y0 + side], scale.colour(sum / *count as f64))
    });
    let layers = vec![Layer::Cells { cells: coloured.collect() }];
    Some(Plot {
        title: format!("Deviations from {of}, as the sensor sees them"),
        description: format!(
            "Means over cells of {side:.2} mm, {} points. Orange stands out (towards the outside, or the sensor), purple lies deeper.",
            known.len()
        ),
        x,
        y,
        layers,
        equal: true,
        scale: Some((scale, "mm".to_owned())),
    })
}

/// How many points lie how far off.
pub(crate) fn deviations(scan: &Scan, of: &str) -> Option<Plot> {
    let reach = 2.0 * reach(&scan.deviations_mm)?;
    let mut counts = vec![0; CLASSES];
    let mut beyond = 0;
    for d in scan.deviations_mm.iter().map(|d| f64::from(*d)).filter(|d| d.is_finite()) {
        let class = ((d / reach + 1.0) / 2.0 * CLASSES as f64).floor();
        match class {
            class if class >= 0.0 && class < CLASSES as f64 => counts[class as usize] += 1,
            _ => beyond += 1,
        }
    }
    let histogram = HistogramRecord { from_mm: -reach, to_mm: reach, counts };
    let beyond = format!("{beyond} points lie farther off than the axis goes.");
    Some(histogram_plot(&histogram, &format!("Deviations from {of}"), &beyond))
}

/// A histogram.
pub(crate) fn histogram_plot(histogram: &HistogramRecord, title: &str, said: &str) -> Plot {
    let HistogramRecord { from_mm, to_mm, counts } = histogram;
    let width = (to_mm - from_mm) / counts.len().max(1) as f64;
    let bars = counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(at, count)| {
        let from = from_mm + width * at as f64;
        [from + 0.05 * width, from + 0.95 * width, 0.0, *count as f64]
    });
    let highest = counts.iter().copied().max().unwrap_or_default() as f64;
    let range = if to_mm > from_mm { [*from_mm, *to_mm] } else { [from_mm - 1.0, to_mm + 1.0] };
    Plot {
        title: title.to_owned(),
        description: format!("{} points in classes of {width:.4} mm. {said}", counts.iter().sum::<usize>()),
        x: Axis { label: "deviation, mm".to_owned(), range },
        y: Axis { label: "points".to_owned(), range: [0.0, (1.08 * highest).max(1.0)] },
        layers: vec![Layer::Bars { name: String::new(), ink: Ink::Series(0), bars: bars.collect() }],
        equal: false,
        scale: None,
    }
}

/// A ball of a scan, as the plots along the distance show it.
struct Seen<'a> {
    label: &'a str,
    distance_mm: f64,
    radius_mm: f64,
    sigma: f64,
    error: Option<f64>,
    outside_mm: f64,
    inside_mm: f64,
}

fn balls(record: &Record) -> Vec<Seen<'_>> {
    let shapes = record.scans.iter().flat_map(|scan| &scan.shapes).filter(|s| s.kind == "sphere");
    shapes
        .filter_map(|shape| {
            let (_, radius) = shape.figure("radius_mm")?;
            let (_, z) = shape.figure("z_mm")?;
            Some(Seen {
                label: &shape.label,
                distance_mm: z.value,
                radius_mm: radius.value,
                sigma: radius.whole_sigma().unwrap_or_default(),
                error: radius.error,
                outside_mm: shape.max_outside_mm,
                inside_mm: shape.max_inside_mm,
            })
        })
        .collect()
}

/// Errors of the radii by distance (the paper's Figure 8), and the farthest points outside and inside (Figure 9); nothing for fewer than
/// two balls.
pub(crate) fn along_the_distance(record: &Record) -> Vec<Plot> {
    let mut seen = balls(record);
    // Where nominal values were given, a sphere without one is none of the artefact's balls.
    let judged = seen.iter().any(|s| s.error.is_some());
    seen.retain(|s| !judged || s.error.is_some());
    if seen.len() < 2 {
        return Vec::new();
    }
    let x = || Axis::around("z of the centre, mm", seen.iter().map(|s| s.distance_mm));
    let value = |s: &Seen<'_>| if judged { s.error.unwrap_or(f64::NAN) } else { s.radius_mm };
    let mut names: Vec<&str> = seen.iter().map(|s| s.label).collect();
    names.sort_unstable();
    names.dedup();
    // One ball in many places has one name; many without a name are shown alike.
    let alone = names.len() > 8;
    let markers = [Marker::Disc, Marker::Triangle, Marker::Square, Marker::Cross];
    let groups = if alone { vec!["balls"] } else { names };
    let layers = groups.iter().enumerate().map(|(at, name)| {
        let of: Vec<&Seen<'_>> = seen.iter().filter(|s| alone || s.label == *name).collect();
        Layer::Points {
            name: (*name).to_owned(),
            ink: Ink::Series(at as u8),
            marker: markers[at % markers.len()],
            at: of.iter().map(|s| [s.distance_mm, value(s)]).collect(),
            sigmas: of.iter().map(|s| s.sigma).collect(),
        }
    });
    let mut ends: Vec<f64> = seen
        .iter()
        .flat_map(|s| [value(s) - s.sigma, value(s) + s.sigma])
        .filter(|v| v.is_finite())
        .collect();
    if judged {
        ends.push(0.0);
    }
    let label = if judged { "radius less nominal, mm" } else { "radius, mm" };
    let (low, high) =
        ends.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let radii = Plot {
        title: if judged { "Error of the radius by distance" } else { "Radius by distance" }.to_owned(),
        description: format!(
            "{} balls, from {low:.4} to {high:.4} mm; bars are one sigma, with the calibration's part where it is known.",
            seen.len()
        ),
        x: x(),
        y: Axis::around(label, ends),
        layers: layers.collect(),
        equal: false,
        scale: None,
    };
    let farthest = |name: &str, series: u8, marker: Marker, of: fn(&Seen<'_>) -> f64| Layer::Points {
        name: name.to_owned(),
        ink: Ink::Series(series),
        marker,
        at: seen.iter().map(|s| [s.distance_mm, of(s)]).collect(),
        sigmas: Vec::new(),
    };
    let most = seen.iter().map(|s| s.outside_mm.max(s.inside_mm)).fold(0.0, f64::max);
    let extremes = Plot {
        title: "Farthest points outside and inside, by distance".to_owned(),
        description: format!("Of the points that each sphere was fitted to; {most:.4} mm at most."),
        x: x(),
        y: Axis { label: "distance from the sphere, mm".to_owned(), range: [0.0, (1.1 * most).max(1e-6)] },
        layers: vec![
            farthest("outside", 0, Marker::Disc, |s| s.outside_mm),
            farthest("inside", 1, Marker::Triangle, |s| s.inside_mm),
        ],
        equal: false,
        scale: None,
    };
    vec![radii, extremes]
}
