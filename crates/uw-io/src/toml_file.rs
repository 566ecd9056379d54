//! Versioned TOML: `format` and `version` first, then strictly typed keys, errors with line and column.

use std::path::{Path, PathBuf};

use serde::{Deserialize, de::DeserializeOwned, de::Error as _};
use toml::{
    Spanned,
    de::{DeTable, DeValue, Deserializer},
};

use crate::{
    error::{Error, Place, Problem},
    text,
};

const LIMIT: u64 = 16 << 20;

/// The keys of our formats that are tables.
const TABLES: [&str; 12] = [
    "camera",
    "dialect",
    "disk",
    "galvo",
    "interlock",
    "laser",
    "port",
    "rig",
    "statistics",
    "sweep",
    "target",
    "water",
];

/// A TOML file's text.
pub(crate) fn text(path: &Path) -> Result<String, Error> {
    text::read(path, LIMIT)
}

/// A TOML file of a known format, whose keys can be found again when one of them is wrong.
pub(crate) struct TomlFile {
    path: PathBuf,
    text: String,
}

impl TomlFile {
    /// Reads a file and checks that it declares `format` and a version up to `version`.
    pub fn read(path: &Path, format: &'static str, version: u32) -> Result<Self, Error> {
        Self::of_text(path, text(path)?, format, version)
    }

    /// As [`TomlFile::read`], from the file's text.
    pub fn of_text(path: &Path, text: String, format: &'static str, version: u32) -> Result<Self, Error> {
        let file = Self { path: path.to_owned(), text };
        let table = file.table()?;
        let table = table.get_ref();
        match table.get("format").map(Spanned::get_ref) {
            Some(DeValue::String(got)) if got == format => {}
            other => {
                let got = match other {
                    Some(DeValue::String(got)) => format!("of format \"{got}\""),
                    Some(_) => "of a format that is no text".into(),
                    None => "a file without `format`".into(),
                };
                return Err(Error::Format { place: file.place("format"), needed: format, got });
            }
        }
        let number = match table.get("version").map(Spanned::get_ref) {
            Some(DeValue::Integer(i)) => i64::from_str_radix(i.as_str(), i.radix()).ok(),
            _ => None,
        };
        match number {
            Some(got) if got > i64::from(version) => {
                Err(Error::Version { place: file.place("version"), needed: version, got })
            }
            Some(got) if got >= 1 => Ok(file),
            _ => {
                let what = "the version must be a whole number from 1";
                Err(file.error("version", what, format!("write: version = {version}")))
            }
        }
    }

