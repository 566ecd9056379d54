//! Shapes found by themselves: spheres, planes and cylinders in an unorganised cloud.
//!
//! | step | file | what it decides |
//! |---|---|---|
//! | sample | `mod` | some thousand points, with normals and tolerances from their neighbours in the whole cloud |
//! | search | `search` | shapes through pairs of oriented points (R. Schnabel, R. Wahl, R. Klein, Computer Graphics Forum 26 (2007) 214); which hang together, which chance explains |
//! | assignment | `mod` | the cloud's points by the sample's nearest one |
//! | fit | [`crate::fit_sphere`] and its kin | maximum likelihood, sigmas, outliers; what is no shape after all |
//! | merging | `mod` | two that are one |
//! | relations | `relation` | distances and angles between them |
//!
//! What is left is searched again until nothing more is found. Chance is seeded, and there are no threads: the same cloud gives the
//! same shapes.

mod confirm;
mod primitive;
mod relation;
mod search;

pub use relation::{Relation, Relations, relations};

use crate::cloud::PointCloud;
use crate::cylinder::CylinderFit;
use crate::deviations::{Deviations, Influence};
use crate::error::{CloudError, FitError};
use crate::neighbours::Neighbours;
use crate::normals::{LocalPlane, NORMAL_NEIGHBOURS, local_plane, local_plane_of_several};
use crate::plane::PlaneFit;
use crate::robust::{Random, median};
use crate::sphere::SphereFit;
use nalgebra::{DMatrix, Vector3};
use primitive::{Oriented, Primitive};
use search::{Candidate, Field};

/// Points that are searched at a time.
const SAMPLED: usize = 3000;

/// Samples in a row that bring nothing, until the search ends.
const MAX_ROUNDS: usize = 24;

/// How far off a point may lie, in units of the roughness that its neighbours show.
const TOLERANCE: f64 = 4.0;

/// Roughness, in shares of how far neighbours are, that is as good as none: coordinates are not written down more exactly.
const EXACT: f64 = 1e-6;

/// Scatter in shares of the roughness that is none.
const ROUNDING: f64 = 1e-4;

/// Points of a shape whose neighbours are asked whether they lie off it alike, and neighbours of each.
const PAIRED: usize = 500;
const NEAREST: usize = 6;

/// Neighbourhoods that each of a shape's parameters needs: a normal is that of a neighbourhood, and so is the tolerance, so that the points of one
/// are flat by construction. With two, half of what they say tests the other half.
const NEIGHBOURHOODS: usize = 2;

/// How shapes are searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeOptions {
    /// At most so many, those with the most points; `None`: all.
    pub max: Option<usize>,
    /// The sensor in the cloud's frame, mm, which normals face.
    pub sensor_mm: [f64; 3],
    /// Seed of the random samples.
    pub seed: u64,
}

impl Default for ShapeOptions {
    fn default() -> Self {
        Self { max: None, sensor_mm: [0.0; 3], seed: 1 }
    }
}

/// A fit of any kind.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
#[allow(clippy::large_enum_variant, reason = "a cloud has a handful of shapes")]
pub enum ShapeFit {
    /// A sphere.
    Sphere(SphereFit),
    /// A plane.
    Plane(PlaneFit),
    /// A cylinder.
    Cylinder(CylinderFit),
}

