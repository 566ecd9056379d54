//! The page of the reproduction: the paper's tables and figures, with the paper's own numbers, its method and ours.

use crate::pipeline::report::page::{cell, framed, signed};
use crate::pipeline::report::plots::histogram_plot;
use crate::pipeline::report::views;
use crate::pipeline::reproduce::published::{BALL_RADIUS_MM, COVER_POINTS, FIGURE_10};
use crate::pipeline::reproduce::record::{BallFigures, BallRecord, Record, Summary};
use uw_cloud::{PointCloud, TriangleMesh};
use uw_report::{Axis, Block, Cell, Column, Ink, Layer, Marker, Note, Page, Plot, Section, Table};

/// The three series, everywhere in the same colours and forms.
const PUBLISHED: (&str, Ink, Marker) = ("the paper's tank, as printed", Ink::Text, Marker::Cross);
const PAPER: (&str, Ink, Marker) = ("the paper's method, simulated", Ink::Series(1), Marker::Triangle);
const OURS: (&str, Ink, Marker) = ("ours, simulated", Ink::Series(0), Marker::Disc);

/// The page.
pub(crate) fn page(record: &Record, cover: &PointCloud, mesh: &TriangleMesh) -> Page {
    let sections =
        vec![summary(record), ball(record), three(record), object(record, cover, mesh), differences(record)];
    let title = "The paper's experiments, by its method and by ours";
    framed(title, &record.head, &format!(", seed {}", record.seed), sections)
}

fn summary(record: &Record) -> Section {
    let mut section = Section::new("Summary");
    section.push(format!(
        "S. Chi, Z. Xie, W. Chen, \"A Laser Line Auto-Scanning System for Underwater 3D Reconstruction\", Sensors 16 (2016), measured a ball in ten \
         positions, three balls in three orientations, and a sealing cover. Here the same is done on {} simulated images of an instrument with \
         the paper's geometry, by the paper's method and by ours. Both are given the same images, and neither is told the true instrument.",
        record.images
    ));
    section.push(Block::Notes(
        std::iter::once(Note::Remark(
            "The paper's own numbers come from its tank. What is simulated shares its geometry, not its instrument, noise or errors of mounting: \
             columns can be compared by their size and their course, not number by number."
                .to_owned(),
        ))
        .chain(record.warnings.iter().cloned().map(Note::Warning))
        .collect(),
    ));
    let published = published_summary(record);
    let row = |name: &str, of: &dyn Fn(&Summary) -> f64, printed: Option<f64>, at: &str| {
        let of_way = |summary: &Summary, way: &str| cell(of(summary), 3, format!("/summary/{way}/{at}"));
        vec![
            name.into(),
            printed.map_or(Cell::Empty, |v| cell(v, 3, "")),
            of_way(&record.summary.paper, "paper"),
            of_way(&record.summary.ours, "ours"),
        ]
    };
    section.push(Table {
        caption: "Largest errors, mm".to_owned(),
        columns: columns(&["of"], &[PUBLISHED.0, PAPER.0, OURS.0]),
        rows: vec![
            row(
                "the ball's radius, highest",
                &|s| s.ball_radius_mm[1],
                Some(published.ball_radius_mm[1]),
                "ball_radius_mm/1",
            ),
            row(
                "the ball's radius, lowest",
                &|s| s.ball_radius_mm[0],
                Some(published.ball_radius_mm[0]),
                "ball_radius_mm/0",
            ),
            row("distances between the ball's positions", &|s| s.ball_places_mm, None, "ball_places_mm"),
            row(
                "radii of the three balls",
                &|s| s.three_radius_mm,
                Some(published.three_radius_mm),
                "three_radius_mm",
            ),
            row(
                "distances between the three balls",
                &|s| s.three_distance_mm,
                Some(published.three_distance_mm),
                "three_distance_mm",
            ),
        ],
        note: "The paper did not print how far the ball had been moved.".to_owned(),
    });
    section
}

fn published_summary(record: &Record) -> Summary {
    let balls = || record.balls.iter().map(|b| b.published_error_mm);
    let three = |distances: bool| {
        let of = record.three_balls.iter().filter(|t| t.quantity.contains(" to ") == distances);
        of.map(|t| t.published_error_mm.abs()).fold(0.0, f64::max)
    };
    Summary {
        ball_radius_mm: [balls().fold(f64::INFINITY, f64::min), balls().fold(f64::NEG_INFINITY, f64::max)],
        ball_places_mm: f64::NAN,
        three_radius_mm: three(false),
        three_distance_mm: three(true),
    }
}

