//! Several stripes: each fitted with the others' light taken away, turn by turn, which ends at the likelihood's maximum for all together.

use super::{CANDIDATE_SNR, Precise, Taken, refine};
use crate::mle::{self, Fit, Seed, WidthPrior};
use crate::peak::Candidate;
use crate::profile::{Reject, Stripe};
use crate::ranks::follow;
use crate::special::normal;
use crate::{NoiseModel, Pixel, StripeError, View};

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
        let mut fits: Vec<Vec<Option<Fit>>> =
            places.iter().map(|rank| self.first_fits(rank, &places, &noise, prior)).collect();
        for turn in 0..TURNS {
            for rank in 0..ranks {
                self.clear_others(&fits, rank, &raw);
                let again: Vec<Option<Fit>> = (0..raw.len() / self.lines.length.max(1))
                    .map(|i| {
                        let last = fits[rank][i]?;
                        let near = |r: usize| {
                            fits[r][i].is_some_and(|f| {
                                (f.centre - last.centre).abs() < FAR * last.width.max(f.width)
                            })
                        };
                        let unsettled = turn == 0 || (0..ranks).any(|r| r != rank && near(r));
                        if unsettled { self.again(i, &last, &noise, prior) } else { Some(last) }
                    })
                    .collect();
                fits[rank] = again;
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

    /// Fits in windows that end midway to the other stripes.
    fn first_fits(
        &self,
        rank: &[Option<Candidate>],
        all: &[Vec<Option<Candidate>>],
        noise: &NoiseModel,
        prior: Option<WidthPrior>,
    ) -> Vec<Option<Fit>> {
        let fit = |(i, place): (usize, &Option<Candidate>)| {
            let own = (*place)?;
            let others = all.iter().filter_map(|r| r[i]).filter(|c| c.centre != own.centre);
            let seeds: Vec<Candidate> = std::iter::once(own).chain(others).collect();
            refine(self.lines.line(i), noise, &seeds, 0, prior, None)
        };
        rank.iter().enumerate().map(fit).collect()
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

    /// The fit once more in the light that is left, from where it ended.
    fn again(&self, i: usize, last: &Fit, noise: &NoiseModel, prior: Option<WidthPrior>) -> Option<Fit> {
        let line = self.lines.line(i);
        let Fit { centre, width, flux, background, .. } = *last;
        let window = |centre: f64, half: f64| {
            let to = ((centre + half).floor().max(-1.0) + 1.0) as usize;
            ((centre - half).ceil().max(0.0) as usize, to.min(line.value.len()))
        };
        mle::settle(line, noise, Seed { centre, width, flux, background }, prior, None, window)
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