impl ShapeFit {
    /// Returns the kind's name: `sphere`, `plane` or `cylinder`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Sphere(_) => "sphere",
            Self::Plane(_) => "plane",
            Self::Cylinder(_) => "cylinder",
        }
    }

    /// Returns number of points and their distances.
    pub fn deviations(&self) -> &Deviations {
        match self {
            Self::Sphere(fit) => &fit.deviations,
            Self::Plane(fit) => &fit.deviations,
            Self::Cylinder(fit) => &fit.deviations,
        }
    }

    /// Returns how the parameters follow the points.
    pub fn influence(&self) -> &Influence {
        match self {
            Self::Sphere(fit) => &fit.influence,
            Self::Plane(fit) => &fit.influence,
            Self::Cylinder(fit) => &fit.influence,
        }
    }

    /// Returns the covariance of the parameters, as the fit of that kind orders them.
    pub fn covariance(&self) -> DMatrix<f64> {
        match self {
            Self::Sphere(fit) => DMatrix::from_fn(4, 4, |i, j| fit.covariance_mm2[(i, j)]),
            Self::Plane(fit) => DMatrix::from_fn(4, 4, |i, j| fit.covariance[(i, j)]),
            Self::Cylinder(fit) => DMatrix::from_fn(7, 7, |i, j| fit.covariance[(i, j)]),
        }
    }
}

/// A shape of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// What it is, with sigmas and deviations.
    pub fit: ShapeFit,
    /// Its points, by their index in the cloud, ascending.
    pub points: Vec<usize>,
}

/// The shapes of a cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Shapes {
    /// Those found, the one with the most points first.
    pub shapes: Vec<Shape>,
    /// Points of no shape.
    pub unassigned_points: usize,
}

/// Returns the spheres, planes and cylinders of a cloud, in the cloud's frame, mm.
///
/// A shape is told from chance by the number of its points and from another kind by which of them hold to it; one that its points
/// do not determine is none. Points that no shape holds are counted, and none is forced.
///
/// # Errors
/// [`FitError::Cloud`] for values that are not finite, [`FitError::InvalidCovariance`], and [`FitError::TooFewPoints`] for fewer
/// than four points. A cloud without shapes is no error.
///
/// # Examples
/// ```
/// use uw_cloud::{Frame, PointCloud, ShapeFit, ShapeOptions, find_shapes};
///
/// // The near half of a ball, rough by 0.02 mm.
/// let ball = (0..3000).map(|i| {
///     let (t, z) = (2.4 * f64::from(i), -f64::from(i + 1) / 3001.0);
///     let (r, radius) = ((1.0 - z * z).sqrt(), 20.0 + 0.02 * (12.99 * f64::from(i)).sin());
///     [radius * r * t.cos(), radius * r * t.sin(), 700.0 + radius * z]
/// });
/// let found = find_shapes(&PointCloud::new(Frame::Camera, ball.collect()), &ShapeOptions::default())?;
/// let [shape] = &found.shapes[..] else { panic!("one shape") };
/// let ShapeFit::Sphere(fit) = &shape.fit else { panic!("a sphere") };
/// assert!((fit.radius_mm - 20.0).abs() < 0.01);
/// # Ok::<(), uw_cloud::FitError>(())
/// ```
pub fn find_shapes(cloud: &PointCloud, options: &ShapeOptions) -> Result<Shapes, FitError> {
    crate::sample::check_positions(cloud)?;
    if cloud.len() < 4 {
        return Err(FitError::TooFewPoints { shape: "shape", needed: 4, got: cloud.len() });
    }
    let mut hunt = Hunt::new(cloud, options)?;
    let mut found: Vec<Shape> = Vec::new();
    for _ in 0..MAX_ROUNDS {
        let before = found.len();
        let whole = hunt.round(&mut found)?;
        if found.len() == before || whole {
            break;
        }
    }
    hunt.merge(&mut found)?;
    found.sort_by_key(|shape| std::cmp::Reverse(shape.points.len()));
    if let Some(max) = options.max {
        found.truncate(max);
    }
    let assigned: usize = found.iter().map(|shape| shape.points.len()).sum();
    Ok(Shapes { shapes: found, unassigned_points: cloud.len() - assigned })
}

/// The state of a search.
struct Hunt<'a> {
    cloud: &'a PointCloud,
    sensor: Vector3<f64>,
    /// The cloud's middle: coordinates are taken from it, so that offsets cost no digits.
    origin: Vector3<f64>,
    tree: Neighbours,
    /// Points of no shape yet.
    remaining: Vec<usize>,
    random: Random,
    /// The typical roughness, mm.
    roughness_mm: f64,
}

