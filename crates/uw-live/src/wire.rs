//! Messages to bytes and back: docs/live-protocol.md.

use serde::Deserialize;

use crate::cloud::Point;
use crate::control::{Replay, Word};
use crate::feed::Stripe;

/// The subprotocol.
pub const PROTOCOL: &str = "uwscan.live.v1";
/// Largest message of a client, bytes.
pub const MOST_BYTES: usize = 64 << 10;
/// Bytes of a point.
pub const POINT_BYTES: usize = 7;
/// Parts of a stripe whose quality is told.
const PARTS: usize = 64;
/// A stripe's position where there is none.
const NONE: u16 = u16::MAX;
/// Positions are told in this share of a pixel, times two to the message's flags.
const POSITION_STEP: f64 = 1.0 / 64.0;

/// What a client says.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum FromClient {
    /// Who it is: first of all.
    Hello {
        /// What lets it in.
        token: Option<String>,
        /// A name that others are shown.
        client: Option<String>,
        /// Its link, kbit/s.
        bandwidth_kbps: Option<f64>,
    },
    /// It has all binary messages until this.
    Ack {
        /// The last one's number.
        sequence: u32,
    },
    /// What it wants to see.
    View {
        /// Its link, kbit/s.
        bandwidth_kbps: Option<f64>,
        /// Images; absent: as before.
        image: Option<bool>,
        /// Points; absent: as before.
        points: Option<bool>,
        /// The share of the points, at most; `None`: as the link allows.
        #[serde(default)]
        density: Option<f64>,
    },
    /// What it has already.
    Have {
        /// Of which cloud.
        epoch: u32,
        /// How many.
        points: u64,
    },
    /// Something of the scan.
    Command {
        /// The answer's.
        id: u64,
        /// What.
        #[serde(rename = "do")]
        word: Word,
    },
    /// Something of a replay.
    Replay {
        /// The answer's.
        id: u64,
        /// What.
        #[serde(rename = "do")]
        word: ReplayWord,
        /// Which, to open.
        capture: Option<String>,
        /// Where, to seek.
        frame: Option<u32>,
        /// How fast.
        rate: Option<f64>,
    },
    /// Which captures there are.
    Captures,
}

/// The words of a replay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ReplayWord {
    /// [`Replay::Open`].
    Open,
    /// [`Replay::Play`].
    Play,
    /// [`Replay::Pause`].
    Pause,
    /// [`Replay::Seek`].
    Seek,
    /// [`Replay::Rate`].
    Rate,
}

/// What a replay is asked for; `None` where a value is missing that it needs, or is none.
pub fn replay(
    word: ReplayWord,
    capture: Option<String>,
    frame: Option<u32>,
    rate: Option<f64>,
) -> Option<Replay> {
    Some(match word {
        ReplayWord::Open => Replay::Open(capture?),
        ReplayWord::Play => Replay::Play,
        ReplayWord::Pause => Replay::Pause,
        ReplayWord::Seek => Replay::Seek(frame?),
        ReplayWord::Rate => rate.and_then(Replay::rate)?,
    })
}

/// The start of a binary message.
fn head(kind: u8, flags: u8, sequence: u32, room: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(8 + room);
    bytes.extend([kind, flags, 0, 0]);
    bytes.extend(sequence.to_le_bytes());
    bytes
}

/// An image and its stripe: `size` is the image's whole size, whatever that of the JPEG.
pub fn image(
    sequence: u32,
    (stamp_ns, frame): (u64, u32),
    size: [u32; 2],
    stripe: Option<&Stripe>,
    jpeg: &[u8],
) -> Vec<u8> {
    let positions = stripe.map(|stripe| positions(stripe, size)).unwrap_or_default();
    // Wide images need coarser steps than 1/64 px for all of them to be told.
    let widest = f64::from(size[0].max(size[1]));
    let flags = (0..8).find(|flags| widest < step(*flags) * f64::from(NONE)).unwrap_or(8);
    let mut bytes = head(1, flags, sequence, 28 + 2 * positions.len() + jpeg.len());
    bytes.extend(stamp_ns.to_le_bytes());
    bytes.extend(frame.to_le_bytes());
    size.iter().for_each(|side| bytes.extend(u16::try_from(*side).unwrap_or(u16::MAX).to_le_bytes()));
    bytes.extend((positions.len() as u32).to_le_bytes());
    for position in positions {
        let steps = position.map(|px| (px / step(flags)).round()).filter(|steps| *steps >= 0.0);
        let told = steps.filter(|steps| *steps < f64::from(NONE)).map_or(NONE, |steps| steps as u16);
        bytes.extend(told.to_le_bytes());
    }
    bytes.extend((jpeg.len() as u32).to_le_bytes());
    bytes.extend(jpeg);
    bytes
}

