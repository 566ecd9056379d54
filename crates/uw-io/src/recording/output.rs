//! Messages into an MCAP file: chunks closed by size and by time, and a file that stays whole where a write fails.

use std::{
    collections::BTreeMap,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering::Relaxed},
    time::{Duration, Instant},
};

use mcap::{
    Attachment, McapError, WriteOptions,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};

use super::{
    messages::Schema,
    sink::{Counted, Durable, Sink, Tally},
    walk::Channel,
};
use crate::error::{Error, Place};

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Compression {
    /// Not at all: as fast as the disk.
    #[default]
    None,
    /// LZ4: fast, little.
    Lz4,
    /// Zstandard: slow, more.
    Zstd,
}

/// How to record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Of chunks.
    pub compression: Compression,
    /// A chunk is closed when it holds as many bytes.
    pub chunk_bytes: u64,
    /// A chunk is closed, and made durable, when its first message is as old.
    pub interval: Duration,
}

impl Default for Options {
    /// No compression, chunks of 4 MiB or a quarter of a second: at most a second is lost where the process is killed or the
    /// power fails, with three quarters of it left for the disk.
    fn default() -> Self {
        Self { compression: Compression::None, chunk_bytes: 4 << 20, interval: Duration::from_millis(250) }
    }
}

/// What became of a recording.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Images recorded.
    pub frames: u64,
    /// Images that were told of as lost.
    pub lost_frames: u64,
    /// Messages of all topics.
    pub messages: u64,
    /// Bytes written to the file.
    pub bytes: u64,
    /// The longest that a write to the file took.
    pub longest_write: Duration,
    /// Times that what was written was made durable.
    pub syncs: u64,
    /// The longest that making it durable took.
    pub longest_sync: Duration,
    /// Times that the disk was still busy with the interval before the last: more than the last second was in danger.
    pub late_syncs: u64,
}

/// A message's own times and number.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stamps {
    /// When it was received, nanoseconds since the Unix epoch.
    pub log_ns: u64,
    /// When what it tells of was so.
    pub publish_ns: u64,
    /// `None`: counted by channel.
    pub sequence: Option<u32>,
}

type Inner<S> = mcap::Writer<NoSeek<BufWriter<Counted<S>>>>;

/// An MCAP file in the making.
pub(crate) struct Output<S: Sink> {
    path: PathBuf,
    /// `None` once a write has failed.
    writer: Option<Inner<S>>,
    channels: BTreeMap<(&'static str, u8), u16>,
    options: Options,
    durable: Option<Durable>,
    /// Bytes of messages in the chunk that is open.
    chunk_bytes: u64,
    /// When its first message came.
    chunk_began: Option<Instant>,
    /// Length of the file up to its last whole chunk.
    whole_bytes: u64,
    sequences: BTreeMap<u16, u32>,
    tally: Arc<Tally>,
    pub counts: Counts,
}

impl<S: Sink> Output<S> {
    /// Begins a file with this profile.
    pub fn begin(sink: S, path: &Path, profile: &str, options: Options) -> Result<Self, Error> {
        let started = sink.durable().and_then(|make| make.map(Durable::start).transpose());
        let durable = started.map_err(Error::file(path, "write"))?;
        let compression = match options.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        };
        let settings = WriteOptions::new()
            .profile(profile)
            .compression(compression)
            .compression_threads(0)
            // Closed by ourselves, by size and by time, so that it is known up to where the file is whole.
            .chunk_size(None)
            .disable_seeking(true)
            // Chunks, attachments and the summary have their own, and a file that is cut off never gets this one.
            .calculate_data_section_crc(false)
            .library(concat!("uwscan ", env!("CARGO_PKG_VERSION")));
        let tally = Arc::new(Tally::default());
        let output = BufWriter::with_capacity(1 << 16, Counted { sink, tally: Arc::clone(&tally) });
        let writer = settings.create(NoSeek::new(output)).map_err(|e| failure(path, e))?;
        let mut output = Self {
            path: path.to_owned(),
            writer: Some(writer),
            channels: BTreeMap::new(),
            options,
            durable,
            chunk_bytes: 0,
            chunk_began: None,
            whole_bytes: 0,
            sequences: BTreeMap::new(),
            tally,
            counts: Counts::default(),
        };
        output.close_chunk()?;
        Ok(output)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A metadata record; it closes the chunk.
    pub fn metadata(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), Error> {
        self.close_chunk()?;
        self.with(|writer| writer.write_metadata(&Metadata { name: name.to_owned(), metadata: map }))?;
        self.close_chunk()
    }

    /// A file attached; it closes the chunk.
    pub fn attach(&mut self, attachment: &Attachment<'_>) -> Result<(), Error> {
        self.close_chunk()?;
        self.with(|writer| writer.attach(attachment))?;
        self.close_chunk()
    }

    /// The number of a channel, which is added if it is new.
    pub fn channel(
        &mut self,
        topic: &'static str,
        kind: u8,
        schema: impl FnOnce() -> Schema,
    ) -> Result<u16, Error> {
        if let Some(id) = self.channels.get(&(topic, kind)) {
            return Ok(*id);
        }
        let Schema { name, encoding, data, message_encoding } = schema();
        let id = self.with(|writer| {
            let schema = writer.add_schema(&name, &encoding, &data)?;
            writer.add_channel(schema, topic, message_encoding, &BTreeMap::new())
        })?;
        self.channels.insert((topic, kind), id);
        self.chunk_began.get_or_insert_with(Instant::now);
        Ok(id)
    }

