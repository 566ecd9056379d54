//! Balls of an artefact: which is which, and their probing and sphere-spacing errors in the sense of VDI/VDE 2634 part 2.

use nalgebra::{Matrix4, Vector3, Vector4};
use uw_cloud::{PointCloud, Shape, ShapeFit, SphereFit};
use uw_io::Nominal;

/// A ball is looked for among those whose radius is this near, as a share of its own.
const NEAR_RADIUS: f64 = 0.1;
/// What a nominal ball that is not seen costs in the search: as much as one that is this far off, mm.
const MISSING_MM: f64 = 10.0;
/// Points belong to a ball that lie this near its surface, as a share of its radius, unless another shape has them.
pub(crate) const NEAR_SURFACE: f64 = 0.05;
/// Points that may be left out, of all.
pub(crate) const LEFT_OUT: f64 = 0.003;
/// Steps of least squares; they gain two digits each on a ball seen from one side.
const STEPS: usize = 30;

/// Which of the found shapes each nominal ball is: those whose radii and distances are nearest together; `None` for one that none is.
pub(crate) fn matched(nominal: &Nominal, shapes: &[Shape]) -> Vec<Option<usize>> {
    let spheres: Vec<(usize, &SphereFit)> = shapes
        .iter()
        .enumerate()
        .filter_map(|(at, shape)| match &shape.fit {
            ShapeFit::Sphere(fit) => Some((at, fit)),
            _ => None,
        })
        .collect();
    let mut search = Search { nominal, spheres: &spheres, best: (f64::INFINITY, Vec::new()) };
    search.go(&mut Vec::new(), 0.0);
    let found = |at: Option<usize>| at.and_then(|at| spheres.get(at)).map(|(shape, _)| *shape);
    search.best.1.into_iter().map(found).collect()
}

/// Depth first, one nominal ball after the other; what costs more than the best so far is not followed.
struct Search<'a> {
    nominal: &'a Nominal,
    spheres: &'a [(usize, &'a SphereFit)],
    best: (f64, Vec<Option<usize>>),
}

impl Search<'_> {
    fn go(&mut self, chosen: &mut Vec<Option<usize>>, cost: f64) {
        if cost >= self.best.0 {
            return;
        }
        let Some(ball) = self.nominal.spheres.get(chosen.len()) else {
            self.best = (cost, chosen.clone());
            return;
        };
        for (at, (_, fit)) in self.spheres.iter().enumerate() {
            let off = fit.radius_mm - ball.radius_mm;
            if chosen.contains(&Some(at)) || off.abs() > NEAR_RADIUS * ball.radius_mm {
                continue;
            }
            let more = off * off + self.distances(chosen, at);
            chosen.push(Some(at));
            self.go(chosen, cost + more);
            chosen.pop();
        }
        chosen.push(None);
        self.go(chosen, cost + MISSING_MM * MISSING_MM);
        chosen.pop();
    }

    /// Squares of what the distances to those already chosen are off by.
    fn distances(&self, chosen: &[Option<usize>], at: usize) -> f64 {
        let ball = &self.nominal.spheres[chosen.len()].name;
        let center = Vector3::from(self.spheres[at].1.center_mm);
        let off = |(other, place): (&uw_io::nominal::NominalSphere, &Option<usize>)| {
            let distance = distance(self.nominal, ball, &other.name)?;
            let other = Vector3::from(self.spheres[(*place)?].1.center_mm);
            Some(((center - other).norm() - distance).powi(2))
        };
        self.nominal.spheres.iter().zip(chosen).filter_map(off).sum()
    }
}

/// The nominal distance of two balls, if there is one.
pub(crate) fn distance(nominal: &Nominal, a: &str, b: &str) -> Option<f64> {
    let of = |d: &&uw_io::nominal::NominalDistance| (d.a == a && d.b == b) || (d.a == b && d.b == a);
    nominal.distances.iter().find(of).map(|d| d.distance_mm)
}

/// The sphere of least squares through the points of a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Probed {
    pub(crate) center_mm: [f64; 3],
    pub(crate) radius_mm: f64,
    /// Range of the radial distances.
    pub(crate) form_mm: f64,
    pub(crate) points: usize,
    pub(crate) left_out: usize,
}

/// A ball probed: the points near its surface that no other shape holds, the sphere of least squares through them with free radius and
/// equal weights, without the farthest 3 in 1000, and through those that are left once more. `None` where they determine no sphere.
pub(crate) fn probed(cloud: &PointCloud, taken: &[bool], fit: &SphereFit) -> Option<Probed> {
    let center = Vector3::from(fit.center_mm);
    let near = |p: &Vector3<f64>| ((p - center).norm() - fit.radius_mm).abs() <= NEAR_SURFACE * fit.radius_mm;
    let mut points: Vec<Vector3<f64>> = cloud
        .positions_mm()
        .iter()
        .zip(taken)
        .filter(|(_, taken)| !**taken)
        .map(|(p, _)| Vector3::from(*p))
        .filter(near)
        .collect();
    let whole = least_squares(&points, center, fit.radius_mm)?;
    let left_out = (LEFT_OUT * points.len() as f64).floor() as usize;
    let off = |p: &Vector3<f64>, (center, radius): (Vector3<f64>, f64)| (p - center).norm() - radius;
    points.sort_by(|p, q| off(p, whole).abs().total_cmp(&off(q, whole).abs()));
    points.truncate(points.len() - left_out);
    let (center, radius) = least_squares(&points, whole.0, whole.1)?;
    let (low, high) = points
        .iter()
        .map(|p| off(p, (center, radius)))
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d)));
    Some(Probed {
        center_mm: center.into(),
        radius_mm: radius,
        form_mm: high - low,
        points: points.len(),
        left_out,
    })
}