impl<'a> Hunt<'a> {
    fn new(cloud: &'a PointCloud, options: &ShapeOptions) -> Result<Self, CloudError> {
        let (low, high) = cloud.bounding_box_mm().unwrap_or_default();
        Ok(Self {
            cloud,
            sensor: options.sensor_mm.into(),
            origin: (Vector3::from(low) + Vector3::from(high)) * 0.5,
            tree: Neighbours::new(cloud.positions_mm())?,
            remaining: (0..cloud.len()).collect(),
            random: Random::new(options.seed),
            roughness_mm: 0.0,
        })
    }

    /// Searches one sample of what remains; returns whether that was all of it.
    fn round(&mut self, found: &mut Vec<Shape>) -> Result<bool, FitError> {
        let count = self.remaining.len().min(SAMPLED);
        let whole = count == self.remaining.len();
        // The front of a shuffle.
        for i in 0..count {
            let other = i + self.random.below(self.remaining.len() - i);
            self.remaining.swap(i, other);
        }
        let mut chosen = self.remaining[..count].to_vec();
        chosen.sort_unstable();
        let points = self.oriented(&chosen);
        let tree = Neighbours::new(&points.iter().map(|o| o.point.into()).collect::<Vec<_>>())?;
        let mut field = Field::new(points, tree);
        while let Some(candidate) = field.best(&mut self.random) {
            let shape = self.measured(&field, &candidate)?;
            for &i in &candidate.members {
                field.free[i] = false;
            }
            found.extend(shape);
        }
        self.remaining.sort_unstable();
        Ok(whole)
    }

    /// Returns the chosen points with normals and tolerances, without those that have no normal.
    fn oriented(&mut self, chosen: &[usize]) -> Vec<Oriented> {
        let positions = self.cloud.positions_mm();
        let sensor = self.sensor.into();
        let local: Vec<_> = chosen
            .iter()
            .filter_map(|&i| {
                let place = &positions[i];
                let rows = self.cloud.frame_rows();
                let several =
                    local_plane_of_several(positions, &self.tree, rows, place, NORMAL_NEIGHBOURS, &sensor);
                let plain = || local_plane(positions, &self.tree, place, NORMAL_NEIGHBOURS, &sensor);
                let local = several.or_else(plain)?;
                Some((i, self.cloud.vector(i) - self.origin, local))
            })
            .collect();
        if self.roughness_mm <= 0.0 {
            let middle = |of: fn(&LocalPlane) -> f64| {
                median(&mut local.iter().map(|(.., l)| of(l)).collect::<Vec<_>>())
            };
            self.roughness_mm = middle(|l| l.roughness_mm).max(EXACT * middle(|l| l.reach_mm));
        }
        let typical = self.roughness_mm;
        let tolerance = |roughness: f64, reach: f64| {
            (TOLERANCE * roughness)
                .clamp(0.7 * TOLERANCE * typical, (1.5 * TOLERANCE * typical).max(0.01 * reach))
        };
        let oriented = local.iter().map(|(i, point, l)| Oriented {
            point: *point,
            row: self.cloud.frame_rows().map(|rows| rows[*i]),
            normal: l.normal,
            tolerance: tolerance(l.roughness_mm, l.reach_mm),
            reach: l.reach_mm,
        });
        oriented.collect()
    }

