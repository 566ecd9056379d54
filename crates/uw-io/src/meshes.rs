//! Triangle meshes in the format that a file's name tells by its ending.

use std::path::Path;

use uw_cloud::{Frame, TriangleMesh};

use crate::{
    atomic::Overwrite,
    error::{Error, Place, Problem},
    glb, obj, ply, stl,
};

/// The endings that are written, as messages say them.
pub const ENDINGS: &str = ".ply, .stl, .obj or .glb";

/// A format of meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// PLY (`.ply`), written in this encoding.
    Ply(ply::Encoding),
    /// STL (`.stl`), written in this encoding: bare triangles.
    Stl(ply::Encoding),
    /// Wavefront OBJ (`.obj`), text.
    Obj,
    /// Binary glTF 2.0 (`.glb`): written in metres, as it has it; not read.
    Glb,
}

impl Format {
    /// The format that the ending of a file's name tells, upper or lower case; PLY and STL are binary.
    ///
    /// # Errors
    /// [`Error::MeshEnding`] for another ending, or none.
    pub fn of(path: &Path) -> Result<Self, Error> {
        let ending = path.extension().map(std::ffi::OsStr::to_ascii_lowercase);
        match ending.as_ref().and_then(|e| e.to_str()) {
            Some("ply") => Ok(Self::Ply(ply::Encoding::Binary)),
            Some("stl") => Ok(Self::Stl(ply::Encoding::Binary)),
            Some("obj") => Ok(Self::Obj),
            Some("glb") => Ok(Self::Glb),
            _ => Err(Error::MeshEnding { path: path.to_owned() }),
        }
    }

    /// The same format as text where it can be: PLY and STL.
    pub fn as_text(self) -> Self {
        match self {
            Self::Ply(_) => Self::Ply(ply::Encoding::Ascii),
            Self::Stl(_) => Self::Stl(ply::Encoding::Ascii),
            other @ (Self::Obj | Self::Glb) => other,
        }
    }
}

/// Whether a file is to be read as a mesh: by its name, and a PLY by whether it has faces.
///
/// # Errors
/// A PLY's header can't be read.
pub fn is_mesh(path: &Path) -> Result<bool, Error> {
    match Format::of(path) {
        Ok(Format::Ply(_)) => ply::has_faces(path),
        Ok(_) => Ok(true),
        Err(_) => Ok(false),
    }
}

/// The mesh in a file, of the format that its name tells, with warnings about what had to be assumed.
///
/// # Errors
/// [`Error::MeshEnding`], or as [`ply::read_mesh`], [`stl::read`], [`obj::read`]; GLB is not read.
pub fn read(path: &Path) -> Result<(TriangleMesh, Vec<Problem>), Error> {
    match Format::of(path)? {
        Format::Ply(_) => ply::read_mesh(path),
        Format::Stl(_) => stl::read(path),
        Format::Obj => obj::read(path),
        Format::Glb => {
            let what = "is a GLB, which is written here but not read";
            Err(Error::content(Place::file(path), what, "give the mesh as .ply, .stl or .obj"))
        }
    }
}

/// Writes a mesh in a format ([`Format::of`] tells it from the name), whole or not at all.
///
/// # Errors
/// As [`atomic::write`](crate::atomic::write()).
pub fn write(path: &Path, overwrite: Overwrite, mesh: &TriangleMesh, format: Format) -> Result<(), Error> {
    match format {
        Format::Ply(encoding) => ply::write_mesh(path, overwrite, mesh, encoding),
        Format::Stl(encoding) => stl::write(path, overwrite, mesh, encoding),
        Format::Obj => obj::write(path, overwrite, mesh),
        Format::Glb => glb::write(path, overwrite, mesh),
    }
}

/// The frame that a file names, with warnings about what it does not name well.
pub(crate) fn frame_and_unit(
    path: &Path,
    frame: Option<&str>,
    unit: Option<&str>,
) -> Result<(Frame, Vec<Problem>), Error> {
    let place = Place::file(path);
    if let Some(unit) = unit.filter(|unit| *unit != "mm") {
        let what = format!("its unit is \"{unit}\"");
        return Err(Error::content(place, what, "convert it to millimetres, and let its unit say mm"));
    }
    match frame.map(|name| (name, Frame::from_name(name))) {
        None => Ok((Frame::Camera, Vec::new())),
        Some((_, Some(frame))) => Ok((frame, Vec::new())),
        Some((name, None)) => {
            let what = format!("its frame \"{name}\" is neither camera nor galvo");
            Ok((Frame::Camera, vec![Problem::warning(place, what, "it is taken as the camera's")]))
        }
    }
}

/// Collects faces of any number of corners as triangles.
#[derive(Debug, Default)]
pub(crate) struct Polygons {
    triangles: Vec<[u32; 3]>,
}

impl Polygons {
    /// Takes a face by its corners' numbers, from 0, and fans it out from the first; what is wrong with it.
    pub fn push(&mut self, corners: impl ExactSizeIterator<Item = f64>) -> Result<(), String> {
        let count = corners.len();
        if count < 3 {
            return Err(format!("a face has {count} corners, not three or more"));
        }
        let mut seen: [Option<u32>; 2] = [None, None];
        for corner in corners {
            let whole = corner as u32;
            if (f64::from(whole) - corner).abs() > 0.0 {
                return Err(format!("{corner} is no number of a vertex"));
            }
            match seen {
                [None, _] => seen[0] = Some(whole),
                [_, None] => seen[1] = Some(whole),
                [Some(first), Some(last)] => {
                    self.triangles.push([first, last, whole]);
                    seen[1] = Some(whole);
                }
            }
        }
        Ok(())
    }

    /// The mesh of these faces.
    pub fn mesh(self, path: &Path, frame: Frame, vertices: Vec<[f64; 3]>) -> Result<TriangleMesh, Error> {
        let failed = |e: uw_cloud::MeshError| {
            Error::content(
                Place::file(path),
                e.to_string(),
                "the file is torn: copy it again, or write it anew",
            )
        };
        TriangleMesh::new(frame, vertices, self.triangles).map_err(failed)
    }
}
