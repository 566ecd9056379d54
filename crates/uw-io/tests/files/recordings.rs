//! What a recording gives back: a capture bit for bit, what is left of a torn or damaged file, and how that is told.

use std::{
    fs,
    path::{Path, PathBuf},
};

use proptest::prelude::*;
use tempfile::TempDir;
use uw_io::{
    Capture, Error, Overwrite, Reduce, Severity,
    convert::{to_folder, to_recording},
    recording::{Options, Picture, Recorder, Shot, recover},
};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures").join(name)
}

fn lost(capture: &Capture) -> Vec<String> {
    let lost = capture.problems().iter().filter(|p| p.severity == Severity::Loss);
    lost.map(ToString::to_string).collect()
}

/// Writes values as a file of the format that the name tells.
fn image_file(path: &Path, values: &[u16], sixteen: bool) {
    let image = match sixteen {
        true => {
            image::DynamicImage::ImageLuma16(image::ImageBuffer::from_raw(4, 3, values.to_vec()).unwrap())
        }
        false => {
            let bytes = values.iter().map(|v| *v as u8).collect();
            image::DynamicImage::ImageLuma8(image::ImageBuffer::from_raw(4, 3, bytes).unwrap())
        }
    };
    image.save(path).unwrap();
}

#[test]
fn fixtures_come_back_bit_for_bit() {
    for name in ["ball", "cal-water"] {
        let dir = TempDir::new().unwrap();
        let (recording, back) = (dir.path().join("c.mcap"), dir.path().join("back"));
        let folder = Capture::open(&fixture(name)).unwrap();
        let made = to_recording(&folder, &recording, Overwrite::Refuse).unwrap();
        assert_eq!(made.images, folder.frames.len());
        let recorded = Capture::open(&recording).unwrap();
        assert_eq!(lost(&recorded), [""; 0]);
        assert_eq!((recorded.kind, recorded.medium), (folder.kind, folder.medium));
        assert_eq!((&recorded.target, &recorded.rig), (&folder.target, &folder.rig));
        for (a, b) in std::iter::zip(&recorded.frames, &folder.frames) {
            assert_eq!((a.row, &a.file, a.pose, a.laser_on), (b.row, &b.file, b.pose, b.laser_on));
            assert_eq!(
                (a.stamp_ns, a.voltage_v.map(f64::to_bits)),
                (b.stamp_ns, b.voltage_v.map(f64::to_bits))
            );
            let decode = |c: &Capture| c.image(a, Reduce::Luma, None).unwrap();
            assert_eq!(decode(&recorded), decode(&folder));
        }
        let made = to_folder(&recorded, &back).unwrap();
        assert_eq!((made.images, made.warnings.len()), (folder.frames.len(), 0));
        for frame in &folder.frames {
            let bytes = |c: &Path| fs::read(c.join(&frame.file)).unwrap();
            assert_eq!(bytes(&back), bytes(&folder.path), "{}", frame.file);
        }
        assert_eq!(fs::read(back.join("rig.toml")).unwrap(), fs::read(folder.path.join("rig.toml")).unwrap());
        let again = Capture::open(&back).unwrap();
        assert_eq!(again.frames, folder.frames);
        assert_eq!((again.kind, &again.target), (folder.kind, &folder.target));
        assert_eq!(again.problems().len(), 0);
    }
}

