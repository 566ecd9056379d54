//! Which voltages a scan visits: those of a sweep, all or some.

use uw_hw::sweep::{Schedule, ScheduleError, Spacing};

/// An inclusive range of voltages that a scan is cut down to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    low_v: f64,
    high_v: f64,
}

impl Region {
    /// The range between two voltages, in either order; `None` where one is not finite.
    pub fn new(a_v: f64, b_v: f64) -> Option<Self> {
        (a_v.is_finite() && b_v.is_finite()).then(|| Self { low_v: a_v.min(b_v), high_v: a_v.max(b_v) })
    }

    /// Lowest and highest voltage.
    pub fn range_v(self) -> [f64; 2] {
        [self.low_v, self.high_v]
    }

    /// Whether a voltage lies in it.
    pub fn holds(self, voltage_v: f64) -> bool {
        (self.low_v..=self.high_v).contains(&voltage_v)
    }
}

/// Why there is nothing to visit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The sweep is none.
    #[error(transparent)]
    Sweep(#[from] ScheduleError),
    /// No voltage of the sweep lies in a region.
    #[error(
        "none of the sweep's {voltages} voltages, {} to {} V, lies in the region {} to {} V: give a region within the sweep, and wider \
         than a step", sweep_v[0], sweep_v[1], region_v[0], region_v[1]
    )]
    Region {
        /// How many there are.
        voltages: usize,
        /// The first and the last.
        sweep_v: [f64; 2],
        /// The region.
        region_v: [f64; 2],
    },
}

/// The voltages of a sweep that lie in one of the regions, or all where none is given: in the sweep's order and each once, the very
/// values that the whole sweep visits, so that a part and the whole compare.
///
/// # Errors
/// [`PlanError`] where there are none, or none in one of the regions.
pub fn voltages(from_v: f64, to_v: f64, spacing: Spacing, regions: &[Region]) -> Result<Vec<f64>, PlanError> {
    within(Schedule::new(from_v, to_v, spacing)?.volts().to_vec(), regions)
}

/// Those of some voltages that lie in one of the regions, or all where none is given.
///
/// # Errors
/// As [`voltages`].
pub fn within(mut volts: Vec<f64>, regions: &[Region]) -> Result<Vec<f64>, PlanError> {
    for region in regions {
        if !volts.iter().any(|&v| region.holds(v)) {
            let ends = [volts.first(), volts.last()].map(|v| v.copied().unwrap_or(f64::NAN));
            return Err(PlanError::Region {
                voltages: volts.len(),
                sweep_v: ends,
                region_v: region.range_v(),
            });
        }
    }
    volts.retain(|&v| regions.is_empty() || regions.iter().any(|region| region.holds(v)));
    Ok(volts)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parts(regions: &[[f64; 2]]) -> Result<Vec<f64>, PlanError> {
        let regions: Vec<Region> = regions.iter().map(|&[a, b]| Region::new(a, b).unwrap()).collect();
        voltages(-1.0, 1.0, Spacing::Step(0.1), &regions)
    }

    #[test]
    fn a_region_visits_the_same_voltages_as_the_whole() {
        let all = parts(&[]).unwrap();
        assert_eq!(all.len(), 21);
        let part = parts(&[[0.55, 0.25], [-0.95, -0.75], [0.3, 0.4]]).unwrap();
        assert_eq!(part.len(), 5);
        assert!(part.iter().all(|v| all.iter().any(|w| w.to_bits() == v.to_bits())));
        assert!(part.windows(2).all(|pair| pair[1] > pair[0]));
    }

    #[test]
    fn a_region_that_holds_nothing_and_no_sweep_are_refused() {
        let between = parts(&[[-0.5, 0.5], [0.21, 0.29]]).unwrap_err();
        assert!(between.to_string().contains("0.21 to 0.29 V"), "{between}");
        assert_eq!(Region::new(f64::NAN, 0.0), None);
        assert!(matches!(voltages(0.0, 1.0, Spacing::Step(0.0), &[]), Err(PlanError::Sweep(_))));
    }
}
