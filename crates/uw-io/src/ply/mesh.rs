//! Meshes as PLY.

use std::{
    fs::File,
    io::{BufReader, Write},
    path::Path,
};

use uw_cloud::TriangleMesh;

use super::{Encoding, body::Rows, header::Header};
use crate::{
    atomic::{self, Overwrite},
    error::{Error, Place, Problem},
    meshes::{Polygons, frame_and_unit},
};

/// Writes a mesh: vertices `x y z` (double, mm), then as far as the mesh has them `nx ny nz`, `sigma` (mm), `intensity` and
/// `deviation` (mm), all float, `red green blue` (uchar), and faces `vertex_indices`; the frame and the unit in comments of the header.
///
/// # Errors
/// As [`atomic::write`].
pub fn write_mesh(
    path: &Path,
    overwrite: Overwrite,
    mesh: &TriangleMesh,
    encoding: Encoding,
) -> Result<(), Error> {
    let singles: Vec<(&str, &[f32])> =
        [("sigma", mesh.sigmas_mm()), ("intensity", mesh.intensities()), ("deviation", mesh.deviations_mm())]
            .into_iter()
            .filter_map(|(name, values)| Some((name, values?)))
            .collect();
    let (format, ascii) = match encoding {
        Encoding::Binary => ("binary_little_endian", false),
        Encoding::Ascii => ("ascii", true),
    };
    atomic::write(path, overwrite, |w| {
        let frame = mesh.frame().name();
        writeln!(w, "ply\nformat {format} 1.0\ncomment uwscan {}", env!("CARGO_PKG_VERSION"))?;
        writeln!(w, "comment frame {frame}\ncomment unit mm\nelement vertex {}", mesh.vertices_mm().len())?;
        writeln!(w, "property double x\nproperty double y\nproperty double z")?;
        if mesh.normals().is_some() {
            writeln!(w, "property float nx\nproperty float ny\nproperty float nz")?;
        }
        singles.iter().try_for_each(|(name, _)| writeln!(w, "property float {name}"))?;
        if mesh.colors().is_some() {
            writeln!(w, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        }
        writeln!(
            w,
            "element face {}\nproperty list uchar int vertex_indices\nend_header",
            mesh.triangles().len()
        )?;
        let mut row = Vec::new();
        for (at, position) in mesh.vertices_mm().iter().enumerate() {
            row.clear();
            let normal = mesh.normals().map(|normals| normals[at]);
            let color = mesh.colors().map(|colors| colors[at]);
            let floats = normal.into_iter().flatten().chain(singles.iter().map(|(_, values)| values[at]));
            if ascii {
                write!(row, "{:?} {:?} {:?}", position[0], position[1], position[2])?;
                floats.into_iter().try_for_each(|value| write!(row, " {value:?}"))?;
                color.into_iter().flatten().try_for_each(|value| write!(row, " {value}"))?;
                row.push(b'\n');
            } else {
                position.iter().for_each(|c| row.extend(c.to_le_bytes()));
                floats.into_iter().for_each(|value| row.extend(value.to_le_bytes()));
                row.extend(color.into_iter().flatten());
            }
            w.write_all(&row)?;
        }
        for [a, b, c] in mesh.triangles() {
            if ascii {
                writeln!(w, "3 {a} {b} {c}")?;
            } else {
                row.clear();
                row.push(3);
                [a, b, c].iter().for_each(|v| row.extend(v.to_le_bytes()));
                w.write_all(&row)?;
            }
        }
        Ok(())
    })
}

/// The mesh of a PLY file, polygons cut into triangles, with warnings about what had to be assumed.
///
/// # Errors
/// [`Error`] where the file cannot be read, is no PLY, has no vertices with x, y and z or no faces, ends early, names a vertex that
/// it has not, or says that its unit is not the millimetre.
pub fn read_mesh(path: &Path) -> Result<(TriangleMesh, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let mut source = BufReader::with_capacity(1 << 18, file);
    let header = Header::read(path, &mut source)?;
    let mut vertices = Vertices::new(path, &header)?;
    let mut faces = Faces::new(path, &header)?;
    header.read_body(path, &mut source, &mut [("vertex", &mut vertices), ("face", &mut faces)])?;
    let (frame, problems) = frame_and_unit(path, header.comment("frame"), header.comment("unit"))?;
    let failed =
        |e: uw_cloud::MeshError| Error::content(Place::file(path), e.to_string(), "write the file anew");
    let mut mesh = faces.polygons.mesh(path, frame, vertices.positions)?;
    if let Some((_, normals)) = vertices.normals {
        mesh = mesh.with_normals(normals).map_err(failed)?;
    }
    for (_, name, values) in vertices.singles {
        mesh = match name {
            "sigma" => mesh.with_sigmas_mm(values),
            "intensity" => mesh.with_intensities(values),
            _ => mesh.with_deviations_mm(values),
        }
        .map_err(failed)?;
    }
    Ok((mesh, problems))
}

/// Whether a PLY holds faces; an error only where its header can't be read.
pub(crate) fn has_faces(path: &Path) -> Result<bool, Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    Ok(Header::read(path, &mut BufReader::new(file))?.count("face") > 0)
}