fn step(flags: u8) -> f64 {
    POSITION_STEP * f64::from(1_u32 << flags)
}

/// One position a line, px.
fn positions(stripe: &Stripe, size: [u32; 2]) -> Vec<Option<f64>> {
    let most = size[1 - stripe.across.index()];
    let mut all = vec![None; stripe.all_lines.min(most) as usize];
    for (line, position) in std::iter::zip(&stripe.lines, &stripe.position_px) {
        if let Some(place) = all.get_mut(*line as usize) {
            *place = Some(*position);
        }
    }
    all
}

/// Points, the first of which is the `first`th of the epoch. None is more than half a step off on any axis.
pub fn points(sequence: u32, epoch: u32, first: u64, points: &[Point]) -> Vec<u8> {
    let mut corner = [f32::INFINITY; 3];
    let mut far = [f32::NEG_INFINITY; 3];
    for point in points {
        for (i, x) in point.position_mm.iter().enumerate() {
            corner[i] = corner[i].min(*x);
            far[i] = far[i].max(*x);
        }
    }
    let longest = (0..3).map(|i| f64::from(far[i]) - f64::from(corner[i])).fold(0.0, f64::max);
    // Rounded up, so that the farthest is within reach.
    let step = ((longest / f64::from(u16::MAX)) as f32).next_up().max(1e-9);
    if points.is_empty() {
        corner = [0.0; 3];
    }
    let mut bytes = head(2, 0, sequence, 32 + POINT_BYTES * points.len());
    bytes.extend(epoch.to_le_bytes());
    bytes.extend(first.to_le_bytes());
    bytes.extend((points.len() as u32).to_le_bytes());
    corner.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    bytes.extend(step.to_le_bytes());
    for point in points {
        for (x, corner) in std::iter::zip(point.position_mm, corner) {
            let steps = (f64::from(x) - f64::from(corner)) / f64::from(step);
            bytes.extend((steps.round() as u16).to_le_bytes());
        }
        bytes.push(point.brightness);
    }
    bytes
}

/// The points of one image.
pub fn profile(sequence: u32, stripe: &Stripe) -> Vec<u8> {
    let positions = stripe.cloud.positions_mm();
    let mut bytes = head(3, 0, sequence, 20 + 12 * positions.len());
    bytes.extend(stripe.stamp_ns.to_le_bytes());
    bytes.extend(stripe.frame.to_le_bytes());
    bytes.extend((stripe.voltage_v as f32).to_le_bytes());
    let finite = positions.iter().filter(|position| position.iter().all(|x| x.is_finite()));
    bytes.extend((finite.clone().count() as u32).to_le_bytes());
    finite.flatten().for_each(|x| bytes.extend((*x as f32).to_le_bytes()));
    bytes
}

/// The quality of a stripe along itself.
pub fn signal(stripe: &Stripe) -> serde_json::Value {
    let mut parts: Vec<(Vec<f32>, Vec<f32>)> = vec![Default::default(); PARTS];
    let lines = stripe.all_lines.max(1);
    for (i, line) in stripe.lines.iter().enumerate() {
        let part = (u64::from(*line) * PARTS as u64 / u64::from(lines)) as usize;
        if let Some((amplitudes, sigmas)) = parts.get_mut(part) {
            amplitudes.push(stripe.amplitude[i]);
            sigmas.push(stripe.sigma_px[i]);
        }
    }
    let amplitude: Vec<_> = parts.iter_mut().map(|(amplitudes, _)| median(amplitudes)).collect();
    let sigma_px: Vec<_> = parts.iter_mut().map(|(_, sigmas)| median(sigmas)).collect();
    let found = stripe.lines.len() as f64 / f64::from(lines);
    serde_json::json!({
        "type": "signal", "frame": stripe.frame, "found": found, "amplitude": amplitude, "sigma_px": sigma_px,
    })
}

