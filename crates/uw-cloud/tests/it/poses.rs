//! Poses from anywhere: forms that tell them, parts of forms, forms that don't.

use crate::scene::{gauss, random, uniform};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::rngs::StdRng;
use uw_cloud::{
    Frame, NearestOnMesh, PointCloud, RegisterError, Registration, Start, TriangleMesh, register,
};

/// Noise of the points along the line of sight, mm.
const SIGMA_MM: f64 = 0.05;
/// Size of the forms, mm.
const RADIUS_MM: f64 = 50.0;
/// A pose from thousands of points is right to a few micrometres along what they determine well; a wrong one is off by millimetres.
const RIGHT_MM: f64 = 0.2;

/// A closed form: a ball whose radius follows its direction.
fn closed(radius: impl Fn(Vector3<f64>) -> f64) -> TriangleMesh {
    const ROUND: u32 = 120;
    const UP: u32 = 60;
    let mut vertices = vec![Vector3::z(), -Vector3::z()];
    for i in 1..UP {
        for j in 0..ROUND {
            let (t, p) = (f64::from(i) / f64::from(UP), f64::from(j) / f64::from(ROUND));
            let (t, p) = (t * std::f64::consts::PI, p * std::f64::consts::TAU);
            vertices.push(Vector3::new(t.sin() * p.cos(), t.sin() * p.sin(), t.cos()));
        }
    }
    let at = |i: u32, j: u32| 2 + (i - 1) * ROUND + j % ROUND;
    let mut triangles = Vec::new();
    for j in 0..ROUND {
        triangles.push([0, at(1, j), at(1, j + 1)]);
        triangles.push([1, at(UP - 1, j + 1), at(UP - 1, j)]);
        for i in 1..UP - 1 {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let vertices = vertices.into_iter().map(|d| (d * radius(d)).into()).collect();
    TriangleMesh::new(Frame::Camera, vertices, triangles).expect("corners are vertices")
}

/// A form that no motion maps onto itself.
fn lump(d: Vector3<f64>) -> f64 {
    RADIUS_MM
        * (1.0
            + 0.18 * (3.0 * d.x + 1.0).sin()
            + 0.15 * (4.0 * d.y - 2.0 * d.z).cos()
            + 0.12 * d.x * d.z
            + 0.1 * (5.0 * d.z + d.y).sin())
}

/// Where on a facet the points of a form lie.
#[derive(Clone, Copy, PartialEq)]
enum On {
    Facets,
    Form,
}

/// What a sensor 900 mm before a form in a pose sees of it, with noise along the sight: `keep` of its directions across. Points of the
/// form itself lie beside the facets of its mesh by what these sag.
fn seen(
    form: impl Fn(Vector3<f64>) -> f64,
    pose: &Isometry3<f64>,
    keep: f64,
    random: &mut StdRng,
) -> PointCloud {
    seen_on(On::Form, form, pose, keep, random)
}

fn seen_on(
    on: On,
    form: impl Fn(Vector3<f64>) -> f64,
    pose: &Isometry3<f64>,
    keep: f64,
    random: &mut StdRng,
) -> PointCloud {
    let mesh = closed(&form);
    let place = |v: u32| pose * Point3::from(mesh.vertices_mm()[v as usize]);
    let (mut points, mut pixels) = (Vec::new(), Vec::new());
    for t in mesh.triangles() {
        let [a, b, c] = t.map(|v| place(v).coords);
        let normal = (b - a).cross(&(c - a));
        let middle = (a + b + c) / 3.0;
        // Nothing that is seen at a grazing angle. What hides behind another bump is no matter here.
        if normal.dot(&-middle) < 0.3 * normal.norm() * middle.norm() {
            continue;
        }
        let (p, q) = (uniform(random, 0.0, 0.5), uniform(random, 0.0, 0.5));
        let facet = a + (b - a) * p + (c - a) * q;
        let direction = (pose.inverse() * Point3::from(facet)).coords.normalize();
        let point = match on {
            On::Facets => facet,
            On::Form => (pose * Point3::from(direction * form(direction))).coords,
        };
        points.push(point + point.normalize() * (SIGMA_MM * gauss(random)));
        pixels.push([(point.x / point.z * 1900.0) as f32, (point.y / point.z * 1900.0) as f32]);
    }
    let mut across: Vec<f64> = points.iter().map(|p| p.x).collect();
    across.sort_by(f64::total_cmp);
    let end = across[((across.len() - 1) as f64 * keep) as usize];
    let kept: Vec<usize> = (0..points.len()).filter(|&i| points[i].x <= end).collect();
    PointCloud::new(Frame::Camera, kept.iter().map(|&i| points[i].into()).collect())
        .with_pixels(kept.iter().map(|&i| pixels[i]).collect())
        .expect("one a point")
        .with_sigmas_mm(vec![SIGMA_MM as f32; kept.len()])
        .expect("one a point")
}

/// A pose that is anywhere, 900 mm before the sensor.
fn any_pose(random: &mut StdRng) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
        gauss(random),
        gauss(random),
        gauss(random),
        gauss(random),
    ));
    let shift = Vector3::new(uniform(random, -60.0, 60.0), uniform(random, -60.0, 60.0), 900.0);
    Isometry3::from_parts(shift.into(), turn)
}

