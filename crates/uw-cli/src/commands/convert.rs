//! `uwscan convert`: the endings of the two names tell what is wanted.

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::{ValueEnum, error::ErrorKind};
use serde::Serialize;
use uwscan::io::{
    Capture, Error, Problem, atomic, calibration_toml,
    camera_yaml::{self, Form},
    clouds,
    convert::{Converted, to_folder, to_recording},
    meshes, recording,
    ros2::to_ros2,
};

use crate::{
    args::usage_error,
    commands::overwrite,
    console::Console,
    exit::Outcome,
    output::{self, Lost},
};

/// Arguments of `convert`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Capture folder, recording (.mcap), point cloud (.ply, .pcd, .xyz, .csv, .e57, .las, .laz), mesh (.ply, .stl, .obj) or calibration (.toml)
    input: PathBuf,
    /// A capture folder becomes a recording (.mcap), a recording a new folder, a cloud a cloud and a mesh a mesh of another ending
    output: PathBuf,
    /// Write a capture as ros2, a rosbag2 (MCAP with CDR messages, metadata.yaml) in a new folder; a calibration's camera as ros or opencv, their
    /// YAML files
    #[arg(long, value_name = "FORMAT")]
    to: Option<To>,
    /// Write a PLY, PCD or STL as text rather than binary
    #[arg(long)]
    ascii: bool,
    /// Replace the output if it exists; folders are never replaced
    #[arg(long)]
    force: bool,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum To {
    Ros2,
    Ros,
    #[value(name = "opencv")]
    OpenCv,
}

#[derive(Serialize)]
struct Record {
    file: String,
    #[serde(flatten)]
    counts: Counts,
    warnings: Vec<String>,
    lost: Vec<Lost>,
}

/// What was carried over, of what there was.
#[derive(Default, Serialize)]
struct Counts {
    #[serde(skip_serializing_if = "Option::is_none")]
    images: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    triangles: Option<usize>,
}

/// Converts and prints what came out.
///
/// # Errors
/// Nothing can be converted so, or a file can't be read or written.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    // What is not there has no kind, whatever its name ends in.
    args.input.metadata().map_err(Error::file(&args.input, "open"))?;
    let is_recording =
        |path: &Path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(recording::ENDING));
    if args.input.is_dir() || is_recording(&args.input) {
        if args.to.is_none() && args.input.is_dir() && !is_recording(&args.output) {
            bail!(
                "{}: a capture folder becomes a recording: give a name that ends in .{}",
                args.output.display(),
                recording::ENDING
            );
        }
        if matches!(args.to, Some(To::Ros | To::OpenCv)) {
            return Err(usage_error(
                ErrorKind::ArgumentConflict,
                "--to ros and --to opencv take a calibration",
            ));
        }
        return capture(args, console);
    }
    match args.to {
        Some(To::Ros2) => {
            Err(usage_error(ErrorKind::ArgumentConflict, "--to ros2 takes a capture folder or a recording"))
        }
        Some(To::Ros) => camera(args, Form::Ros, console),
        Some(To::OpenCv) => camera(args, Form::OpenCv, console),
        None if has_ending(&args.input, &["yaml", "yml"]) => bail!(
            "{}: a camera of ROS or OpenCV becomes no calibration: it lacks windows, galvanometer and laser; capture a board with the \
             instrument, and run uwscan calibrate",
            args.input.display()
        ),
        None if has_ending(&args.input, &["toml"]) => Err(usage_error(
            ErrorKind::MissingRequiredArgument,
            "a calibration's camera is written with --to ros or --to opencv",
        )),
        None if meshes::is_mesh(&args.input)? => mesh(args, console),
        None => cloud(args, console),
    }
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|e| endings.iter().any(|ending| e.eq_ignore_ascii_case(ending)))
}

fn camera(args: &Args, form: Form, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = overwrite(args.force);
    atomic::check(&args.output, overwrite)?;
    let (calibration, problems) = calibration_toml::read(&args.input)?;
    let outcome = console.problems(&problems);
    camera_yaml::write(&args.output, overwrite, &calibration, form)?;
    console.warn(camera_yaml::LOST);
    let warnings = [camera_yaml::LOST.to_owned()];
    tell(args, Counts::default(), "the camera, without its window", &warnings, &problems)?;
    Ok(outcome)
}

fn mesh(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = overwrite(args.force);
    let format = meshes::Format::of(&args.output)?;
    atomic::check(&args.output, overwrite)?;
    let (mesh, problems) = meshes::read(&args.input)?;
    let outcome = console.problems(&problems);
    let format = if args.ascii { format.as_text() } else { format };
    meshes::write(&args.output, overwrite, &mesh, format)?;
    let triangles = mesh.triangles().len();
    let what = format!("{triangles} triangles on {} vertices", mesh.vertices_mm().len());
    tell(args, Counts { triangles: Some(triangles), ..Counts::default() }, &what, &[], &problems)?;
    Ok(outcome)
}

fn capture(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = overwrite(args.force);
    let folder = args.input.is_dir();
    if folder && args.to.is_none() {
        atomic::check(&args.output, overwrite)?;
    }
    let mut noted = Vec::new();
    let opened = Capture::open_noting(&args.input, None, &mut noted);
    let mut capture = match opened {
        Ok(capture) => capture,
        Err(error) => {
            console.problems(&noted);
            return Err(error.into());
        }
    };
    let mut problems: Vec<Problem> = capture.take_problems();
    let converted = match (args.to, folder) {
        (Some(_), _) => to_ros2(&capture, &args.output),
        (None, true) => to_recording(&capture, &args.output, overwrite),
        (None, false) => to_folder(&capture, &args.output),
    };
    let Converted { images, problems: lost, warnings } = match converted {
        Ok(converted) => converted,
        Err(error) => {
            console.problems(&problems);
            return Err(error.into());
        }
    };
    problems.extend(lost);
    let outcome = console.problems(&problems);
    warnings.iter().for_each(|warning| console.warn(warning));
    let counts = Counts { images: Some(images), ..Counts::default() };
    tell(args, counts, &format!("{images} images"), &warnings, &problems)?;
    Ok(outcome)
}

fn cloud(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let overwrite = overwrite(args.force);
    if clouds::Format::of(&args.input).is_ok()
        && clouds::Format::of(&args.output).is_err()
        && meshes::Format::of(&args.output).is_ok()
    {
        bail!("{}: a cloud becomes a mesh by `uwscan mesh`, which finds its surface", args.output.display());
    }
    let format = clouds::Format::of(&args.output)?;
    atomic::check(&args.output, overwrite)?;
    let (cloud, problems) = clouds::read(&args.input)?;
    let outcome = console.problems(&problems);
    let format = if args.ascii { format.as_text() } else { format };
    clouds::write(&args.output, overwrite, &cloud, format)?;
    let points = cloud.len();
    tell(
        args,
        Counts { points: Some(points), ..Counts::default() },
        &format!("{points} points"),
        &[],
        &problems,
    )?;
    Ok(outcome)
}

/// Prints what came out.
fn tell(
    args: &Args,
    counts: Counts,
    what: &str,
    warnings: &[String],
    problems: &[Problem],
) -> anyhow::Result<()> {
    let file = args.output.display().to_string();
    if !args.json {
        return output::print(format!("{file}: {what}\n"));
    }
    let (warnings, lost) = (output::warnings(warnings, problems), output::lost(problems));
    output::json(&Record { file, counts, warnings, lost })
}
