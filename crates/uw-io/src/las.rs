//! LAS and LAZ (ASPRS, version 1.4), surveyors' formats, by the crates `las` and `laz`: our clouds out, anybody's in.
//!
//! Coordinates are metres there, in steps of a micrometre. Intensity is a whole number of 16 bits. All else goes into extra bytes that describe
//! themselves, under the names and in the units of [`crate::ply::write`].

use std::{io::Cursor, path::Path};

use las::{Builder, Color, Point, Reader, Transform, Vector, Vlr, Writer, point::Format};
use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Column, Gather},
    error::{Error, Place, Problem},
};

const MM_PER_M: f64 = 1000.0;
/// Steps of the stored coordinates: a thousandth of a millimetre, so that 2³¹ of them reach 2 km.
const STEP_M: f64 = 1e-6;
/// The record that describes extra bytes (LAS 1.4 R15, table 24 and following): who defines it, its number, and the size of a description.
const DEFINED_BY: &str = "LASF_Spec";
const EXTRA_BYTES: u16 = 4;
const DESCRIPTION: usize = 192;

/// Writes a cloud, compressed (LAZ) or not. Its frame is named in the file's system identifier. The file is put together in memory.
///
/// # Errors
/// As [`atomic::write`]; a cloud that is larger than 2 km does not fit.
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, compressed: bool) -> Result<(), Error> {
    let bytes = encoded(cloud, compressed).map_err(|e| {
        let what = format!("the cloud does not fit into a LAS file: {e}");
        Error::content(Place::file(path), what, "crop it, or write another format")
    })?;
    atomic::write(path, overwrite, |w| w.write_all(&bytes))
}

/// What is stored in extra bytes: all but positions, intensity and colours.
fn is_extra(name: &str) -> bool {
    !matches!(name, "x" | "y" | "z" | "intensity" | "red" | "green" | "blue")
}

fn encoded(cloud: &PointCloud, compressed: bool) -> las::Result<Vec<u8>> {
    let extra: Vec<(&str, Column<'_>)> =
        columns::of(cloud).into_iter().filter(|(name, _)| is_extra(name)).collect();
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(if cloud.colors().is_some() { 2 } else { 0 })?;
    builder.point_format.extra_bytes = 4 * extra.len() as u16;
    builder.point_format.is_compressed = compressed;
    builder.generating_software = format!("uwscan {}", env!("CARGO_PKG_VERSION"));
    builder.system_identifier = format!("frame {}", cloud.frame().name());
    let (low, high) = cloud.bounding_box_mm().unwrap_or_default();
    // Whole metres keep the coordinates' digits.
    let offset: [f64; 3] = std::array::from_fn(|k| ((low[k] + high[k]) / 2.0 / MM_PER_M).round());
    let step = |k: usize| Transform { scale: STEP_M, offset: offset[k] };
    builder.transforms = Vector { x: step(0), y: step(1), z: step(2) };
    if !extra.is_empty() {
        builder.vlrs.push(Vlr {
            user_id: DEFINED_BY.to_owned(),
            record_id: EXTRA_BYTES,
            description: "extra bytes".to_owned(),
            data: extra.iter().flat_map(|(name, column)| description(name, column)).collect(),
        });
    }
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header()?)?;
    for (i, position) in cloud.positions_mm().iter().enumerate() {
        let [x, y, z] = position.map(|c| c / MM_PER_M);
        let mut point = Point { x, y, z, return_number: 1, number_of_returns: 1, ..Point::default() };
        if let Some(values) = cloud.intensities() {
            point.intensity = values[i].round() as u16;
        }
        // Eight bits become sixteen, as the format wants it.
        let color = |[r, g, b]: [u8; 3]| {
            let [red, green, blue] = [r, g, b].map(|c| u16::from(c) * 257);
            Color { red, green, blue }
        };
        point.color = cloud.colors().map(|colors| color(colors[i]));
        extra.iter().for_each(|(_, column)| column.append_le(i, &mut point.extra_bytes));
        writer.write_point(point)?;
    }
    writer.close()?;
    Ok(writer.into_inner()?.into_inner())
}

/// The description of a column of extra bytes: two bytes reserved, type, options, name, … and at the end a text.
fn description(name: &str, column: &Column<'_>) -> Vec<u8> {
    const UNSIGNED_LONG: u8 = 5;
    const FLOAT: u8 = 9;
    let mut bytes = vec![0; DESCRIPTION];
    bytes[2] = if matches!(column, Column::Int(_)) { UNSIGNED_LONG } else { FLOAT };
    bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
    bytes
}

