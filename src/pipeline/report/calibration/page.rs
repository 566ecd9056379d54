//! The page of a calibration: what remains, where the view is covered, how the boards stood, what is known how well, what was left out.

use crate::pipeline::calibrate::Calibrated;
use crate::pipeline::report::calibration::{CORRELATED, CalibrationReport, PoseRecord, correlation, rms};
use crate::pipeline::report::page::{cell, framed, notes, quantities};
use crate::pipeline::report::plots::histogram_plot;
use crate::pipeline::report::record::HistogramRecord;
use crate::pipeline::report::views::rounded_up;
use nalgebra::{DMatrix, Vector2};
use std::collections::BTreeMap;
use uw_calib::{GLOBALS, ViewResiduals};
use uw_report::{Axis, Block, Cell, Column, Ink, Layer, Marker, Note, Page, Plot, Scale, Section, Table};

/// Cells of a residual map along the image's width.
const CELLS: f64 = 16.0;
/// Classes of a histogram of residuals.
const CLASSES: usize = 41;

/// The page of a calibration.
pub fn calibration_page(report: &CalibrationReport, calibrated: &Calibrated) -> Page {
    let calibration = &calibrated.file.calibration;
    let size = calibration.image_size.map(f64::from);
    let views = &calibrated.remains;
    let mut sections = vec![summary(report)];
    if !views.is_empty() {
        sections.push(residuals(views, size));
        sections.push(coverage(views, size));
        sections.push(poses(report));
    }
    let mut figures = Section::new("Figures and what they rest on");
    figures.push(quantities(&report.figures, "/figures"));
    if let Some(covariance) = &calibration.covariance {
        figures.push(correlations(covariance));
        figures.blocks.extend(correlated(report).map(Block::Table));
    }
    sections.push(figures);
    sections.push(left_out(report));
    framed("Calibration of the instrument", &report.head, "", sections)
}

fn summary(report: &CalibrationReport) -> Section {
    let mut section = Section::new("Summary and advice");
    section.blocks.extend(notes(&report.warnings, &report.lost));
    if report.warnings.is_empty() {
        section.push(Block::Notes(vec![Note::Remark(
            "The set is complete: boards in air and in water, at several distances, tilts and voltages. There is nothing to capture anew."
                .to_owned(),
        )]));
    }
    let row = |name: &str, cell: Cell| vec![name.into(), cell];
    let whole = |n: usize, at: &str| Cell::figure(n.to_string(), n as f64, at);
    section.push(Table {
        caption: format!("What remains, {} method", report.method),
        columns: vec![Column::text("quantity"), Column::number("value")],
        rows: vec![
            row("corners, rms, px", cell(report.reprojection_rms_px, 4, "/reprojection_rms_px")),
            row("stripes, rms, px", cell(report.stripe_rms_px, 4, "/stripe_rms_px")),
            row("stripes on the board, rms, mm", cell(report.stripe_rms_mm, 4, "/stripe_rms_mm")),
            row("corners that took part", whole(report.corners[0], "/corners/0")),
            row("corners rejected", whole(report.corners[1], "/corners/1")),
            row("measurements of stripes that took part", whole(report.stripe_points[0], "/stripe_points/0")),
            row(
                "measurements left out (edges, outliers)",
                whole(report.stripe_points[1], "/stripe_points/1"),
            ),
            row("corners: scatter over predicted sigma", cell(report.scales[0], 3, "/scales/0")),
            row("stripes: scatter over predicted sigma", cell(report.scales[1], 3, "/scales/1")),
        ],
        note: String::new(),
    });
    let rows =
        report.captures.iter().map(|s| vec![s.name.clone().into(), s.medium.into(), s.sha256.clone().into()]);
    section.push(Table {
        caption: "Captures".to_owned(),
        columns: vec![Column::text("capture"), Column::text("medium"), Column::text("SHA-256")],
        rows: rows.collect(),
        note: String::new(),
    });
    section
}

/// The image as a plot's axes: u to the right, v down.
fn image_axes([width, height]: [f64; 2]) -> [Axis; 2] {
    [
        Axis { label: "u, px".to_owned(), range: [0.0, width] },
        Axis { label: "v, px".to_owned(), range: [height, 0.0] },
    ]
}

