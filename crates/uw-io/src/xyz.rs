//! XYZ and CSV: points as text, for spreadsheets and everything else.

use std::{fs::File, io::BufReader, path::Path};

use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Gather},
    error::{Error, Place, Problem},
    text,
};

/// What stands between the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    /// A space: `.xyz`, its column names behind a `#`, as most readers of XYZ skip such a line.
    Space,
    /// A comma: `.csv`, its column names bare.
    Comma,
}

/// Writes a cloud as text: lines `# frame NAME` and `# unit mm`, a line of column names as in [`crate::ply::write`],
/// and one line a point. Numbers read back as they were.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(
    path: &Path,
    overwrite: Overwrite,
    cloud: &PointCloud,
    separator: Separator,
) -> Result<(), Error> {
    let columns = columns::of(cloud);
    let names: Vec<&str> = columns.iter().map(|(name, _)| *name).collect();
    atomic::write(path, overwrite, |w| {
        writeln!(w, "# frame {}\n# unit mm", cloud.frame().name())?;
        match separator {
            Separator::Space => writeln!(w, "# {}", names.join(" "))?,
            Separator::Comma => writeln!(w, "{}", names.join(","))?,
        }
        columns::write_text(w, &columns, cloud.len(), if separator == Separator::Space { b' ' } else { b',' })
    })
}

/// The longest line that is read: a file that is no text is not read as one line.
const LONGEST_LINE: u64 = 1 << 16;

/// The cloud of a text file: values between spaces, tabs, commas or semicolons; comments behind `#`. Columns are those of a
/// line of names, behind a `#` or bare; without one, the first three are x, y and z. Without the comments
/// `# frame` and `# unit`, the camera's frame and millimetres are meant.
///
/// # Errors
/// [`Error`] where the file cannot be read, holds no points, or a line is not what the first one promised.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let mut source = BufReader::with_capacity(1 << 18, file);
    let (mut frame, mut unit, mut names) = (None, None, None);
    let mut gather: Option<(Gather, usize)> = None;
    let mut bytes = Vec::new();
    let mut values = Vec::new();
    for at in 1_u32.. {
        if !text::next_line(&mut source, path, LONGEST_LINE, &mut bytes)? {
            break;
        }
        let fail = |what: String, mend: &str| Err(Error::content(Place::line(path, at), what, mend));
        if bytes.len() as u64 == LONGEST_LINE {
            return fail(
                format!("is longer than {LONGEST_LINE} bytes"),
                "give a text file of points, one a line",
            );
        }
        let Ok(line) = std::str::from_utf8(&bytes) else {
            return fail("is no text".into(), "give a text file of points");
        };
        let line = line.trim_start_matches('\u{feff}').trim();
        let (comment, line) = match line.strip_prefix('#').or_else(|| line.strip_prefix("//")) {
            Some(rest) => (true, rest.trim()),
            None => (false, line),
        };
        let words = || line.split([' ', '\t', ',', ';']).map(str::trim).filter(|w| !w.is_empty());
        let lower = || words().map(|w| w.trim_matches('"').to_ascii_lowercase()).collect::<Vec<_>>();
        let is_names =
            gather.is_none() && ["x", "y", "z"].iter().all(|name| lower().iter().any(|w| w == name));
        if is_names {
            names = Some(lower());
        } else if comment {
            match words().collect::<Vec<_>>().as_slice() {
                ["frame", name] => frame = Some((*name).to_owned()),
                ["unit", name] => unit = Some((*name).to_owned()),
                _ => {}
            }
        } else if !line.is_empty() {
            values.clear();
            for word in words() {
                match word.parse::<f64>() {
                    Ok(value) => values.push(value),
                    Err(_) if gather.is_none() && names.is_none() => {
                        let what =
                            format!("\"{word}\" is no number, and the line names no columns x, y and z");
                        return fail(what, "name the columns x, y and z, or put # before the line");
                    }
                    Err(_) => {
                        return fail(format!("\"{word}\" is no number"), "mend the line, or put # before it");
                    }
                }
            }
            let (gather, width) = match &mut gather {
                Some(started) => started,
                None => {
                    let names = names.take().unwrap_or_else(|| ["x", "y", "z"].map(String::from).to_vec());
                    let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
                    let width = values.len().max(3);
                    if names.len() <= 3 {
                        names.resize(width, "");
                    }
                    gather.insert((Gather::new(path, &names, 0)?, names.len()))
                }
            };
            if values.len() != *width {
                return fail(
                    format!("has {} values, not {width}", values.len()),
                    "each line has as many as the first",
                );
            }
            if let Err(bad) = gather.push(&values) {
                return fail(bad.to_string(), "mend the line, or put # before it");
            }
        }
    }
    match gather {
        Some((gather, _)) => gather.finish(frame.as_deref(), unit.as_deref()),
        None => Err(Error::content(Place::file(path), "holds no points", "give a text file of points")),
    }
}
