//! `uwscan clean`.

use std::time::Instant;

use anyhow::{Context, anyhow};
use serde::Serialize;
use uwscan::{
    cloud::{
        NORMAL_NEIGHBOURS, PointCloud, averaged, cropped, normals, sheet_outliers, sparse_outliers, thinned,
        thinned_by_curvature,
    },
    io::{atomic, clouds},
};

use crate::{
    cloud_file::CloudFile,
    commands::WriteArgs,
    console::Console,
    exit::Outcome,
    output::{self, Lost},
    text::{coordinates, length, number},
};

/// Arguments of `clean`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Point cloud
    #[arg(value_parser = CloudFile::parser())]
    cloud: CloudFile,
    /// Cloud to write
    #[arg(short, long, value_name = "FILE", value_parser = CloudFile::parser())]
    output: CloudFile,
    /// Keep what lies in this box, mm; either end may be left out: ,,:900 keeps what is nearer than 900 mm
    #[arg(long, value_name = "X0:X1,Y0:Y1,Z0:Z1", value_parser = region, allow_hyphen_values = true)]
    crop: Option<Region>,
    /// Take out points that are farther from their neighbours, or off the plane of those in line and voltage, than so many sigmas [with no
    /// other step: 5]
    #[arg(long, value_name = "SIGMAS", num_args = 0..=1, default_missing_value = "5", value_parser = limit)]
    outliers: Option<f64>,
    /// Add the surface's normal at each point, towards the sensor
    #[arg(long)]
    normals: bool,
    /// Where the points were seen from, in the cloud's frame, mm [default: its origin]
    #[arg(long, value_name = "X,Y,Z", value_parser = coordinates, allow_hyphen_values = true)]
    sensor: Option<[f64; 3]>,
    /// Keep about one point in a cube of this size
    #[arg(long, value_name = "MM", value_parser = length, conflicts_with_all = ["thin_curvature", "average"])]
    thin: Option<f64>,
    /// Keep few points where the surface is flat and many where it bends: those left out lie within this distance of the others' surface
    #[arg(long, value_name = "MM", value_parser = length, conflicts_with = "average")]
    thin_curvature: Option<f64>,
    /// Make the points in each cube of this size one, at their mean
    #[arg(long, value_name = "MM", value_parser = length)]
    average: Option<f64>,
    /// Write a PLY or PCD as text rather than binary
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    written: WriteArgs,
}

/// A box, its ends infinite where they were left out.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Region {
    low: [f64; 3],
    high: [f64; 3],
}

fn region(text: &str) -> Result<Region, String> {
    const FORM: &str = "give three ranges between commas, such as -50:50,:20,800:900";
    let mut region = Region { low: [f64::NEG_INFINITY; 3], high: [f64::INFINITY; 3] };
    let ranges: Vec<&str> = text.split(',').collect();
    if ranges.len() != 3 {
        return Err(FORM.to_owned());
    }
    for (axis, range) in ranges.iter().enumerate().filter(|(_, range)| !range.trim().is_empty()) {
        let (low, high) = range.split_once(':').ok_or_else(|| FORM.to_owned())?;
        for (end, into) in [(low, &mut region.low[axis]), (high, &mut region.high[axis])] {
            if !end.trim().is_empty() {
                *into =
                    end.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| FORM.to_owned())?;
            }
        }
        if region.low[axis] > region.high[axis] {
            return Err(format!("the range {range} is empty"));
        }
    }
    Ok(region)
}

fn limit(text: &str) -> Result<f64, String> {
    number(text, 1.0, 100.0, "")
}

#[derive(Serialize)]
struct Record {
    points_in: usize,
    points: usize,
    outside_crop: usize,
    lonely: usize,
    /// `null` where the cloud does not tell line, voltage and sigma.
    off_sheet: Option<usize>,
    thinned: usize,
    without_normal: Option<usize>,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    seconds: f64,
}

