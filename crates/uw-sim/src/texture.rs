//! Patterns, averaged over a patch: what one sample of an image shows of them.

use crate::scene::{Surface, Texture};

/// A patch of a pattern: its middle, and the vectors along which a sample's two sides lie on the drawing, mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    pub(crate) at: [f64; 2],
    pub(crate) sides: [[f64; 2]; 2],
}

/// Mean over a patch of sign(x), for a coordinate x whose sides on the patch are `a` and `b`: the second integral of the sign's
/// step, x|x|/2, differenced over both sides. Exact for a straight edge.
fn mean_sign(x: f64, a: f64, b: f64) -> f64 {
    let (a, b) = (a.abs().max(b.abs()), a.abs().min(b.abs()));
    if x.abs() >= 0.5 * (a + b) {
        return x.signum();
    }
    // A side that is hardly one would divide rounding by itself: then the step is averaged over the other alone.
    if b <= 1e-6 * a {
        return (2.0 * x / a).clamp(-1.0, 1.0);
    }
    let half = |t: f64| 0.5 * t * t.abs();
    let (p, q) = (0.5 * (a + b), 0.5 * (a - b));
    (half(x + p) - half(x + q) - half(x - q) + half(x - p)) / (a * b)
}

/// Means over a patch, smaller than a square, along one axis of a chessboard, in squares: of being on one of the squares −1 … n − 1, and
/// of that times the squares' sign, +1 for square 0.
fn mean_squares(x: f64, a: f64, b: f64, n: u32) -> [f64; 2] {
    let line = x.round();
    let step = mean_sign(x - line, a, b);
    let square = |k: f64| {
        let on = f64::from(u8::from(k >= -1.0 && k < f64::from(n)));
        [on, if k.rem_euclid(2.0) > 0.5 { -on } else { on }]
    };
    let ([before, minus], [after, plus]) = (square(line - 1.0), square(line));
    let mean = |l: f64, r: f64| 0.5 * (l + r) + 0.5 * (r - l) * step;
    [mean(before, after), mean(minus, plus)]
}

impl Surface {
    /// Albedo averaged over a patch.
    pub(crate) fn albedo_over(&self, patch: &Patch) -> f64 {
        let Patch { at, sides: [a, b] } = patch;
        match self.texture {
            Texture::Plain => self.albedo,
            Texture::Chessboard { inner_corners, square_mm, dark } => {
                let scaled = |i: usize| [at[i], a[i], b[i]].map(|x| x / square_mm);
                let ([x, xa, xb], [y, ya, yb]) = (scaled(0), scaled(1));
                let [on_x, sign_x] = mean_squares(x, xa, xb, inner_corners[0]);
                let [on_y, sign_y] = mean_squares(y, ya, yb, inner_corners[1]);
                self.albedo + 0.5 * (on_x * on_y + sign_x * sign_y) * (dark - self.albedo)
            }
            Texture::Tiles { pitch_mm, joint_mm, dark } => {
                let off_joint = |i: usize| {
                    let nearest = at[i] - pitch_mm * (at[i] / pitch_mm).round();
                    let half = 0.5 * joint_mm;
                    1.0 - 0.5
                        * (mean_sign(nearest + half, a[i], b[i]) - mean_sign(nearest - half, a[i], b[i]))
                };
                let tile = off_joint(0) * off_joint(1);
                dark + tile * (self.albedo - dark)
            }
        }
    }

    /// Which even patch of the pattern a point lies in: two points of the same have no edge between them.
    pub(crate) fn cell(&self, at: [f64; 2]) -> [i32; 2] {
        match self.texture {
            Texture::Plain => [0, 0],
            Texture::Chessboard { inner_corners, square_mm, .. } => {
                let cell = |x: f64, n: u32| (x / square_mm).floor().clamp(-2.0, f64::from(n)) as i32;
                let [x, y] = [cell(at[0], inner_corners[0]), cell(at[1], inner_corners[1])];
                let margin = |x: i32, n: u32| x < -1 || x >= n as i32;
                // All of the margin is one patch.
                if margin(x, inner_corners[0]) || margin(y, inner_corners[1]) {
                    [i32::MIN, 0]
                } else {
                    [x, y]
                }
            }
            Texture::Tiles { pitch_mm, joint_mm, .. } => {
                let cell = |x: f64| {
                    let tile = (x / pitch_mm).round();
                    let nearest = x - pitch_mm * tile;
                    let side = if nearest > 0.5 * joint_mm {
                        1
                    } else if nearest < -0.5 * joint_mm {
                        -1
                    } else {
                        0
                    };
                    3 * tile as i32 + side
                };
                [cell(at[0]), cell(at[1])]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against a lattice of 400 × 400 points in the patch; their own error is 1/400 of the step.
    #[test]
    fn means_over_patches_are_those_of_many_points() {
        let surface = Surface {
            texture: Texture::Chessboard { inner_corners: [3, 2], square_mm: 10.0, dark: 0.05 },
            ..Surface::matt(0.9)
        };
        let tiles = Surface {
            texture: Texture::Tiles { pitch_mm: 20.0, joint_mm: 3.0, dark: 0.2 },
            ..Surface::matt(0.6)
        };
        let cases = [[4.0, 10.3], [-10.2, 3.0], [29.6, 5.0], [10.05, 4.0], [1.4, 5.0], [-3.0, -40.0]];
        for at in cases {
            for sides in [[[1.5, 0.4], [-0.3, 1.2]], [[1.0, 0.0], [0.0, 1.0]]] {
                for surface in [&surface, &tiles] {
                    let exact = surface.albedo_over(&Patch { at, sides });
                    let n = 400;
                    let mut sum = 0.0;
                    for i in 0..n {
                        for j in 0..n {
                            let [s, t] = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(n) - 0.5);
                            let p = [0, 1].map(|k| at[k] + s * sides[0][k] + t * sides[1][k]);
                            let point = Patch { at: p, sides: [[0.0; 2]; 2] };
                            sum += surface.albedo_over(&point);
                        }
                    }
                    let mean = sum / f64::from(n * n);
                    assert!((exact - mean).abs() < 3e-3, "{at:?} {sides:?}: {exact} {mean}");
                }
            }
        }
    }

    #[test]
    fn points_of_one_cell_have_one_albedo() {
        let surface = Surface {
            texture: Texture::Chessboard { inner_corners: [3, 2], square_mm: 10.0, dark: 0.05 },
            ..Surface::matt(0.9)
        };
        let mut seen = std::collections::BTreeMap::new();
        for i in -50..80 {
            for j in -50..80 {
                let at = [f64::from(i) + 0.5, f64::from(j) + 0.5];
                let albedo = surface.albedo_over(&Patch { at, sides: [[0.0; 2]; 2] });
                let first = *seen.entry(surface.cell(at)).or_insert(albedo);
                assert!((albedo - first).abs() < 1e-12, "{at:?}");
            }
        }
        assert_eq!(seen.len(), 4 * 3 + 1);
    }
}
