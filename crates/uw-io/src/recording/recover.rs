//! A whole recording from one that was cut off or damaged.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use super::{
    bytes::{Bytes, Spot},
    output::{Counts, Options, Output, Stamps},
    reader::Recording,
    sink::Through,
    topics,
    walk::{Channel, End, Item, walk},
};
use crate::{
    atomic::{self, Overwrite},
    error::{Error, Place, Problem},
};

/// Name of the metadata record that tells of a recovery.
const METADATA: &str = "uwscan-recovery";

/// What came of a recovery.
#[derive(Debug)]
pub struct Recovered {
    /// What the new file holds.
    pub counts: Counts,
    /// What is missing or damaged, and what is odd.
    pub problems: Vec<Problem>,
}

/// Writes all that can be read of a recording into a new one with an index, whole or not at all: every message with its
/// times and number, metadata and files attached. Any MCAP file is taken, whoever made it. An image of ours that is damaged goes along as it is, and
/// is told of.
///
/// # Errors
/// [`Error`] where it can't be read, is no MCAP file or holds no message, and where the new file can't be written.
pub fn recover(torn: &Path, whole: &Path, overwrite: Overwrite) -> Result<Recovered, Error> {
    let bytes = Bytes::open(torn)?;
    let mut profile = String::new();
    // A first walk finds the profile, which stands first in the new file.
    let end = walk(&bytes, |item| {
        if let Item::Profile(name) = item {
            name.clone_into(&mut profile);
        }
        Ok(())
    })?;
    let counts = atomic::write_through(whole, overwrite, |out| {
        let mut output = Output::begin(Through(out), whole, &profile, Options::default())?;
        let mut channels: Vec<(Arc<Channel>, u16)> = Vec::new();
        walk(&bytes, |item| copy(&bytes, item, &mut output, &mut channels))?;
        output.metadata(METADATA, note(torn, &end))?;
        if output.counts().messages == 0 {
            let what = "holds no message that can be read";
            return Err(Error::content(Place::file(torn), what, "check that this is the recording meant"));
        }
        output.finish()
    })?;
    let problems = match Recording::open(torn) {
        Ok(recording) => {
            let damaged = recording.damaged();
            recording.problems.into_iter().chain(damaged).collect()
        }
        // Another program's file: what is torn is known all the same.
        Err(_) => {
            let lost = |fault| Problem::lost(Error::content(Place::file(torn), fault, "the rest was kept"));
            end.faults.iter().cloned().map(lost).collect()
        }
    };
    Ok(Recovered { counts, problems })
}

fn note(torn: &Path, end: &End) -> BTreeMap<String, String> {
    let name = torn.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let software = concat!("uwscan ", env!("CARGO_PKG_VERSION")).to_owned();
    [("from", name), ("software", software), ("faults", end.faults.join("; "))]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
}

fn copy(
    bytes: &Bytes,
    item: Item<'_>,
    output: &mut Output<Through<'_>>,
    channels: &mut Vec<(Arc<Channel>, u16)>,
) -> Result<(), Error> {
    let (header, channel, spot) = match item {
        Item::Profile(_) => return Ok(()),
        Item::Metadata(record) => return output.metadata(&record.name, record.metadata.clone()),
        Item::Attachment(file) => {
            return output.attach(&mcap::Attachment {
                log_time: file.log_time,
                create_time: file.create_time,
                name: file.name.clone(),
                media_type: file.media_type.clone(),
                data: file.data.as_slice().into(),
            });
        }
        Item::Message(header, channel, spot) => (header, channel, spot),
    };
    // An image stays in one chunk with its row.
    if channel.topic != topics::IMAGE {
        output.room()?;
    }
    let known = channels.iter().find(|(other, _)| Arc::ptr_eq(other, channel)).map(|(_, id)| *id);
    let id = match known {
        Some(id) => id,
        None => {
            let id = output.channel_like(channel)?;
            channels.push((Arc::clone(channel), id));
            id
        }
    };
    let stamps =
        Stamps { log_ns: header.log_time, publish_ns: header.publish_time, sequence: Some(header.sequence) };
    match spot {
        Spot::Plain { length, .. } if length > super::bytes::MOST_BYTES => Ok(()),
        spot => output.message(id, stamps, &bytes.load(spot)?),
    }
}
