//! One scan measured: its shapes, what lies between them, and how far its points are from shapes or from a reference.

use crate::Error;
use crate::pipeline::reconstruct::{Reconstructed, Refraction};
use crate::pipeline::report::artefact;
use crate::pipeline::report::record::{
    DeviationsRecord, FigureRecord, FileRecord, HistogramRecord, ImageRecord, RelationRecord, ScanRecord,
    ShapeRecord,
};
use crate::pipeline::uncertainty::SharedErrors;
use nalgebra::{DMatrix, Vector3};
use std::collections::BTreeMap;
use std::path::Path;
use uw_calib::Calibration;
use uw_cloud::{
    NearestOnMesh, PointCloud, Relation, Shape, ShapeFit, ShapeOptions, Start, compare, find_shapes,
    register, relations,
};
use uw_io::{Medium, Nominal};

/// Share of a scan's points that must come to lie on the reference.
const LEAST_OVERLAP: f64 = 0.3;

/// What a scan is measured with.
pub(crate) struct Against<'a> {
    pub(crate) calibration: Option<&'a Calibration>,
    pub(crate) nominal: Option<&'a Nominal>,
    /// The reference, and its file's name.
    pub(crate) reference: Option<(&'a Path, &'a NearestOnMesh<'a>)>,
}

/// What is known of how a cloud was made.
pub(crate) struct Made<'a> {
    pub(crate) reconstructed: &'a Reconstructed,
    pub(crate) refraction: Refraction,
    pub(crate) medium: Medium,
}

/// A scan, measured.
#[derive(Debug)]
pub(crate) struct Scan {
    pub(crate) record: ScanRecord,
    pub(crate) cloud: PointCloud,
    pub(crate) shapes: Vec<Shape>,
    /// Of each point from its shape or from the reference, mm; not a number where there is none.
    pub(crate) deviations_mm: Vec<f32>,
    /// The shape of each point.
    pub(crate) shape_of: Vec<Option<usize>>,
    /// Which shape each nominal ball is.
    pub(crate) balls: Vec<Option<usize>>,
}

impl Scan {
    /// Measures a cloud.
    ///
    /// # Errors
    /// [`Error`] where its values are no numbers, or it does not lie on the reference.
    pub(crate) fn measure(
        (name, file): (String, FileRecord),
        cloud: PointCloud,
        made: Option<&Made<'_>>,
        against: &Against<'_>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, Error> {
        let path = || file.file.clone().into();
        let found = find_shapes(&cloud, &ShapeOptions::default())
            .map_err(|source| Error::Shapes { path: path(), source })?;
        let shapes = found.shapes;
        let balls = against.nominal.map(|n| artefact::matched(n, &shapes)).unwrap_or_default();
        let causes = against.calibration.and_then(|c| match causes(&cloud, c, &shapes) {
            Ok(causes) => Some(causes),
            Err(error) => {
                warnings.push(format!(
                    "{}: the calibration's part of the uncertainty is not in its figures: {error}",
                    file.file
                ));
                None
            }
        });
        let labels = labels(&shapes, &balls, against.nominal);
        let between = relations(&cloud, &shapes, causes.as_deref());
        let nominal = |a: usize, b: usize| {
            against.nominal.and_then(|n| artefact::distance(n, &labels[a].0, &labels[b].0))
        };
        let relation = |name: &'static str, scale: f64, r: &Relation| RelationRecord {
            a: labels[r.a].0.clone(),
            b: labels[r.b].0.clone(),
            figure: FigureRecord::new(
                name,
                r.value * scale,
                r.sigma * scale,
                r.sigma_total.map(|s| s * scale),
            ),
        };
        let distances = between.distances_mm.iter().map(|r| {
            let record = relation("distance_mm", 1.0, r);
            RelationRecord { figure: record.figure.against(nominal(r.a, r.b)), ..record }
        });
        let degrees = 180.0 / std::f64::consts::PI;

