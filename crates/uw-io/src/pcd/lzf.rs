//! Unpacking LZF (M. Lehmann's liblzf): literal runs and copies of what came before.

/// The most that a byte becomes: three bytes copy up to 264.
pub(super) const MOST_PER_BYTE: u64 = 88;

/// Returns what was packed, of this length; `None` where it is of another or damaged.
pub(super) fn unpacked(packed: &[u8], length: usize) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(length);
    let mut source = packed.iter().copied();
    while let Some(control) = source.next() {
        let control = usize::from(control);
        if control < 32 {
            for _ in 0..=control {
                out.push(source.next()?);
            }
        } else {
            let mut count = control >> 5;
            if count == 7 {
                count += usize::from(source.next()?);
            }
            let back = ((control & 31) << 8) + usize::from(source.next()?) + 1;
            let from = out.len().checked_sub(back)?;
            // What is copied may reach into what is being written.
            for at in from..from + count + 2 {
                out.push(out[at]);
            }
        }
        if out.len() > length {
            return None;
        }
    }
    (out.len() == length).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::unpacked;

    #[test]
    fn runs_and_copies_unpack_and_damage_does_not() {
        // "abc", then five from three back, then seven and more from one back.
        let packed = [2, b'a', b'b', b'c', 3 << 5, 2, 7 << 5, 4, 0];
        assert_eq!(unpacked(&packed, 3 + 5 + 13).unwrap(), b"abcabcabbbbbbbbbbbbbb");
        assert_eq!(unpacked(&packed, 20), None, "of another length");
        for end in 1..packed.len() {
            assert_eq!(unpacked(&packed[..end], 21), None, "torn after {end} bytes");
        }
        assert_eq!(unpacked(&[1 << 5, 0], 3), None, "copies from before the start");
        assert_eq!(unpacked(&[], 0).unwrap(), b"");
    }
}
