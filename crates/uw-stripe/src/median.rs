//! Medians.

/// Upper median; 0 for an empty slice.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Median of the positive `values` whose `known` is a number, to a part in 512; `None` if there are none.
///
/// The upper bits of such numbers, exponent and eight of the fraction, are in the same order; each bit of the median's is told by how many are below.
#[inline(always)]
pub(crate) fn median_of_known(
    known: &[f32],
    values: impl Iterator<Item = f32>,
    upper: &mut Vec<u16>,
) -> Option<f32> {
    const LOWER: u32 = 15;
    upper.clear();
    upper.extend(
        known
            .iter()
            .zip(values)
            .map(|(k, v)| if k.is_nan() { u16::MAX } else { (v.to_bits() >> LOWER) as u16 }),
    );
    let count = below(upper, u16::MAX);
    let rank = (count > 0).then_some(count / 2)?;
    let median = (0..16)
        .rev()
        .map(|bit| 1 << bit)
        .fold(0, |median, bit| if below(upper, median | bit) <= rank { median | bit } else { median });
    // The middle of what the lower bits may make of it.
    Some(f32::from_bits((u32::from(median) << LOWER) | 1 << (LOWER - 1)))
}

/// How many are below a limit, in counts that a vector holds as many of as of the values.
#[inline(always)]
fn below(values: &[u16], limit: u16) -> u32 {
    values
        .chunks(1 << 15)
        .map(|part| u32::from(part.iter().fold(0u16, |n, v| n + u16::from(*v < limit))))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn medians_are_those_of_a_sorted_list(
            values in prop::collection::vec((1e-6f32..1e6, prop::bool::weighted(0.8)), 0..300),
        ) {
            let known: Vec<f32> = values.iter().map(|(_, known)| if *known { 0.0 } else { f32::NAN }).collect();
            let median = median_of_known(&known, values.iter().map(|(v, _)| *v), &mut Vec::new());
            let mut sorted: Vec<f32> = values.iter().filter(|(_, known)| *known).map(|(v, _)| *v).collect();
            sorted.sort_by(f32::total_cmp);
            match (median, sorted.get(sorted.len() / 2)) {
                (Some(got), Some(want)) => prop_assert!((got / want - 1.0).abs() < 1.0 / 500.0, "{got} for {want}"),
                (got, want) => prop_assert_eq!(got.is_none(), want.is_none()),
            }
        }
    }
}
