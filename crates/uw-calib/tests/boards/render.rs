//! Draws a chessboard as a distorted camera sees it: blurred, sampled by pixels' areas, under uneven light,
//! with noise.

use nalgebra::{Rotation3, Vector2, Vector3};
use uw_calib::{GreyView, Layout, Samples};
use uw_geom::{Camera, Distortion};

/// What is drawn. Board coordinates are squares; corner (0, 0) lies at the origin.
#[derive(Clone)]
pub struct Scene {
    pub size: [usize; 2],
    pub camera: Camera,
    pub inner: [usize; 2],
    pub rotation: Rotation3<f64>,
    /// Of the board's middle, in squares.
    pub position: Vector3<f64>,
    pub dark: f64,
    pub bright: f64,
    pub background: f64,
    /// Standard deviation of the blur, px.
    pub blur: f64,
    pub noise: f64,
    /// Light falls off from 1 at the left to this at the right.
    pub light_right: f64,
    pub levels: u16,
    pub seed: u64,
}

pub struct Image {
    pub data: Vec<u16>,
    pub size: [usize; 2],
    pub levels: u16,
}

impl Image {
    pub fn view(&self) -> GreyView<'_> {
        let layout = Layout { width: self.size[0], height: self.size[1], stride: self.size[0] };
        GreyView::new(Samples::U16(&self.data), layout, self.levels).unwrap()
    }

    /// A disc of one value over the image.
    pub fn disc(&mut self, centre: [f64; 2], radius: f64, value: u16) {
        for row in 0..self.size[1] {
            for col in 0..self.size[0] {
                if (col as f64 - centre[0]).hypot(row as f64 - centre[1]) <= radius {
                    self.data[row * self.size[0] + col] = value;
                }
            }
        }
    }
}

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) as f64 / u64::MAX as f64
    }

    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Samples a pixel's side.
const SAMPLES: usize = 4;

impl Scene {
    /// 11 × 8 corners at 8 bits, some 25 px a square, turned a little: along the pixels' rows, area sampling
    /// by a few points would round the edges' places.
    pub fn plain() -> Self {
        let size = [400, 320];
        let camera = Camera {
            fx: 500.0,
            fy: 505.0,
            cx: 203.3,
            cy: 157.1,
            distortion: Distortion { k1: -0.1, ..Distortion::none() },
        };
        Self {
            size,
            camera,
            inner: [11, 8],
            rotation: Rotation3::from_euler_angles(0.05, -0.08, 0.13),
            position: Vector3::new(0.0, 0.0, 20.0),
            dark: 20.0,
            bright: 200.0,
            background: 60.0,
            blur: 0.7,
            noise: 1.5,
            light_right: 1.0,
            levels: 255,
            seed: 1,
        }
    }

    fn middle(&self) -> Vector3<f64> {
        Vector3::new(self.inner[0] as f64 - 1.0, self.inner[1] as f64 - 1.0, 0.0) / 2.0
    }

    /// Where the corner at (column, row) is seen, px.
    pub fn corner(&self, col: usize, row: usize) -> Vector2<f64> {
        let board = Vector3::new(col as f64, row as f64, 0.0) - self.middle();
        self.camera.project(&(self.rotation * board + self.position)).unwrap()
    }

