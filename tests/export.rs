//! `export`: what other programs read is what the recording holds, to the bit.

#![allow(clippy::print_stdout, reason = "a test shows what it measured")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use place::Place;
use serde_json::Value;
use std::io::Read as _;
use whirls::recording::{Flow, Frame, Recording};

/// A place with a training's recording.
fn trained() -> (Place, Recording) {
    let place = Place::new();
    let train = [
        "small.toml",
        "--record",
        "run.mcap",
        "--set",
        "learn.iterations=2",
        "--json",
        "--set",
        "learn.frames=2",
    ];
    place.json("train", &train);
    let recording = place.recording("run.mcap");
    (place, recording)
}

fn frames(recording: &Recording, flow: Flow) -> Vec<Frame> {
    (0..recording.frame_count(flow)).map(|k| recording.frame(flow, k).unwrap()).collect()
}

/// A .vtp file: its header as XML, and the bytes after the underscore.
struct Vtp {
    head: String,
    bytes: Vec<u8>,
}

impl Vtp {
    fn open(place: &Place, name: &str) -> Self {
        let bytes = std::fs::read(place.path(name)).unwrap();
        let mark = b"<AppendedData encoding=\"raw\">\n_";
        let at = bytes.windows(mark.len()).position(|part| part == mark).unwrap();
        let head = String::from_utf8(bytes[..at].to_vec()).unwrap() + "</VTKFile>";
        let end = b"\n  </AppendedData>\n</VTKFile>\n";
        assert!(bytes.ends_with(end));
        Self { head, bytes: bytes[at + mark.len()..bytes.len() - end.len()].to_vec() }
    }

    /// The eight-byte words of an array.
    fn words(&self, name: &str) -> Vec<[u8; 8]> {
        let document = roxmltree::Document::parse(&self.head).unwrap();
        let mut found = document.descendants().filter(|node| node.attribute("Name") == Some(name));
        let array = found.next().unwrap();
        assert!(found.next().is_none(), "{name} stands twice");
        let at: usize = array.attribute("offset").unwrap().parse().unwrap();
        let length = u64::from_le_bytes(self.bytes[at..at + 8].try_into().unwrap()) as usize;
        self.bytes[at + 8..at + 8 + length].as_chunks().0.to_vec()
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.words(name).into_iter().map(f64::from_le_bytes).collect()
    }
}

#[test]
fn paraview_gets_points_and_times_once_and_every_bit() {
    let (place, recording) = trained();
    let export =
        ["run.mcap", "--out", "para.pvd", "--topic", "/truth/particles", "--every", "2", "--json"];
    let report = place.json("export", &export);
    let truth = frames(&recording, Flow::Truth);
    assert_eq!(report["frames"], truth.len().div_ceil(2));
    let text = std::fs::read_to_string(place.path("para.pvd")).unwrap();
    let document = roxmltree::Document::parse(&text).unwrap();
    let sets: Vec<_> = document.descendants().filter(|node| node.has_tag_name("DataSet")).collect();
    assert_eq!(sets.len(), truth.len().div_ceil(2));
    for (set, frame) in sets.iter().zip(truth.iter().step_by(2)) {
        let time: f64 = set.attribute("timestep").unwrap().parse().unwrap();
        assert_eq!(time.to_bits(), frame.time.to_bits());
        let vtp = Vtp::open(&place, set.attribute("file").unwrap());
        assert!(vtp.numbers("Points") == frame.positions.concat());
        assert!(vtp.numbers("velocity") == frame.velocities.concat());
        assert!(vtp.numbers("density") == frame.densities);
        let count = frame.positions.len() as i64;
        let whole =
            |name| -> Vec<i64> { vtp.words(name).into_iter().map(i64::from_le_bytes).collect() };
        assert_eq!(whole("id"), (0..count).collect::<Vec<_>>());
        assert_eq!(whole("offsets"), (1..=count).collect::<Vec<_>>());
        assert!(!vtp.head.contains("TimeValue"), "times stand in the .pvd");
    }
}

