//! What the paper printed: S. Chi, Z. Xie, W. Chen, "A Laser Line Auto-Scanning System for Underwater 3D Reconstruction", Sensors 16 (2016),
//! Tables 1 and 2 and section 5. Lengths in millimetres.

/// Radius of the ball.
pub const BALL_RADIUS_MM: f64 = 20.0175;

/// A row of Table 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BallRow {
    /// Fitted centre, galvanometer frame.
    pub center_mm: [f64; 3],
    /// Fitted radius.
    pub radius_mm: f64,
    /// Points.
    pub points: usize,
}

const fn ball(x: f64, y: f64, z: f64, radius_mm: f64, points: usize) -> BallRow {
    BallRow { center_mm: [x, y, z], radius_mm, points }
}

/// Table 1.
pub const BALLS: [BallRow; 10] = [
    ball(18.6293, -71.9997, 667.2722, 20.2712, 3635),
    ball(18.6899, -79.499, 721.507, 20.2547, 2978),
    ball(19.5748, -39.5651, 772.5898, 20.2187, 2870),
    ball(19.7713, -39.3427, 817.5533, 20.2018, 2380),
    ball(19.8753, -29.6658, 858.9471, 20.1116, 1958),
    ball(19.9782, -23.9347, 912.6583, 20.0975, 2017),
    ball(20.3525, -16.948, 958.4314, 20.0857, 1701),
    ball(21.1155, -23.5845, 998.197, 20.0794, 1527),
    ball(21.6605, -32.4656, 1021.3342, 20.1154, 1433),
    ball(23.3907, -37.6898, 1067.269, 20.1003, 1176),
];

/// The position, from 0, of Figure 10, and the farthest points outside and inside there.
pub const FIGURE_10: (usize, [f64; 2]) = (5, [0.3532, 0.4211]);

/// Names of Table 2's columns: radii of A, B, C, then the distances.
pub const THREE_NAMES: [&str; 6] = ["radius A", "radius B", "radius C", "A to B", "A to C", "B to C"];
/// Their standard values.
pub const THREE_NOMINAL_MM: [f64; 6] = [30.200, 30.193, 30.166, 151.713, 220.056, 221.449];
/// What was measured in three orientations.
pub const THREE_MEASURED_MM: [[f64; 6]; 3] = [
    [30.612, 30.939, 31.089, 151.682, 219.197, 222.090],
    [29.968, 30.461, 30.631, 150.699, 218.179, 220.716],
    [30.133, 30.245, 30.519, 150.694, 219.372, 222.438],
];

/// Points on the cover.
pub const COVER_POINTS: usize = 36_127;

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a unit of the last digit printed, and rounding, mm.
    const PRINTED_MM: f64 = 0.001;

    #[test]
    fn errors_are_those_that_the_paper_prints() {
        let errors: Vec<f64> = BALLS.iter().map(|row| row.radius_mm - BALL_RADIUS_MM).collect();
        let (least, most) =
            errors.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), e| (low.min(*e), high.max(*e)));
        assert!((least - 0.0619).abs() < PRINTED_MM && (most - 0.2537).abs() < PRINTED_MM);
        let printed = [
            [0.412, 0.746, 0.923, -0.031, -0.859, 0.641],
            [-0.232, 0.268, 0.465, -1.014, -1.877, -0.733],
            [-0.067, 0.052, 0.353, -1.019, -0.684, 0.989],
        ];
        for (measured, errors) in THREE_MEASURED_MM.iter().zip(printed) {
            for ((measured, nominal), error) in measured.iter().zip(THREE_NOMINAL_MM).zip(errors) {
                assert!((measured - nominal - error).abs() < PRINTED_MM);
            }
        }
    }
}
