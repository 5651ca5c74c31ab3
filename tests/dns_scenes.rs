//! Direct numerical simulations as scenes: `simulate dns-3d`, what it records, and what it refuses.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::place;

use place::Place;
use whirls::dns::Solver;
use whirls::recording::{Flow, Level};
use whirls::scene::{AnyScene, DnsScene, SHIPPED_DNS};
use whirls::vector::Vector;

/// A simulation of a second, whose tracers a small scene of particles can learn from.
pub(crate) const SMALL_DNS: &str = r#"
name = "small-dns"
kind = "dns"
dimension = 2
seed = 3
box_length = 1.0

[dns]
nodes = 24
viscosity = 0.02
start = { kind = "random-solenoidal", velocity = 1.0, spectrum = { kind = "band", largest = 3 } }
forcing = { kind = "ornstein-uhlenbeck", power = 1.0, correlation_time = 0.05 }
spin_up = [{ nodes = 16, time = 0.02 }, { nodes = 24, time = 0.01 }]

[tracers]
per_side = 10
jitter = 0.002

[time]
interval = 0.004
frames = 6

[record]
every = 2
filtered = { smoothing_length = 0.12, mesh = 8 }
"#;

/// A scene that learns from them: a frame every two steps of 0.004.
const LEARNS: &str = r#"
name = "learns"
dimension = 2

[fluid]
particles_per_side = 10
box_length = 1.0
smoothing_length = 0.12
c = 10.0
alpha = 1.0
beta = 2.0
gamma = 7.0

[time]
dt = 0.004

[learn]
parameters = ["alpha", "beta"]
every = 2
frames = 3
iterations = 2
loss = { field = 1.0 }
"#;

fn with_dns() -> Place {
    let place = Place::new();
    std::fs::write(place.path("dns.toml"), SMALL_DNS).unwrap();
    std::fs::write(place.path("learns.toml"), LEARNS).unwrap();
    place
}

#[test]
fn simulate_records_tracers_accelerations_the_filtered_field_and_statistics() {
    let place = with_dns();
    let report = place.json("simulate", &["dns.toml", "--json", "--record", "dns.mcap"]);
    assert_eq!((&report["nodes"], &report["tracers"]), (&576.into(), &100.into()));
    assert_eq!((&report["frames"], &report["recording"]), (&7.into(), &"dns.mcap".into()));
    let recording = place.recording("dns.mcap");
    assert_eq!(
        recording.cloud_topics(),
        ["/truth/acceleration", "/truth/filtered", "/truth/particles"]
    );
    assert_eq!(recording.frame_count(Flow::Truth), 4);
    let times = recording.frame_times(Flow::Truth);
    assert!((times[3] - times[0] - 6.0 * 0.004).abs() < 1e-9, "{times:?}");
    let (flow, spectrum) =
        (recording.values("/truth/flow").unwrap(), recording.values("/truth/spectrum").unwrap());
    assert_eq!((flow.len(), spectrum.len()), (4, 4));
    for (row, shells) in flow.iter().zip(&spectrum) {
        let at = |name: &str| row.values[row.names.iter().position(|n| n == name).unwrap()];
        assert!((shells.values.iter().sum::<f64>() - at("energy")).abs() < 1e-12);
        let (velocity, dissipation) = (at("velocity"), at("dissipation"));
        assert!((at("energy") - velocity * velocity).abs() < 1e-12, "two components");
        assert!((at("eddy_time") * dissipation - velocity * velocity).abs() < 1e-12);
    }
    assert_eq!(recording.cloud("/truth/filtered", 0).unwrap().positions.len(), 64);
}

