//! What is on a page.

use crate::plot::Plot;
use crate::view::View;

/// A page.
#[derive(Debug, Clone, Default)]
pub struct Page {
    /// Its title.
    pub title: String,
    /// A line below it.
    pub subtitle: String,
    /// Its parts.
    pub sections: Vec<Section>,
    /// The last line: what made it.
    pub footer: String,
}

/// A part of a page.
#[derive(Debug, Clone, Default)]
pub struct Section {
    /// Its heading.
    pub heading: String,
    /// What is in it.
    pub blocks: Vec<Block>,
}

impl Section {
    /// Returns a part with nothing in it.
    pub fn new(heading: impl Into<String>) -> Self {
        Self { heading: heading.into(), blocks: Vec::new() }
    }

    /// Adds to it.
    pub fn push(&mut self, block: impl Into<Block>) {
        self.blocks.push(block.into());
    }
}

/// A piece of a section.
#[derive(Debug, Clone)]
pub enum Block {
    /// Text.
    Text(String),
    /// Terms and what they are.
    Terms(Vec<(String, String)>),
    /// What a reader must not overlook.
    Notes(Vec<Note>),
    /// A table.
    Table(Table),
    /// A plot.
    Plot(Plot),
    /// Points or a surface in space.
    View(View),
    /// A part of the part, with a heading of the next rank.
    Section(Section),
}

/// Something to know before trusting a figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Note {
    /// Trust it less.
    Warning(String),
    /// An input that was missing.
    Loss(String),
    /// No fault.
    Remark(String),
}

/// A table.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// Heads of its columns.
    pub columns: Vec<Column>,
    /// Its rows, a cell a column; the first cell of each is the row's head.
    pub rows: Vec<Vec<Cell>>,
    /// What is said below it; empty: nothing.
    pub note: String,
}

/// A column's head.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// What it is.
    pub head: String,
    /// Its cells are numbers.
    pub numeric: bool,
}

impl Column {
    /// A column of words.
    pub fn text(head: impl Into<String>) -> Self {
        Self { head: head.into(), numeric: false }
    }

    /// A column of numbers, its unit in its head.
    pub fn number(head: impl Into<String>) -> Self {
        Self { head: head.into(), numeric: true }
    }
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A number.
    Figure {
        /// As a person reads it.
        text: String,
        /// All of it.
        value: f64,
        /// Its place in the record beside the page: a JSON pointer (RFC 6901); empty: it is not there.
        at: String,
    },
    /// Nothing to say.
    Empty,
}

impl Cell {
    /// A number with its place in the record.
    pub fn figure(text: impl Into<String>, value: f64, at: impl Into<String>) -> Self {
        Self::Figure { text: text.into(), value, at: at.into() }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<Table> for Block {
    fn from(table: Table) -> Self {
        Self::Table(table)
    }
}

impl From<Plot> for Block {
    fn from(plot: Plot) -> Self {
        Self::Plot(plot)
    }
}

impl From<View> for Block {
    fn from(view: View) -> Self {
        Self::View(view)
    }
}

impl From<Section> for Block {
    fn from(section: Section) -> Self {
        Self::Section(section)
    }
}

impl From<String> for Block {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<&str> for Block {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}
