//! Several stripes an image, against the truth of each.

use crate::scene::{Scene, to_u8};
use uw_stripe::{Extractor, Flags, Options, Reject, Stripe, StripeError, View};

const WIDTH: usize = 200;
const HEIGHT: usize = 240;
const SIGMA: f64 = 1.6;
/// Widths apart from which both stripes of a pair have to be measured.
const APART: f64 = 4.5;
/// Predicted sigma over scatter, some 400 lines each: 4 %, the rest is margin for what the other stripe adds.
const HONEST: std::ops::RangeInclusive<f64> = 0.85..=1.15;

type Centre<'a> = &'a dyn Fn(f64) -> f64;

/// Stripes of the given centres (NaN: none) and heights on 4 DN.
fn extract(stripes: &[(Centre<'_>, f64)], ranks: usize, seed: u64) -> Vec<Stripe> {
    let (first, rest) = stripes.split_first().unwrap();
    let height = |_: f64, v: f64| if first.0(v).is_nan() { 0.0 } else { first.1 };
    let others = |u: f64, v: f64| {
        let light = |s: &(Centre<'_>, f64)| {
            let t = (u - s.0(v)) / SIGMA;
            if t.is_nan() { 0.0 } else { s.1 * (-0.5 * t * t).exp() }
        };
        4.0 + rest.iter().map(light).sum::<f64>()
    };
    let centre = |v: f64| if first.0(v).is_nan() { 0.0 } else { first.0(v) };
    let scene = Scene {
        width: WIDTH,
        height: HEIGHT,
        centre: &centre,
        amplitude: &height,
        sigma: SIGMA,
        background: &others,
        electrons_per_dn: 40.0,
        read_noise_dn: 1.0,
        full_scale_dn: 255.0,
    };
    let image = to_u8(&scene.render(seed));
    let mut extractor = Extractor::new(Options { stripes: ranks, ..Options::default() }).unwrap();
    extractor.extract_all(View::packed(&image, WIDTH, HEIGHT).unwrap(), None).unwrap().to_vec()
}

/// Holds each rank to its stripe: found wherever no other is near, nowhere off, sigmas as the scatter.
fn hold(name: &str, stripes: &[(Centre<'_>, f64)]) {
    let (mut squares, mut count) = (0.0, 0.0);
    for seed in 0..2 {
        let found = extract(stripes, stripes.len(), seed);
        for (rank, (centre, _)) in stripes.iter().enumerate() {
            for line in 0..HEIGHT {
                let truth = centre(line as f64);
                // A line holds all of the stripe or none.
                let edge = [-0.5, 0.5].map(|d| centre(line as f64 + d).is_nan());
                if edge[0] != edge[1] || edge[0] != truth.is_nan() {
                    continue;
                }
                let others =
                    stripes.iter().enumerate().filter(|(k, _)| *k != rank).map(|(_, s)| s.0(line as f64));
                let gap =
                    others.map(|o| (o - truth).abs()).filter(|d| !d.is_nan()).fold(f64::INFINITY, f64::min);
                let (at, reject) = (f64::from(found[rank].position_px[line]), found[rank].reject[line]);
                if truth.is_nan() {
                    assert!(at.is_nan(), "{name}, rank {rank}, line {line}: {at} where it is not");
                } else if at.is_nan() {
                    assert!(
                        gap < APART * SIGMA,
                        "{name}, rank {rank}, line {line}: {reject:?}, found {:?}",
                        found.iter().map(Stripe::found).collect::<Vec<_>>()
                    );
                } else {
                    let z = (at - truth) / f64::from(found[rank].sigma_px[line]);
                    assert!(z.abs() < 6.0, "{name}, rank {rank}, line {line}: {at} for {truth}, gap {gap}");
                    (squares, count) = (squares + z * z, count + 1.0);
                }
            }
        }
    }
    let honesty = f64::sqrt(count / squares);
    assert!(HONEST.contains(&honesty), "{name}: sigma over scatter {honesty}");
}

#[test]
fn parallel_stripes_keep_their_ranks() {
    let stripe = |at: f64| move |v: f64| at + 0.1 * v + 4.0 * (v / 40.0).sin();
    let (a, b, c) = (stripe(50.0), stripe(82.0), stripe(90.5));
    hold("parallel", &[(&a, 160.0), (&b, 120.0), (&c, 80.0)]);
}

#[test]
fn crossing_stripes_go_on_as_they_came() {
    let (a, b) = (|v: f64| 100.0 + 0.35 * (v - 120.0), |v: f64| 100.0 - 0.25 * (v - 120.0));
    hold("crossing", &[(&a, 120.0), (&b, 90.0)]);
}

#[test]
fn lines_on_which_stripes_merge_are_said_to() {
    let (a, b) = (|v: f64| 100.0 + 0.35 * (v - 120.0), |v: f64| 100.0 - 0.25 * (v - 120.0));
    let found = extract(&[(&a, 120.0), (&b, 90.0)], 2, 5);
    for stripe in &found {
        assert_eq!(stripe.reject[120], Some(Reject::Merged));
        let merged = stripe.reject.iter().filter(|r| **r == Some(Reject::Merged)).count();
        assert!((12..24).contains(&merged) && stripe.found() > HEIGHT - 30, "{merged}, {}", stripe.found());
        assert!(stripe.flags[20].contains(Flags::SEVERAL_PEAKS));
    }
    assert!((found[0].rival_ratio[20] * found[1].rival_ratio[20] - 1.0).abs() < 0.01);
}

#[test]
fn a_stripe_that_ends_leaves_its_rank_and_a_broken_one_comes_back_to_it() {
    let whole = |_: f64| 150.2;
    let ends = |v: f64| if v < 140.0 { 40.0 + 0.1 * v } else { f64::NAN };
    let broken = |v: f64| if (60.0..80.0).contains(&v) { f64::NAN } else { 90.4 - 0.05 * v };
    hold("ends", &[(&whole, 140.0), (&broken, 110.0), (&ends, 90.0)]);
}

#[test]
fn ranks_without_a_stripe_are_empty_and_the_first_is_the_single_one() {
    let one = |v: f64| 60.0 + 0.2 * v;
    let found = extract(&[(&one, 130.0)], 4, 3);
    assert_eq!(found.len(), 4);
    assert_eq!(found[0].found(), HEIGHT);
    for stripe in &found[1..] {
        assert_eq!((stripe.found(), stripe.len()), (0, HEIGHT));
        assert!(stripe.reject.iter().all(|r| *r == Some(Reject::NoSignal)));
    }
    for stripes in [0, 17] {
        let refused = Extractor::new(Options { stripes, ..Options::default() });
        assert!(matches!(refused, Err(StripeError::InvalidOption { name: "stripes", .. })));
    }
}