fn columns(words: &[&str], numbers: &[&str]) -> Vec<Column> {
    words.iter().map(|w| Column::text(*w)).chain(numbers.iter().map(|n| Column::number(*n))).collect()
}

fn ball(record: &Record) -> Section {
    let mut section = Section::new("The ball in ten positions");
    let rows = record.balls.iter().enumerate().map(|(k, b)| {
        let at = |name: &str| format!("/balls/{k}/{name}");
        let ours = &b.found.ours;
        vec![
            Cell::figure(b.position.to_string(), b.position as f64, at("position")),
            cell(b.published_z_mm, 1, at("published_z_mm")),
            signed(b.published_error_mm, 4, at("published_error_mm")),
            Cell::figure(b.published_points.to_string(), b.published_points as f64, at("published_points")),
            cell(b.found.paper.center_mm[2], 2, at("paper/center_mm/2")),
            signed(b.found.paper.error_mm, 4, at("paper/error_mm")),
            cell(ours.center_mm[2], 2, at("ours/center_mm/2")),
            signed(ours.error_mm, 4, at("ours/error_mm")),
            ours.sigma_mm.map_or(Cell::Empty, |s| cell(s, 4, at("ours/sigma_mm"))),
            Cell::figure(ours.points.to_string(), ours.points as f64, at("ours/points")),
        ]
    });
    let heads = columns(
        &[],
        &[
            "No.",
            "z printed, mm",
            "error printed, mm",
            "points printed",
            "z, paper's method, mm",
            "error, paper's method, mm",
            "z, ours, mm",
            "error, ours, mm",
            "sigma, ours, mm",
            "points",
        ],
    );
    section.push(Table {
        caption: format!("Table 1. Radius of a ball of {BALL_RADIUS_MM} mm in ten positions"),
        columns: heads,
        rows: rows.collect(),
        note: "z in the galvanometer's frame of each calibration. The sigma holds the calibration's part."
            .to_owned(),
    });
    section.push(by_distance(
        record,
        "Figure 8. Error of the fitted radius by distance",
        "radius less nominal, mm",
        |b, way| {
            Some(match way {
                0 => b.published_error_mm,
                1 => b.found.paper.error_mm,
                _ => b.found.ours.error_mm,
            })
        },
    ));
    section.push(by_distance(
        record,
        "What the radius hides: error of the distance from position 1",
        "distance less the true one, mm",
        |b, way| match way {
            0 => None,
            1 => Some(b.found.paper.from_first_error_mm),
            _ => Some(b.found.ours.from_first_error_mm),
        },
    ));
    section.push(farthest(record));
    for (title, histogram) in [
        ("Figure 10. Distances from the sphere at position 6, paper's method", &record.figure_10.paper),
        ("Figure 10. The same, ours", &record.figure_10.ours),
    ] {
        let [outside, inside] = FIGURE_10.1;
        let said = format!(
            "In the paper's tank the farthest points were {outside} mm outside and {inside} mm inside."
        );
        section.push(histogram_plot(histogram, title, &said));
    }
    section
}

fn layer((name, ink, marker): (&str, Ink, Marker), at: Vec<[f64; 2]>, sigmas: Vec<f64>) -> Layer {
    Layer::Points { name: name.to_owned(), ink, marker, at, sigmas }
}

