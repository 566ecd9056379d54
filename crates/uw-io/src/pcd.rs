//! PCD, the Point Cloud Library's format: our clouds out as binary or text, anybody's in (version 0.6 and 0.7; `ascii`, `binary`,
//! `binary_compressed`).
//!
//! A sweep is written organised: a row of the file for each image, in order, and in it a place for each line of the image; places without a
//! point are not-a-number, as PCL has it. Reading leaves those out, and frame and pixel tell the order again.

mod header;
mod lzf;

use std::{
    collections::HashMap,
    fs::File,
    io::{BufRead, BufReader, Read, Write},
    path::Path,
};

use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Column, Gather},
    error::{Error, Place, Problem},
    ply::Encoding,
    text,
};
use header::{Data, Field, Header, Kind};

/// A line of a point's values.
const LONGEST_LINE: u64 = 1 << 16;
/// Coordinates become floats of four bytes, as PCL's own points have them, where that rounds them by no more, mm.
const ROUNDING_MM: f64 = 1e-4;
/// Places of an organised file for each point at most: a sweep that saw less is written as a list.
const MOST_PLACES: usize = 20;

/// Writes a cloud with the columns of [`crate::ply::write`]; normals as `normal_x normal_y normal_z` and colours as `rgb`, as PCL names
/// them; the frame and the unit in comments. Coordinates are float where that rounds them by at most 0.0001 mm, else double.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, encoding: Encoding) -> Result<(), Error> {
    let columns: Vec<Written<'_>> = written(cloud);
    let places = organised(cloud);
    let (width, height) = places.as_ref().map_or((cloud.len(), 1), |p| (p.width, p.height));
    let join =
        |value: &dyn Fn(&Written<'_>) -> String| columns.iter().map(value).collect::<Vec<_>>().join(" ");
    atomic::write(path, overwrite, |w| {
        writeln!(w, "# .PCD v0.7 - Point Cloud Data file format")?;
        writeln!(w, "# uwscan {}\n# frame {}\n# unit mm", env!("CARGO_PKG_VERSION"), cloud.frame().name())?;
        writeln!(w, "VERSION 0.7\nFIELDS {}", join(&|c| c.name.to_owned()))?;
        writeln!(w, "SIZE {}\nTYPE {}", join(&|c| c.size.to_string()), join(&|c| c.kind.to_string()))?;
        writeln!(w, "COUNT {}\nWIDTH {width}\nHEIGHT {height}", join(&|_| "1".to_owned()))?;
        writeln!(w, "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}", width * height)?;
        writeln!(w, "DATA {}", if encoding == Encoding::Binary { "binary" } else { "ascii" })?;
        let mut row = Vec::new();
        for place in 0..width * height {
            let point = places.as_ref().map_or(Some(place), |places| places.of.get(&place).copied());
            row.clear();
            for (at, column) in columns.iter().enumerate() {
                if encoding == Encoding::Binary {
                    column.append(point, &mut row);
                } else {
                    column.append_text(point, at > 0, &mut row)?;
                }
            }
            if encoding == Encoding::Ascii {
                row.push(b'\n');
            }
            w.write_all(&row)?;
        }
        Ok(())
    })
}

/// A column as it is written.
struct Written<'a> {
    name: &'static str,
    size: usize,
    kind: char,
    value: Value<'a>,
}

