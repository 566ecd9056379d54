//! What the examples that measure have in common.

/// Memory that the process holds, MiB (/proc/self/statm, pages of 4 KiB).
pub fn resident_mib() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    text.split(' ').nth(1).and_then(|pages| pages.parse::<f64>().ok()).map_or(f64::NAN, |pages| pages / 256.0)
}
