//! How fast a client's link is, by its acknowledgements, and how much may be under way.
//!
//! A binary message counts as under way until it is acknowledged. What may be under way is what the link carries in one way there and
//! back and a fifth of a second more: enough to keep it busy, little enough that what matters never waits long behind it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Taken for a link's rate until it is known, bytes/s: 2 Mbit/s.
const FIRST_RATE: f64 = 250e3;
/// What may be under way at least and at most, bytes.
const WINDOW: (usize, usize) = (16 << 10, 2 << 20);
/// How long what is under way may take beyond the way there and back.
const SLACK: Duration = Duration::from_millis(200);
/// How much of a slower measurement is believed at a time.
const FORGET: f64 = 0.1;
/// How much faster than measured is tried.
const TRY: f64 = 1.25;
/// The shortest way is looked for anew after so long.
const SHORTEST_HOLDS: Duration = Duration::from_secs(20);

#[derive(Debug)]
struct Sent {
    sequence: u32,
    bytes: usize,
    at: Instant,
    delivered: u64,
    full: bool,
}

/// What is known of a link.
#[derive(Debug)]
pub struct Pace {
    told: Option<f64>,
    measured: Option<f64>,
    shortest: Option<(Duration, Instant)>,
    under_way: VecDeque<Sent>,
    bytes_under_way: usize,
    delivered: u64,
    delivered_at: Option<Instant>,
    /// With a told rate: when the next message may go.
    due: Option<Instant>,
}

impl Pace {
    /// Of a link that the client says carries `kbps`, or that is measured.
    pub fn new(kbps: Option<f64>) -> Self {
        Self {
            told: rate(kbps),
            measured: None,
            shortest: None,
            under_way: VecDeque::new(),
            bytes_under_way: 0,
            delivered: 0,
            delivered_at: None,
            due: None,
        }
    }

    /// The client says another rate, or none.
    pub fn tell(&mut self, kbps: Option<f64>) {
        self.told = rate(kbps);
        self.due = None;
    }

    /// Bytes a second.
    pub fn rate(&self) -> f64 {
        let measured = self.measured.unwrap_or(FIRST_RATE);
        match self.told {
            Some(told) if self.measured.is_some() => told.min(measured * TRY),
            Some(told) => told,
            None => measured,
        }
    }

    /// Bytes that may be under way.
    pub fn window(&self) -> usize {
        let way = self.shortest.map_or(Duration::ZERO, |(way, _)| way) + SLACK;
        ((self.rate() * TRY * way.as_secs_f64()) as usize).clamp(WINDOW.0, WINDOW.1)
    }

    /// Whether another message may go now, or when.
    ///
    /// # Errors
    /// When to ask again, where time alone is waited for; `None` where an acknowledgement is.
    pub fn may_send(&self, now: Instant) -> Result<(), Option<Instant>> {
        if self.bytes_under_way >= self.window() {
            return Err(None);
        }
        match self.due {
            Some(due) if due > now => Err(Some(due)),
            _ => Ok(()),
        }
    }

    /// A message has gone.
    pub fn sent(&mut self, sequence: u32, bytes: usize, now: Instant) {
        if self.under_way.is_empty() {
            self.delivered_at = Some(now);
        }
        self.bytes_under_way += bytes;
        let full = self.bytes_under_way >= self.window();
        self.under_way.push_back(Sent { sequence, bytes, at: now, delivered: self.delivered, full });
        if let Some(told) = self.told {
            let from = self.due.filter(|due| *due > now).unwrap_or(now);
            self.due = Some(from + Duration::from_secs_f64(bytes as f64 / told));
        }
    }