enum Value<'a> {
    Double(&'a [[f64; 3]], usize),
    Single(Box<dyn Fn(usize) -> f32 + 'a>),
    Count(&'a [u32]),
}

fn written(cloud: &PointCloud) -> Vec<Written<'_>> {
    let largest = cloud.positions_mm().iter().flatten().fold(0.0_f64, |most, c| most.max(c.abs()));
    let single = largest * 2_f64.powi(-24) <= ROUNDING_MM;
    columns::of(cloud).into_iter().filter_map(|(name, column)| as_written(name, column, single)).collect()
}

/// A column under PCL's name; `None` for those that are part of another.
fn as_written<'a>(name: &'static str, column: Column<'a>, single: bool) -> Option<Written<'a>> {
    let name = match name {
        "nx" => "normal_x",
        "ny" => "normal_y",
        "nz" => "normal_z",
        other => other,
    };
    Some(match column {
        Column::Double(v, at) if single => {
            let value = Value::Single(Box::new(move |i| v[i][at] as f32));
            Written { name, size: 4, kind: 'F', value }
        }
        Column::Double(v, at) => Written { name, size: 8, kind: 'F', value: Value::Double(v, at) },
        Column::Float(v) => Written { name, size: 4, kind: 'F', value: Value::Single(v) },
        Column::Int(v) => Written { name, size: 4, kind: 'U', value: Value::Count(v) },
        // One number for the three.
        Column::Byte(v, 0) => {
            let packed = move |i: usize| f32::from_bits(u32::from_be_bytes([0, v[i][0], v[i][1], v[i][2]]));
            Written { name: "rgb", size: 4, kind: 'F', value: Value::Single(Box::new(packed)) }
        }
        Column::Byte(..) => return None,
    })
}

impl Written<'_> {
    fn append(&self, point: Option<usize>, row: &mut Vec<u8>) {
        match &self.value {
            Value::Double(v, at) => row.extend(point.map_or(f64::NAN, |i| v[i][*at]).to_le_bytes()),
            Value::Single(v) => row.extend(point.map_or(f32::NAN, v).to_le_bytes()),
            Value::Count(v) => row.extend(point.map_or(0, |i| v[i]).to_le_bytes()),
        }
    }

    fn append_text(&self, point: Option<usize>, later: bool, row: &mut Vec<u8>) -> std::io::Result<()> {
        if later {
            row.push(b' ');
        }
        match (&self.value, point) {
            (Value::Count(v), point) => write!(row, "{}", point.map_or(0, |i| v[i])),
            (_, None) => write!(row, "nan"),
            (Value::Double(v, at), Some(i)) => write!(row, "{:?}", v[i][*at]),
            (Value::Single(v), Some(i)) => write!(row, "{:?}", v(i)),
        }
    }
}

/// The places of an organised file.
struct Places {
    width: usize,
    height: usize,
    /// Which point is in a place.
    of: HashMap<usize, usize>,
}

/// Where each point of a sweep belongs: its image, and its line in it. `None` for what is no sweep, has two points in a place, or few in
/// very many.
fn organised(cloud: &PointCloud) -> Option<Places> {
    let (pixels, frames) = (cloud.pixels()?, cloud.frame_rows()?);
    let whole = |k: usize| pixels.iter().all(|p| p[k].fract() == 0.0);
    // One centre a row has whole v, one a column whole u.
    let along = [1, 0].into_iter().find(|k| whole(*k))?;
    let lines = || pixels.iter().map(|p| p[along] as i64);
    let (low, high) = (lines().min()?, lines().max()?);
    let (first, last) = (*frames.iter().min()?, *frames.iter().max()?);
    let width = usize::try_from(high.checked_sub(low)?).ok()?.checked_add(1)?;
    let height = (last - first) as usize + 1;
    if width.checked_mul(height)? > MOST_PLACES * cloud.len() {
        return None;
    }
    let mut of = HashMap::with_capacity(cloud.len());
    for (point, (line, frame)) in lines().zip(frames).enumerate() {
        let place = (frame - first) as usize * width + (line - low) as usize;
        if of.insert(place, point).is_some() {
            return None;
        }
    }
    Some(Places { width, height, of })
}

/// The cloud of a PCD file, places without a point left out, with warnings about what had to be assumed. Without the comments `# frame` and
/// `# unit`, the camera's frame and millimetres are meant.
///
/// # Errors
/// [`Error`] where the file cannot be read, is no PCD, has no x, y and z, ends early, or says that its unit is not the millimetre.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let size = file.metadata().map_err(Error::file(path, "open"))?.len();
    let mut source = BufReader::with_capacity(1 << 18, file);
    let header = Header::read(path, &mut source)?;
    let names = header.names();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let expected = header.points.min(size as usize);
    let mut body =
        Body { path, header: &header, gather: Gather::new(path, &names, expected)?, row: Vec::new() };
    match header.data {
        Data::Ascii => body.text(&mut source)?,
        Data::Binary => body.binary(&mut source)?,
        Data::Compressed => body.compressed(&mut source, size)?,
    }
    body.gather.finish(header.frame.as_deref(), header.unit.as_deref())
}

struct Body<'a> {
    path: &'a Path,
    header: &'a Header,
    gather: Gather,
    row: Vec<f64>,
}