    /// Returns the fit to the cloud's points that a candidate claims, `None` where it is none after all. Its points are taken
    /// out of what remains either way, lest they be found again.
    fn measured(&mut self, field: &Field, candidate: &Candidate) -> Result<Option<Shape>, FitError> {
        let mut member = vec![false; field.points.len()];
        candidate.members.iter().for_each(|&i| member[i] = true);
        let (mut claimed, mut left) = (Vec::new(), Vec::new());
        for &i in &self.remaining {
            let point = self.cloud.vector(i) - self.origin;
            let near = candidate.primitive.distance(&point).abs();
            let owner = (near < 3.0 * TOLERANCE * self.roughness_mm.max(near * 1e-3))
                .then(|| field.tree.nearest_one(&point.into()))
                .flatten()
                .filter(|(_, owner)| member[*owner] && near <= 2.0 * field.points[*owner].tolerance);
            if owner.is_some() { claimed.push(i) } else { left.push(i) }
        }
        self.remaining = left;
        claimed.sort_unstable();
        let least = NEIGHBOURHOODS * NORMAL_NEIGHBOURS * candidate.primitive.parameters();
        if claimed.len() < least {
            return Ok(None);
        }
        let scatter = self.roughness_mm;
        match candidate.primitive.fitted(self.cloud, claimed, &self.origin, scatter, &self.sensor) {
            Ok((fit, points)) => {
                let primitive = Primitive::of(&fit, &self.origin);
                let near: Vec<Vector3<f64>> =
                    points.iter().map(|&i| self.cloud.vector(i) - self.origin).collect();
                let reach = field.reach(&candidate.members);
                let slight = confirm::is_slight(&primitive, &near) && !self.goes_on(&primitive, &points);
                let sound = points.len() >= least
                    && confirm::confirmed(&fit, &primitive, &near, self.roughness_mm, reach, slight)
                    && (slight || self.is_noise_about(&primitive, &points));
                Ok(sound.then_some(Shape { fit, points }))
            }
            Err(error @ (FitError::Cloud(_) | FitError::InvalidCovariance { .. })) => Err(error),
            Err(_) => Ok(None),
        }
    }

    /// Returns how far off a surface a point of the cloud lies, mm.
    fn off(&self, primitive: &Primitive, i: usize) -> f64 {
        primitive.distance(&(self.cloud.vector(i) - self.origin))
    }

    /// Returns whether a surface goes on beyond what is claimed of it and bends away there: whether the points that nothing has claimed, and that lie
    /// off it by more than the `claimed` do, but little more, are more than a few beside them.
    fn goes_on(&self, primitive: &Primitive, claimed: &[usize]) -> bool {
        const FURTHER: f64 = 4.0;
        const FEW: f64 = 0.1;
        let off = |&i: &usize| self.off(primitive, i).abs();
        let within = claimed.iter().map(off).fold(0.0, f64::max);
        let reach = FURTHER * TOLERANCE * self.roughness_mm;
        let further = self.remaining.iter().map(off).filter(|&off| off > within && off <= reach);
        further.count() as f64 > FEW * claimed.len() as f64
    }

    /// Returns whether what lies off a surface is noise for the most part, rather than form: by how much neighbours among its points lie
    /// off it alike, the mean product of two neighbours' distances by the mean square, which is the share of form.
    ///
    /// Neighbours on one stripe share errors, so that those on others are asked where the cloud tells.
    fn is_noise_about(&self, primitive: &Primitive, points: &[usize]) -> bool {
        let off = |i: usize| self.off(primitive, i);
        let rows = self.cloud.frame_rows();
        let (mut products, mut pairs) = (0.0, 0.0_f64);
        let (mut squares, mut count) = (0.0, 0.0_f64);
        for &i in points.iter().step_by(points.len().div_ceil(PAIRED).max(1)) {
            let own = off(i);
            squares += own * own;
            count += 1.0;
            let place = &self.cloud.positions_mm()[i];
            let near = self.tree.nearest_of_several(place, NORMAL_NEIGHBOURS, rows);
            let others = near.into_iter().map(|(_, j)| j).filter(|&j| {
                j != i && rows.is_none_or(|rows| rows[i] != rows[j]) && points.binary_search(&j).is_ok()
            });
            for j in others.take(NEAREST) {
                products += own * off(j);
                pairs += 1.0;
            }
        }
        let squares = squares / count.max(1.0);
        // Rounding has any pattern.
        squares.sqrt() <= ROUNDING * self.roughness_mm
            || pairs > 0.0 && confirm::is_mostly_noise(products / pairs / squares, count)
    }

