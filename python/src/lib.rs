//! The Python module `uwscan._uwscan`: the facade of the library on NumPy arrays. Nothing is computed here.
//!
//! | module | has |
//! |---|---|
//! | `convert` | arrays in, borrowed; arrays out, owned or lent |
//! | `errors` | the library's errors as classes of `uwscan.errors` |
//! | `long` | long calls: threads, progress, Ctrl-C |
//! | `stripe`, `noise`, `capture`, `calibration`, `residuals`, `cloud`, `mesh`, `fits`, `shapes`, `model` | one class or family each |
//! | `shared` | the calibration's part of a measurement's uncertainty |
//! | `care`, `align` | outliers, normals, thinning; comparing and merging |
//! | `lens` | a camera alone, from photographs |
//! | `jobs`, `reports`, `batch` | calibrate, reconstruct, simulate; pages; one recording of an archive |
//!
//! Docstrings are these doc comments, in NumPy's style; signatures say their types to what makes stubs of them (feature `stubs`).
#![allow(clippy::needless_pass_by_value, reason = "arguments of Python's functions are extracted by value")]
#![allow(missing_docs, reason = "the names are Python's, and documented where that shows them")]

mod align;
mod batch;
mod calibration;
mod capture;
mod care;
mod cloud;
mod convert;
mod errors;
mod fits;
mod jobs;
mod lens;
mod long;
mod mesh;
mod model;
mod noise;
mod reports;
mod residuals;
mod shapes;
mod shared;
mod stripe;

/// The compiled part of uwscan; import `uwscan` instead.
#[pyo3::pymodule]
mod _uwscan {
    #[pymodule_export]
    use crate::align::{Comparison, Merged, compare, merge};
    #[pymodule_export]
    use crate::batch::{batch_fail, batch_jobs, batch_one, batch_table};
    #[pymodule_export]
    use crate::calibration::Calibration;
    #[pymodule_export]
    use crate::capture::{Capture, Frame, Frames, open_capture};
    #[pymodule_export]
    use crate::care::{average, estimate_normals, find_outliers, thin};
    #[pymodule_export]
    use crate::cloud::Cloud;
    #[pymodule_export]
    use crate::fits::{
        CircleFit, CylinderFit, PlaneFit, SphereFit, fit_circle, fit_cylinder, fit_plane, fit_sphere,
    };
    #[pymodule_export]
    use crate::jobs::{calibrate, reconstruct, simulate};
    #[pymodule_export]
    use crate::lens::{CameraFit, calibrate_camera};
    #[pymodule_export]
    use crate::mesh::{Mesh, triangulate_surface};
    #[pymodule_export]
    use crate::model::{Camera, Fan, Galvo, Port, Scanner, water_index};
    #[pymodule_export]
    use crate::noise::NoiseModel;
    #[pymodule_export]
    use crate::reports::report;
    #[pymodule_export]
    use crate::residuals::{ResidualTable, Residuals};
    #[pymodule_export]
    use crate::shapes::{Shapes, find_shapes};
    #[pymodule_export]
    use crate::stripe::{Stripe, extract_stripe, stripe_codes};

    #[pymodule_export]
    #[allow(non_upper_case_globals, reason = "Python's own name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