/// A column of extra bytes that is read.
struct Extra {
    name: String,
    at: usize,
    kind: u8,
}

/// Bytes of each type of extra bytes; `None` for those that are not read (arrays, reserved).
fn width(kind: u8) -> Option<usize> {
    match kind {
        1 | 2 => Some(1),
        3 | 4 => Some(2),
        5 | 6 | 9 => Some(4),
        7 | 8 | 10 => Some(8),
        _ => None,
    }
}

fn extras(vlrs: &[Vlr]) -> Vec<Extra> {
    let described = vlrs.iter().find(|vlr| vlr.user_id == DEFINED_BY && vlr.record_id == EXTRA_BYTES);
    let mut found = Vec::new();
    let mut at = 0;
    for bytes in described.iter().flat_map(|vlr| vlr.data.chunks_exact(DESCRIPTION)) {
        let (kind, name) = (bytes[2], &bytes[4..36]);
        let end = name.iter().position(|b| *b == 0).unwrap_or(name.len());
        let name = String::from_utf8_lossy(&name[..end]).to_ascii_lowercase();
        // Of scaled ones, and where it is not known how long they are, what follows is not read.
        let Some(width) = width(kind).filter(|_| bytes[3] & 0b1_1000 == 0) else { break };
        found.push(Extra { name, at, kind });
        at += width;
    }
    found
}

impl Extra {
    fn value(&self, bytes: &[u8]) -> Option<f64> {
        let own = bytes.get(self.at..self.at + width(self.kind)?)?;
        let mut eight = [0_u8; 8];
        eight[..own.len()].copy_from_slice(own);
        let whole = u64::from_le_bytes(eight);
        let shift = 64 - 8 * own.len();
        Some(match self.kind {
            9 => f64::from(f32::from_bits(whole as u32)),
            10 => f64::from_bits(whole),
            2 | 4 | 6 | 8 => ((whole << shift) as i64 >> shift) as f64,
            _ => whole as f64,
        })
    }
}

/// The cloud of a LAS or LAZ file, metres taken as its unit, points marked as withheld left out.
///
/// # Errors
/// [`Error`] where the file cannot be read, or is no LAS.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let failed = |e: las::Error| {
        Error::content(Place::file(path), format!("is no sound LAS: {e}"), "copy it again, or write it anew")
    };
    // Tells a missing file in our words.
    drop(std::fs::File::open(path).map_err(Error::file(path, "open"))?);
    let mut reader = Reader::from_path(path).map_err(failed)?;
    let extras = extras(reader.header().vlrs());
    let color = reader.header().point_format().has_color;
    let mut names = vec!["x", "y", "z", "intensity"];
    names.extend(if color { &["red", "green", "blue"][..] } else { &[] });
    names.extend(extras.iter().map(|extra| extra.name.as_str()));
    let count = reader.header().number_of_points();
    let frame = reader.header().system_identifier().strip_prefix("frame ").map(str::to_owned);
    let mut gather = Gather::new(path, &names, count.min(1 << 20) as usize)?;
    let mut row = Vec::new();
    let mut done = 0;
    while done < count {
        let points = reader.read_points((count - done).min(1 << 16)).map_err(failed)?;
        let before = done;
        for point in points.points() {
            let point = point.map_err(failed)?;
            done += 1;
            if point.is_withheld {
                continue;
            }
            row.clear();
            row.extend([point.x, point.y, point.z].map(|c| c * MM_PER_M));
            row.push(f64::from(point.intensity));
            if color {
                let own = point.color.unwrap_or(Color { red: 0, green: 0, blue: 0 });
                // Many writers store eight bits as they are.
                let most = own.red.max(own.green).max(own.blue);
                let by = if most > 255 { 257 } else { 1 };
                row.extend([own.red, own.green, own.blue].map(|c| f64::from(c / by)));
            }
            row.extend(extras.iter().map(|extra| extra.value(&point.extra_bytes).unwrap_or(0.0)));
            gather.push(&row).map_err(|what| {
                let place = Place::file(path).key(&format!("point {}", done - 1));
                Error::content(place, what, "mend the point, or take it out")
            })?;
        }
        if done == before {
            let what = format!("ends after {done} of {count} points");
            return Err(Error::content(Place::file(path), what, "the file is torn: copy it again"));
        }
    }
    gather.finish(frame.as_deref(), Some("mm"))
}
