//! What a client sees, and what it may ask for.

use std::time::{Duration, Instant};

use serde_json::json;
use uw_live::{About, Action, Level, Phase, State};

use crate::client::{Client, Cloud, Got};
use crate::scenes::{CONTROL, VIEW, picture, positions, scanning, serve, serve_with_tokens, stripe};

const SOON: Duration = Duration::from_secs(5);

/// Takes what comes until a cloud has so many points.
fn gather(client: &mut Client, cloud: &mut Cloud, count: usize) {
    let deadline = Instant::now() + SOON;
    while cloud.points.len() < count {
        assert!(Instant::now() < deadline, "{} of {count} points", cloud.points.len());
        if let Some(Got::Binary(bytes)) = client.next(Duration::from_millis(100)) {
            cloud.take(&bytes);
        }
    }
}

fn assert_same(cloud: &Cloud, expected: &[[f64; 3]]) {
    assert_eq!(cloud.points.len(), expected.len());
    assert!(cloud.half_step < 0.01, "steps of {} mm", 2.0 * cloud.half_step);
    for (got, expected) in std::iter::zip(&cloud.points, expected) {
        for axis in 0..3 {
            // The position is rounded to f32, too.
            let off = (got[axis] - expected[axis]).abs();
            assert!(off <= cloud.half_step * 1.001 + 1e-4, "{got:?}, not {expected:?}");
        }
    }
}

#[test]
fn a_client_is_welcomed_and_sees_the_scan() {
    let (server, feed, _asked) = serve();
    feed.about(About { image_size: [96, 64], volts: Some([-1.0, 2.0]), ..About::default() });
    feed.note(Level::Warning, "the disk is slow");
    let mut client = Client::hello(server.listening(), None, "bow");
    let welcome = client.text("welcome", SOON);
    assert_eq!((&welcome["rights"], &welcome["mode"]), (&json!("control"), &json!("scan")));
    assert_eq!(welcome["camera"], json!({"width": 96, "height": 64}));
    assert_eq!((&welcome["volts"]["from"], &welcome["across"]), (&json!(-1.0), &json!("row")));
    let state = client.text("state", SOON);
    assert_eq!((&state["phase"], &state["viewers"]), (&json!("idle"), &json!(1)));
    assert_eq!(client.text("note", SOON)["text"], "the disk is slow");
    // A change of phase is told at once.
    let began = Instant::now();
    feed.state(scanning(1));
    while client.text("state", SOON)["phase"] != "scanning" {}
    assert!(began.elapsed() < Duration::from_millis(500), "{:?}", began.elapsed());
    feed.image(picture(7, [96, 64]));
    feed.stripe(stripe(7, 64));
    let (mut seen, mut signal) = ([false; 4], json!(null));
    while !seen[1] || !seen[2] || !seen[3] || signal.is_null() {
        let bytes = match client.next(SOON) {
            Some(Got::Binary(bytes)) => bytes,
            Some(Got::Text(text)) if text["type"] == "signal" => {
                signal = text;
                continue;
            }
            Some(_) => continue,
            None => panic!("{seen:?}, {signal}"),
        };
        seen[usize::from(bytes[0])] = true;
        if bytes[0] == 1 {
            assert_eq!(u32::from_le_bytes(bytes[16..20].try_into().unwrap()), 7);
            assert_eq!(u32::from_le_bytes(bytes[24..28].try_into().unwrap()), 64);
            // 307.2 px lies outside of an image of 96 columns in no unit: it is told as it is.
            assert_eq!(u16::from_le_bytes(bytes[28..30].try_into().unwrap()), 19661);
            let jpeg = &bytes[32 + 2 * 64..];
            let image = image::load_from_memory(jpeg).unwrap();
            assert_eq!((image.width(), image.height()), (96, 64));
        }
    }
    assert_eq!((&signal["frame"], &signal["found"]), (&json!(7), &json!(1.0)));
}

