//! What remained of each measurement of a calibration.

use crate::convert::{Out, lend, lend_rows, pose_rows};
use numpy::ndarray::{ArrayView1, ArrayViewD, IxDyn};
use pyo3::prelude::*;
use uwscan::calib::{Across, Outside, ViewResiduals};

/// The residuals of a calibration: model less measurement, of every corner and every stripe point, those that were left out, too.
///
/// Placements of the board and images are numbered from 0 in the order in which they were captured: ``corners.pose`` and ``stripes.pose`` are
/// places in `pose_medium` and `camera_from_board`, ``frame`` in `files`.
#[pyclass(module = "uwscan", frozen)]
pub struct Residuals {
    files: Vec<String>,
    media: Vec<&'static str>,
    poses: Vec<[[f64; 4]; 4]>,
    corners: Py<ResidualTable>,
    stripes: Py<ResidualTable>,
}

#[pymethods]
impl Residuals {
    /// The board's corners: two residuals each, u and v.
    #[getter]
    fn corners(&self, py: Python<'_>) -> Py<ResidualTable> {
        self.corners.clone_ref(py)
    }

    /// The stripes' points on the board: one residual each, along the measured coordinate.
    #[getter]
    fn stripes(&self, py: Python<'_>) -> Py<ResidualTable> {
        self.stripes.clone_ref(py)
    }

    /// Names of the images.
    #[getter]
    fn files(&self) -> Vec<String> {
        self.files.clone()
    }

    /// What was outside the windows at each placement: ``"air"`` or ``"water"``.
    #[getter]
    fn pose_medium(&self) -> Vec<&'static str> {
        self.media.clone()
    }

    /// Where the board was found to be at each placement: (p, 4, 4) float64, mm.
    #[getter]
    fn camera_from_board<'py>(&self, py: Python<'py>) -> PyResult<Out<'py, f64>> {
        Out::matrices(py, self.poses.clone())
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let rows = |table: &Py<ResidualTable>| table.bind(py).get().pose.len();
        format!(
            "Residuals(poses={}, corners={}, stripes={})",
            self.poses.len(),
            rows(&self.corners),
            rows(&self.stripes)
        )
    }
}

/// Residuals of corners, or of stripe points, a row each. Arrays are read-only views of its own memory.
#[pyclass(module = "uwscan", frozen)]
pub struct ResidualTable {
    pose: Vec<u32>,
    frame: Vec<u32>,
    point: Vec<u32>,
    pixel: Vec<[f64; 2]>,
    /// Residuals a row: two of a corner, one of a stripe.
    each: usize,
    px: Vec<f64>,
    standardised: Vec<f64>,
    mm: Option<Vec<f64>>,
    voltage: Option<Vec<f64>>,
    used: Vec<bool>,
}

impl ResidualTable {
    fn new(each: usize) -> Self {
        let of_stripes = (each == 1).then(Vec::new);
        Self {
            pose: Vec::new(),
            frame: Vec::new(),
            point: Vec::new(),
            pixel: Vec::new(),
            each,
            px: Vec::new(),
            standardised: Vec::new(),
            mm: of_stripes.clone(),
            voltage: of_stripes,
            used: Vec::new(),
        }
    }

    fn place(&mut self, pose: usize, frame: usize, point: usize, pixel: [f64; 2], used: bool) {
        self.pose.push(pose as u32);
        self.frame.push(frame as u32);
        self.point.push(point as u32);
        self.pixel.push(pixel);
        self.used.push(used);
    }
}

/// Values of a row's residuals: (n, 2) of corners, (n,) of stripes.
fn shaped<'py>(slf: &Bound<'py, ResidualTable>, values: &[f64]) -> PyResult<Out<'py, f64>> {
    let table = slf.get();
    let shape = if table.each == 1 { vec![table.pose.len()] } else { vec![table.pose.len(), table.each] };
    let view = ArrayViewD::from_shape(IxDyn(&shape), values);
    lend(slf.as_any(), &view.map_err(|e| crate::errors::input(slf.py(), e.to_string()))?)
}

