//! What a calibration can't hold.

use nalgebra::{DMatrix, Matrix3};
use toml::Value;
use uw_calib::{GLOBALS, Method, NAMES};

use super::{
    Fault,
    record::{CovarianceRecord, Record},
};
use crate::text;

/// How far the galvanometer's axes may be from unit length and from square to each other.
const SQUARE: f64 = 1e-9;
/// Rounding of a covariance that was got by inverting, as a correlation.
const COVARIANCE_ROUNDING: f64 = 1e-6;
/// The mend of what only hands can have changed.
const AGAIN: &str = "calibrate again, or undo what was changed by hand";

/// Refuses numbers that are not finite, and standard deviations below zero, anywhere in a table.
pub(super) fn finite(key: &str, value: &Value) -> Result<(), Fault> {
    match value {
        Value::Float(x) if !x.is_finite() => {
            Err(Fault::new(key, format!("{x} is no number to compute with"), AGAIN))
        }
        Value::Float(x) if *x < 0.0 && key.rsplit('.').next().is_some_and(|k| k.starts_with("sigma_")) => {
            Err(Fault::new(key, format!("a standard deviation is not negative, as {x} is"), AGAIN))
        }
        Value::Array(values) => values.iter().try_for_each(|v| finite(key, v)),
        Value::Table(table) => table.iter().try_for_each(|(k, v)| {
            let dot = if key.is_empty() { "" } else { "." };
            finite(&format!("{key}{dot}{k}"), v)
        }),
        _ => Ok(()),
    }
}

/// Refuses values that no instrument has; all are finite.
pub(super) fn record(record: &Record) -> Result<(), Fault> {
    let Record { camera, galvo, laser, water, rig, captures, .. } = record;
    for (key, value, unit) in [
        ("camera.fx_px", camera.fx_px, "px"),
        ("camera.fy_px", camera.fy_px, "px"),
        ("galvo.degrees_per_volt", galvo.degrees_per_volt, "°/V"),
        ("laser.wavelength_nm", laser.wavelength_nm, "nm"),
    ] {
        if value <= 0.0 {
            return Err(Fault::new(key, format!("{value} {unit} must be positive"), AGAIN));
        }
    }
    let size = [camera.width, camera.height];
    if size != [rig.camera.width, rig.camera.height] || size.contains(&0) {
        let what = format!(
            "the images are {} x {} pixels here, but {} x {} in [rig.camera]",
            size[0], size[1], rig.camera.width, rig.camera.height
        );
        return Err(Fault::new("camera.width", what, AGAIN));
    }
    instrument(record)?;
    if laser.wavelength_nm.to_bits() != rig.laser.wavelength_nm.to_bits() {
        let what = format!("{} nm, but {} nm in [rig.laser]", laser.wavelength_nm, rig.laser.wavelength_nm);
        return Err(Fault::new("laser.wavelength_nm", what, "make both the same"));
    }
    let axes = Matrix3::from_columns(&[galvo.axis_direction, galvo.y_axis, galvo.z_axis].map(|a| a.0.into()));
    let off = (axes.transpose() * axes - Matrix3::identity()).amax();
    // NaN, from numbers too large to square, is not below anything.
    if !(off <= SQUARE && axes.determinant() > 0.0) {
        let what = format!(
            "axis_direction, y_axis and z_axis are no right-handed frame of unit vectors (off by {off:.1e})"
        );
        return Err(Fault::new("galvo.axis_direction", what, AGAIN));
    }
    if let Some(index) = water.nominal_index.filter(|n| !(1.0..=4.0).contains(n)) {
        let what = format!("{index} is no index of refraction relative to air");
        return Err(Fault::new("water.nominal_index", what, AGAIN));
    }
    // Without this, a file that was torn before its last section would look whole.
    if record.method == Method::Joint && record.covariance.is_none() {
        let what = "a joint calibration has a covariance, which is missing";
        return Err(Fault::new("covariance", what, "get the whole file, or calibrate again"));
    }
    for capture in captures {
        if capture.sha256.len() != 64 || !capture.sha256.bytes().all(|b| b.is_ascii_hexdigit()) {
            let what = format!("{:?} of {:?} is no SHA-256", capture.sha256, capture.name);
            return Err(Fault::new("captures.sha256", what, "give its 64 hexadecimal digits"));
        }
    }
    Ok(())
}

/// How many times its images' width a focal length may be: from all that is before the camera to a
/// twentieth of a degree.
const FOCAL_WIDTHS: [f64; 2] = [1e-2, 1e3];
/// How far from the centre of the image, in its widths, the principal point may be.
const PRINCIPAL_WIDTHS: f64 = 10.0;
/// By how much distortion may stretch or shrink the distance of a corner of the image.
const STRETCH: f64 = 10.0;
/// How far the water's index may be from its nominal one: no two waters differ so.
const WATER_OFFSET: f64 = 0.3;

