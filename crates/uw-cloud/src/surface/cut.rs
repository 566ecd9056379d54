//! Which triangles of the plane are surface, and which only span what was not seen.

use super::delaunay::Flat;
use super::noise::Noise;
use super::normals::{Faces, Incident};
use super::step::{Limits, cut_steps};
use super::void::{Span, spans};
use crate::cloud::PointCloud;
use crate::mesh::NONE;
use crate::robust::rejection_limit;
use nalgebra::Vector3;

/// Rounds of cutting steps: each has normals from what the one before left.
const STEP_ROUNDS: usize = 3;

/// Why triangles were left out, and how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Cut {
    /// They span a void: an empty circle that the density of points about it does not explain.
    pub voids: usize,
    /// They stand along the line of sight or along the laser's light, as the border of an occlusion does and no surface that was
    /// measured.
    pub grazing: usize,
    /// They lead from one face to another across a step in depth.
    pub steps: usize,
    /// They close a gap that the camera could not see or that the light did not reach, behind an outline or in a shadow; or they are left by themselves, so that
    /// nothing tells whether they do.
    pub unseen: usize,
}

/// Returns which triangles are surface, how many of the others there are, and whether the plane's order of corners faces away from the sensor.
pub(super) fn cut(
    cloud: &PointCloud,
    places: &[[f64; 2]],
    flat: &Flat,
    noise: &Noise<'_>,
    sensor_mm: Vector3<f64>,
    steepest_rad: f64,
) -> (Vec<bool>, Cut, bool) {
    let incident = Incident::new(&flat.triangles, places.len());
    let mut cut = Cut::default();
    let spans = spans(cloud, places, flat, &incident, noise);
    let mut kept: Vec<bool> = spans.iter().map(|span| !matches!(span, Span::Void | Span::Unlit)).collect();
    cut.voids = spans.iter().filter(|span| **span == Span::Void).count();
    cut.unseen = spans.iter().filter(|span| **span == Span::Unlit).count();
    let (normals, grazing, away) = normals_to(cloud, flat, noise, sensor_mm, steepest_rad, &mut kept);
    cut.grazing = grazing;
    let mut faces = Faces::new(flat, &incident, &normals, &kept);
    let limits = Limits::of(cloud, noise, &faces, &kept);
    let mut asked: Vec<u32> = (0..kept.len() as u32).collect();
    for round in 0..STEP_ROUNDS {
        if round > 0 {
            // Elsewhere nothing has changed.
            asked = faces.renew(&kept);
        }
        let more = cut_steps(cloud, noise, &limits, &spans, &mut kept, &mut faces, &asked);
        if more.steps + more.unseen == 0 {
            break;
        }
        cut.steps += more.steps;
        cut.unseen += more.unseen;
    }
    cut.unseen += cut_lone(flat, &mut kept);
    (kept, cut, away)
}

/// Cuts single triangles and pairs of them that hang together with no other by an edge, and returns how many: the faces at their corners are their own, so that nothing tells
/// whether they keep to any. Such are left at the ends of an outline. Where there is nothing else, they stay.
fn cut_lone(flat: &Flat, kept: &mut [bool]) -> usize {
    let beside = |t: usize| {
        let across = flat.across[t].into_iter().filter(|&other| other != NONE && kept[other as usize]);
        across.map(|other| other as usize)
    };
    let all = || (0..kept.len()).filter(|&t| kept[t]);
    if !all().any(|t| beside(t).count() > 1) {
        return 0;
    }
    let is_lone = |t: &usize| {
        let mut own = beside(*t);
        match (own.next(), own.next()) {
            (None, _) => true,
            (Some(other), None) => beside(other).count() == 1,
            _ => false,
        }
    };
    let lone: Vec<usize> = all().filter(is_lone).collect();
    lone.iter().for_each(|&t| kept[t] = false);
    lone.len()
}

/// Returns unit normals of the triangles in space, all on the side of the sensor as the plane's order of corners has it, and cuts those triangles that stand along the line of
/// sight or along the light, whose number comes second, and those without an area; and whether the normals had to be turned.
fn normals_to(
    cloud: &PointCloud,
    flat: &Flat,
    noise: &Noise<'_>,
    sensor_mm: Vector3<f64>,
    steepest_rad: f64,
    kept: &mut [bool],
) -> (Vec<Vector3<f64>>, usize, bool) {
    let steepest2 = steepest_rad.cos().powi(2);
    let limit = rejection_limit(flat.triangles.len());
    let mut towards = 0_i64;
    let mut grazing = 0;
    let normal_of = |(corners, kept): (&[u32; 3], &mut bool)| {
        let corner @ [a, b, c] = corners.map(|v| cloud.vector(v as usize));
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else {
            *kept = false;
            return Vector3::zeros();
        };
        if *kept {
            towards += if normal.dot(&(sensor_mm - a)) < 0.0 { -1 } else { 1 };
            // A small triangle that its points' noise has tipped over is no occlusion: it has to reach farther than that.
            let stands = |ray: &Vector3<f64>| {
                normal.dot(ray).powi(2) < steepest2 * ray.norm_squared() && {
                    let ray = ray.normalize();
                    let depth = corner.map(|p| p.dot(&ray));
                    let reach = depth.iter().fold(f64::MIN, |a, b| a.max(*b))
                        - depth.iter().fold(f64::MAX, |a, b| a.min(*b));
                    let variance: f64 = corners.iter().map(|&v| noise.along(v, &ray)).sum();
                    reach > limit * variance.sqrt()
                }
            };
            let view = sensor_mm - (a + b + c) / 3.0;
            if stands(&view) || noise.light(corners[0]).as_ref().is_some_and(stands) {
                *kept = false;
                grazing += 1;
            }
        }
        normal
    };
    let mut normals: Vec<Vector3<f64>> = flat.triangles.iter().zip(kept).map(normal_of).collect();
    if towards < 0 {
        normals.iter_mut().for_each(|normal| *normal = -*normal);
    }
    (normals, grazing, towards < 0)
}
