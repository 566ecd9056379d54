//! Slow links and stuck clients.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use uw_live::Feed;

use crate::client::{Client, Cloud, Got};
use crate::scenes::{now_ns, picture, scanning, serve, stripe};

const SOON: Duration = Duration::from_secs(5);

/// Carries bytes at a rate, each way, and late.
fn thin(server: SocketAddr, bytes_per_s: f64, late: Duration) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for client in listener.incoming() {
            let client = client.unwrap();
            let upstream = TcpStream::connect(server).unwrap();
            for (mut from, mut to) in
                [(client.try_clone().unwrap(), upstream.try_clone().unwrap()), (upstream, client)]
            {
                to.set_nodelay(true).unwrap();
                // What waits on the link is bounded, as in a modem.
                let (send, receive) = sync_channel::<(Vec<u8>, Instant)>(16);
                std::thread::spawn(move || {
                    let mut free = Instant::now();
                    let mut buffer = [0; 1500];
                    while let Ok(count @ 1..) = from.read(&mut buffer) {
                        free = free.max(Instant::now()) + Duration::from_secs_f64(count as f64 / bytes_per_s);
                        std::thread::sleep(free.saturating_duration_since(Instant::now()));
                        if send.send((buffer[..count].to_vec(), free + late)).is_err() {
                            break;
                        }
                    }
                });
                std::thread::spawn(move || {
                    for (bytes, at) in receive {
                        std::thread::sleep(at.saturating_duration_since(Instant::now()));
                        if to.write_all(&bytes).is_err() {
                            break;
                        }
                    }
                    let _ = to.shutdown(Shutdown::Both);
                });
            }
        }
    });
    address
}

/// What feeding took.
struct Fed {
    frames: u32,
    /// Median, 99th percentile and longest of a frame's calls, us.
    took_us: [u64; 3],
}

/// Feeds frames at a rate until it is told to end.
fn scan(feed: Feed, rate_hz: f64, size: [u32; 2], end: Arc<AtomicBool>) -> std::thread::JoinHandle<Fed> {
    std::thread::spawn(move || {
        let began = Instant::now();
        let mut took_us = Vec::new();
        let mut frame = 0;
        let image = picture(0, size);
        while !end.load(Ordering::Acquire) {
            let due = began + Duration::from_secs_f64(f64::from(frame) / rate_hz);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let stripe = stripe(frame, size[1]);
            let mut picture = image.clone();
            (picture.frame, picture.stamp_ns) = (frame, now_ns());
            let called = Instant::now();
            feed.image(picture);
            feed.stripe(stripe);
            feed.state(scanning(frame as usize));
            took_us.push(called.elapsed().as_micros() as u64);
            frame += 1;
        }
        took_us.sort_unstable();
        let at = |share: f64| took_us[(share * (took_us.len() - 1) as f64) as usize];
        Fed { frames: frame, took_us: [at(0.5), at(0.99), at(1.0)] }
    })
}

