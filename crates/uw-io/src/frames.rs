//! `frames.csv`: one row an image, in the order of capture.

use std::{
    collections::HashMap,
    path::{Component, Path},
};

use csv::{ReaderBuilder, StringRecord, Trim};

use crate::{
    capture::{FrameRecord, Kind},
    error::{Error, Place, Problem},
    text,
};

const COLUMNS: [&str; 5] = ["file", "pose", "laser", "voltage_v", "stamp_ns"];
const HEADER: &str = "file,pose,laser,voltage_v,stamp_ns";
/// Some million rows.
const LIMIT: u64 = 256 << 20;

/// The rows of the file, with warnings about what is odd in them. Columns may come in any order.
pub(crate) fn read(path: &Path, kind: Kind) -> Result<(Vec<FrameRecord>, Vec<Problem>), Error> {
    let text = text::read(path, LIMIT)?;
    let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(text.as_bytes());
    let mut warnings = Vec::new();
    let header = reader.headers().map_err(|e| csv_error(path, &e))?.clone();
    let columns = columns(path, &header, &mut warnings)?;
    let mut rows = Rows { path, text: &text, kind, columns, frames: Vec::new(), lines: HashMap::new() };
    let mut odd = Odd::default();
    let mut record = StringRecord::new();
    while reader.read_record(&mut record).map_err(|e| csv_error(path, &e))? {
        // Spreadsheets leave lines of commas behind.
        if record.iter().all(str::is_empty) {
            continue;
        }
        rows.push(&record, header.len(), &mut odd)?;
    }
    if rows.frames.is_empty() {
        return Err(Error::content(
            Place::file(path),
            "names no image",
            "add one row an image below the header",
        ));
    }
    warnings.extend(odd.warnings(path));
    Ok((rows.frames, warnings))
}

/// Where each of [`COLUMNS`] is in a row.
fn columns(path: &Path, header: &StringRecord, warnings: &mut Vec<Problem>) -> Result<[usize; 5], Error> {
    let place = Place::line(path, 1);
    if header.iter().all(str::is_empty) {
        return Err(Error::content(place, "is empty", format!("begin it with the line: {HEADER}")));
    }
    let mut found = [None; 5];
    for (at, name) in header.iter().enumerate() {
        match COLUMNS.iter().position(|c| c.eq_ignore_ascii_case(name)) {
            Some(c) if found[c].replace(at).is_some() => {
                return Err(Error::content(
                    place.key(name),
                    "stands twice in the header",
                    "remove one of the columns",
                ));
            }
            Some(_) => {}
            None => {
                let mend = match text::nearest(name, COLUMNS) {
                    Some(known) => format!("did you mean {known}?"),
                    None => "it is ignored".into(),
                };
                warnings.push(Problem::warning(place.clone().key(name), "is an unknown column", mend));
            }
        }
    }
    if let Some(missing) = COLUMNS.iter().zip(found).find_map(|(name, at)| at.is_none().then_some(name)) {
        let line: Vec<&str> = header.iter().collect();
        let line = line.join(",");
        let mend = if line.contains([';', '\t']) {
            format!("separate columns by commas: {HEADER}")
        } else {
            format!("the first line must be: {HEADER}")
        };
        let shown: String = line.chars().take(80).collect();
        return Err(Error::content(place, format!("the header \"{shown}\" has no column {missing}"), mend));
    }
    Ok(found.map(Option::unwrap_or_default))
}

struct Rows<'a> {
    path: &'a Path,
    text: &'a str,
    kind: Kind,
    columns: [usize; 5],
    frames: Vec<FrameRecord>,
    /// The line that named a file first.
    lines: HashMap<String, u32>,
}

