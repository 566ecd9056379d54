//! Every method held to the Cramér–Rao bound, on every scene that it is for.

#![allow(clippy::print_stdout, reason = "figures of a bar that was missed")]

use crate::suite::{self, CASES, CONTENDERS, Score, judge};

/// Images for each width and camera.
const SEEDS: u64 = 2;
/// Standard errors of a measured figure by which it may miss its bar.
const CHANCE: f64 = 3.0;
/// Predicted sigma over actual scatter.
const HONEST: [f64; 2] = [0.9, 1.1];
/// Share of lines with a wrong peak.
const WRONG: f64 = 0.01;

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
    for (contender, score) in CONTENDERS.iter().zip(judge(case, &CONTENDERS, SEEDS)) {
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
