//! Steps that go back and forth, made shorter until they don't.
//!
//! Points half-way between two of the other sweep's belong to the one or the other as the pose goes, and where many are, what they pull by changes with the pose by more than the normal equations
//! tell: a step then goes too far, the next one as far back, and so on for ever. The secant between the ends of a step tells where along it nothing would have pulled.

/// What share of their steps is taken.
pub(super) struct Swing {
    share: f64,
    /// The gradient along the last whole step, where that began.
    slope: f64,
}

impl Swing {
    /// Before the first step, which is taken whole.
    pub(super) fn new() -> Self {
        Self { share: 1.0, slope: 0.0 }
    }

    /// Returns the share of the next step, given the gradient along the last whole one where that ended.
    pub(super) fn share(&mut self, slope: f64) -> f64 {
        let left = if self.slope < 0.0 { slope / self.slope } else { 0.0 };
        // Never longer again: where pulls jump, a step that fell short tells nothing of the next one.
        self.share /= 1.0 - left.min(0.0);
        self.share
    }

    /// Notes the gradient along the next whole step, where that begins.
    pub(super) fn begin(&mut self, slope: f64) {
        self.slope = slope;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of −`pull`(x) from 1 on; returns where they end and their number.
    fn walked(pull: impl Fn(f64) -> f64) -> (f64, usize) {
        let (mut swing, mut at, mut last) = (Swing::new(), 1.0, 0.0);
        for round in 0..40 {
            let share = swing.share(pull(at) * last);
            last = -pull(at);
            if (share * last).abs() < 1e-6 {
                return (at, round);
            }
            swing.begin(pull(at) * last);
            at += share * last;
        }
        (at, 40)
    }

    #[test]
    fn what_overshoots_comes_to_rest_and_what_does_not_is_left_alone() {
        // Whole steps go to and fro between 1 and −1, and beyond.
        for steep in [2.0, 3.0, 10.0] {
            let (at, rounds) = walked(|x| steep * x);
            assert!(at.abs() < 1e-6 && rounds < 6, "{steep}: {at} after {rounds}");
        }
        // A jump has no place where nothing pulls, but one where its sign changes.
        let (at, rounds) = walked(|x| if x > 0.3 { 0.5 } else { -0.7 });
        assert!((at - 0.3).abs() < 1e-5 && rounds < 40, "{at} after {rounds}");
        // Steps that are right, or short, are taken whole.
        assert_eq!(walked(|x| x), (0.0, 1));
        let (_, rounds) = walked(|x| 0.5 * x);
        assert_eq!(rounds, 19, "halved to 2⁻²⁰");
    }
}
