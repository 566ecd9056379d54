//! What the mirror makes of a command, measured by reading back.

use std::time::Duration;

use crate::{Fault, GuardedGalvo, ReadBack};

/// How the mirror settles after a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Settling {
    /// From the command to the first read-back after which none was farther from the end than the tolerance.
    pub settle: Duration,
    /// Between two read-backs: by how much `settle` may be too long.
    pub resolution: Duration,
    /// Standard deviation of the read-back once settled, V.
    pub noise_v: f64,
    /// The settled read-back less the command, V.
    pub offset_v: f64,
    /// Whether the read-back was at the end from the first on: it may then repeat the command, and tell nothing of the mirror.
    pub at_once: bool,
}

/// By how much the mirror lags behind on a ramp.
#[derive(Clone, Debug, PartialEq)]
pub struct Lag {
    /// Mean of (command less read-back) over rate; negative where the read-back is ahead.
    pub lag_ns: i64,
    /// Standard deviation of that mean.
    pub sigma_ns: u64,
    /// Read-backs used.
    pub samples: usize,
}

/// How many read-backs at the end of a measurement say where the mirror came to rest.
const LAST: usize = 8;

/// Steps from `from_v` to `to_v` and reads back until `watch` is over. `tolerance_v` says what is near enough to the end.
///
/// # Errors
/// The drive's [`Fault`]; [`Fault::NotFollowing`] where it came to rest farther from the command than the limits' tolerance.
pub fn measure_settling(
    galvo: &mut GuardedGalvo,
    [from_v, to_v]: [f64; 2],
    tolerance_v: f64,
    watch: Duration,
    within: Duration,
) -> Result<Settling, Fault> {
    let timeline = galvo.timeline().clone();
    galvo.set(from_v, within)?;
    timeline.sleep(watch);
    let moved = galvo.set(to_v, within)?;
    let deadline = timeline.deadline(watch);
    let mut reads: Vec<ReadBack> = vec![moved.read_back];
    while timeline.left(deadline).is_some() || reads.len() <= LAST {
        let before = timeline.since_start();
        reads.push(galvo.read_back(within)?);
        if timeline.since_start() == before {
            // A drive that answers at once (or a clock that stands still) is not asked endlessly often.
            timeline.sleep(watch / 512);
        }
    }
    let settled = &reads[reads.len() - LAST..];
    let mean = settled.iter().map(|read| read.volts).sum::<f64>() / LAST as f64;
    let square = settled.iter().map(|read| (read.volts - mean).powi(2)).sum::<f64>() / (LAST - 1) as f64;
    galvo.confirm(within)?;
    let near = |read: &ReadBack| (read.volts - mean).abs() <= tolerance_v;
    let first = reads.iter().rposition(|read| !near(read)).map_or(0, |last_far| last_far + 1);
    let span_ns = reads[reads.len() - 1].stamp_ns.abs_diff(reads[0].stamp_ns);
    Ok(Settling {
        settle: Duration::from_nanos(
            reads[first.min(reads.len() - 1)].stamp_ns.saturating_sub(moved.sent_ns).max(0).cast_unsigned(),
        ),
        resolution: Duration::from_nanos(span_ns / (reads.len() - 1) as u64),
        noise_v: square.sqrt(),
        offset_v: mean - to_v,
        at_once: first == 0,
    })
}

/// Drives a ramp from `from_v` to `to_v` at `rate_v_per_s` and compares commands with read-backs.
///
/// # Errors
/// The drive's [`Fault`]; [`Fault::OutOfRange`] for a rate that the limits don't allow.
pub fn measure_lag(
    galvo: &mut GuardedGalvo,
    [from_v, to_v]: [f64; 2],
    rate_v_per_s: f64,
    settle: Duration,
    within: Duration,
) -> Result<Lag, Fault> {
    let timeline = galvo.timeline().clone();
    let slew = galvo.limits().slew_v_per_s();
    if !(rate_v_per_s > 0.0 && rate_v_per_s <= slew) {
        let (device, unit, allowed) = ("the ramp".into(), "V/s", [0.0, slew]);
        return Err(Fault::OutOfRange { device, quantity: "rate", unit, value: rate_v_per_s, allowed });
    }
    galvo.set(from_v, within)?;
    timeline.sleep(settle);
    let begin_ns = timeline.stamp_ns();
    let rate = rate_v_per_s.copysign(to_v - from_v);
    let on_ramp = |stamp_ns: i64| from_v + rate * (stamp_ns - begin_ns) as f64 * 1e-9;
    let length_s = (to_v - from_v).abs() / rate_v_per_s;
    let mut lags_ns: Vec<f64> = Vec::new();
    loop {
        let into_s = (timeline.stamp_ns() - begin_ns) as f64 * 1e-9;
        if into_s >= length_s {
            break;
        }
        let read = galvo.set(on_ramp(timeline.stamp_ns()), within)?.read_back;
        // The start, where the mirror gains speed, tells nothing of the ramp.
        if into_s > length_s * 0.25 {
            lags_ns.push((on_ramp(read.stamp_ns) - read.volts) / rate * 1e9);
        }
        timeline.sleep(Duration::from_millis(1));
    }
    galvo.set(to_v, within)?;
    let count = lags_ns.len() as f64;
    if lags_ns.len() < 2 {
        return Err(Fault::Unsupported {
            device: crate::limits::name(&galvo.identity()),
            what: format!("be read back often enough on a ramp of {length_s:.3} s"),
            mend: "measure with a longer or slower ramp".into(),
        });
    }
    let mean = lags_ns.iter().sum::<f64>() / count;
    let variance = lags_ns.iter().map(|lag| (lag - mean).powi(2)).sum::<f64>() / (count - 1.0);
    Ok(Lag { lag_ns: mean as i64, sigma_ns: (variance / count).sqrt() as u64, samples: lags_ns.len() })
}