fn image_plot(title: &str, description: String, size: [f64; 2], layers: Vec<Layer>) -> Plot {
    let [x, y] = image_axes(size);
    Plot { title: title.to_owned(), description, x, y, layers, equal: true, scale: None }
}

/// Sums over cells of the image.
fn in_cells<T: Copy + std::ops::AddAssign + Default>(
    values: impl Iterator<Item = (Vector2<f64>, T)>,
    side: f64,
) -> BTreeMap<(i64, i64), (T, usize)> {
    let mut cells: BTreeMap<(i64, i64), (T, usize)> = BTreeMap::new();
    for (pixel, value) in values {
        let cell =
            cells.entry(((pixel.x / side).floor() as i64, (pixel.y / side).floor() as i64)).or_default();
        cell.0 += value;
        cell.1 += 1;
    }
    cells
}

fn corners(views: &[ViewResiduals]) -> impl Iterator<Item = &uw_calib::CornerRemains> {
    views.iter().flat_map(|v| &v.corners)
}

fn stripe_points(views: &[ViewResiduals]) -> impl Iterator<Item = &uw_calib::StripePointRemains> {
    views.iter().flat_map(|v| &v.stripes).flat_map(|s| &s.points)
}

/// A summed vector that has a default, as a cell's sum begins.
#[derive(Clone, Copy, Default)]
struct Sum(f64, f64);

impl std::ops::AddAssign for Sum {
    fn add_assign(&mut self, other: Self) {
        self.0 += other.0;
        self.1 += other.1;
    }
}

fn residuals(views: &[ViewResiduals], size: [f64; 2]) -> Section {
    let mut section = Section::new("Residuals");
    section.push("What is random here is noise. What has a pattern is the model's fault, or the board's: a bent board, a lens or window that is not as modelled.");
    let side = size[0] / CELLS;
    let used = corners(views).filter(|c| c.used);
    let cells = in_cells(used.map(|c| (c.pixel, Sum(c.residual_px.x, c.residual_px.y))), side);
    let means: Vec<(Vector2<f64>, Vector2<f64>)> = cells
        .iter()
        .map(|((i, j), (Sum(x, y), n))| {
            let middle = Vector2::new(*i as f64 + 0.5, *j as f64 + 0.5) * side;
            (middle, Vector2::new(*x, *y) / *n as f64)
        })
        .collect();
    let longest = means.iter().map(|(_, mean)| mean.norm()).fold(0.0, f64::max);
    let unit = rounded_up(longest);
    let arrows = means.iter().map(|(at, mean)| {
        let by = mean * (side / unit);
        [at.x - 0.5 * by.x, at.y - 0.5 * by.y, at.x + 0.5 * by.x, at.y + 0.5 * by.y]
    });
    let name = format!("an arrow as long as a cell is {unit} px");
    let arrows = Layer::Arrows { name, ink: Ink::Series(0), arrows: arrows.collect() };
    section.push(image_plot(
        "Corners: mean residual over cells of the image",
        format!(
            "Model less measurement, {} corners; the longest mean is {longest:.4} px.",
            corners(views).filter(|c| c.used).count()
        ),
        size,
        vec![arrows],
    ));
    let both = || corners(views).filter(|c| c.used).flat_map(|c| [c.residual_px.x, c.residual_px.y]);
    section.push(residual_histogram(&both().collect::<Vec<_>>(), "Corners: residuals along u and v"));

    let fine = side / 2.0;
    let cells = in_cells(stripe_points(views).filter(|p| p.used).map(|p| (p.pixel, p.residual_px)), fine);
    let means: Vec<((i64, i64), f64)> =
        cells.into_iter().map(|(at, (sum, n))| (at, sum / n as f64)).collect();
    let reach = rounded_up(rms(means.iter().map(|(_, m)| m * m)) * 2.0);
    let scale = Scale::diverging(reach);
    let coloured = means.iter().map(|((i, j), mean)| {
        let [x, y] = [*i as f64 * fine, *j as f64 * fine];
        ([x, (x + fine).min(size[0]), y, (y + fine).min(size[1])], scale.colour(*mean))
    });
    let mut map = image_plot(
        "Stripes: mean residual over cells of the image",
        format!(
            "Model less measurement across the stripe, {} measurements.",
            stripe_points(views).filter(|p| p.used).count()
        ),
        size,
        vec![Layer::Cells { cells: coloured.collect() }],
    );
    map.scale = Some((scale, "px".to_owned()));
    section.push(map);
    let values: Vec<f64> = stripe_points(views).filter(|p| p.used).map(|p| p.residual_px).collect();
    section.push(residual_histogram(&values, "Stripes: residuals across the stripe"));
    section
}