#[test]
fn every_format_of_images_keeps_its_values() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("c");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("capture.toml"), "format='uwscan-capture'\nversion=1\nkind='scan'\nmedium='air'\n")
        .unwrap();
    let names = [("a.png", true), ("b.tif", true), ("c.tiff", false), ("d.pgm", false), ("e.PNG", false)];
    let values: Vec<u16> = (0..12).map(|i| i * 5431 + 7).collect();
    let mut csv = "file,pose,laser,voltage_v,stamp_ns\n".to_owned();
    for (k, (name, sixteen)) in names.into_iter().enumerate() {
        image_file(&folder.join(name), &values, sixteen);
        csv += &format!("{name},,on,{},{}\n", 0.1 + k as f64, 100 + k);
    }
    // Twelve bits, as portable maps have them.
    let mut twelve = b"P5\n4 3\n4095\n".to_vec();
    twelve.extend((0..12_u16).flat_map(|i| (i * 372).to_be_bytes()));
    fs::write(folder.join("twelve.pgm"), twelve).unwrap();
    csv += "twelve.pgm,,off,,110\ngone.png,,off,,111\n";
    fs::write(folder.join("frames.csv"), csv).unwrap();

    let (recording, back) = (dir.path().join("c.mcap"), dir.path().join("back"));
    let capture = Capture::open(&folder).unwrap();
    to_recording(&capture, &recording, Overwrite::Refuse).unwrap();
    let recorded = Capture::open(&recording).unwrap();
    let losses = lost(&recorded);
    assert!(losses.len() == 1 && losses[0].contains("frame 6: its image was missing"), "{losses:?}");
    to_folder(&recorded, &back).unwrap();
    let again = Capture::open(&back).unwrap();
    for frame in capture.present() {
        let decode = |c: &Capture| c.image(frame, Reduce::Luma, None).unwrap();
        assert_eq!(decode(&recorded).data, decode(&capture).data, "{}", frame.file);
        assert_eq!(decode(&recorded).full_scale, decode(&capture).full_scale, "{}", frame.file);
        let twin = again.frames.iter().find(|f| f.row == frame.row).unwrap();
        assert_eq!(
            again.image(twin, Reduce::Luma, None).unwrap().data,
            decode(&capture).data,
            "{}",
            frame.file
        );
    }
    let message = to_recording(&capture, &recording, Overwrite::Refuse).unwrap_err().to_string();
    assert!(message.contains("exists already"), "{message}");
    let message = to_folder(&recorded, &back).unwrap_err().to_string();
    assert!(message.contains("exists already"), "{message}");
}

/// A recording of raw images in small chunks.
fn small(path: &Path, frames: u32, options: Options) {
    let mut head = uw_io::recording::Head::new(uw_io::Kind::Scan, uw_io::Medium::Air, None);
    head.planned_frames = Some(frames);
    head.rig = Some(fs::read_to_string(fixture("ball/rig.toml")).unwrap());
    let mut recorder = Recorder::create(path, Overwrite::Refuse, &head, 1000, options).unwrap();
    for number in 0..frames {
        let pixels: Vec<u8> = (0..600).map(|i| (i + number) as u8).collect();
        let shot = Shot {
            number,
            file: "",
            pose: None,
            laser_on: true,
            voltage_v: Some(f64::from(number)),
            stamp_ns: 1000 + u64::from(number) * 10_000_000,
            bits: 8,
        };
        recorder
            .frame(&shot, &Picture::U8 { width: 30, height: 20, pixels: &pixels }, shot.stamp_ns)
            .unwrap();
    }
    recorder.finish().unwrap();
}

/// What can be read of a file, image by image; `None` where there is no capture.
fn readable(path: &Path) -> Option<(Capture, usize)> {
    let capture = Capture::open(path).ok()?;
    let mut sound = 0;
    for frame in capture.present() {
        if let Ok(image) = capture.image(frame, Reduce::Luma, None) {
            let uw_io::Pixels::U8(pixels) = image.data else { panic!("8 bits were recorded") };
            let expected: Vec<u8> = (0..600).map(|i| (i + frame.row as u32) as u8).collect();
            assert_eq!(pixels, expected, "an image that is given out is the one that was recorded");
            sound += 1;
        }
    }
    Some((capture, sound))
}

fn options(compression: uw_io::recording::Compression) -> Options {
    Options { compression, chunk_bytes: 2000, ..Options::default() }
}

use uw_io::recording::Compression::{Lz4, None as Plain, Zstd};

#[test]
fn a_file_cut_off_anywhere_gives_all_before_and_is_recovered() {
    let dir = TempDir::new().unwrap();
    let (whole, torn, mended) =
        (dir.path().join("w.mcap"), dir.path().join("t.mcap"), dir.path().join("m.mcap"));
    for compression in [Plain, Lz4, Zstd] {
        _ = fs::remove_file(&whole);
        small(&whole, 12, options(compression));
        assert_eq!(readable(&whole).unwrap().1, 12);
        let bytes = fs::read(&whole).unwrap();
        let mut seen = 0;
        for length in (0..bytes.len()).step_by(41) {
            fs::write(&torn, &bytes[..length]).unwrap();
            let Some((capture, sound)) = readable(&torn) else {
                assert_eq!(seen, 0, "what was readable of less is readable of more");
                continue;
            };
            assert!(sound >= seen, "{sound} of {length} bytes, but {seen} of fewer");
            seen = sound;
            let losses = lost(&capture);
            assert!(losses.iter().any(|l| l.contains("cut off") || l.contains("not finished")), "{losses:?}");
            let last = capture.frames.last().unwrap().row;
            let planned = losses.iter().any(|l| l.contains("of 12 frames that were planned are missing"));
            assert_eq!(planned, last < 11, "{losses:?}");

            let recovered = recover(&torn, &mended, Overwrite::Replace).unwrap();
            assert!(!recovered.problems.is_empty());
            let (mended, again) = readable(&mended).unwrap();
            assert_eq!(again, sound);
            let losses = lost(&mended);
            assert!(losses.iter().all(|l| !l.contains("cut off") && !l.contains("finished")), "{losses:?}");
            assert!(mended.rig.is_some());
        }
        assert_eq!(seen, 12, "the index is not needed");
    }
}