#[test]
fn recorded_tracers_are_those_of_the_solver_bit_for_bit() {
    let place = with_dns();
    place.json("simulate", &["dns.toml", "--json", "--record", "dns.mcap"]);
    let recording = place.recording("dns.mcap");
    let scene = DnsScene::parse(SMALL_DNS, "small", &[]).unwrap();
    let mut solver: Solver<2> = scene.developed(&mut |_| {}).unwrap();
    let start = solver.time();
    let rows = |all: &[Vector<f64, 2>]| all.iter().map(|x| x.to_3d()).collect::<Vec<_>>();
    for number in 0..=scene.time.frames {
        solver.advance_to(start + number as f64 * scene.time.interval).unwrap();
        if number % scene.record.every > 0 {
            continue;
        }
        let [positions, velocities, accelerations] = solver.observe();
        let k = (number / scene.record.every) as usize;
        let frame = recording.frame(Flow::Truth, k).unwrap();
        assert!(frame.densities.is_empty());
        assert_eq!(frame.positions, rows(&positions), "frame {k}");
        assert_eq!(frame.velocities, rows(&velocities), "frame {k}");
        let cloud = recording.cloud("/truth/acceleration", k).unwrap();
        let found: Vec<_> = accelerations.iter().map(|a| a[1]).collect();
        assert_eq!(cloud.columns[1].values, found, "frame {k}");
    }
}

#[test]
fn any_number_of_threads_records_the_same_bytes() {
    let place = with_dns();
    let bytes = |threads: &str| {
        let name = format!("{threads}.mcap");
        place.json("simulate", &["dns.toml", "--json", "--threads", threads, "--record", &name]);
        std::fs::read(place.path(&name)).unwrap()
    };
    let one = bytes("1");
    assert!(one == bytes("2") && one == bytes("3"));
}

#[test]
fn a_training_takes_the_tracers_as_its_truth() {
    let place = with_dns();
    place.json("simulate", &["dns.toml", "--json", "--record", "dns.mcap"]);
    let arguments = ["learns.toml", "--truth", "dns.mcap", "--json", "--record", "learned.mcap"];
    let report = place.json("train", &arguments);
    let [first, last] = ["loss_initial", "loss_final"].map(|key| report[key].as_f64().unwrap());
    println!("loss {first:.3e} to {last:.3e}");
    assert!(last < first);
    assert!(report["truth"].as_object().is_none_or(serde_json::Map::is_empty), "{report}");
    let logs = place.recording("learned.mcap").logs().unwrap();
    let doubts =
        logs.iter().filter(|line| line.level == Level::Warning && line.text.contains("scene"));
    assert_eq!(doubts.count(), 0, "{logs:?}");
    place.refuses("evaluate", &["dns.mcap"], &["learned model", "direct numerical simulation"]);
}

/// A truth of the scene [`LEARNS`].
const TRUTH: &str = r#"
[truth]
kind = "dns"
nodes = 24
viscosity = 0.02
start = { kind = "random-solenoidal", velocity = 1.0, spectrum = { kind = "band", largest = 3 } }
spin_up = [{ nodes = 16, time = 0.01 }]
"#;

#[test]
fn a_training_makes_its_truth_by_direct_numerical_simulation() {
    let place = with_dns();
    std::fs::write(place.path("dns-truth.toml"), format!("{LEARNS}{TRUTH}")).unwrap();
    let losses = ["tracers", "filtered"].map(|field| {
        let (set, name) = (format!("learn.field='{field}'"), format!("{field}.mcap"));
        let arguments = ["dns-truth.toml", "--json", "--record", &name, "--set", &set];
        let report = place.json("train", &arguments);
        let [first, last] = ["loss_initial", "loss_final"].map(|key| report[key].as_f64().unwrap());
        println!("{field}: loss {first:.4e} to {last:.4e}");
        assert!(last < first);
        // Nothing is known of the parameters of a law that did not make the truth.
        assert!(report["truth"].as_object().is_none_or(serde_json::Map::is_empty), "{report}");
        first
    });
    assert!(losses[0] > 0.0 && losses[1] > 0.0);
    assert!((losses[0] / losses[1] - 1.0).abs() > 1e-6, "two targets, {losses:?}");
    let small = ["--quick", "--steps", "6", "--every", "3", "--no-record", "--json"];
    let report = place.json("evaluate", &[&["filtered.mcap"], &small[..]].concat());
    assert_eq!(report["realisations"], 2);
    place.refuses(
        "train",
        &["learns.toml", "--set", "learn.field='filtered'"],
        &["learn.field", "kind \"dns\""],
    );
    let wrong = ["dns-truth.toml", "--set", "truth.nodes=4"];
    place.refuses("train", &wrong, &["truth.nodes", "4"]);
    let unresolved = ["dns-truth.toml", "--set", "truth.viscosity=1e-5"];
    place.refuses("train", &unresolved, &["truth.nodes", "k_max"]);
}

