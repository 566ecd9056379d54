//! Bytes into lines.

/// What came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A line without its end; bytes that are no UTF-8 became U+FFFD.
    Text(String),
    /// More than a line may hold, thrown away up to its end.
    TooLong,
}

/// Collects bytes until a line is whole. Holds no more than the longest line.
#[derive(Clone, Debug)]
pub struct Lines {
    end: u8,
    longest: usize,
    part: Vec<u8>,
    /// The line that is coming has become too long.
    over: bool,
    whole: std::collections::VecDeque<Line>,
}

/// Whole lines that are kept: a controller that talks without end is not listened to without end.
const KEPT: usize = 64;

impl Lines {
    /// Lines that end with the byte `end` (a CR before LF is dropped) and are not longer than `longest` bytes.
    pub fn new(end: u8, longest: usize) -> Self {
        Self { end, longest, part: Vec::new(), over: false, whole: std::collections::VecDeque::new() }
    }

    /// Takes what came.
    pub fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if byte == self.end {
                self.end_line();
            } else if self.part.len() >= self.longest {
                self.over = true;
            } else {
                self.part.push(byte);
            }
        }
    }

    /// The next line that is whole; `None` while there is none. Empty lines are left out.
    pub fn next_line(&mut self) -> Option<Line> {
        self.whole.pop_front()
    }

    /// What came of a line that is not whole.
    pub fn part(&self) -> String {
        String::from_utf8_lossy(&self.part).into_owned()
    }

    /// Forgets all that came; whether there was anything.
    pub fn clear(&mut self) -> bool {
        let any = !(self.part.is_empty() && self.whole.is_empty());
        self.part.clear();
        self.whole.clear();
        self.over = false;
        any
    }

    fn end_line(&mut self) {
        let line = if std::mem::take(&mut self.over) {
            Line::TooLong
        } else {
            let text = String::from_utf8_lossy(&self.part);
            let text = text.trim_matches(['\r', '\n', '\0']);
            if text.is_empty() {
                self.part.clear();
                return;
            }
            Line::Text(text.to_owned())
        };
        self.part.clear();
        if self.whole.len() == KEPT {
            self.whole.pop_front();
        }
        self.whole.push_back(line);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(lines: &mut Lines) -> Vec<Line> {
        std::iter::from_fn(|| lines.next_line()).collect()
    }

    fn text(line: &str) -> Line {
        Line::Text(line.into())
    }

    #[test]
    fn lines_come_however_they_are_cut_and_whichever_way_they_end() {
        let bytes = b"+1.25E0\r\n\n\r\n0,\"No error\"\nhalf";
        for size in 1..bytes.len() {
            let mut lines = Lines::new(b'\n', 64);
            bytes.chunks(size).for_each(|chunk| lines.push(chunk));
            assert_eq!(all(&mut lines), [text("+1.25E0"), text("0,\"No error\"")], "{size}");
            assert_eq!(lines.part(), "half");
        }
        let mut lines = Lines::new(b'\r', 64);
        lines.push(b"1\r\n2\r");
        assert_eq!(all(&mut lines), [text("1"), text("2")]);
    }

    #[test]
    fn a_line_without_end_costs_no_memory_and_is_told() {
        let mut lines = Lines::new(b'\n', 16);
        for _ in 0..10_000 {
            lines.push(&[0xFF; 100]);
        }
        assert!(lines.part.capacity() <= 64);
        lines.push(b"\n1\n");
        assert_eq!(all(&mut lines), [Line::TooLong, text("1")]);
        (0..1000).for_each(|i| lines.push(format!("{i}\n").as_bytes()));
        assert_eq!(all(&mut lines).len(), KEPT);
    }

    #[test]
    fn garbage_is_a_line_like_any_other_and_nothing_panics() {
        let mut lines = Lines::new(b'\n', 16);
        lines.push(b"\xFE\xFF\x00\n");
        assert_eq!(all(&mut lines), [text("\u{FFFD}\u{FFFD}")]);
        assert!(!lines.clear());
        lines.push(b"abc\nd");
        assert!(lines.clear() && lines.next_line().is_none() && lines.part().is_empty());
    }
}
