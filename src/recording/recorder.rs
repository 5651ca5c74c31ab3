//! [`Recorder`]: writes a recording, on a separate thread.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use super::colour::Palette;
use super::messages::{Level, Log, TrainStep, Values};
use super::orders::{Order, obey};
use super::rows::{CloudHeader, Particle, write_row};
use super::sink::McapWriter;
use super::{Cloud, Flow, Frame, RunInfo, Summary, clock, topic};
use crate::output::Output;
use crate::statistics::Conservation;
use crate::{Error, Result};

/// Length of the queue, in messages, beyond which the run waits for the disk.
const QUEUE: usize = 8;

/// The columns of a flow's particles.
const WITH_RHO: &[&str] = &["vx", "vy", "vz", "rho"];

/// The columns without densities.
const WITHOUT_RHO: &[&str] = &["vx", "vy", "vz"];

/// Size of a cloud in bytes, maximum: readers refuse a larger chunk.
const LARGEST_CLOUD: usize = super::source::LARGEST_CHUNK - (1 << 20);

/// Writes one run into one MCAP file.
///
/// Particles are encoded at once, with colours, in one pass on all threads. Checksums, compression
/// and writing happen on a separate thread after a queue of eight messages, which returns the
/// memory of each cloud for reuse. If the disk cannot keep up the run waits, and no message is
/// lost. A failure to write is returned by the next call, by all later calls, and by
/// [`finish`](Self::finish). The file gets its final name when it is finished, and has an
/// unfinished name until then, see [`Output`]. Dropping the recorder (also during a panic)
/// completes the file under the unfinished name. After a kill everything up to the last chunk can
/// be read; [`checkpoint`](Self::checkpoint) ends a chunk. Equal inputs give equal bytes.
///
/// ```no_run
/// use whirls::recording::{Flow, Frame, Recorder, RunInfo};
/// # fn main() -> whirls::Result<()> {
/// let run = RunInfo {
///     scene_toml: "name = \"two particles\"".into(),
///     dimension: 2,
///     box_length: 1.0,
///     sides: Vec::new(),
///     boundary: Vec::new(),
///     speed_scale: 1.0,
///     parameters: vec![],
///     metadata: Default::default(),
/// };
/// let mut recorder = Recorder::create("two.mcap".as_ref(), &run)?;
/// let (positions, velocities) = ([[0.1, 0.2], [0.3, 0.4]], [[1.0, 0.0], [0.0, -1.0]]);
/// recorder.frame(Flow::Truth, Frame::new(0, 0.0, positions, velocities, vec![1.0; 2]))?;
/// println!("{} bytes", recorder.finish()?.bytes);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Recorder {
    /// The file while it is written.
    path: PathBuf,
    dimension: usize,
    /// Fraction of the colour scale per unit of speed.
    per_speed: f64,
    palette: Palette,
    queue: Option<SyncSender<Order>>,
    /// Memory of clouds that have been written, to be reused.
    written: Receiver<Vec<u8>>,
    thread: Option<JoinHandle<Result<Summary>>>,
    /// The error that stopped the writing thread.
    failed: Option<Error>,
}

impl Recorder {
    /// Memory on the way to the disk, in bytes per particle, maximum: the frames in the queue, the
    /// one being written and the one being encoded.
    pub const MOST_BYTES: usize = (QUEUE + 2) * Frame::ROW;

    /// Creates the file and its folders, and writes the metadata of the run. An existing file of
    /// that name is replaced when this one is finished.
    ///
    /// # Errors
    /// [`Error::Input`] if `run` is invalid or another run writes the file, [`Error::File`] if it
    /// cannot be created.
    pub fn create(path: &Path, run: &RunInfo) -> Result<Self> {
        run.to_record()?;
        Self::begin(Output::create(path)?, run)
    }