/// Centre and radius that make the sum of squared radial distances least (Gauss–Newton); `None` where the points do not determine them.
fn least_squares(points: &[Vector3<f64>], center: Vector3<f64>, radius: f64) -> Option<(Vector3<f64>, f64)> {
    if points.len() < 4 {
        return None;
    }
    let (mut center, mut radius) = (center, radius);
    for _ in 0..STEPS {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for p in points {
            let out = p - center;
            let length = out.norm();
            let direction = out.try_normalize(0.0)?;
            let row = direction.push(1.0);
            normal += row * row.transpose();
            right += row * (length - radius);
        }
        let step = normal.cholesky()?.solve(&right);
        center += step.xyz();
        radius += step.w;
        if step.norm() <= 1e-12 * radius {
            break;
        }
    }
    (radius.is_finite() && radius > 0.0).then_some((center, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use uw_cloud::{Frame, ShapeOptions, SphereOptions, find_shapes, fit_sphere};
    use uw_io::nominal::{NominalDistance, NominalSphere};

    /// The half of a ball that faces the sensor, on a spiral; `rough` moves each point out of it.
    fn ball(center: [f64; 3], radius: f64, rough: impl Fn(usize) -> f64) -> Vec<[f64; 3]> {
        (0..2000)
            .map(|i| {
                let (t, z) = (2.4 * i as f64, -(i as f64 + 1.0) / 2001.0);
                let (r, out) = ((1.0 - z * z).sqrt(), radius + rough(i));
                [center[0] + out * r * t.cos(), center[1] + out * r * t.sin(), center[2] + out * z]
            })
            .collect()
    }

    fn wave(i: usize) -> f64 {
        0.02 * (12.99 * i as f64).sin()
    }

    const CENTERS: [[f64; 3]; 3] = [[80.0, 60.0, 1000.0], [50.0, -80.0, 990.0], [-130.0, 30.0, 1010.0]];

    fn nominal(names: [&str; 3], order: [usize; 3]) -> Nominal {
        let spheres = names.map(|name| NominalSphere { name: name.to_owned(), radius_mm: 30.0 }).to_vec();
        let far =
            |i: usize, j: usize| (Vector3::from(CENTERS[order[i]]) - Vector3::from(CENTERS[order[j]])).norm();
        let pairs = [(0, 1), (0, 2), (1, 2)];
        let distances = pairs.map(|(i, j)| NominalDistance {
            a: names[i].to_owned(),
            b: names[j].to_owned(),
            distance_mm: far(i, j),
        });
        Nominal { spheres, distances: distances.to_vec() }
    }

    #[test]
    fn equal_balls_are_told_apart_by_their_distances() {
        let points: Vec<[f64; 3]> = CENTERS.iter().flat_map(|c| ball(*c, 30.0, wave)).collect();
        let cloud = PointCloud::new(Frame::Camera, points);
        let shapes = find_shapes(&cloud, &ShapeOptions::default()).unwrap().shapes;
        assert_eq!(shapes.len(), 3);
        for order in [[0, 1, 2], [2, 0, 1], [1, 2, 0]] {
            let places = matched(&nominal(["A", "B", "C"], order), &shapes);
            for (place, of) in places.iter().zip(order) {
                let ShapeFit::Sphere(fit) = &shapes[place.unwrap()].fit else { panic!("a sphere") };
                assert!((Vector3::from(fit.center_mm) - Vector3::from(CENTERS[of])).norm() < 0.1);
            }
        }
        let mut larger = nominal(["A", "B", "C"], [0, 1, 2]);
        larger.spheres[1].radius_mm = 50.0;
        assert_eq!(matched(&larger, &shapes).iter().filter(|place| place.is_none()).count(), 1);
        assert_eq!(matched(&larger, &[]), [None, None, None]);
    }

    #[test]
    fn probing_finds_the_range_of_what_the_points_stand_out_by() {
        // Six points of two thousand are 3 in 1000: they may be left out, a seventh not.
        for (spikes, range) in [(6, 0.04), (7, 0.52)] {
            let rough = |i: usize| if i % 250 == 77 && i / 250 < spikes { 0.5 } else { wave(i) };
            let cloud = PointCloud::new(Frame::Camera, ball(CENTERS[0], 30.0, rough));
            let fit = fit_sphere(&cloud, &SphereOptions::default()).unwrap();
            let probed = probed(&cloud, &vec![false; cloud.len()], &fit).unwrap();
            assert_eq!((probed.points, probed.left_out), (1994, 6));
            assert!((probed.form_mm - range).abs() < 0.005, "{} with {spikes} spikes", probed.form_mm);
            assert!((probed.radius_mm - 30.0).abs() < 0.01);
        }
    }

    #[test]
    fn what_another_shape_holds_is_not_probed() {
        let cloud = PointCloud::new(Frame::Camera, ball(CENTERS[0], 30.0, wave));
        let fit = fit_sphere(&cloud, &SphereOptions::default()).unwrap();
        let taken: Vec<bool> = (0..cloud.len()).map(|i| i >= 100).collect();
        assert_eq!(probed(&cloud, &taken, &fit).unwrap().points, 100);
        assert_eq!(probed(&cloud, &vec![true; cloud.len()], &fit), None);
    }
}
