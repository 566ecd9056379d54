//! The header of a PLY: which elements its body holds, in which types.

use std::{
    io::{BufRead, Read},
    path::Path,
};

use crate::error::{Error, Place};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    Little,
    Big,
}

/// The numeric types, under both of their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
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

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of the first bytes, which are as many as [`Scalar::size`] says.
    pub(super) fn value(self, bytes: &[u8], little: bool) -> f64 {
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

/// One property of an element.
pub(super) struct Property {
    pub(super) name: String,
    /// The type of the count that a list begins with; `None` for a single value.
    pub(super) count: Option<Scalar>,
    pub(super) scalar: Scalar,
}

/// A kind of rows: vertices, faces, anything else.
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

/// What the body holds, and how.
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) comments: Vec<String>,
    pub(super) elements: Vec<Element>,
    pub(super) lines: u32,
}

/// A header's line is never longer, nor are there more of them: a file that is no PLY is not read as one line.
const LONGEST_LINE: u64 = 4096;
const MOST_LINES: u32 = 10_000;

impl Header {
    pub(super) fn read(path: &Path, source: &mut impl BufRead) -> Result<Self, Error> {
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

    /// The element of this name.
    pub(super) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }

    /// How many rows an element has; none where it is not there.
    pub(super) fn count(&self, name: &str) -> usize {
        self.element(name).map_or(0, |v| usize::try_from(v.count).unwrap_or(usize::MAX))
    }

    /// The names of an element's properties, a list's left empty.
    pub(super) fn names(&self, name: &str) -> Vec<&str> {
        let properties = self.element(name).map_or(&[][..], |v| &v.properties);
        properties.iter().map(|p| if p.count.is_some() { "" } else { p.name.as_str() }).collect()
    }

    /// What a comment says that begins with a word.
    pub(super) fn comment(&self, word: &str) -> Option<&str> {
        self.comments.iter().find_map(|c| c.strip_prefix(word)?.strip_prefix(' '))
    }
}
