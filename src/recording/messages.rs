//! The protobuf messages of a recording: standard ones of Foxglove, and some of our own.
//!
//! Field numbers of the `foxglove.*` messages are those published by Foxglove, so that its viewers
//! and Rerun read them; fields that are never used (`pose`'s optional extras, identifiers) are left
//! out. Floating-point fields are marked `required`, because a proto3 encoder drops a `-0.0`, and
//! every value must be read back with the same bits. On the wire they are ordinary proto3 fields.

/// `foxglove.PointCloud`: rows of packed fields, one row per particle.
///
/// Two additional fields, with numbers far from Foxglove's, hold the exact time (the timestamp has
/// whole nanoseconds) and the step.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PointCloud {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub(super) pose: Option<Pose>,
    #[prost(fixed32, tag = "4")]
    pub(super) point_stride: u32,
    #[prost(message, repeated, tag = "5")]
    pub(super) fields: Vec<PackedElementField>,
    #[prost(bytes = "vec", tag = "6")]
    pub(super) data: Vec<u8>,
    #[prost(double, required, tag = "1001")]
    pub(super) simulation_time: f64,
    #[prost(uint64, tag = "1002")]
    pub(super) simulation_step: u64,
}

/// The part of a [`PointCloud`] before its rows, as encoded.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CloudHead {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub(super) pose: Option<Pose>,
    #[prost(fixed32, tag = "4")]
    pub(super) point_stride: u32,
    #[prost(message, repeated, tag = "5")]
    pub(super) fields: Vec<PackedElementField>,
}

/// The part of a [`PointCloud`] after its rows, as encoded.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CloudTail {
    #[prost(double, required, tag = "1001")]
    pub(super) simulation_time: f64,
    #[prost(uint64, tag = "1002")]
    pub(super) simulation_step: u64,
}

/// `foxglove.PackedElementField`: name, byte offset and number type of one field of a row.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PackedElementField {
    #[prost(string, tag = "1")]
    pub(super) name: String,
    #[prost(fixed32, tag = "2")]
    pub(super) offset: u32,
    #[prost(enumeration = "NumericType", tag = "3")]
    pub(super) r#type: i32,
}

/// `foxglove.PackedElementField.NumericType`, complete, because the descriptor lists every value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(super) enum NumericType {
    Unknown = 0,
    Uint8 = 1,
    Int8 = 2,
    Uint16 = 3,
    Int16 = 4,
    Uint32 = 5,
    Int32 = 6,
    Float32 = 7,
    Float64 = 8,
}

/// `foxglove.Vector3`.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(super) struct Vector3 {
    #[prost(double, required, tag = "1")]
    pub(super) x: f64,
    #[prost(double, required, tag = "2")]
    pub(super) y: f64,
    #[prost(double, required, tag = "3")]
    pub(super) z: f64,
}

/// `foxglove.Quaternion`.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(super) struct Quaternion {
    #[prost(double, required, tag = "1")]
    pub(super) x: f64,
    #[prost(double, required, tag = "2")]
    pub(super) y: f64,
    #[prost(double, required, tag = "3")]
    pub(super) z: f64,
    #[prost(double, required, tag = "4")]
    pub(super) w: f64,
}

/// `foxglove.Pose`; our clouds always have the identity.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(super) struct Pose {
    #[prost(message, optional, tag = "1")]
    pub(super) position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub(super) orientation: Option<Quaternion>,
}

impl Pose {
    /// Whether it leaves points unchanged; missing parts do not move points.
    pub(super) fn is_identity(&self) -> bool {
        let still = self.position.is_none_or(|p| p == Vector3::default());
        let turn = self.orientation.map(|q| [q.x, q.y, q.z]);
        still && turn.is_none_or(|axis| axis.iter().all(|x| x.abs() < f64::MIN_POSITIVE))
    }