/// Does the steps in turn (crop, outliers, normals, thinning), writes the cloud and prints what was taken out.
///
/// # Errors
/// A file can't be read or written, or no point is left.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let began = Instant::now();
    let overwrite = args.written.overwrite();
    atomic::check(&args.output.path, overwrite)?;
    let (mut cloud, problems) = clouds::read(&args.cloud.path)?;
    let outcome = console.problems(&problems);
    let named = || args.cloud.path.display().to_string();
    let mut warnings = Vec::new();
    let mut record = Record {
        points_in: cloud.len(),
        points: 0,
        outside_crop: 0,
        lonely: 0,
        off_sheet: None,
        thinned: 0,
        without_normal: None,
        warnings: Vec::new(),
        lost: output::lost(&problems),
        seconds: 0.0,
    };
    if let Some(region) = args.crop {
        let kept = cropped(&cloud, &region.low, &region.high);
        record.outside_crop = cloud.len() - kept.len();
        cloud = cloud.selected(&kept);
    }
    if let Some(limit) = outlier_limit(args) {
        cloud = without_outliers(&cloud, limit, &mut record).with_context(named)?;
        if record.off_sheet.is_none() {
            warnings.push(
                "the cloud has no frame, pixel and sigma: points were judged by their distances alone"
                    .to_owned(),
            );
        }
    }
    if args.normals {
        let found =
            normals(&cloud, NORMAL_NEIGHBOURS, &args.sensor.unwrap_or_default()).with_context(named)?;
        record.without_normal = Some(found.iter().filter(|n| n.is_none()).count());
        let stored = found.into_iter().map(|n| n.map_or([0.0; 3], |n| n.map(|c| c as f32))).collect();
        cloud = cloud.with_normals(stored).with_context(named)?;
    }
    let before = cloud.len();
    cloud = fewer(args, cloud);
    record.thinned = before - cloud.len();
    if cloud.is_empty() {
        return Err(anyhow!("{}: no point is left", named()));
    }
    let format = args.output.written_as(args.ascii);
    clouds::write(&args.output.path, overwrite, &cloud, format)?;
    warnings.iter().for_each(|warning| console.warn(warning));
    record.points = cloud.len();
    record.warnings = output::warnings(&warnings, &problems);
    record.seconds = began.elapsed().as_secs_f64();
    if args.written.json {
        output::json(&record)?;
    } else {
        output::print(text(args, &record))?;
    }
    Ok(outcome)
}

/// What was asked for, or the usual where nothing was.
fn outlier_limit(args: &Args) -> Option<f64> {
    const USUAL: f64 = 5.0;
    let other = args.crop.is_some()
        || args.normals
        || [args.thin, args.thin_curvature, args.average].iter().any(Option::is_some);
    args.outliers.or((!other).then_some(USUAL))
}

fn without_outliers(cloud: &PointCloud, limit: f64, record: &mut Record) -> anyhow::Result<PointCloud> {
    let lonely = sparse_outliers(cloud, limit)?;
    let off = sheet_outliers(cloud, limit);
    record.lonely = lonely.iter().filter(|out| **out).count();
    let only_off =
        |off: &Vec<bool>| off.iter().zip(&lonely).filter(|(off, lonely)| **off && !**lonely).count();
    record.off_sheet = off.as_ref().map(only_off);
    let sound = |i: &usize| !lonely[*i] && off.as_ref().is_none_or(|off| !off[*i]);
    Ok(cloud.selected(&(0..cloud.len()).filter(sound).collect::<Vec<_>>()))
}

fn fewer(args: &Args, cloud: PointCloud) -> PointCloud {
    if let Some(size) = args.thin {
        return cloud.selected(&thinned(&cloud, size));
    }
    if let Some(tolerance) = args.thin_curvature {
        return cloud.selected(&thinned_by_curvature(&cloud, tolerance));
    }
    match args.average {
        Some(size) => averaged(&cloud, size),
        None => cloud,
    }
}

fn text(args: &Args, record: &Record) -> String {
    let mut text = format!(
        "{}: {} of {} points, {:.2} s\n",
        args.output.path.display(),
        record.points,
        record.points_in,
        record.seconds
    );
    let mut line = |count: usize, what: &str| {
        if count > 0 {
            text += &format!("{count:>10}  {what}\n");
        }
    };
    line(record.outside_crop, "outside the box");
    line(record.lonely, "far from their neighbours");
    line(record.off_sheet.unwrap_or(0), "off the surface of those next to them in line and voltage");
    line(record.thinned, "thinned out");
    line(record.without_normal.unwrap_or(0), "left without a normal: their neighbours tell no plane");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_taken_whole_or_not_at_all() {
        let region = region("-50:50,:20,800:").unwrap();
        assert_eq!(
            (region.low, region.high),
            ([-50.0, f64::NEG_INFINITY, 800.0], [50.0, 20.0, f64::INFINITY])
        );
        assert!(super::region(",,:900").is_ok());
        for bad in ["", "1:2", "1:2,3:4", "a:b,,", "5:1,,", "1,2,3"] {
            assert!(super::region(bad).is_err(), "{bad}");
        }
    }
}
