//! Colours that stand for numbers.

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// A scale of colours over an interval of numbers. Both can be told apart with any of the common kinds of colour blindness, and in grey.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Where it begins and ends.
    pub range: [f64; 2],
    stops: &'static [Rgb],
}

/// Cividis (J. R. Nuñez, C. R. Anderton, R. S. Renslow, PLoS ONE 13 (2018), e0199239), nine of its stops.
const CIVIDIS: [Rgb; 9] = [
    [0, 34, 78],
    [18, 53, 112],
    [59, 73, 108],
    [87, 93, 109],
    [112, 113, 115],
    [138, 134, 120],
    [165, 156, 116],
    [195, 179, 105],
    [253, 232, 55],
];

/// PuOr of ColorBrewer (C. A. Brewer), nine classes, from purple for what lies deeper to orange for what stands out.
const PURPLE_ORANGE: [Rgb; 9] = [
    [84, 39, 136],
    [128, 115, 172],
    [178, 171, 210],
    [216, 218, 235],
    [247, 247, 247],
    [254, 224, 182],
    [253, 184, 99],
    [224, 130, 20],
    [179, 88, 6],
];

impl Scale {
    /// A scale for quantities that go from less to more.
    pub fn sequential(range: [f64; 2]) -> Self {
        Self { range, stops: &CIVIDIS }
    }

    /// A scale for deviations to both sides of zero, `reach` to either.
    pub fn diverging(reach: f64) -> Self {
        Self { range: [-reach, reach], stops: &PURPLE_ORANGE }
    }

    /// The colour of a number; of one beyond an end, that end's. A number that is none is grey.
    pub fn colour(&self, value: f64) -> Rgb {
        if !value.is_finite() {
            return [128; 3];
        }
        let [low, high] = self.range;
        let share = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
        let at = share * (self.stops.len() - 1) as f64;
        let below = (at as usize).min(self.stops.len() - 2);
        let part = at - below as f64;
        std::array::from_fn(|i| {
            let [from, to] = [self.stops[below][i], self.stops[below + 1][i]].map(f64::from);
            (from + part * (to - from)).round() as u8
        })
    }

    /// The scale as CSS paints it, from left to right.
    pub(crate) fn gradient(&self) -> String {
        let stops: Vec<String> = self.stops.iter().map(|c| hex(*c)).collect();
        format!("linear-gradient(to right,{})", stops.join(","))
    }
}

pub(crate) fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_begins_ends_and_turns_where_it_says() {
        let scale = Scale::diverging(0.5);
        assert_eq!(scale.colour(-9.0), PURPLE_ORANGE[0]);
        assert_eq!(scale.colour(0.0), PURPLE_ORANGE[4]);
        assert_eq!(scale.colour(0.5), PURPLE_ORANGE[8]);
        assert_eq!(scale.colour(f64::NAN), [128; 3]);
        let empty = Scale::sequential([2.0, 2.0]);
        assert_eq!(empty.colour(2.0), CIVIDIS[4]);
    }

    #[test]
    fn more_is_lighter_all_along_the_sequential_scale() {
        let scale = Scale::sequential([0.0, 1.0]);
        let light = |share: f64| {
            let [r, g, b] = scale.colour(share).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for step in 0..50 {
            let (here, next) = (light(f64::from(step) / 50.0), light(f64::from(step + 1) / 50.0));
            assert!(next > here, "at {step}: {here}, then {next}");
        }
    }
}