    /// The identity.
    pub(super) fn identity() -> Self {
        Self { position: Some(Vector3::default()), orientation: Some(Quaternion::identity()) }
    }
}

impl Quaternion {
    /// No rotation.
    pub(super) fn identity() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// `foxglove.FrameTransform`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub(super) rotation: Option<Quaternion>,
}

/// `foxglove.FrameTransforms`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub(super) transforms: Vec<FrameTransform>,
}

/// `foxglove.Log`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Log {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<prost_types::Timestamp>,
    #[prost(enumeration = "Level", tag = "2")]
    pub(super) level: i32,
    #[prost(string, tag = "3")]
    pub(super) message: String,
    #[prost(string, tag = "4")]
    pub(super) name: String,
    #[prost(double, required, tag = "1001")]
    pub(super) simulation_time: f64,
}

/// The level of a log line (`foxglove.Log.Level`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub enum Level {
    /// Unknown.
    Unknown = 0,
    /// For developers.
    Debug = 1,
    /// Progress.
    Info = 2,
    /// A warning: the run continues.
    Warning = 3,
    /// An error.
    Error = 4,
    /// A fatal error: the run ends.
    Fatal = 5,
}

/// `whirls.Scene`: the scene that was run, as TOML, so that the run can be repeated.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Scene {
    #[prost(string, tag = "1")]
    pub(super) toml: String,
}

/// `whirls.TrainStep`: one iteration of learning (topic `/train/step`).
///
/// Every list is empty or has one entry per learned parameter, in the order of
/// [`RunInfo::parameters`](super::RunInfo::parameters).
#[derive(Clone, PartialEq, prost::Message)]
pub struct TrainStep {
    /// The iteration, from 0.
    #[prost(uint64, tag = "1")]
    pub iteration: u64,
    /// The total loss.
    #[prost(double, required, tag = "2")]
    pub loss: f64,
    /// The trajectory part.
    #[prost(double, required, tag = "3")]
    pub loss_trajectory: f64,
    /// The field part.
    #[prost(double, required, tag = "4")]
    pub loss_field: f64,
    /// log₁₀ of the loss (viewers have no logarithmic axis).
    #[prost(double, required, tag = "5")]
    pub log10_loss: f64,
    /// Euclidean norm of the gradient.
    #[prost(double, required, tag = "6")]
    pub gradient_norm: f64,
    /// The optimiser's step scale: a learning rate, or the damping of a Gauss–Newton step.
    #[prost(double, required, tag = "7")]
    pub learning_rate_or_damping: f64,
    /// Number of frames of the truth in the loss.
    #[prost(uint64, tag = "8")]
    pub window: u64,
    /// The parameters at which loss and gradient were evaluated.
    #[prost(double, repeated, tag = "9")]
    pub parameters: Vec<f64>,
    /// Derivative of the loss by each parameter.
    #[prost(double, repeated, tag = "10")]
    pub gradients: Vec<f64>,
    /// The true parameters; empty if they are unknown.
    #[prost(double, repeated, tag = "11")]
    pub truth: Vec<f64>,
    /// log₁₀ of each parameter's relative error; empty if the truth is unknown.
    #[prost(double, repeated, tag = "12")]
    pub log10_error: Vec<f64>,
    /// The part from statistics of velocity increments; zero in recordings older than this field.
    #[prost(double, required, tag = "13")]
    pub loss_kl: f64,
}

impl TrainStep {
    /// Lower bound of the logarithm of an error in [`with_logarithms`](Self::with_logarithms):
    /// below it an `f64` has no digits left, and −∞ could not be plotted. A loss is a sum of
    /// squares, with twice that bound.
    pub const LOG10_FLOOR: f64 = -17.0;