#[test]
fn gaps_are_told_with_their_numbers_and_seconds() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("g.mcap");
    let head = uw_io::recording::Head::new(uw_io::Kind::Scan, uw_io::Medium::Air, None);
    let mut recorder = Recorder::create(&path, Overwrite::Refuse, &head, 0, Options::default()).unwrap();
    for number in [0, 1, 5, 6, 7] {
        let shot = Shot {
            number,
            file: "../../etc/passwd",
            pose: None,
            laser_on: number != 1,
            voltage_v: (number != 1).then_some(0.5),
            stamp_ns: u64::from(number) * 250_000_000,
            bits: 0,
        };
        if number == 6 {
            recorder.lost_frame(&shot, "the camera dropped it", shot.stamp_ns).unwrap();
        } else {
            recorder
                .frame(&shot, &Picture::U16 { width: 1, height: 1, pixels: &[9] }, shot.stamp_ns)
                .unwrap();
        }
    }
    let counts = recorder.finish().unwrap();
    assert_eq!((counts.frames, counts.lost_frames), (4, 1));
    let capture = Capture::open(&path).unwrap();
    let losses = lost(&capture).join("\n");
    assert!(losses.contains("3 frames, 2 to 4, are missing: 1.000 s pass"), "{losses}");
    assert!(losses.contains("frame 6: the camera dropped it"), "{losses}");
    let rows: Vec<usize> = capture.present().map(|f| f.row).collect();
    assert_eq!(rows, [0, 1, 5, 7]);
    assert!(
        capture.frames.iter().all(|f| f.file.starts_with("images/")),
        "names that lead out are not taken"
    );
}

#[test]
fn what_is_no_recording_of_ours_is_said() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("x.mcap");
    let open = || Capture::open(&path).unwrap_err().to_string();
    fs::write(&path, "no recording").unwrap();
    assert!(open().contains("neither a capture folder nor a recording"), "{}", open());
    let mut writer = mcap::WriteOptions::new()
        .profile("ros2")
        .create(std::io::BufWriter::new(fs::File::create(&path).unwrap()))
        .unwrap();
    writer.finish().unwrap();
    drop(writer);
    assert!(open().contains("profile \"ros2\""), "{}", open());
    let out = dir.path().join("out.mcap");
    let error = recover(&path, &out, Overwrite::Refuse).unwrap_err();
    assert!(matches!(error, Error::Content { .. }) && error.to_string().contains("no message"), "{error}");
    assert!(!out.exists());
}

const CHILD: &str = "UWSCAN_TEST_RECORDS_INTO";

fn now_ns() -> u64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64
}

/// Not a test: what the one below starts as a process of its own, and kills.
#[test]
fn records_until_it_is_killed() {
    let Some(path) = std::env::var_os(CHILD) else { return };
    let head = uw_io::recording::Head::new(uw_io::Kind::Scan, uw_io::Medium::Air, None);
    let began = now_ns();
    let mut recorder =
        Recorder::create(Path::new(&path), Overwrite::Refuse, &head, began, Options::default()).unwrap();
    for number in 0.. {
        let stamp_ns = now_ns();
        let shot =
            Shot { number, file: "", pose: None, laser_on: true, voltage_v: Some(0.0), stamp_ns, bits: 8 };
        let pixels: Vec<u8> = (0..64_000).map(|i| (i + number) as u8).collect();
        recorder.frame(&shot, &Picture::U8 { width: 320, height: 200, pixels: &pixels }, stamp_ns).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// What a process may lose that is killed at any moment.
const MOST_LOST_NS: u64 = 1_000_000_000;

#[test]
fn a_process_killed_at_any_moment_loses_at_most_a_second() {
    let dir = TempDir::new().unwrap();
    for round in 0..20_u64 {
        let (path, mended) =
            (dir.path().join(format!("{round}.mcap")), dir.path().join(format!("m{round}.mcap")));
        let mut child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "recordings::records_until_it_is_killed"])
            .env(CHILD, &path)
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let waiting = std::time::Instant::now();
        while !path.exists() && waiting.elapsed().as_secs() < 60 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        // Moments that no clock of the recorder's is in step with; from before the first chunk to after several.
        std::thread::sleep(std::time::Duration::from_micros(20_000 + round * 47_911));
        let killed_ns = now_ns();
        child.kill().unwrap();
        child.wait().unwrap();
        let last_ns = match Capture::open(&path) {
            Ok(capture) => {
                assert!(!lost(&capture).is_empty(), "a file that was cut off is told of");
                let rows: Vec<usize> = capture.present().map(|f| f.row).collect();
                assert_eq!(rows, (0..rows.len()).collect::<Vec<_>>(), "no image is lost before the last");
                for frame in capture.present().step_by(10) {
                    capture.image(frame, Reduce::Luma, None).unwrap();
                }
                recover(&path, &mended, Overwrite::Refuse).unwrap();
                let whole = Capture::open(&mended).unwrap();
                assert_eq!(whole.present().count(), rows.len());
                // A row whose image was just being written.
                assert!(
                    lost(&whole).len() <= 1 && whole.frames.len() <= rows.len() + 1,
                    "{:?}",
                    lost(&whole)
                );
                capture.present().last().unwrap().stamp_ns
            }
            // Killed before its first chunk: it had recorded for less than that.
            Err(_) => path
                .metadata()
                .unwrap()
                .modified()
                .unwrap()
                .duration_since(std::time::UNIX_EPOCH)
                .unwrap()
                .as_nanos() as u64,
        };
        let lost_ns = killed_ns.saturating_sub(last_ns);
        assert!(lost_ns < MOST_LOST_NS, "round {round}: the last {lost_ns} ns are lost");
    }
}

