//! The variance component that the covariances do not tell of.

/// The variance beyond the covariances: f as it is most likely, and f as it is used in weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Floor {
    /// The f of largest likelihood, mm.
    pub(crate) likely_mm: f64,
    /// The f that weights are made with, mm.
    pub(crate) used_mm: f64,
    /// φ at the f of largest likelihood.
    pub(crate) scale: f64,
}

/// Steps of the search, and of its coarse one.
const STEPS: usize = 64;
const COARSE: usize = 8;

/// Variances that are multiplied before a logarithm is taken of them, in units of the scatter's: none is so far from one that
/// so many leave the numbers.
const MULTIPLIED: usize = 16;

/// Returns the noise floor from (residual along the normal, nᵀCn) of the inliers, for a shape of `unknowns`.
///
/// −2 ln L = dof ln φ(f) + Σ ln(a + f²), φ(f) = Σ r²/(a + f²) / dof, searched between a thousandth of the typical
/// normal sigma and the scatter, in steps of about 15 %: every eighth first, then those beside the best of them.
pub(crate) fn noise_floor(residuals: &[(f64, f64)], unknowns: usize, resolution_mm: f64) -> Floor {
    const SMALLEST_MM: f64 = 1e-30;
    let dof = residuals.len().saturating_sub(unknowns).max(1) as f64;
    let scatter = (residuals.iter().map(|(r, _)| r * r).sum::<f64>() / dof).sqrt();
    let sigma = residuals.iter().map(|(_, a)| a).sum::<f64>().sqrt() / (residuals.len().max(1) as f64).sqrt();
    let lowest = (1e-3 * sigma).max(1e-4 * scatter).max(resolution_mm).max(SMALLEST_MM);
    let highest = scatter.max(lowest);
    let unit = 1.0 / (highest * highest);
    // φ, and the deviance but for a constant.
    let told = |f2: f64| {
        let (mut squares, mut logarithms) = (0.0, 0.0);
        for some in residuals.chunks(MULTIPLIED) {
            let mut product = 1.0;
            for (r, a) in some {
                let variance = a + f2;
                squares += r * r / variance;
                product *= variance * unit;
            }
            logarithms += product.ln();
        }
        let scale = squares / dof;
        (scale, dof * scale.max(f64::MIN_POSITIVE).ln() + logarithms)
    };
    let at = |i: usize| lowest * (highest / lowest).powf(i as f64 / STEPS as f64);
    let mut tried = [None; STEPS + 1];
    let mut deviance = |i: usize| *tried[i].get_or_insert_with(|| told(at(i).powi(2)).1);
    let mut likely = 0;
    for i in (0..=STEPS).step_by(COARSE) {
        if deviance(i) < deviance(likely) {
            likely = i;
        }
    }
    for i in likely.saturating_sub(COARSE - 1)..=(likely + COARSE - 1).min(STEPS) {
        if deviance(i) < deviance(likely) {
            likely = i;
        }
    }
    // The largest that is hardly less likely: by coarse steps from above, then by single ones.
    let allowed = deviance(likely) + 1.0;
    let mut above = STEPS;
    while above > likely && deviance(above) > allowed {
        let coarse = (above - 1) / COARSE * COARSE;
        // Beyond a coarse step that is too little likely there is none that isn't.
        above = if coarse > likely && deviance(coarse) > allowed { coarse } else { above - 1 };
    }
    Floor { likely_mm: at(likely), used_mm: at(above), scale: told(at(likely).powi(2)).0 }
}
