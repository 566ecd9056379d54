//! What is on the page of a report, and in which words.

use crate::pipeline::report::artefact::{LEFT_OUT, NEAR_SURFACE};
use crate::pipeline::report::plots;
use crate::pipeline::report::record::{
    CalibrationRecord, FigureRecord, HeadRecord, Record, RelationRecord, ScanRecord, ShapeRecord,
};
use crate::pipeline::report::scan::Scan;
use crate::pipeline::report::views;
use uw_report::{Block, Cell, Column, Note, Page, Section, Table, decimals, plus_minus};

/// Distances and angles listed of one scan; the JSON file and the table have all.
const LISTED: usize = 30;

/// The page of a report.
pub(crate) fn page(record: &Record, scans: &[Scan]) -> Page {
    let mut sections = vec![summary(record)];
    sections.extend(balls(record));
    for (at, scan) in scans.iter().enumerate() {
        sections.push(one(record, at, scan));
    }
    sections.extend(errors(record));
    sections.push(instrument(record));
    sections.push(method(record));
    framed(&record.title, &record.head, "", sections)
}

/// A page with what is above and below the sections of each; `besides` follows the software's name.
pub(crate) fn framed(title: &str, head: &HeadRecord, besides: &str, sections: Vec<Section>) -> Page {
    let lengths = "Lengths in millimetres";
    Page {
        title: title.to_owned(),
        subtitle: head.made.as_ref().map_or_else(|| lengths.to_owned(), |made| format!("{made}. {lengths}")),
        sections,
        footer: format!(
            "{}{besides}. The figures in full: the JSON and CSV files beside this page.",
            head.software
        ),
    }
}

/// A figure with its sigma, and what it is in the record.
pub(crate) fn sigma_cell(f: &FigureRecord, at: &str) -> Cell {
    Cell::figure(plus_minus(f.value, f.whole_sigma()), f.value, format!("{at}/value"))
}

/// A figure with so many decimals.
pub(crate) fn cell(value: f64, digits: usize, at: impl Into<String>) -> Cell {
    if value.is_finite() { Cell::figure(format!("{value:.digits$}"), value, at) } else { Cell::Empty }
}

/// The same with its sign.
pub(crate) fn signed(value: f64, digits: usize, at: impl Into<String>) -> Cell {
    if value.is_finite() { Cell::figure(format!("{value:+.digits$}"), value, at) } else { Cell::Empty }
}

fn count(value: usize, at: impl Into<String>) -> Cell {
    Cell::figure(value.to_string(), value as f64, at)
}

/// Another standard deviation of a figure, with two digits.
fn spread(value: Option<f64>, at: String) -> Cell {
    value.map_or(Cell::Empty, |s| Cell::figure(format!("{s:.*}", decimals(s.max(1e-12))), s, at))
}

fn optional(value: Option<f64>, digits: usize, at: String) -> Cell {
    value.map_or(Cell::Empty, |v| cell(v, digits, at))
}

pub(crate) fn notes(warnings: &[String], lost: &[String]) -> Option<Block> {
    let all: Vec<Note> =
        lost.iter().cloned().map(Note::Loss).chain(warnings.iter().cloned().map(Note::Warning)).collect();
    (!all.is_empty()).then_some(Block::Notes(all))
}

fn summary(record: &Record) -> Section {
    let mut section = Section::new("Summary");
    section.blocks.extend(notes(&record.warnings, &record.lost));
    let rows = record.scans.iter().enumerate().map(|(at, scan)| {
        let shapes = |kind: &str| scan.shapes.iter().filter(|s| s.kind == kind).count();
        let found: Vec<String> = ["sphere", "plane", "cylinder"]
            .into_iter()
            .map(|kind| (kind, shapes(kind)))
            .filter(|(_, n)| *n > 0)
            .map(|(kind, n)| format!("{n} {kind}{}", if n == 1 { "" } else { "s" }))
            .collect();
        let found = if found.is_empty() { "none".to_owned() } else { found.join(", ") };
        vec![
            scan.name.clone().into(),
            scan.medium.unwrap_or("not told").into(),
            count(scan.points, format!("/scans/{at}/points")),
            spread(scan.point_sigma_mm.map(|s| s[0]), format!("/scans/{at}/point_sigma_mm/0")),
            spread(scan.point_sigma_mm.map(|s| s[1]), format!("/scans/{at}/point_sigma_mm/1")),
            found.into(),
        ]
    });
    section.push(Table {
        caption: "What was measured".to_owned(),
        columns: vec![
            Column::text("scan"),
            Column::text("medium"),
            Column::number("points"),
            Column::number("sigma of a point, median, mm"),
            Column::number("95 % are below, mm"),
            Column::text("shapes"),
        ],
        rows: rows.collect(),
        note: String::new(),
    });
    section
}