        let mut shape_of = vec![None; cloud.len()];
        for (at, shape) in shapes.iter().enumerate() {
            shape.points.iter().for_each(|&point| shape_of[point] = Some(at));
        }
        let (mut deviations, mut deviations_mm) = (None, from_shapes(&cloud, &shapes, &shape_of));
        if let Some((of, mesh)) = against.reference {
            let (record, distances) = from_reference(&cloud, of, mesh)?;
            (deviations, deviations_mm) = (Some(record), distances);
        }
        let record = ScanRecord {
            name,
            kind: if made.is_some() { "capture" } else { "cloud" },
            file,
            medium: made.map(|m| m.medium.name()),
            index: made.map(|m| m.reconstructed.index),
            refraction: made.map(|m| m.refraction.name()),
            points: cloud.len(),
            frame: cloud.frame().name(),
            box_mm: cloud.bounding_box_mm().map(|(low, high)| [low, high]),
            point_sigma_mm: cloud.sigmas_mm().and_then(sigmas),
            rejected: made.map(|m| owned(&m.reconstructed.rejected)).unwrap_or_default(),
            images: made.map(|m| images(m.reconstructed)).unwrap_or_default(),
            shapes: shapes
                .iter()
                .enumerate()
                .map(|(at, shape)| {
                    let total = causes.as_ref().map(|parts: &Vec<DMatrix<f64>>| {
                        shape.fit.covariance() + &parts[at] * parts[at].transpose()
                    });
                    let nominal = balls.iter().position(|ball| *ball == Some(at));
                    let radius = nominal.and_then(|n| Some(against.nominal?.spheres.get(n)?.radius_mm));
                    shape_record(&labels[at], &shape.fit, total.as_ref(), radius)
                })
                .collect(),
            distances: distances.collect(),
            angles: between.angles_rad.iter().map(|r| relation("angle_deg", degrees, r)).collect(),
            unassigned_points: found.unassigned_points,
            deviations,
        };
        Ok(Self { record, cloud, shapes, deviations_mm, shape_of, balls })
    }
}

/// Each shape's derivatives by the independent causes of the calibration's errors.
fn causes(
    cloud: &PointCloud,
    calibration: &Calibration,
    shapes: &[Shape],
) -> Result<Vec<DMatrix<f64>>, Error> {
    let mut shared = SharedErrors::new(cloud, calibration)?;
    shapes.iter().map(|shape| shared.of(shape.fit.influence())).collect()
}

/// What each shape is called, and whether that is the name of a nominal ball.
fn labels(shapes: &[Shape], balls: &[Option<usize>], nominal: Option<&Nominal>) -> Vec<(String, bool)> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let one = |(at, shape): (usize, &Shape)| {
        let ball = balls.iter().position(|ball| *ball == Some(at));
        if let Some(name) = ball.and_then(|b| Some(nominal?.spheres.get(b)?.name.clone())) {
            return (name, true);
        }
        let kind = shape.fit.kind();
        let count = counts.entry(kind).or_default();
        *count += 1;
        (format!("{kind} {count}"), false)
    };
    shapes.iter().enumerate().map(one).collect()
}

fn owned(counts: &BTreeMap<&'static str, usize>) -> BTreeMap<String, usize> {
    let some = counts.iter().filter(|(_, count)| **count > 0);
    some.map(|(reason, count)| ((*reason).to_owned(), *count)).collect()
}

fn images(made: &Reconstructed) -> Vec<ImageRecord> {
    made.images
        .iter()
        .map(|i| ImageRecord { row: i.row, points: i.points, rejected: owned(&i.rejected) })
        .collect()
}

/// The median of the points' sigmas, and what 95 % are below.
fn sigmas(all: &[f32]) -> Option<[f64; 2]> {
    let mut sorted = all.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f64| sorted.get((share * (sorted.len() as f64 - 1.0)).round() as usize);
    Some([f64::from(*at(0.5)?), f64::from(*at(0.95)?)])
}

