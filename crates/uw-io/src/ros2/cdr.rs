//! ROS 2 messages as it sends them: CDR (OMG DDSI-RTPS 10, plain CDR version 1), little-endian.

/// A message in the making. Every number is aligned to its size, counted from after the four bytes of the head.
pub(super) struct Cdr(Vec<u8>);

impl Cdr {
    /// The head: plain CDR, little-endian.
    pub fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    pub fn finish(self) -> Vec<u8> {
        self.0
    }

    fn align(&mut self, size: usize) {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
    }

    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// An array of fixed length.
    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// A length, as sequences begin with.
    pub fn length(&mut self, length: usize) {
        // Nothing here is as long as four gigabytes: messages of recordings are smaller.
        self.u32(u32::try_from(length).unwrap_or(u32::MAX));
    }

    pub fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    pub fn bytes(&mut self, bytes: &[u8]) {
        self.length(bytes.len());
        self.0.extend_from_slice(bytes);
    }

    /// `builtin_interfaces/Time`; seconds are signed there, and end in 2038.
    pub fn stamp(&mut self, ns: u64) {
        self.u32(u32::try_from(ns / 1_000_000_000).unwrap_or(u32::MAX).min(i32::MAX as u32));
        self.u32((ns % 1_000_000_000) as u32);
    }

    /// `std_msgs/Header`.
    pub fn header(&mut self, stamp_ns: u64, frame: &str) {
        self.stamp(stamp_ns);
        self.text(frame);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_after_the_head() {
        let mut cdr = Cdr::new();
        cdr.u8(7);
        cdr.u32(1);
        cdr.text("ab");
        cdr.f64(1.0);
        let expected = [
            &[0, 1, 0, 0][..],
            &[7, 0, 0, 0],
            &[1, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0],
            // 15 bytes so far: one more to a multiple of eight.
            &[0],
            &1.0_f64.to_le_bytes(),
        ];
        assert_eq!(cdr.finish(), expected.concat());
    }
}
