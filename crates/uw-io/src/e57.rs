//! E57 (ASTM E2807), surveyors' exchange format: our clouds out, anybody's in. The crate `e57` reads and writes the container.
//!
//! Coordinates are metres there. What the format has no attribute for goes into an extension of our namespace, under the names and in the
//! units of [`crate::ply::write`]. A sweep's images and lines are its columns and rows.

use std::{
    fs::File,
    io::{BufReader, Cursor},
    path::Path,
};

use e57::{
    CartesianCoordinate, E57Reader, E57Writer, Extension, PointCloud as Part, Record, RecordDataType,
    RecordName, RecordValue,
};
use sha2::{Digest, Sha256};
use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Column, Gather},
    error::{Error, Place, Problem},
};

const MM_PER_M: f64 = 1000.0;
/// The extension's namespace and what it is told by.
const NAMESPACE: &str = "uwscan";
const URL: &str = "https://github.com/uwscan/uwscan";

/// Writes a cloud as one part, whose description names the frame. The file is put together in memory.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud) -> Result<(), Error> {
    let bytes = encoded(cloud).map_err(|e| {
        Error::content(Place::file(path), format!("cannot be put together: {e}"), "report this as a fault")
    })?;
    atomic::write(path, overwrite, |w| w.write_all(&bytes))
}

fn encoded(cloud: &PointCloud) -> e57::Result<Vec<u8>> {
    let columns = columns::of(cloud);
    let mut hash = Sha256::new();
    cloud.positions_mm().iter().flatten().for_each(|c| hash.update(c.to_le_bytes()));
    let hash: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let guid = |n: usize| {
        format!(
            "{{{}-{}-{}-{}-{}{n}}}",
            &hash[..8],
            &hash[8..12],
            &hash[12..16],
            &hash[16..20],
            &hash[20..31]
        )
    };
    let mut bytes = Cursor::new(Vec::new());
    let mut file = E57Writer::new(&mut bytes, &guid(0))?;
    file.register_extension(Extension::new(NAMESPACE, URL))?;
    let prototype = columns.iter().map(|(name, column)| record(name, column)).collect();
    let mut part = file.add_pointcloud(&guid(1), prototype)?;
    part.set_description(Some(format!("frame {}", cloud.frame().name())));
    for point in 0..cloud.len() {
        part.add_point(columns.iter().map(|(_, column)| value(column, point)).collect())?;
    }
    part.finalize()?;
    file.finalize()?;
    drop(file);
    Ok(bytes.into_inner())
}

fn record(name: &str, column: &Column<'_>) -> Record {
    let known = match name {
        "x" => RecordName::CartesianX,
        "y" => RecordName::CartesianY,
        "z" => RecordName::CartesianZ,
        "intensity" => RecordName::Intensity,
        "red" => RecordName::ColorRed,
        "green" => RecordName::ColorGreen,
        "blue" => RecordName::ColorBlue,
        other => RecordName::Unknown { namespace: NAMESPACE.to_owned(), name: other.to_owned() },
    };
    let data_type = match column {
        Column::Double(..) => RecordDataType::Double { min: None, max: None },
        Column::Float(_) => RecordDataType::Single { min: None, max: None },
        Column::Int(_) => RecordDataType::Integer { min: 0, max: i64::from(u32::MAX) },
        Column::Byte(..) => RecordDataType::Integer { min: 0, max: 255 },
    };
    Record { name: known, data_type }
}

fn value(column: &Column<'_>, point: usize) -> RecordValue {
    match column {
        Column::Double(v, at) => RecordValue::Double(v[point][*at] / MM_PER_M),
        Column::Float(v) => RecordValue::Single(v(point)),
        Column::Int(v) => RecordValue::Integer(i64::from(v[point])),
        Column::Byte(v, at) => RecordValue::Integer(i64::from(v[point][*at])),
    }
}

/// The cloud of all parts of an E57 file, each moved by its pose, invalid points left out, with warnings about what had to be assumed.
///
/// # Errors
/// [`Error`] where the file cannot be read, is no E57, or holds no points.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let failed = |e: e57::Error| {
        Error::content(Place::file(path), format!("is no sound E57: {e}"), "copy it again, or write it anew")
    };
    let open = || -> Result<E57Reader<BufReader<File>>, Error> {
        let file = File::open(path).map_err(Error::file(path, "open"))?;
        E57Reader::new(BufReader::new(file)).map_err(failed)
    };
    let (mut file, mut again) = (open()?, open()?);
    let parts = file.pointclouds();
    let sound = |part: &&Part| part.records > 0;
    let Some(first) = parts.iter().find(sound) else {
        return Err(Error::content(Place::file(path), "holds no points", "give an E57 with points"));
    };
    // Only what every part has can be told of all points.
    let own = |part: &Part| -> Vec<(usize, String)> {
        let named = part.prototype.iter().enumerate().filter_map(|(at, record)| match &record.name {
            RecordName::Unknown { namespace, name } if namespace == NAMESPACE => Some((at, name.clone())),
            _ => None,
        });
        named.collect()
    };
    let everywhere = |has: &dyn Fn(&Part) -> bool| parts.iter().filter(sound).all(has);
    let extra: Vec<String> = own(first)
        .into_iter()
        .map(|(_, name)| name)
        .filter(|name| everywhere(&|part| own(part).iter().any(|(_, other)| other == name)))
        .collect();
    let intensity = everywhere(&Part::has_intensity);
    let color = everywhere(&Part::has_color);
    let mut names = vec!["x", "y", "z"];
    names.extend(intensity.then_some("intensity"));
    names.extend(if color { &["red", "green", "blue"][..] } else { &[] });
    names.extend(extra.iter().map(String::as_str));
    let expected: u64 = parts.iter().map(|part| part.records).sum();
    let mut gather = Gather::new(path, &names, expected.min(1 << 20) as usize)?;
    let mut row = Vec::new();
    for part in parts.iter().filter(sound) {
        let own = own(part);
        let at: Vec<usize> = extra
            .iter()
            .filter_map(|name| own.iter().find(|(_, other)| other == name).map(|(at, _)| *at))
            .collect();
        let mut simple = file.pointcloud_simple(part).map_err(failed)?;
        simple.normalize_intensity(false);
        simple.normalize_color(false);
        let raw = again.pointcloud_raw(part).map_err(failed)?;
        for (point, (seen, values)) in simple.zip(raw).enumerate() {
            let (seen, values) = (seen.map_err(failed)?, values.map_err(failed)?);
            let CartesianCoordinate::Valid { x, y, z } = seen.cartesian else { continue };
            row.clear();
            row.extend([x, y, z].map(|c| c * MM_PER_M));
            if intensity {
                row.push(f64::from(seen.intensity.unwrap_or(0.0)));
            }
            if color {
                let color = seen.color.map_or([0.0; 3], |c| [c.red, c.green, c.blue].map(f64::from));
                row.extend(color);
            }
            for &at in &at {
                row.push(values[at].to_f64(&part.prototype[at].data_type).map_err(failed)?);
            }
            gather.push(&row).map_err(|what| {
                let place = Place::file(path).key(&format!("point {point}"));
                Error::content(place, what, "mend the point, or take it out")
            })?;
        }
    }
    let frame = first.description.as_deref().and_then(|text| text.strip_prefix("frame "));
    gather.finish(frame, Some("mm"))
}
