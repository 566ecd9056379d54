//! From record to record through a recording, finished or not, without reading what is in the images.

use std::{collections::BTreeMap, sync::Arc};

use mcap::{
    MAGIC,
    records::{self, MessageHeader, Record, op},
};

use super::bytes::{Attached, Bytes, Spot, attachment, chunk_header, message_header};
use crate::error::{Error, Place};

/// A channel with its schema.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Channel {
    pub topic: String,
    pub message_encoding: String,
    pub metadata: BTreeMap<String, String>,
    pub schema_name: String,
    pub schema_encoding: String,
    pub schema_data: Vec<u8>,
}

/// What a walk comes by.
#[derive(Clone, Copy)]
pub(crate) enum Item<'w> {
    /// The file's header says what it is for.
    Profile(&'w str),
    /// A metadata record.
    Metadata(&'w records::Metadata),
    /// A file attached.
    Attachment(&'w Attached),
    /// A message; its data are where the spot says.
    Message(&'w MessageHeader, &'w Arc<Channel>, Spot),
}

/// How a walk ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct End {
    /// The file was finished, and all of it could be walked.
    pub finished: bool,
    /// Up to where the file could be walked.
    pub reached: u64,
    /// What is wrong, where, one entry a place.
    pub faults: Vec<String>,
}

/// A record's code, and where its content is.
#[derive(Clone, Copy)]
struct At {
    op: u8,
    offset: u64,
    length: u64,
}

impl At {
    fn end(self) -> u64 {
        self.offset + self.length
    }
}

/// Code and length before each record.
const PREFIX: u64 = 9;
/// What comes before a message's data.
const MESSAGE_HEADER: u64 = super::bytes::MESSAGE_HEADER as u64;
/// What is read of a file at once: as much as there is between two images.
const WINDOW: usize = 4096;
/// No metadata, schema, channel or attachment of ours is as large.
const MOST_SMALL: u64 = 64 << 20;

const MOST_FAULTS: usize = 20;

struct Walker<'b> {
    bytes: &'b Bytes,
    window: Vec<u8>,
    window_at: u64,
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    channels: BTreeMap<u16, Arc<Channel>>,
    faults: Vec<String>,
}

