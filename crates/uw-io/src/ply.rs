//! PLY: our clouds out, anybody's clouds in.
//!
//! Written are the properties of [`write()`]. Read is any PLY of format 1.0, ascii or binary of either byte order, with
//! any properties of any type in any order: what is known by name is taken, the rest skipped, other elements too.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::Path,
};

use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Gather},
    error::{Error, Place, Problem},
};

/// How the body of a PLY is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Encoding {
    /// Binary, little-endian.
    #[default]
    Binary,
    /// One line of text a point; numbers read back as they were.
    Ascii,
}

/// Writes a cloud: `x y z` (double, mm), then as far as the cloud has them `intensity` (float), `frame` (int),
/// `u v` (float), `sigma` (float, mm), `cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz` (float, mm²); the frame and the
/// unit in comments of the header.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, encoding: Encoding) -> Result<(), Error> {
    let columns = columns::of(cloud);
    let format = match encoding {
        Encoding::Binary => "binary_little_endian",
        Encoding::Ascii => "ascii",
    };
    atomic::write(path, overwrite, |mut w| {
        writeln!(w, "ply\nformat {format} 1.0\ncomment uwscan {}", env!("CARGO_PKG_VERSION"))?;
        writeln!(
            w,
            "comment frame {}\ncomment unit mm\nelement vertex {}",
            cloud.frame().name(),
            cloud.len()
        )?;
        for (name, column) in &columns {
            writeln!(w, "property {} {name}", column.ply_type())?;
        }
        writeln!(w, "end_header")?;
        match encoding {
            Encoding::Ascii => columns::write_text(&mut w, &columns, cloud.len(), b' '),
            Encoding::Binary => {
                let mut row = Vec::new();
                for point in 0..cloud.len() {
                    row.clear();
                    columns.iter().for_each(|(_, column)| column.append_le(point, &mut row));
                    w.write_all(&row)?;
                }
                Ok(())
            }
        }
    })
}

/// The cloud of a PLY file, with warnings about what had to be assumed.
///
/// Attributes come back where all of their properties are there. Without the comments `frame` and
/// `unit`, the camera's frame and millimetres are meant.
///
/// # Errors
/// [`Error`] where the file cannot be read, is no PLY, has no vertices with x, y and z, ends early, holds a position
/// that is no finite number, or says that its unit is not the millimetre.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let size = file.metadata().map_err(Error::file(path, "open"))?.len();
    let mut source = BufReader::with_capacity(1 << 18, file);
    let header = Header::read(path, &mut source)?;
    let names = header.vertex_names();
    // No vertex takes less than a byte, so that a count that lies reserves no more than the file's own size.
    let expected = header.vertices().min(size as usize);
    let mut gather = Gather::new(path, &names, expected)?;
    header.read_body(path, &mut source, &mut gather)?;
    let frame = header.comments.iter().find_map(|c| c.strip_prefix("frame "));
    let unit = header.comments.iter().find_map(|c| c.strip_prefix("unit "));
    gather.finish(frame, unit)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Ascii,
    Little,
    Big,
}

/// The numeric types, under both of their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of the first bytes, which are as many as [`Scalar::size`] says.
    fn value(self, bytes: &[u8], little: bool) -> f64 {
        /// The first bytes in little-endian order.
        fn first<const N: usize>(bytes: &[u8], little: bool) -> [u8; N] {
            let mut array = [0; N];
            array.copy_from_slice(&bytes[..N]);
            if !little {
                array.reverse();
            }
            array
        }
        match self {
            Self::I8 => f64::from(i8::from_le_bytes(first(bytes, little))),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes(first(bytes, little))),
            Self::U16 => f64::from(u16::from_le_bytes(first(bytes, little))),
            Self::I32 => f64::from(i32::from_le_bytes(first(bytes, little))),
            Self::U32 => f64::from(u32::from_le_bytes(first(bytes, little))),
            Self::F32 => f64::from(f32::from_le_bytes(first(bytes, little))),
            Self::F64 => f64::from_le_bytes(first(bytes, little)),
        }
    }
}

