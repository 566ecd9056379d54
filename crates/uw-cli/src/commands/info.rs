//! `uwscan info`: what a file or capture folder holds, and whether it is sound.

mod capture;
mod cloud;
mod instrument;
mod mesh;

use std::path::{Path, PathBuf};

use anyhow::bail;
use serde::Serialize;
use uwscan::io::{Error, Problem, Rig, calibration_toml, clouds, meshes, recording};

use crate::{
    console::Console,
    exit::{Outcome, chain},
    output::{self, Lost},
};

/// Arguments of `info`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Capture folder, recording, calibration.toml, rig.toml, point cloud or mesh
    file: PathBuf,
    /// Print one JSON object instead of text
    #[arg(long)]
    json: bool,
}

/// What a file holds.
struct Content {
    what: What,
    text: String,
    warnings: Vec<String>,
    problems: Vec<Problem>,
}

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum What {
    Capture(Box<capture::Record>),
    Rig { rig: Box<Rig> },
    Calibration(Box<instrument::Record>),
    Cloud(cloud::Record),
    Mesh(mesh::Record),
}

#[derive(Serialize)]
struct Record<'a> {
    file: String,
    sound: bool,
    #[serde(flatten)]
    what: Option<&'a What>,
    warnings: Vec<String>,
    lost: Vec<Lost>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

/// Looks, and prints what is there. A file that is not sound fails; a capture with lost images is done with loss.
///
/// # Errors
/// The file is not sound, or of no kind that is known.
pub fn run(args: &Args, console: &Console) -> anyhow::Result<Outcome> {
    let file = args.file.display().to_string();
    let mut noted = Vec::new();
    let content = match look(&args.file, &mut noted, console) {
        Ok(content) => content,
        Err(error) => {
            console.problems(&noted);
            if args.json {
                output::json(&Record {
                    file,
                    sound: false,
                    what: None,
                    warnings: output::warnings(&[], &noted),
                    lost: output::lost(&noted),
                    error: Some(chain(&error)),
                })?;
            }
            return Err(error);
        }
    };
    let outcome = console.problems(&content.problems);
    content.warnings.iter().for_each(|warning| console.warn(warning));
    if args.json {
        output::json(&Record {
            file,
            sound: outcome == Outcome::Done,
            what: Some(&content.what),
            warnings: output::warnings(&content.warnings, &content.problems),
            lost: output::lost(&content.problems),
            error: None,
        })?;
    } else {
        let verdict = if outcome == Outcome::Done { "sound" } else { "usable, with losses" };
        output::print(format!("{file}: {verdict}\n{}", content.text))?;
    }
    Ok(outcome)
}

/// What the file holds; where it is not sound, what was found before that is added to `noted`.
fn look(path: &Path, noted: &mut Vec<Problem>, console: &Console) -> anyhow::Result<Content> {
    // What is not there has no kind, whatever its name ends in.
    path.metadata().map_err(Error::file(path, "open"))?;
    let ends = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    if path.is_dir() || ends(recording::ENDING) {
        return capture::look(path, noted, console);
    }
    if ends("toml") {
        return toml(path, noted, console);
    }
    if meshes::is_mesh(path)? {
        return Ok(mesh::look(path)?);
    }
    match clouds::Format::of(path) {
        Ok(_) => Ok(cloud::look(path)?),
        Err(_) => bail!(
            "{}: this is neither a capture folder nor a .mcap or .toml file, nor one whose name ends in {} or {}; give one of these",
            path.display(),
            clouds::ENDINGS,
            meshes::ENDINGS
        ),
    }
}

/// A TOML file is what its `format` says.
fn toml(path: &Path, noted: &mut Vec<Problem>, console: &Console) -> anyhow::Result<Content> {
    if path.file_name().is_some_and(|name| name == "capture.toml") {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        return capture::look(folder.unwrap_or(Path::new(".")), noted, console);
    }
    match calibration_toml::read(path) {
        Err(Error::Format { .. }) => {}
        read => return Ok(instrument::calibration(read?, console)),
    }
    match Rig::read(path) {
        Err(Error::Format { got, .. }) => bail!(
            "{}: this is {got}, but of a .toml file \"uwscan-rig\", \"uwscan-calibration\" and \"uwscan-capture\" (named \
             capture.toml) are known; give one of these, or begin it with its format",
            path.display()
        ),
        read => Ok(instrument::rig(read?)),
    }
}
