//! Every method held to the Cramér–Rao bound, on every scene that it is for.

#![allow(clippy::print_stdout, reason = "figures of a bar that was missed")]

use crate::optics::Camera;
use crate::others::OTHERS;
use crate::suite::{self, CAMERAS, CASES, CONTENDERS, Contender, Score, WIDTHS_PX, WRONG_PX, judge};
use uw_stripe::{Method, NoiseModel, Options};

/// Images for each width and camera.
const SEEDS: u64 = 2;
/// Standard errors of a measured figure by which it may miss its bar.
const CHANCE: f64 = 3.0;
/// Predicted sigma over actual scatter.
const HONEST: [f64; 2] = [0.9, 1.1];
/// RMS over a single line's bound that pooling along the ridge must reach.
const POOLED: f64 = 0.75;
/// Share of lines with a wrong peak.
const WRONG: f64 = 0.01;

/// The methods by name.
const ROBUST: [&str; 3] = ["robust", "precise", "precise, noise from the image"];
const SINGLE: [&str; 4] = ["fast", "robust", "precise", "precise, noise from the image"];
const RIDGE: [&str; 1] = ["ridge"];

/// What a scene asks.
struct Bar {
    /// Most that RMS over bound may be.
    over_bound: f64,
    /// Largest mean error for any width and camera, px.
    bias_px: f64,
    found: f64,
}

fn case(name: &str) -> &'static suite::Case {
    CASES.iter().chain(&OTHERS).find(|c| c.name == name).unwrap()
}

/// The method, whose settings [`judge`] takes.
fn method(name: &str) -> Contender {
    let found = CONTENDERS.iter().find(|c| c.name == name).unwrap();
    Contender { name: found.name, options: found.options }
}

fn hold(methods: &[&str], name: &str, bar: &Bar) {
    let contenders: Vec<Contender> = methods.iter().map(|m| method(m)).collect();
    println!("{:<48} {}", "", suite::HEADS);
    for (contender, score) in contenders.iter().zip(judge(case(name), &contenders, SEEDS)) {
        let who = format!("{}, {name}", contender.name);
        println!("{who:<48} {}", score.row());
        assert!(score.found() >= bar.found, "found {} {who}", score.found());
        assert!(score.wrong() <= WRONG, "wrong {} {who}", score.wrong());
        // An RMS of n errors is known to 1/√(2n) of itself.
        let slack = CHANCE * score.relative_error();
        assert!(score.over_bound() <= bar.over_bound * (1.0 + slack), "RMS {} {who}", score.over_bound());
        let (bias, error) = score.worst_bias_px();
        assert!(bias.abs() <= bar.bias_px + CHANCE * error, "bias {bias} {who}");
        assert_honest(&score, slack, &who);
    }
}

fn assert_honest(score: &Score, slack: f64, who: &str) {
    let range = HONEST[0] - slack..=HONEST[1] + slack;
    assert!(range.contains(&score.honesty()), "sigma over scatter {} {who}", score.honesty());
}

#[test]
fn clean_water() {
    hold(&SINGLE, "clean", &Bar { over_bound: 1.03, bias_px: 0.002, found: 0.99 });
    hold(&RIDGE, "clean", &Bar { over_bound: POOLED, bias_px: 0.002, found: 0.99 });
}

/// Scenes that nothing was made on: the bars of the suite's own.
#[test]
fn other_scenes() {
    let bar = |over_bound, found| Bar { over_bound, bias_px: 0.01, found };
    for (name, bar) in [
        ("narrow", bar(1.1, 0.99)),
        ("wide", bar(1.1, 0.99)),
        ("other cameras", bar(1.1, 0.99)),
        ("near the border", bar(1.2, 0.99)),
        ("uneven veil", bar(1.2, 0.99)),
        // A fifth of the lines are dark, two fifths lie beyond the end.
        ("dark gaps", bar(1.2, 0.75)),
        ("ends halfway", bar(1.2, 0.57)),
        ("defocus along", bar(1.1, 0.99)),
        ("saturated threefold", bar(1.1, 0.99)),
        ("shaded", bar(1.2, 0.99)),
    ] {
        hold(&ROBUST, name, &bar);
    }
    hold(&ROBUST[1..], "several glints", &bar(1.1, 0.9));
}

/// Three glints at once, two of them brighter than the stripe, on a third of the rows: more than the kernels' two candidates a block of rows.
#[test]
fn rows_without_glints_are_looked_at_by_themselves() {
    /// What the image's first rows get wrong, where a glint begins before the stripe does.
    const FIRST_ROWS: f64 = 0.02;
    let methods = ["fast", "robust", "ridge"].map(method);
    for (method, score) in methods.iter().zip(judge(case("several glints"), &methods, SEEDS)) {
        assert!(score.found() > 0.99, "{} {}", method.name, score.row());
        assert!(method.name == "fast" || score.wrong() < FIRST_ROWS, "{} {}", method.name, score.row());
    }
}

/// One on every fifth line, far brighter than the stripe.
#[test]
fn hot_pixels() {
    hold(&SINGLE[..2], "hot pixels, low signal", &Bar { over_bound: 1.05, bias_px: 0.01, found: 0.99 });
    hold(&RIDGE, "hot pixels, low signal", &Bar { over_bound: POOLED, bias_px: 0.015, found: 0.99 });
    // Where they lie on the stripe itself, its centre is lost with them.
    for method in [&SINGLE[1..], &RIDGE[..]].concat().into_iter().map(method) {
        let score = judge(case("hot pixels"), std::slice::from_ref(&method), SEEDS).remove(0);
        let row = score.row();
        println!("{:<48} {row}", method.name);
        assert!(
            score.found() > 0.99 && score.wrong() < 0.001 && score.rms_px() < 0.06,
            "{} {row}",
            method.name
        );
    }
}