impl Body<'_> {
    fn torn(&self, done: usize) -> Error {
        let what = format!("ends after {done} of {} points", self.header.points);
        Error::content(Place::file(self.path), what, "the file is torn: copy it again")
    }

    /// Takes the row that was gathered, unless it is a place without a point.
    fn push(&mut self, point: usize) -> Result<(), Error> {
        if self.header.position.iter().any(|&at| self.row[at].is_nan()) {
            return Ok(());
        }
        self.gather.push(&self.row).map_err(|what| {
            let place = Place::file(self.path).key(&format!("point {point}"));
            Error::content(place, what, "mend the point, or take it out")
        })
    }

    fn text(&mut self, source: &mut impl BufRead) -> Result<(), Error> {
        let mut bytes = Vec::new();
        let mut line = self.header.lines;
        for point in 0..self.header.points {
            line += 1;
            if !text::next_line(source, self.path, LONGEST_LINE, &mut bytes)? {
                return Err(self.torn(point));
            }
            let line_text = String::from_utf8_lossy(&bytes);
            let mut words = line_text.split_ascii_whitespace();
            self.row.clear();
            for field in &self.header.fields {
                for _ in 0..field.count {
                    let value = words.next().and_then(|word| word.parse::<f64>().ok());
                    let Some(value) = value else {
                        let what = format!("has no number for {}", field.name);
                        return Err(Error::content(
                            Place::line(self.path, line),
                            what,
                            "each line has a number for each field",
                        ));
                    };
                    // Of text a packed colour is a float whose bits are meant.
                    field.append(value, (value as f32).to_bits(), &mut self.row);
                }
            }
            self.push(point)?;
        }
        Ok(())
    }

    fn binary(&mut self, source: &mut impl BufRead) -> Result<(), Error> {
        let header = self.header;
        let mut record = vec![0; header.record_size()];
        for point in 0..header.points {
            if let Err(e) = source.read_exact(&mut record) {
                return Err(match e.kind() {
                    std::io::ErrorKind::UnexpectedEof => self.torn(point),
                    _ => Error::file(self.path, "read")(e),
                });
            }
            self.row.clear();
            let mut left = record.as_slice();
            for field in &header.fields {
                for _ in 0..field.count {
                    let (own, rest) = left.split_at(field.size);
                    field.take(own, &mut self.row);
                    left = rest;
                }
            }
            self.push(point)?;
        }
        Ok(())
    }

    /// The body is compressed as a whole, and in it lies field after field.
    fn compressed(&mut self, source: &mut impl BufRead, size: u64) -> Result<(), Error> {
        let header = self.header;
        let mut sizes = [0; 8];
        source.read_exact(&mut sizes).map_err(|_| self.torn(0))?;
        let [packed, whole] =
            [0, 4].map(|at| u32::from_le_bytes([sizes[at], sizes[at + 1], sizes[at + 2], sizes[at + 3]]));
        let wrong =
            |what: String| Error::content(Place::file(self.path), what, "the file is torn: copy it again");
        let needed = header.points as u64 * header.record_size() as u64;
        if u64::from(whole) != needed {
            return Err(wrong(format!("tells of {whole} bytes of points, but its header of {needed}")));
        }
        if u64::from(packed) > size || u64::from(whole) > lzf::MOST_PER_BYTE * u64::from(packed) {
            return Err(self.torn(0));
        }
        let mut bytes = Vec::new();
        source.take(u64::from(packed)).read_to_end(&mut bytes).map_err(Error::file(self.path, "read"))?;
        let all = lzf::unpacked(&bytes, whole as usize);
        let all = all.ok_or_else(|| wrong("its compressed points do not unpack".to_owned()))?;
        for point in 0..header.points {
            self.row.clear();
            let mut start = 0;
            for field in &header.fields {
                let each = field.size * field.count;
                for k in 0..field.count {
                    let at = start + point * each + k * field.size;
                    field.take(&all[at..at + field.size], &mut self.row);
                }
                start += each * header.points;
            }
            self.push(point)?;
        }
        Ok(())
    }
}

impl Field {
    /// Appends a binary value to a row.
    fn take(&self, bytes: &[u8], row: &mut Vec<f64>) {
        let mut eight = [0_u8; 8];
        eight[..self.size].copy_from_slice(bytes);
        let whole = u64::from_le_bytes(eight);
        let value = match (self.kind, self.size) {
            (Kind::Float, 4) => f64::from(f32::from_bits(whole as u32)),
            (Kind::Float, _) => f64::from_bits(whole),
            (Kind::Unsigned, _) => whole as f64,
            // The sign comes from the highest bit that there is.
            (Kind::Signed, size) => ((whole << (64 - 8 * size)) as i64 >> (64 - 8 * size)) as f64,
        };
        self.append(value, whole as u32, row);
    }

    fn append(&self, value: f64, bits: u32, row: &mut Vec<f64>) {
        if self.is_packed_color() {
            let bits = if self.kind == Kind::Float { bits } else { value as u32 };
            let [_, red, green, blue] = bits.to_be_bytes();
            row.extend([red, green, blue].map(f64::from));
        } else {
            row.push(value);
        }
    }
}