#[pymethods]
impl ResidualTable {
    /// Placement of the board, (n,) uint32.
    #[getter]
    fn pose<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, u32>> {
        lend(slf.as_any(), &ArrayView1::from(slf.get().pose.as_slice()))
    }

    /// Image, (n,) uint32: a place in ``Residuals.files``.
    #[getter]
    fn frame<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, u32>> {
        lend(slf.as_any(), &ArrayView1::from(slf.get().frame.as_slice()))
    }

    /// Number of the corner in its image, or line (row or column) of the stripe point, (n,) uint32.
    #[getter]
    fn point<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, u32>> {
        lend(slf.as_any(), &ArrayView1::from(slf.get().point.as_slice()))
    }

    /// Where it was seen, (n, 2) float64, px; (0, 0) is the centre of the top-left pixel.
    #[getter]
    fn pixel<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f64>> {
        lend_rows(slf.as_any(), &slf.get().pixel)
    }

    /// Model less measurement, px: (n, 2) float64 of corners, (n,) of stripes, along the measured coordinate.
    #[getter]
    fn residual_px<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f64>> {
        shaped(slf, &slf.get().px)
    }

    /// The same in standard deviations, as measurements were weighted, the shape of `residual_px`; a corner's two along axes that make its errors
    /// independent. Of unit variance where the predicted sigmas and their common scale are right.
    #[getter]
    fn standardised<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, f64>> {
        shaped(slf, &slf.get().standardised)
    }

    /// Distance of the board's point from the sheet of light, (n,) float64, mm; None of corners.
    #[getter]
    fn off_sheet_mm<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, f64>>> {
        slf.get().mm.as_ref().map(|mm| shaped(slf, mm)).transpose()
    }

    /// The galvanometer's voltage, (n,) float64, V; None of corners.
    #[getter]
    fn voltage_v<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Out<'py, f64>>> {
        slf.get().voltage.as_ref().map(|v| shaped(slf, v)).transpose()
    }

    /// Whether it took part, (n,) bool: false for what was sorted out as an outlier or not to be trusted.
    #[getter]
    fn used<'py>(slf: &Bound<'py, Self>) -> PyResult<Out<'py, bool>> {
        lend(slf.as_any(), &ArrayView1::from(slf.get().used.as_slice()))
    }

    fn __len__(&self) -> usize {
        self.pose.len()
    }

    fn __repr__(&self) -> String {
        let used = self.used.iter().filter(|used| **used).count();
        let what = if self.each == 1 { "stripes" } else { "corners" };
        format!("ResidualTable({what}, rows={}, used={used})", self.pose.len())
    }
}

/// The residuals of a calibration's placements.
pub fn residuals(py: Python<'_>, views: &[ViewResiduals], across: Across) -> PyResult<Residuals> {
    let (mut files, mut media, mut poses) = (Vec::new(), Vec::new(), Vec::new());
    let (mut corners, mut stripes) = (ResidualTable::new(2), ResidualTable::new(1));
    for (pose, view) in views.iter().enumerate() {
        media.push(if view.outside == Outside::Air { "air" } else { "water" });
        poses.push(pose_rows(&view.camera_from_board.isometry()));
        for (point, corner) in view.corners.iter().enumerate() {
            corners.place(pose, files.len(), point, corner.pixel.into(), corner.used);
            corners.px.extend(corner.residual_px.iter());
            corners.standardised.extend(corner.standardised.iter());
        }
        files.push(view.file.clone());
        for stripe in &view.stripes {
            for remains in &stripe.points {
                // Lines of the image are whole numbers.
                let line = remains.pixel[1 - across.index()].round().max(0.0) as usize;
                stripes.place(pose, files.len(), line, remains.pixel.into(), remains.used);
                stripes.px.push(remains.residual_px);
                stripes.standardised.push(remains.standardised);
                stripes.mm.get_or_insert_default().push(remains.off_sheet_mm);
                stripes.voltage.get_or_insert_default().push(stripe.voltage_v);
            }
            files.push(stripe.file.clone());
        }
    }
    Ok(Residuals { files, media, poses, corners: Py::new(py, corners)?, stripes: Py::new(py, stripes)? })
}
