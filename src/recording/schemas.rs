//! Descriptors of the messages, written into each recording so that any reader can decode it.
//!
//! They are built in code with `prost-types`, so that no protobuf compiler is needed; a test
//! compares them with encoded messages.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet,
};

/// A message that a topic may carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Schema {
    PointCloud,
    FrameTransforms,
    Log,
    Scene,
    TrainStep,
    Conservation,
    Values,
}

impl Schema {
    /// Full protobuf name.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::PointCloud => "foxglove.PointCloud",
            Self::FrameTransforms => "foxglove.FrameTransforms",
            Self::Log => "foxglove.Log",
            Self::Scene => "whirls.Scene",
            Self::TrainStep => "whirls.TrainStep",
            Self::Conservation => "whirls.Conservation",
            Self::Values => "whirls.Values",
        }
    }

    /// The serialised `FileDescriptorSet` of the message and of everything that it refers to.
    pub(super) fn descriptors(self) -> Vec<u8> {
        let file = match self {
            Self::PointCloud | Self::FrameTransforms | Self::Log => {
                vec![timestamp_file(), foxglove_file(self)]
            }
            Self::Scene | Self::TrainStep | Self::Conservation | Self::Values => {
                vec![whirls_file(self)]
            }
        };
        FileDescriptorSet { file }.encode_to_vec()
    }
}

fn timestamp_file() -> FileDescriptorProto {
    let fields = vec![one("seconds", 1, Type::Int64), one("nanos", 2, Type::Int32)];
    file("google/protobuf/timestamp.proto", "google.protobuf", vec![message("Timestamp", fields)])
}

fn foxglove_file(schema: Schema) -> FileDescriptorProto {
    let (path, messages) = match schema {
        Schema::PointCloud => ("foxglove/PointCloud.proto", cloud_messages()),
        Schema::FrameTransforms => ("foxglove/FrameTransforms.proto", transform_messages()),
        _ => ("foxglove/Log.proto", vec![log_message()]),
    };
    let mut file = file(path, "foxglove", messages);
    file.dependency.push("google/protobuf/timestamp.proto".into());
    file
}

fn packed_element_field() -> DescriptorProto {
    let mut packed = message(
        "PackedElementField",
        vec![
            one("name", 1, Type::String),
            one("offset", 2, Type::Fixed32),
            of(one("type", 3, Type::Enum), ".foxglove.PackedElementField.NumericType"),
        ],
    );
    packed.enum_type.push(values(
        "NumericType",
        &["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"],
    ));
    packed
}

fn cloud_messages() -> Vec<DescriptorProto> {
    let cloud = vec![
        time_stamp(1),
        one("frame_id", 2, Type::String),
        of(one("pose", 3, Type::Message), ".foxglove.Pose"),
        one("point_stride", 4, Type::Fixed32),
        of(many("fields", 5, Type::Message), ".foxglove.PackedElementField"),
        one("data", 6, Type::Bytes),
        one("simulation_time", 1001, Type::Double),
        one("simulation_step", 1002, Type::Uint64),
    ];
    let pose = vec![
        of(one("position", 1, Type::Message), ".foxglove.Vector3"),
        of(one("orientation", 2, Type::Message), ".foxglove.Quaternion"),
    ];
    vec![
        message("PointCloud", cloud),
        packed_element_field(),
        message("Pose", pose),
        vector3(),
        quaternion(),
    ]
}

fn transform_messages() -> Vec<DescriptorProto> {
    let transform = vec![
        time_stamp(1),
        one("parent_frame_id", 2, Type::String),
        one("child_frame_id", 3, Type::String),
        of(one("translation", 4, Type::Message), ".foxglove.Vector3"),
        of(one("rotation", 5, Type::Message), ".foxglove.Quaternion"),
    ];
    let transforms = of(many("transforms", 1, Type::Message), ".foxglove.FrameTransform");
    vec![
        message("FrameTransforms", vec![transforms]),
        message("FrameTransform", transform),
        vector3(),
        quaternion(),
    ]
}

