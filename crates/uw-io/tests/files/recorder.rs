//! What a recorder writes, read by the crate `mcap`; and what it does when its disk fails.

use std::{
    io::{self, Write},
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use mcap::records::Record;
use uw_io::{
    Kind, Medium,
    recording::{Compression, GalvoState, Head, Level, Options, Picture, Recorder, Shot, Sink},
};

/// Memory as a sink, with a limit to what fits.
#[derive(Clone)]
struct Memory {
    bytes: Arc<Mutex<Vec<u8>>>,
    limit: usize,
    slow: Duration,
}

impl Memory {
    fn new(limit: usize) -> Self {
        Self { bytes: Arc::default(), limit, slow: Duration::ZERO }
    }

    fn bytes(&self) -> Vec<u8> {
        self.bytes.lock().unwrap().clone()
    }
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        std::thread::sleep(self.slow);
        let mut all = self.bytes.lock().unwrap();
        let fits = bytes.len().min(self.limit - all.len());
        if fits == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        all.extend_from_slice(&bytes[..fits]);
        Ok(fits)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Sink for Memory {
    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.bytes.lock().unwrap().truncate(length as usize);
        Ok(())
    }
}

const BEGAN_NS: u64 = 1_700_000_000_123_456_789;
const SIZE: [u32; 2] = [64, 48];

fn shot(number: u32) -> Shot<'static> {
    Shot {
        number,
        file: "",
        pose: None,
        laser_on: true,
        voltage_v: Some(0.1 * f64::from(number)),
        stamp_ns: BEGAN_NS + u64::from(number) * 2_000_000,
        bits: 8,
    }
}

fn pixels(number: u32) -> Vec<u8> {
    (0..SIZE[0] * SIZE[1]).map(|i| (i * 7 + number * 13) as u8).collect()
}

fn record(recorder: &mut Recorder<Memory>, number: u32) -> Result<(), uw_io::Error> {
    let [width, height] = SIZE;
    let shot = shot(number);
    recorder.frame(&shot, &Picture::U8 { width, height, pixels: &pixels(number) }, shot.stamp_ns + 1000)
}

fn recorder(memory: &Memory, options: Options) -> Recorder<Memory> {
    let head = Head { scan_id: "pool-7".to_owned(), ..Head::new(Kind::Scan, Medium::Water, None) };
    Recorder::new(memory.clone(), Path::new("scan.mcap"), &head, BEGAN_NS, options).unwrap()
}

#[test]
fn another_reader_finds_what_was_recorded() {
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let memory = Memory::new(usize::MAX);
        let mut recorder =
            recorder(&memory, Options { compression, chunk_bytes: 10_000, ..Options::default() });
        for number in 0..20 {
            let state = GalvoState { frame: Some(number), commanded_v: Some(1.0), ..GalvoState::default() };
            recorder.galvo(&state, BEGAN_NS).unwrap();
            record(&mut recorder, number).unwrap();
        }
        recorder.log(Level::Info, "all of it", BEGAN_NS).unwrap();
        let counts = recorder.finish().unwrap();
        let bytes = memory.bytes();
        assert_eq!((counts.frames, counts.messages, counts.bytes), (20, 61, bytes.len() as u64));

        let summary = mcap::Summary::read(&bytes).unwrap().expect("a finished file has a summary");
        assert!(summary.chunk_indexes.len() >= 5, "chunks are closed by size");
        assert_eq!(summary.stats.expect("statistics").message_count, 61);
        let images = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        let images: Vec<_> = images.filter(|m| m.channel.topic == "/camera/image").collect();
        assert_eq!(images.len(), 20);
        for (number, message) in (0..).zip(&images) {
            let schema = message.channel.schema.as_ref().unwrap();
            assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("foxglove.RawImage", "protobuf"));
            assert_eq!(message.sequence, number);
            assert_eq!(message.publish_time, shot(number).stamp_ns);
            assert_eq!(message.log_time, shot(number).stamp_ns + 1000);
            let image = <foxglove::messages::RawImage as foxglove::Decode>::decode(&*message.data).unwrap();
            assert_eq!(image.timestamp.unwrap().total_nanos(), shot(number).stamp_ns);
            assert_eq!((image.width, image.height, image.step), (64, 48, 64));
            assert_eq!((image.encoding.as_str(), image.frame_id.as_str()), ("mono8", "camera"));
            assert_eq!(image.data, pixels(number));
        }
    }
}

