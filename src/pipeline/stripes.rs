//! Stripes of images: extraction with the rig's full scale, and which way the stripe runs.

use crate::Error;
use crate::pipeline::load::{Reading, StripeView, stripe_view};
use std::collections::BTreeMap;
use std::path::Path;
use uw_calib::Across;
use uw_io::{Capture, FrameRecord, GrayImage};
use uw_stripe::{Axis, Extractor, Method, Options, Stripe, StripeError};

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

/// An extractor for images of `bits` significant bits.
pub(crate) fn extractor(across: Across, bits: u8, reject_edges: bool) -> Result<Extractor, StripeError> {
    let full_scale = ((1u32 << bits) - 1) as f32;
    Extractor::new(Options {
        // Each image by itself, bends corrected: what a measurement wants, whatever it takes.
        method: Method::Precise,
        axis: axis(across),
        full_scale_dn: Some(full_scale),
        reject_edges,
        ..Options::default()
    })
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
