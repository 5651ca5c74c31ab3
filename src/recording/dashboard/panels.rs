//! The panels of the dashboard, with settings for which Rerun's Rust interface has no method:
//! camera, background, legend, columns of the log.

use rerun::blueprint::components::{BackgroundKind, Corner2D, Eye3DKind};
use rerun::blueprint::datatypes::{TextLogColumn, TextLogColumnKind};
use rerun::blueprint::{
    Blueprint, BlueprintActivation, ContainerLike, Spatial2DView, Spatial3DView, TextLogView,
    TimeSeriesView,
};
use rerun::external::re_sdk_types::blueprint::archetypes::{
    Background, EyeControls3D, LineGrid3D, PlotLegend, TextLogColumns,
};
use rerun::log::LogMsg;
use rerun::{AsComponents, RecordingStream, RecordingStreamBuilder, RecordingStreamResult};

/// Background colour of particle views.
const BACKGROUND: [u8; 3] = [10, 10, 16];

/// A view with the settings that are logged with it.
pub(super) struct Panel {
    pub(super) view: ContainerLike,
    settings: Vec<Setting>,
}

/// One setting: its path in the blueprint, and its value.
pub(super) type Setting = (String, Box<dyn AsComponents>);

impl Panel {
    fn new(view: impl Into<ContainerLike>) -> Self {
        Self { view: view.into(), settings: Vec::new() }
    }

    fn with(mut self, name: &str, value: impl AsComponents + 'static) -> Self {
        if let ContainerLike::View(view) = &self.view {
            self.settings.push((format!("{}/{name}", view.blueprint_path()), Box::new(value)));
        }
        self
    }

    /// Curves, with the legend in a corner or without a legend.
    pub(super) fn plot(name: &str, entities: &[&str], legend: Option<Corner2D>) -> Self {
        let view = TimeSeriesView::new(name).with_contents(entities.iter().copied());
        let shown = PlotLegend::new().with_visible(legend.is_some());
        let legend = legend.map_or(shown.clone(), |corner| shown.with_corner(corner));
        Self::new(view).with("PlotLegend", legend)
    }

    /// A two-dimensional view of particles.
    pub(super) fn plane(name: &str, origin: &str, contents: [&str; 2]) -> Self {
        let view = Spatial2DView::new(name).with_origin(origin).with_contents(contents);
        Self::new(view).with("Background", background())
    }

    /// A view of particles in a box of edge `length`, from a corner.
    pub(super) fn volume(name: &str, origin: &str, contents: [&str; 2], edge: f32) -> Self {
        let view = Spatial3DView::new(name).with_origin(origin).with_contents(contents);
        let eye = EyeControls3D::new()
            .with_kind(Eye3DKind::Orbital)
            .with_position([1.67, -0.87, 1.12].map(|part: f32| part * edge))
            .with_look_target([0.5, 0.5, 0.43].map(|part: f32| part * edge))
            .with_eye_up([0.0_f32, 0.0, 1.0]);
        Self::new(view)
            .with("Background", background())
            .with("EyeControls3D", eye)
            .with("LineGrid3D", LineGrid3D::new().with_visible(false))
    }

    /// The log: level and text.
    pub(super) fn log(name: &str, entity: &str) -> Self {
        let column = |kind| TextLogColumn { visible: true.into(), kind };
        let columns = [column(TextLogColumnKind::LogLevel), column(TextLogColumnKind::Body)];
        let columns = TextLogColumns::new().with_text_log_columns(columns);
        Self::new(TextLogView::new(name).with_contents([entity])).with("TextLogColumns", columns)
    }

    pub(super) fn take_settings(&mut self) -> Vec<Setting> {
        std::mem::take(&mut self.settings)
    }
}

fn background() -> Background {
    let [r, g, b] = BACKGROUND;
    Background::new(BackgroundKind::SolidColor).with_color(rerun::Color::from_rgb(r, g, b))
}

/// Sends a blueprint and its settings, which go into the same store.
pub(super) fn send(
    blueprint: &Blueprint,
    settings: &[Setting],
    stream: &RecordingStream,
) -> RecordingStreamResult<()> {
    let Some(application) = stream.store_info().map(|info| info.application_id().clone()) else {
        return Ok(());
    };
    let (kept, messages) = RecordingStreamBuilder::new(application).memory()?;
    blueprint.send(&kept, BlueprintActivation::default())?;
    let mut sent = Vec::new();
    let mut activation = None;
    for message in messages.take() {
        match message {
            LogMsg::BlueprintActivationCommand(command) => activation = Some(command),
            message if message.store_id().is_blueprint() => sent.push(message),
            _ => {}
        }
    }
    let Some(activation) = activation else {
        return Ok(());
    };
    let store = RecordingStreamBuilder::from_store_id(&activation.blueprint_id);
    let (beside, messages) = store.memory()?;
    beside.set_time_sequence("blueprint", 0);
    for (path, value) in settings {
        beside.log(path.as_str(), value.as_ref())?;
    }
    let settings = messages.take().into_iter();
    sent.extend(settings.filter(|message| matches!(message, LogMsg::ArrowMsg(..))));
    stream.send_blueprint(sent, activation);
    Ok(())
}