#[test]
fn low_signal() {
    hold(&SINGLE, "low signal", &Bar { over_bound: 1.03, bias_px: 0.01, found: 0.95 });
    hold(&RIDGE, "low signal", &Bar { over_bound: POOLED, bias_px: 0.015, found: 0.95 });
}

#[test]
fn haze() {
    hold(&ROBUST, "haze", &Bar { over_bound: 1.2, bias_px: 0.02, found: 0.99 });
    hold(&ROBUST, "haze, long tails", &Bar { over_bound: 1.2, bias_px: 0.02, found: 0.99 });
    hold(&RIDGE, "haze", &Bar { over_bound: 1.2, bias_px: 0.02, found: 0.99 });
}

#[test]
fn saturation() {
    hold(&SINGLE, "saturated", &Bar { over_bound: 1.1, bias_px: 0.002, found: 0.99 });
}

#[test]
fn second_reflections() {
    hold(&ROBUST, "second reflection", &Bar { over_bound: 1.1, bias_px: 0.005, found: 0.99 });
    hold(&RIDGE, "second reflection", &Bar { over_bound: POOLED, bias_px: 0.005, found: 0.99 });
}

#[test]
fn steep_stripes() {
    for name in ["steep", "steep, sheared"] {
        hold(&SINGLE, name, &Bar { over_bound: 1.1, bias_px: 0.01, found: 0.99 });
        hold(&RIDGE, name, &Bar { over_bound: POOLED, bias_px: 0.01, found: 0.99 });
    }
}

/// Edges of brightness move a centre by what no line shows: sigmas cannot be exact, and must not be far too small.
#[test]
fn albedo_edges() {
    const NOT_FAR_OFF: [f64; 2] = [0.65, 1.2];
    let contenders: Vec<Contender> = ROBUST.iter().map(|m| method(m)).collect();
    for (contender, score) in contenders.iter().zip(judge(case("albedo edges"), &contenders, SEEDS)) {
        println!("{:<48} {}", contender.name, score.row());
        assert!(score.found() >= 0.96 && score.wrong() <= WRONG, "{}", score.row());
        assert!((NOT_FAR_OFF[0]..=NOT_FAR_OFF[1]).contains(&score.honesty()), "{}", score.row());
    }
}

/// Grains as strong as they come, one of which passes for a stripe: the stripe's width is that of many lines together.
#[test]
fn strong_speckle() {
    const FOUND: f64 = 0.93;
    const NOT_FAR_OFF: [f64; 2] = [0.75, 1.2];
    let contenders: Vec<Contender> = ROBUST.iter().map(|m| method(m)).collect();
    for (contender, score) in contenders.iter().zip(judge(case("strong speckle"), &contenders, SEEDS)) {
        println!("{:<48} {}", contender.name, score.row());
        assert!(score.found() >= FOUND && score.wrong() <= WRONG, "{}", score.row());
        assert!((NOT_FAR_OFF[0]..=NOT_FAR_OFF[1]).contains(&score.honesty()), "{}", score.row());
    }
}

/// The camera's noise with a speckle contrast that is about right for the scene.
fn speckled(camera: &Camera) -> Options {
    let noise = NoiseModel { speckle_contrast: 0.3, ..suite::photon_transfer(camera) };
    Options { method: Method::Precise, noise: Some(noise), ..Options::default() }
}

/// RMS over a centre of gravity's, with the camera's noise given and without: the image itself tells the speckle.
#[test]
fn speckle() {
    const BY_CENTRE_OF_GRAVITY: f64 = 0.75;
    let case = case("speckle");
    let mut contenders: Vec<Contender> = ROBUST.iter().map(|m| method(m)).collect();
    contenders.push(Contender { name: "precise, speckle given", options: speckled });
    let (mut squares, mut lines) = (0.0, 0.0);
    for (camera, width) in CAMERAS.iter().flat_map(|c| WIDTHS_PX.map(|w| (c, w))) {
        let scene = (case.make)(width, *camera);
        let image = scene.expose(0).shoot(1);
        for (line, row) in image.chunks_exact(scene.width).enumerate() {
            let error = centre_of_gravity(row) - (scene.centre)(line as f64);
            if error.abs() <= WRONG_PX {
                (squares, lines) = (squares + error * error, lines + 1.0);
            }
        }
    }
    let gravity: f64 = f64::sqrt(squares / lines);
    for (contender, score) in contenders.iter().zip(judge(case, &contenders, SEEDS)) {
        let who = format!("{}, speckle", contender.name);
        println!("{who:<48} {}", score.row());
        println!("{:.3} of a centre of gravity's {gravity:.3} px", score.rms_px() / gravity);
        assert!(score.found() >= 0.99 && score.wrong() <= WRONG, "{who}: {}", score.row());
        assert!(score.rms_px() <= BY_CENTRE_OF_GRAVITY * gravity, "{who}: {} by {gravity}", score.rms_px());
        assert_honest(&score, CHANCE * score.relative_error(), &who);
    }
}

/// The usual one, at the threshold that does best on these scenes: a fifth of the way from the line's least to its largest value.
fn centre_of_gravity(row: &[u16]) -> f64 {
    const THRESHOLD: f64 = 0.2;
    let (low, high) = row.iter().fold((u16::MAX, 0), |(l, h), v| (l.min(*v), h.max(*v)));
    let level = f64::from(low) + THRESHOLD * f64::from(high - low);
    let weights = row.iter().zip(0..).map(|(v, i)| ((f64::from(*v) - level).max(0.0), f64::from(i)));
    let (mass, moment) = weights.fold((0.0, 0.0), |(m, s), (w, i)| (m + w, s + w * i));
    moment / mass
}
