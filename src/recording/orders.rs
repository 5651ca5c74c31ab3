//! The orders to the recorder's writing thread, and their execution.

use std::sync::mpsc::{Receiver, Sender, SyncSender};

use prost::Message as _;

use super::messages::{Conservation, Log, TrainStep, Values};
use super::schemas::Schema;
use super::sink::{Entry, McapWriter};
use super::{Summary, clock, topic};
use crate::Result;

/// An order to the writing thread.
pub(super) enum Order {
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
    /// Complete the file under its final name.
    Finish,
}

/// The writing thread: executes orders until the queue is closed, then completes the file.
pub(super) fn obey(
    mut sink: McapWriter,
    orders: &Receiver<Order>,
    written: &Sender<Vec<u8>>,
) -> Result<Summary> {
    let mut named = false;
    for order in orders {
        match order {
            Order::Cloud { topic, times, message } => {
                write_cloud(&mut sink, &topic, times, &message)?;
                // The recorder may be gone, and its receiver with it: then the memory is simply
                // freed.
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
                // The receiver may be gone; the flush has been done anyway.
                let _ = done.send(());
            }
            Order::Finish => named = true,
        }
    }
    sink.finish(named)
}

fn write(sink: &mut McapWriter, topic: &str, times: (u64, u64), data: &[u8]) -> Result<()> {
    let (log_time, publish_time) = times;
    sink.write(&Entry { topic, log_time, publish_time, data, alone: false })
}

fn write_cloud(sink: &mut McapWriter, topic: &str, times: (u64, u64), data: &[u8]) -> Result<()> {
    let schema = Schema::PointCloud;
    sink.channel(topic, schema.name(), || schema.descriptors())?;
    let (log_time, publish_time) = times;
    sink.write(&Entry { topic, log_time, publish_time, data, alone: true })
}
