//! Reading a recording, finished or cut off: where its images are, and one of them at a time.

use std::{collections::BTreeMap, fmt::Write, path::Path, sync::Arc};

use foxglove::messages::{CompressedImage, RawImage};
use mcap::records::MessageHeader;
use prost::Message;

use super::{
    bytes::{Bytes, Spot},
    head::{self, Head},
    messages::{self, stamp_ns},
    topics,
    walk::{Channel, End, Item, walk},
};
use crate::{
    capture::{FrameRecord, Kind},
    error::{Error, Place, Problem},
    frames,
    images::{self, Expect, FileFormat, GrayImage, Pixels, Reduce, Stored},
};

/// One image.
#[derive(Debug, Clone, Copy)]
struct Picture {
    spot: Spot,
    compressed: bool,
    crc32: u32,
    bits: u8,
}

/// What there is of one topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name of its messages' schema.
    pub schema: String,
    /// How many.
    pub messages: u64,
}

/// A message that is neither an image nor its row.
pub(crate) struct Other<'m> {
    pub topic: &'m str,
    pub log_ns: u64,
    pub publish_ns: u64,
    pub data: &'m [u8],
}

/// A recording's content, its images left where they are.
#[derive(Debug)]
pub(crate) struct Recording {
    bytes: Bytes,
    pub head: Head,
    /// In the order of their numbers, those that are lost too.
    pub frames: Vec<FrameRecord>,
    pictures: BTreeMap<usize, Picture>,
    pub topics: BTreeMap<String, Topic>,
    /// What is missing, and what is odd.
    pub problems: Vec<Problem>,
}

/// What a walk has gathered.
#[derive(Default)]
struct Gathered {
    metadata: Option<BTreeMap<String, String>>,
    profile: String,
    files: BTreeMap<String, Vec<u8>>,
    rows: BTreeMap<u32, messages::Frame>,
    images: BTreeMap<u32, (Spot, bool)>,
    topics: BTreeMap<String, Topic>,
    /// Rows that can't be read, or came twice.
    odd: u64,
}

