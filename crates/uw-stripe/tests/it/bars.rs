//! Every method held to the Cramér–Rao bound, on every scene that it is for.

#![allow(clippy::print_stdout, reason = "figures of a bar that was missed")]

use crate::suite::{self, CAMERAS, CASES, CONTENDERS, Contender, Score, WIDTHS_PX, WRONG_PX, judge};

/// Images for each width and camera.
const SEEDS: u64 = 2;
/// Standard errors of a measured figure by which it may miss its bar.
const CHANCE: f64 = 3.0;
/// Predicted sigma over actual scatter.
const HONEST: [f64; 2] = [0.9, 1.1];
/// Share of lines with a wrong peak.
const WRONG: f64 = 0.01;

/// The likelihood method, with the noise given and with its own.
const PRECISE: &[Contender] = CONTENDERS.split_at(3).1;

/// What a scene asks.
struct Bar {
    /// Most that RMS over bound may be.
    over_bound: f64,
    /// Largest mean error for any width and camera, px.
    bias_px: f64,
    found: f64,
}

fn hold(name: &str, bar: &Bar) {
    let case = CASES.iter().find(|c| c.name == name).unwrap();
    println!("{:<48} {}", "", suite::HEADS);
    for (contender, score) in PRECISE.iter().zip(judge(case, PRECISE, SEEDS)) {
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
    hold("clean", &Bar { over_bound: 1.03, bias_px: 0.002, found: 0.99 });
}

#[test]
fn low_signal() {
    hold("low signal", &Bar { over_bound: 1.03, bias_px: 0.01, found: 0.95 });
}

#[test]
fn haze() {
    hold("haze", &Bar { over_bound: 1.2, bias_px: 0.02, found: 0.99 });
}

#[test]
fn saturation() {
    hold("saturated", &Bar { over_bound: 1.1, bias_px: 0.002, found: 0.99 });
}

#[test]
fn second_reflections() {
    hold("second reflection", &Bar { over_bound: 1.1, bias_px: 0.005, found: 0.99 });
}

#[test]
fn steep_stripes() {
    hold("steep", &Bar { over_bound: 1.1, bias_px: 0.01, found: 0.99 });
    hold("steep, sheared", &Bar { over_bound: 1.1, bias_px: 0.01, found: 0.99 });
}

/// RMS over a centre of gravity's where the image itself tells the noise.
#[test]
fn speckle() {
    const BY_CENTRE_OF_GRAVITY: f64 = 0.75;
    let case = CASES.iter().find(|c| c.name == "speckle").unwrap();
    let own = CONTENDERS.iter().position(|c| c.name == "precise, noise from the image").unwrap();
    let score = judge(case, &CONTENDERS[own..=own], SEEDS).remove(0);
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
    println!("{:.3} of a centre of gravity's {gravity:.3} px", score.rms_px() / gravity);
    assert!(score.found() >= 0.99 && score.wrong() <= WRONG, "{}", score.row());
    assert!(score.rms_px() <= BY_CENTRE_OF_GRAVITY * gravity, "{} against {gravity}", score.rms_px());
    assert_honest(&score, CHANCE * score.relative_error(), "speckle");
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
