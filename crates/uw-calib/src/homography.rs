//! Plane-to-plane homographies.

use nalgebra::{DMatrix, Matrix3, Vector3};

/// Below this ratio of the second-smallest to the largest singular value of the normalised equations, more
/// than one homography fits: the points are (nearly) on a line, or too few are distinct.
const RANK_RATIO: f64 = 1e-7;

/// Returns the homography H, to ~ H from, that is closest in the algebraic sense after normalisation of both
/// point sets (Hartley, "In defense of the eight-point algorithm", 1997), with |H| = 1 in the Frobenius
/// sense; `None` for fewer than four pairs or a degenerate arrangement.
#[must_use]
pub fn homography(pairs: &[([f64; 2], [f64; 2])]) -> Option<Matrix3<f64>> {
    let finite = pairs.iter().all(|(p, q)| p.iter().chain(q).all(|x| x.is_finite()));
    if pairs.len() < 4 || !finite {
        return None;
    }
    let from = normalizer(pairs.iter().map(|p| p.0))?;
    let to = normalizer(pairs.iter().map(|p| p.1))?;
    // At least nine rows, so that the decomposition holds the whole right-hand basis.
    let mut a = DMatrix::zeros((2 * pairs.len()).max(9), 9);
    for (i, (p, q)) in pairs.iter().enumerate() {
        let p = from * Vector3::new(p[0], p[1], 1.0);
        let q = to * Vector3::new(q[0], q[1], 1.0);
        for k in 0..3 {
            a[(2 * i, k)] = p[k];
            a[(2 * i, 6 + k)] = -q.x * p[k];
            a[(2 * i + 1, 3 + k)] = p[k];
            a[(2 * i + 1, 6 + k)] = -q.y * p[k];
        }
    }
    let svd = a.svd(false, true);
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|&i, &j| svd.singular_values[i].total_cmp(&svd.singular_values[j]));
    let (largest, second) = (svd.singular_values[*order.last()?], svd.singular_values[*order.get(1)?]);
    if second.is_nan() || second <= RANK_RATIO * largest {
        return None;
    }
    let v = svd.v_t?;
    let h = Matrix3::from_row_iterator(v.row(order[0]).iter().copied());
    let h = to.try_inverse()? * h * from;
    h.try_normalize(0.0).filter(|h| h.iter().all(|x| x.is_finite()))
}

/// Returns H applied to a point, or `None` where it goes to infinity.
#[must_use]
pub fn apply(h: &Matrix3<f64>, p: [f64; 2]) -> Option<[f64; 2]> {
    let q = h * Vector3::new(p[0], p[1], 1.0);
    let point = [q.x / q.z, q.y / q.z];
    point.iter().all(|x| x.is_finite()).then_some(point)
}

/// Similarity that moves the centroid to the origin and the mean distance to √2.
fn normalizer(points: impl Iterator<Item = [f64; 2]> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let (mut cx, mut cy) = (0.0, 0.0);
    for p in points.clone() {
        cx += p[0] / n;
        cy += p[1] / n;
    }
    let mean = points.map(|p| (p[0] - cx).hypot(p[1] - cy)).sum::<f64>() / n;
    let scale = std::f64::consts::SQRT_2 / mean;
    (scale.is_finite() && scale > 0.0)
        .then(|| Matrix3::new(scale, 0.0, -scale * cx, 0.0, scale, -scale * cy, 0.0, 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pixels: rounding of the decomposition for coordinates of about 1000.
    const EXACT_PX: f64 = 1e-8;

    fn grid() -> impl Iterator<Item = [f64; 2]> {
        (0..20).map(|k| [f64::from(k % 5) * 24.0, f64::from(k / 5) * 24.0])
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn exact_points_give_the_homography(
            m in proptest::array::uniform4(-1.0..1.0_f64), t in proptest::array::uniform2(-500.0..500.0_f64),
            w in proptest::array::uniform2(-1e-3..1e-3_f64),
        ) {
            let truth = Matrix3::new(3.0 + m[0], m[1], t[0], m[2], 3.0 + m[3], t[1], w[0], w[1], 1.0);
            let pairs: Vec<_> = grid().map(|p| (p, apply(&truth, p).unwrap())).collect();
            let h = homography(&pairs).unwrap();
            for (p, q) in pairs {
                let r = apply(&h, p).unwrap();
                prop_assert!((r[0] - q[0]).hypot(r[1] - q[1]) < EXACT_PX);
            }
        }
    }

    #[test]
    fn degenerate_points_have_none() {
        let line: Vec<_> = (0..9).map(|k| ([f64::from(k), 0.0], [f64::from(k) * 3.0, 7.0])).collect();
        assert!(homography(&line).is_none());
        assert!(homography(&line[..3]).is_none());
        assert!(homography(&[([1.0, 1.0], [2.0, 2.0]); 8]).is_none());
        let not_finite: Vec<_> = grid().map(|p| (p, [f64::NAN, 1.0])).collect();
        assert!(homography(&not_finite).is_none());
    }
}
