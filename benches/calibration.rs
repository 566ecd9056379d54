//! The joint adjustment against a dense solver of the same residuals and derivatives, in the same run.
//!
//! Images are read once, outside the timing. Compared on the fixtures' land and water calibrations together:
//! - `joint_adjustment`: one robust solve of the whole instrument from the same start to the same minimum. `eliminating_poses`
//!   is the library's solver; `dense` linearises the same model with the same damping and end, but factors the full normal
//!   matrix (globals and six unknowns a pose) by nalgebra's Cholesky. Linearisation is common to both, and most of the time.
//! - `one_step`: what differs between the two, the linear solve alone, at the start.
//! - `covariance`: elimination against the inverse of the full matrix, at the start.
//! - `calibration`: all of [`uw_calib::calibrate`], start values, three solves and outliers included.

#![allow(clippy::print_stdout, reason = "a benchmark tells the size of what it times")]

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{DVector, Vector6};
use std::hint::black_box;
use std::path::Path;
use uw_calib::lm::{self, Model, Normal, Options, Shape, Step};
use uw_calib::{Method, adjustment, calibrate};
use uwscan::pipeline::Silent;
use uwscan::pipeline::calibrate::{Settings, observe};

/// As the library solves its joint adjustment.
const OPTIONS: Options = Options { max_iterations: 60, lambda: 1e-9, tolerance_sigmas: 1e-3 };
/// Relative difference of the two minima's Σρ: both end a thousandth of a sigma from the minimum, in squares.
const SAME_MINIMUM: f64 = 1e-6;

/// The step of the damped full equations and its promised decrease of Σρ; `None` where the matrix is singular.
fn dense_step(normal: &Normal, lambda: f64) -> Option<(Step, f64)> {
    let Shape { globals, poses } = normal.shape();
    let (mut h, g) = normal.dense();
    let diagonal = h.diagonal();
    h.set_diagonal(&(&diagonal * (1.0 + lambda)));
    let delta: DVector<f64> = -h.cholesky()?.solve(&g);
    let decrease = (0..delta.len()).map(|i| delta[i] * (lambda * diagonal[i] * delta[i] - g[i])).sum();
    let pose = |k: usize| Vector6::from_fn(|i, _| delta[globals + 6 * k + i]);
    let step = Step { globals: delta.rows(0, globals).into_owned(), poses: (0..poses).map(pose).collect() };
    Some((step, decrease))
}

/// [`lm::solve`] without elimination; returns Σρ at the end and the linearisations made.
fn dense_solve<M: Model>(model: &M, start: &M::State) -> Option<(f64, usize)> {
    let mut state = start.clone();
    let mut normal = model.linearize(&state)?;
    let (mut lambda, mut iterations) = (OPTIONS.lambda, 1);
    'linearised: while iterations < OPTIONS.max_iterations {
        if dense_step(&normal, 0.0)?.1.max(0.0).sqrt() <= OPTIONS.tolerance_sigmas {
            break;
        }
        let mut growth = 2.0;
        loop {
            let (step, promised) = dense_step(&normal, lambda)?;
            let candidate = model.retract(&state, &step);
            let gain = model.cost(&candidate).map_or(f64::NEG_INFINITY, |cost| normal.cost() - cost);
            if gain > 0.0 {
                let factor = 1.0 - (2.0 * gain / promised - 1.0).powi(3);
                lambda *= factor.clamp(1.0 / 3.0, 2.0);
                normal = model.linearize(&candidate)?;
                state = candidate;
                iterations += 1;
                continue 'linearised;
            }
            if promised <= 64.0 * f64::EPSILON * normal.cost() {
                break 'linearised;
            }
            lambda *= growth;
            growth *= 2.0;
        }
    }
    Some((normal.cost(), iterations))
}

fn calibration(c: &mut Criterion) {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let captures = [fixtures.join("cal-air"), fixtures.join("cal-water")];
    let settings = Settings { rig: None, method: Method::Joint };
    let observed = observe(&captures, &settings, &Silent).expect("the fixtures are whole");
    let (observations, rig) = (observed.observations, observed.rig.to_calib().expect("the rig is sound"));
    let whole = adjustment(&observations, &rig).expect("the fixtures determine a calibration");

    let normal = whole.model.linearize(&whole.start).expect("the start is in the model's domain");
    let Shape { globals, poses } = normal.shape();
    let solved = lm::solve(&whole.model, whole.start.clone(), &OPTIONS).expect("the solver ends");
    let (cost, iterations) = dense_solve(&whole.model, &whole.start).expect("the dense solver ends");
    println!(
        "{} residuals, {globals} globals, {poses} poses: {} unknowns; {} linearisations, dense {iterations}",
        normal.rows(),
        globals + 6 * poses,
        solved.report.iterations
    );
    assert!(solved.report.converged());
    assert!((cost / solved.report.cost - 1.0).abs() < SAME_MINIMUM, "{cost} {:?}", solved.report);

    let mut group = c.benchmark_group("joint_adjustment");
    group.sample_size(10);
    group.bench_function("eliminating_poses", |b| {
        b.iter(|| lm::solve(&whole.model, black_box(whole.start.clone()), &OPTIONS));
    });
    group.bench_function("dense", |b| b.iter(|| dense_solve(&whole.model, black_box(&whole.start))));
    group.finish();

    let mut group = c.benchmark_group("one_step");
    group.bench_function("eliminating_poses", |b| b.iter(|| black_box(&normal).solve(OPTIONS.lambda)));
    group.bench_function("dense", |b| b.iter(|| dense_step(black_box(&normal), OPTIONS.lambda)));
    group.finish();

    let mut group = c.benchmark_group("covariance");
    group.bench_function("eliminating_poses", |b| b.iter(|| black_box(&normal).covariance()));
    group.bench_function("dense", |b| {
        b.iter(|| black_box(&normal).dense().0.cholesky().map(|factor| factor.inverse()));
    });
    group.finish();

    let mut group = c.benchmark_group("calibration");
    group.sample_size(10);
    group.bench_function("all", |b| b.iter(|| calibrate(black_box(&observations), &rig)));
    group.finish();
}

criterion_group!(joint, calibration);
criterion_main!(joint);
