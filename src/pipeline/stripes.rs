//! Stripes of images: extraction with the rig's full scale, and which way the stripe runs.

use crate::Error;
use crate::pipeline::load::{Reading, StripeView, stripe_view};
use std::collections::BTreeMap;
use std::path::Path;
use uw_calib::Across;
use uw_io::{Capture, FrameRecord, GrayImage};
use uw_stripe::{Axis, Extractor, Method, NoiseModel, Options, Stripe, StripeError};

/// What a scan's stripes are measured by where nothing else is asked for (docs/adr/0065).
pub const METHOD: Method = Method::Robust;
/// Images that tell noise and width to the methods that keep them.
const LEARNED_FROM: usize = 12;

/// Laser-on images that are looked at to find the stripe's direction.
const DIRECTION_SAMPLES: usize = 12;

/// Measurements rejected, by reason.
pub(crate) type Rejects = BTreeMap<&'static str, usize>;

/// Rows or columns, as the extractor says it.
pub(crate) fn axis(across: Across) -> Axis {
    match across {
        Across::U => Axis::PerRow,
        Across::V => Axis::PerColumn,
    }
}

/// An extractor that measures each image of `bits` significant bits by itself.
pub(crate) fn extractor(across: Across, bits: u8, reject_edges: bool) -> Result<Extractor, StripeError> {
    Extractor::new(Options { reject_edges, ..options(across, bits, Method::Precise) })
}

fn options(across: Across, bits: u8, method: Method) -> Options {
    let full_scale = ((1u32 << bits) - 1) as f32;
    Options { method, axis: axis(across), full_scale_dn: Some(full_scale), ..Options::default() }
}

/// Settings for a scan's images by a method of choice. Those that keep noise and width from image to image are given them, read off images
/// spread over the scan: so that no result depends on the order in which threads come to the images. Where none tells them, every image is
/// measured as by [`Method::Precise`].
///
/// # Errors
/// [`Error::Stripe`] where an image does not suit the settings; one that can't be read is reported where all of them are.
pub(crate) fn settled(
    method: Method,
    (across, bits): (Across, u8),
    (capture, reading): (&Capture, Reading),
) -> Result<Options, Error> {
    let mut options = options(across, bits, method);
    if method == Method::Precise {
        return Ok(options);
    }
    let frames: Vec<&FrameRecord> = capture.present().filter(|f| f.laser_on).collect();
    let step = frames.len().div_ceil(LEARNED_FROM).max(1);
    // First those spread over the scan, then those between.
    let order = (0..step).flat_map(|from| frames.iter().skip(from).step_by(step));
    let mut told: Vec<(NoiseModel, f32)> = Vec::new();
    for (tried, frame) in order.enumerate() {
        if tried >= LEARNED_FROM && !told.is_empty() {
            break;
        }
        let path = capture.image_path(frame);
        let failed = |source| Error::Stripe { path: path.clone(), source };
        let Ok(image) = reading.stripe(capture, frame) else { continue };
        let mut extractor = Extractor::new(options.clone()).map_err(failed)?;
        let learned = match stripe_view(&image).map_err(failed)? {
            StripeView::U8(view) => extractor.learn(view),
            StripeView::U16(view) => extractor.learn(view),
        };
        if learned.map_err(failed)? {
            told.extend(extractor.model());
        }
    }
    told.sort_unstable_by(|a, b| a.1.total_cmp(&b.1));
    if let Some((noise, width)) = told.get(told.len() / 2) {
        (options.noise, options.width_px) = (Some(*noise), Some(*width));
    }
    Ok(options)
}

/// The stripe of one image.
pub(crate) fn extract<'e>(
    extractor: &'e mut Extractor,
    image: &GrayImage,
    background: Option<&GrayImage>,
    path: &Path,
) -> Result<&'e Stripe, Error> {
    let stripe = |source| Error::Stripe { path: path.to_owned(), source };
    let dark = background.map(stripe_view).transpose().map_err(stripe)?;
    match (stripe_view(image).map_err(stripe)?, dark) {
        (StripeView::U8(view), Some(StripeView::U8(dark))) => extractor.extract(view, Some(dark)),
        (StripeView::U16(view), Some(StripeView::U16(dark))) => extractor.extract(view, Some(dark)),
        (StripeView::U8(view), _) => extractor.extract(view, None),
        (StripeView::U16(view), _) => extractor.extract(view, None),
    }
    .map_err(stripe)
}

/// Which coordinate stripes are measured along: the one in which more of them are found.
pub(crate) fn direction(captures: &[(&Capture, Reading, u8)]) -> Result<Across, Error> {
    let frames: Vec<(&Capture, Reading, u8, &FrameRecord)> = captures
        .iter()
        .flat_map(|&(capture, reading, bits)| {
            capture.present().filter(|f| f.laser_on).map(move |f| (capture, reading, bits, f))
        })
        .collect();
    let step = frames.len().div_ceil(DIRECTION_SAMPLES).max(1);
    let (mut along_u, mut along_v) = (0, 0);
    for &(capture, reading, bits, frame) in frames.iter().step_by(step) {
        // An image that can't be read is reported where all of them are.
        let Ok(image) = reading.stripe(capture, frame) else { continue };
        let path = capture.image_path(frame);
        for (across, found) in [(Across::U, &mut along_u), (Across::V, &mut along_v)] {
            let mut extractor = extractor(across, bits, true)
                .map_err(|source| Error::Stripe { path: path.clone(), source })?;
            *found += extract(&mut extractor, &image, None, &path)?.found();
        }
    }
    Ok(if along_v > along_u { Across::V } else { Across::U })
}
