//! A file's bytes at any place, from any thread; no length that the file claims is believed beyond its end.

use std::{
    fs::File,
    io,
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use mcap::{
    McapResult,
    records::{ChunkHeader, MessageHeader, op},
    sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::error::{Error, Place};

/// The largest message, and the largest chunk that is decompressed: larger than any image.
pub(super) const MOST_BYTES: u64 = 1 << 30;

/// What comes before a message's data.
pub(super) const MESSAGE_HEADER: usize = 22;

/// Where the data of a message are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Spot {
    /// In the file as they are.
    Plain {
        /// Of the data's first byte.
        offset: u64,
        /// Of the data.
        length: u64,
    },
    /// In a compressed chunk.
    Packed {
        /// Of the chunk record's content.
        chunk: u64,
        /// Length of that.
        length: u64,
        /// Which of the chunk's messages.
        index: usize,
    },
}

/// A compressed chunk's records, unpacked.
#[derive(Default)]
pub(super) struct Unpacked {
    data: Vec<u8>,
    /// Code of each record, and where its content is in the data.
    records: Vec<(u8, Range<usize>)>,
    /// What is wrong after the last of the records; `None` where nothing is.
    pub fault: Option<String>,
}

impl Unpacked {
    /// Code and content of each record.
    pub fn records(&self) -> impl Iterator<Item = (u8, &[u8])> {
        self.records.iter().map(|(op, range)| (*op, &self.data[range.clone()]))
    }
}

/// A file that is read in place.
pub(crate) struct Bytes {
    path: PathBuf,
    file: File,
    length: u64,
    /// The chunk that was unpacked last, by its offset: neighbours are read one after the other.
    last: Mutex<Option<(u64, Arc<Unpacked>)>>,
}

impl std::fmt::Debug for Bytes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bytes")
            .field("path", &self.path)
            .field("length", &self.length)
            .finish_non_exhaustive()
    }
}

impl Bytes {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = File::open(path).map_err(Error::file(path, "open"))?;
        let length = file.metadata().map_err(Error::file(path, "open"))?.len();
        Ok(Self { path: path.to_owned(), file, length, last: Mutex::default() })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file when it was opened.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// `length` bytes at an offset; an error where the file does not hold them, or holds too many for one piece.
    pub fn read(&self, offset: u64, length: u64) -> Result<Vec<u8>, Error> {
        let end = offset.checked_add(length).filter(|end| *end <= self.length && length <= MOST_BYTES);
        let (Some(_), Ok(size)) = (end, usize::try_from(length)) else {
            let what = format!("a record of {length} bytes at byte {offset} can't be in it");
            return Err(Error::content(Place::file(&self.path), what, "recover it with uwscan recover"));
        };
        let mut bytes = vec![0; size];
        self.fill(offset, &mut bytes).map_err(Error::file(&self.path, "read"))?;
        Ok(bytes)
    }

    #[cfg(unix)]
    pub fn fill(&self, offset: u64, bytes: &mut [u8]) -> io::Result<()> {
        std::os::unix::fs::FileExt::read_exact_at(&self.file, bytes, offset)
    }

