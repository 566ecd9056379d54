//! From light at places of the image plane to what pixels collect: point-spread and pixel area in one exact kernel.

/// Light per pixel area, `size` plus a margin on every side that the lens's blur reaches in from.
#[derive(Clone, Debug)]
pub(crate) struct Canvas {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, data: vec![0.0; width * height] }
    }
}

/// The share of a sample's light that each pixel near it collects, along one axis: the sample is a box of side 1/n px, blurred by a
/// Gaussian and integrated over the pixel. Both integrals in closed form: with S(x) = x Φ(x/σ) + σ φ(x/σ), the second difference of S
/// over both boxes.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    /// By the sample's place in its pixel, weights of the pixels from −reach to +reach.
    taps: Vec<Vec<f32>>,
    pub(crate) reach: usize,
}

/// Reach of a blur in its standard deviations: 6e-8 of the light lies beyond.
const REACH_SIGMAS: f64 = 5.4;

impl Kernel {
    /// The kernel for `n` samples a pixel.
    pub(crate) fn new(blur_px: f64, n: usize) -> Self {
        let reach = (REACH_SIGMAS * blur_px).ceil() as usize;
        let side = 1.0 / n as f64;
        let s = |x: f64| {
            if blur_px > 0.0 {
                let z = x / blur_px;
                x * normal_cdf(z) + blur_px * (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt()
            } else {
                x.max(0.0)
            }
        };
        let weight = |offset: f64| {
            let (p, q) = (0.5 * (1.0 + side), 0.5 * (1.0 - side));
            (s(offset + p) - s(offset + q) - s(offset - q) + s(offset - p)) / side
        };
        let taps = (0..n).map(|k| {
            let at = (k as f64 + 0.5) * side - 0.5;
            let weights: Vec<f64> =
                (0..=2 * reach).map(|i| weight(i as f64 - reach as f64 - at).max(0.0)).collect();
            let total: f64 = weights.iter().sum();
            weights.iter().map(|w| (w / total) as f32).collect()
        });
        Self { taps: taps.collect(), reach }
    }

    pub(crate) fn taps(&self, k: usize) -> &[f32] {
        &self.taps[k]
    }

    /// The whole canvas through the kernel of one sample a pixel, cropped by `margin` on all sides.
    pub(crate) fn crop(&self, canvas: &Canvas, margin: usize) -> Canvas {
        let (width, height) = (canvas.width - 2 * margin, canvas.height - 2 * margin);
        let taps = &self.taps[0];
        let mut across = Canvas::new(width, canvas.height);
        for (out, line) in across.data.chunks_exact_mut(width).zip(canvas.data.chunks_exact(canvas.width)) {
            for (k, tap) in taps.iter().enumerate() {
                let from = (margin + k).checked_sub(self.reach);
                let Some(shifted) = from.and_then(|from| line.get(from..from + width)) else { continue };
                out.iter_mut().zip(shifted).for_each(|(o, x)| *o += tap * x);
            }
        }
        let mut out = Canvas::new(width, height);
        for (v, line) in out.data.chunks_exact_mut(width).enumerate() {
            for (k, tap) in taps.iter().enumerate() {
                let from = (v + margin + k).checked_sub(self.reach).map(|row| row * width);
                let Some(shifted) = from.and_then(|from| across.data.get(from..from + width)) else {
                    continue;
                };
                line.iter_mut().zip(shifted).for_each(|(o, x)| *o += tap * x);
            }
        }
        out
    }
}

/// No pixels: first and one past the last.
const NONE: (usize, usize) = (usize::MAX, 0);

/// Collects samples, row by row of samples, into an image.
pub(crate) struct Collector<'k> {
    kernel: &'k Kernel,
    samples: usize,
    /// Pixels outside the image on every side that samples may lie in.
    margin: usize,
    pub(crate) image: Canvas,
    /// The present row of samples, blurred along u; and which of its pixels have light.
    row: Vec<f32>,
    used: (usize, usize),
}

impl<'k> Collector<'k> {
    pub(crate) fn new(
        kernel: &'k Kernel,
        samples: usize,
        margin: usize,
        [width, height]: [usize; 2],
    ) -> Self {
        let row = vec![0.0; width];
        Self { kernel, samples, margin, image: Canvas::new(width, height), row, used: NONE }
    }