fn log_message() -> DescriptorProto {
    let fields = vec![
        time_stamp(1),
        of(one("level", 2, Type::Enum), ".foxglove.Log.Level"),
        one("message", 3, Type::String),
        one("name", 4, Type::String),
        one("file", 5, Type::String),
        one("line", 6, Type::Fixed32),
        one("simulation_time", 1001, Type::Double),
    ];
    let mut log = message("Log", fields);
    let levels = ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"];
    log.enum_type.push(values("Level", &levels));
    log
}

fn whirls_file(schema: Schema) -> FileDescriptorProto {
    let (path, message) = match schema {
        Schema::TrainStep => ("whirls/TrainStep.proto", train_step()),
        Schema::Conservation => ("whirls/Conservation.proto", conservation()),
        Schema::Values => ("whirls/Values.proto", named_values()),
        _ => ("whirls/Scene.proto", message("Scene", vec![one("toml", 1, Type::String)])),
    };
    file(path, "whirls", vec![message])
}

fn train_step() -> DescriptorProto {
    let fields = vec![
        one("iteration", 1, Type::Uint64),
        one("loss", 2, Type::Double),
        one("loss_trajectory", 3, Type::Double),
        one("loss_field", 4, Type::Double),
        one("log10_loss", 5, Type::Double),
        one("gradient_norm", 6, Type::Double),
        one("learning_rate_or_damping", 7, Type::Double),
        one("window", 8, Type::Uint64),
        many("parameters", 9, Type::Double),
        many("gradients", 10, Type::Double),
        many("truth", 11, Type::Double),
        many("log10_error", 12, Type::Double),
        one("loss_kl", 13, Type::Double),
    ];
    message("TrainStep", fields)
}

fn conservation() -> DescriptorProto {
    let fields = vec![
        one("step", 1, Type::Uint64),
        one("time", 2, Type::Double),
        one("kinetic_energy", 3, Type::Double),
        one("total_energy", 4, Type::Double),
        one("max_mach", 5, Type::Double),
        one("max_density_deviation", 6, Type::Double),
        many("momentum", 7, Type::Double),
        many("momentum_pressure", 8, Type::Double),
        many("momentum_viscosity", 9, Type::Double),
        many("momentum_forcing", 10, Type::Double),
        one("courant", 11, Type::Double),
        many("terms", 12, Type::String),
        many("momentum_terms", 13, Type::Double),
    ];
    message("Conservation", fields)
}

fn named_values() -> DescriptorProto {
    let fields = vec![
        one("step", 1, Type::Uint64),
        one("time", 2, Type::Double),
        many("names", 3, Type::String),
        many("values", 4, Type::Double),
    ];
    message("Values", fields)
}

fn vector3() -> DescriptorProto {
    message("Vector3", ["x", "y", "z"].into_iter().zip(1..).map(double).collect())
}

fn quaternion() -> DescriptorProto {
    message("Quaternion", ["x", "y", "z", "w"].into_iter().zip(1..).map(double).collect())
}

fn double((name, number): (&str, i32)) -> FieldDescriptorProto {
    one(name, number, Type::Double)
}

fn time_stamp(number: i32) -> FieldDescriptorProto {
    of(one("timestamp", number, Type::Message), ".google.protobuf.Timestamp")
}

fn file(path: &str, package: &str, messages: Vec<DescriptorProto>) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(path.into()),
        package: Some(package.into()),
        message_type: messages,
        syntax: Some("proto3".into()),
        ..Default::default()
    }
}

fn message(name: &str, fields: Vec<FieldDescriptorProto>) -> DescriptorProto {
    DescriptorProto { name: Some(name.into()), field: fields, ..Default::default() }
}