struct Vertices {
    at: [usize; 3],
    positions: Vec<[f64; 3]>,
    normals: Option<([usize; 3], Vec<[f32; 3]>)>,
    singles: Vec<(usize, &'static str, Vec<f32>)>,
}

impl Vertices {
    fn new(path: &Path, header: &Header) -> Result<Self, Error> {
        let names = header.names("vertex");
        let find = |name: &str| names.iter().position(|n| *n == name);
        let three = |[a, b, c]: [&str; 3]| Some([find(a)?, find(b)?, find(c)?]);
        let Some(at) = three(["x", "y", "z"]) else {
            let what = format!("has no vertices with x, y and z (their properties: {})", names.join(" "));
            return Err(Error::content(Place::file(path), what, "give a mesh, its columns named so"));
        };
        let singles = ["sigma", "intensity", "deviation"];
        Ok(Self {
            at,
            positions: Vec::new(),
            normals: three(["nx", "ny", "nz"]).map(|at| (at, Vec::new())),
            singles: singles.into_iter().filter_map(|name| Some((find(name)?, name, Vec::new()))).collect(),
        })
    }
}

impl Rows for Vertices {
    fn push(&mut self, row: &[f64], _: &[f64]) -> Result<(), String> {
        let position = self.at.map(|at| row[at]);
        if let Some(value) = position.into_iter().find(|v| !v.is_finite()) {
            return Err(format!("a coordinate is {value}, not a finite number"));
        }
        self.positions.push(position);
        if let Some((at, normals)) = &mut self.normals {
            normals.push(at.map(|at| row[at] as f32));
        }
        self.singles.iter_mut().for_each(|(at, _, values)| values.push(row[*at] as f32));
        Ok(())
    }
}

struct Faces {
    list: usize,
    polygons: Polygons,
}

impl Faces {
    fn new(path: &Path, header: &Header) -> Result<Self, Error> {
        let properties = header.element("face").map_or(&[][..], |face| &face.properties);
        let known = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
        match properties.iter().position(|p| p.count.is_some() && known(&p.name)) {
            Some(list) if header.count("face") > 0 => Ok(Self { list, polygons: Polygons::default() }),
            _ => {
                let what = "holds no faces with vertex_indices: it is a cloud, not a mesh";
                Err(Error::content(
                    Place::file(path),
                    what,
                    "give a mesh; `uwscan mesh` makes one of a cloud",
                ))
            }
        }
    }
}

impl Rows for Faces {
    fn list(&self) -> Option<usize> {
        Some(self.list)
    }

    fn push(&mut self, _: &[f64], corners: &[f64]) -> Result<(), String> {
        self.polygons.push(corners.iter().copied())
    }
}