/// Shows every record of the data section to `visit`, in the order of the file.
///
/// # Errors
/// [`Error`] where the file can't be read or is no MCAP file, and what `visit` returns. Whatever is torn or damaged
/// is no error but in [`End`].
pub(crate) fn walk(
    bytes: &Bytes,
    mut visit: impl FnMut(Item<'_>) -> Result<(), Error>,
) -> Result<End, Error> {
    let mut magic = [0; MAGIC.len()];
    let length = bytes.length();
    let whole_magic = length >= MAGIC.len() as u64;
    if !whole_magic || bytes.fill(0, &mut magic).is_err() || magic != *MAGIC {
        let what = "is neither a capture folder nor a recording: it does not begin as an MCAP file does";
        return Err(Error::content(Place::file(bytes.path()), what, "give a recording, or a capture folder"));
    }
    let mut walker = Walker {
        bytes,
        window: Vec::new(),
        window_at: 0,
        schemas: BTreeMap::new(),
        channels: BTreeMap::new(),
        faults: Vec::new(),
    };
    let mut at = MAGIC.len() as u64;
    let mut ended = false;
    while at < length && !ended {
        let Some(record) = walker.record(at, length)? else { break };
        if record.end() > length {
            // What was written of a chunk before the process died can be read as far as it goes.
            if record.op == op::CHUNK {
                walker.chunk(At { length: length - record.offset, ..record }, true, &mut visit)?;
            }
            break;
        }
        match record.op {
            op::CHUNK => walker.chunk(record, false, &mut visit)?,
            op::DATA_END => ended = true,
            _ => walker.single(record, &mut visit)?,
        }
        at = record.end();
    }
    let closed = ended && ends_with_magic(bytes);
    if !ended {
        walker.fault(match length - at {
            0 => "was not finished: its index is missing".to_owned(),
            rest => {
                format!("was cut off: after byte {at} there are {rest} bytes of a record that is not whole")
            }
        });
    } else if !closed {
        walker.fault("was cut off within its index".to_owned());
    }
    Ok(End { finished: closed && walker.faults.is_empty(), reached: at, faults: walker.faults })
}

fn ends_with_magic(bytes: &Bytes) -> bool {
    let mut magic = [0; MAGIC.len()];
    let at = bytes.length().checked_sub(MAGIC.len() as u64);
    at.is_some_and(|at| bytes.fill(at, &mut magic).is_ok()) && magic == *MAGIC
}

impl Walker<'_> {
    /// A damaged file may have as many faults as bytes: some are enough to tell.
    fn fault(&mut self, fault: String) {
        if self.faults.len() < MOST_FAULTS && self.faults.last() != Some(&fault) {
            self.faults.push(fault);
        }
    }

    /// Up to `length` bytes at an offset, fewer at the file's end.
    fn peek(&mut self, offset: u64, length: usize) -> Result<&[u8], Error> {
        let inside =
            offset >= self.window_at && offset + length as u64 <= self.window_at + self.window.len() as u64;
        if !inside {
            let size = (self.bytes.length().saturating_sub(offset)).min(WINDOW.max(length) as u64);
            self.window.resize(size as usize, 0);
            self.window_at = offset;
            let failed = Error::file(self.bytes.path(), "read");
            self.bytes.fill(offset, &mut self.window).map_err(failed)?;
        }
        let from = (offset - self.window_at) as usize;
        let end = (from + length).min(self.window.len());
        Ok(&self.window[from..end])
    }

    /// The record at an offset; `None` where fewer bytes are left before `end` than one begins with. Its end may lie beyond.
    fn record(&mut self, at: u64, end: u64) -> Result<Option<At>, Error> {
        if end.saturating_sub(at) < PREFIX {
            return Ok(None);
        }
        let &[op, ref length @ ..] = self.peek(at, PREFIX as usize)? else { return Ok(None) };
        let Ok(length) = length.try_into().map(u64::from_le_bytes) else { return Ok(None) };
        let offset = at + PREFIX;
        // A length that no file has must not overflow.
        Ok(Some(At { op, offset, length: length.min(u64::MAX - offset) }))
    }

    fn chunk(
        &mut self,
        chunk: At,
        torn: bool,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        // Longer than any name of a compression needs.
        let head = self.peek(chunk.offset, chunk.length.min(256) as usize)?.to_vec();
        let Some((header, _)) = chunk_header(&head) else {
            if !torn {
                self.fault(format!("the chunk at byte {} is damaged", chunk.offset));
            }
            return Ok(());
        };
        if !header.compression.is_empty() {
            return self.packed(chunk, torn, visit);
        }
        let start = chunk.offset + 40 + header.compression.len() as u64;
        let end = start.saturating_add(header.compressed_size).min(chunk.end());
        let mut at = start;
        while at < end {
            let record = self.record(at, end)?.filter(|record| record.end() <= end);
            let Some(record) = record else {
                if !torn {
                    self.fault(format!("the chunk at byte {} is damaged from byte {at} on", chunk.offset));
                }
                return Ok(());
            };
            match record.op {
                op::MESSAGE if record.length >= MESSAGE_HEADER => {
                    let Some(header) = message_header(self.peek(record.offset, MESSAGE_HEADER as usize)?)
                    else {
                        return Ok(());
                    };
                    let spot = Spot::Plain {
                        offset: record.offset + MESSAGE_HEADER,
                        length: record.length - MESSAGE_HEADER,
                    };
                    self.message(&header, spot, visit)?;
                }
                _ => self.single(record, visit)?,
            }
            at = record.end();
        }
        Ok(())
    }

    fn packed(
        &mut self,
        chunk: At,
        torn: bool,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        if torn {
            return Ok(());
        }
        let unpacked = match self.bytes.unpack(chunk.offset, chunk.length) {
            Ok(unpacked) => unpacked,
            Err(error @ Error::File { .. }) => return Err(error),
            Err(_) => {
                self.fault(format!("the chunk at byte {} is damaged", chunk.offset));
                return Ok(());
            }
        };
        let mut index = 0;
        for (op, body) in unpacked.records() {
            match (op, message_header(body)) {
                (op::MESSAGE, Some(header)) => {
                    let spot = Spot::Packed { chunk: chunk.offset, length: chunk.length, index };
                    index += 1;
                    self.message(&header, spot, visit)?;
                }
                (op::SCHEMA | op::CHANNEL, _) => self.parsed(op, body, chunk.offset, visit)?,
                _ => {}
            }
        }
        if let Some(fault) = &unpacked.fault {
            self.fault(format!("the chunk at byte {} is damaged: {fault}", chunk.offset));
        }
        Ok(())
    }

    /// A record that is neither chunk nor message in a chunk.
    fn single(
        &mut self,
        record: At,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let wanted = [op::HEADER, op::SCHEMA, op::CHANNEL, op::METADATA, op::ATTACHMENT, op::MESSAGE];
        if !wanted.contains(&record.op) {
            return Ok(());
        }
        if record.op == op::MESSAGE && record.length >= MESSAGE_HEADER {
            let head = self.peek(record.offset, MESSAGE_HEADER as usize)?;
            let Some(header) = message_header(head) else { return Ok(()) };
            let spot = Spot::Plain {
                offset: record.offset + MESSAGE_HEADER,
                length: record.length - MESSAGE_HEADER,
            };
            return self.message(&header, spot, visit);
        }
        if record.length > MOST_SMALL {
            self.fault(format!("the record at byte {} is too large to be one", record.offset));
            return Ok(());
        }
        let body = self.bytes.read(record.offset, record.length)?;
        if record.op == op::ATTACHMENT {
            return match attachment(&body) {
                Some(attached) => visit(Item::Attachment(&attached)),
                None => {
                    self.fault(format!("the file attached at byte {} is damaged", record.offset));
                    Ok(())
                }
            };
        }
        self.parsed(record.op, &body, record.offset, visit)
    }

    /// A record's content that `mcap` parses.
    fn parsed(
        &mut self,
        op: u8,
        body: &[u8],
        at: u64,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        match mcap::parse_record(op, body) {
            Ok(parsed) => self.known(&parsed, visit),
            Err(_) => {
                self.fault(format!("the record at byte {at} is damaged"));
                Ok(())
            }
        }
    }

    fn known(
        &mut self,
        record: &Record<'_>,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        match record {
            Record::Header(header) => visit(Item::Profile(&header.profile)),
            Record::Metadata(metadata) => visit(Item::Metadata(metadata)),
            Record::Schema { header, data } => {
                let schema = (header.name.clone(), header.encoding.clone(), data.to_vec());
                self.schemas.insert(header.id, schema);
                Ok(())
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let (schema_name, schema_encoding, schema_data) = schema;
                let channel_of = Channel {
                    topic: channel.topic.clone(),
                    message_encoding: channel.message_encoding.clone(),
                    metadata: channel.metadata.clone(),
                    schema_name,
                    schema_encoding,
                    schema_data,
                };
                self.channels.insert(channel.id, Arc::new(channel_of));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn message(
        &mut self,
        header: &MessageHeader,
        spot: Spot,
        visit: &mut impl FnMut(Item<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        match self.channels.get(&header.channel_id) {
            Some(channel) => visit(Item::Message(header, &Arc::clone(channel), spot)),
            None => {
                let fault = format!(
                    "a message is of channel {}, which is described nowhere before it",
                    header.channel_id
                );
                self.fault(fault);
                Ok(())
            }
        }
    }
}
