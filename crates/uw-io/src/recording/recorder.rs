//! Writing a recording, so that whatever happens to the process, all but the last moments can be read.

use std::{
    fs::{File, OpenOptions},
    io,
    path::Path,
};

use foxglove::messages as fox;
use prost::Message;
use uw_cloud::PointCloud;

use super::{
    encode,
    entries::{Environment, GalvoState, Level, Picture, Pose, Shot, Stripe},
    head::{self, Head},
    messages::{self, Schema, own, stamp, well_known},
    output::{Counts, Options, Output, Stamps},
    sink::Sink,
    topics,
};
use crate::{
    atomic::{self, Overwrite},
    calibration_toml,
    error::Error,
};

/// Writes one recording. Call it from one thread; [`Recorder::tick`] at least every [`Options::interval`] where
/// nothing else is written, and [`Recorder::finish`] at the end. What is dropped unfinished is closed as well as can be.
///
/// After a failed write the file is cut back to the last chunk that is whole, every further call fails, and what the
/// file then holds is a recording that was cut off: it can be read, and recovered.
pub struct Recorder<S: Sink> {
    output: Output<S>,
    buffer: Vec<u8>,
}

impl Recorder<File> {
    /// Begins a recording in a file, which is there from now on and grows: a killed process leaves what it had written.
    ///
    /// # Errors
    /// [`Error::Exists`] where it exists and may not be replaced, [`Error::File`] where it can't be written, or as
    /// [`Recorder::new`].
    pub fn create(
        path: &Path,
        overwrite: Overwrite,
        head: &Head,
        began_ns: u64,
        options: Options,
    ) -> Result<Self, Error> {
        atomic::check(path, overwrite)?;
        let mut open = OpenOptions::new();
        open.write(true);
        match overwrite {
            Overwrite::Refuse => open.create_new(true),
            Overwrite::Replace => open.create(true).truncate(true),
        };
        let file = open.open(path).map_err(|e| match e.kind() {
            io::ErrorKind::AlreadyExists => Error::Exists { path: path.to_owned() },
            _ => Error::file(path, "write")(e),
        })?;
        Self::new(file, path, head, began_ns, options)
    }
}

impl<S: Sink> Recorder<S> {
    /// Begins a recording in a sink, at a time in nanoseconds since the Unix epoch; `path` names it in errors. The head is written
    /// through at once.
    ///
    /// # Errors
    /// [`Error::File`] where the sink can't be written; what is wrong with the calibration attached.
    pub fn new(sink: S, path: &Path, head: &Head, began_ns: u64, options: Options) -> Result<Self, Error> {
        let parsed = head
            .calibration
            .as_ref()
            .map(|text| calibration_toml::parse(&path.join(head::CALIBRATION), text));
        let calibration = parsed.transpose()?;
        let mut output = Output::begin(sink, path, "", options)?;
        output.metadata(head::METADATA, head.to_metadata())?;
        let rig = head.rig.iter().map(|text| (head::RIG, text));
        for (name, text) in rig.chain(head.calibration.iter().map(|text| (head::CALIBRATION, text))) {
            output.attach(&mcap::Attachment {
                log_time: began_ns,
                create_time: began_ns,
                name: name.to_owned(),
                media_type: "application/toml".to_owned(),
                data: text.as_bytes().into(),
            })?;
        }
        let mut recorder = Self { output, buffer: Vec::new() };
        if let Some((file, _)) = &calibration {
            let camera = encode::camera(file, began_ns);
            recorder.put(
                topics::CALIBRATION,
                well_known::<fox::CameraCalibration>,
                began_ns,
                began_ns,
                &camera,
            )?;
            recorder.transform(&encode::galvo_in_camera(file, began_ns), began_ns)?;
        }
        recorder.output.sync()?;
        Ok(recorder)
    }

    /// Records an image and its row of frames.csv. Numbers rise from image to image.
    ///
    /// # Errors
    /// [`Error::Image`] where the picture is not of its size; else as [`Recorder::new`].
    pub fn frame(&mut self, shot: &Shot<'_>, picture: &Picture<'_>, received_ns: u64) -> Result<(), Error> {
        if let Some(what) = misfit(picture) {
            let path = self.output.path().join(format!("{}", shot.number));
            return Err(Error::image(&path, what, "this is a mistake of the program that records"));
        }
        self.output.room()?;
        let mut image = std::mem::take(&mut self.buffer);
        image.clear();
        let crc = encode::image(picture, shot.stamp_ns, &mut image);
        let row = self.row(shot, received_ns, Some(crc), "");
        let channel = match picture {
            Picture::U8 { .. } | Picture::U16 { .. } => {
                self.output.channel(topics::IMAGE, 0, well_known::<fox::RawImage>)
            }
            Picture::Png(_) | Picture::Jpeg(_) => {
                self.output.channel(topics::IMAGE, 1, well_known::<fox::CompressedImage>)
            }
        };
        // Both go into one chunk: an image is never there without its row.
        let put = row.and(channel).and_then(|channel| {
            let stamps =
                Stamps { log_ns: received_ns, publish_ns: shot.stamp_ns, sequence: Some(shot.number) };
            self.output.message(channel, stamps, &image)
        });
        self.buffer = image;
        put?;
        self.output.counts.frames += 1;
        self.output.tick()
    }

