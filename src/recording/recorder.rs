//! [`Recorder`]: the writer of a recording, on a thread of its own.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;

use prost::Message as _;

use super::colour::Palette;
use super::messages::{Conservation, Level, Log, TrainStep, Values};
use super::rows::{Particle, Title, write_row};
use super::schemas::Schema;
use super::sink::{Entry, Sink};
use super::{Cloud, Flow, Frame, RunInfo, Summary, clock, topic};
use crate::{Error, Result};

/// How many messages may wait for the disk before the run waits for it.
const QUEUE: usize = 8;

/// The columns of a flow's particles.
const WITH_RHO: &[&str] = &["vx", "vy", "vz", "rho"];

/// Those of a flow whose densities are not known.
const WITHOUT_RHO: &[&str] = &["vx", "vy", "vz"];

/// The largest cloud, in bytes: readers refuse a larger chunk.
const LARGEST_CLOUD: usize = super::source::LARGEST_CHUNK - (1 << 20);

/// Writes one run into one MCAP file.
///
/// Particles become the bytes of their message at once, coloured, in one pass on all threads; checksums,
/// compressing and writing happen on a thread of their own behind a queue of eight messages, from
/// which the memory of each cloud comes back to be used again. When the disk cannot keep up the run
/// waits, and no message is lost. A failure to write is returned by the next call, or by
/// [`finish`](Self::finish). Dropping the recorder (also while a panic unwinds) completes the file; of a
/// killed run everything up to the last chunk can be read, and [`checkpoint`](Self::checkpoint) ends a
/// chunk. Equal inputs give equal bytes.
///
/// ```no_run
/// use whirls::recording::{Flow, Frame, Recorder, RunInfo};
/// # fn main() -> whirls::Result<()> {
/// let run = RunInfo {
///     scene_toml: "name = \"two particles\"".into(),
///     dimension: 2,
///     box_length: 1.0,
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
    path: PathBuf,
    dimension: usize,
    /// Fraction of the colour scale of each unit of speed.
    per_speed: f64,
    palette: Palette,
    queue: Option<SyncSender<Order>>,
    /// Clouds that have been written, to be written over.
    written: Receiver<Vec<u8>>,
    thread: Option<JoinHandle<Result<Summary>>>,
}

/// What the writing thread is told to do.
enum Order {
    /// An encoded cloud, with the times of its message.
    Cloud {
        topic: String,
        times: (u64, u64),
        message: Vec<u8>,
    },
    TrainStep(TrainStep),
    Conservation(Conservation),
    Log(Log),
    Values {
        topic: String,
        values: Values,
    },
    Attachment {
        name: String,
        media_type: &'static str,
        data: Vec<u8>,
    },
    Checkpoint(SyncSender<()>),
}

impl Recorder {
    /// Most bytes per particle on their way to the disk: the frames that wait, the one that is written and
    /// the one that is made.
    pub const MOST_BYTES: usize = (QUEUE + 2) * Frame::ROW;