    #[cfg(windows)]
    pub fn fill(&self, mut offset: u64, mut bytes: &mut [u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match std::os::windows::fs::FileExt::seek_read(&self.file, bytes, offset)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                read => {
                    bytes = &mut bytes[read..];
                    offset += read as u64;
                }
            }
        }
        Ok(())
    }

    /// The data of a message.
    pub fn load(&self, spot: Spot) -> Result<Vec<u8>, Error> {
        match spot {
            Spot::Plain { offset, length } => self.read(offset, length),
            Spot::Packed { chunk, length, index } => {
                let unpacked = self.unpack(chunk, length)?;
                let mut messages = unpacked.records().filter(|(op, _)| *op == op::MESSAGE);
                match messages.nth(index) {
                    Some((_, body)) if body.len() >= MESSAGE_HEADER => Ok(body[MESSAGE_HEADER..].to_vec()),
                    _ => {
                        let what = format!("the chunk at byte {chunk} has changed");
                        Err(Error::content(Place::file(&self.path), what, "open it again"))
                    }
                }
            }
        }
    }

    /// Unpacks with `mcap`'s reader, which is given nothing but this chunk, and a limit to what it may reserve.
    fn unpack_into(&self, chunk: u64, length: u64, to: &mut Unpacked) -> Result<McapResult<()>, Error> {
        let body = self.read(chunk, length)?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(limit(length));
        let mut reader = LinearReader::new_with_options(options);
        let mut prefix = vec![op::CHUNK];
        prefix.extend_from_slice(&length.to_le_bytes());
        let mut pieces = [prefix.as_slice(), body.as_slice()].into_iter();
        let mut rest: &[u8] = pieces.next().unwrap_or_default();
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(need)) => {
                    if rest.is_empty() {
                        rest = pieces.next().unwrap_or_default();
                    }
                    if rest.is_empty() {
                        break;
                    }
                    let (now, later) = rest.split_at(need.min(rest.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    rest = later;
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    let start = to.data.len();
                    to.data.extend_from_slice(data);
                    to.records.push((opcode, start..to.data.len()));
                }
                Err(e) => return Ok(Err(e)),
            }
        }
        Ok(Ok(()))
    }

    /// The records of a compressed chunk whose content begins at an offset, checked by its CRC.
    pub fn unpack(&self, chunk: u64, length: u64) -> Result<Arc<Unpacked>, Error> {
        if let Some((at, unpacked)) = &*self.last.lock().unwrap_or_else(PoisonError::into_inner)
            && *at == chunk
        {
            return Ok(Arc::clone(unpacked));
        }
        let mut unpacked = Unpacked::default();
        if let Err(e) = self.unpack_into(chunk, length, &mut unpacked)? {
            unpacked.fault = Some(e.to_string());
        }
        let unpacked = Arc::new(unpacked);
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some((chunk, Arc::clone(&unpacked)));
        Ok(unpacked)
    }
}

/// What is used of a record that is this long at most.
fn limit(compressed: u64) -> usize {
    // Images of nothing but black shrink to a thousandth; more than that is only claimed.
    usize::try_from((compressed.saturating_mul(1000)).clamp(64 << 20, MOST_BYTES)).unwrap_or(usize::MAX)
}

/// The header of a chunk record's content, and the data after it, as many as it says or as there are.
pub(super) fn chunk_header(body: &[u8]) -> Option<(ChunkHeader, &[u8])> {
    let mut cut = Cut(body);
    let header = ChunkHeader {
        message_start_time: cut.u64()?,
        message_end_time: cut.u64()?,
        uncompressed_size: cut.u64()?,
        uncompressed_crc: cut.u32()?,
        compression: cut.text()?,
        compressed_size: cut.u64()?,
    };
    let length = usize::try_from(header.compressed_size).unwrap_or(usize::MAX).min(cut.0.len());
    let (data, _) = cut.0.split_at(length);
    Some((header, data))
}

/// The header of a message record's content; 22 bytes.
pub(super) fn message_header(body: &[u8]) -> Option<MessageHeader> {
    let mut cut = Cut(body);
    Some(MessageHeader {
        channel_id: u16::from_le_bytes(cut.array()?),
        sequence: cut.u32()?,
        log_time: cut.u64()?,
        publish_time: cut.u64()?,
    })
}

/// An attachment record's content.
pub(crate) struct Attached {
    pub log_time: u64,
    pub create_time: u64,
    pub name: String,
    pub media_type: String,
    pub data: Vec<u8>,
}

/// The attachment in a record's content; `None` where it is damaged.
pub(super) fn attachment(body: &[u8]) -> Option<Attached> {
    let mut cut = Cut(body);
    let (log_time, create_time) = (cut.u64()?, cut.u64()?);
    let (name, media_type) = (cut.text()?, cut.text()?);
    let length = usize::try_from(cut.u64()?).ok()?;
    let data = cut.take(length)?.to_vec();
    let covered = body.len() - cut.0.len();
    let crc = cut.u32()?;
    let sound = crc == 0 || crc == crc32fast::hash(&body[..covered]);
    sound.then_some(Attached { log_time, create_time, name, media_type, data })
}

/// Bytes that are cut off from the front; `None` where there are too few.
struct Cut<'a>(&'a [u8]);

impl<'a> Cut<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (first, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(first)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.u32()? as usize;
        String::from_utf8(self.take(length)?.to_vec()).ok()
    }
}
