//! A page with one of everything.

use uw_report::{
    Axis, Block, Cell, Colouring, Column, Ink, Layer, Marker, Note, Page, Plot, Scale, Section, Table, View,
};

/// What would break a page if it were not escaped.
pub const EVIL: &str = "<script>alert(\"1\")</script> & 'so' on";

fn axis(label: &str, range: [f64; 2]) -> Axis {
    Axis { label: label.to_owned(), range }
}

fn plot() -> Plot {
    let places: Vec<[f64; 2]> =
        (0..10).map(|i| [660.0 + 40.0 * f64::from(i), 0.1 * (f64::from(i)).sin()]).collect();
    let points = |name: &str, series: u8, marker, shift: f64| Layer::Points {
        name: name.to_owned(),
        ink: Ink::Series(series),
        marker,
        at: places.iter().map(|[x, y]| [*x, y + shift]).collect(),
        sigmas: vec![0.03; 10],
    };
    Plot {
        title: format!("Error by distance {EVIL}"),
        description: "Ten balls from 660 to 1020 mm.".to_owned(),
        x: axis("distance, mm", [640.0, 1040.0]),
        y: axis("error, mm", [-0.25, 0.35]),
        layers: vec![
            Layer::Line { name: "zero".to_owned(), ink: Ink::Faint, at: vec![[640.0, 0.0], [1040.0, 0.0]] },
            points("one", 0, Marker::Disc, 0.0),
            points("two", 1, Marker::Triangle, 0.1),
            points("three", 2, Marker::Square, 0.15),
            points("four", 3, Marker::Cross, -0.1),
        ],
        equal: false,
        scale: None,
    }
}

fn map() -> Plot {
    let scale = Scale::diverging(0.1);
    let cells = (0..40).flat_map(|i| {
        (0..30).map(move |j| {
            let [x, y] = [f64::from(i), f64::from(j)];
            ([x, x + 1.0, y, y + 1.0], scale.colour(0.1 * (0.3 * x).sin() * (0.2 * y).cos()))
        })
    });
    let arrows = (0..8).map(|i| [f64::from(5 * i), 5.0, f64::from(5 * i) + 3.0, 5.0 + f64::from(i - 4)]);
    Plot {
        title: "A map".to_owned(),
        description: "Cells and arrows.".to_owned(),
        x: axis("u, px", [0.0, 40.0]),
        y: axis("v, px, downwards", [30.0, 0.0]),
        layers: vec![
            Layer::Cells { cells: cells.collect() },
            Layer::Arrows { name: "arrows".to_owned(), ink: Ink::Text, arrows: arrows.collect() },
        ],
        equal: true,
        scale: Some((scale, "mm".to_owned())),
    }
}

fn view(solid: bool) -> View {
    let side = 60_u32;
    let points_mm: Vec<[f64; 3]> = (0..side * side)
        .map(|i| {
            let [x, y] = [f64::from(i % side), f64::from(i / side)];
            [x, y, 900.0 + 8.0 * (0.2 * x).sin() * (0.2 * y).cos()]
        })
        .collect();
    let scale = Scale::sequential([892.0, 908.0]);
    let colours = points_mm.iter().map(|p| scale.colour(p[2])).collect();
    let corner = |i: u32, j: u32| j * side + i;
    let triangles = (0..side - 1).flat_map(|j| {
        (0..side - 1).flat_map(move |i| {
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
    });
    View {
        caption: "Waves.".to_owned(),
        description: format!("A wavy sheet {EVIL}"),
        triangles: if solid { triangles.collect() } else { Vec::new() },
        colourings: vec![
            Colouring { name: "depth".to_owned(), colours, scale: Some((scale, "mm".to_owned())) },
            Colouring {
                name: "plain".to_owned(),
                colours: vec![[0, 114, 178]; points_mm.len()],
                scale: None,
            },
        ],
        points_mm,
        up: [0.0, -1.0, 0.0],
        towards_eye: [0.0, 0.0, -1.0],
    }
}

/// The page.
pub fn page() -> Page {
    let mut first = Section::new("Figures");
    first.push("A paragraph that says what the figures are.");
    first.push(Block::Notes(vec![
        Note::Loss("image 7 is missing".to_owned()),
        Note::Warning(EVIL.to_owned()),
        Note::Remark("all is well".to_owned()),
    ]));
    first.push(Block::Terms(vec![
        ("hash".to_owned(), "d63e6ab5".repeat(8)),
        (EVIL.to_owned(), EVIL.to_owned()),
    ]));
    let row = |name: &str, value: f64| {
        vec![name.into(), Cell::figure(format!("{value:.3} ± 0.012"), value, "/figures/0/value"), Cell::Empty]
    };
    first.push(Table {
        caption: "A table".to_owned(),
        columns: vec![Column::text("what"), Column::number("value, mm"), Column::number("nominal, mm")],
        rows: vec![row("radius", 20.017_025_562_703_7), row(EVIL, -1e-9)],
        note: "A note below it.".to_owned(),
    });
    let mut inner = Section::new("Part of the part");
    inner.push(plot());
    inner.push(map());
    first.push(inner);
    let mut second = Section::new("In space");
    second.push(view(false));
    second.push(view(true));
    Page {
        title: format!("A page {EVIL}"),
        subtitle: "for looking at".to_owned(),
        sections: vec![first, second],
        footer: "made by a test".to_owned(),
    }
}