    /// Begins a file that was reserved before.
    ///
    /// # Errors
    /// [`Error::Input`] if `run` is invalid, [`Error::File`] if the file cannot be written.
    pub fn begin(output: Output, run: &RunInfo) -> Result<Self> {
        let path = output.unfinished().to_owned();
        let mut sink = McapWriter::create(output, run.to_record()?, &run.scene_toml)?;
        sink.begin(&run.scene_toml)?;
        let (queue, orders) = sync_channel(QUEUE);
        let (back, written) = channel();
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || obey(sink, &orders, &back))
            .map_err(|error| Error::write(&path, error))?;
        Ok(Self {
            path,
            dimension: run.dimension,
            per_speed: 1.0 / run.speed_scale,
            palette: Palette::new(),
            queue: Some(queue),
            written,
            thread: Some(thread),
            failed: None,
        })
    }

    /// Records the particles of a flow, coloured by speed.
    ///
    /// # Errors
    /// [`Error::Input`] if the columns differ in length or a two-dimensional frame has a third
    /// coordinate; [`Error::File`] if writing has failed.
    pub fn frame(&mut self, flow: Flow, frame: Frame) -> Result<()> {
        self.order_frame(flow.topic(), frame)
    }

    /// Records the particles of one of several learned flows, coloured by speed, on the topic
    /// `/NAME/particles`.
    ///
    /// # Errors
    /// As [`frame`](Self::frame), and [`Error::Input`] for a reserved name.
    pub fn frame_of(&mut self, name: &str, frame: Frame) -> Result<()> {
        let topic = format!("/{name}/particles");
        own_topic(&topic)?;
        self.order_frame(&topic, frame)
    }

    fn order_frame(&mut self, topic: &str, frame: Frame) -> Result<()> {
        frame.check(topic, self.dimension)?;
        let (count, now) = (frame.positions.len(), (frame.step, frame.time));
        let columns = if frame.densities.is_empty() { WITHOUT_RHO } else { WITH_RHO };
        self.order_rows((topic, columns), now, count, |k| frame.particle(k))
    }

    /// Records `count` particles of a flow, coloured by speed; `particle(k)` may be called on any
    /// thread.
    ///
    /// # Errors
    /// [`Error::Input`] if they are too many; [`Error::File`] if writing has failed.
    pub(crate) fn particles(
        &mut self,
        flow: Flow,
        now: (u64, f64),
        count: usize,
        particle: impl Fn(usize) -> Particle + Sync,
    ) -> Result<()> {
        self.order_rows((flow.topic(), WITH_RHO), now, count, particle)
    }

    fn order_rows(
        &mut self,
        (topic, columns): (&str, &[&str]),
        (step, time): (u64, f64),
        count: usize,
        particle: impl Fn(usize) -> Particle + Sync,
    ) -> Result<()> {
        let title = CloudHeader { step, time, columns };
        must_fit(topic, &title, count)?;
        let (mut message, per_speed) = (self.room(), self.per_speed);
        let palette = &self.palette;
        title.encode(&mut message, count, |k, row| {
            let ([x, y, z], [vx, vy, vz], rho) = particle(k);
            let speed = (vx * vx + vy * vy + vz * vz).sqrt();
            let colour = palette.colour(per_speed * speed);
            // A row without a density is shorter.
            write_row((k, row), [x, y, z, vx, vy, vz, rho], colour);
        });
        self.order_cloud(topic, &title, message)
    }

    /// Records particles with any columns on a topic of their own, such as
    /// `/learned/sensitivity/alpha`; `shade[k]` is particle `k`'s fraction of the colour scale, 0 to 1.
    ///
    /// # Errors
    /// [`Error::Input`] if lengths or names do not fit, or the topic is used for something else;
    /// [`Error::File`] if writing has failed.
    pub fn cloud(&mut self, topic: &str, cloud: Cloud, shade: Vec<f64>) -> Result<()> {
        own_topic(topic)?;
        if shade.len() != cloud.positions.len() {
            return Err(Error::input(
                topic,
                format!("{} shades, one per position", cloud.positions.len()),
                shade.len(),
                "give every particle a shade",
            ));
        }
        cloud.check(topic, self.dimension)?;
        let columns: Vec<&str> = cloud.columns.iter().map(|column| column.name.as_str()).collect();
        let title = CloudHeader { step: cloud.step, time: cloud.time, columns: &columns };
        must_fit(topic, &title, cloud.positions.len())?;
        let mut message = self.room();
        cloud.encode(&title, &shade, &mut message);
        self.order_cloud(topic, &title, message)
    }

    /// Records one iteration of learning.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn train_step(&mut self, step: TrainStep) -> Result<()> {
        self.order(Order::TrainStep(step))
    }

    /// Records conserved quantities of the flow.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn conservation(&mut self, conservation: Conservation) -> Result<()> {
        self.order(Order::Conservation(conservation.into()))
    }

    /// Records named numbers on a topic of their own, such as `/errors/field`.
    ///
    /// # Errors
    /// [`Error::Input`] if the topic is used for something else or a name is missing;
    /// [`Error::File`] if writing has failed.
    pub fn values(&mut self, topic: &str, values: Values) -> Result<()> {
        own_topic(topic)?;
        if values.names.len() != values.values.len() {
            let expected = format!("{} values, one per name", values.names.len());
            let found = values.values.len();
            return Err(Error::input(topic, expected, found, "give every name a value"));
        }
        self.order(Order::Values { topic: topic.into(), values })
    }

    /// Attaches a file.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn attach(&mut self, name: &str, media_type: &'static str, data: Vec<u8>) -> Result<()> {
        self.order(Order::Attachment { name: name.into(), media_type, data })
    }

    /// Records a line of text at a simulation time.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn log(&mut self, level: Level, time: f64, text: impl Into<String>) -> Result<()> {
        self.order(Order::Log(Log {
            timestamp: Some(clock::timestamp(time)),
            level: level.into(),
            message: text.into(),
            name: "whirls".into(),
            simulation_time: time,
        }))
    }

    /// Ends the chunk, and returns when the operating system has it: everything recorded so far
    /// survives a kill.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn checkpoint(&mut self) -> Result<()> {
        let (done, wait) = sync_channel(1);
        self.order(Order::Checkpoint(done))?;
        wait.recv().map_err(|_| self.failure())
    }

    /// Completes the file and gives it its final name.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed, now or earlier.
    pub fn finish(mut self) -> Result<Summary> {
        self.order(Order::Finish)?;
        self.close()
    }

    /// Completes the file under its unfinished name: for a run that was interrupted.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed, now or earlier.
    pub fn leave(mut self) -> Result<Summary> {
        self.close()
    }

    /// Finishes the file of a run that ended; completes that of an interrupted run under its
    /// unfinished name.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed, now or earlier.
    pub fn conclude<T>(self, outcome: &Result<T>) -> Result<Summary> {
        match outcome {
            Err(Error::Interrupted { .. }) => self.leave(),
            _ => self.finish(),
        }
    }

    /// Memory for a message: that of a cloud already written, if there is one.
    fn room(&self) -> Vec<u8> {
        self.written.try_recv().unwrap_or_default()
    }

    fn order_cloud(
        &mut self,
        topic: &str,
        title: &CloudHeader<'_>,
        message: Vec<u8>,
    ) -> Result<()> {
        let times = (clock::nanoseconds(title.time), clock::ticks(title.step));
        self.order(Order::Cloud { topic: topic.into(), times, message })
    }

    fn order(&mut self, order: Order) -> Result<()> {
        let sent = (self.queue.as_ref()).is_some_and(|queue| queue.send(order).is_ok());
        if sent { Ok(()) } else { Err(self.failure()) }
    }

    /// The error that stopped the writing thread.
    fn failure(&mut self) -> Error {
        let stopped = std::io::Error::other("writing has stopped");
        self.close().err().unwrap_or_else(|| Error::write(&self.path, stopped))
    }

    fn close(&mut self) -> Result<Summary> {
        drop(self.queue.take());
        let fail = |reason: &str| Error::write(&self.path, std::io::Error::other(reason));
        let error = match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Ok(summary))) => return Ok(summary),
            Some(Ok(Err(error))) => error,
            Some(Err(_)) => fail("the writing thread panicked"),
            None => self.failed.take().unwrap_or_else(|| fail("writing has stopped")),
        };
        self.failed = Some(error.again());
        Err(error)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A caller that needs the error calls `finish`.
        drop(self.close());
    }
}

/// Refuses a cloud of `count` particles that would be too large to be read.
fn must_fit(topic: &str, title: &CloudHeader<'_>, count: usize) -> Result<()> {
    let bytes = title.stride().saturating_mul(count);
    if bytes <= LARGEST_CLOUD {
        return Ok(());
    }
    Err(Error::input(
        topic,
        format!("at most {LARGEST_CLOUD} bytes in a cloud"),
        bytes,
        "record fewer particles or columns",
    ))
}

/// Refuses a reserved topic.
fn own_topic(topic: &str) -> Result<()> {
    if topic.starts_with('/') && !topic::is_reserved(topic) {
        return Ok(());
    }
    Err(Error::input(
        format!("topic {topic:?}"),
        "a topic that starts with `/` and has no meaning yet",
        topic,
        "choose another name, such as /learned/sensitivity/alpha",
    ))
}

#[cfg(test)]
#[path = "recorder_tests.rs"]
mod tests;
