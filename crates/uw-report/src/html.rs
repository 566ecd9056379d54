//! The page as HTML.

use crate::colour::{Scale, hex};
use crate::page::{Block, Cell, Note, Page, Section, Table};
use crate::plot::{Ink, Key, Layer, Marker, Plot};
use crate::svg::{self, PlotError};
use crate::view::View;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("style.css");
const VIEWER: &str = include_str!("viewer.js");

/// Numbers that ids are made of.
#[derive(Default)]
struct Count {
    next: usize,
}

impl Count {
    fn id(&mut self, kind: &str) -> String {
        self.next += 1;
        format!("{kind}{}", self.next)
    }
}

impl Page {
    /// Returns the page's text: one file, which asks for no other. The same page gives the same text.
    ///
    /// # Errors
    /// [`PlotError`] where an axis has no length.
    pub fn html(&self) -> Result<String, PlotError> {
        let mut count = Count::default();
        let ids: Vec<String> = self.sections.iter().map(|_| count.id("s")).collect();
        let mut parts = Vec::new();
        for (part, id) in self.sections.iter().zip(&ids) {
            parts.push(section(part, 2, id, &mut count)?);
        }
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    // A page without this asks its host for an icon.
                    link rel="icon" href="data:,";
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    a.skip href="#content" { "To the content" }
                    header {
                        h1 { (self.title) }
                        p { (self.subtitle) }
                        nav aria-label="Contents" {
                            ul {
                                @for (part, id) in self.sections.iter().zip(&ids) {
                                    li { a href={ "#" (id) } { (part.heading) } }
                                }
                            }
                        }
                    }
                    main #content { @for part in &parts { (part) } }
                    footer { p { (self.footer) } }
                    script { (PreEscaped(VIEWER)) }
                }
            }
        };
        Ok(page.into_string() + "\n")
    }
}

fn heading(rank: u8, id: &str, text: &str) -> Markup {
    match rank {
        2 => html! { h2 id=(id) { (text) } },
        3 => html! { h3 id=(id) { (text) } },
        _ => html! { h4 id=(id) { (text) } },
    }
}

fn section(part: &Section, rank: u8, id: &str, count: &mut Count) -> Result<Markup, PlotError> {
    let mut inside = Vec::new();
    for piece in &part.blocks {
        inside.push(block(piece, rank, count)?);
    }
    Ok(html! {
        section aria-labelledby=(id) {
            (heading(rank, id, &part.heading))
            @for piece in &inside { (piece) }
        }
    })
}

fn block(piece: &Block, rank: u8, count: &mut Count) -> Result<Markup, PlotError> {
    Ok(match piece {
        Block::Text(text) => html! { p { (text) } },
        Block::Terms(terms) => html! {
            dl { @for (term, what) in terms { div { dt { (term) } dd { (what) } } } }
        },
        Block::Notes(notes) => html! {
            ul.notes { @for note in notes { (one_note(note)) } }
        },
        Block::Table(table) => table_markup(table, &count.id("t")),
        Block::Plot(plot) => figure(plot, &count.id("p"))?,
        Block::View(view) => view_markup(view, &count.id("v")),
        Block::Section(part) => {
            let id = count.id("s");
            section(part, rank + 1, &id, count)?
        }
    })
}

fn one_note(note: &Note) -> Markup {
    let (class, label, text) = match note {
        Note::Warning(text) => ("warning", "Warning", text),
        Note::Loss(text) => ("loss", "Lost", text),
        Note::Remark(text) => ("remark", "Note", text),
    };
    html! { li class=(class) { strong { (label) ": " } (text) } }
}

fn table_markup(table: &Table, id: &str) -> Markup {
    let numeric = |at: usize| table.columns.get(at).is_some_and(|c| c.numeric);
    html! {
        // What is wider than the page scrolls by itself; with a keyboard, too.
        div.table role="region" aria-labelledby=(id) tabindex="0" {
            table {
                caption id=(id) { (table.caption) }
                thead { tr { @for (at, column) in table.columns.iter().enumerate() {
                    th scope="col" class=[numeric(at).then_some("n")] { (column.head) }
                } } }
                tbody { @for row in &table.rows { tr { @for (at, cell) in row.iter().enumerate() {
                    @if at == 0 { th scope="row" class=[numeric(at).then_some("n")] { (cell_markup(cell)) } }
                    @else { td class=[numeric(at).then_some("n")] { (cell_markup(cell)) } }
                } } } }
            }
        }
        @if !table.note.is_empty() { p.note { (table.note) } }
    }
}

