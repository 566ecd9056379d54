//! A plot as an SVG element of the page, drawn by `plotters`.
//!
//! `plotters` knows no style sheet: it is given stand-in colours, which become the page's own (`var(--…)`) in its output.

use crate::colour::Rgb;
use crate::plot::{Axis, Ink, Layer, Marker, Plot};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::fmt::Write;

/// The drawing's size, px, twice that at which it is shown: `plotters` rounds to whole ones.
const SIZE: (u32, u32) = (1440, 800);
const TEXT_PX: u32 = 26;
const LEFT_PX: u32 = 130;
const BOTTOM_PX: u32 = 84;
const MARGIN_PX: u32 = 18;
/// Half of the last tick's label stands beyond the axis.
const RIGHT_PX: u32 = 48;
const MARK_PX: i32 = 9;
const LINE_PX: u32 = 3;
/// An arrow's head, of its length, and its half width.
const HEAD: [f64; 2] = [0.3, 0.15];

/// Why a plot can't be drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlotError {
    /// Its title.
    pub title: String,
    /// What is wrong.
    pub what: String,
}

impl std::fmt::Display for PlotError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the plot \"{}\" can't be drawn: {}", self.title, self.what)
    }
}

impl std::error::Error for PlotError {}

/// Colours of the page by their names in its style, in the order of their stand-ins.
const NAMES: [&str; 10] =
    ["--ink", "--faint", "--s0", "--s1", "--s2", "--s3", "--s4", "--s5", "--s6", "--s7"];

/// A colour's place in [`NAMES`].
fn place(ink: Ink) -> usize {
    match ink {
        Ink::Text => 0,
        Ink::Faint => 1,
        Ink::Series(n) => 2 + usize::from(n % 8),
    }
}

/// The colour as CSS names it.
pub(crate) fn css(ink: Ink) -> String {
    format!("var({})", NAMES[place(ink)])
}

/// Red and green of all stand-ins; a real colour that happens to be one is moved by a step of blue out of their way.
const STAND_IN: [u8; 2] = [1, 2];

fn stand_in(ink: Ink) -> RGBColor {
    RGBColor(STAND_IN[0], STAND_IN[1], place(ink) as u8)
}

fn real([r, g, b]: Rgb) -> RGBColor {
    if [r, g] == STAND_IN { RGBColor(r, g, b.max(NAMES.len() as u8)) } else { RGBColor(r, g, b) }
}

