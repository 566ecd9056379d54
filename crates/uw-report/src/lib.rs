//! Pages to hand over: one HTML file with tables, plots and a 3-D view that turns, which asks nothing of the network.
//!
//! A [`Page`] is what is on it, [`Page::html`] its text. This crate knows nothing of scanners: which figures a page shows, and in which
//! words, is decided by whoever fills it.
//!
//! | part | file | what it decides |
//! |---|---|---|
//! | page, sections, tables | `page`, `html` | headings, captions, what a screen reader is told |
//! | plots | `plot`, `svg` | axes, marks; colours are the page's, so that they follow its light, dark and print styles |
//! | 3-D view | `view` | how points and triangles are packed |
//! | numbers | `number` | digits, by the standard deviation |
//! | colours | `colour` | scales that the colour-blind can read |
//!
//! Every figure of a table carries its full value, and its place in the record that lies beside the page, in a `data` element.

mod colour;
mod html;
mod number;
mod page;
mod plot;
mod svg;
mod view;

pub use colour::{Rgb, Scale};
pub use number::{decimals, plus_minus};
pub use page::{Block, Cell, Column, Note, Page, Section, Table};
pub use plot::{Axis, Ink, Layer, Marker, Plot};
pub use svg::PlotError;
pub use view::{Colouring, View};