fn residual_histogram(values: &[f64], title: &str) -> Plot {
    let reach = rounded_up(4.0 * rms(values.iter().map(|v| v * v)));
    let mut counts = vec![0; CLASSES];
    for value in values {
        let class = (value / reach + 1.0) / 2.0 * CLASSES as f64;
        counts[class.clamp(0.0, CLASSES as f64 - 1.0) as usize] += 1;
    }
    let histogram = HistogramRecord { from_mm: -reach, to_mm: reach, counts };
    let mut plot = histogram_plot(&histogram, title, "");
    plot.description = format!("{} residuals; those beyond the ends are in the last classes.", values.len());
    plot.x.label = "residual, px".to_owned();
    plot.y.label = "count".to_owned();
    plot
}

fn coverage(views: &[ViewResiduals], size: [f64; 2]) -> Section {
    let mut section = Section::new("Coverage of the view");
    section.push("Where nothing was seen, distortion and sheets are extrapolated.");
    for (title, what, all) in [
        (
            "Corners over the image",
            "corners",
            corners(views).filter(|c| c.used).map(|c| c.pixel).collect::<Vec<_>>(),
        ),
        (
            "Stripes over the image",
            "measurements",
            stripe_points(views).filter(|p| p.used).map(|p| p.pixel).collect(),
        ),
    ] {
        let side = size[0] / CELLS;
        let cells = in_cells(all.iter().map(|pixel| (*pixel, 1_usize)), side);
        let most = cells.values().map(|(_, n)| *n).max().unwrap_or(1) as f64;
        let scale = Scale::sequential([0.0, most]);
        let whole = ((size[0] / side).ceil() * (size[1] / side).ceil()) as usize;
        let coloured = cells.iter().map(|((i, j), (_, n))| {
            let [x, y] = [*i as f64 * side, *j as f64 * side];
            ([x, (x + side).min(size[0]), y, (y + side).min(size[1])], scale.colour(*n as f64))
        });
        let mut plot = image_plot(
            title,
            format!("{} {what}; they fall into {} of {whole} cells.", all.len(), cells.len()),
            size,
            vec![Layer::Cells { cells: coloured.collect() }],
        );
        plot.scale = Some((scale, format!("{what} a cell")));
        section.push(plot);
    }
    section
}