fn cell_markup(cell: &Cell) -> Markup {
    match cell {
        Cell::Text(text) => html! { (text) },
        Cell::Figure { text, value, at } => html! {
            data value=(value) data-at=[(!at.is_empty()).then_some(at)] { (text) }
        },
        Cell::Empty => html! { span aria-label="nothing" { "–" } },
    }
}

fn figure(plot: &Plot, id: &str) -> Result<Markup, PlotError> {
    let drawn = svg::draw(plot, id)?;
    let keys: Vec<_> = plot.layers.iter().filter_map(Layer::key).collect();
    Ok(html! {
        figure {
            div.plot tabindex="0" role="group" aria-label=(plot.title) { (PreEscaped(drawn)) }
            @if !keys.is_empty() {
                ul.legend { @for (name, ink, key) in keys { li { (key_mark(ink, key)) (name) } } }
            }
            @if let Some((scale, unit)) = &plot.scale { (scale_markup(scale, unit)) }
            figcaption { strong { (plot.title) ". " } (plot.description) }
        }
    })
}

fn key_mark(ink: Ink, key: Key) -> Markup {
    let colour = svg::css(ink);
    html! {
        svg.key viewBox="0 0 20 20" aria-hidden="true" {
            @match key {
                Key::Marker(Marker::Disc) => { circle cx="10" cy="10" r="6" fill=(colour) {} }
                Key::Marker(Marker::Triangle) => { path d="M10 3 17 16 3 16Z" fill=(colour) {} }
                Key::Marker(Marker::Cross) => { path d="M4 4 16 16M16 4 4 16" stroke=(colour) stroke-width="2.5" {} }
                Key::Marker(Marker::Square) => { rect x="4" y="4" width="12" height="12" fill=(colour) {} }
                Key::Line => { path d="M1 10H19" stroke=(colour) stroke-width="2.5" {} }
            }
        }
    }
}

fn scale_markup(scale: &Scale, unit: &str) -> Markup {
    let [low, high] = scale.range;
    let decimals = (2.0 - (high - low).abs().log10().floor()).clamp(0.0, 6.0) as usize;
    let end = |v: f64| format!("{v:.decimals$} {unit}").replacen('-', "−", 1);
    html! {
        p.scale {
            span { (end(low)) }
            span.bar style={ "background:" (scale.gradient()) } {}
            span { (end(high)) }
        }
    }
}

fn view_markup(view: &View, id: &str) -> Markup {
    let packed = view.packed();
    let list = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let first = view.colourings.first();
    let plain = first.and_then(|c| c.colours.first()).map_or_else(String::new, |c| hex(*c));
    html! {
        figure.view3d data-positions=(packed.positions) data-triangles=(packed.triangles)
            data-middle=(list(&packed.middle_mm)) data-side=(packed.side_mm) data-up=(list(&view.up))
            data-eye=(list(&view.towards_eye)) data-plain=(plain) {
            canvas id=(id) tabindex="0" role="img" aria-label=(view.description) aria-describedby={ (id) "-h" } {
                (view.description)
            }
            p.fallback hidden { "This browser does not draw in three dimensions (WebGL 2)." }
            div.controls {
                @for (at, (colouring, data)) in view.colourings.iter().zip(&packed.colours).enumerate() {
                    label data-colours=(data) {
                        input type="radio" name={ (id) "-c" } value=(at) checked[at == 0];
                        (colouring.name)
                    }
                }
                button type="button" data-do="turn" aria-pressed="false" { "Turn" }
                button type="button" data-do="nearer" aria-label="Nearer" { "+" }
                button type="button" data-do="farther" aria-label="Farther" { "−" }
                button type="button" data-do="reset" { "Reset" }
            }
            @for (at, colouring) in view.colourings.iter().enumerate() {
                @if let Some((scale, unit)) = &colouring.scale {
                    div.of data-of=(at) hidden[at != 0] { (scale_markup(scale, unit)) }
                }
            }
            figcaption {
                (view.caption)
                span.help id={ (id) "-h" } {
                    " Drag to turn, with two fingers or Shift to shift, pinch or Ctrl and wheel to come nearer; with the keyboard "
                    "arrows, Shift and arrows, + and −, 0 to reset."
                }
            }
        }
    }
}
