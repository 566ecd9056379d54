//! Numbers as arguments, and in sentences.

use std::str::FromStr;

/// A number from `low` to `high`, in a unit.
pub fn number(text: &str, low: f64, high: f64, unit: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (low..=high).contains(&value) => Ok(value),
        Ok(_) => Err(format!("give a number from {low} to {high}{unit}")),
        Err(e) => Err(e.to_string()),
    }
}

/// A length, mm.
pub fn length(text: &str) -> Result<f64, String> {
    number(text, 1e-6, 1e6, " mm")
}

/// A share of a whole.
pub fn share(text: &str) -> Result<f64, String> {
    number(text, 0.0, 1.0, "")
}

/// A whole number from 1.
pub fn positive<T: FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| "give a whole number from 1".to_owned())
}

/// Three coordinates between commas, mm.
pub fn coordinates(text: &str) -> Result<[f64; 3], String> {
    numbers(text)
}

/// So many numbers between commas.
pub fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let parsed: Option<Vec<f64>> = text
        .split(',')
        .map(|word| word.trim().parse().ok().filter(|value: &f64| value.is_finite()))
        .collect();
    let all = parsed.and_then(|values| <[f64; N]>::try_from(values).ok());
    all.ok_or_else(|| format!("give {N} numbers between commas"))
}

/// So many of something: `1 shape`, `2 shapes`.
pub fn many(count: usize, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_taken_whole_or_not_at_all() {
        assert_eq!(coordinates("1, -2.5,3e2"), Ok([1.0, -2.5, 300.0]));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan"] {
            assert!(coordinates(bad).is_err(), "{bad}");
        }
        assert!(number("80", 45.0, 90.0, "°").is_ok());
        assert!(number("91", 45.0, 90.0, "°").unwrap_err().contains("90"));
    }
}