    /// Makes one of several shapes of a kind where one fit holds nearly all points of them.
    fn merge(&self, found: &mut Vec<Shape>) -> Result<(), FitError> {
        found.sort_by_key(|shape| std::cmp::Reverse(shape.points.len()));
        let mut first = 0;
        while first < found.len() {
            let others: Vec<usize> =
                (first + 1..found.len()).filter(|&other| self.is_on(&found[other], &found[first])).collect();
            // All at once, as a fit of many points takes long; else one after the other.
            let all = (others.len() > 1).then(|| others.clone());
            let tries = all.into_iter().chain(others.iter().map(|&other| vec![other]));
            let mut merged = false;
            for some in tries {
                if let Some(shape) = self.merged(found, first, &some)? {
                    found[first] = shape;
                    some.iter().rev().for_each(|&other| drop(found.remove(other)));
                    merged = true;
                    break;
                }
            }
            if !merged {
                first += 1;
            }
        }
        Ok(())
    }

    /// Returns whether most of a shape's points lie on another one of the same kind.
    fn is_on(&self, shape: &Shape, other: &Shape) -> bool {
        const MOST: f64 = 0.8;
        let primitive = Primitive::of(&other.fit, &self.origin);
        let reach = 2.0 * TOLERANCE * self.roughness_mm.max(other.fit.deviations().rms_mm);
        let near = |&&i: &&usize| self.off(&primitive, i).abs() <= reach;
        shape.fit.kind() == other.fit.kind()
            && shape.points.iter().filter(near).count() as f64 >= MOST * shape.points.len() as f64
    }

    /// Returns the one shape of some, the first of which is near it; `None` where it is none.
    fn merged(&self, found: &[Shape], first: usize, others: &[usize]) -> Result<Option<Shape>, FitError> {
        const OF_ALL: f64 = 0.95;
        let primitive = Primitive::of(&found[first].fit, &self.origin);
        let of_others = others.iter().flat_map(|&other| &found[other].points);
        let mut all: Vec<usize> = found[first].points.iter().chain(of_others).copied().collect();
        all.sort_unstable();
        let count = all.len();
        match primitive.fitted(self.cloud, all, &self.origin, self.roughness_mm, &self.sensor) {
            Ok((fit, points)) if points.len() as f64 >= OF_ALL * count as f64 => {
                Ok(Some(Shape { fit, points }))
            }
            Err(error @ (FitError::Cloud(_) | FitError::InvalidCovariance { .. })) => Err(error),
            _ => Ok(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::Frame;

    #[test]
    fn a_surface_goes_on_where_what_is_left_bends_away_from_it() {
        let ball = |i: usize, off: f64| {
            let (turn, z) = (2.4 * i as f64, -(i as f64 + 1.0) / 1001.0);
            let (across, radius) = ((1.0 - z * z).sqrt(), 20.0 + off * (7.1 * i as f64).sin().powi(2));
            [radius * across * turn.cos(), radius * across * turn.sin(), radius * z]
        };
        let sphere = Primitive::Sphere { center: Vector3::zeros(), radius: 20.0 };
        for (left_off_mm, goes_on) in [(0.01, false), (0.1, true), (5.0, false)] {
            let points = (0..1000).map(|i| ball(i, if i < 600 { 0.01 } else { left_off_mm })).collect();
            let cloud = PointCloud::new(Frame::Camera, points);
            let mut hunt = Hunt::new(&cloud, &ShapeOptions::default()).unwrap();
            hunt.origin = Vector3::zeros();
            hunt.roughness_mm = 0.01;
            hunt.remaining = (600..1000).collect();
            let claimed: Vec<usize> = (0..600).collect();
            assert_eq!(hunt.goes_on(&sphere, &claimed), goes_on, "{left_off_mm} mm");
        }
    }
}
