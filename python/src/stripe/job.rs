//! The work of a call: images shared among threads, each line into its place of the arrays.

use super::codes::number;
use super::{NOTES, VALUES};
use crate::convert::{Frame, stack};
use crate::errors::{OrRaise, input};
use numpy::PyReadonlyArrayDyn;
use numpy::ndarray::{Axis as Dim, s};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::cell::RefCell;
use uwscan::stripe::{Extractor, Method, Options, Pixel, StripeError};

/// Extractors that a thread keeps for calls with the same settings: making filters takes longer than applying them.
const KEPT: usize = 4;

thread_local! {
    static EXTRACTORS: RefCell<Vec<Extractor>> = const { RefCell::new(Vec::new()) };
}

pub struct Job {
    pub options: Options,
    pub lines: usize,
    pub threads: usize,
}

/// Where one image's results go.
struct Place<'a> {
    values: [&'a mut [f32]; VALUES],
    notes: [&'a mut [u16]; NOTES],
}

impl Job {
    pub fn run<P: Pixel + numpy::Element>(
        self,
        py: Python<'_>,
        images: &PyReadonlyArrayDyn<'_, P>,
        background: Option<&PyReadonlyArrayDyn<'_, P>>,
        values: &mut [f32],
        notes: &mut [u16],
    ) -> PyResult<()> {
        let Some(images) = stack(images) else { return Err(input(py, "image must have two or three axes")) };
        let dark = background.map(|dark| {
            let dark = stack(dark).filter(|d| d.dim().0 == 1);
            dark.ok_or_else(|| input(py, "background must be one image (h, w)"))
        });
        let dark = dark.transpose()?;
        let threads = self.threads;
        let mut places = self.places(values, notes);
        let work = |places: &mut [Place<'_>]| -> Result<(), StripeError> {
            let dark = dark.as_ref().map(|d| Frame::of(d.index_axis(Dim(0), 0))).transpose()?;
            let dark = dark.as_ref().map(Frame::view).transpose()?;
            let mut first = extractor(&self.options)?;
            // What methods learn from the first image that shows it is learned before images are shared out.
            for image in images.outer_iter().take(if dark.is_none() { usize::MAX } else { 0 }) {
                if self.options.method == Method::Precise
                    || first.model().is_some()
                    || first.learn(Frame::of(image)?.view()?)?
                {
                    break;
                }
            }
            let one = |extractor: &mut Extractor, (k, place): (usize, &mut Place<'_>)| {
                let image = Frame::of(images.slice(s![k, .., ..]))?;
                place.fill(extractor.extract(image.view()?, dark)?);
                Ok(())
            };
            if threads == 1 || places.len() < 2 {
                places.iter_mut().enumerate().try_for_each(|job| one(&mut first, job))?;
                keep(first);
                return Ok(());
            }
            let model = first.model();
            let settled = Options {
                noise: model.map(|m| m.0).or(self.options.noise),
                width_px: model.map(|m| m.1).or(self.options.width_px),
                ..self.options.clone()
            };
            places
                .par_iter_mut()
                .enumerate()
                .map_init(
                    || Extractor::new(settled.clone()),
                    |extractor, job| match extractor {
                        Ok(extractor) => one(extractor, job),
                        Err(e) => Err(e.clone()),
                    },
                )
                .collect()
        };
        if threads == 1 {
            return py.detach(|| work(&mut places)).or_raise(py);
        }
        crate::long::run(py, Some(threads), Some(&false.into_pyobject(py)?.to_owned().into_any()), |_| {
            work(&mut places)
        })?
        .or_raise(py)
    }

    /// One place an image: each array holds its values image by image.
    fn places<'a>(&self, values: &'a mut [f32], notes: &'a mut [u16]) -> Vec<Place<'a>> {
        fn arrays<'a, T, const N: usize>(
            all: &'a mut [T],
            lines: usize,
        ) -> [std::slice::ChunksExactMut<'a, T>; N] {
            let size = (all.len() / N).max(1);
            let mut arrays = all.chunks_exact_mut(size);
            std::array::from_fn(|_| arrays.next().unwrap_or_default().chunks_exact_mut(lines.max(1)))
        }
        let frames = values.len() / (VALUES * self.lines).max(1);
        let mut values: [_; VALUES] = arrays(values, self.lines);
        let mut notes: [_; NOTES] = arrays(notes, self.lines);
        let place = |_| Place {
            values: values.each_mut().map(|array| array.next().unwrap_or_default()),
            notes: notes.each_mut().map(|array| array.next().unwrap_or_default()),
        };
        (0..frames).map(place).collect()
    }
}

impl Place<'_> {
    fn fill(&mut self, stripe: &uwscan::stripe::Stripe) {
        let from: [&[f32]; VALUES] = [
            &stripe.position_px,
            &stripe.sigma_px,
            &stripe.amplitude,
            &stripe.width_px,
            &stripe.background,
            &stripe.chi2,
            &stripe.rival_ratio,
        ];
        self.values.iter_mut().zip(from).for_each(|(to, from)| to.copy_from_slice(from));
        let [flags, rejects] = &mut self.notes;
        flags.iter_mut().zip(&stripe.flags).for_each(|(to, flags)| *to = flags.bits());
        rejects.iter_mut().zip(&stripe.reject).for_each(|(to, reason)| *to = reason.map_or(0, number));
    }
}

/// An extractor with these settings that has learned nothing from other images.
fn extractor(options: &Options) -> Result<Extractor, StripeError> {
    let kept = EXTRACTORS.with_borrow_mut(|kept| {
        let at = kept.iter().position(|e| e.options() == options)?;
        Some(kept.remove(at))
    });
    match kept {
        Some(mut extractor) => {
            // With both given there is nothing to forget, and filters need not be made anew.
            if options.noise.is_none() || options.width_px.is_none() {
                extractor.forget();
            }
            Ok(extractor)
        }
        None => Extractor::new(options.clone()),
    }
}

fn keep(extractor: Extractor) {
    EXTRACTORS.with_borrow_mut(|kept| {
        kept.insert(0, extractor);
        kept.truncate(KEPT);
    });
}
