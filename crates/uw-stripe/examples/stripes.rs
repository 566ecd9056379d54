//! Prints the stripe of each grey image given, as CSV: `cargo run -p uw-stripe --example stripes -- [--columns] IMAGE…`

#![allow(clippy::print_stdout, reason = "printing is what this example is for")]

use std::error::Error;
use uw_stripe::{Axis, Extractor, Method, Options, Stripe, View};

fn main() -> Result<(), Box<dyn Error>> {
    // The images may have nothing in common.
    let mut options = Options { method: Method::Precise, ..Options::default() };
    let mut files: Vec<String> = std::env::args().skip(1).collect();
    if files.first().is_some_and(|f| f == "--columns") {
        files.remove(0);
        options.axis = Axis::PerColumn;
    }
    let mut extractor = Extractor::new(options)?;
    println!("image,line,position_px,sigma_px,amplitude,width_px,background,chi2,rival_ratio,flags,reject");
    for (n, file) in files.iter().enumerate() {
        let image = image::open(file)?;
        let (width, height) = (image.width() as usize, image.height() as usize);
        if image.color().bytes_per_pixel() / image.color().channel_count() == 2 {
            let pixels = image.to_luma16();
            print(n, extractor.extract(View::packed(&pixels, width, height)?, None)?);
        } else {
            let pixels = image.to_luma8();
            print(n, extractor.extract(View::packed(&pixels, width, height)?, None)?);
        }
    }
    Ok(())
}

fn print(n: usize, s: &Stripe) {
    eprint_summary(s);
    for i in 0..s.len() {
        println!(
            "{n},{i},{:.4},{:.4},{:.2},{:.3},{:.2},{:.3},{:.3},{},{}",
            s.position_px[i],
            s.sigma_px[i],
            s.amplitude[i],
            s.width_px[i],
            s.background[i],
            s.chi2[i],
            s.rival_ratio[i],
            s.flags[i].bits(),
            s.reject[i].map_or("", uw_stripe::Reject::name),
        );
    }
}

#[allow(clippy::print_stderr, reason = "a summary beside the table")]
fn eprint_summary(s: &Stripe) {
    let rejected: Vec<String> =
        s.rejected().filter(|(_, n)| *n > 0).map(|(r, n)| format!("{} {n}", r.name())).collect();
    let n = s.noise;
    eprintln!(
        "{} found; {}; gain {:.2} e/DN, read noise {:.2} DN, speckle {:.3}",
        s.found(),
        rejected.join(", "),
        n.gain_e_per_dn,
        n.read_noise_dn,
        n.speckle_contrast
    );
}
