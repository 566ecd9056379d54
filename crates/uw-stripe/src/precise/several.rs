//! Several stripes: each fitted with the others' light taken away, turn by turn, which ends at the likelihood's maximum for all together.

use super::{CANDIDATE_SNR, Precise, Taken, apart, shape};
use crate::lines::{Line, Lines};
use crate::mle::{Common, Fit, Seed, Source, within};
use crate::peak::Candidate;
use crate::profile::{Reject, Stripe};
use crate::ranks::follow;
use crate::special::normal;
use crate::{NoiseModel, Pixel, StripeError, View};
use std::ops::Range;

/// Candidates kept a line, and most stripes.
pub(crate) const MOST: usize = 16;
/// Turns; each takes away what the one before left of the others' error, most of it but at the least distances.
const TURNS: usize = 10;
/// Distance, in widths, from which one turn is enough.
const FAR: f64 = 9.0;
/// Widths apart below which two stripes' centres are no longer told from each other: their errors then double.
const TOLD_APART: f64 = 3.0;
/// Widths beyond which a stripe sheds no light.
const REACH: f64 = 6.0;

impl Precise {
    /// Fills `out` with the `ranks` stripes of most light in `image`.
    ///
    /// # Errors
    /// As [`Precise::extract`].
    pub fn extract_all<P: Pixel>(
        &mut self,
        image: View<'_, P>,
        background: Option<View<'_, P>>,
        ranks: usize,
        out: &mut Vec<Stripe>,
    ) -> Result<(), StripeError> {
        let (noise, prior) = self.prepare(&image, background.as_ref())?;
        let lines = self.options.axis.lines(image.width(), image.height());
        let candidates = self.all_candidates(&noise);
        let width = prior.map_or(1.0, |p| p.ln_width.exp());
        let places = follow(&candidates, ranks, width);
        let raw = self.lines.value.clone();
        let common = Common { noise: &noise, width: prior };
        let known = self.known_width(prior);
        let mut fits = vec![Vec::new(); ranks];
        for (rank, fits) in fits.iter_mut().enumerate() {
            let source = Ranks { lines: &self.lines, rank, places: &places };
            let seed = |(i, place): (usize, &Option<Candidate>)| {
                Some(shape(self.lines.line(i), place.as_ref()?, known))
            };
            self.fitter.fit(places[rank].iter().enumerate().map(seed), &source, common, fits);
        }
        let mut again = Vec::new();
        for turn in 0..TURNS {
            for rank in 0..ranks {
                self.clear_others(&fits, rank, &raw);
                // Once more in the light that is left, from where it ended.
                let seed = |i: usize| {
                    let last = fits[rank][i].as_ref()?;
                    let near = |r: usize| {
                        fits[r][i].as_ref().is_some_and(|f: &Fit| {
                            (f.centre - last.centre).abs() < FAR * last.width.max(f.width)
                        })
                    };
                    let unsettled = turn == 0 || (0..ranks).any(|r| r != rank && near(r));
                    let Fit { centre, width, flux, background, .. } = *last;
                    unsettled.then_some(Seed { centre, width, flux, background })
                };
                let seeds: Vec<Option<Seed>> = (0..fits[rank].len()).map(seed).collect();
                self.fitter.fit(seeds.iter().copied(), &self.lines, common, &mut again);
                for ((fit, again), seed) in fits[rank].iter_mut().zip(&mut again).zip(seeds) {
                    if seed.is_some() {
                        *fit = again.take();
                    }
                }
            }
        }
        out.resize_with(ranks, Stripe::empty);
        for (rank, stripe) in out.iter_mut().enumerate() {
            self.clear_others(&fits, rank, &raw);
            self.stripe.reset(self.options.axis, lines);
            self.stripe.noise = noise;
            let (own, merged) = Self::told_apart(&fits, &places, rank);
            self.fits = own;
            self.taken.clear();
            for (i, place) in places[rank].iter().enumerate() {
                let other = (0..ranks).filter(|r| *r != rank).filter_map(|r| fits[r][i].as_ref());
                let own = fits[rank][i].as_ref().map_or(f64::INFINITY, |f| f.flux);
                let rival = other.map(|f| (f.flux / own) as f32).fold(0.0, f32::max);
                self.taken.push(place.map(|candidate| Taken { candidate, rival }));
            }
            self.verdicts();
            for i in merged {
                self.stripe.drop_line(i + self.lines.first_line, Reject::Merged);
            }
            std::mem::swap(&mut self.stripe, stripe);
        }
        self.lines.value = raw;
        self.lines.light.clear();
        Ok(())
    }