/// Refuses what can be computed with, but no instrument is.
fn instrument(record: &Record) -> Result<(), Fault> {
    let Record { camera: c, water, .. } = record;
    let [width, height] = [c.width, c.height].map(f64::from);
    for (key, focal) in [("camera.fx_px", c.fx_px), ("camera.fy_px", c.fy_px)] {
        if !(FOCAL_WIDTHS[0]..=FOCAL_WIDTHS[1]).contains(&(focal / width)) {
            let what = format!("{focal:e} px is no focal length of images {width} px wide");
            return Err(Fault::new(key, what, AGAIN));
        }
    }
    for (key, at, side) in [("camera.cx_px", c.cx_px, width), ("camera.cy_px", c.cy_px, height)] {
        if (at / side - 0.5).abs() > PRINCIPAL_WIDTHS {
            let what = format!("{at:e} px is no principal point of images {width} x {height} px large");
            return Err(Fault::new(key, what, AGAIN));
        }
    }
    let r2 = (width.max(height) / c.fx_px.min(c.fy_px)).powi(2) / 4.0;
    let stretch = 1.0 + r2 * (c.k1 + r2 * (c.k2 + r2 * c.k3));
    if !(STRETCH.recip()..=STRETCH).contains(&stretch) {
        let what = format!("the distortion moves the image's edge to {stretch:.3e} times its distance");
        return Err(Fault::new("camera.k1", what, AGAIN));
    }
    for (key, offset) in
        [("water.index_offset", water.index_offset), ("water.dispersion_offset", water.dispersion_offset)]
    {
        if offset.abs() > WATER_OFFSET {
            return Err(Fault::new(key, format!("{offset:e} is no difference between waters"), AGAIN));
        }
    }
    Ok(())
}

/// The covariance, with the names that are expected, symmetric and positive semidefinite.
pub(super) fn covariance(record: &CovarianceRecord) -> Result<DMatrix<f64>, Fault> {
    let (names, rows) = ("covariance.names", "covariance.rows");
    if record.names.len() != GLOBALS {
        let what = format!("{GLOBALS} names are needed, not {}", record.names.len());
        return Err(Fault::new(names, what, AGAIN));
    }
    for (place, (got, needed)) in record.names.iter().zip(NAMES).enumerate() {
        if got != needed {
            parameter(names, got)?;
            let what = format!("name {} must be \"{needed}\", not \"{got}\"", place + 1);
            return Err(Fault::new(names, what, "put the names, with their rows and columns, back in order"));
        }
    }
    if record.rows.len() != GLOBALS {
        let what = format!("{GLOBALS} rows are needed, not {}", record.rows.len());
        return Err(Fault::new(rows, what, AGAIN));
    }
    for (name, row) in NAMES.iter().zip(&record.rows) {
        if row.len() != GLOBALS {
            let what = format!("the row of {name} needs {GLOBALS} numbers, not {}", row.len());
            return Err(Fault::new(rows, what, AGAIN));
        }
    }
    let matrix = DMatrix::from_fn(GLOBALS, GLOBALS, |i, j| record.rows[i][j]);
    let sigmas: Vec<f64> = matrix.diagonal().iter().map(|v| v.sqrt()).collect();
    if let Some(i) = sigmas.iter().position(|s| s.is_nan()) {
        let what = format!("the variance of {} is negative: {}", NAMES[i], matrix[(i, i)]);
        return Err(Fault::new(rows, what, AGAIN));
    }
    // As correlations, so that nothing hangs on units.
    let mut correlations = DMatrix::identity(GLOBALS, GLOBALS);
    for i in 0..GLOBALS {
        for j in (0..GLOBALS).filter(|j| *j != i) {
            let scaled = |c: f64| if c == 0.0 { 0.0 } else { c / sigmas[i] / sigmas[j] };
            correlations[(i, j)] = scaled(matrix[(i, j)]);
            let (a, b) = (NAMES[i], NAMES[j]);
            if correlations[(i, j)].is_nan() || correlations[(i, j)].abs() > 1.0 + COVARIANCE_ROUNDING {
                let what = format!("{} for {a} and {b} is more than their variances allow", matrix[(i, j)]);
                return Err(Fault::new(rows, what, AGAIN));
            }
            if (correlations[(i, j)] - scaled(matrix[(j, i)])).abs() > COVARIANCE_ROUNDING {
                let what = format!("it is not symmetric: {a} with {b} is not {b} with {a}");
                return Err(Fault::new(rows, what, AGAIN));
            }
        }
    }
    let slack = DMatrix::identity(GLOBALS, GLOBALS) * COVARIANCE_ROUNDING;
    if (correlations + slack).cholesky().is_none() {
        let what = "it is not positive semidefinite: some combination of parameters has a negative variance";
        return Err(Fault::new(rows, what, AGAIN));
    }
    Ok(matrix)
}

/// The parameter of this name.
pub(super) fn parameter(key: &str, name: &str) -> Result<&'static str, Fault> {
    NAMES.iter().find(|known| **known == name).copied().ok_or_else(|| {
        let mend = match text::nearest(name, NAMES) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => AGAIN.into(),
        };
        Fault::new(key, format!("\"{name}\" is no parameter"), mend)
    })
}