/// An array of an archive, with its shape.
fn npz(place: &Place, name: &str, array: &str) -> (Vec<u64>, Vec<f64>) {
    let file = std::fs::File::open(place.path(name)).unwrap();
    let mut archive = zip::ZipArchive::new(file).unwrap();
    let mut bytes = Vec::new();
    archive.by_name(&format!("{array}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
    let array = npyz::NpyFile::new(&bytes[..]).unwrap();
    (array.shape().to_vec(), array.into_vec().unwrap())
}

#[test]
fn numpy_gets_whole_arrays_of_each_flow() {
    let (place, recording) = trained();
    let report = place.json("export", &["run.mcap", "--to", "npz", "--json"]);
    assert_eq!(report["files"], serde_json::json!(["run-learned.npz", "run-truth.npz"]));
    for (flow, name) in [(Flow::Truth, "run-truth.npz"), (Flow::Learned, "run-learned.npz")] {
        let frames = frames(&recording, flow);
        let (count, particles) = (frames.len() as u64, frames[0].positions.len() as u64);
        let all = |of: fn(&Frame) -> &Vec<[f64; 3]>| -> Vec<f64> {
            frames.iter().flat_map(of).flatten().copied().collect()
        };
        let shape = vec![count, particles, 3];
        assert!(npz(&place, name, "positions") == (shape.clone(), all(|frame| &frame.positions)));
        assert!(npz(&place, name, "velocities") == (shape, all(|frame| &frame.velocities)));
        let densities = frames.iter().flat_map(|frame| frame.densities.clone()).collect();
        assert!(npz(&place, name, "densities") == (vec![count, particles], densities));
        let times = frames.iter().map(|frame| frame.time).collect();
        assert_eq!(npz(&place, name, "time"), (vec![count], times));
        assert_eq!(npz(&place, name, "box").1, [recording.run().box_length; 3]);
    }
}

#[test]
fn a_long_table_reads_back_to_the_bit_and_can_be_imported() {
    let (place, recording) = trained();
    let export = ["run.mcap", "--out", "flow.csv", "--topic", "/truth/particles", "--json"];
    place.json("export", &export);
    let frames = frames(&recording, Flow::Truth);
    let mut reader = csv::Reader::from_path(place.path("flow.csv")).unwrap();
    let head: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    assert_eq!(head.join(","), "track,frame,time,x,y,z,vx,vy,vz,rho");
    let mut rows = reader.records();
    for (k, frame) in frames.iter().enumerate() {
        for i in 0..frame.positions.len() {
            let row = rows.next().unwrap().unwrap();
            let numbers: Vec<f64> = row.iter().map(|field| field.parse().unwrap()).collect();
            let wanted = [
                &[i as f64, k as f64, frame.time],
                &frame.positions[i][..],
                &frame.velocities[i],
                &[frame.densities[i]],
            ]
            .concat();
            assert_eq!(numbers, wanted);
        }
    }
    assert!(rows.next().is_none());
    let report = place.json("import", &["flow.csv", "--out", "again.mcap", "--json"]);
    let again = place.recording("again.mcap");
    for (k, frame) in frames.iter().enumerate() {
        let found = again.frame(Flow::Truth, k).unwrap();
        assert!(
            found.positions == frame.positions && found.velocities == frame.velocities,
            "frame {k}"
        );
    }
    let dt = frames[1].time - frames[0].time;
    assert!((report["dt"].as_f64().unwrap() / dt - 1.0).abs() < 1e-12);
}

#[test]
fn what_was_learned_reads_back_as_json_and_as_a_table() {
    let (place, recording) = trained();
    let report = place.json("export", &["run.mcap", "--out", "learned.json", "--json"]);
    place.json("export", &["run.mcap", "--to", "learned", "--out", "learned.csv", "--json"]);
    let steps = recording.train_steps().unwrap();
    assert_eq!(report["iterations"], steps.len());
    let text = std::fs::read_to_string(place.path("learned.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let names = &recording.run().parameters;
    assert_eq!(json["parameters"], serde_json::json!(names));
    let mut table = csv::Reader::from_path(place.path("learned.csv")).unwrap();
    let head = table.headers().unwrap().clone();
    for (step, row) in steps.iter().zip(table.records()) {
        let row = row.unwrap();
        let number = |name: &str| -> f64 {
            row[head.iter().position(|found| found == name).unwrap()].parse().unwrap()
        };
        let found = &json["iterations"][step.iteration as usize];
        assert_eq!(number("loss").to_bits(), step.loss.to_bits());
        assert_eq!(found["loss"].as_f64().unwrap().to_bits(), step.loss.to_bits());
        for (name, value) in names.iter().zip(&step.parameters) {
            assert_eq!(number(name).to_bits(), value.to_bits());
            assert_eq!(found["parameters"][name].as_f64().unwrap().to_bits(), value.to_bits());
        }
    }
    let last = &steps.last().unwrap().parameters;
    assert_eq!(json["learned"][&names[0]].as_f64().unwrap().to_bits(), last[0].to_bits());
}

#[cfg(feature = "hdf5")]
#[test]
fn lagrangebench_files_are_read_back_as_the_same_flow() {
    let (place, recording) = trained();
    let export = ["run.mcap", "--out", "lb/train.h5", "--topic", "/truth/particles", "--json"];
    place.json("export", &export);
    let text = std::fs::read_to_string(place.path("lb/metadata.json")).unwrap();
    let metadata: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(metadata["dim"], 3);
    assert_eq!(metadata["bounds"][0][1].as_f64(), Some(recording.run().box_length));
    let import = ["lb/train.h5", "--velocities", "derive", "--out", "again.mcap", "--json"];
    place.json("import", &import);
    let again = place.recording("again.mcap");
    assert_eq!(again.run().box_length.to_bits(), recording.run().box_length.to_bits());
    for (k, frame) in frames(&recording, Flow::Truth).iter().enumerate() {
        let found = again.frame(Flow::Truth, k).unwrap();
        for (a, b) in found.positions.iter().flatten().zip(frame.positions.iter().flatten()) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }
    // Mean displacement over a frame: that of the momentum, zero to the accuracy of the forcing.
    let spread = metadata["vel_std"][0].as_f64().unwrap();
    let interval = metadata["dt"].as_f64().unwrap();
    let all = frames(&recording, Flow::Truth);
    let square: f64 = all.iter().flat_map(|frame| &frame.velocities).map(|v| v[0] * v[0]).sum();
    let speed = (square / (all.len() * all[0].velocities.len()) as f64).sqrt();
    assert!((spread / interval / speed - 1.0).abs() < 0.05, "{spread} {interval} {speed}");
}

#[test]
fn exports_replace_nothing_and_say_what_can_be_had() {
    let (place, _) = trained();
    place.json(
        "export",
        &["run.mcap", "--out", "flow.csv", "--topic", "/truth/particles", "--json"],
    );
    let again = ["run.mcap", "--out", "flow.csv", "--topic", "/truth/particles"];
    place.refuses("export", &again, &["flow.csv", "a new name", "--overwrite"]);
    place.json("export", &[&again[..], &["--overwrite", "--json"]].concat());
    let other = ["run.mcap", "--out", "x.csv", "--topic", "/nothing"];
    place.refuses("export", &other, &["/nothing", "/truth/particles", "/learned/particles"]);
    place.refuses("export", &["run.mcap", "--out", "x.xls"], &["x.xls", "vtp (.pvd)", "--to"]);
    place.refuses("export", &["run.mcap", "--to", "csv", "--every", "0"], &["--every"]);
    place.refuses(
        "export",
        &["run.mcap", "--to", "csv", "--out", "run.mcap", "--overwrite"],
        &["input"],
    );
    place.json("simulate", &["small.toml", "--record", "flow.mcap", "--json"]);
    let nothing = ["flow.mcap", "--out", "x.json"];
    place.refuses("export", &nothing, &["a recording of `train`", "`simulate`"]);
    place.refuses("export", &["small.toml", "--to", "csv"], &["small.toml"]);
}
