//! PLY: our clouds out, anybody's clouds in.
//!
//! Written are the properties of [`write()`]. Read is any PLY of format 1.0, ascii or binary of either byte order, with
//! any properties of any type in any order: what is known by name is taken, the rest skipped, other elements too.

mod body;
mod header;
mod mesh;

use std::{fs::File, io::BufReader, path::Path};

use uw_cloud::PointCloud;

use crate::{
    atomic::{self, Overwrite},
    columns::{self, Gather},
    error::{Error, Problem},
};
use header::Header;

pub(crate) use mesh::has_faces;
pub use mesh::{read_mesh, write_mesh};

/// How the body of a PLY is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Encoding {
    /// Binary, little-endian.
    #[default]
    Binary,
    /// One line of text a point; numbers read back as they were.
    Ascii,
}

/// Writes a cloud: `x y z` (double, mm), then as far as the cloud has them `intensity` (float), `frame` (int),
/// `u v` (float), `sigma` (float, mm), `cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz` (float, mm²), `shared_x shared_y shared_z`
/// (float, mm); the frame and the unit in comments of the header.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, overwrite: Overwrite, cloud: &PointCloud, encoding: Encoding) -> Result<(), Error> {
    let columns = columns::of(cloud);
    let format = match encoding {
        Encoding::Binary => "binary_little_endian",
        Encoding::Ascii => "ascii",
    };
    atomic::write(path, overwrite, |mut w| {
        writeln!(w, "ply\nformat {format} 1.0\ncomment uwscan {}", env!("CARGO_PKG_VERSION"))?;
        writeln!(
            w,
            "comment frame {}\ncomment unit mm\nelement vertex {}",
            cloud.frame().name(),
            cloud.len()
        )?;
        for (name, column) in &columns {
            writeln!(w, "property {} {name}", column.ply_type())?;
        }
        writeln!(w, "end_header")?;
        match encoding {
            Encoding::Ascii => columns::write_text(&mut w, &columns, cloud.len(), b' '),
            Encoding::Binary => {
                let mut row = Vec::new();
                for point in 0..cloud.len() {
                    row.clear();
                    columns.iter().for_each(|(_, column)| column.append_le(point, &mut row));
                    w.write_all(&row)?;
                }
                Ok(())
            }
        }
    })
}

/// The cloud of a PLY file, with warnings about what had to be assumed.
///
/// Attributes come back where all of their properties are there. Without the comments `frame` and
/// `unit`, the camera's frame and millimetres are meant.
///
/// # Errors
/// [`Error`] where the file cannot be read, is no PLY, has no vertices with x, y and z, ends early, holds a position
/// that is no finite number, or says that its unit is not the millimetre.
pub fn read(path: &Path) -> Result<(PointCloud, Vec<Problem>), Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let size = file.metadata().map_err(Error::file(path, "open"))?.len();
    let mut source = BufReader::with_capacity(1 << 18, file);
    let header = Header::read(path, &mut source)?;
    let names = header.names("vertex");
    // No vertex takes less than a byte, so that a count that lies reserves no more than the file's own size.
    let expected = header.count("vertex").min(size as usize);
    let mut gather = Gather::new(path, &names, expected)?;
    header.read_body(path, &mut source, &mut [("vertex", &mut gather)])?;
    gather.finish(header.comment("frame"), header.comment("unit"))
}
