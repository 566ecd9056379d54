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

/// Returns the noise floor from (residual along the normal, nᵀCn) of the inliers, for a shape of `unknowns`.
///
/// −2 ln L = dof ln φ(f) + Σ ln(a + f²), φ(f) = Σ r²/(a + f²) / dof, searched between a thousandth of the typical
/// normal sigma and the scatter, in steps of about 15 %.
pub(crate) fn noise_floor(residuals: &[(f64, f64)], unknowns: usize, resolution_mm: f64) -> Floor {
    const STEPS: i32 = 64;
    // Four of its squares still have a product; one logarithm for four is a third of the time.
    const SMALLEST_MM: f64 = 1e-30;
    let dof = residuals.len().saturating_sub(unknowns).max(1) as f64;
    let scatter = (residuals.iter().map(|(r, _)| r * r).sum::<f64>() / dof).sqrt();
    let sigma = residuals.iter().map(|(_, a)| a).sum::<f64>().sqrt() / (residuals.len().max(1) as f64).sqrt();
    let lowest = (1e-3 * sigma).max(1e-4 * scatter).max(resolution_mm).max(SMALLEST_MM);
    let highest = scatter.max(lowest);
    let scale = |f2: f64| residuals.iter().map(|(r, a)| r * r / (a + f2)).sum::<f64>() / dof;
    let deviance = |f2: f64| {
        dof * scale(f2).max(f64::MIN_POSITIVE).ln()
            + residuals
                .chunks(4)
                .map(|four| four.iter().map(|(_, a)| a + f2).product::<f64>().ln())
                .sum::<f64>()
    };
    let tried: Vec<(f64, f64)> = (0..=STEPS)
        .map(|i| lowest * (highest / lowest).powf(f64::from(i) / f64::from(STEPS)))
        .map(|f| (f, deviance(f * f)))
        .collect();
    let likely = tried.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((lowest, 0.0));
    let used_mm =
        tried.iter().rev().find(|(_, deviance)| *deviance <= likely.1 + 1.0).map_or(likely.0, |(f, _)| *f);
    Floor { likely_mm: likely.0, used_mm, scale: scale(likely.0 * likely.0) }
}