/// How far a registration brings what it registered off, mm, at its middle and beside it.
fn off(found: &Registration, camera_from_mesh: &Isometry3<f64>) -> f64 {
    let middle = Vector3::from(found.middle_mm);
    let back = camera_from_mesh * found.mesh_from_cloud;
    let arms = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()].map(|a| a * RADIUS_MM);
    arms.iter()
        .map(|arm| (back * Point3::from(middle + arm) - Point3::from(middle + arm)).norm())
        .fold(0.0, f64::max)
}

#[test]
fn a_lump_is_found_in_any_pose_from_the_side_that_is_seen_or_a_part_of_it() {
    let mesh = closed(lump);
    let tree = NearestOnMesh::new(&mesh).unwrap();
    let mut random = random(11);
    for trial in 0..4 {
        let truth = any_pose(&mut random);
        let keep = [1.0, 0.6, 0.4, 0.8][trial % 4];
        let cloud = seen(lump, &truth, keep, &mut random);
        let found = register(&cloud, &tree, Start::Anywhere, 0.3).unwrap();
        assert!(off(&found, &truth) < RIGHT_MM, "trial {trial}: {} mm, {found:?}", off(&found, &truth));
        assert!(
            found.overlap > 0.95 && found.undetermined.is_empty() && found.rivals.is_empty(),
            "{found:?}"
        );
        assert!(!found.reversed);
    }
}

#[test]
fn a_cloud_of_which_a_part_overlaps_is_found_from_anywhere() {
    let whole = closed(lump);
    let mut random = random(12);
    for (trial, share) in [0.3, 0.45, 0.7].into_iter().enumerate() {
        let truth = any_pose(&mut random);
        let cloud = seen(lump, &truth, 1.0, &mut random);
        // The mesh ends where so many of the points lie on it.
        let mut across: Vec<f64> = cloud.positions_mm().iter().map(|p| p[0]).collect();
        across.sort_by(f64::total_cmp);
        let end = across[((across.len() - 1) as f64 * share) as usize];
        let inside = |t: &&[u32; 3]| {
            t.iter().all(|&v| (truth * Point3::from(whole.vertices_mm()[v as usize])).x < end)
        };
        let triangles = whole.triangles().iter().filter(inside).copied().collect();
        let part = TriangleMesh::new(Frame::Camera, whole.vertices_mm().to_vec(), triangles).unwrap();
        let tree = NearestOnMesh::new(&part).unwrap();
        let found = register(&cloud, &tree, Start::Anywhere, 0.2).unwrap();
        assert!(off(&found, &truth) < 2.0 * RIGHT_MM, "trial {trial}: {} mm, {found:?}", off(&found, &truth));
        assert!((found.overlap - share).abs() < 0.06, "{share}: {}", found.overlap);
    }
}

#[test]
fn a_reference_that_is_inside_out_is_found_and_told() {
    let mesh = closed(lump);
    let turned = mesh.triangles().iter().map(|&[a, b, c]| [a, c, b]).collect();
    let turned = TriangleMesh::new(Frame::Camera, mesh.vertices_mm().to_vec(), turned).unwrap();
    let mut random = random(13);
    let truth = any_pose(&mut random);
    let cloud = seen(lump, &truth, 1.0, &mut random);
    let found = register(&cloud, &NearestOnMesh::new(&turned).unwrap(), Start::Anywhere, 0.3).unwrap();
    assert!(off(&found, &truth) < RIGHT_MM && found.reversed, "{found:?}");
}

