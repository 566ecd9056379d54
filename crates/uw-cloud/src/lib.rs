//! Point clouds and robust shape fits with covariance.
//!
//! A [`PointCloud`] holds positions in millimetres and, where its maker gave them, what was measured with each
//! point and the covariance of its measurement. [`fit_sphere`] and [`fit_plane`] turn one into a shape with
//! sigmas, as [`fit_cylinder`] and [`fit_circle`] do. How points were made, and the files that they come from, are no concern of this crate.
//!
//! # How a shape is fitted
//!
//! | step | file | what it decides |
//! |---|---|---|
//! | start | `consensus` | a shape from random minimal samples that the densest share of the points agrees with |
//! | refinement | `fit` | maximum likelihood with errors in variables; noise floor; scale; which points are outliers |
//! | covariance | `fit` | sigmas, and whether the points determine the shape at all |
//!
//! A shape is a `fit::Surface`: its signed distance, the foot of a point under that point's own covariance, and
//! the derivatives there. Everything else is shared between shapes.

mod boundary;
mod circle;
mod cloud;
mod compare;
mod consensus;
mod cylinder;
mod deviations;
mod eigen;
mod error;
mod fit;
mod floor;
mod merge;
mod mesh;
mod nearest;
mod neighbours;
mod newton;
mod normals;
mod outliers;
mod plane;
mod reference;
mod register;
mod robust;
mod round;
mod sample;
mod shapes;
mod sphere;
mod surface;
mod thin;

pub use boundary::Boundary;
pub use circle::{CircleFit, CircleOptions, fit_circle};
pub use cloud::{CloudPoint, Frame, PointCloud};
pub use compare::{Bins, Comparison, compare, deviation_color};
pub use cylinder::{CylinderFit, CylinderOptions, fit_cylinder};
pub use deviations::{Deviations, Histogram, Influence, InfluencePoint};
pub use error::{CloudError, FitError, MergeError, MeshError, ReferenceError, RegisterError, SurfaceError};
pub use merge::{MergeOptions, Merged, PairResidual, merge};
pub use mesh::{Topology, TriangleMesh};
pub use nearest::{Nearest, NearestOnMesh};
pub use neighbours::Neighbours;
pub use normals::{LocalPlane, NORMAL_NEIGHBOURS, local_plane, normals};
pub use outliers::{sheet_outliers, sparse_outliers};
pub use plane::{PlaneFit, PlaneOptions, fit_plane};
pub use reference::{AgainstReference, ReferenceOptions, compare_with_reference};
pub use register::{Motion, Registration, Start, SweepSurface, register, register_sweep};
pub use shapes::{Relation, Relations, Shape, ShapeFit, ShapeOptions, Shapes, find_shapes, relations};
pub use sphere::{SphereFit, SphereOptions, fit_sphere};
pub use surface::{Cut, Parameters, Smoothed, Surface, SurfaceOptions, triangulate};
pub use thin::{averaged, cropped, thinned, thinned_by_curvature};
