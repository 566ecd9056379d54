//! What only the sweep as a whole shows: points where the sheet of light grazes the surface or partly misses it.
//!
//! The sheet is some tenths of a millimetre thick. Where it grazes a surface, its light is smeared over many times its
//! thickness, and the surface's curvature and end weigh one side more than the other; where it half passes an outline, only
//! the half that meets the surface is seen. Either way the middle of the light is not where the middle of the sheet is, by
//! up to a pixel, always to the same side. A single image does not tell when the whole stripe is so, as where the sheet first
//! touches a ball: the neighbouring images and the usual width do.

/// A stripe this many times wider than usual is smeared.
const SMEARED: f32 = 1.8;
/// Share of the light further in below which part of the sheet passed the surface.
const PARTIAL: f32 = 0.5;
/// Longest way from an image to the next within a surface: usual steps, and pixels.
const STEP: (f32, f32) = (2.0, 3.0);

/// A stripe's centre on one line of an image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Row or column of the image.
    pub line: usize,
    /// Centre along it, px.
    pub position_px: f32,
    /// Standard deviation of the cross section, px.
    pub width_px: f32,
    /// Light across the stripe, DN · px up to a factor.
    pub flux: f32,
}

/// One image's centres, line by line.
type Image<'a> = &'a [Seen];

/// Why each centre of each image is not to be believed, `None` where it is; images in the order of their voltages.
pub(crate) fn judge(images: &[Image<'_>]) -> Vec<Vec<Option<&'static str>>> {
    let width = median(images.iter().flat_map(|image| (0..image.len()).map(|i| square_width(image, i))));
    let steps = images.windows(2).flat_map(|pair| {
        let step = |seen: &Seen| at(pair[1], seen).map(|next| (next.position_px - seen.position_px).abs());
        pair[0].iter().filter_map(step)
    });
    let reach = STEP.0 * median(steps) + STEP.1;
    let reason = |n: usize, i: usize| {
        if square_width(images[n], i) > SMEARED * width {
            Some("smeared")
        } else {
            partial(images, n, &images[n][i], reach).then_some("partial_beam")
        }
    };
    (0..images.len()).map(|n| (0..images[n].len()).map(|i| reason(n, i)).collect()).collect()
}

/// Width across the stripe: a line cuts a steep one obliquely.
fn square_width(image: Image<'_>, i: usize) -> f32 {
    let (a, b) = (&image[i.saturating_sub(1)], &image[(i + 1).min(image.len() - 1)]);
    let slope = if b.line > a.line && b.line <= a.line + 2 {
        (b.position_px - a.position_px) / (b.line - a.line) as f32
    } else {
        0.0
    };
    image[i].width_px / slope.hypot(1.0)
}

/// Whether the surface ends in the next image on one side, where the light is much less than in the images on the other.
fn partial(images: &[Image<'_>], n: usize, seen: &Seen, reach: f32) -> bool {
    let flux = |other: Option<usize>, steps: f32| {
        let found = at(images.get(other?)?, seen)?;
        ((found.position_px - seen.position_px).abs() <= steps * reach).then_some(found.flux)
    };
    let before = [flux(n.checked_sub(1), 1.0), flux(n.checked_sub(2), 2.0)];
    let after = [flux(Some(n + 1), 1.0), flux(Some(n + 2), 2.0)];
    let inside = match (before, after) {
        ([None, None], [Some(a), Some(b)]) | ([Some(a), Some(b)], [None, None]) => a.max(b),
        _ => return false,
    };
    seen.flux < PARTIAL * inside
}

/// What another image shows on the same line.
fn at<'a>(image: Image<'a>, seen: &Seen) -> Option<&'a Seen> {
    image.binary_search_by_key(&seen.line, |s| s.line).ok().map(|i| &image[i])
}

/// Upper median; 0 of none.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stripes on 20 lines, one a voltage, five pixels apart.
    fn sweep() -> Vec<Vec<Seen>> {
        let seen = |n: usize, line| Seen { line, position_px: 5.0 * n as f32, width_px: 1.5, flux: 100.0 };
        (0..8).map(|n| (0..20).map(|line| seen(n, line)).collect()).collect()
    }

    fn judged(images: &[Vec<Seen>]) -> Vec<Vec<Option<&'static str>>> {
        judge(&images.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }

    #[test]
    fn an_even_surface_is_left_alone() {
        assert!(judged(&sweep()).iter().flatten().all(Option::is_none));
    }

    #[test]
    fn half_a_beam_at_the_sweeps_end_is_taken_out_and_a_dark_patch_is_not() {
        let mut images = sweep();
        images[0].iter_mut().for_each(|s| s.flux = 40.0);
        images[4][7].flux = 40.0;
        let reasons = judged(&images);
        assert!(reasons[0].iter().all(|r| *r == Some("partial_beam")));
        assert!(reasons[1..].iter().flatten().all(Option::is_none));
    }

    #[test]
    fn a_smeared_stripe_is_taken_out_and_an_oblique_one_is_not() {
        let mut images = sweep();
        images[0].iter_mut().for_each(|s| s.width_px = 4.0);
        for seen in &mut images[5] {
            seen.position_px += 3.0 * seen.line as f32;
            seen.width_px = 4.0;
        }
        let reasons = judged(&images);
        assert!(reasons[0].iter().all(|r| *r == Some("smeared")));
        assert!(reasons[1..].iter().flatten().all(Option::is_none));
    }

    #[test]
    fn nothing_gives_nothing() {
        assert!(judged(&[]).is_empty());
        assert_eq!(judged(&[vec![], vec![]]), [vec![], vec![]]);
    }
}