    /// All messages until this one have come; whether there was one.
    pub fn acknowledged(&mut self, sequence: u32, now: Instant) -> bool {
        let mut last = None;
        while let Some(first) = self.under_way.front() {
            // Counted round: what lies less than half of all numbers behind has come.
            if sequence.wrapping_sub(first.sequence) > u32::MAX / 2 {
                break;
            }
            self.bytes_under_way -= first.bytes;
            self.delivered += first.bytes as u64;
            last = self.under_way.pop_front();
        }
        let Some(last) = last else { return false };
        let took = now.saturating_duration_since(last.at);
        match self.shortest {
            Some((way, found)) if way <= took && now.saturating_duration_since(found) < SHORTEST_HOLDS => {}
            _ => self.shortest = Some((took, now)),
        }
        let rate = (self.delivered - last.delivered) as f64 / took.as_secs_f64().max(1e-4);
        self.measured = Some(match self.measured {
            None => rate,
            Some(known) if rate >= known => rate,
            // Slower: only believed where it was the link that was waited for.
            Some(known) if last.full => known + FORGET * (rate - known),
            Some(known) => known,
        });
        self.delivered_at = Some(now);
        true
    }

    /// How long the oldest message has been under way.
    pub fn oldest(&self, now: Instant) -> Duration {
        self.under_way.front().map_or(Duration::ZERO, |sent| now.saturating_duration_since(sent.at))
    }
}

/// Bytes a second; what is no rate is none.
fn rate(kbps: Option<f64>) -> Option<f64> {
    kbps.filter(|kbps| kbps.is_finite() && *kbps > 0.0).map(|kbps| (kbps * 125.0).max(1000.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link of some rate and way, fed as the window allows; its pace after `seconds`, and the longest queue, s.
    fn run(rate: f64, way: Duration, told: Option<f64>, seconds: f64) -> (Pace, f64) {
        let began = Instant::now();
        let mut pace = Pace::new(told);
        let (mut now, mut free, mut sequence, mut longest) = (began, began, 0, 0.0_f64);
        let mut acks: VecDeque<(u32, Instant)> = VecDeque::new();
        while now < began + Duration::from_secs_f64(seconds) {
            if acks.front().is_some_and(|(_, at)| *at <= now) {
                let (which, at) = acks.pop_front().unwrap();
                assert!(pace.acknowledged(which, at));
            } else if pace.may_send(now).is_ok() {
                free = free.max(now) + Duration::from_secs_f64(10_000.0 / rate);
                longest = longest.max((free - now).as_secs_f64());
                pace.sent(sequence, 10_000, now);
                acks.push_back((sequence, free + way));
                sequence += 1;
            } else {
                let due = pace.may_send(now).unwrap_err();
                now = due.into_iter().chain(acks.front().map(|(_, at)| *at)).min().unwrap().max(now);
            }
        }
        (pace, longest)
    }

    #[test]
    fn a_thin_link_is_measured_and_its_queue_stays_short() {
        let (pace, longest) = run(125e3, Duration::from_millis(300), None, 20.0);
        assert!((pace.rate() / 125e3 - 1.0).abs() < 0.15, "{}", pace.rate());
        assert!(longest < 0.6, "{longest} s queued");
    }

    #[test]
    fn a_fast_link_is_used() {
        let (pace, _) = run(50e6, Duration::from_millis(1), None, 2.0);
        assert!(pace.rate() > 25e6, "{}", pace.rate());
    }

    #[test]
    fn a_client_that_says_its_rate_gets_no_more() {
        let (mut pace, _) = run(50e6, Duration::from_millis(1), Some(1000.0), 10.0);
        assert!(pace.delivered as f64 <= 1.05 * 10.0 * 125e3, "{} bytes in 10 s", pace.delivered);
        assert!(pace.delivered as f64 >= 0.9 * 10.0 * 125e3, "{} bytes in 10 s", pace.delivered);
        pace.tell(Some(f64::NAN));
        assert_eq!(pace.told, None);
    }

    #[test]
    fn who_acknowledges_nothing_gets_a_bounded_number_of_bytes() {
        let now = Instant::now();
        let mut pace = Pace::new(None);
        let mut sent = 0;
        while pace.may_send(now).is_ok() {
            pace.sent(sent, 1000, now);
            sent += 1;
        }
        assert!(sent < 100, "{sent}");
        assert!(!pace.acknowledged(sent + 5_000_000, now) || pace.bytes_under_way == 0);
    }
}
