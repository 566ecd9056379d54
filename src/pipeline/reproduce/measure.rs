//! Balls measured by either method, from the same measurements of stripes.

use crate::Error;
use crate::pipeline::reproduce::published;
use crate::pipeline::uncertainty::SharedErrors;
use nalgebra::{DMatrix, Vector3};
use std::collections::HashSet;
use uw_calib::Calibration;
use uw_cloud::{
    Frame, PointCloud, Relation, Shape, ShapeFit, SphereFit, SphereOptions, fit_sphere, relations,
};
use uw_io::Nominal;
use uw_io::nominal::{NominalDistance, NominalSphere};

/// The artefact of Table 2.
pub(crate) fn three() -> Nominal {
    let [a, b, c, ab, ac, bc] = published::THREE_NOMINAL_MM;
    let sphere = |name: &str, radius_mm| NominalSphere { name: name.to_owned(), radius_mm };
    let distance =
        |a: &str, b: &str, distance_mm| NominalDistance { a: a.to_owned(), b: b.to_owned(), distance_mm };
    Nominal {
        spheres: vec![sphere("A", a), sphere("B", b), sphere("C", c)],
        distances: vec![distance("A", "B", ab), distance("A", "C", ac), distance("B", "C", bc)],
    }
}

/// The sphere of equal weights, as a commercial program fits it.
pub(crate) fn plain(cloud: &PointCloud) -> Result<SphereFit, Error> {
    let bare = PointCloud::new(cloud.frame(), cloud.positions_mm().to_vec());
    fit_sphere(&bare, &SphereOptions::default()).map_err(Error::Fit)
}

/// The sphere with each point's own covariance, and the sigma of its radius with the calibration's part.
pub(crate) fn weighted(cloud: &PointCloud, calibration: &Calibration) -> Result<(SphereFit, f64), Error> {
    let fit = fit_sphere(cloud, &SphereOptions::default()).map_err(Error::Fit)?;
    let own = DMatrix::from_fn(4, 4, |i, j| fit.covariance_mm2[(i, j)]);
    let total = SharedErrors::new(cloud, calibration)?.total(&own, &fit.influence)?;
    Ok((fit, total[(3, 3)].max(0.0).sqrt()))
}

/// Where a point was measured: its image and its pixel, to the bit.
type Key = (u32, [u32; 2]);

fn keys(cloud: &PointCloud) -> impl Iterator<Item = Key> + '_ {
    let (frames, pixels) = (cloud.frame_rows().unwrap_or_default(), cloud.pixels().unwrap_or_default());
    frames.iter().zip(pixels).map(|(frame, pixel)| (*frame, pixel.map(f32::to_bits)))
}

/// The points of another cloud, of the same images, that are the same measurements as those of a shape.
pub(crate) fn same(cloud: &PointCloud, shape: &Shape, other: &PointCloud) -> PointCloud {
    let all: Vec<Key> = keys(cloud).collect();
    let wanted: HashSet<Key> = shape.points.iter().filter_map(|&at| all.get(at).copied()).collect();
    let kept = keys(other).zip(other.positions_mm()).filter(|(key, _)| wanted.contains(key));
    PointCloud::new(Frame::Galvo, kept.map(|(_, p)| *p).collect())
}

/// Radii and distances, in the order of the paper's columns; `None` where a ball was not found.
pub(crate) type Six = [Option<f64>; 6];

/// Six figures of three spheres.
pub(crate) fn six(balls: [Option<([f64; 3], f64)>; 3]) -> Six {
    let apart = |i: usize, j: usize| {
        let (a, b) = (balls[i]?.0, balls[j]?.0);
        Some((Vector3::from(a) - Vector3::from(b)).norm())
    };
    let radius = |i: usize| balls[i].map(|(_, radius)| radius);
    [radius(0), radius(1), radius(2), apart(0, 1), apart(0, 2), apart(1, 2)]
}

/// The standard deviations of those figures with the calibration's part.
pub(crate) fn six_sigmas(
    cloud: &PointCloud,
    shapes: &[Shape],
    balls: &[Option<usize>],
    calibration: &Calibration,
) -> Result<Six, Error> {
    let mut shared = SharedErrors::new(cloud, calibration)?;
    let parts: Vec<DMatrix<f64>> =
        shapes.iter().map(|shape| shared.of(shape.fit.influence())).collect::<Result<_, _>>()?;
    let between = relations(cloud, shapes, Some(&parts)).distances_mm;
    let ball = |i: usize| balls.get(i).copied().flatten();
    let radius = |i: usize| {
        let at = ball(i)?;
        let total = shapes[at].fit.covariance() + &parts[at] * parts[at].transpose();
        matches!(shapes[at].fit, ShapeFit::Sphere(_)).then(|| total[(3, 3)].max(0.0).sqrt())
    };
    let apart = |i: usize, j: usize| {
        let (a, b) = (ball(i)?, ball(j)?);
        let of = |r: &&Relation| (r.a, r.b) == (a, b) || (r.a, r.b) == (b, a);
        between.iter().find(of)?.sigma_total
    };
    Ok([radius(0), radius(1), radius(2), apart(0, 1), apart(0, 2), apart(1, 2)])
}