/// Every ball of every scan in one table, as the paper's Table 1, and the plots along the distance.
fn balls(record: &Record) -> Option<Section> {
    let judged = record.nominal.is_some();
    let mut columns = vec![Column::text("scan"), Column::text("ball")];
    columns.extend(["x", "y", "z", "radius"].map(|name| Column::number(format!("{name}, mm"))));
    if judged {
        columns.extend(["nominal, mm", "error, mm"].map(Column::number));
    }
    columns.push(Column::number("points"));
    let mut rows = Vec::new();
    for (i, scan) in record.scans.iter().enumerate() {
        for (j, shape) in scan.shapes.iter().enumerate().filter(|(_, s)| s.kind == "sphere") {
            let at = |k: usize| format!("/scans/{i}/shapes/{j}/figures/{k}");
            let figure = |name: &str| match shape.figure(name) {
                Some((k, figure)) => sigma_cell(figure, &at(k)),
                None => Cell::Empty,
            };
            let mut row = vec![scan.name.clone().into(), shape.label.clone().into()];
            row.extend(["x_mm", "y_mm", "z_mm", "radius_mm"].map(figure));
            if let (true, Some((k, radius))) = (judged, shape.figure("radius_mm")) {
                row.push(optional(radius.nominal, 4, format!("{}/nominal", at(k))));
                row.push(radius.error.map_or(Cell::Empty, |e| signed(e, 4, format!("{}/error", at(k)))));
            }
            row.push(count(shape.points, format!("/scans/{i}/shapes/{j}/points")));
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return None;
    }
    let mut section = Section::new("Balls");
    let (mut named, mut others): (Vec<_>, Vec<_>) = (rows, Vec::new());
    if judged && named.iter().any(|row| matches!(row.get(7), Some(Cell::Figure { .. }))) {
        (named, others) = named.into_iter().partition(|row| matches!(row.get(7), Some(Cell::Figure { .. })));
    }
    section.push(Table {
        caption: "Centres and radii of the balls".to_owned(),
        columns: columns.clone(),
        rows: named,
        note: "Each ± is one standard deviation, with the calibration's part where it is known.".to_owned(),
    });
    if !others.is_empty() {
        section.push(Table {
            caption: "Spheres that are none of the nominal balls".to_owned(),
            columns,
            rows: others,
            note: String::new(),
        });
    }
    section.blocks.extend(plots::along_the_distance(record).into_iter().map(Block::Plot));
    if let Some(table) = between_balls(record) {
        section.push(table);
    }
    Some(section)
}

/// Radii and distances of a named artefact in all scans, as the paper's Table 2.
fn between_balls(record: &Record) -> Option<Table> {
    let rows: Vec<Vec<Cell>> = record
        .scans
        .iter()
        .enumerate()
        .flat_map(|(i, scan)| {
            let judged = scan.distances.iter().enumerate().filter(|(_, d)| d.figure.nominal.is_some());
            judged.map(move |(k, d)| {
                let at = format!("/scans/{i}/distances/{k}");
                vec![
                    scan.name.clone().into(),
                    format!("{} to {}", d.a, d.b).into(),
                    sigma_cell(&d.figure, &at),
                    optional(d.figure.nominal, 4, format!("{at}/nominal")),
                    d.figure.error.map_or(Cell::Empty, |e| signed(e, 4, format!("{at}/error"))),
                ]
            })
        })
        .collect();
    (!rows.is_empty()).then(|| Table {
        caption: "Distances between the balls".to_owned(),
        columns: vec![
            Column::text("scan"),
            Column::text("between"),
            Column::number("distance, mm"),
            Column::number("nominal, mm"),
            Column::number("error, mm"),
        ],
        rows,
        note: String::new(),
    })
}

/// One scan.
fn one(record: &Record, at: usize, scan: &Scan) -> Section {
    let r = &scan.record;
    let mut section = Section::new(r.name.clone());
    let mut terms =
        vec![(r.kind.to_owned(), r.file.file.clone()), ("SHA-256".to_owned(), r.file.sha256.clone())];
    if let (Some(medium), Some(index)) = (r.medium, r.index) {
        terms.push(("outside the windows".to_owned(), format!("{medium}, index {index:.5}")));
    }
    if let Some(refraction) = r.refraction {
        terms.push(("refraction".to_owned(), refraction.to_owned()));
    }
    if let Some([low, high]) = r.box_mm {
        let ends: Vec<String> = low.iter().zip(high).map(|(l, h)| format!("{l:.1} to {h:.1}")).collect();
        terms.push(("extent".to_owned(), format!("{} mm ({} frame)", ends.join(", "), r.frame)));
    }
    section.push(Block::Terms(terms));

    let of = match &record.reference {
        Some(_) => "the reference",
        None => "the fitted shapes",
    };
    section.push(views::scan(scan, of));
    section.push(shapes(at, r));
    for (title, kind, relations) in
        [("Distances", "distances", &r.distances), ("Angles", "angles", &r.angles)]
    {
        section.blocks.extend(between(title, &format!("/scans/{at}/{kind}"), relations).map(Block::Table));
    }
    if let Some(d) = &r.deviations {
        let at = format!("/scans/{at}/deviations");
        let row = |name: &str, cell: Cell| vec![name.into(), cell];
        section.push(Table {
            caption: "Deviations from the reference after best fit".to_owned(),
            columns: vec![Column::text("quantity"), Column::number("mm")],
            rows: vec![
                row("mean", signed(d.mean_mm, 4, format!("{at}/mean_mm"))),
                row("root mean square", cell(d.rms_mm, 4, format!("{at}/rms_mm"))),
                row("robust standard deviation", cell(d.robust_sigma_mm, 4, format!("{at}/robust_sigma_mm"))),
                row("2.5 % are below", signed(d.quantiles_mm[0], 4, format!("{at}/quantiles_mm/0"))),
                row("97.5 % are below", signed(d.quantiles_mm[4], 4, format!("{at}/quantiles_mm/4"))),
                row("farthest inside", signed(d.extremes_mm[0], 4, format!("{at}/extremes_mm/0"))),
                row("farthest outside", signed(d.extremes_mm[1], 4, format!("{at}/extremes_mm/1"))),
            ],
            note: format!(
                "{} points compared, {} beside the reference; {:.0} % of them came to lie on it.",
                d.compared,
                d.beyond,
                100.0 * d.overlap
            ),
        });
    }
    section.blocks.extend(plots::map(scan, of).map(Block::Plot));
    section.blocks.extend(plots::deviations(scan, of).map(Block::Plot));
    section.blocks.extend(plots::stripes(&r.images).map(Block::Plot));
    section
}

fn shapes(at: usize, scan: &ScanRecord) -> Block {
    if scan.shapes.is_empty() {
        return "No spheres, planes or cylinders were found that the points tell from anything else.".into();
    }
    let mut rows = Vec::new();
    for (j, shape) in scan.shapes.iter().enumerate() {
        for (k, figure) in shape.figures.iter().enumerate() {
            let at = format!("/scans/{at}/shapes/{j}/figures/{k}");
            let decimals = figure.whole_sigma().filter(|s| *s > 0.0).map_or(4, decimals);
            rows.push(vec![
                format!("{}: {}", shape.label, spoken(&figure.name)).into(),
                cell(figure.value, decimals, format!("{at}/value")),
                spread(figure.sigma, format!("{at}/sigma")),
                spread(figure.sigma_total, format!("{at}/sigma_total")),
            ]);
        }
    }
    let mut part = Section::new(format!("Shapes of {}", scan.name));
    part.push(Table {
        caption: "Figures of the shapes".to_owned(),
        columns: vec![
            Column::text("figure"),
            Column::number("value"),
            Column::number("sigma of the points"),
            Column::number("sigma with the calibration"),
        ],
        rows,
        note: "Standard deviations. The calibration's part is common to all points and does not average out."
            .to_owned(),
    });
    part.push(fits(at, &scan.shapes, scan.unassigned_points));
    Block::Section(part)
}

fn fits(at: usize, shapes: &[ShapeRecord], unassigned: usize) -> Table {
    let row = |(j, s): (usize, &ShapeRecord)| {
        let at = format!("/scans/{at}/shapes/{j}");
        vec![
            s.label.clone().into(),
            count(s.points, format!("{at}/points")),
            count(s.outliers, format!("{at}/outliers")),
            cell(s.rms_mm, 4, format!("{at}/rms_mm")),
            cell(s.max_outside_mm, 4, format!("{at}/max_outside_mm")),
            cell(s.max_inside_mm, 4, format!("{at}/max_inside_mm")),
        ]
    };
    Table {
        caption: "Deviations of the points from their shapes".to_owned(),
        columns: vec![
            Column::text("shape"),
            Column::number("points"),
            Column::number("outliers"),
            Column::number("rms, mm"),
            Column::number("farthest outside, mm"),
            Column::number("farthest inside, mm"),
        ],
        rows: shapes.iter().enumerate().map(row).collect(),
        note: format!("{unassigned} points belong to no shape."),
    }
}

/// A figure's name as people say it: `axis_direction_x` → `axis direction x`, `radius_mm` → `radius, mm`.
fn spoken(name: &str) -> String {
    let (stem, unit) = match name.strip_suffix("_mm") {
        Some(stem) => (stem, ", mm"),
        None => (name, ""),
    };
    stem.replace('_', " ") + unit
}

fn between(caption: &str, at: &str, relations: &[RelationRecord]) -> Option<Table> {
    let rows = relations.iter().enumerate().take(LISTED).map(|(k, r)| {
        let at = format!("{at}/{k}");
        let f = &r.figure;
        vec![
            format!("{} to {}", r.a, r.b).into(),
            sigma_cell(f, &at),
            spread(f.sigma, format!("{at}/sigma")),
            spread(f.sigma_total, format!("{at}/sigma_total")),
        ]
    });
    let unit = if relations.first()?.figure.name.ends_with("deg") { "°" } else { "mm" };
    Some(Table {
        caption: caption.to_owned(),
        columns: vec![
            Column::text("between"),
            Column::number(format!("value, {unit}")),
            Column::number("sigma of the points"),
            Column::number("sigma with the calibration"),
        ],
        rows: rows.collect(),
        note: match relations.len().checked_sub(LISTED) {
            Some(more @ 1..) => format!("And {more} more: the files beside this page have them."),
            _ => String::new(),
        },
    })
}

/// Probing and sphere-spacing errors, with what they are.
fn errors(record: &Record) -> Option<Section> {
    if record.probing.is_empty() {
        return None;
    }
    let mut section = Section::new("Probing and sphere-spacing errors");
    section.push(format!(
        "In the sense of VDI/VDE 2634 part 2 (2012). Of each ball, all points count that lie within {:.0} % of its radius of its \
         surface and belong to no other shape. The compensating sphere is that of least squares with free radius and equal weights; \
         at most {} points in 1000, the farthest ones, are left out, and the sphere is fitted anew.",
        100.0 * NEAR_SURFACE,
        1000.0 * LEFT_OUT
    ));
    section.push(Block::Terms(vec![
        (
            "probing error, form (PF)".to_owned(),
            "the range of the points' radial distances from the compensating sphere: largest less smallest"
                .to_owned(),
        ),
        (
            "probing error, size (PS)".to_owned(),
            "the compensating sphere's diameter less the nominal one".to_owned(),
        ),
        (
            "sphere-spacing error (SD)".to_owned(),
            "the distance between the centres of two compensating spheres less the nominal one".to_owned(),
        ),
    ]));
    let of_scan = |at: usize| record.scans.get(at).map_or("", |scan| scan.name.as_str());
    let rows = record.probing.iter().enumerate().map(|(k, p)| {
        let at = format!("/probing/{k}");
        vec![
            of_scan(p.scan).into(),
            p.ball.clone().into(),
            cell(p.form_mm, 4, format!("{at}/form_mm")),
            p.size_mm.map_or(Cell::Empty, |size| signed(size, 4, format!("{at}/size_mm"))),
            count(p.points, format!("{at}/points")),
            count(p.left_out, format!("{at}/left_out")),
        ]
    });
    let largest = |of: &mut dyn Iterator<Item = f64>| of.map(f64::abs).fold(0.0, f64::max);
    let form = largest(&mut record.probing.iter().map(|p| p.form_mm));
    let size = largest(&mut record.probing.iter().filter_map(|p| p.size_mm));
    section.push(Table {
        caption: "Probing errors".to_owned(),
        columns: vec![
            Column::text("scan"),
            Column::text("ball"),
            Column::number("PF, mm"),
            Column::number("PS, mm"),
            Column::number("points"),
            Column::number("left out"),
        ],
        rows: rows.collect(),
        note: format!(
            "Largest PF {form:.4} mm{}.",
            match record.nominal {
                Some(_) => format!(", largest |PS| {size:.4} mm"),
                None => "; PS needs nominal values (--nominal)".to_owned(),
            }
        ),
    });
    if !record.spacing.is_empty() {
        let rows = record.spacing.iter().enumerate().map(|(k, s)| {
            let at = format!("/spacing/{k}");
            vec![
                of_scan(s.scan).into(),
                format!("{} to {}", s.a, s.b).into(),
                cell(s.distance_mm, 4, format!("{at}/distance_mm")),
                cell(s.nominal_mm, 4, format!("{at}/nominal_mm")),
                signed(s.error_mm, 4, format!("{at}/error_mm")),
            ]
        });
        let most = largest(&mut record.spacing.iter().map(|s| s.error_mm));
        section.push(Table {
            caption: "Sphere-spacing errors".to_owned(),
            columns: vec![
                Column::text("scan"),
                Column::text("between"),
                Column::number("distance, mm"),
                Column::number("nominal, mm"),
                Column::number("SD, mm"),
            ],
            rows: rows.collect(),
            note: format!("Largest |SD| {most:.4} mm."),
        });
    }
    section.push(
        "These are the figures of the positions that were scanned. An acceptance test asks for more: artefacts with a certificate, their \
         placement as the guideline has it, and limits agreed upon beforehand.",
    );
    Some(section)
}

fn instrument(record: &Record) -> Section {
    let mut section = Section::new("Instrument and calibration");
    let Some(c) = &record.calibration else {
        section.push(
            "No calibration was given: the sigmas are the points' own, and what the calibration adds is not in them (-c calibration.toml).",
        );
        return section;
    };
    section.push(Block::Terms(vec![
        ("calibration".to_owned(), c.file.file.clone()),
        ("SHA-256".to_owned(), c.file.sha256.clone()),
        ("made by".to_owned(), format!("{}, {} method", c.software, c.method)),
    ]));
    section.blocks.extend(notes(&c.warnings, &[]));
    section.push(health(c));
    if !c.captures.is_empty() {
        section.push(Table {
            caption: "Captures that it was made from".to_owned(),
            columns: vec![Column::text("capture"), Column::text("medium"), Column::text("SHA-256")],
            rows: c
                .captures
                .iter()
                .map(|s| vec![s.name.clone().into(), s.medium.into(), s.sha256.clone().into()])
                .collect(),
            note: String::new(),
        });
    }
    section.push(quantities(&c.figures, "/calibration/figures"));
    section
}

fn health(c: &CalibrationRecord) -> Table {
    let row = |name: &str, cell: Cell| vec![name.into(), cell];
    let px = |v: f64, name: &str| cell(v, 4, format!("/calibration/{name}"));
    Table {
        caption: "Health of the calibration".to_owned(),
        columns: vec![Column::text("quantity"), Column::number("value")],
        rows: vec![
            row("placements of the board", count(c.poses_used, "/calibration/poses_used")),
            row("images", count(c.frames_used, "/calibration/frames_used")),
            row("images left out", count(c.rejected, "/calibration/rejected")),
            row("corners, rms, px", px(c.reprojection_rms_px, "reprojection_rms_px")),
            row("stripes, rms, px", px(c.stripe_rms_px, "stripe_rms_px")),
            row("stripes on the board, rms, mm", px(c.stripe_rms_mm, "stripe_rms_mm")),
        ],
        note: String::new(),
    }
}

/// Figures of the instrument.
pub(crate) fn quantities(figures: &[FigureRecord], at: &str) -> Table {
    let rows = figures.iter().enumerate().map(|(k, f)| {
        let at = format!("{at}/{k}");
        let digits = f.sigma.filter(|s| *s > 0.0).map_or(6, decimals);
        vec![
            f.name.clone().into(),
            cell(f.value, digits, format!("{at}/value")),
            spread(f.sigma, format!("{at}/sigma")),
        ]
    });
    Table {
        caption: "Figures of the instrument".to_owned(),
        columns: vec![Column::text("figure"), Column::number("value"), Column::number("sigma")],
        rows: rows.collect(),
        note: String::new(),
    }
}

fn method(record: &Record) -> Section {
    let mut section = Section::new("How it was measured");
    section.push(
        "Each point is where the ray that the camera sees a stripe's centre by meets the sheet of light, both traced through their windows; \
         its standard deviation follows from the stripe's. Shapes are found in the points and fitted by maximum likelihood with each point's \
         own covariance, robustly; a point that its sigma and the number of points do not explain is an outlier, and counted. A shape's sigma \
         follows from its points; with the calibration's covariance, which all points share, it is the one that counts.",
    );
    let mut terms = Vec::new();
    for (name, file) in [("reference", &record.reference), ("nominal values", &record.nominal)] {
        if let Some(file) = file {
            terms.push((name.to_owned(), format!("{}, SHA-256 {}", file.file, file.sha256)));
        }
    }
    terms.push((
        "frame camera".to_owned(),
        "x right, y down, z forward, origin at the optical centre".to_owned(),
    ));
    terms.push((
        "frame galvo".to_owned(),
        "x along the mirror's axis, z in the laser plane of the reference voltage, outwards".to_owned(),
    ));
    section.push(Block::Terms(terms));
    section
}
