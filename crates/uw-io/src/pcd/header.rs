//! The header of a PCD: what each point holds, and how many there are.

use std::{io::BufRead, path::Path};

use crate::{
    error::{Error, Place},
    text,
};

const LONGEST_LINE: u64 = 1 << 16;
/// No header has more lines.
const MOST_LINES: u32 = 1000;
/// Values of a field at most: descriptors have hundreds.
const MOST_VALUES: usize = 1 << 14;

/// How the points are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Data {
    Ascii,
    Binary,
    Compressed,
}

/// The type of a field's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Float,
    Signed,
    Unsigned,
}

/// One field of a point.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) name: String,
    /// Bytes of a value.
    pub(super) size: usize,
    pub(super) kind: Kind,
    /// Values of it.
    pub(super) count: usize,
}

impl Field {
    /// Whether it is three colours in four bytes.
    pub(super) fn is_packed_color(&self) -> bool {
        matches!(self.name.as_str(), "rgb" | "rgba") && self.size == 4 && self.count == 1
    }
}

/// What a header says.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) fields: Vec<Field>,
    pub(super) points: usize,
    pub(super) data: Data,
    pub(super) frame: Option<String>,
    pub(super) unit: Option<String>,
    /// Lines of the header.
    pub(super) lines: u32,
    /// Where x, y and z are in a row of values.
    pub(super) position: Vec<usize>,
}

impl Header {
    /// Reads up to the line that says how the points are stored.
    pub(super) fn read(path: &Path, source: &mut impl BufRead) -> Result<Self, Error> {
        let mut fields: Vec<Field> = Vec::new();
        let (mut width, mut height, mut points) = (None, None, None);
        let (mut frame, mut unit) = (None, None);
        let mut bytes = Vec::new();
        for at in 1..=MOST_LINES {
            let fail = |what: String| {
                Error::content(Place::line(path, at), what, "check that this is a whole PCD file")
            };
            if !text::next_line(source, path, LONGEST_LINE, &mut bytes)? {
                return Err(fail("the header ends before its line DATA".to_owned()));
            }
            let Ok(line) = std::str::from_utf8(&bytes) else {
                return Err(fail("is no text: this is no PCD".to_owned()));
            };
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let number = |words: &[&str]| -> Result<usize, Error> {
                let number = words.first().and_then(|word| word.parse().ok());
                number.ok_or_else(|| fail("has no whole number".to_owned()))
            };
            // SIZE, TYPE and COUNT have a value for each field.
            let each = |words: &[&str], fields: usize| match words.len() == fields {
                true => Ok(()),
                false => Err(fail(format!("has {} values for {fields} fields", words.len()))),
            };
            match words.as_slice() {
                ["#", "frame", name] => frame = Some((*name).to_owned()),
                ["#", "unit", name] => unit = Some((*name).to_owned()),
                [] | ["VERSION" | "VIEWPOINT", ..] => {}
                [word, ..] if word.starts_with('#') => {}
                ["FIELDS" | "COLUMNS", names @ ..] => {
                    let field = |name: &&str| Field {
                        name: name.to_ascii_lowercase(),
                        size: 4,
                        kind: Kind::Float,
                        count: 1,
                    };
                    fields = names.iter().map(field).collect();
                }
                ["SIZE", sizes @ ..] => {
                    each(sizes, fields.len())?;
                    for (field, size) in fields.iter_mut().zip(sizes) {
                        field.size = number(&[size])?;
                    }
                }
                ["TYPE", kinds @ ..] => {
                    each(kinds, fields.len())?;
                    for (field, kind) in fields.iter_mut().zip(kinds) {
                        field.kind = match *kind {
                            "F" => Kind::Float,
                            "I" => Kind::Signed,
                            "U" => Kind::Unsigned,
                            other => return Err(fail(format!("\"{other}\" is none of F, I and U"))),
                        };
                    }
                }
                ["COUNT", counts @ ..] => {
                    each(counts, fields.len())?;
                    for (field, count) in fields.iter_mut().zip(counts) {
                        field.count = number(&[count])?;
                    }
                }
                ["WIDTH", rest @ ..] => width = Some(number(rest)?),
                ["HEIGHT", rest @ ..] => height = Some(number(rest)?),
                ["POINTS", rest @ ..] => points = Some(number(rest)?),
                ["DATA", kind] => {
                    let data = match *kind {
                        "ascii" => Data::Ascii,
                        "binary" => Data::Binary,
                        "binary_compressed" => Data::Compressed,
                        other => {
                            return Err(fail(format!(
                                "\"{other}\" is none of ascii, binary, binary_compressed"
                            )));
                        }
                    };
                    let places = width.and_then(|w: usize| w.checked_mul(height.unwrap_or(1)));
                    let Some(points) = points.or(places) else {
                        return Err(fail("no line before it says how many POINTS there are".to_owned()));
                    };
                    for field in &fields {
                        let sound = match field.kind {
                            Kind::Float => matches!(field.size, 4 | 8),
                            Kind::Signed | Kind::Unsigned => matches!(field.size, 1 | 2 | 4 | 8),
                        };
                        if !sound || field.count > MOST_VALUES {
                            return Err(fail(format!(
                                "the field {} has {} values of {} bytes, which no PCD has",
                                field.name, field.count, field.size
                            )));
                        }
                    }
                    let mut header =
                        Self { fields, points, data, frame, unit, lines: at, position: Vec::new() };
                    if header.record_size().checked_mul(points).is_none() {
                        return Err(fail(format!("no file has {points} points")));
                    }
                    let names = header.names();
                    let find = |name: &str| names.iter().position(|n| n == name);
                    header.position = ["x", "y", "z"].into_iter().filter_map(find).collect();
                    return Ok(header);
                }
                [word, ..] => return Err(fail(format!("\"{word}\" begins no line of a PCD's header"))),
            }
        }
        Err(Error::content(Place::file(path), "has no line DATA", "check that this is a whole PCD file"))
    }

    /// Bytes of a point.
    pub(super) fn record_size(&self) -> usize {
        self.fields.iter().map(|field| field.size * field.count).sum()
    }

    /// A name for each value of a row, as other formats name it; packed colours are three values.
    pub(super) fn names(&self) -> Vec<String> {
        let mut names = Vec::new();
        for field in &self.fields {
            if field.is_packed_color() {
                names.extend(["red", "green", "blue"].map(String::from));
                continue;
            }
            let name = match field.name.as_str() {
                "normal_x" => "nx",
                "normal_y" => "ny",
                "normal_z" => "nz",
                other => other,
            };
            match field.count {
                1 => names.push(name.to_owned()),
                count => names.extend((0..count).map(|k| format!("{name}[{k}]"))),
            }
        }
        names
    }
}
