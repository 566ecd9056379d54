//! STL: bare triangles, binary or text.

use std::{
    collections::HashMap,
    fs::File,
    io::{BufRead, BufReader, Read},
    path::Path,
};

use uw_cloud::{Frame, TriangleMesh};

use crate::{
    atomic::{self, Overwrite},
    error::{Error, Place, Problem},
    ply::Encoding,
};

/// Bytes before the triangles of a binary file: a text of any kind and their number.
const HEADER: usize = 84;
/// Bytes of a triangle: normal, three corners, an attribute.
const TRIANGLE: usize = 50;
/// No line of an STL is longer.
const LONGEST_LINE: u64 = 4096;

/// Writes a mesh's triangles, mm: positions as floats of four bytes, as the format has them.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(
    path: &Path,
    overwrite: Overwrite,
    mesh: &TriangleMesh,
    encoding: Encoding,
) -> Result<(), Error> {
    let corners = |t: &[u32; 3]| t.map(|v| mesh.vertices_mm()[v as usize]);
    let title = format!("uwscan {} unit mm frame {}", env!("CARGO_PKG_VERSION"), mesh.frame().name());
    atomic::write(path, overwrite, |w| match encoding {
        Encoding::Binary => {
            let mut header = [b' '; 80];
            let length = title.len().min(80);
            header[..length].copy_from_slice(&title.as_bytes()[..length]);
            w.write_all(&header)?;
            w.write_all(&(mesh.triangles().len() as u32).to_le_bytes())?;
            let mut row = Vec::with_capacity(TRIANGLE);
            for t in mesh.triangles() {
                row.clear();
                let corners = corners(t);
                let normal = unit_normal(corners);
                for value in std::iter::once(normal).chain(corners).flatten() {
                    row.extend((value as f32).to_le_bytes());
                }
                row.extend([0, 0]);
                w.write_all(&row)?;
            }
            Ok(())
        }
        Encoding::Ascii => {
            writeln!(w, "solid {title}")?;
            for t in mesh.triangles() {
                let corners = corners(t);
                let [x, y, z] = unit_normal(corners).map(|c| c as f32);
                writeln!(w, "facet normal {x:?} {y:?} {z:?}\nouter loop")?;
                for [x, y, z] in corners.map(|corner| corner.map(|c| c as f32)) {
                    writeln!(w, "vertex {x:?} {y:?} {z:?}")?;
                }
                writeln!(w, "endloop\nendfacet")?;
            }
            writeln!(w, "endsolid")
        }
    })
}

