//! The calibration's part of a measurement's uncertainty, as an argument.

use std::path::{Path, PathBuf};

use uwscan::{
    cloud::PointCloud,
    io::{Problem, calibration_toml, calibration_toml::CalibrationFile},
    pipeline::uncertainty::SharedErrors,
};

use crate::{console::Console, text::number};

/// The calibration that adds its part, and whose index of water counts.
#[derive(Debug, clap::Args)]
pub struct SharedArgs {
    /// The calibration that the cloud was reconstructed with: adds its part of the uncertainty, which all points share
    #[arg(short, long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Standard deviation of the water's index where reconstruct was given it (--water-index, or --temperature, --salinity and --depth), in
    /// place of the calibration's; 0 takes it as exact
    #[arg(long, value_name = "SIGMA", value_parser = index_sigma, requires = "calibration")]
    index_sigma: Option<f64>,
}

/// All of the difference between air and water.
fn index_sigma(text: &str) -> Result<f64, String> {
    number(text, 0.0, 0.3, "")
}

impl SharedArgs {
    /// The calibration that was named, if one was.
    ///
    /// # Errors
    /// It can't be read.
    pub fn read(&self, problems: &mut Vec<Problem>) -> anyhow::Result<Option<CalibrationFile>> {
        let Some(path) = &self.calibration else { return Ok(None) };
        let (file, noted) = calibration_toml::read(path)?;
        problems.extend(noted);
        Ok(Some(file))
    }

    /// The errors that the calibration brought into a cloud; what to know of the water's index is told, and kept in `warnings`.
    ///
    /// # Errors
    /// They don't belong together.
    pub fn errors<'a>(
        &self,
        at: &Path,
        cloud: &'a PointCloud,
        file: &'a CalibrationFile,
        console: &Console,
        warnings: &mut Vec<String>,
    ) -> anyhow::Result<SharedErrors<'a>> {
        let shared = SharedErrors::new(cloud, &file.calibration)
            .map_err(|e| anyhow::anyhow!("{}: {e}", at.display()))?;
        if let Some(sigma) = self.index_sigma {
            return Ok(shared.with_index_known_to(sigma));
        }
        if let Some(own) = shared.other_index() {
            let warning = format!(
                "{}: light was traced with an index of {:.5}, the calibration's water has {own:.5}; the index counts as uncertain as the \
                 calibration's. If reconstruct was given it, say how well it is known: --index-sigma",
                at.display(),
                shared.index(),
            );
            console.warn(&warning);
            warnings.push(warning);
        }
        Ok(shared)
    }
}