    fn all_candidates(&mut self, noise: &NoiseModel) -> Vec<Vec<Candidate>> {
        let widest = (3.0 * self.options.max_width_px).ceil() as usize;
        let (lines, search) = (&self.lines, &mut self.search);
        (0..lines.count())
            .map(|i| {
                let mut found = Vec::new();
                search.each(lines.line(i), noise, widest, CANDIDATE_SNR, |c| found.push(c));
                found.sort_by(|a, b| b.flux.total_cmp(&a.flux).then(a.centre.cmp(&b.centre)));
                found.truncate(MOST);
                found
            })
            .collect()
    }

    /// The image with the light of all stripes but one taken away; what it weighs stays known.
    fn clear_others(&mut self, fits: &[Vec<Option<Fit>>], rank: usize, raw: &[f32]) {
        let length = self.lines.length;
        self.lines.value.copy_from_slice(raw);
        self.lines.light.clear();
        self.lines.light.resize(raw.len(), 0.0);
        for (i, fit) in
            fits.iter().enumerate().filter(|(r, _)| *r != rank).flat_map(|(_, f)| f.iter().enumerate())
        {
            let Some(fit) = fit else { continue };
            let reach = REACH * fit.width + 1.0;
            let from = (fit.centre - reach).ceil().max(0.0) as usize;
            let to = ((fit.centre + reach).floor().max(-1.0) + 1.0) as usize;
            for x in from..to.min(length) {
                let below = |edge: f64| normal((x as f64 + edge - fit.centre) / fit.width).1;
                let light = (fit.flux * (below(0.5) - below(-0.5))) as f32;
                self.lines.value[i * length + x] -= light;
                self.lines.light[i * length + x] += light;
            }
        }
    }

    /// The fits of a rank, none where another stripe is too near, and those lines.
    fn told_apart(
        fits: &[Vec<Option<Fit>>],
        places: &[Vec<Option<Candidate>>],
        rank: usize,
    ) -> (Vec<Option<Fit>>, Vec<usize>) {
        let mut own = fits[rank].clone();
        let mut merged = Vec::new();
        for (i, fit) in own.iter_mut().enumerate() {
            let Some(place) = places[rank][i] else { continue };
            let (centre, width) = fit.as_ref().map_or((place.centre as f64, 0.0), |f| (f.centre, f.width));
            let near = |r: usize| {
                let other = fits[r][i].as_ref();
                let limit = TOLD_APART * other.map_or(width, |f| f.width).max(width);
                let by_fit = other.is_some_and(|f| (f.centre - centre).abs() < limit);
                by_fit || places[r][i].is_some_and(|p| p.centre.abs_diff(place.centre) as f64 <= limit)
            };
            if (0..fits.len()).any(|r| r != rank && near(r)) {
                *fit = None;
                merged.push(i);
            }
        }
        (own, merged)
    }
}

/// Lines with windows that end midway to the other ranks' stripes.
#[derive(Debug, Clone, Copy)]
struct Ranks<'a> {
    lines: &'a Lines,
    rank: usize,
    places: &'a [Vec<Option<Candidate>>],
}

impl Source for Ranks<'_> {
    fn line(&self, k: usize) -> Line<'_> {
        self.lines.line(k)
    }

    fn window(&self, k: usize, centre: f64, half: f64) -> Range<usize> {
        let window = within(centre, half, self.lines.length);
        let own = self.places[self.rank][k].map_or(0, |c| c.centre);
        apart(window, own, self.places.iter().filter_map(|rank| rank[k]).map(|c| c.centre))
    }
}

impl Source for Lines {
    fn line(&self, k: usize) -> Line<'_> {
        Self::line(self, k)
    }
}