fn median(values: &mut [f32]) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    // More digits than a plot shows would be most of the message.
    values.get(values.len() / 2).map(|value| (value * 1e4).round() * 1e-4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use uw_calib::Across;
    use uw_cloud::PointCloud;

    fn f32_at(bytes: &[u8], at: usize) -> f32 {
        f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    fn u16_at(bytes: &[u8], at: usize) -> u16 {
        u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
    }

    proptest! {
        #[test]
        fn points_come_back_to_half_a_step(
            positions in prop::collection::vec(prop::array::uniform3(-5000.0_f32..5000.0), 1..200),
            first: u64,
        ) {
            let of = |position_mm| Point { position_mm, brightness: 9 };
            let sent: Vec<Point> = positions.iter().copied().map(of).collect();
            let bytes = points(3, 17, first, &sent);
            prop_assert_eq!(bytes.len(), 40 + 7 * sent.len());
            prop_assert_eq!(u64::from_le_bytes(bytes[12..20].try_into().unwrap()), first);
            let corner = [24, 28, 32].map(|at| f64::from(f32_at(&bytes, at)));
            let step = f64::from(f32_at(&bytes, 36));
            prop_assert!(step <= 10_000.0 / 65_000.0);
            for (i, point) in sent.iter().enumerate() {
                for (axis, corner) in corner.iter().enumerate() {
                    let got = corner + step * f64::from(u16_at(&bytes, 40 + 7 * i + 2 * axis));
                    let off = (got - f64::from(point.position_mm[axis])).abs();
                    prop_assert!(off <= 0.5001 * step, "{} of {}", off, step);
                }
                prop_assert_eq!(bytes[40 + 7 * i + 6], 9);
            }
        }

        #[test]
        fn no_text_of_a_client_is_a_panic(text in ".{0,200}") {
            let _ = serde_json::from_str::<FromClient>(&text);
            let _ = serde_json::from_str::<FromClient>(&format!("{{\"type\":\"command\",\"id\":{text}}}"));
        }
    }

    fn stripe(lines: &[u32], position_px: &[f64]) -> Stripe {
        Stripe {
            frame: 5,
            stamp_ns: 77,
            voltage_v: 0.5,
            across: Across::U,
            all_lines: 640,
            lines: lines.to_vec(),
            position_px: position_px.to_vec(),
            sigma_px: vec![0.1; lines.len()],
            width_px: vec![2.0; lines.len()],
            amplitude: lines.iter().map(|line| *line as f32).collect(),
            full_scale: 255.0,
            cloud: PointCloud::default(),
        }
    }

    #[test]
    fn positions_of_a_stripe_are_told_line_by_line() {
        let read = |bytes: &[u8], line: usize| {
            let told = u16_at(bytes, 28 + 2 * line);
            (told != NONE).then(|| f64::from(told) / 64.0 * f64::from(1 << bytes[1]))
        };
        let bytes = image(1, (77, 5), [768, 640], Some(&stripe(&[0, 9, 9999], &[1.25, 700.5, 3.0])), b"jpeg");
        assert_eq!((bytes[0], bytes[1], u16_at(&bytes, 20), u16_at(&bytes, 22)), (1, 0, 768, 640));
        assert_eq!((read(&bytes, 0), read(&bytes, 1), read(&bytes, 9)), (Some(1.25), None, Some(700.5)));
        assert_eq!(&bytes[bytes.len() - 8..], b"\x04\0\0\0jpeg");
        let wide = image(1, (77, 5), [4096, 640], Some(&stripe(&[3], &[4000.0])), b"");
        assert_eq!(read(&wide, 3), Some(4000.0));
        let none = image(1, (77, 5), [4096, 640], None, b"");
        assert_eq!(none.len(), 32);
    }

    #[test]
    fn quality_is_told_in_equal_parts() {
        let lines: Vec<u32> = (10..30).collect();
        let told = signal(&stripe(&lines, &vec![0.0; lines.len()]));
        assert_eq!(told["amplitude"].as_array().unwrap().len(), 64);
        assert_eq!((&told["amplitude"][0], &told["amplitude"][1]), (&serde_json::Value::Null, &15.0.into()));
        assert_eq!((&told["amplitude"][2], &told["sigma_px"][2]), (&25.0.into(), &told["sigma_px"][1]));
        assert_eq!(told["found"], 20.0 / 640.0);
    }

    #[test]
    fn what_clients_say_is_read_as_the_protocol_has_it() {
        let read = |text: &str| serde_json::from_str::<FromClient>(text);
        let command = read(r#"{"type": "command", "id": 7, "do": "laser-off"}"#).unwrap();
        assert_eq!(command, FromClient::Command { id: 7, word: Word::LaserOff });
        let hello = read(r#"{"type":"hello","token":null,"client":"a","bandwidth_kbps":1000}"#).unwrap();
        assert!(matches!(hello, FromClient::Hello { token: None, bandwidth_kbps: Some(_), .. }));
        assert_eq!(read(r#"{"type":"captures"}"#).unwrap(), FromClient::Captures);
        let seek = read(r#"{"type":"replay","id":8,"do":"seek","capture":"x","frame":3}"#).unwrap();
        let FromClient::Replay { word, capture, frame, rate, .. } = seek else { panic!("{seek:?}") };
        assert_eq!(replay(word, capture, frame, rate), Some(Replay::Seek(3)));
        assert_eq!(replay(ReplayWord::Rate, None, None, Some(f64::NAN)), None);
        for bad in ["", "{}", "[]", r#"{"type":"command","id":-1,"do":"stop"}"#, r#"{"type":"ack"}"#] {
            assert!(read(bad).is_err(), "{bad}");
        }
    }
}