#[test]
fn over_one_megabit_with_a_long_way_the_view_is_fresh_and_commands_are_heard() {
    let (server, feed, asked) = serve();
    std::thread::spawn(move || asked.into_iter().for_each(uw_live::Asked::done));
    let link = thin(server.listening(), 125e3, Duration::from_millis(150));
    let end = Arc::new(AtomicBool::new(false));
    let scanning = scan(feed, 50.0, [768, 576], end.clone());
    let mut client = Client::hello(link, None, "thin");
    client.text("welcome", SOON);
    let began = Instant::now();
    let (mut ages_s, mut images, mut cloud, mut answers) = (Vec::new(), 0, Cloud::default(), Vec::new());
    let (mut state_at, mut longest_s) = (Instant::now(), 0.0_f64);
    let (mut asked_at, mut id) = (None, 0);
    while began.elapsed() < Duration::from_secs(12) {
        if asked_at.is_none() && began.elapsed() > Duration::from_secs(2 + id) {
            id += 1;
            client.say(&serde_json::json!({"type": "command", "id": id, "do": "laser-off"}));
            asked_at = Some(Instant::now());
        }
        match client.next(Duration::from_millis(20)) {
            Some(Got::Binary(bytes)) => {
                cloud.take(&bytes);
                if bytes[0] != 2 {
                    images += usize::from(bytes[0] == 1);
                    let stamp_ns = u64::from_le_bytes(bytes[8..16].try_into().unwrap());
                    ages_s.push((now_ns() - stamp_ns) as f64 * 1e-9);
                }
            }
            Some(Got::Text(text)) if text["type"] == "state" => {
                longest_s = longest_s.max(state_at.elapsed().as_secs_f64());
                state_at = Instant::now();
            }
            Some(Got::Text(text)) if text["type"] == "answer" => {
                answers.push(asked_at.take().unwrap().elapsed().as_secs_f64());
            }
            Some(Got::Closed(code)) => panic!("closed with {code}"),
            _ => {}
        }
    }
    end.store(true, Ordering::Release);
    scanning.join().unwrap();
    let oldest_s = ages_s.iter().copied().fold(0.0, f64::max);
    let slowest_s = answers.iter().copied().fold(0.0, f64::max);
    println!(
        "1 Mbit/s, 300 ms: {images} images in 12 s, oldest {oldest_s:.2} s, {} points, {} answers, slowest {slowest_s:.2} s, \
         states at most {longest_s:.2} s apart",
        cloud.points.len(),
        answers.len()
    );
    assert!(images >= 20, "{images} images");
    assert!(oldest_s < 2.0, "a view that is {oldest_s} s old");
    assert!(answers.len() >= 5 && slowest_s < 1.0, "answers after {answers:?} s");
    assert!(longest_s < 2.0, "no state for {longest_s} s");
    // 28 800 points a second are more than the link carries: it gets a thinner cloud, of the whole scan.
    assert!(cloud.points.len() > 5000, "{} points", cloud.points.len());
    let last = cloud.points.last().unwrap()[0];
    assert!(last > 0.37 * 50.0 * 9.0 - 50.0, "the cloud ends at x = {last}");
}

#[test]
fn many_viewers_and_a_stuck_one_hold_nothing_up() {
    const SECONDS: Duration = Duration::from_secs(4);
    let (server, feed, _asked) = serve();
    let address = server.listening();
    // The same without anybody, to compare with.
    let end = Arc::new(AtomicBool::new(false));
    let alone = scan(feed.clone(), 200.0, [384, 288], end.clone());
    std::thread::sleep(SECONDS);
    end.store(true, Ordering::Release);
    let alone = alone.join().unwrap();
    let end = Arc::new(AtomicBool::new(false));
    let viewing: Vec<_> = (0..20)
        .map(|i| {
            let end = end.clone();
            std::thread::spawn(move || {
                let mut client = Client::hello(address, None, &i.to_string());
                let mut images = 0;
                while !end.load(Ordering::Acquire) {
                    let got = client.next(Duration::from_millis(50));
                    images += usize::from(matches!(got, Some(Got::Binary(bytes)) if bytes[0] == 1));
                }
                images
            })
        })
        .collect();
    // It reads nothing, and one more never acknowledges.
    let stuck = Client::hello(address, None, "stuck");
    let mut deaf = Client::hello(address, None, "deaf");
    deaf.acks = false;
    let watched = scan(feed, 200.0, [384, 288], end.clone());
    let began = Instant::now();
    let mut bulk = 0;
    while began.elapsed() < SECONDS {
        if let Some(Got::Binary(bytes)) = deaf.next(Duration::from_millis(50)) {
            bulk += bytes.len();
        }
    }
    end.store(true, Ordering::Release);
    let watched = watched.join().unwrap();
    let images: Vec<usize> = viewing.into_iter().map(|viewer| viewer.join().unwrap()).collect();
    println!(
        "200 Hz, alone: {} frames, {:?} us a frame; with 22 clients: {} frames, {:?} us; images {images:?}; deaf {bulk} bytes",
        alone.frames, alone.took_us, watched.frames, watched.took_us
    );
    // The clients are on the same processors here: the bar of 5 % is for a machine that has room for them.
    assert!(
        f64::from(watched.frames) > 0.9 * f64::from(alone.frames),
        "{} of {}",
        watched.frames,
        alone.frames
    );
    // What is unacknowledged is bounded, whatever is scanned: this is what memory and socket hold of it.
    assert!(bulk < 200_000, "{bulk} bytes to a client that acknowledges none");
    assert!(images.iter().all(|images| *images > 0), "{images:?}");
    drop(stuck);
}