fn in_the_pages_colours(svg: &str) -> String {
    NAMES.iter().enumerate().fold(svg.to_owned(), |svg, (at, name)| {
        let [r, g] = STAND_IN;
        svg.replace(&format!("\"#{r:02X}{g:02X}{at:02X}\""), &format!("\"var({name})\""))
    })
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Returns the plot as an `svg` element, named by the elements with the ids `title` and `description` inside of it.
///
/// # Errors
/// [`PlotError`] for an axis that is none.
pub(crate) fn draw(plot: &Plot, id: &str) -> Result<String, PlotError> {
    let failed = |what: String| PlotError { title: plot.title.clone(), what };
    for axis in [&plot.x, &plot.y] {
        let [from, to] = axis.range;
        if !(from.is_finite() && to.is_finite() && (to - from).abs() > 0.0) {
            return Err(failed(format!("its axis \"{}\" goes from {from} to {to}", axis.label)));
        }
    }
    let mut drawn = String::new();
    {
        let area = SVGBackend::with_string(&mut drawn, SIZE).into_drawing_area();
        chart(plot, &area).map_err(|e| failed(e.to_string()))?;
        area.present().map_err(|e| failed(e.to_string()))?;
    }
    let inside = drawn.find('>').and_then(|at| drawn.get(at + 1..)).unwrap_or_default();
    let mut svg = String::new();
    // Writing to a string can't fail.
    _ = write!(
        svg,
        "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-labelledby=\"{id}-t {id}-d\"><title id=\"{id}-t\">{}</title><desc id=\"{id}-d\">{}</desc>",
        SIZE.0,
        SIZE.1,
        escaped(&plot.title),
        escaped(&plot.description)
    );
    svg += in_the_pages_colours(inside).trim();
    Ok(svg)
}

fn escaped(text: &str) -> String {
    maud::html! { (text) }.into_string()
}

/// The intervals of both axes, widened so that a unit is as long along either where that is asked for.
fn ranges(plot: &Plot) -> [[f64; 2]; 2] {
    let [mut x, mut y] = [plot.x.range, plot.y.range];
    if plot.equal {
        let wide = f64::from(SIZE.0 - LEFT_PX - MARGIN_PX - RIGHT_PX);
        let high = f64::from(SIZE.1 - BOTTOM_PX - 2 * MARGIN_PX);
        let [per_x, per_y] = [(x[1] - x[0]).abs() / wide, (y[1] - y[0]).abs() / high];
        let widen = |[from, to]: [f64; 2], by: f64| {
            let (middle, half) = (0.5 * (from + to), 0.5 * (to - from) * by);
            [middle - half, middle + half]
        };
        if per_x > per_y {
            y = widen(y, per_x / per_y);
        } else {
            x = widen(x, per_y / per_x);
        }
    }
    [x, y]
}

/// Decimals that tell an axis's ticks, about ten of them, apart.
fn tick_decimals([from, to]: [f64; 2]) -> usize {
    (1.0 - ((to - from).abs() / 2.0).log10().floor()).clamp(0.0, 9.0) as usize
}

fn tick(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = if decimals > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    // A typographic minus, and no minus zero.
    if text == "-0" { "0".to_owned() } else { text.replacen('-', "−", 1) }
}

fn chart(plot: &Plot, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<(), Box<dyn std::error::Error>> {
    let [x, y] = ranges(plot);
    let mut chart = ChartBuilder::on(area)
        .margin(MARGIN_PX)
        .margin_right(RIGHT_PX)
        .x_label_area_size(BOTTOM_PX)
        .y_label_area_size(LEFT_PX)
        .build_cartesian_2d(x[0]..x[1], y[0]..y[1])?;
    let text = ("sans-serif", TEXT_PX).into_font().color(&stand_in(Ink::Text));
    let decimals = |axis: &Axis, range| (axis.label.clone(), tick_decimals(range));
    let ((x_label, x_digits), (y_label, y_digits)) = (decimals(&plot.x, x), decimals(&plot.y, y));
    chart
        .configure_mesh()
        .axis_style(stand_in(Ink::Text))
        .bold_line_style(stand_in(Ink::Faint).mix(0.35))
        .light_line_style(TRANSPARENT)
        .label_style(text.clone())
        .axis_desc_style(text)
        .x_desc(x_label)
        .y_desc(y_label)
        .x_label_formatter(&|v| tick(*v, x_digits))
        .y_label_formatter(&|v| tick(*v, y_digits))
        .draw()?;
    for layer in &plot.layers {
        draw_layer(&mut chart, layer, [x, y])?;
    }
    Ok(())
}

fn draw_layer(
    chart: &mut Chart<'_, '_>,
    layer: &Layer,
    ranges: [[f64; 2]; 2],
) -> Result<(), Box<dyn std::error::Error>> {
    let finite = |p: &[f64; 2]| p.iter().all(|v| v.is_finite());
    match layer {
        Layer::Points { ink, marker, at, sigmas, .. } => {
            let colour = stand_in(*ink);
            for (p, sigma) in at.iter().zip(sigmas).filter(|(p, s)| finite(p) && s.is_finite()) {
                let [x, y] = *p;
                chart.draw_series([PathElement::new(
                    vec![(x, y - sigma), (x, y + sigma)],
                    colour.stroke_width(LINE_PX),
                )])?;
            }
            let places = at.iter().filter(|p| finite(p)).map(|[x, y]| (*x, *y));
            match marker {
                Marker::Disc => {
                    chart.draw_series(places.map(|p| Circle::new(p, MARK_PX, colour.filled())))?
                }
                Marker::Triangle => {
                    chart.draw_series(places.map(|p| TriangleMarker::new(p, MARK_PX + 3, colour.filled())))?
                }
                Marker::Cross => chart
                    .draw_series(places.map(|p| Cross::new(p, MARK_PX, colour.stroke_width(LINE_PX + 1))))?,
                Marker::Square => chart.draw_series(places.map(|p| {
                    EmptyElement::at(p)
                        + Rectangle::new([(-MARK_PX, -MARK_PX), (MARK_PX, MARK_PX)], colour.filled())
                }))?,
            };
        }
        Layer::Line { ink, at, .. } => {
            let places: Vec<(f64, f64)> = at.iter().filter(|p| finite(p)).map(|[x, y]| (*x, *y)).collect();
            chart.draw_series([PathElement::new(places, stand_in(*ink).stroke_width(LINE_PX))])?;
        }
        Layer::Bars { ink, bars, .. } => {
            let colour = stand_in(*ink).filled();
            chart.draw_series(
                bars.iter().map(|[x0, x1, y0, y1]| Rectangle::new([(*x0, *y0), (*x1, *y1)], colour)),
            )?;
        }
        Layer::Cells { cells } => {
            chart.draw_series(cells.iter().map(|([x0, x1, y0, y1], colour)| {
                Rectangle::new([(*x0, *y0), (*x1, *y1)], real(*colour).filled())
            }))?;
        }
        Layer::Arrows { ink, arrows, .. } => {
            let style = stand_in(*ink).stroke_width(2);
            // Heads are drawn in the drawing's own measure, where an arrow has one form whichever way it points.
            let [wide, high] = ranges.map(|[from, to]| to - from);
            let per = high / wide * f64::from(SIZE.0) / f64::from(SIZE.1);
            for [x0, y0, x1, y1] in arrows.iter().filter(|a| a.iter().all(|v| v.is_finite())) {
                let (dx, dy) = (x1 - x0, (y1 - y0) / per);
                let wing = |side: f64| {
                    (
                        x1 - HEAD[0] * dx + side * HEAD[1] * dy,
                        y1 - (HEAD[0] * dy - side * HEAD[1] * -dx) * per,
                    )
                };
                chart.draw_series([
                    PathElement::new(vec![(*x0, *y0), (*x1, *y1)], style),
                    PathElement::new(vec![wing(1.0), (*x1, *y1), wing(-1.0)], style),
                ])?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colour::Scale;

    fn plot(layers: Vec<Layer>) -> Plot {
        Plot {
            title: "a < b & \"c\"".to_owned(),
            description: "what <it> shows".to_owned(),
            x: Axis::around("x, mm", [0.0, 1.0]),
            y: Axis::around("y, mm", [-0.02, 0.02]),
            layers,
            equal: false,
            scale: None,
        }
    }

    #[test]
    fn marks_have_the_pages_colours_and_cells_their_own() {
        let points = |marker, n| Layer::Points {
            name: "p".to_owned(),
            ink: Ink::Series(n),
            marker,
            at: vec![[0.5, 0.0], [0.2, f64::NAN]],
            sigmas: vec![0.01, 0.01],
        };
        let svg = draw(
            &plot(vec![
                Layer::Cells {
                    cells: vec![
                        ([0.0, 1.0, -0.01, 0.01], Scale::diverging(1.0).colour(1.0)),
                        ([0.0, 0.1, 0.0, 0.01], [1, 2, 3]),
                    ],
                },
                points(Marker::Disc, 0),
                points(Marker::Square, 9),
                Layer::Arrows { name: String::new(), ink: Ink::Text, arrows: vec![[0.0, 0.0, 1.0, 0.01]] },
            ]),
            "p1",
        )
        .unwrap();
        assert!(svg.starts_with("<svg viewBox") && svg.ends_with("</svg>"));
        assert!(svg.contains("a &lt; b &amp; &quot;c&quot;") && svg.contains("what &lt;it&gt; shows"));
        for found in ["var(--s0)", "var(--s1)", "var(--ink)", "var(--faint)", "#B35806", "#01020A"] {
            assert!(svg.contains(found), "{found} is not in {svg}");
        }
        assert_eq!(svg.matches("#0102").count(), 1, "a stand-in was left");
        assert_eq!(svg.matches("<circle").count(), 1, "what is no number has no mark");
    }

    #[test]
    fn an_axis_without_length_is_refused() {
        let mut nothing = plot(Vec::new());
        nothing.y.range = [1.0, 1.0];
        assert!(draw(&nothing, "p").unwrap_err().to_string().contains("from 1 to 1"));
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "what is not touched is the same")]
    fn a_unit_is_as_long_either_way_where_that_is_asked() {
        let mut square = plot(Vec::new());
        square.equal = true;
        let [x, y] = ranges(&square);
        let wide = f64::from(SIZE.0 - LEFT_PX - MARGIN_PX - RIGHT_PX) / (x[1] - x[0]);
        let high = f64::from(SIZE.1 - BOTTOM_PX - 2 * MARGIN_PX) / (y[1] - y[0]);
        assert!((wide / high - 1.0).abs() < 1e-12);
        assert_eq!(x, square.x.range, "the longer one stays");
    }

    #[test]
    fn ticks_are_told_apart_and_zero_has_no_sign() {
        assert_eq!(tick(-0.25, tick_decimals([-0.5, 0.5])), "−0.25");
        assert_eq!(tick(-1e-12, 2), "0");
        assert_eq!(tick(1000.0, tick_decimals([600.0, 1100.0])), "1000");
    }
}