#[test]
fn sixteen_bits_and_image_files_are_kept_as_they_are() {
    let memory = Memory::new(usize::MAX);
    let mut recorder = recorder(&memory, Options::default());
    let values: Vec<u16> = (0..SIZE[0] * SIZE[1]).map(|i| (i * 11) as u16).collect();
    let picture = Picture::U16 { width: SIZE[0], height: SIZE[1], pixels: &values };
    recorder.frame(&shot(0), &picture, BEGAN_NS).unwrap();
    recorder.frame(&shot(1), &Picture::Png(b"the bytes of a file"), BEGAN_NS).unwrap();
    recorder.finish().unwrap();
    let bytes = memory.bytes();
    let images = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let images: Vec<_> = images.filter(|m| m.channel.topic == "/camera/image").collect();
    let raw = <foxglove::messages::RawImage as foxglove::Decode>::decode(&*images[0].data).unwrap();
    assert_eq!((raw.encoding.as_str(), raw.step), ("mono16", 128));
    let little_endian: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(raw.data, little_endian);
    let png = <foxglove::messages::CompressedImage as foxglove::Decode>::decode(&*images[1].data).unwrap();
    assert_eq!((png.format.as_str(), &png.data[..]), ("png", &b"the bytes of a file"[..]));
}

#[test]
fn a_picture_of_another_size_is_refused_and_nothing_is_written_of_it() {
    let memory = Memory::new(usize::MAX);
    let mut recorder = recorder(&memory, Options::default());
    let picture = Picture::U8 { width: 64, height: 48, pixels: &[0; 100] };
    let message = recorder.frame(&shot(0), &picture, BEGAN_NS).unwrap_err().to_string();
    assert!(message.contains("64 x 48 pixels are 3072 values, not 100"), "{message}");
    assert_eq!(recorder.finish().unwrap().frames, 0);
}

/// Images in the whole chunks of a file, whether or not it was finished.
fn whole_images(bytes: &[u8]) -> usize {
    let options = mcap::read::Options::IgnoreEndMagic.into();
    let mut images = 0;
    for record in mcap::read::ChunkFlattener::new_with_options(bytes, options).unwrap() {
        match record {
            Ok(Record::Message { data, .. }) if data.len() > 1000 => images += 1,
            Ok(_) => {}
            Err(mcap::McapError::UnexpectedEof) => break,
            Err(e) => panic!("{e}"),
        }
    }
    images
}

#[test]
fn a_full_disk_is_told_and_all_before_stays_readable() {
    for limit in [20_000, 50_001, 77_777] {
        let memory = Memory::new(limit);
        let mut recorder = recorder(&memory, Options { chunk_bytes: 10_000, ..Options::default() });
        let (failed, error) =
            (0..).find_map(|n| record(&mut recorder, n).err().map(|e| (n as usize, e))).unwrap();
        let message = error.to_string();
        assert!(message.contains("scan.mcap") && message.contains("free some space"), "{message}");
        let again = record(&mut recorder, 99).unwrap_err().to_string();
        assert!(again.contains("an earlier write to this recording failed"), "{again}");
        assert!(recorder.finish().is_err(), "what failed is not finished");
        let bytes = memory.bytes();
        assert!(bytes.len() <= limit);
        let images = whole_images(&bytes);
        // Four images of 3 kB fill a chunk, and the one that failed may have been the first of the next.
        assert!(images + 5 >= failed && images <= failed, "{images} of {failed} images are there");
    }
}

#[test]
fn chunks_are_closed_by_time_too() {
    let memory = Memory::new(usize::MAX);
    let interval = Duration::from_millis(20);
    let mut recorder = recorder(&memory, Options { interval, ..Options::default() });
    record(&mut recorder, 0).unwrap();
    assert_eq!(whole_images(&memory.bytes()), 0, "still in memory");
    std::thread::sleep(interval);
    recorder.tick().unwrap();
    assert_eq!(whole_images(&memory.bytes()), 1, "in the file, unfinished though it is");
    record(&mut recorder, 1).unwrap();
    drop(recorder);
    let bytes = memory.bytes();
    assert!(mcap::Summary::read(&bytes).unwrap().is_some(), "a recorder that is dropped ends its file");
    assert_eq!(whole_images(&bytes), 2);
}