    /// Records that an image is lost, and why.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn lost_frame(&mut self, shot: &Shot<'_>, why: &str, received_ns: u64) -> Result<(), Error> {
        self.output.room()?;
        self.row(shot, received_ns, None, why)?;
        self.output.counts.lost_frames += 1;
        self.output.tick()
    }

    fn row(
        &mut self,
        shot: &Shot<'_>,
        received_ns: u64,
        image_crc32: Option<u32>,
        lost: &str,
    ) -> Result<(), Error> {
        let row = encode::row(shot, image_crc32, lost);
        let channel = self.output.channel(topics::FRAME, 0, || own(messages::FRAME))?;
        let stamps = Stamps { log_ns: received_ns, publish_ns: shot.stamp_ns, sequence: Some(shot.number) };
        self.output.message(channel, stamps, &row.encode_to_vec())
    }

    /// Records what the galvanometer was told, and said.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn galvo(&mut self, state: &GalvoState, received_ns: u64) -> Result<(), Error> {
        let message = encode::galvo(state);
        self.put(topics::GALVO, || own(messages::GALVO), state.stamp_ns, received_ns, &message)
    }

    /// Records the stripe of one image.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn stripe(&mut self, stripe: &Stripe<'_>, received_ns: u64) -> Result<(), Error> {
        let message = encode::profile(stripe);
        self.put(topics::PROFILE, || own(messages::PROFILE), stripe.stamp_ns, received_ns, &message)
    }

    /// Records points, such as those of one image, taken at `stamp_ns`.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn points(&mut self, cloud: &PointCloud, stamp_ns: u64, received_ns: u64) -> Result<(), Error> {
        let message = encode::points(cloud, stamp_ns);
        self.put(topics::POINTS, well_known::<fox::PointCloud>, stamp_ns, received_ns, &message)
    }

    /// Records where one frame is in another, on the topic `/tf`.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn transform(&mut self, pose: &Pose<'_>, received_ns: u64) -> Result<(), Error> {
        self.put(
            topics::TRANSFORMS,
            well_known::<fox::FrameTransforms>,
            pose.stamp_ns,
            received_ns,
            &encode::transform(pose),
        )
    }

    /// Records where a navigation system says that the vehicle is.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn vehicle(&mut self, pose: &Pose<'_>, received_ns: u64) -> Result<(), Error> {
        self.put(
            topics::POSE,
            well_known::<fox::PoseInFrame>,
            pose.stamp_ns,
            received_ns,
            &encode::pose(pose),
        )
    }

    /// Records what is known of the water.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn environment(&mut self, water: &Environment, received_ns: u64) -> Result<(), Error> {
        let message = messages::Environment {
            timestamp: Some(stamp(water.stamp_ns)),
            temperature_c: water.temperature_c,
            salinity_psu: water.salinity_psu,
            depth_m: water.depth_m,
            index: water.index,
        };
        self.put(topics::ENVIRONMENT, || own(messages::ENVIRONMENT), water.stamp_ns, received_ns, &message)
    }

    /// Records a line for people.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn log(&mut self, level: Level, text: &str, at_ns: u64) -> Result<(), Error> {
        self.put(topics::LOG, well_known::<fox::Log>, at_ns, at_ns, &encode::log(level, text, at_ns))
    }

    /// Closes the chunk, and has it made durable, if its first message is older than the interval. To be called where nothing else is
    /// written for a while.
    ///
    /// # Errors
    /// As [`Recorder::new`].
    pub fn tick(&mut self) -> Result<(), Error> {
        self.output.tick()
    }

    /// What became of it so far.
    pub fn counts(&self) -> Counts {
        self.output.counts()
    }

    /// Ends the recording: writes its index, and waits until all is durable.
    ///
    /// # Errors
    /// As [`Recorder::new`]: the recording then is one that was cut off.
    pub fn finish(self) -> Result<Counts, Error> {
        self.output.finish()
    }

    /// A message that is no image.
    fn put(
        &mut self,
        topic: &'static str,
        schema: impl FnOnce() -> Schema,
        stamp_ns: u64,
        received_ns: u64,
        message: &impl Message,
    ) -> Result<(), Error> {
        self.output.room()?;
        self.buffer.clear();
        message.encode_raw(&mut self.buffer);
        let channel = self.output.channel(topic, 0, schema)?;
        let stamps = Stamps { log_ns: received_ns, publish_ns: stamp_ns, sequence: None };
        self.output.message(channel, stamps, &self.buffer)?;
        self.output.tick()
    }
}

/// What is wrong with the picture; `None` where nothing is.
fn misfit(picture: &Picture<'_>) -> Option<String> {
    let (width, height, got) = match *picture {
        Picture::U8 { width, height, pixels } => (width, height, pixels.len()),
        Picture::U16 { width, height, pixels } => (width, height, pixels.len()),
        Picture::Png(_) | Picture::Jpeg(_) => return None,
    };
    let needed = u64::from(width) * u64::from(height);
    (needed != got as u64).then(|| format!("{width} x {height} pixels are {needed} values, not {got}"))
}
