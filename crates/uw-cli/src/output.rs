//! Results on standard output: text, or one JSON object.

use std::io::{self, Write};

use serde::Serialize;
use uwscan::io::{Problem, Severity};

/// Writes a result. A reader that has gone away (`uwscan … | head`) has what it wanted: that is no failure.
///
/// # Errors
/// Standard output can't be written.
pub fn print(bytes: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes.as_ref()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(e).context("cannot write to standard output"))
        }
        _ => Ok(()),
    }
}

/// Writes a record as the one JSON object of `--json`; what is no finite number is `null` there.
///
/// # Errors
/// As [`print`].
pub fn json(record: &impl Serialize) -> anyhow::Result<()> {
    let mut text = serde_json::to_string(record)?;
    text.push('\n');
    print(text)
}

/// An input that was missing or unreadable.
#[derive(Debug, Serialize)]
pub struct Lost {
    file: String,
    reason: String,
}

/// What was lost, for JSON.
pub fn lost(problems: &[Problem]) -> Vec<Lost> {
    let lost = problems.iter().filter(|p| p.severity == Severity::Loss);
    lost.map(|p| Lost { file: p.error.path().display().to_string(), reason: p.to_string() }).collect()
}

/// A result's own warnings and those about its inputs, for JSON.
pub fn warnings(own: &[String], problems: &[Problem]) -> Vec<String> {
    let inputs = problems.iter().filter(|p| p.severity == Severity::Warning).map(ToString::to_string);
    own.iter().cloned().chain(inputs).collect()
}

/// `value ± sigma`, the sigma with two significant digits and the value with as many decimals; the value alone where
/// there is no sigma.
pub fn plus_minus(value: f64, sigma: Option<f64>) -> String {
    match sigma.filter(|s| s.is_finite() && *s > 0.0) {
        Some(sigma) => {
            let decimals = decimals(sigma);
            format!("{value:.decimals$} ± {sigma:.decimals$}")
        }
        None => format!("{value:.6}"),
    }
}

/// Decimals that show two significant digits of `sigma`; at most twelve.
pub fn decimals(sigma: f64) -> usize {
    (1.0 - sigma.log10().floor()).clamp(0.0, 12.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sigma_decides_the_digits() {
        assert_eq!(plus_minus(20.017_461, Some(0.004_32)), "20.0175 ± 0.0043");
        assert_eq!(plus_minus(-1395.26, Some(0.41)), "-1395.26 ± 0.41");
        assert_eq!(plus_minus(12345.6, Some(12.0)), "12346 ± 12");
        assert_eq!(plus_minus(1e-5, Some(1e-20)), "0.000010000000 ± 0.000000000000");
        for none in [None, Some(0.0), Some(f64::NAN)] {
            assert_eq!(plus_minus(1.5, none), "1.500000");
        }
    }
}