    /// Where a ray meets the board's plane, squares from corner (0, 0).
    fn on_board(&self, direction: Vector2<f64>) -> Vector2<f64> {
        let [x, y, normal] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| self.rotation * axis);
        let ray = direction.push(1.0);
        let hit = ray * (normal.dot(&self.position) / normal.dot(&ray)) - self.position;
        Vector2::new(x.dot(&hit), y.dot(&hit)) + self.middle().xy()
    }

    /// Brightness at a place, averaged over a sample across which its coordinates change by `size`: without
    /// that average the samples' lattice would move edges by tenths of a sample.
    fn albedo(&self, p: Vector2<f64>, size: Vector2<f64>) -> f64 {
        let [cols, rows] = self.inner.map(|n| n as f64);
        // Squares reach one beyond the inner corners, the bright margin half a square further.
        let beyond = |x: f64, n: f64| (-x).max(x - (n - 1.0));
        let out = beyond(p.x, cols).max(beyond(p.y, rows));
        if out > 1.6 {
            return self.background;
        }
        if out > 1.0 {
            return self.bright;
        }
        let wave = |x: f64, size: f64| {
            let line = x.round();
            let side = if line.rem_euclid(2.0) > 0.5 { -1.0 } else { 1.0 };
            side * (2.0 * (x - line) / size).clamp(-1.0, 1.0)
        };
        0.5 * (self.bright + self.dark)
            - 0.5 * (self.bright - self.dark) * wave(p.x, size.x) * wave(p.y, size.y)
    }

    pub fn render(&self) -> Image {
        let [width, height] = self.size;
        // Undistorted directions of the pixels' corners; within a pixel, bilinear.
        let direction = |col: usize, row: usize| {
            let pixel = Vector2::new(col as f64 - 0.5, row as f64 - 0.5);
            self.camera.unproject(&pixel).map_or(Vector2::new(1e3, 1e3), |d| d.xy() / d.z)
        };
        let lines: Vec<Vec<_>> =
            (0..=height).map(|row| (0..=width).map(|col| direction(col, row)).collect()).collect();
        // The lens blurs before pixels sample, so all that happens on a finer grid.
        let fine = [width * SAMPLES, height * SAMPLES];
        let mut places = Vec::with_capacity(fine[0] * fine[1]);
        for v in 0..fine[1] {
            for u in 0..fine[0] {
                let (col, row) = (u / SAMPLES, v / SAMPLES);
                let [s, t] = [u, v].map(|x| ((x % SAMPLES) as f64 + 0.5) / SAMPLES as f64);
                let top = lines[row][col] * (1.0 - s) + lines[row][col + 1] * s;
                let bottom = lines[row + 1][col] * (1.0 - s) + lines[row + 1][col + 1] * s;
                places.push(self.on_board(top * (1.0 - t) + bottom * t));
            }
        }
        let drawn: Vec<f32> = (0..places.len())
            .map(|at| {
                let step =
                    |by: usize| places[at] - places[if at + by < places.len() { at + by } else { at - by }];
                let (across, down) = (step(1), step(fine[0]));
                self.albedo(places[at], across.zip_map(&down, f64::hypot)) as f32
            })
            .collect();
        let sigma = self.blur * SAMPLES as f64;
        let drawn = blurred_and_turned(&blurred_and_turned(&drawn, fine[0], sigma), fine[1], sigma);
        let mut image = vec![0.0; width * height];
        for (at, value) in drawn.iter().enumerate() {
            let (u, v) = (at % fine[0], at / fine[0]);
            image[v / SAMPLES * width + u / SAMPLES] += f64::from(*value) / (SAMPLES * SAMPLES) as f64;
        }
        for (at, value) in image.iter_mut().enumerate() {
            *value *= 1.0 + (self.light_right - 1.0) * (at % width) as f64 / width as f64;
        }
        let mut random = Random(self.seed);
        let data = image
            .iter()
            .map(|x| (x + self.noise * random.normal()).round().clamp(0.0, f64::from(self.levels)) as u16)
            .collect();
        Image { data, size: self.size, levels: self.levels }
    }
}

/// Gaussian blur along the rows, then rows and columns exchanged: twice is a blur in both directions.
fn blurred_and_turned(image: &[f32], width: usize, sigma: f64) -> Vec<f32> {
    let reach = (3.5 * sigma).ceil() as usize;
    let weight = |k: usize| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32;
    let weights: Vec<f32> = (0..=2 * reach).map(|k| weight(k.abs_diff(reach))).collect();
    let total: f32 = weights.iter().sum();
    let height = image.len() / width;
    let mut out = vec![0.0; image.len()];
    for (row, line) in image.chunks_exact(width).enumerate() {
        let padded: Vec<f32> =
            (0..width + 2 * reach).map(|k| line[k.saturating_sub(reach).min(width - 1)]).collect();
        for (col, window) in padded.windows(2 * reach + 1).enumerate() {
            out[col * height + row] = window.iter().zip(&weights).map(|(x, w)| x * w).sum::<f32>() / total;
        }
    }
    out
}
