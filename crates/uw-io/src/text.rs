//! Text as people make it: byte order marks, other encodings, typing slips.

use std::{
    fs::File,
    io::{BufRead, Read},
    path::Path,
};

use crate::error::{Error, Place};

/// A text file whole, without its byte order mark; refused where it is larger than `limit` bytes.
pub(crate) fn read(path: &Path, limit: u64) -> Result<String, Error> {
    let file = File::open(path).map_err(Error::file(path, "open"))?;
    let mut bytes = Vec::new();
    // One byte more than allowed tells "as large as allowed" from "larger", and bounds what a device file costs.
    file.take(limit + 1).read_to_end(&mut bytes).map_err(Error::file(path, "read"))?;
    if bytes.len() as u64 > limit {
        let what = format!("is larger than {} MB, which no such file is", limit >> 20);
        return Err(Error::content(Place::file(path), what, "check that this is the file meant"));
    }
    let start = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    match std::str::from_utf8(&bytes[start..]) {
        Ok(text) => Ok(text.to_owned()),
        Err(e) => {
            let line = line_column(&String::from_utf8_lossy(&bytes[..start + e.valid_up_to()]), usize::MAX).0;
            Err(Error::content(Place::line(path, line), "is not UTF-8 text", "save the file as UTF-8"))
        }
    }
}

/// Reads the next line into `bytes`, its end included, no more than `limit` bytes of it; false where the file ends.
pub(crate) fn next_line(
    source: &mut impl BufRead,
    path: &Path,
    limit: u64,
    bytes: &mut Vec<u8>,
) -> Result<bool, Error> {
    bytes.clear();
    source.take(limit).read_until(b'\n', bytes).map_err(Error::file(path, "read"))?;
    Ok(!bytes.is_empty())
}

/// Line and column, from 1, of a byte offset.
pub(crate) fn line_column(text: &str, offset: usize) -> (u32, u32) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let start = before.iter().rposition(|b| *b == b'\n').map_or(0, |at| at + 1);
    let line = before.iter().filter(|b| **b == b'\n').count();
    // Bytes that don't continue a character start one.
    let column = before[start..].iter().filter(|b| (**b & 0xc0) != 0x80).count();
    (1 + line as u32, 1 + column as u32)
}

/// The known word that `word` is most likely a slip of; `None` where none is near.
pub(crate) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let near = |k: &&str| {
        let d = distance(word, k);
        // A third of the letters may differ: `glas_index` and `port_distance_mm` are slips, `colour` is not.
        (d <= k.len().max(word.len()) / 3 || k.contains(word) || word.contains(*k)).then_some(d)
    };
    known.into_iter().filter_map(|k| near(&k).map(|d| (d, k))).min().map(|(_, k)| k)
}

/// Letters inserted, left out, replaced or swapped with their neighbour between two words (optimal string
/// alignment), their case aside.
fn distance(a: &str, b: &str) -> usize {
    let [a, b] = [a, b].map(|word| word.to_lowercase().chars().collect::<Vec<_>>());
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for i in 0..a.len() {
        let mut row = vec![i + 1];
        for j in 0..b.len() {
            let replaced = rows[i][j] + usize::from(a[i] != b[j]);
            let mut least = replaced.min(rows[i][j + 1] + 1).min(row[j] + 1);
            if i > 0 && j > 0 && a[i] == b[j - 1] && a[i - 1] == b[j] {
                least = least.min(rows[i - 1][j - 1] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_count_slips() {
        for (a, b, d) in [
            ("", "abc", 3),
            ("kitten", "sitting", 3),
            ("flaw", "lawn", 2),
            ("prot", "port", 1),
            ("Index", "index", 0),
        ] {
            assert_eq!(distance(a, b), d, "{a} {b}");
            assert_eq!(distance(b, a), d, "{b} {a}");
        }
    }

    #[test]
    fn offsets_become_lines_and_characters() {
        let text = "a\nµ = 1\r\nb";
        assert_eq!(line_column(text, 0), (1, 1));
        assert_eq!(line_column(text, text.find('1').expect("there is a 1")), (2, 5));
        assert_eq!(line_column(text, text.len() + 9), (3, 2));
    }
}
