//! Wavefront OBJ: vertices and faces as text.

use std::{fs::File, io::BufReader, path::Path};

use uw_cloud::TriangleMesh;

use crate::{
    atomic::{self, Overwrite},
    error::{Error, Place, Problem},
    meshes::{Polygons, frame_and_unit},
    text,
};

/// A line, or a face's with thousands of corners.
const LONGEST_LINE: u64 = 1 << 20;

/// Writes a mesh: `v`, `vn` where it has normals, and `f`; the frame and the unit in comments. Numbers read back as they were.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, mesh: &TriangleMesh) -> Result<(), Error> {
    atomic::write(path, overwrite, |w| {
        writeln!(w, "# uwscan {}\n# frame {}\n# unit mm", env!("CARGO_PKG_VERSION"), mesh.frame().name())?;
        for [x, y, z] in mesh.vertices_mm() {
            writeln!(w, "v {x:?} {y:?} {z:?}")?;
        }
        for [x, y, z] in mesh.normals().unwrap_or_default() {
            writeln!(w, "vn {x:?} {y:?} {z:?}")?;
        }
        for t in mesh.triangles() {
            let [a, b, c] = t.map(|v| v + 1);
            match mesh.normals() {
                Some(_) => writeln!(w, "f {a}//{a} {b}//{b} {c}//{c}")?,
                None => writeln!(w, "f {a} {b} {c}")?,
            }
        }
        Ok(())
    })
}

/// The mesh of an OBJ, polygons cut into triangles; of groups, materials and textures nothing. Without the comments `# frame` and
/// `# unit`, the camera's frame and millimetres are meant.
///
/// # Errors
/// [`Error`] where the file cannot be read, a line is not what it begins as, a face names a vertex that is not there, or
/// there are no faces.
pub fn read(path: &Path) -> Result<(TriangleMesh, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let mut source = BufReader::with_capacity(1 << 18, file);
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut polygons = Polygons::default();
    let (mut faces, mut frame, mut unit) = (0, None, None);
    let mut bytes = Vec::new();
    for at in 1_u32.. {
        if !text::next_line(&mut source, path, LONGEST_LINE, &mut bytes)? {
            break;
        }
        let fail = |what: String| {
            Err(Error::content(Place::line(path, at), what, "check that this is a whole OBJ file"))
        };
        if bytes.len() as u64 == LONGEST_LINE {
            return fail(format!("is longer than {LONGEST_LINE} bytes"));
        }
        let text = String::from_utf8_lossy(&bytes);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["#", "frame", name] => frame = Some((*name).to_owned()),
            ["#", "unit", name] => unit = Some((*name).to_owned()),
            ["v", x, y, z, ..] => {
                let [Ok(x), Ok(y), Ok(z)] = [x, y, z].map(|c| c.parse::<f64>()) else {
                    return fail("is a vertex without three numbers".to_owned());
                };
                if ![x, y, z].iter().all(|c| c.is_finite()) {
                    return fail("has a coordinate that is not a finite number".to_owned());
                }
                vertices.push([x, y, z]);
            }
            ["f", corners @ ..] => {
                let number = |corner: &&str| {
                    let number: i64 = corner.split('/').next()?.parse().ok()?;
                    // From 1, or from the last one backwards.
                    let from_0 = if number < 0 { vertices.len() as i64 + number } else { number - 1 };
                    (0..vertices.len() as i64).contains(&from_0).then_some(from_0 as f64)
                };
                let numbers: Option<Vec<f64>> = corners.iter().map(number).collect();
                let Some(numbers) = numbers else {
                    return fail(format!(
                        "is a face of vertices that are not among the {} before it",
                        vertices.len()
                    ));
                };
                if let Err(what) = polygons.push(numbers.into_iter()) {
                    return fail(what);
                }
                faces += 1;
            }
            ["v", ..] => return fail("is a vertex without three numbers".to_owned()),
            _ => {}
        }
    }
    if faces == 0 {
        return Err(Error::content(Place::file(path), "holds no faces", "give a mesh"));
    }
    let (frame, problems) = frame_and_unit(path, frame.as_deref(), unit.as_deref())?;
    Ok((polygons.mesh(path, frame, vertices)?, problems))
}
