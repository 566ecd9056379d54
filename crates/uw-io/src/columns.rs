//! A cloud as named columns: what PLY and text have in common.

use std::{
    io::{self, Write},
    path::{Path, PathBuf},
};

use uw_cloud::{CloudError, Frame, PointCloud};

use crate::error::{Error, Place, Problem};

/// One column of a cloud, in the type that files give it.
pub(crate) enum Column<'a> {
    /// A coordinate of the positions.
    Double(&'a [[f64; 3]], usize),
    /// A measured value of a point.
    Float(Box<dyn Fn(usize) -> f32 + 'a>),
    /// A count.
    Int(&'a [u32]),
    /// A part of a colour.
    Byte(&'a [[u8; 3]], usize),
}

impl Column<'_> {
    /// The type's name in a PLY header.
    pub fn ply_type(&self) -> &'static str {
        match self {
            Self::Double(..) => "double",
            Self::Int(_) => "int",
            Self::Float(_) => "float",
            Self::Byte(..) => "uchar",
        }
    }

    /// Appends a point's value, little-endian.
    pub fn append_le(&self, point: usize, row: &mut Vec<u8>) {
        match self {
            Self::Double(v, at) => row.extend(v[point][*at].to_le_bytes()),
            Self::Int(v) => row.extend(v[point].to_le_bytes()),
            Self::Float(v) => row.extend(v(point).to_le_bytes()),
            Self::Byte(v, at) => row.push(v[point][*at]),
        }
    }

    /// Appends a point's value as the shortest text that reads back as the same number.
    fn append_text(&self, point: usize, line: &mut Vec<u8>) -> io::Result<()> {
        // Debug writes 1e-30 where Display would write thirty zeros.
        match self {
            Self::Double(v, at) => write!(line, "{:?}", v[point][*at]),
            Self::Int(v) => write!(line, "{}", v[point]),
            Self::Float(v) => write!(line, "{:?}", v(point)),
            Self::Byte(v, at) => write!(line, "{}", v[point][*at]),
        }
    }
}

/// The covariance's columns, in the cloud's order.
const COVARIANCE: [&str; 6] = ["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"];
/// A negative variance, as a share of all three, that rounding explains.
const ROUNDING: f64 = 1e-5;
/// The columns of shared errors.
const SHARED: [&str; 3] = ["shared_x", "shared_y", "shared_z"];
/// The columns of normals and of colours.
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const COLOR: [&str; 3] = ["red", "green", "blue"];

/// A cloud's columns in the order of files.
pub(crate) fn of(cloud: &PointCloud) -> Vec<(&'static str, Column<'_>)> {
    fn float<'a>(name: &'static str, value: impl Fn(usize) -> f32 + 'a) -> (&'static str, Column<'a>) {
        (name, Column::Float(Box::new(value)))
    }
    let positions = cloud.positions_mm();
    let mut columns = vec![
        ("x", Column::Double(positions, 0)),
        ("y", Column::Double(positions, 1)),
        ("z", Column::Double(positions, 2)),
    ];
    columns.extend(cloud.intensities().map(|v| float("intensity", |i| v[i])));
    columns.extend(cloud.frame_rows().map(|v| ("frame", Column::Int(v))));
    if let Some(v) = cloud.pixels() {
        columns.extend([float("u", |i| v[i][0]), float("v", |i| v[i][1])]);
    }
    columns.extend(cloud.sigmas_mm().map(|v| float("sigma", |i| v[i])));
    if let Some(v) = cloud.covariances_mm2() {
        columns.extend(COVARIANCE.into_iter().enumerate().map(|(at, name)| float(name, move |i| v[i][at])));
    }
    if let Some(v) = cloud.shared_mm() {
        columns.extend(SHARED.into_iter().enumerate().map(|(at, name)| float(name, move |i| v[i][at])));
    }
    if let Some(v) = cloud.normals() {
        columns.extend(NORMAL.into_iter().enumerate().map(|(at, name)| float(name, move |i| v[i][at])));
    }
    columns.extend(cloud.deviations_mm().map(|v| float("deviation", |i| v[i])));
    if let Some(v) = cloud.colors() {
        columns.extend(COLOR.into_iter().enumerate().map(|(at, name)| (name, Column::Byte(v, at))));
    }
    columns
}