/// A figure of the ball by the printed distance, in three series, with a line at zero.
fn by_distance(record: &Record, title: &str, label: &str, of: fn(&BallRecord, usize) -> Option<f64>) -> Plot {
    let mut layers = Vec::new();
    let x = Axis::around("z of the centre, as printed, mm", record.balls.iter().map(|b| b.published_z_mm));
    layers.push(Layer::Line {
        name: String::new(),
        ink: Ink::Faint,
        at: x.range.iter().map(|x| [*x, 0.0]).collect(),
    });
    let (mut ends, mut said) = (vec![0.0], Vec::new());
    for (way, series) in [PUBLISHED, PAPER, OURS].into_iter().enumerate() {
        let places: Vec<[f64; 2]> =
            record.balls.iter().filter_map(|b| Some([b.published_z_mm, of(b, way)?])).collect();
        if places.is_empty() {
            continue;
        }
        let range = Axis::around("", places.iter().map(|p| p[1])).range;
        let span = (range[1] - range[0]) / 22.0;
        said.push(format!("{} from {:+.4} to {:+.4} mm", series.0, range[0] + span, range[1] - span));
        ends.extend(places.iter().map(|p| p[1]));
        layers.push(layer(series, places, Vec::new()));
    }
    Plot {
        title: title.to_owned(),
        description: said.join("; ") + ".",
        x,
        y: Axis::around(label, ends),
        layers,
        equal: false,
        scale: None,
    }
}

fn farthest(record: &Record) -> Plot {
    let places = |way: fn(&BallRecord) -> &BallFigures, of: fn(&BallFigures) -> f64| {
        record.balls.iter().map(|b| [b.published_z_mm, of(way(b))]).collect::<Vec<_>>()
    };
    let paper: fn(&BallRecord) -> &BallFigures = |b| &b.found.paper;
    let ours: fn(&BallRecord) -> &BallFigures = |b| &b.found.ours;
    let outside: fn(&BallFigures) -> f64 = |f| f.max_outside_mm;
    let inside: fn(&BallFigures) -> f64 = |f| f.max_inside_mm;
    let printed_at = record.balls.get(FIGURE_10.0).map_or(f64::NAN, |b| b.published_z_mm);
    let [printed_outside, printed_inside] = FIGURE_10.1;
    let layers = vec![
        layer(
            ("printed: outside, inside (position 6)", PUBLISHED.1, Marker::Cross),
            vec![[printed_at, printed_outside], [printed_at, printed_inside]],
            Vec::new(),
        ),
        layer(
            ("paper's method: outside", Ink::Series(1), Marker::Triangle),
            places(paper, outside),
            Vec::new(),
        ),
        layer(("paper's method: inside", Ink::Series(4), Marker::Square), places(paper, inside), Vec::new()),
        layer(("ours: outside", Ink::Series(0), Marker::Disc), places(ours, outside), Vec::new()),
        layer(("ours: inside", Ink::Series(2), Marker::Cross), places(ours, inside), Vec::new()),
    ];
    let all = layers.iter().flat_map(|layer| match layer {
        Layer::Points { at, .. } => at.iter().map(|p| p[1]).collect::<Vec<_>>(),
        _ => Vec::new(),
    });
    let most = all.fold(printed_inside, f64::max);
    Plot {
        title: "Figure 9. Farthest points outside and inside the sphere".to_owned(),
        description: format!(
            "Of the points that each sphere was fitted to; {most:.3} mm at most. The paper prints numbers for position 6 only."
        ),
        x: Axis::around("z of the centre, as printed, mm", record.balls.iter().map(|b| b.published_z_mm)),
        y: Axis { label: "distance from the sphere, mm".to_owned(), range: [0.0, 1.1 * most] },
        layers,
        equal: false,
        scale: None,
    }
}

fn three(record: &Record) -> Section {
    let mut section = Section::new("Three balls in three orientations");
    let rows = record.three_balls.iter().enumerate().map(|(k, t)| {
        let at = |name: &str| format!("/three_balls/{k}/{name}");
        let optional = |v: Option<f64>, name: &str| v.map_or(Cell::Empty, |v| signed(v, 3, at(name)));
        vec![
            format!("{}: {}", t.orientation, t.quantity).into(),
            cell(t.nominal_mm, 3, at("nominal_mm")),
            signed(t.published_error_mm, 3, at("published_error_mm")),
            optional(t.paper_error_mm, "paper_error_mm"),
            optional(t.ours_error_mm, "ours_error_mm"),
            t.ours_sigma_mm.map_or(Cell::Empty, |s| cell(s, 4, at("ours_sigma_mm"))),
        ]
    });
    section.push(Table {
        caption: "Table 2. Radii and distances of three balls".to_owned(),
        columns: columns(
            &["orientation and figure"],
            &["standard, mm", "error printed, mm", "error, paper's method, mm", "error, ours, mm", "sigma, ours, mm"],
        ),
        rows: rows.collect(),
        note: "The paper does not print its orientations. Here the first faces the camera, and in the others distances run along the depth, where the \
               paper's errors were largest. The balls' points are found in our cloud; the paper's method is given the same measurements."
            .to_owned(),
    });
    section
}

