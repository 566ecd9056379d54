//! The body of a PLY: rows of an element, handed on one at a time.

use std::{
    io::{self, BufRead, Read},
    path::Path,
};

use super::header::{Element, Format, Header};
use crate::{
    columns::Gather,
    error::{Error, Place},
};

/// A vertex's line, or a face's with thousands of corners.
const LONGEST_TEXT: u64 = 1 << 20;

/// Takes the rows of an element.
pub(super) trait Rows {
    /// The position among the properties of the list whose items are wanted.
    fn list(&self) -> Option<usize> {
        None
    }

    /// Takes a row: a value a property (a list's means nothing), and the items of the wanted list; what is wrong with it.
    fn push(&mut self, values: &[f64], list: &[f64]) -> Result<(), String>;
}

impl Rows for Gather {
    fn push(&mut self, values: &[f64], _: &[f64]) -> Result<(), String> {
        Self::push(self, values)
    }
}

impl Header {
    /// Reads the elements in turn up to the last one that somebody wants; what follows is not looked at.
    pub(super) fn read_body(
        &self,
        path: &Path,
        source: &mut impl BufRead,
        wanted: &mut [(&str, &mut dyn Rows)],
    ) -> Result<(), Error> {
        let mut line = self.lines;
        let mut left = wanted.iter().filter(|(name, _)| self.element(name).is_some()).count();
        for element in &self.elements {
            if left == 0 {
                break;
            }
            let into = wanted.iter_mut().find(|(name, _)| *name == element.name);
            let into = into.map(|(_, rows)| {
                left -= 1;
                &mut **rows
            });
            match self.format {
                Format::Ascii => element.read_text(path, source, &mut line, into)?,
                Format::Little => element.read_binary(path, source, true, into)?,
                Format::Big => element.read_binary(path, source, false, into)?,
            }
        }
        Ok(())
    }
}

impl Element {
    fn read_text(
        &self,
        path: &Path,
        source: &mut impl BufRead,
        at: &mut u32,
        mut into: Option<&mut dyn Rows>,
    ) -> Result<(), Error> {
        let wanted = into.as_ref().and_then(|rows| rows.list());
        let mut list = Vec::new();
        let mut line = String::new();
        let mut values = Vec::with_capacity(self.properties.len());
        let mut done = 0;
        while done < self.count {
            line.clear();
            if source.take(LONGEST_TEXT).read_line(&mut line).map_err(Error::file(path, "read"))? == 0 {
                return Err(self.torn(path, done));
            }
            *at = at.saturating_add(1);
            let fail = |what: String| {
                Error::content(Place::line(path, *at), what, "mend the line, or write it anew")
            };
            if line.len() as u64 == LONGEST_TEXT {
                return Err(fail(format!("is longer than {LONGEST_TEXT} bytes")));
            }
            let mut words = line.split_ascii_whitespace().peekable();
            if words.peek().is_none() && !self.properties.is_empty() {
                continue;
            }
            values.clear();
            list.clear();
            for (at, property) in self.properties.iter().enumerate() {
                let mut next = || {
                    let word = words
                        .next()
                        .ok_or_else(|| fail(format!("the value of {} is missing", property.name)))?;
                    word.parse::<f64>()
                        .map_err(|_| fail(format!("{}: \"{word}\" is no number", property.name)))
                };
                if property.count.is_some() {
                    // A count that lies runs out of words.
                    for _ in 0..next()? as u64 {
                        let value = next()?;
                        if wanted == Some(at) {
                            list.push(value);
                        }
                    }
                    values.push(0.0);
                } else {
                    values.push(next()?);
                }
            }
            if let Some(rows) = &mut into {
                rows.push(&values, &list).map_err(fail)?;
            }
            done += 1;
        }
        Ok(())
    }

    fn read_binary(
        &self,
        path: &Path,
        source: &mut impl BufRead,
        little: bool,
        mut into: Option<&mut dyn Rows>,
    ) -> Result<(), Error> {
        let wanted = into.as_ref().and_then(|rows| rows.list());
        let (mut list, mut raw) = (Vec::new(), Vec::new());
        let read = |e: io::Error, done: u64| match e.kind() {
            io::ErrorKind::UnexpectedEof => self.torn(path, done),
            _ => Error::file(path, "read")(e),
        };
        if self.properties.is_empty() {
            return Ok(());
        }
        let fixed: Option<usize> =
            self.properties.iter().map(|p| p.count.is_none().then(|| p.scalar.size())).sum();
        let mut bytes = vec![0; fixed.unwrap_or(8)];
        let mut values = vec![0.0; self.properties.len()];
        for done in 0..self.count {
            if fixed.is_some() {
                source.read_exact(&mut bytes).map_err(|e| read(e, done))?;
                let mut rest = bytes.as_slice();
                for (value, property) in values.iter_mut().zip(&self.properties) {
                    *value = property.scalar.value(rest, little);
                    rest = &rest[property.scalar.size()..];
                }
            } else {
                list.clear();
                for (at, (value, property)) in values.iter_mut().zip(&self.properties).enumerate() {
                    let head = property.count.unwrap_or(property.scalar);
                    let bytes = &mut bytes[..head.size()];
                    source.read_exact(bytes).map_err(|e| read(e, done))?;
                    *value = head.value(bytes, little);
                    if property.count.is_some() {
                        let size = property.scalar.size();
                        let length = *value as u64 * size as u64;
                        let mut rest = source.by_ref().take(length);
                        raw.clear();
                        // What is taken grows with what is there, so that a count that lies reserves nothing.
                        let taken = match wanted == Some(at) {
                            true => rest.read_to_end(&mut raw).map(|n| n as u64),
                            false => io::copy(&mut rest, &mut io::sink()),
                        };
                        if taken.map_err(|e| read(e, done))? < length {
                            return Err(self.torn(path, done));
                        }
                        list.extend(raw.chunks_exact(size).map(|item| property.scalar.value(item, little)));
                    }
                }
            }
            if let Some(rows) = &mut into {
                let place = || Place::file(path).key(&format!("{} {done}", self.name));
                rows.push(&values, &list)
                    .map_err(|what| Error::content(place(), what, "write the file anew"))?;
            }
        }
        Ok(())
    }

    fn torn(&self, path: &Path, done: u64) -> Error {
        let what = format!("ends after {done} of {} elements \"{}\"", self.count, self.name);
        Error::content(Place::file(path), what, "the file is torn: copy it again, or write it anew")
    }
}