    /// The number of a channel of another file, which is added if it is new.
    pub fn channel_like(&mut self, channel: &Channel) -> Result<u16, Error> {
        let Channel { topic, message_encoding, metadata, schema_name, schema_encoding, schema_data } =
            channel;
        self.with(|writer| {
            let schema = match schema_name.is_empty() && schema_data.is_empty() {
                true => 0,
                false => writer.add_schema(schema_name, schema_encoding, schema_data)?,
            };
            writer.add_channel(schema, topic, message_encoding, metadata)
        })
    }

    /// A message into the chunk that is open.
    pub fn message(&mut self, channel_id: u16, stamps: Stamps, data: &[u8]) -> Result<(), Error> {
        let count = self.sequences.entry(channel_id).or_default();
        let sequence = stamps.sequence.unwrap_or(*count);
        *count = count.wrapping_add(1);
        let header =
            MessageHeader { channel_id, sequence, log_time: stamps.log_ns, publish_time: stamps.publish_ns };
        self.with(|writer| writer.write_to_known_channel(&header, data))?;
        self.counts.messages += 1;
        self.chunk_bytes += data.len() as u64;
        self.chunk_began.get_or_insert_with(Instant::now);
        Ok(())
    }

    /// Closes the chunk if it is full.
    pub fn room(&mut self) -> Result<(), Error> {
        if self.chunk_bytes >= self.options.chunk_bytes { self.close_chunk() } else { Ok(()) }
    }

    /// Closes the chunk if its first message is older than the interval, and has it made durable.
    pub fn tick(&mut self) -> Result<(), Error> {
        match self.chunk_began {
            Some(began) if began.elapsed() >= self.options.interval => self.sync(),
            _ => Ok(()),
        }
    }

    /// Closes the chunk and asks for it to be made durable.
    pub fn sync(&mut self) -> Result<(), Error> {
        self.close_chunk()?;
        if self.durable.as_ref().is_some_and(Durable::ask) {
            self.counts.late_syncs += 1;
        }
        self.check_durable()
    }

    /// What became of it so far.
    pub fn counts(&self) -> Counts {
        let (syncs, longest_sync) = self.durable.as_ref().map(Durable::figures).unwrap_or_default();
        let bytes = self.tally.bytes.load(Relaxed);
        let longest_write = Duration::from_nanos(self.tally.longest_ns.load(Relaxed));
        Counts { bytes, longest_write, syncs, longest_sync, ..self.counts }
    }

    /// Writes the index, and waits until all is durable.
    pub fn finish(mut self) -> Result<Counts, Error> {
        self.close_chunk()?;
        self.with(|writer| writer.finish().map(drop))?;
        if let Some(writer) = self.writer.take() {
            let output = writer.into_inner().into_inner();
            let flushed = output.into_inner().map_err(std::io::IntoInnerError::into_error);
            let mut counted = flushed.map_err(Error::file(&self.path, "write"))?;
            counted.flush().map_err(Error::file(&self.path, "write"))?;
        }
        if let Some(durable) = &mut self.durable {
            durable.ask_and_wait();
        }
        match self.durable.as_ref().and_then(Durable::error) {
            Some(error) => Err(Error::file(&self.path, "write")(error)),
            None => Ok(self.counts()),
        }
    }

    fn check_durable(&mut self) -> Result<(), Error> {
        match self.durable.as_ref().and_then(Durable::error) {
            Some(error) => Err(self.fail(McapError::Io(error))),
            None => Ok(()),
        }
    }

    fn close_chunk(&mut self) -> Result<(), Error> {
        (self.chunk_bytes, self.chunk_began) = (0, None);
        self.with(mcap::Writer::flush)?;
        self.whole_bytes = self.tally.bytes.load(Relaxed);
        Ok(())
    }

    fn with<T>(&mut self, act: impl FnOnce(&mut Inner<S>) -> Result<T, McapError>) -> Result<T, Error> {
        match self.writer.as_mut().map(act) {
            Some(Ok(done)) => Ok(done),
            Some(Err(error)) => Err(self.fail(error)),
            None => {
                let what = "an earlier write to this recording failed; what was recorded until then is in it";
                Err(Error::content(Place::file(&self.path), what, "free some space, and record anew"))
            }
        }
    }

    /// Gives the file up: what was written of the chunk that failed is taken back.
    fn fail(&mut self, error: McapError) -> Error {
        if let Some(writer) = self.writer.take() {
            let (mut counted, _) = writer.into_inner().into_inner().into_parts();
            // Where even this fails the file's end is torn, which readers see.
            let _ = counted.sink.cut(self.whole_bytes);
        }
        failure(&self.path, error)
    }
}

impl<S: Sink> Drop for Output<S> {
    /// An index makes the file whole for every reader, even where nobody asked for its end.
    fn drop(&mut self) {
        if let Some(mut writer) = self.writer.take()
            && writer.finish().is_ok()
        {
            let _ = writer.into_inner().into_inner().flush();
        }
    }
}

/// What `mcap` can't write, as this crate says it.
fn failure(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::file(path, "write")(error),
        // It wraps what a message's header can't be written for.
        McapError::Parse(error) => Error::file(path, "write")(std::io::Error::other(error.to_string())),
        other => Error::content(Place::file(path), format!("cannot be written: {other}"), "report this"),
    }
}