fn object(record: &Record, cover: &PointCloud, mesh: &TriangleMesh) -> Section {
    let mut section = Section::new("A sealing cover");
    let c = &record.cover;
    section.push(format!(
        "Figure 11. A cover with an outer ring of 78 mm radius, 1 m away, in steps of 0.09°: {} images, {} points; the paper had {COVER_POINTS} \
         points of its cover. Mesh: {} triangles on {} points.",
        c.images, c.points, c.triangles, c.vertices
    ));
    section.push(views::cloud(
        cover,
        format!("Points of the cover: every {} of {}.", nth(cover.len()), cover.len()),
        "The points of the cover in space, coloured by depth.".to_owned(),
    ));
    section.push(views::surface(
        mesh,
        "Mesh of the cover.".to_owned(),
        "The triangulated surface of the cover, coloured by depth.".to_owned(),
    ));
    section
}

fn nth(points: usize) -> String {
    match views::step(points) {
        1 => "one".to_owned(),
        2 => "second".to_owned(),
        3 => "third".to_owned(),
        n => format!("{n}th"),
    }
}

fn differences(record: &Record) -> Section {
    let mut section = Section::new("What differs from the paper");
    let c = &record.calibrations;
    section.push(Block::Terms(
        [
            (
                "instrument",
                "Baseline 400 mm, 12 mm lens, 768 × 576 px of 8.6 × 8.3 µm, windows of 8 mm 10 mm before the camera and 40 mm before the mirror's axis, \
                 2° of mirror a volt: the paper's, or drawn where it does not print them. The true one differs from that drawing by what a seed draws: \
                 windows tilted by half a degree, distances off by half a millimetre, and so on. The paper's own mounting errors are not known.",
            ),
            (
                "images",
                "8 bits, shot and read noise, a lens without halo, clear water. The paper's had a frame grabber, its tank's water and a ball's real surface.",
            ),
            (
                "stripes",
                "Both methods are given the same centres of stripes, found by maximum likelihood. The paper does not say how it found them: what noise it had \
                 on top is not simulated.",
            ),
            (
                "paper's method",
                "Zhang's calibration, planes of light from boards on land, the axis from the planes, Eqs 9 to 14 in water, with its slips mended where they have \
                 no solution as printed (Eqs 4, 6, 7). Spheres are fitted with equal weights, without known outliers.",
            ),
            (
                "ours",
                "One adjustment of boards on land and in water, refraction exact at both windows, spheres weighted by the points' covariances.",
            ),
        ]
        .map(|(term, what)| (term.to_owned(), what.to_owned()))
        .to_vec(),
    ));
    section.push(Table {
        caption: "The calibrations".to_owned(),
        columns: columns(&["of"], &["paper's method", "ours"]),
        rows: vec![
            vec![
                "placements of the board".into(),
                Cell::figure(
                    c.paper.poses_used.to_string(),
                    c.paper.poses_used as f64,
                    "/calibrations/paper/poses_used",
                ),
                Cell::figure(
                    c.ours.poses_used.to_string(),
                    c.ours.poses_used as f64,
                    "/calibrations/ours/poses_used",
                ),
            ],
            vec![
                "corners, rms, px".into(),
                cell(c.paper.reprojection_rms_px, 4, "/calibrations/paper/reprojection_rms_px"),
                cell(c.ours.reprojection_rms_px, 4, "/calibrations/ours/reprojection_rms_px"),
            ],
            vec![
                "stripes on the board, rms, mm".into(),
                cell(c.paper.stripe_rms_mm, 4, "/calibrations/paper/stripe_rms_mm"),
                cell(c.ours.stripe_rms_mm, 4, "/calibrations/ours/stripe_rms_mm"),
            ],
        ],
        note: String::new(),
    });
    section.push(format!(
        "A radius alone proves little: approximations that shift and stretch the space alike leave it nearly as it is, while distances show them: here up \
         to {:.2} mm by the paper's method between the ball's positions, and {:.3} mm by ours.",
        record.summary.paper.ball_places_mm, record.summary.ours.ball_places_mm
    ));
    section
}