    /// Creates the file, and the folders it lies in, and begins it with what is known of the run.
    ///
    /// # Errors
    /// [`Error::Input`] if `run` is impossible, [`Error::File`] if the file cannot be created.
    pub fn create(path: &Path, run: &RunInfo) -> Result<Self> {
        let mut sink = Sink::create(path, run.to_record()?, &run.scene_toml)?;
        sink.begin(&run.scene_toml)?;
        let (queue, orders) = sync_channel(QUEUE);
        let (back, written) = channel();
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || obey(sink, &orders, &back))
            .map_err(|error| Error::write(path, error))?;
        Ok(Self {
            path: path.to_owned(),
            dimension: run.dimension,
            per_speed: 1.0 / run.speed_scale,
            palette: Palette::new(),
            queue: Some(queue),
            written,
            thread: Some(thread),
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
    /// As [`frame`](Self::frame), and [`Error::Input`] for the name of a flow that has a meaning.
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

    /// Records `count` particles of a flow, coloured by speed; `particle(k)` is asked for on any thread.
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
        let title = Title { step, time, columns };
        must_fit(topic, &title, count)?;
        let (mut message, per_speed) = (self.room(), self.per_speed);
        let palette = &self.palette;
        title.encode(&mut message, count, |k, row| {
            let ([x, y, z], [vx, vy, vz], rho) = particle(k);
            let speed = (vx * vx + vy * vy + vz * vz).sqrt();
            let colour = palette.colour(per_speed * speed);
            // A row without a density ends before it.
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
        let title = Title { step: cloud.step, time: cloud.time, columns: &columns };
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

    /// Records what the flow should keep.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn conservation(&mut self, conservation: Conservation) -> Result<()> {
        self.order(Order::Conservation(conservation))
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

    /// Ends the chunk and returns when the operating system has it: what was recorded until now
    /// survives a kill.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed.
    pub fn checkpoint(&mut self) -> Result<()> {
        let (done, wait) = sync_channel(1);
        self.order(Order::Checkpoint(done))?;
        wait.recv().map_err(|_| self.failure())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`Error::File`] if writing has failed, now or earlier.
    pub fn finish(mut self) -> Result<Summary> {
        self.close()
    }

    /// Memory for a message: that of a cloud which has been written, where there is one.
    fn room(&self) -> Vec<u8> {
        self.written.try_recv().unwrap_or_default()
    }

    fn order_cloud(&mut self, topic: &str, title: &Title<'_>, message: Vec<u8>) -> Result<()> {
        let times = (clock::nanoseconds(title.time), clock::ticks(title.step));
        self.order(Order::Cloud { topic: topic.into(), times, message })
    }

    fn order(&mut self, order: Order) -> Result<()> {
        let sent = (self.queue.as_ref()).is_some_and(|queue| queue.send(order).is_ok());
        if sent { Ok(()) } else { Err(self.failure()) }
    }

    /// Why the writing thread has stopped.
    fn failure(&mut self) -> Error {
        let stopped = std::io::Error::other("writing has stopped");
        self.close().err().unwrap_or_else(|| Error::write(&self.path, stopped))
    }

    fn close(&mut self) -> Result<Summary> {
        drop(self.queue.take());
        let fail = |reason: &str| Err(Error::write(&self.path, std::io::Error::other(reason)));
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) => fail("the writing thread panicked"),
            None => fail("writing has failed before"),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A caller that wants to know of a failure calls `finish`.
        drop(self.close());
    }
}

/// Refuses a cloud of `count` particles that would be too large to be read.
fn must_fit(topic: &str, title: &Title<'_>, count: usize) -> Result<()> {
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

/// Refuses a topic that means something else.
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

/// The writing thread: obeys until the queue is closed, then completes the file.
fn obey(mut sink: Sink, orders: &Receiver<Order>, written: &Sender<Vec<u8>>) -> Result<Summary> {
    for order in orders {
        match order {
            Order::Cloud { topic, times, message } => {
                write_cloud(&mut sink, &topic, times, &message)?;
                // Nobody waits for the memory of the last clouds.
                let _ = written.send(message);
            }
            Order::TrainStep(step) => {
                let time = clock::ticks(step.iteration);
                write(&mut sink, topic::TRAIN_STEP, (time, time), &step.encode_to_vec())?;
            }
            Order::Conservation(kept) => {
                let times = (clock::nanoseconds(kept.time), clock::ticks(kept.step));
                write(&mut sink, topic::CONSERVATION, times, &kept.encode_to_vec())?;
            }
            Order::Log(log) => {
                let count = sink.count(topic::LOG);
                let times = (clock::nanoseconds(log.simulation_time), clock::ticks(count));
                write(&mut sink, topic::LOG, times, &log.encode_to_vec())?;
            }
            Order::Values { topic, values } => {
                let schema = Schema::Values;
                sink.channel(&topic, schema.name(), || schema.descriptors())?;
                let times = (clock::nanoseconds(values.time), clock::ticks(values.step));
                write(&mut sink, &topic, times, &values.encode_to_vec())?;
            }
            Order::Attachment { name, media_type, data } => {
                sink.attach(&name, media_type, &data)?;
            }
            Order::Checkpoint(done) => {
                sink.flush()?;
                // Whoever asked may have gone; the flush is done all the same.
                let _ = done.send(());
            }
        }
    }
    sink.finish()
}

fn write(sink: &mut Sink, topic: &str, times: (u64, u64), data: &[u8]) -> Result<()> {
    let (log_time, publish_time) = times;
    sink.write(&Entry { topic, log_time, publish_time, data, alone: false })
}

fn write_cloud(sink: &mut Sink, topic: &str, times: (u64, u64), data: &[u8]) -> Result<()> {
    let schema = Schema::PointCloud;
    sink.channel(topic, schema.name(), || schema.descriptors())?;
    let (log_time, publish_time) = times;
    sink.write(&Entry { topic, log_time, publish_time, data, alone: true })
}

#[cfg(test)]
mod tests {
    use super::super::Recording;
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    const PARTICLES: usize = 300;
    const FRAMES: usize = 60;

    fn frame(step: usize) -> Frame {
        let rows = (0..PARTICLES).map(|k| [k as f64, step as f64, (k * step) as f64]);
        Frame::new(step as u64, step as f64, rows.clone(), rows, vec![1.0; PARTICLES])
    }

    fn recorder(path: &Path) -> Result<Recorder> {
        let run = RunInfo {
            scene_toml: "name = \"test\"\n".into(),
            dimension: 3,
            box_length: 1.0,
            speed_scale: 1.0,
            parameters: vec![],
            metadata: Default::default(),
        };
        Recorder::create(path, &run)
    }

    #[test]
    fn no_frame_is_lost_and_memory_stays_bounded_when_the_disk_stands_still() -> Result<()> {
        let folder = std::env::temp_dir().join(format!("whirls-still-{}", std::process::id()));
        let path = folder.join("still.mcap");
        let mut recorder = recorder(&path)?;
        // The writing thread waits here until somebody takes its answer.
        let (done, wait) = sync_channel(0);
        recorder.order(Order::Checkpoint(done))?;
        let accepted = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            let run = scope.spawn(|| -> Result<()> {
                for step in 0..FRAMES {
                    recorder.frame(Flow::Truth, frame(step))?;
                    accepted.fetch_add(1, Ordering::SeqCst);
                }
                recorder.checkpoint()
            });
            while accepted.load(Ordering::SeqCst) < QUEUE - 1 {
                std::thread::yield_now();
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
            assert!(accepted.load(Ordering::SeqCst) <= QUEUE, "the run waits for the disk");
            assert!(wait.recv().is_ok());
            run.join().unwrap_or_else(|_| panic!("the run panicked"))
        })?;
        // All the memory that was ever made has come back.
        let made: Vec<Vec<u8>> = recorder.written.try_iter().collect();
        let bytes: usize = made.iter().map(Vec::capacity).sum();
        assert!(made.len() <= QUEUE + 2, "{} clouds in memory", made.len());
        assert!(bytes <= PARTICLES * Recorder::MOST_BYTES + made.len() * 512, "{bytes} bytes");
        recorder.finish()?;
        let recording = Recording::open(&path)?;
        assert_eq!(recording.frame_count(Flow::Truth), FRAMES);
        for step in 0..FRAMES {
            assert_eq!(recording.frame(Flow::Truth, step)?, frame(step));
        }
        std::fs::remove_dir_all(folder).map_err(|error| Error::write(&path, error))
    }

    #[test]
    fn a_disk_that_keeps_up_is_given_the_same_memory_again() -> Result<()> {
        let folder = std::env::temp_dir().join(format!("whirls-again-{}", std::process::id()));
        let mut recorder = recorder(&folder.join("again.mcap"))?;
        for step in 0..FRAMES {
            recorder.frame(Flow::Truth, frame(step))?;
            recorder.checkpoint()?;
        }
        assert_eq!(recorder.written.try_iter().count(), 1);
        recorder.finish()?;
        std::fs::remove_dir_all(&folder).map_err(|error| Error::write(&folder, error))
    }
}