fn shape_record(
    (label, is_nominal): &(String, bool),
    fit: &ShapeFit,
    total: Option<&DMatrix<f64>>,
    nominal_radius: Option<f64>,
) -> ShapeRecord {
    let own = fit.covariance();
    let sigma = |c: &DMatrix<f64>, at: usize| c[(at, at)].max(0.0).sqrt();
    let figure = |name: &str, value: f64, at: usize| {
        FigureRecord::new(name, value, sigma(&own, at), total.map(|c| sigma(c, at)))
    };
    let three = |names: [&str; 3], values: [f64; 3], first: usize| {
        let each = names.into_iter().zip(values).enumerate();
        each.map(|(i, (name, value))| figure(name, value, first + i)).collect::<Vec<_>>()
    };
    let mut figures = Vec::new();
    match fit {
        ShapeFit::Sphere(fit) => {
            figures.push(figure("radius_mm", fit.radius_mm, 3).against(nominal_radius));
            figures.extend(three(["x_mm", "y_mm", "z_mm"], fit.center_mm, 0));
        }
        ShapeFit::Plane(fit) => {
            figures.extend(three(["normal_x", "normal_y", "normal_z"], fit.normal, 0));
            figures.push(figure("offset_mm", fit.offset_mm, 3));
        }
        ShapeFit::Cylinder(fit) => {
            figures.push(figure("radius_mm", fit.radius_mm, 6));
            figures.extend(three(["axis_x_mm", "axis_y_mm", "axis_z_mm"], fit.axis_point_mm, 0));
            let direction = ["axis_direction_x", "axis_direction_y", "axis_direction_z"];
            figures.extend(three(direction, fit.axis_direction, 3));
        }
        // A kind of a later version has no figures here yet.
        _ => {}
    }
    let d = fit.deviations();
    ShapeRecord {
        label: label.clone(),
        kind: fit.kind(),
        is_nominal: *is_nominal,
        figures,
        points: d.points,
        outliers: d.outliers,
        rms_mm: d.rms_mm,
        max_outside_mm: d.max_outside_mm,
        max_inside_mm: d.max_inside_mm,
        histogram: (&d.histogram).into(),
    }
}

/// Each point's signed distance from its shape: positive outside, of a plane towards the sensor.
fn from_shapes(cloud: &PointCloud, shapes: &[Shape], shape_of: &[Option<usize>]) -> Vec<f32> {
    let off = |(position, shape): (&[f64; 3], &Option<usize>)| {
        let p = Vector3::from(*position);
        let distance = match shape.and_then(|at| shapes.get(at)).map(|s| &s.fit) {
            Some(ShapeFit::Sphere(s)) => (p - Vector3::from(s.center_mm)).norm() - s.radius_mm,
            Some(ShapeFit::Plane(s)) => Vector3::from(s.normal).dot(&p) + s.offset_mm,
            Some(ShapeFit::Cylinder(s)) => {
                (p - Vector3::from(s.axis_point_mm)).cross(&Vector3::from(s.axis_direction)).norm()
                    - s.radius_mm
            }
            _ => f64::NAN,
        };
        distance as f32
    };
    cloud.positions_mm().iter().zip(shape_of).map(off).collect()
}

fn from_reference(
    cloud: &PointCloud,
    path: &Path,
    mesh: &NearestOnMesh<'_>,
) -> Result<(DeviationsRecord, Vec<f32>), Error> {
    let fail = |what: String| Error::Reference { path: path.to_owned(), what };
    let fit = register(cloud, mesh, Start::Anywhere, LEAST_OVERLAP).map_err(|e| fail(e.to_string()))?;
    let moved = cloud.clone().transformed(cloud.frame(), &fit.mesh_from_cloud);
    let compared = compare(moved.positions_mm(), cloud.sigmas_mm(), mesh)
        .ok_or_else(|| fail("no point lies beside it".to_owned()))?;
    let bins = compared.histogram();
    let record = DeviationsRecord {
        compared: compared.compared,
        beyond: compared.beyond,
        mean_mm: compared.mean_mm,
        rms_mm: compared.rms_mm,
        robust_sigma_mm: compared.robust_sigma_mm,
        quantiles_mm: compared.quantiles_mm,
        extremes_mm: compared.extremes_mm,
        overlap: fit.overlap,
        histogram: HistogramRecord {
            from_mm: bins.from_mm,
            to_mm: bins.from_mm + bins.width_mm * bins.counts.len() as f64,
            counts: bins.counts,
        },
    };
    Ok((record, compared.deviations_mm))
}