#[test]
fn the_start_of_a_simulation_can_be_a_field_in_a_file() {
    use whirls::dns::{Settings, Start};
    let place = with_dns();
    let settings = Settings { length: 1.0, ..Settings::new(16, 0.05) };
    let mut solver = Solver::<2>::new(settings, &Start::TaylorGreen { velocity: 2.0 }).unwrap();
    let field = solver.velocity();
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 16, 16), }".to_owned();
    header.push_str(&" ".repeat(117 - header.len()));
    header.push('\n');
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for axis in [0, 1] {
        for index in 0..256 {
            let (x, y) = (index / 16, index % 16);
            bytes.extend(field[x + 16 * y][axis].to_le_bytes());
        }
    }
    std::fs::write(place.path("u.npy"), bytes).unwrap();
    let file = "dns.start={kind='file',path='u.npy'}";
    let other = "dns.start={kind='taylor-green',velocity=2.0}";
    let energy = |start: &str| {
        let mut arguments = vec!["dns.toml", "--json", "--set", "dns.viscosity=0.05"];
        let others = ["dns.forcing={kind='none'}", "dns.spin_up=[]", "record.every=0", start];
        arguments.extend(others.into_iter().flat_map(|set| ["--set", set]));
        place.json("simulate", &arguments)["energy"].as_f64().unwrap()
    };
    let (from_file, exact) = (energy(file), energy(other));
    assert!((from_file - exact).abs() < 1e-12 * exact, "{from_file} {exact}");
}

#[test]
fn wrong_input_is_refused_with_what_to_do() {
    let place = with_dns();
    let refuse = |set: &str, parts: &[&str]| {
        place.refuses("simulate", &["dns.toml", "--set", set], parts);
    };
    refuse("dns.bogus=1", &["bogus", "expected one of", "viscosity"]);
    refuse("dns.nodes=56", &["dns.nodes", "prime factor"]);
    refuse("dns.viscosity=-1", &["dns.viscosity", "a positive number", "-1"]);
    refuse("dns.start={kind='abc'}", &["dns.start.kind", "three"]);
    refuse("record.filtered.mesh=7", &["record.filtered.mesh", "prime factors"]);
    refuse("dns.forcing={kind='band',power=1,band=99}", &["dns.forcing.band", "99"]);
    refuse("dns.start={kind='taylor-green',velocity=0}", &["dns.start.velocity", "positive"]);
    refuse("tracers.per_side=0", &["tracers.per_side"]);
    refuse("dns.viscosity=1e-5", &["k_max", "more nodes"]);
    refuse("dns.start={kind='file',path='nowhere.npy'}", &["nowhere.npy"]);
    place.refuses("simulate", &["dns.toml", "--steps", "3"], &["time.frames"]);
    place.refuses("simulate", &["dns.toml", "--from", "x.mcap"], &["dns.start"]);
    for command in ["train", "trade"] {
        place.refuses(command, &["dns-2d"], &["simulation", "--truth"]);
        place.refuses(command, &["dns.toml"], &["simulation", "--truth"]);
    }
    place.refuses("simulate", &["dns-4d"], &["dns-2d, dns-3d", "did you mean dns-"]);
}

#[test]
fn shipped_simulations_are_read_written_and_explained() {
    let place = Place::new();
    for (name, _) in SHIPPED_DNS {
        let AnyScene::Dns(scene) = AnyScene::open(name, &[]).unwrap() else {
            panic!("{name} is no simulation")
        };
        assert_eq!(scene.name, name);
        assert_eq!(DnsScene::parse(&scene.to_toml(), "written", &[]).unwrap(), *scene);
        let done = place.run("simulate", &[name, "--explain"]);
        assert_eq!(done.code, Some(0), "{}", done.err);
        assert!(done.out.contains("interpolate_velocity"), "{}", done.out);
    }
}