/// Writes one line a point.
pub(crate) fn write_text(
    w: &mut dyn Write,
    columns: &[(&'static str, Column<'_>)],
    points: usize,
    separator: u8,
) -> io::Result<()> {
    let mut line = Vec::new();
    for point in 0..points {
        line.clear();
        for (at, (_, column)) in columns.iter().enumerate() {
            if at > 0 {
                line.push(separator);
            }
            column.append_text(point, &mut line)?;
        }
        line.push(b'\n');
        w.write_all(&line)?;
    }
    Ok(())
}

/// Collects rows of values whose columns have names into a cloud.
pub(crate) struct Gather {
    path: PathBuf,
    position: [usize; 3],
    intensity: Option<(usize, Vec<f32>)>,
    frame: Option<(usize, Vec<u32>)>,
    pixel: Option<([usize; 2], Vec<[f32; 2]>)>,
    sigma: Option<(usize, Vec<f32>)>,
    covariance: Option<([usize; 6], Vec<[f32; 6]>)>,
    shared: Option<([usize; 3], Vec<[f32; 3]>)>,
    normal: Option<([usize; 3], Vec<[f32; 3]>)>,
    deviation: Option<(usize, Vec<f32>)>,
    color: Option<([usize; 3], Vec<[u8; 3]>)>,
    positions: Vec<[f64; 3]>,
    /// The value of `frame` that was no row, for which the column was dropped.
    foreign_frame: Option<f64>,
}

impl Gather {
    /// For rows whose columns have these names, about `expected` of them.
    pub fn new(path: &Path, names: &[&str], expected: usize) -> Result<Self, Error> {
        // Room for what a file of that size surely holds; beyond it the vectors grow with what is really read.
        let room = expected.min(1 << 20);
        let find = |name: &str| names.iter().position(|n| *n == name);
        let Some(position) = all(["x", "y", "z"].map(find)) else {
            let what = format!("has no points with x, y and z (its columns: {})", names.join(" "));
            return Err(Error::content(
                Place::file(path),
                what,
                "give a file of points, its columns named so",
            ));
        };
        Ok(Self {
            path: path.to_owned(),
            position,
            intensity: find("intensity").map(|at| (at, Vec::with_capacity(room))),
            frame: find("frame").map(|at| (at, Vec::with_capacity(room))),
            pixel: all(["u", "v"].map(find)).map(|at| (at, Vec::with_capacity(room))),
            sigma: find("sigma").map(|at| (at, Vec::with_capacity(room))),
            covariance: all(COVARIANCE.map(find)).map(|at| (at, Vec::with_capacity(room))),
            shared: all(SHARED.map(find)).map(|at| (at, Vec::with_capacity(room))),
            normal: all(NORMAL.map(find)).map(|at| (at, Vec::with_capacity(room))),
            deviation: find("deviation").map(|at| (at, Vec::with_capacity(room))),
            color: all(COLOR.map(find)).map(|at| (at, Vec::with_capacity(room))),
            positions: Vec::with_capacity(room),
            foreign_frame: None,
        })
    }

