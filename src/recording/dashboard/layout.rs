//! The panels of the dashboard and their arrangement: only panels for which the recording has data.

use rerun::blueprint::components::{Corner2D, LoopMode, PanelState, PlayState};
use rerun::blueprint::{
    Blueprint, BlueprintPanel, Horizontal, SelectionPanel, TimePanel, Vertical,
};
use rerun::{RecordingStream, RecordingStreamResult};

use super::panels::{self, Panel};
use crate::Result;
use crate::recording::{Flow, Recording, RunInfo, TrainStep};

/// Colours of curves, in the order of use; visible on a dark background.
pub(super) const PALETTE: [[u8; 3]; 8] = [
    [255, 176, 59],
    [86, 180, 233],
    [102, 204, 143],
    [236, 112, 160],
    [240, 228, 66],
    [150, 130, 255],
    [230, 97, 60],
    [190, 190, 200],
];

/// Number of parameters plotted, maximum.
const MOST_CURVES: usize = 12;

/// Number of flows in one row, maximum.
const MOST_FLOWS: usize = 4;

/// Duration of one playback of the flow, in seconds.
const PLAY_SECONDS: f64 = 10.0;

/// The content of a recording that can be shown.
pub(super) struct Content {
    dimension: usize,
    edge: f32,
    /// Topics with particles: the truth first, then learned flows.
    pub(super) clouds: Vec<String>,
    /// Topics with named numbers.
    pub(super) values: Vec<String>,
    /// Simulation times of the first and the last frame.
    span: (f64, f64),
    iterations: bool,
    errors: bool,
    conservation: bool,
    log: bool,
}

impl Content {
    pub(super) fn of(recording: &Recording) -> Result<Self> {
        let steps = recording.train_steps()?;
        let counts = recording.counts();
        let mut clouds = recording.cloud_topics();
        let rank = |topic: &String| Flow::ALL.iter().position(|flow| flow.topic() == topic);
        clouds.sort_by_key(|topic| rank(topic).unwrap_or(Flow::ALL.len()));
        let times: Vec<f64> =
            clouds.iter().flat_map(|topic| recording.cloud_times(topic)).collect();
        let start = times.iter().copied().fold(f64::INFINITY, f64::min);
        Ok(Self {
            dimension: recording.run().dimension,
            edge: recording.run().space().longest::<3>() as f32,
            span: (start, times.into_iter().fold(0.0, f64::max)),
            clouds,
            values: recording.value_topics(),
            iterations: !steps.is_empty(),
            errors: steps.iter().any(|step| !step.log10_error.is_empty()),
            conservation: counts.contains_key("/diag/conservation"),
            log: counts.contains_key("/log"),
        })
    }
}

/// Names of the parameters that are plotted.
pub(super) fn shown_parameters(steps: &[TrainStep], run: &RunInfo) -> Vec<String> {
    let count = steps.first().map_or(0, |step| step.parameters.len()).min(MOST_CURVES);
    let name = |k: usize| run.parameters.get(k).cloned().unwrap_or(format!("parameter {k}"));
    (0..count).map(name).collect()
}

/// Sends the layout to the viewer or the file.
pub(super) fn send(content: &Content, stream: &RecordingStream) -> RecordingStreamResult<()> {
    let (mut rows, mut shares, mut settings) = (Vec::new(), Vec::new(), Vec::new());
    let mut all: Vec<(f32, Vec<Panel>)> = Vec::new();
    let mut flows = flows(content);
    while flows.len() > MOST_FLOWS {
        let rest = flows.split_off(flows.len().div_ceil(2));
        all.push((5.0, std::mem::replace(&mut flows, rest)));
    }
    all.push((5.0, flows));
    all.extend([(3.0, learning(content)), (3.0, numbers(content)), (2.2, keeping(content))]);
    for (share, row) in all {
        if row.is_empty() {
            continue;
        }
        let place = |mut panel: Panel| {
            settings.append(&mut panel.take_settings());
            panel.view
        };
        rows.push(Horizontal::new(row.into_iter().map(place).collect::<Vec<_>>()).into());
        shares.push(share);
    }
    let blueprint = Blueprint::new(Vertical::new(rows).with_row_shares(shares))
        .with_auto_views(false)
        .with_auto_layout(false)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(time_panel(content));
    panels::send(&blueprint, &settings, stream)
}

fn time_panel(content: &Content) -> TimePanel {
    let panel = TimePanel::new()
        .with_state(PanelState::Collapsed)
        .with_timeline("time")
        .with_play_state(PlayState::Playing);
    let (start, end) = content.span;
    if end <= start {
        return panel;
    }
    let [first, last] = [start, end].map(rerun::time::TimeInt::from_secs);
    panel
        .with_playback_speed((end - start) / PLAY_SECONDS)
        .with_loop_mode(LoopMode::Selection)
        .with_time_selection(first..=last)
}

fn flows(content: &Content) -> Vec<Panel> {
    let view = |topic: &String| {
        let origin = topic.rsplit_once('/').map_or("/", |(folder, _)| folder);
        let name = match topic.as_str() {
            "/truth/particles" => "truth, coloured by speed",
            "/learned/particles" => "learned, coloured by speed",
            other => other.trim_start_matches('/').trim_end_matches("/particles"),
        };
        let contents = [topic.as_str(), &format!("{origin}/box")];
        match content.dimension {
            2 => Panel::plane(name, origin, contents),
            _ => Panel::volume(name, origin, contents, content.edge),
        }
    };
    content.clouds.iter().map(view).collect()
}

fn numbers(content: &Content) -> Vec<Panel> {
    let panel = |(k, topic): (usize, &String)| {
        let name = format!("log10 of {}, by time", topic.trim_start_matches('/'));
        // The colours are the same in all panels.
        let legend = (k == 0).then_some(Corner2D::RightBottom);
        Panel::plot(&name, &[topic.as_str()], legend)
    };
    content.values.iter().enumerate().map(panel).collect()
}

fn learning(content: &Content) -> Vec<Panel> {
    if !content.iterations {
        return Vec::new();
    }
    let loss =
        Panel::plot("log10 loss, by iteration", &["/train/log10_loss"], Some(Corner2D::RightTop));
    let name = "log10 of |gradient|, by iteration";
    let gradient = Panel::plot(name, &["/train/log10_gradients"], Some(Corner2D::LeftBottom));
    if !content.errors {
        let legend = Some(Corner2D::RightTop);
        let parameters = Panel::plot("parameters, by iteration", &["/train/parameters"], legend);
        return vec![parameters, loss, gradient];
    }
    // The colours are explained once, in the panel beside, if there is room.
    let name = "parameters and (thin) their truth, by iteration";
    let parameters = Panel::plot(name, &["/train/parameters", "/train/truth"], None);
    let name = "log10 relative error of parameters, by iteration";
    let errors = Panel::plot(name, &["/train/log10_error"], Some(Corner2D::LeftBottom));
    vec![parameters, errors, loss, gradient]
}

fn keeping(content: &Content) -> Vec<Panel> {
    let mut row = Vec::new();
    if content.conservation {
        let corner = Some(Corner2D::RightTop);
        row.push(Panel::plot(
            "log10 of momentum drift and |Σ m a|, by time",
            &["/diag/momentum"],
            corner,
        ));
        row.push(Panel::plot("energy, by time", &["/diag/energy"], corner));
        row.push(Panel::plot("limits, by time", &["/diag/limits"], corner));
    }
    if content.log {
        row.push(Panel::log("log", "/log"));
    }
    row
}