    /// Adds the light of the sample `k` (along u) in a column of pixels, counted from the margin's first.
    pub(crate) fn add(&mut self, column: usize, k: usize, light: f32) {
        let taps = self.kernel.taps(k);
        let first = column as isize - self.margin as isize - self.kernel.reach as isize;
        let skip = (-first).max(0) as usize;
        let start = first.max(0) as usize;
        let Some(taps) = taps.get(skip..) else { return };
        let end = (start + taps.len()).min(self.row.len());
        if start >= end {
            return;
        }
        self.row[start..end].iter_mut().zip(taps).for_each(|(o, tap)| *o += light * tap);
        self.used = (self.used.0.min(start), self.used.1.max(end));
    }

    /// Ends a row of samples: the `k`-th of a row of pixels, counted from the margin's first.
    pub(crate) fn end_row(&mut self, row: usize, k: usize) {
        let used = std::mem::replace(&mut self.used, NONE);
        if used.0 >= used.1 {
            return;
        }
        let share = 1.0 / (self.samples * self.samples) as f32;
        let first = row as isize - self.margin as isize - self.kernel.reach as isize;
        for (i, tap) in self.kernel.taps(k).iter().enumerate() {
            let v = first + i as isize;
            if v < 0 || v >= self.image.height as isize {
                continue;
            }
            let start = v as usize * self.image.width;
            let out = &mut self.image.data[start + used.0..start + used.1];
            out.iter_mut().zip(&self.row[used.0..used.1]).for_each(|(o, x)| *o += share * tap * x);
        }
        self.row[used.0..used.1].fill(0.0);
    }
}

/// Φ(x), the normal distribution.
pub(crate) fn normal_cdf(x: f64) -> f64 {
    if x.abs() > 8.0 {
        return if x > 0.0 { 1.0 } else { 0.0 };
    }
    // Φ(x) = ½ + φ(x) (x + x³/3 + x⁵/15 + …), G. Marsaglia, J. Stat. Software 11 (2004) 4.
    let (mut sum, mut term, mut n) = (x, x, 1.0);
    while f64::abs(term) > 1e-17 {
        n += 2.0;
        term *= x * x / n;
        sum += term;
    }
    0.5 + sum * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of equal samples gives even pixels; a sample's mean place and variance come out as box + blur + box make them.
    #[test]
    fn a_kernel_keeps_light_place_and_width() {
        for (blur, n) in [(0.7, 4), (0.45, 2), (1.3, 1), (0.0, 4)] {
            let kernel = Kernel::new(blur, n);
            for k in 0..n {
                let at = (k as f64 + 0.5) / n as f64 - 0.5;
                let place = |i: usize| i as f64 - kernel.reach as f64;
                let taps = kernel.taps(k).iter().map(|w| f64::from(*w)).enumerate();
                let moment =
                    |power: i32| -> f64 { taps.clone().map(|(i, w)| w * (place(i) - at).powi(power)).sum() };
                assert!((moment(0) - 1.0).abs() < 1e-6);
                // Sampling at whole pixels keeps moments only for a blur that is wide enough to them.
                if blur > 0.6 {
                    assert!(moment(1).abs() < 2e-4, "{blur} {k}: {}", moment(1));
                    let variance = blur * blur + (1.0 + 1.0 / (n * n) as f64) / 12.0;
                    assert!((moment(2) - variance).abs() < 2e-3, "{blur} {k}: {}", moment(2));
                }
            }
        }
    }

    #[test]
    fn the_normal_distribution_is_that_of_the_tables() {
        // Abramowitz and Stegun, Table 26.1.
        for (x, p) in [(0.0, 0.5), (1.0, 0.841_344_746_068_543), (2.5, 0.993_790_334_674_224)] {
            assert!((normal_cdf(x) - p).abs() < 1e-14);
            assert!((normal_cdf(-x) - (1.0 - p)).abs() < 1e-14);
        }
    }

    /// Light collected sample by sample, and light spread from whole pixels, end in the same image where the light is even.
    #[test]
    fn samples_and_pixels_agree_on_even_light() {
        let (one, four) = (Kernel::new(0.8, 1), Kernel::new(0.8, 4));
        let margin = one.reach;
        let mut canvas = Canvas::new(20 + 2 * margin, 15 + 2 * margin);
        let mut collector = Collector::new(&four, 4, margin, [20, 15]);
        for row in 0..canvas.height {
            for k in 0..4 {
                for column in 0..canvas.width {
                    let light = (column / 3 + row / 2) as f32;
                    canvas.data[row * canvas.width + column] = light;
                    (0..4).for_each(|i| collector.add(column, i, light));
                }
                collector.end_row(row, k);
            }
        }
        let direct = one.crop(&canvas, margin);
        for (a, b) in direct.data.iter().zip(&collector.image.data) {
            assert!((a - b).abs() < 1e-4 * a.max(1.0), "{a} {b}");
        }
    }
}