/// A disk of one megabyte, if it may be mounted.
struct SmallDisk(TempDir);

impl SmallDisk {
    fn mount() -> Option<Self> {
        let dir = TempDir::new().unwrap();
        let mount = std::process::Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"])
            .arg(dir.path())
            .stderr(std::process::Stdio::null())
            .status();
        mount.is_ok_and(|status| status.success()).then_some(Self(dir))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg(self.0.path()).status();
    }
}

#[test]
#[expect(clippy::print_stderr, reason = "a test that skips itself says so")]
fn a_disk_that_is_full_is_told_and_keeps_what_was_recorded() {
    let Some(disk) = SmallDisk::mount() else {
        eprintln!("skipped: a small disk can't be mounted here (needs root)");
        return;
    };
    let path = disk.0.path().join("full.mcap");
    let head = uw_io::recording::Head::new(uw_io::Kind::Scan, uw_io::Medium::Air, None);
    let options = Options { chunk_bytes: 100_000, ..Options::default() };
    let mut recorder = Recorder::create(&path, Overwrite::Refuse, &head, 0, options).unwrap();
    let failed = (0..1000_u32).find_map(|number| {
        let shot = Shot {
            number,
            file: "",
            pose: None,
            laser_on: true,
            voltage_v: Some(0.0),
            stamp_ns: number.into(),
            bits: 8,
        };
        let picture = Picture::U8 { width: 100, height: 100, pixels: &[7; 10_000] };
        recorder.frame(&shot, &picture, 0).err().map(|e| (number as usize, e.to_string()))
    });
    let (number, message) = failed.expect("a megabyte is soon full");
    assert!(message.contains("full.mcap: cannot write") && message.contains("free some space"), "{message}");
    assert!(recorder.finish().is_err());
    let capture = Capture::open(&path).unwrap();
    assert!(capture.frames.len() + 11 >= number, "{} of {number}", capture.frames.len());
    assert_eq!(capture.present().count(), capture.frames.len());
    let elsewhere = TempDir::new().unwrap();
    recover(&path, &elsewhere.path().join("whole.mcap"), Overwrite::Refuse).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever is wrong with the bytes: an error, or images that are those recorded; no panic, no memory for what is only
    /// claimed.
    #[test]
    fn damage_is_an_error_or_a_loss(
        compression in prop::sample::select(vec![Plain, Lz4, Zstd]),
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8_u32), 1..4),
        lengths in prop::collection::vec(any::<prop::sample::Index>(), 0..2),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let dir = TempDir::new().unwrap();
        let path = dir.path().join("d.mcap");
        small(&path, 8, options(compression));
        let mut bytes = fs::read(&path).unwrap();
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        for at in lengths {
            let at = at.index(bytes.len() - 8);
            bytes[at..at + 8].fill(0xff);
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        fs::write(&path, &bytes).unwrap();
        readable(&path);
        let mended = dir.path().join("m.mcap");
        if recover(&path, &mended, Overwrite::Refuse).is_ok() {
            readable(&mended);
        }
    }
}