struct Property {
    name: String,
    /// The type of the count that a list begins with; `None` for a single value.
    count: Option<Scalar>,
    scalar: Scalar,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Header {
    format: Format,
    comments: Vec<String>,
    elements: Vec<Element>,
    lines: u32,
}

/// A header's line is never longer, nor are there more of them: a file that is no PLY is not read as one line.
const LONGEST_LINE: u64 = 4096;
/// A vertex's line, or a face's with thousands of corners.
const LONGEST_TEXT: u64 = 1 << 20;
const MOST_LINES: u32 = 10_000;

impl Header {
    fn read(path: &Path, source: &mut impl BufRead) -> Result<Self, Error> {
        let mut header = Self { format: Format::Ascii, comments: Vec::new(), elements: Vec::new(), lines: 0 };
        let mut format = None;
        loop {
            let mut bytes = Vec::new();
            source.take(LONGEST_LINE).read_until(b'\n', &mut bytes).map_err(Error::file(path, "read"))?;
            header.lines += 1;
            let place = Place::line(path, header.lines);
            let fail =
                |what: &str| Err(Error::content(place.clone(), what, "check that this is a whole PLY file"));
            let line = String::from_utf8_lossy(&bytes);
            let line = line.trim();
            if header.lines == 1 {
                if line != "ply" {
                    return fail("does not begin with \"ply\"");
                }
                continue;
            }
            if bytes.last() != Some(&b'\n') && line != "end_header" || header.lines > MOST_LINES {
                return fail("the header does not end");
            }
            let words: Vec<&str> = line.split_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                ["comment" | "obj_info", rest @ ..] => header.comments.push(rest.join(" ")),
                ["format", name, "1.0"] => {
                    format = match *name {
                        "ascii" => Some(Format::Ascii),
                        "binary_little_endian" => Some(Format::Little),
                        "binary_big_endian" => Some(Format::Big),
                        _ => return fail(&format!("the format \"{name}\" is unknown")),
                    }
                }
                ["element", name, count] => {
                    let Ok(count) = count.parse() else {
                        return fail(&format!("\"{count}\" is no number of elements"));
                    };
                    if header.elements.iter().any(|e| e.name == *name) {
                        return fail(&format!("the element {name} is declared twice"));
                    }
                    header.elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                ["property", kind @ .., name] => {
                    let types = match kind {
                        [scalar] => Scalar::from_name(scalar).map(|s| (None, s)),
                        ["list", count, scalar] => Scalar::from_name(count)
                            .zip(Scalar::from_name(scalar))
                            .filter(|(c, _)| !matches!(c, Scalar::F32 | Scalar::F64))
                            .map(|(c, s)| (Some(c), s)),
                        _ => None,
                    };
                    let Some((count, scalar)) = types else {
                        return fail(&format!("\"{line}\" declares no known type"));
                    };
                    let Some(element) = header.elements.last_mut() else {
                        return fail("a property comes before any element");
                    };
                    if element.properties.iter().any(|p| p.name == *name) {
                        return fail(&format!("the property {name} is declared twice"));
                    }
                    element.properties.push(Property { name: (*name).to_owned(), count, scalar });
                }
                [] => {}
                _ => return fail(&format!("\"{line}\" is no line of a PLY header")),
            }
        }
        let Some(format) = format else {
            return Err(Error::content(
                Place::file(path),
                "has no format line",
                "check that this is a whole PLY file",
            ));
        };
        Ok(Self { format, ..header })
    }

    fn vertex(&self) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == "vertex")
    }

    fn vertices(&self) -> usize {
        self.vertex().map_or(0, |v| usize::try_from(v.count).unwrap_or(usize::MAX))
    }

    /// The names of the vertex's properties, a list's left empty.
    fn vertex_names(&self) -> Vec<&str> {
        let properties = self.vertex().map_or(&[][..], |v| &v.properties);
        properties.iter().map(|p| if p.count.is_some() { "" } else { p.name.as_str() }).collect()
    }

    /// Reads up to the vertices' end; what follows them is not looked at.
    fn read_body(&self, path: &Path, source: &mut impl BufRead, gather: &mut Gather) -> Result<(), Error> {
        let mut line = self.lines;
        for element in &self.elements {
            let into = (element.name == "vertex").then_some(&mut *gather);
            let last = into.is_some();
            match self.format {
                Format::Ascii => element.read_text(path, source, &mut line, into)?,
                Format::Little => element.read_binary(path, source, true, into)?,
                Format::Big => element.read_binary(path, source, false, into)?,
            }
            if last {
                break;
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
        mut into: Option<&mut Gather>,
    ) -> Result<(), Error> {
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
            for property in &self.properties {
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
                        next()?;
                    }
                    values.push(0.0);
                } else {
                    values.push(next()?);
                }
            }
            if let Some(gather) = &mut into {
                gather.push(&values).map_err(fail)?;
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
        mut into: Option<&mut Gather>,
    ) -> Result<(), Error> {
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
                for (value, property) in values.iter_mut().zip(&self.properties) {
                    let head = property.count.unwrap_or(property.scalar);
                    let bytes = &mut bytes[..head.size()];
                    source.read_exact(bytes).map_err(|e| read(e, done))?;
                    *value = head.value(bytes, little);
                    if property.count.is_some() {
                        let length = *value as u64 * property.scalar.size() as u64;
                        let skipped = io::copy(&mut source.by_ref().take(length), &mut io::sink());
                        if skipped.map_err(|e| read(e, done))? < length {
                            return Err(self.torn(path, done));
                        }
                    }
                }
            }
            if let Some(gather) = &mut into {
                let place = || Place::file(path).key(&format!("vertex {done}"));
                gather.push(&values).map_err(|what| Error::content(place(), what, "write the file anew"))?;
            }
        }
        Ok(())
    }

    fn torn(&self, path: &Path, done: u64) -> Error {
        let what = format!("ends after {done} of {} elements \"{}\"", self.count, self.name);
        Error::content(Place::file(path), what, "the file is torn: copy it again, or write it anew")
    }
}