    /// The file's keys, `format` and `version` aside, as `T`; a key that `T` doesn't know is an error.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, Error> {
        let mut table = self.table()?;
        table.get_mut().remove("format");
        table.get_mut().remove("version");
        T::deserialize(Deserializer::from(table)).map_err(|e| self.translate(&e))
    }

    /// An error about the key with this dotted path, with its line and column where it exists.
    pub fn error(&self, key: &str, what: impl Into<String>, mend: impl Into<String>) -> Error {
        Error::content(self.place(key), what, mend)
    }

    /// A warning about the key with this dotted path.
    pub fn warning(&self, key: &str, what: impl Into<String>, mend: impl Into<String>) -> Problem {
        Problem::warning(self.place(key), what, mend)
    }

    fn table(&self) -> Result<Spanned<DeTable<'_>>, Error> {
        DeTable::parse(&self.text).map_err(|e| self.translate(&e))
    }

    /// The place of a dotted key; of the innermost table that exists where the key doesn't.
    fn place(&self, key: &str) -> Place {
        let mut start = None;
        if let Ok(root) = DeTable::parse(&self.text) {
            let mut table = Some(root.get_ref());
            for part in key.split('.') {
                let Some((name, value)) = table.and_then(|t| t.get_key_value(part)) else { break };
                start = Some(name.span().start);
                table = match value.get_ref() {
                    DeValue::Table(inner) => Some(inner),
                    _ => None,
                };
            }
        }
        self.at(start).key(key)
    }

    fn at(&self, offset: Option<usize>) -> Place {
        let (line, column) = offset.map(|o| text::line_column(&self.text, o)).unzip();
        Place { line, column, ..Place::file(&self.path) }
    }

    /// The innermost key whose name or value covers an offset; `None` outside all keys, or in a text that is no TOML.
    fn key_at(&self, offset: usize) -> Option<String> {
        fn find(table: &DeTable<'_>, offset: usize) -> Option<String> {
            table.iter().find_map(|(name, value)| {
                let inside = |inner| find(inner, offset).map(|key| format!("{}.{key}", name.get_ref()));
                let deeper = match value.get_ref() {
                    DeValue::Table(inner) => inside(inner),
                    DeValue::Array(rows) => rows.iter().find_map(|row| inside(row.get_ref().as_table()?)),
                    _ => None,
                };
                let here = name.span().contains(&offset) || value.span().contains(&offset);
                deeper.or_else(|| here.then(|| name.get_ref().to_string()))
            })
        }
        find(DeTable::parse(&self.text).ok()?.get_ref(), offset)
    }

    /// Says what serde or the parser found, in the words of a person who edits the file.
    fn translate(&self, e: &toml::de::Error) -> Error {
        let offset = e.span().map(|s| s.start);
        let message = e.message().replace('\n', ", ");
        let mut place = self.at(offset);
        place.key = offset.and_then(|o| self.key_at(o));
        // Where a key is missing from the file's top, serde points at the first key that is there.
        let is_table = |key: &String| key.rsplit('.').next().is_some_and(|last| TABLES.contains(&last));
        if message.starts_with("missing field") && !place.key.as_ref().is_some_and(is_table) {
            place = self.at(None);
        }
        // serde names the unknown word first and then the ones it knows, each between backticks.
        let mut quoted = message.split('`').skip(1).step_by(2);
        let word = quoted.next().unwrap_or_default();
        let mend = if message.starts_with("unknown field") {
            match text::nearest(word, quoted.clone()) {
                Some(known) => format!("did you mean `{known}`?"),
                None => "remove it, or use one of the names above".into(),
            }
        } else if message.starts_with("unknown variant") {
            match text::nearest(word, quoted.clone()) {
                Some(known) => format!("did you mean \"{known}\"?"),
                None => "use one of the names above".into(),
            }
        } else if message.starts_with("missing field") {
            if TABLES.contains(&word) {
                let above = place.key.as_ref().map_or(String::new(), |key| format!("{key}."));
                format!("add the table [{above}{word}], or get the whole file")
            } else {
                format!("add a line: {word} = …")
            }
        } else if message.starts_with("invalid") {
            wanted(message.rsplit_once("expected ").map_or("", |(_, expected)| expected))
        } else if message == "wanted string or table" {
            "write one of its names between quotation marks".into()
        } else {
            "mend the TOML here".into()
        };
        Error::content(place, message, mend)
    }
}

/// What to write where serde expected something else.
fn wanted(expected: &str) -> String {
    match expected {
        "f32" | "f64" => "write a number, such as 1.5".into(),
        "u8" | "u16" | "u32" | "u64" => "write a whole number from 0".into(),
        "a string" | "string" | "path string" => "write a text between quotation marks".into(),
        "a sequence" => "write a list, such as [1.0, 2.0]".into(),
        e if e.starts_with("struct ") => {
            "write a table of its own: [name], then a line for each of its keys".into()
        }
        e if e.starts_with("an array of length ") => {
            format!("write {} values between brackets", &e["an array of length ".len()..])
        }
        e if e.ends_with(" values") => format!("write {e}, no more and no fewer"),
        _ => "mend the value".into(),
    }
}

/// An array of exactly `N` values: serde's own reading of arrays lets further ones pass.
pub(crate) fn exactly<'de, D, T, const N: usize>(from: D) -> Result<[T; N], D::Error>
where
    D: serde::Deserializer<'de>,
    T: Deserialize<'de>,
{
    let values = Vec::deserialize(from)?;
    let length = values.len();
    values.try_into().map_err(|_| D::Error::invalid_length(length, &format!("{N} values").as_str()))
}
