//! Images of a capture, decoded one at a time where they are used, so that memory stays bounded.

use uw_calib::{GreyView, Layout, Samples, ViewError};
use uw_io::{Capture, Expect, FrameRecord, GrayImage, Pixels, Reduce, Rig, SaidBy};
use uw_stripe::{StripeError, View};

/// How a capture's images are read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    expect: Option<Expect>,
    wavelength_nm: f64,
}

impl Reading {
    pub(crate) fn new(rig: &Rig, said_by: SaidBy) -> Self {
        Self { expect: Some(Expect::of(&rig.camera, said_by)), wavelength_nm: rig.laser.wavelength_nm }
    }

    /// As an image that is like the others, where nothing else says what they are; not for stripes.
    pub(crate) fn like(image: &GrayImage) -> Self {
        let bits = (image.full_scale.checked_ilog2().unwrap_or(0) + 1) as u8;
        let expect = Expect { size: [image.width, image.height], bits, said_by: SaidBy::Others };
        Self { expect: Some(expect), wavelength_nm: 0.0 }
    }

    /// The image of a frame as a stripe shows best in it.
    pub(crate) fn stripe(&self, capture: &Capture, frame: &FrameRecord) -> Result<GrayImage, uw_io::Error> {
        capture.image(frame, Reduce::Wavelength(self.wavelength_nm), self.expect)
    }

    /// The image of a frame as the target shows best in it.
    pub(crate) fn board(&self, capture: &Capture, frame: &FrameRecord) -> Result<GrayImage, uw_io::Error> {
        capture.image(frame, Reduce::Luma, self.expect)
    }
}

/// The image as corner detection takes it.
pub(crate) fn grey_view(image: &GrayImage) -> Result<GreyView<'_>, ViewError> {
    let (width, height) = (image.width as usize, image.height as usize);
    let samples = match &image.data {
        Pixels::U8(data) => Samples::U8(data),
        Pixels::U16(data) => Samples::U16(data),
    };
    GreyView::new(samples, Layout { width, height, stride: width }, image.full_scale)
}

/// The image as stripe extraction takes it.
pub(crate) enum StripeView<'a> {
    /// 8 bits.
    U8(View<'a, u8>),
    /// Up to 16 bits.
    U16(View<'a, u16>),
}

pub(crate) fn stripe_view(image: &GrayImage) -> Result<StripeView<'_>, StripeError> {
    let (width, height) = (image.width as usize, image.height as usize);
    Ok(match &image.data {
        Pixels::U8(data) => StripeView::U8(View::packed(data, width, height)?),
        Pixels::U16(data) => StripeView::U16(View::packed(data, width, height)?),
    })
}

/// The laser-on frames of a scan in groups that share a background: the laser-off frame nearest in the order of capture.
pub(crate) fn by_background(capture: &Capture) -> Vec<(Option<&FrameRecord>, Vec<&FrameRecord>)> {
    let dark: Vec<&FrameRecord> = capture.present().filter(|f| !f.laser_on).collect();
    let mut groups: Vec<(Option<&FrameRecord>, Vec<&FrameRecord>)> = Vec::new();
    for frame in capture.present().filter(|f| f.laser_on) {
        let background = dark.iter().copied().min_by_key(|d| d.row.abs_diff(frame.row));
        match groups.last_mut() {
            Some((last, frames)) if last.map(|b| b.row) == background.map(|b| b.row) => frames.push(frame),
            _ => groups.push((background, vec![frame])),
        }
    }
    groups
}