fn values(name: &str, names: &[&str]) -> EnumDescriptorProto {
    let value = |(number, name): (i32, &&str)| EnumValueDescriptorProto {
        name: Some((*name).into()),
        number: Some(number),
        options: None,
    };
    EnumDescriptorProto {
        name: Some(name.into()),
        value: (0..).zip(names).map(value).collect(),
        ..Default::default()
    }
}

fn one(name: &str, number: i32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..Default::default()
    }
}

fn many(name: &str, number: i32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto { label: Some(Label::Repeated.into()), ..one(name, number, kind) }
}

fn of(field: FieldDescriptorProto, type_name: &str) -> FieldDescriptorProto {
    FieldDescriptorProto { type_name: Some(type_name.into()), ..field }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::messages;

    /// Field numbers and wire types found in an encoded message, in order of appearance.
    fn tags(mut bytes: &[u8]) -> Vec<(u32, prost::encoding::WireType)> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let (number, wire) = prost::encoding::decode_key(&mut bytes).unwrap();
            let context = prost::encoding::DecodeContext::default();
            prost::encoding::skip_field(wire, number, &mut bytes, context).unwrap();
            found.push((number, wire));
        }
        found
    }

    fn assert_described(schema: Schema, encoded: &[u8], missing: &[&str]) {
        use prost::encoding::WireType as Wire;
        let set = FileDescriptorSet::decode(&*schema.descriptors()).unwrap();
        let short = schema.name().split('.').next_back();
        let described = (set.file.iter().flat_map(|file| &file.message_type))
            .find(|message| message.name.as_deref() == short)
            .unwrap();
        let expected: Vec<_> = (described.field.iter())
            .filter(|field| !missing.contains(&field.name()))
            .map(|field| {
                let wire = match field.r#type() {
                    _ if field.label() == Label::Repeated => Wire::LengthDelimited,
                    Type::Double => Wire::SixtyFourBit,
                    Type::Fixed32 => Wire::ThirtyTwoBit,
                    Type::Uint64 | Type::Enum => Wire::Varint,
                    _ => Wire::LengthDelimited,
                };
                (field.number().unsigned_abs(), wire)
            })
            .collect();
        assert_eq!(tags(encoded), expected, "{}", schema.name());
    }

    #[test]
    fn descriptors_describe_the_messages() {
        let one = vec![1.0];
        let step = messages::TrainStep {
            iteration: 1,
            window: 1,
            parameters: one.clone(),
            gradients: one.clone(),
            truth: one.clone(),
            log10_error: one.clone(),
            ..Default::default()
        };
        assert_described(Schema::TrainStep, &step.encode_to_vec(), &[]);
        let kept = messages::Conservation {
            step: 1,
            momentum: one.clone(),
            momentum_pressure: one.clone(),
            momentum_viscosity: one.clone(),
            momentum_forcing: one.clone(),
            terms: vec!["t".into()],
            momentum_terms: one,
            ..Default::default()
        };
        assert_described(Schema::Conservation, &kept.encode_to_vec(), &[]);
        let (names, values) = (vec!["n".into()], vec![1.0]);
        let values = messages::Values { step: 1, time: 0.0, names, values };
        assert_described(Schema::Values, &values.encode_to_vec(), &[]);
        let scene = messages::Scene { toml: "x".into() };
        assert_described(Schema::Scene, &scene.encode_to_vec(), &[]);
        let log = messages::Log {
            timestamp: Some(Default::default()),
            level: 1,
            message: "m".into(),
            name: "n".into(),
            simulation_time: 0.0,
        };
        assert_described(Schema::Log, &log.encode_to_vec(), &["file", "line"]);
        let cloud = messages::PointCloud {
            timestamp: Some(Default::default()),
            frame_id: "world".into(),
            pose: Some(messages::Pose::identity()),
            point_stride: 1,
            fields: vec![Default::default()],
            data: vec![0],
            simulation_time: 0.0,
            simulation_step: 1,
        };
        assert_described(Schema::PointCloud, &cloud.encode_to_vec(), &[]);
    }
}