fn poses(report: &CalibrationReport) -> Section {
    let mut section = Section::new("Placements of the board");
    let by_medium = |place: fn(&PoseRecord) -> [f64; 2]| -> Vec<Layer> {
        let mut layers = Vec::new();
        for (at, (medium, marker)) in
            [("air", Marker::Disc), ("water", Marker::Triangle)].into_iter().enumerate()
        {
            let of = report.poses.iter().filter(|p| p.medium == medium);
            let places: Vec<[f64; 2]> = of.map(place).collect();
            if !places.is_empty() {
                let ink = Ink::Series(at as u8);
                layers.push(Layer::Points {
                    name: medium.to_owned(),
                    ink,
                    marker,
                    at: places,
                    sigmas: Vec::new(),
                });
            }
        }
        layers
    };
    let count = report.poses.len();
    let depth: fn(&PoseRecord) -> [f64; 2] = |p| [p.middle_mm[0], p.middle_mm[2]];
    let tilt: fn(&PoseRecord) -> [f64; 2] = |p| p.tilt_xy_deg;
    let plot = |title: &str, labels: [&str; 2], place: fn(&PoseRecord) -> [f64; 2], equal| {
        let values = |k: usize| report.poses.iter().map(move |p| place(p)[k]);
        Plot {
            title: title.to_owned(),
            description: format!("{count} placements."),
            x: Axis::around(labels[0], values(0)),
            y: Axis::around(labels[1], values(1)),
            layers: by_medium(place),
            equal,
            scale: None,
        }
    };
    section.push(plot("Where the boards stood, from above", ["x, mm", "z, mm"], depth, true));
    section.push(plot("How the boards were tilted", ["towards x, °", "towards y, °"], tilt, true));
    let rows = report.poses.iter().enumerate().map(|(k, p)| {
        let at = |name: &str| format!("/poses/{k}/{name}");
        vec![
            p.file.clone().into(),
            p.medium.into(),
            cell(p.middle_mm[2], 0, at("middle_mm/2")),
            cell(p.tilt_deg, 1, at("tilt_deg")),
            Cell::figure(p.corners.to_string(), p.corners as f64, at("corners")),
            cell(p.rms_px, 4, at("rms_px")),
            Cell::figure(p.stripes.to_string(), p.stripes as f64, at("stripes")),
        ]
    });
    section.push(Table {
        caption: "Placements".to_owned(),
        columns: vec![
            Column::text("image"),
            Column::text("medium"),
            Column::number("z, mm"),
            Column::number("tilt, °"),
            Column::number("corners"),
            Column::number("rms, px"),
            Column::number("stripes"),
        ],
        rows: rows.collect(),
        note: String::new(),
    });
    section
}

fn correlations(covariance: &DMatrix<f64>) -> Plot {
    let scale = Scale::diverging(1.0);
    let cells = (0..GLOBALS).flat_map(|i| {
        (0..GLOBALS).map(move |j| {
            let [x, y] = [i as f64 - 0.5, j as f64 - 0.5];
            ([x, x + 1.0, y, y + 1.0], scale.colour(correlation(covariance, i, j)))
        })
    });
    let end = GLOBALS as f64 - 0.5;
    Plot {
        title: "Correlations between the adjusted parameters".to_owned(),
        description: "Purple: −1, orange: +1, on the diagonal each with itself. The table names the pairs that the data hardly tell apart.".to_owned(),
        x: Axis { label: "parameter".to_owned(), range: [-0.5, end] },
        y: Axis { label: "parameter".to_owned(), range: [end, -0.5] },
        layers: vec![Layer::Cells { cells: cells.collect() }],
        equal: true,
        scale: Some((scale, String::new())),
    }
}

fn correlated(report: &CalibrationReport) -> Option<Table> {
    let rows: Vec<Vec<Cell>> = report
        .correlated
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let figure = Cell::figure(
                format!("{:+.4}", p.correlation),
                p.correlation,
                format!("/correlated/{k}/correlation"),
            );
            vec![p.a.clone().into(), p.b.clone().into(), figure]
        })
        .collect();
    (!rows.is_empty()).then(|| Table {
        caption: format!("Pairs with a correlation beyond ±{CORRELATED}"),
        columns: vec![Column::text("one"), Column::text("other"), Column::number("correlation")],
        rows,
        note: "Neither of a pair is known well by itself; what follows from both together is.".to_owned(),
    })
}

fn left_out(report: &CalibrationReport) -> Section {
    let mut section = Section::new("Images left out, and those that fit worst");
    if report.rejected.is_empty() {
        section.push("No image was left out.");
    } else {
        section.push(Table {
            caption: format!("Images left out: {}", report.rejected.len()),
            columns: vec![Column::text("image"), Column::text("reason")],
            rows: report
                .rejected
                .iter()
                .map(|r| vec![r.file.clone().into(), r.reason.clone().into()])
                .collect(),
            note: String::new(),
        });
    }
    if !report.worst.is_empty() {
        let rows = report.worst.iter().enumerate().map(|(k, w)| {
            let at = |name: &str| format!("/worst/{k}/{name}");
            vec![w.file.clone().into(), cell(w.rms_px, 4, at("rms_px")), cell(w.max_px, 4, at("max_px"))]
        });
        section.push(Table {
            caption: "Images with the largest residuals".to_owned(),
            columns: vec![Column::text("image"), Column::number("rms, px"), Column::number("largest, px")],
            rows: rows.collect(),
            note: String::new(),
        });
    }
    section
}
