//! Scans and recordings shown over the network, and steered from there: what ties [`crate::live`] to the pipeline.

use std::path::Path;

mod replay;
mod watch;

pub use replay::{Replayed, Source, replay};
pub use watch::{OneScan, Station, Watch, Watched, obey};

/// What clients ask for, as it comes.
pub type Requests = crossbeam_channel::Receiver<crate::live::Asked>;

/// A text without the folders that lead to a file or folder that it tells of: where a machine keeps what it shows is not its viewers' to know.
pub fn without_folders(text: &str, path: &Path) -> String {
    // Neither the root nor nothing: that tells nothing.
    let folder = path.parent().filter(|folder| folder.parent().is_some());
    folder.map_or_else(|| text.to_owned(), |folder| text.replace(&folder.join("").display().to_string(), ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_that_lead_to_a_recording_are_not_told() {
        let of = |text, path| without_folders(text, Path::new(path));
        let text = "/data/dive 3/ball/images/7.png: missing; /data/dive 3/ball is not whole";
        assert_eq!(of(text, "/data/dive 3/ball"), "ball/images/7.png: missing; ball is not whole");
        assert_eq!(of("../a/b.mcap: torn", "../a/b.mcap"), "b.mcap: torn");
        assert_eq!(of("ball/frames.csv:3: what", "ball"), "ball/frames.csv:3: what");
        assert_eq!(of("/ball/frames.csv: what", "/ball"), "/ball/frames.csv: what");
    }
}