impl Rows<'_> {
    fn push(&mut self, record: &StringRecord, width: usize, odd: &mut Odd) -> Result<(), Error> {
        let line = record.position().map_or(0, |p| {
            // The reader's position is where the row before ended: blank lines, and half of a CRLF, come first.
            let rest = self.text.as_bytes().get(p.byte() as usize..).unwrap_or_default();
            let skipped =
                rest.iter().take_while(|b| matches!(b, b'\r' | b'\n')).filter(|b| **b == b'\n').count();
            p.line() as u32 + skipped as u32
        });
        let fail = |column: &str, what: String, mend: &str| {
            Error::content(Place::line(self.path, line).key(column), what, mend)
        };
        if record.len() != width {
            let what = format!("has {} fields, the header {width}", record.len());
            let mend = format!("a row is {HEADER}; leave a field empty but keep its comma");
            return Err(Error::content(Place::line(self.path, line), what, mend));
        }
        let [file, pose, laser, voltage, stamp] = self.columns.map(|at| record.get(at).unwrap_or_default());

        if let Some(what) = escapes(file) {
            return Err(fail(
                "file",
                format!("\"{file}\" {what}"),
                "name a file in the capture folder, relative to it",
            ));
        }
        // "a/./b" and "a/b" are one file.
        let normal: String =
            Path::new(file).components().map(|c| format!("/{}", c.as_os_str().display())).collect();
        if let Some(first) = self.lines.insert(normal, line) {
            let what = format!("\"{file}\" stands on line {first} already");
            return Err(fail("file", what, "remove one of the two rows: an image was exposed once"));
        }
        let laser_on = match laser.to_ascii_lowercase().as_str() {
            "on" => true,
            "off" => false,
            _ => return Err(fail("laser", format!("\"{laser}\" is neither on nor off"), "write on or off")),
        };
        let pose = match (self.kind, pose) {
            (Kind::Calibration, "") => {
                let what = "a calibration's image needs the number of its placement".into();
                return Err(fail("pose", what, "number the placements of the target 0, 1, …"));
            }
            (Kind::Calibration, _) => Some(pose.parse().map_err(|_| {
                fail("pose", format!("\"{pose}\" is no whole number from 0"), "number the placements 0, 1, …")
            })?),
            (Kind::Scan, "") => None,
            (Kind::Scan, _) => {
                odd.pose.note(line);
                None
            }
        };
        let voltage_v = match (laser_on, voltage) {
            (true, "") => {
                let what = "is missing, but the laser is on".into();
                return Err(fail(
                    "voltage_v",
                    what,
                    "give the galvanometer's voltage when the image was exposed",
                ));
            }
            (_, "") => None,
            _ => {
                let value: Option<f64> = voltage.parse().ok().filter(|v: &f64| v.is_finite());
                let value = value.ok_or_else(|| {
                    fail("voltage_v", format!("\"{voltage}\" is no voltage"), "write a number, such as -1.25")
                })?;
                if !laser_on {
                    odd.voltage.note(line);
                }
                laser_on.then_some(value)
            }
        };
        let stamp_ns = stamp.parse().map_err(|_| {
            let mend = "write whole nanoseconds since 1970; where none were recorded, count up by the frame's period";
            fail("stamp_ns", format!("\"{stamp}\" is no time"), mend)
        })?;
        if self.frames.last().is_some_and(|last: &FrameRecord| last.stamp_ns > stamp_ns) {
            odd.stamp.note(line);
        }
        let row = self.frames.len();
        self.frames.push(FrameRecord {
            row,
            line,
            file: file.to_owned(),
            pose,
            laser_on,
            voltage_v,
            stamp_ns,
        });
        Ok(())
    }
}

/// Why a path may not be followed; `None` where it stays below the capture folder.
pub(crate) fn escapes(file: &str) -> Option<&'static str> {
    // A drive's letter and a backslash are an absolute path to the system that wrote them, whichever reads it.
    let drive = matches!(file.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    let mut names = 0;
    for component in Path::new(file).components() {
        match component {
            Component::Normal(_) => names += 1,
            Component::CurDir => {}
            Component::ParentDir => return Some("leads out of the capture folder"),
            Component::RootDir | Component::Prefix(_) => return Some("is an absolute path"),
        }
    }
    if drive || file.starts_with('\\') {
        Some("is an absolute path")
    } else if file.split('\\').any(|part| part == "..") {
        Some("leads out of the capture folder")
    } else if names == 0 {
        Some("names no image")
    } else if file.contains('\0') {
        Some("has a character that no file's name has")
    } else {
        None
    }
}

/// Oddities that are told once, with the line of the first and their number.
#[derive(Default)]
struct Odd {
    pose: Tally,
    voltage: Tally,
    stamp: Tally,
}

#[derive(Default)]
struct Tally {
    first: u32,
    count: usize,
}

impl Tally {
    fn note(&mut self, line: u32) {
        if self.count == 0 {
            self.first = line;
        }
        self.count += 1;
    }
}

impl Odd {
    fn warnings(&self, path: &Path) -> impl Iterator<Item = Problem> {
        [
            (&self.pose, "pose", "a scan has no poses: it is ignored", "leave it empty"),
            (&self.voltage, "voltage_v", "is given though the laser is off: it is ignored", "leave it empty"),
            (
                &self.stamp,
                "stamp_ns",
                "is earlier than the row before",
                "check the order of the rows, and the clock",
            ),
        ]
        .into_iter()
        .filter(|(tally, ..)| tally.count > 0)
        .map(|(tally, key, what, mend)| {
            let what = format!("{what} ({} rows, of which this is the first)", tally.count);
            Problem::warning(Place::line(path, tally.first).key(key), what, mend)
        })
    }
}

fn csv_error(path: &Path, e: &csv::Error) -> Error {
    let place = e.position().map_or_else(|| Place::file(path), |p| Place::line(path, p.line() as u32));
    Error::content(place, format!("is no table of comma-separated values: {e}"), format!("rows are {HEADER}"))
}
