//! Digits of a figure, by its standard deviation.

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