/// The normal that the order of corners gives; nil for a triangle without an area.
fn unit_normal([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let (u, v): ([f64; 3], [f64; 3]) =
        (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
    let across = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = across.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 { across.map(|c| c / length) } else { [0.0; 3] }
}

/// The mesh of an STL, corners at the same place made one vertex. Millimetres and the camera's frame are meant, as STL names
/// neither; the order of corners tells the outside, stored normals are not looked at.
///
/// # Errors
/// [`Error`] where the file cannot be read, is neither kind of STL, ends early, or holds a position that is no finite number.
pub fn read(path: &Path) -> Result<(TriangleMesh, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let size = file.metadata().map_err(Error::file(path, "open"))?.len();
    let mut source = BufReader::with_capacity(1 << 18, file);
    let mut start = Vec::with_capacity(HEADER);
    source.by_ref().take(HEADER as u64).read_to_end(&mut start).map_err(Error::file(path, "read"))?;
    let count = start.get(80..).and_then(|n| Some(u32::from_le_bytes(n.try_into().ok()?)));
    // Many a binary file begins with "solid", too: the size tells.
    let binary = count.filter(|&n| size == HEADER as u64 + u64::from(n) * TRIANGLE as u64);
    let mut welded = Welded::default();
    match binary {
        Some(count) => read_binary(path, &mut source, count, &mut welded)?,
        None if start.starts_with(b"solid") => read_text(path, start.as_slice().chain(source), &mut welded)?,
        None => {
            let what = match count {
                Some(count) => format!(
                    "is {size} bytes long, but an STL of the {count} triangles that it tells of has {}",
                    HEADER as u64 + u64::from(count) * TRIANGLE as u64
                ),
                None => "is too short for an STL".to_owned(),
            };
            return Err(Error::content(Place::file(path), what, "the file is torn or no STL: copy it again"));
        }
    }
    if welded.triangles.is_empty() {
        return Err(Error::content(Place::file(path), "holds no triangles", "give a mesh"));
    }
    let failed =
        |e: uw_cloud::MeshError| Error::content(Place::file(path), e.to_string(), "write the file anew");
    let mesh = TriangleMesh::new(Frame::Camera, welded.vertices, welded.triangles).map_err(failed)?;
    Ok((mesh, Vec::new()))
}

fn read_binary(path: &Path, source: &mut impl Read, count: u32, welded: &mut Welded) -> Result<(), Error> {
    let mut bytes = [0; TRIANGLE];
    for at in 0..count {
        source.read_exact(&mut bytes).map_err(Error::file(path, "read"))?;
        let float = |k: usize| f32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
        let corner = |i: usize| [0, 4, 8].map(|k| f64::from(float(12 + 12 * i + k)));
        let place = || Place::file(path).key(&format!("triangle {at}"));
        welded.push([corner(0), corner(1), corner(2)], place)?;
    }
    Ok(())
}

fn read_text(path: &Path, mut source: impl BufRead, welded: &mut Welded) -> Result<(), Error> {
    let mut corners = Vec::with_capacity(3);
    let mut line = Vec::new();
    let mut ended = false;
    for at in 1_u32.. {
        line.clear();
        source.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line).map_err(Error::file(path, "read"))?;
        if line.is_empty() {
            break;
        }
        let fail = |what: &str| {
            Err(Error::content(Place::line(path, at), what, "check that this is a whole STL file"))
        };
        let Ok(text) = std::str::from_utf8(&line) else { return fail("is no text") };
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["vertex", x, y, z] => {
                let [Ok(x), Ok(y), Ok(z)] = [x, y, z].map(|c| c.parse::<f64>()) else {
                    return fail("is a vertex without three numbers");
                };
                corners.push([x, y, z]);
            }
            ["vertex", ..] => return fail("is a vertex without three numbers"),
            ["endloop" | "endfacet"] => {
                if let [a, b, c] = corners[..] {
                    welded.push([a, b, c], || Place::line(path, at))?;
                } else if !corners.is_empty() {
                    return fail("ends a facet that has not three vertices");
                }
                corners.clear();
            }
            ["endsolid", ..] => ended = true,
            [] | ["solid" | "facet" | "outer", ..] => {}
            _ => return fail("is no line of an STL"),
        }
    }
    if ended && corners.is_empty() {
        return Ok(());
    }
    Err(Error::content(Place::file(path), "does not end with endsolid", "the file is torn: copy it again"))
}

/// Triangles whose corners become one vertex where they have the same position to the bit.
#[derive(Default)]
struct Welded {
    numbers: HashMap<[u64; 3], u32>,
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Welded {
    fn push(&mut self, corners: [[f64; 3]; 3], place: impl Fn() -> Place) -> Result<(), Error> {
        if let Some(value) = corners.iter().flatten().find(|v| !v.is_finite()) {
            let what = format!("a coordinate is {value}, not a finite number");
            return Err(Error::content(place(), what, "write the file anew"));
        }
        let triangle = corners.map(|corner| {
            // -0 and 0 are one place.
            let key = corner.map(|c| (c + 0.0).to_bits());
            let next = self.vertices.len() as u32;
            *self.numbers.entry(key).or_insert_with(|| {
                self.vertices.push(corner);
                next
            })
        });
        let [a, b, c] = triangle;
        // Corners that fell together in rounding make no triangle.
        if a != b && b != c && c != a {
            self.triangles.push(triangle);
        }
        Ok(())
    }
}