impl Recording {
    /// The recording in a file.
    ///
    /// # Errors
    /// [`Error`] where it can't be read, or holds no recording of ours. What is missing is no error but in
    /// [`Recording::problems`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let bytes = Bytes::open(path)?;
        let mut gathered = Gathered::default();
        let end = walk(&bytes, |item| gathered.take(&bytes, item))?;
        let Some(metadata) = gathered.metadata.take() else {
            let what = match gathered.profile.as_str() {
                "" => {
                    "is an MCAP file without the metadata record \"uwscan\", so no recording of this software"
                        .to_owned()
                }
                profile => {
                    format!("is an MCAP file of the profile \"{profile}\", not a recording of this software")
                }
            };
            let mend = if end.finished {
                "give the recording that it was made from"
            } else {
                "it was cut off before that was written, or is damaged there: copy it again from where it was made"
            };
            return Err(Error::content(Place::file(path), what, mend));
        };
        let mut head = Head::from_metadata(path, &metadata)?;
        let mut text = |name: &str| {
            let bytes = gathered.files.remove(name)?;
            Some(String::from_utf8(bytes).map_err(|_| {
                Error::content(
                    Place::file(&path.join(name)),
                    "is not UTF-8 text",
                    "record or convert it again",
                )
            }))
        };
        head.rig = text(head::RIG).transpose()?;
        head.calibration = text(head::CALIBRATION).transpose()?;
        let mut recording = Self {
            bytes,
            head,
            frames: Vec::new(),
            pictures: BTreeMap::new(),
            topics: gathered.topics,
            problems: Vec::new(),
        };
        recording.rows(gathered.rows, &gathered.images);
        recording.missing(&end, gathered.odd);
        Ok(recording)
    }

    /// Puts rows and images together.
    fn rows(&mut self, rows: BTreeMap<u32, messages::Frame>, images: &BTreeMap<u32, (Spot, bool)>) {
        let path = self.bytes.path().to_owned();
        let mut names = std::collections::BTreeSet::new();
        for (number, row) in rows {
            let row_number = number as usize;
            let lose = |what: String, mend: &str| {
                Problem::loss(
                    row_number,
                    Error::content(Place::file(&path).key(&format!("frame {number}")), what, mend),
                )
            };
            let voltage_v = row.voltage_v.filter(|v| v.is_finite() && row.laser_on);
            let Some(stamp_ns) = stamp_ns(row.timestamp.as_ref()) else {
                self.problems.push(lose("its time is none".to_owned(), "record it again"));
                continue;
            };
            if row.laser_on && voltage_v.is_none() {
                self.problems
                    .push(lose("the laser is on, but its voltage is missing".to_owned(), "record it again"));
                continue;
            }
            let pose = if self.head.kind == Kind::Calibration { row.pose } else { None };
            if self.head.kind == Kind::Calibration && pose.is_none() {
                self.problems
                    .push(lose("the number of its placement is missing".to_owned(), "record it again"));
                continue;
            }
            let usable =
                !row.file.is_empty() && frames::escapes(&row.file).is_none() && !names.contains(&row.file);
            let file = if usable { row.file } else { format!("images/{number:06}.png") };
            names.insert(file.clone());
            match (images.get(&number), row.image_crc32) {
                (Some(&(spot, compressed)), Some(crc32)) => {
                    let bits = u8::try_from(row.bits).unwrap_or(0);
                    self.pictures.insert(row_number, Picture { spot, compressed, crc32, bits });
                }
                (_, Some(_)) => self
                    .problems
                    .push(lose("its image is missing".to_owned(), "the process ended before it was written")),
                (_, None) => {
                    let why = if row.lost.is_empty() { "its image is missing" } else { &row.lost };
                    self.problems.push(lose(why.to_owned(), "it was lost when it was recorded"));
                }
            }
            self.frames.push(FrameRecord {
                row: row_number,
                line: 0,
                file,
                pose,
                laser_on: row.laser_on,
                voltage_v,
                stamp_ns,
            });
        }
    }

    /// Tells what is not there: gaps in the numbers, what was planned, what was torn.
    fn missing(&mut self, end: &End, odd: u64) {
        let place = Place::file(self.bytes.path());
        let mut told = Vec::new();
        let mut next = 0;
        let mut before: Option<&FrameRecord> = None;
        for frame in &self.frames {
            if frame.row > next {
                let mut what = match frame.row - next {
                    1 => format!("frame {next} is missing"),
                    count => format!("{count} frames, {next} to {}, are missing", frame.row - 1),
                };
                if let Some(before) = before {
                    let seconds = frame.stamp_ns.saturating_sub(before.stamp_ns) as f64 * 1e-9;
                    let _ = write!(what, ": {seconds:.3} s pass between those before and after");
                }
                told.push(Error::content(place.clone(), what, "the others are used"));
            }
            next = frame.row + 1;
            before = Some(frame);
        }
        if let Some(planned) = self.head.planned_frames.map(|n| n as usize).filter(|planned| *planned > next)
        {
            let what =
                format!("the last {} of {planned} frames that were planned are missing", planned - next);
            told.push(Error::content(place.clone(), what, "the others are used"));
        }
        if odd > 0 {
            let what = format!("{odd} rows of images can't be read, or came twice");
            told.push(Error::content(place.clone(), what, "the others are used"));
        }
        for fault in &end.faults {
            let last = match (self.frames.first(), self.frames.last()) {
                (Some(first), Some(last)) => {
                    let seconds = last.stamp_ns.saturating_sub(first.stamp_ns) as f64 * 1e-9;
                    format!("{fault}; its last image is number {}, {seconds:.3} s after the first", last.row)
                }
                _ => fault.clone(),
            };
            told.push(Error::content(
                place.clone(),
                last,
                "uwscan recover makes a whole file of what is there",
            ));
        }
        self.problems.extend(told.into_iter().map(Problem::lost));
    }

    /// Shows every message that is neither an image nor its row, in the order of the file.
    pub fn others(&self, visit: &mut dyn FnMut(Other<'_>) -> Result<(), Error>) -> Result<(), Error> {
        walk(&self.bytes, |item| match item {
            Item::Message(header, channel, spot)
                if ![topics::FRAME, topics::IMAGE].contains(&channel.topic.as_str()) =>
            {
                let data = self.bytes.load(spot)?;
                let (topic, log_ns, publish_ns) =
                    (channel.topic.as_str(), header.log_time, header.publish_time);
                visit(Other { topic, log_ns, publish_ns, data: &data })
            }
            _ => Ok(()),
        })
        .map(drop)
    }

    /// Whether there is an image of this number.
    pub fn has(&self, row: usize) -> bool {
        self.pictures.contains_key(&row)
    }

    /// The images that are there, but not as they were recorded.
    pub fn damaged(&self) -> Vec<Problem> {
        let present = self.frames.iter().filter(|frame| self.has(frame.row));
        let damage = |frame: &FrameRecord| {
            let error = self.stored(frame.row, &self.bytes.path().join(&frame.file)).err()?;
            Some(Problem::loss(frame.row, error))
        };
        present.filter_map(damage).collect()
    }

    /// The image of a frame in one channel; `path` names it in errors.
    pub fn image(
        &self,
        row: usize,
        path: &Path,
        reduce: Reduce,
        expect: Option<Expect>,
    ) -> Result<GrayImage, Error> {
        match self.stored(row, path)? {
            Stored::File { bytes, .. } => images::decode(&bytes, path, reduce, expect),
            Stored::Grey(image) => match expect {
                Some(expect) => images::hold_against(image, path, expect),
                None => Ok(image),
            },
        }
    }

    /// The image of a frame as it was recorded.
    pub fn stored(&self, row: usize, path: &Path) -> Result<Stored, Error> {
        let damaged = |what: &str| {
            Error::image(path, what, "the recording is damaged: copy it again from where it was made")
        };
        let Some(picture) = self.pictures.get(&row) else {
            return Err(Error::image(path, "is missing", "it was lost when it was recorded"));
        };
        let data = bytes_of(self.bytes.load(picture.spot)?);
        if picture.compressed {
            let image = CompressedImage::decode(data).map_err(|_| damaged("its message can't be read"))?;
            if crc32fast::hash(&image.data) != picture.crc32 {
                return Err(damaged("its bytes are not those that were recorded (CRC-32)"));
            }
            let format =
                FileFormat::of_bytes(&image.data).ok_or_else(|| damaged("it is neither PNG nor JPEG"))?;
            return Ok(Stored::File { format, bytes: image.data.into() });
        }
        let image = RawImage::decode(data).map_err(|_| damaged("its message can't be read"))?;
        if crc32fast::hash(&image.data) != picture.crc32 {
            return Err(damaged("its values are not those that were recorded (CRC-32)"));
        }
        grey(&image, picture.bits)
            .map(Stored::Grey)
            .ok_or_else(|| damaged("its size is not that of its values"))
    }
}

