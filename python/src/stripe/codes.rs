//! Numbers of flags and reasons.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use uwscan::stripe::{Flags, Reject};

/// A reason's number: its place among all, from 1.
pub(super) fn number(reason: Reject) -> u16 {
    Reject::ALL.iter().position(|r| *r == reason).map_or(u16::MAX, |at| at as u16 + 1)
}

/// The names of flags and reasons with their numbers, which ``uwscan.StripeFlags`` and ``uwscan.StripeReject`` are held against.
#[pyfunction]
pub fn stripe_codes(py: Python<'_>) -> PyResult<(Bound<'_, PyDict>, Bound<'_, PyDict>)> {
    let (flags, reasons) = (PyDict::new(py), PyDict::new(py));
    for (name, flag) in [
        ("SATURATED", Flags::SATURATED),
        ("SEVERAL_PEAKS", Flags::SEVERAL_PEAKS),
        ("EDGE", Flags::EDGE),
        ("NOT_CONVERGED", Flags::NOT_CONVERGED),
        ("BORDER", Flags::BORDER),
        ("POOR_FIT", Flags::POOR_FIT),
        ("TRACK_LOST", Flags::TRACK_LOST),
    ] {
        flags.set_item(name, flag.bits())?;
    }
    for reason in Reject::ALL {
        reasons.set_item(reason.name().to_uppercase(), number(reason))?;
    }
    Ok((flags, reasons))
}