    /// Takes a row, which has as many values as there are names; what is wrong with it, if it is no point.
    pub fn push(&mut self, row: &[f64]) -> Result<(), String> {
        let position = self.position.map(|at| row[at]);
        if let Some(value) = position.into_iter().find(|v| !v.is_finite()) {
            return Err(format!("a coordinate is {value}, not a finite number"));
        }
        if let Some((at, _)) = &self.covariance {
            // The variances among the six; whether they are finite is checked at the end.
            let least = -ROUNDING * [0, 3, 5].map(|k| row[at[k]]).iter().sum::<f64>().abs();
            for (name, value) in [0, 3, 5].map(|k| (COVARIANCE[k], row[at[k]])) {
                if value < least {
                    return Err(format!("{name} is {value}, but a variance is not negative"));
                }
            }
        }
        if let Some((at, rows)) = &mut self.frame {
            let value = row[*at];
            let whole = value as u32;
            rows.push(whole);
            if (f64::from(whole) - value).abs() > 0.0 || value.is_nan() {
                // Another software's column of this name is no reason to refuse its points.
                (self.frame, self.foreign_frame) = (None, Some(value));
            }
        }
        self.positions.push(position);
        if let Some((at, colors)) = &mut self.color {
            let values = at.map(|at| row[at]);
            if values.iter().all(|v| (0.0..=255.0).contains(v) && v.fract() == 0.0) {
                colors.push(values.map(|v| v as u8));
            } else {
                // Colours of another scale are for others to read.
                self.color = None;
            }
        }
        for (at, values) in [&mut self.normal, &mut self.shared].into_iter().flatten() {
            values.push(at.map(|at| row[at] as f32));
        }
        for (at, values) in [&mut self.intensity, &mut self.sigma, &mut self.deviation].into_iter().flatten()
        {
            values.push(row[*at] as f32);
        }
        if let Some((at, values)) = &mut self.pixel {
            values.push(at.map(|at| row[at] as f32));
        }
        if let Some((at, values)) = &mut self.covariance {
            values.push(at.map(|at| row[at] as f32));
        }
        Ok(())
    }

    /// The cloud, in the frame and the unit that the file names, with warnings about what it doesn't name.
    pub fn finish(
        self,
        frame: Option<&str>,
        unit: Option<&str>,
    ) -> Result<(PointCloud, Vec<Problem>), Error> {
        let place = Place::file(&self.path);
        let mut warnings = Vec::new();
        if let Some(unit) = unit.filter(|unit| *unit != "mm") {
            let what = format!("its unit is \"{unit}\"");
            return Err(Error::content(place, what, "convert it to millimetres, and let its unit say mm"));
        }
        if let Some(value) = self.foreign_frame {
            let what = format!("{value} is no row of frames.csv");
            warnings.push(Problem::warning(place.clone().key("frame"), what, "the column is ignored"));
        }
        let named = frame.map(|name| (name, Frame::from_name(name)));
        let frame = match named {
            Some((_, Some(frame))) => frame,
            Some((name, None)) => {
                let what = format!("its frame \"{name}\" is neither camera nor galvo");
                warnings.push(Problem::warning(place.clone(), what, "it is taken as the camera's"));
                Frame::Camera
            }
            None => Frame::Camera,
        };
        let failed = |e: CloudError| Error::content(place.clone(), e.to_string(), "write the file anew");
        let mut cloud = PointCloud::new(frame, self.positions);
        if let Some((_, values)) = self.intensity {
            cloud = cloud.with_intensities(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.frame {
            cloud = cloud.with_frame_rows(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.pixel {
            cloud = cloud.with_pixels(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.sigma {
            cloud = cloud.with_sigmas_mm(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.covariance {
            cloud = cloud.with_covariances_mm2(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.shared {
            cloud = cloud.with_shared_mm(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.normal {
            cloud = cloud.with_normals(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.deviation {
            cloud = cloud.with_deviations_mm(values).map_err(failed)?;
        }
        if let Some((_, values)) = self.color {
            cloud = cloud.with_colors(values).map_err(failed)?;
        }
        cloud.check_finite().map_err(failed)?;
        Ok((cloud, warnings))
    }
}

/// All of them, or none.
fn all<const N: usize>(found: [Option<usize>; N]) -> Option<[usize; N]> {
    found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default))
}
