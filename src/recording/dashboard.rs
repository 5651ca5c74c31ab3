//! The Rerun dashboard of a recording: flows, course of learning, conserved quantities.
//!
//! The entities have the names of the recording's topics. They are logged from what [`Recording`]
//! reads and not by Rerun's own MCAP reader, for four reasons: a two-dimensional flow gets
//! two-dimensional views, a truncated file can be shown, iterations and steps have timelines of
//! their own, and times are durations instead of dates in 1970.
//!
//! It opens on the timeline `time`: seconds of simulation time for the flow, and one second per
//! iteration for learning. The particles therefore move while whole curves are visible; playback
//! loops over the flow's frames in about ten seconds. The timelines `step` and `iteration` each
//! hold one of the two.

mod entities;
mod layout;
mod panels;

use std::net::{TcpStream, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rerun::{RecordingStream, RecordingStreamBuilder, RecordingStreamError, RecordingStreamResult};

use super::Recording;
use crate::{Error, Result};

/// The name under which the viewer keeps the dashboard.
const APPLICATION: &str = "whirls";

/// Time that a viewer may take to answer.
const PATIENCE: Duration = Duration::from_secs(3);

/// The output of the dashboard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// An `.rrd` file, which any Rerun viewer from 0.36 opens.
    Save(PathBuf),
    /// A viewer that is started, or one that is already running.
    Spawn,
    /// A viewer that listens at this address, or at the default one.
    Connect(Option<String>),
}

/// Shows a recording under a name.
///
/// # Errors
/// [`Error::Input`] if no viewer can be reached or started, or the recording is damaged;
/// [`Error::File`] if the `.rrd` cannot be written.
pub fn show(recording: &Recording, name: &str, target: &Target) -> Result<()> {
    knock(target)?;
    let stream = open(name, target)?;
    let failed = |error: RecordingStreamError| failure(target, &error);
    stream.set_log_time_enabled(false);
    stream.set_log_tick_enabled(false);
    let content = layout::Content::of(recording)?;
    layout::send(&content, &stream).map_err(failed)?;
    entities::send(recording, &content, &stream, failed)?;
    stream.flush_blocking().map_err(|error| failure(target, &error))
}

fn open(name: &str, target: &Target) -> Result<RecordingStream> {
    let builder = RecordingStreamBuilder::new(APPLICATION).recording_name(name);
    let opened: RecordingStreamResult<_> = match target {
        Target::Save(path) => {
            make_folder_of(path)?;
            builder.save(path)
        }
        Target::Spawn => builder.spawn(),
        Target::Connect(None) => builder.connect_grpc(),
        Target::Connect(Some(url)) => builder.connect_grpc_opts(url.as_str()),
    };
    opened.map_err(|error| failure(target, &error))
}

/// Whether a viewer listens at an address; the stream itself would wait for ever.
fn knock(target: &Target) -> Result<()> {
    let Target::Connect(url) = target else {
        return Ok(());
    };
    let url = url.as_deref().unwrap_or("rerun+http://127.0.0.1:9876/proxy");
    let after_scheme = url.split_once("://").map_or(url, |(_, rest)| rest);
    let address = after_scheme.split('/').next().unwrap_or_default();
    let refused = |error: std::io::Error| failure(target, &error);
    let mut last = std::io::Error::other("the address names no machine");
    for address in address.to_socket_addrs().map_err(refused)? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(_) => return Ok(()),
            Err(error) => last = error,
        }
    }
    Err(refused(last))
}

fn make_folder_of(path: &Path) -> Result<()> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(|error| Error::write(folder, error))
}

fn failure(target: &Target, error: &dyn std::fmt::Display) -> Error {
    let viewer = |place: String, remedy: &str| Error::input(place, "a Rerun viewer", error, remedy);
    match target {
        Target::Save(path) => Error::write(path, std::io::Error::other(error.to_string())),
        Target::Spawn => viewer(
            "--spawn".into(),
            "install it with `pip install rerun-sdk==0.36.3`, or use --save",
        ),
        Target::Connect(url) => viewer(
            format!("--connect {}", url.as_deref().unwrap_or_default()),
            "start the viewer first, and give an address such as rerun+http://127.0.0.1:9876/proxy",
        ),
    }
}
