//! The index of refraction of water.

/// Change of water's index with pressure, per decibar: the mean slope of Austin and Halikas (1976) as tabulated by
/// C. Mobley, Light and Water (1994), Table 3.8, between 1.01e5 and 1.08e8 Pa (1.344186 → 1.360076 at 400 nm, 0 °C,
/// 0 psu; 1.331084 → 1.346604 at 700 nm): 1.47e-6 per 1e4 Pa, within a tenth over temperature and salinity.
const INDEX_PER_DECIBAR: f64 = 1.47e-6;
/// Hydrostatic pressure of a metre of sea water, decibar (1025 kg/m³ × 9.81 m/s² = 1.0055e4 Pa).
const DECIBAR_PER_METRE: f64 = 1.0055;

/// The index of refraction of water relative to air.
///
/// X. Quan, E. S. Fry, Appl. Opt. 34 (1995) 3477, Eq 3, in temperature (°C, 0…30), salinity (psu, 0…35) and wavelength
/// (nm, 400…700); plus a term linear in depth (m), 1.48e-6 a metre (see `INDEX_PER_DECIBAR`).
///
/// ```
/// let n = uw_geom::water::index(20.0, 35.0, 532.0, 0.0);
/// assert!((n - 1.341510).abs() < 1e-6);
/// ```
pub fn index(temperature_c: f64, salinity_psu: f64, wavelength_nm: f64, depth_m: f64) -> f64 {
    let (t, s, l) = (temperature_c, salinity_psu, wavelength_nm);
    1.31405 + (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t * t) * s - 2.02e-6 * t * t
        + (15.868 + 0.01155 * s - 0.00423 * t) / l
        - 4382.0 / (l * l)
        + 1.1455e6 / (l * l * l)
        + INDEX_PER_DECIBAR * DECIBAR_PER_METRE * depth_m
}

#[cfg(test)]
mod tests {
    use super::index;

    #[test]
    fn the_papers_check_values() {
        assert!((index(20.0, 0.0, 532.0, 0.0) - 1.335035).abs() < 1e-6);
        assert!((index(20.0, 35.0, 532.0, 0.0) - 1.341510).abs() < 1e-6);
    }

    #[test]
    fn a_kilometre_down_adds_a_thousandth_and_a_half() {
        let rise = index(4.0, 35.0, 532.0, 1000.0) - index(4.0, 35.0, 532.0, 0.0);
        assert!((1.3e-3..1.7e-3).contains(&rise), "{rise}");
    }
}