#[test]
fn the_points_of_a_client_are_the_clouds() {
    let (server, feed, _asked) = serve();
    (0..10).for_each(|frame| feed.stripe(stripe(frame, 200)));
    let mut client = Client::hello(server.listening(), None, "late");
    let mut cloud = Cloud::default();
    gather(&mut client, &mut cloud, 2000);
    (10..30).for_each(|frame| feed.stripe(stripe(frame, 200)));
    gather(&mut client, &mut cloud, 6000);
    assert_same(&cloud, &positions(0..30, 200));
    assert_eq!(cloud.brightness[77], 77);
    // Another client that has a part of it already gets the rest.
    drop(client);
    let mut client = Client::connect(server.listening(), None);
    client.say(&json!({"type": "hello", "token": null, "client": "back", "bandwidth_kbps": null}));
    client.say(&json!({"type": "have", "epoch": cloud.epoch, "points": 4000}));
    cloud.points.truncate(4000);
    let mut again = Cloud { epoch: cloud.epoch, points: cloud.points.clone(), ..Cloud::default() };
    // What was on its way before the server knew begins at the beginning.
    let deadline = Instant::now() + SOON;
    while again.points.len() < 6000 && Instant::now() < deadline {
        let Some(Got::Binary(bytes)) = client.next(SOON) else { continue };
        if bytes[0] == 2 {
            let first = u64::from_le_bytes(bytes[12..20].try_into().unwrap()) as usize;
            again.points.truncate(first);
            again.take(&bytes);
        }
    }
    assert_same(&again, &positions(0..30, 200));
    // A scan that starts anew empties it.
    feed.restart();
    feed.stripe(stripe(50, 100));
    let before = again.epoch;
    while again.epoch == before || again.points.len() < 100 {
        if let Some(Got::Binary(bytes)) = client.next(SOON) {
            again.take(&bytes);
        }
    }
    assert_same(&again, &positions(50..51, 100));
}

#[test]
fn only_who_may_steers_and_only_one_does() {
    let (server, _feed, asked) = serve_with_tokens();
    let obeying = std::thread::spawn(move || {
        let mut done = Vec::new();
        for asked in asked {
            done.push((asked.action.clone(), asked.who.clone()));
            if asked.action == Action::Pause { asked.refuse("not now") } else { asked.done() }
        }
        done
    });
    let address = server.listening();
    let mut viewer = Client::hello(address, Some(VIEW), "viewer");
    assert_eq!(viewer.text("welcome", SOON)["rights"], "view");
    for word in ["take-control", "start", "stop", "laser-off"] {
        assert!(viewer.command(1, word).unwrap().contains("only watch"), "{word}");
    }
    let mut bow = Client::hello(address, Some(CONTROL), "bow");
    let mut stern = Client::hello(address, Some(CONTROL), "stern");
    assert_eq!(bow.text("welcome", SOON)["rights"], "control");
    assert!(bow.command(2, "start").unwrap().contains("take control"));
    assert_eq!(bow.command(3, "take-control"), None);
    assert_eq!(stern.command(4, "take-control").as_deref(), Some("bow steers: only one can"));
    assert!(stern.command(5, "resume").unwrap().contains("take control"));
    assert_eq!(bow.command(6, "start"), None);
    assert_eq!(bow.command(7, "pause").as_deref(), Some("not now"));
    // Anybody with the right may put the laser off.
    let began = Instant::now();
    assert_eq!(stern.command(8, "laser-off"), None);
    assert!(began.elapsed() < Duration::from_millis(500), "{:?}", began.elapsed());
    assert_eq!(stern.command(9, "stop"), None);
    while stern.text("state", SOON)["controller"] != "bow" {}
    drop(bow);
    // Its holder is gone: the place is free.
    let deadline = Instant::now() + SOON;
    while stern.command(10, "take-control").is_some() {
        assert!(Instant::now() < deadline);
    }
    loop {
        let state = stern.text("state", SOON);
        if state["you_control"] == true {
            break assert_eq!(state["controller"], "stern");
        }
    }
    drop((server, stern, viewer));
    let done = obeying.join().unwrap();
    let actions: Vec<&Action> = done.iter().map(|(action, _)| action).collect();
    assert_eq!(actions, [&Action::Start, &Action::Pause, &Action::LaserOff, &Action::Stop]);
    assert!(done[0].1.starts_with("bow (127.0.0.1:"), "{done:?}");
}

#[test]
fn what_nobody_hears_is_refused_and_the_end_is_told() {
    let (server, feed, asked) = serve();
    let mut client = Client::hello(server.listening(), None, "x");
    client.text("welcome", SOON);
    drop(asked);
    assert!(client.command(1, "stop").unwrap().contains("nobody took it"));
    let ended = Some("SIGINT (Ctrl-C)".to_owned());
    feed.state(State { phase: Phase::Finished, ended, ..State::default() });
    server.close(Duration::from_millis(300));
    let mut last = json!(null);
    let code = loop {
        match client.next(SOON) {
            Some(Got::Text(text)) if text["type"] == "state" => last = text,
            Some(Got::Closed(code)) => break code,
            _ => {}
        }
    };
    assert_eq!((code, &last["phase"], &last["ended"]), (1001, &json!("finished"), &json!("SIGINT (Ctrl-C)")));
}
