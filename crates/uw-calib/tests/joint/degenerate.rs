use crate::synthetic::{Plan, world};
use uw_calib::{CalibError, calibrate};

fn outcome(plan: &Plan) -> Result<uw_calib::Calibration, CalibError> {
    let world = world(plan, 7);
    calibrate(&world.observations, &world.rig)
}

#[test]
fn parallel_boards_are_refused() {
    let error = outcome(&Plan { tilt_deg: 0.0, ..Plan::default() }).unwrap_err();
    assert!(matches!(error, CalibError::ParallelBoards { .. }), "{error}");
}

#[test]
fn one_voltage_is_refused() {
    let error = outcome(&Plan { voltages: vec![0.2], ..Plan::default() }).unwrap_err();
    assert!(matches!(error, CalibError::TooFewVoltages { got: 1, .. }), "{error}");
}

#[test]
fn two_poses_are_refused() {
    let error = outcome(&Plan { air_poses: 2, water_poses: 0, ..Plan::default() }).unwrap_err();
    assert!(matches!(error, CalibError::TooFewPoses { got: 2, .. }), "{error}");
}

#[test]
fn land_only_is_warned_of_with_the_accuracy_to_expect() {
    let warnings = outcome(&Plan { water_poses: 0, ..Plan::default() }).unwrap().warnings;
    assert!(warnings.iter().any(|w| w.contains("on land only") && w.contains("expect ±")), "{warnings:?}");
}

#[test]
fn one_distance_and_few_voltages_are_warned_of() {
    let plan = Plan { depth_mm: [800.0, 820.0], voltages: vec![-1.0, 1.0], ..Plan::default() };
    let warnings = outcome(&plan).unwrap().warnings;
    assert!(warnings.iter().any(|w| w.contains("nearer and some farther")), "{warnings:?}");
    assert!(warnings.iter().any(|w| w.contains("2 voltages only")), "{warnings:?}");
}

#[test]
fn a_good_set_is_not_warned_of() {
    assert_eq!(outcome(&Plan::default()).unwrap().warnings, Vec::<String>::new());
}
