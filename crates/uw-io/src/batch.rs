//! What became of each recording of an archive: a small file (`.result.toml`) beside its cloud, and the table of all.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::{
    atomic::{self, Overwrite},
    error::{Error, Place},
    toml_file::TomlFile,
};

/// The `format` of a result's file.
pub const FORMAT: &str = "uwscan-result";
/// The newest version of it that is read, and the one that is written.
pub const VERSION: u32 = 1;

/// What became of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// It became a cloud.
    Done,
    /// It became a cloud, of what could be read of it.
    WithLoss,
    /// It became none.
    Failed,
    /// It is no scan.
    Skipped,
}

impl Status {
    /// The status's name as files carry it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::WithLoss => "with_loss",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}

/// One recording's result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResultRecord {
    /// The recording, relative to the archive's folder, with `/` between folders.
    pub recording: String,
    /// What became of it.
    pub status: Status,
    /// Hash of what the result follows from ([`key`]); empty where that could not be read.
    pub key: String,
    /// Points of the cloud.
    pub points: usize,
    /// Images used.
    pub frames: usize,
    /// Images and parts that were missing or unreadable.
    pub lost: usize,
    /// Index of refraction used outside the windows; 0 where there is no cloud.
    pub index: f64,
    /// Time that it took, seconds.
    pub seconds: f64,
    /// Why it failed, or the first thing that was lost; may be empty.
    pub message: String,
}

/// SHA-256, in hexadecimal, of texts that each count with their length.
pub fn key<'a>(parts: impl IntoIterator<Item = &'a str>) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The result in a file.
///
/// # Errors
/// [`Error`] where there is none, or it is of another format or wrong.
pub fn read(path: &Path) -> Result<ResultRecord, Error> {
    TomlFile::read(path, FORMAT, VERSION)?.parse()
}

/// Writes a result, whole or not at all, in place of one that is there.
///
/// # Errors
/// As [`atomic::write`].
pub fn write(path: &Path, record: &ResultRecord) -> Result<(), Error> {
    let body = toml::to_string(record)
        .map_err(|e| Error::content(Place::file(path), e.to_string(), "report this"))?;
    let text = format!("format = \"{FORMAT}\"\nversion = {VERSION}\n{body}");
    atomic::write(path, Overwrite::Replace, |out| out.write_all(text.as_bytes()))
}

/// Writes the table of all results (CSV, a line a recording), whole or not at all, in place of one that is there.
///
/// # Errors
/// As [`atomic::write`].
pub fn write_table(path: &Path, records: &[ResultRecord]) -> Result<(), Error> {
    let mut table = csv::Writer::from_writer(Vec::new());
    let written = records.iter().try_for_each(|record| table.serialize(record));
    let bytes = written
        .map_err(|e| e.to_string())
        .and_then(|()| table.into_inner().map_err(|e| e.to_string()))
        .map_err(|e| Error::content(Place::file(path), e, "report this"))?;
    atomic::write(path, Overwrite::Replace, |out| out.write_all(&bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(recording: &str, status: Status, message: &str) -> ResultRecord {
        ResultRecord {
            recording: recording.into(),
            status,
            key: key([recording]),
            points: 12,
            frames: 3,
            lost: 0,
            index: 1.335,
            seconds: 0.25,
            message: message.into(),
        }
    }

    #[test]
    fn a_result_reads_back_and_replaces_the_last() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.result.toml");
        write(&path, &record("a", Status::Failed, "a \"quoted\" reason,\nof two lines")).unwrap();
        let second = record("a", Status::Done, "");
        write(&path, &second).unwrap();
        assert_eq!(read(&path).unwrap(), second);
    }

    #[test]
    fn the_table_has_a_line_for_each_and_quotes_what_has_commas() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        let all = [record("a", Status::Done, ""), record("b/c.mcap", Status::Failed, "torn, and cut off")];
        write_table(&path, &all).unwrap();
        let mut table = csv::Reader::from_path(&path).unwrap();
        let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
        assert_eq!(table.headers().unwrap().get(0), Some("recording"));
        assert_eq!(rows.len(), 2);
        assert_eq!((rows[1].get(0), rows[1].get(1)), (Some("b/c.mcap"), Some("failed")));
        assert_eq!(rows[1].get(8), Some("torn, and cut off"));
    }

    #[test]
    fn a_key_tells_where_its_parts_end() {
        assert_ne!(key(["ab", "c"]), key(["a", "bc"]));
        assert_eq!(key([]), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }
}