#[test]
fn a_ball_turns_as_it_will_and_a_spindle_about_its_axis() {
    let mut random = random(14);
    let round = |_| RADIUS_MM;
    let ball = closed(round);
    let truth = any_pose(&mut random);
    let cloud = seen(round, &truth, 1.0, &mut random);
    let found = register(&cloud, &NearestOnMesh::new(&ball).unwrap(), Start::Anywhere, 0.3).unwrap();
    assert_eq!(found.undetermined.len(), 3, "{found:?}");
    assert!(found.rivals.is_empty() && found.overlap > 0.95, "{found:?}");
    // Its middle comes to the ball's wherever it is turned.
    let middle = found.mesh_from_cloud * truth * Point3::origin();
    assert!(middle.coords.norm() < 0.05, "{middle}");

    // Of revolution about z, and not the same upside down.
    let turned = |d: Vector3<f64>| RADIUS_MM * (1.0 + 0.3 * d.z * d.z + 0.25 * d.z);
    let spindle = closed(turned);
    let truth = any_pose(&mut random);
    let cloud = seen(turned, &truth, 1.0, &mut random);
    let found = register(&cloud, &NearestOnMesh::new(&spindle).unwrap(), Start::Anywhere, 0.3).unwrap();
    assert_eq!(found.undetermined.len(), 1, "{found:?}");
    assert!(found.rivals.is_empty(), "{found:?}");
    let motion = found.undetermined[0];
    let axis = Vector3::from(motion.turn).normalize();
    assert!(axis.z.abs() > 0.95, "{motion:?}");
    let tip = found.mesh_from_cloud * truth * Point3::new(0.0, 0.0, RADIUS_MM);
    assert!((tip - Point3::new(0.0, 0.0, RADIUS_MM)).norm() < RIGHT_MM, "{tip}");
}

#[test]
fn a_form_with_several_ways_round_has_rivals() {
    // Three lobes about z.
    let form = |d: Vector3<f64>| {
        let round = d.y.atan2(d.x);
        RADIUS_MM * (1.0 + 0.15 * (3.0 * round).cos() * (1.0 - d.z * d.z) + 0.2 * d.z)
    };
    let lobes = closed(form);
    let mut random = random(15);
    let truth = any_pose(&mut random);
    let cloud = seen(form, &truth, 1.0, &mut random);
    let found = register(&cloud, &NearestOnMesh::new(&lobes).unwrap(), Start::Anywhere, 0.3).unwrap();
    assert!(found.undetermined.is_empty() && found.overlap > 0.9, "{found:?}");
    assert_eq!(found.rivals.len(), 2, "a third and two thirds of a turn: {found:?}");
    for rival in &found.rivals {
        let turn = (rival.rotation * found.mesh_from_cloud.rotation.inverse()).angle().to_degrees();
        assert!((turn - 120.0).abs() < 2.0, "{turn}°");
    }
}

#[test]
fn another_form_is_refused() {
    let mesh = closed(lump);
    let other = |d: Vector3<f64>| {
        RADIUS_MM * (1.0 + 0.2 * (4.0 * d.z + 2.0 * d.x).cos() - 0.2 * d.y * d.y + 0.15 * (6.0 * d.x).sin())
    };
    let tree = NearestOnMesh::new(&mesh).unwrap();
    let mut random = random(16);
    for _ in 0..2 {
        let truth = any_pose(&mut random);
        let cloud = seen(other, &truth, 1.0, &mut random);
        match register(&cloud, &tree, Start::Anywhere, 0.2) {
            Err(RegisterError::LittleOverlap { overlap, .. }) => assert!(overlap < 0.2, "{overlap}"),
            Err(RegisterError::Scattered { scatter_mm, .. }) => assert!(scatter_mm > 0.3, "{scatter_mm}"),
            found => panic!("{found:?}"),
        }
    }
}

#[test]
fn a_pose_scatters_by_its_covariance() {
    let mesh = closed(lump);
    let tree = NearestOnMesh::new(&mesh).unwrap();
    let mut random = random(17);
    const TRIALS: usize = 40;
    let mut chi2 = Vec::new();
    for _ in 0..TRIALS {
        let truth = any_pose(&mut random);
        let cloud = seen_on(On::Facets, lump, &truth, 0.5, &mut random);
        let start = Start::Near(truth.inverse(), 5.0);
        let found = register(&cloud, &tree, start, 0.5).unwrap();
        // The motion that is left, at the moved middle and along the mesh's axes.
        let left = found.mesh_from_cloud * truth;
        let middle = truth.inverse() * Point3::from(found.middle_mm);
        let (turn, shift) = (left.rotation.scaled_axis(), left * middle - middle);
        let error = nalgebra::Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        chi2.push(error.dot(&(found.covariance.try_inverse().unwrap() * error)));
    }
    let mean = chi2.iter().sum::<f64>() / TRIALS as f64;
    // Six degrees of freedom, and a standard error of sqrt(12 / 40); a half more for what neighbours share.
    assert!((4.2..8.0).contains(&mean), "{mean}");
}