    /// The same step with `log10_loss` and `log10_error` filled in from the loss, the parameters and
    /// the truth: `log₁₀ |θ − θ*| / |θ*|`, or `log₁₀ |θ|` where the truth is zero.
    #[must_use]
    pub fn with_logarithms(mut self) -> Self {
        self.log10_loss = log10(self.loss, 2.0 * Self::LOG10_FLOOR);
        let error = |(found, truth): (&f64, &f64)| {
            let scale = if truth.abs() > 0.0 { *truth } else { 1.0 };
            log10((found - truth) / scale, Self::LOG10_FLOOR)
        };
        self.log10_error = self.parameters.iter().zip(&self.truth).map(error).collect();
        self
    }
}

/// log₁₀ of a magnitude, with a lower bound; NaN stays NaN.
pub(super) fn log10(value: f64, floor: f64) -> f64 {
    if value.is_nan() { value } else { value.abs().log10().max(floor) }
}

/// `whirls.Conservation`: [`crate::statistics::Conservation`], field by field (topic `/diag/conservation`).
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Conservation {
    /// The step, from 0.
    #[prost(uint64, tag = "1")]
    pub step: u64,
    /// Simulation time.
    #[prost(double, required, tag = "2")]
    pub time: f64,
    /// `Σ m |v|² / 2`.
    #[prost(double, required, tag = "3")]
    pub kinetic_energy: f64,
    /// Kinetic and internal energy, `Σ m (|v|²/2 + e(ρ))`.
    #[prost(double, required, tag = "4")]
    pub total_energy: f64,
    /// Largest speed over the speed of sound.
    #[prost(double, required, tag = "5")]
    pub max_mach: f64,
    /// Largest `|ρ/ρ₀ − 1|`.
    #[prost(double, required, tag = "6")]
    pub max_density_deviation: f64,
    /// Linear momentum `Σ m v`.
    #[prost(double, repeated, tag = "7")]
    pub momentum: Vec<f64>,
    /// `Σ m a` of the pressure.
    #[prost(double, repeated, tag = "8")]
    pub momentum_pressure: Vec<f64>,
    /// `Σ m a` of the viscosity.
    #[prost(double, repeated, tag = "9")]
    pub momentum_viscosity: Vec<f64>,
    /// `Σ m a` of the forcing.
    #[prost(double, repeated, tag = "10")]
    pub momentum_forcing: Vec<f64>,
    /// Courant number `dt (c + max |v|) / h`.
    #[prost(double, required, tag = "11")]
    pub courant: f64,
    /// Names of the parts of all terms that accelerate particles.
    #[prost(string, repeated, tag = "12")]
    pub terms: Vec<String>,
    /// `Σ m a` of each part, one vector after another.
    #[prost(double, repeated, tag = "13")]
    pub momentum_terms: Vec<f64>,
}

/// The message of a value with the same fields, and back.
macro_rules! same_fields {
    ($message:ident, $value:path, $($field:ident),*) => {
        impl From<$value> for $message {
            fn from(value: $value) -> Self {
                Self { $($field: value.$field),* }
            }
        }

        impl From<$message> for $value {
            fn from(message: $message) -> Self {
                Self { $($field: message.$field),* }
            }
        }
    };
}

same_fields!(
    Conservation,
    crate::statistics::Conservation,
    step,
    time,
    kinetic_energy,
    total_energy,
    max_mach,
    max_density_deviation,
    momentum,
    momentum_pressure,
    momentum_viscosity,
    momentum_forcing,
    courant,
    terms,
    momentum_terms
);

/// `whirls.Values`: named numbers at one step, such as the errors of several models (on any other
/// topic).
#[derive(Clone, PartialEq, prost::Message)]
pub struct Values {
    /// The step, from 0.
    #[prost(uint64, tag = "1")]
    pub step: u64,
    /// Simulation time.
    #[prost(double, required, tag = "2")]
    pub time: f64,
    /// The names of the numbers: the same in every message of a topic.
    #[prost(string, repeated, tag = "3")]
    pub names: Vec<String>,
    /// The numbers.
    #[prost(double, repeated, tag = "4")]
    pub values: Vec<f64>,
}