fn bytes_of(data: Vec<u8>) -> foxglove::bytes::Bytes {
    data.into()
}

/// The values of a message without padding.
fn grey(image: &RawImage, bits: u8) -> Option<GrayImage> {
    let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
    let sample = match image.encoding.as_str() {
        "mono8" | "8UC1" => 1,
        "mono16" | "16UC1" => 2,
        _ => return None,
    };
    let row = width.checked_mul(sample)?;
    if row == 0 || height == 0 || step < row || image.data.len() != step.checked_mul(height)? {
        return None;
    }
    let rows = image.data.chunks_exact(step).map(|line| &line[..row]);
    let data = match sample {
        1 => Pixels::U8(rows.flatten().copied().collect::<Vec<u8>>()),
        _ => Pixels::U16(
            rows.flat_map(|line| line.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]))).collect(),
        ),
    };
    let most = if sample == 1 { 8 } else { 16 };
    let bits = u32::from(if bits == 0 { most } else { bits.min(most) });
    let full_scale = (u32::MAX >> (32 - bits)) as u16;
    Some(GrayImage { width: image.width, height: image.height, data, full_scale })
}

impl Gathered {
    fn take(&mut self, bytes: &Bytes, item: Item<'_>) -> Result<(), Error> {
        match item {
            Item::Profile(profile) => self.profile = profile.to_owned(),
            Item::Metadata(record) if record.name == head::METADATA => {
                self.metadata.get_or_insert_with(|| record.metadata.clone());
            }
            Item::Attachment(file) if [head::RIG, head::CALIBRATION].contains(&file.name.as_str()) => {
                self.files.entry(file.name.clone()).or_insert_with(|| file.data.clone());
            }
            Item::Message(header, channel, spot) => self.message(bytes, header, channel, spot)?,
            Item::Metadata(_) | Item::Attachment(_) => {}
        }
        Ok(())
    }

    fn message(
        &mut self,
        bytes: &Bytes,
        header: &MessageHeader,
        channel: &Arc<Channel>,
        spot: Spot,
    ) -> Result<(), Error> {
        match self.topics.get_mut(&channel.topic) {
            Some(topic) => topic.messages += 1,
            None => {
                let topic = Topic { schema: channel.schema_name.clone(), messages: 1 };
                self.topics.insert(channel.topic.clone(), topic);
            }
        }
        match (channel.topic.as_str(), channel.schema_name.as_str()) {
            (topics::FRAME, "uwscan.Frame") => match messages::Frame::decode(&*bytes.load(spot)?) {
                Ok(row) if !self.rows.contains_key(&row.frame) => {
                    self.rows.insert(row.frame, row);
                }
                _ => self.odd += 1,
            },
            (topics::IMAGE, schema @ ("foxglove.RawImage" | "foxglove.CompressedImage")) => {
                self.images.insert(header.sequence, (spot, schema == "foxglove.CompressedImage"));
            }
            _ => {}
        }
        Ok(())
    }
}
