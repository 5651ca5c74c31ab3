//! What a new user does after the demo: advice, a learned law in another scene, whether a flow is turbulent, one program.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::place;

use place::Place;
use serde_json::Value;
use std::f64::consts::TAU;
use whirls::flow::State;
use whirls::recording::Flow as Topic;
use whirls::scene::Law;
use whirls::statistics::Turbulence;
use whirls::vector::Vector;
use whirls::viscosity::effective_nu;
use whirls::{Flow, Scene};

/// `−⟨u·a⟩/(k²⟨u²⟩)` of a shear wave of one wavelength, `a` that part of the acceleration which `α` makes, over all
/// axes, in the arrangement that the particles of a scene have taken after some steps.
fn measured_share<const D: usize>(scene: &Scene, steps: usize) -> f64 {
    let mut flow = Flow::<D>::new(scene).unwrap();
    (0..steps).for_each(|_| flow.step().unwrap());
    let positions = flow.state().positions;
    let (mut power, mut squares) = (0.0, 0.0);
    for (along, across) in (0..D).flat_map(|a| (0..D).map(move |b| (a, b))).filter(|(a, b)| a != b)
    {
        let wave = |r: &Vector<f64, D>| {
            let mut v = Vector::zero();
            v[across] = (TAU * r[along] / scene.fluid.box_length).sin();
            v
        };
        let velocities: Vec<Vector<f64, D>> = positions.iter().map(wave).collect();
        let state = State { time: 0.0, positions: positions.clone(), velocities };
        let accelerations = |alpha: f64| {
            let mut own = scene.clone();
            (own.fluid.alpha, own.fluid.beta, own.forcing) =
                (alpha, 0.0, whirls::scene::Forcing::None);
            let mut flow = Flow::<D>::from_state(&own, &state).unwrap();
            flow.start().unwrap();
            flow.accelerations()
        };
        let (with, without) = (accelerations(1.0), accelerations(0.0));
        for ((v, a), b) in state.velocities.iter().zip(&with).zip(&without) {
            power -= v.dot(*a - *b);
            squares += v.norm_squared();
        }
    }
    let k = TAU / scene.fluid.box_length;
    power / (k * k * squares) / (scene.fluid.c * scene.fluid.smoothing_length)
}

#[test]
fn alpha_acts_on_a_shear_wave_with_the_viscosity_of_the_table() {
    let cases = [
        ("inverse-3d", 0.853, 10, 30),
        ("inverse-3d", 1.2, 10, 20),
        ("inverse-2d", 1.02, 24, 40),
        ("inverse-2d", 1.3, 24, 40),
    ];
    for (name, ratio, side, steps) in cases {
        let keys =
            [format!("fluid.particles_per_side={side}"), format!("fluid.h_over_spacing={ratio}")];
        let scene = Scene::open(name, &keys).unwrap();
        let found = match scene.dimension {
            2 => measured_share::<2>(&scene, steps),
            _ => measured_share::<3>(&scene, steps),
        };
        let table = effective_nu(scene.dimension, ratio, 1.0);
        println!("{}D, h/spacing {ratio}: measured {found:.4}, table {table:.4}", scene.dimension);
        assert!((found / table - 1.0).abs() < 0.1, "{found} against {table}");
    }
}

/// A Taylor–Green vortex has one wavelength, `|k| = √2` of the box: `u' = U/2`, `λ = L_int = √2` where the box is `2π`.
#[test]
fn the_scales_of_taylor_green_vortices_are_those_of_theory() {
    let text = "name = 'vortices'\ndimension = 2\n[fluid]\nparticles_per_side = 24\nh_over_spacing = 1.3\nc = 10.0\n\
                alpha = 0.0\nbeta = 0.0\ngamma = 7.0\nviscosity = { kind = 'morris', nu = 0.02 }\n\
                [initial]\nvelocity = 0.8\njitter = 0.0\nfield = 'taylor-green'\n[time]\n";
    let scene = Scene::parse(text, "vortices", &[]).unwrap();
    let mut flow = Flow::<2>::new(&scene).unwrap();
    flow.start().unwrap();
    let found = Turbulence::of(&scene, &mut flow).unwrap();
    println!("{found}: {}", found.verdict());
    // The kernel smooths the field over h, so that its amplitude is less; the ratios are exact.
    assert!((0.85..1.0).contains(&(found.u_rms / 0.4)), "{found}");
    for scale in [found.taylor_scale, found.integral_scale] {
        assert!((scale / 2.0_f64.sqrt() - 1.0).abs() < 1e-3, "{found}");
    }
    let epsilon = 2.0 * 0.02 * 2.0 * found.u_rms * found.u_rms;
    assert!((found.dissipation.unwrap() / epsilon - 1.0).abs() < 1e-3, "{found}");
    let re = found.u_rms * found.taylor_scale / 0.02;
    assert!((found.re_lambda.unwrap() / re - 1.0).abs() < 1e-12);
    assert!((found.mach - 0.8 / 2.0_f64.sqrt() / 10.0).abs() < 1e-3, "{found}");
}

#[test]
fn simulate_says_whether_the_flow_is_turbulent_and_so_does_its_recording() {
    let place = Place::new();
    let report = place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let found = &report["turbulence"];
    for key in [
        "u_rms",
        "resolved",
        "mach",
        "taylor_scale",
        "integral_scale",
        "eddy_time",
        "dissipation",
        "re_lambda",
        "eta_over_spacing",
    ] {
        assert!(found[key].as_f64().unwrap() > 0.0, "{key}: {found}");
    }
    let known_by = found["viscosity"]["known_by"].as_str().unwrap();
    assert!(known_by.contains("alpha"), "{known_by}");
    let log = place.recording("flow.mcap").logs().unwrap();
    let said = &log.last().unwrap().text;
    assert!(said.contains("Re_lambda") && said.contains("not turbulence"), "{said}");
    // Without any viscosity there is no Reynolds number, and at rest no scale.
    let ideal = ["small.toml", "--json", "--set", "record.every=0", "--set", "fluid.alpha=0"];
    let found = &place.json("simulate", &ideal)["turbulence"];
    assert!(found.get("re_lambda").is_none() && found["u_rms"].is_number(), "{found}");
    let still =
        [&ideal[..], &["--set", "initial.velocity=0", "--set", "forcing.theta=0", "--steps", "0"]]
            .concat();
    assert!(place.json("simulate", &still).get("turbulence").is_none());
}

/// A scene whose model is a small network, learned for two iterations.
fn learned_network(place: &Place) -> &'static str {
    let options = [
        "small.toml",
        "--json",
        "--record",
        "learned.mcap",
        "--set",
        "learn.model={kind='eos-nn',height=3}",
    ];
    let more = [
        "--set",
        "learn.parameters=['alpha']",
        "--set",
        "learn.iterations=2",
        "--set",
        "learn.windows=[]",
    ];
    place.json("train", &[&options[..], &more[..]].concat());
    "learned.mcap"
}

#[test]
fn a_learned_law_moves_particles_as_in_its_training() {
    let place = Place::new();
    let learned = learned_network(&place);
    // The first frame that was learned from, as a start; then as many steps.
    let options = [
        "small.toml",
        "--law",
        learned,
        "--from",
        learned,
        "--frame",
        "0",
        "--steps",
        "4",
        "--record",
        "again.mcap",
        "--json",
    ];
    let report = place.json("simulate", &options);
    assert_eq!(report["law"], Value::from("small"));
    let (first, again) = (place.recording(learned), place.recording("again.mcap"));
    let [then, now] =
        [first.frame(Topic::Learned, 4).unwrap(), again.frame(Topic::Truth, 4).unwrap()];
    assert_eq!(then.positions, now.positions);
    assert_eq!(then.velocities, now.velocities);
}

#[test]
fn an_exported_law_is_read_back_bit_for_bit_and_scenes_name_it() {
    let place = Place::new();
    let learned = learned_network(&place);
    let report = place.json("export-law", &[learned, "--out", "eos.toml", "--json"]);
    assert_eq!(report["weights"], Value::from(22));
    place.refuses("export-law", &[learned, "--out", "eos.toml"], &["eos.toml", "--overwrite"]);
    let law = Law::open(&place.path("eos.toml")).unwrap();
    assert_eq!(Law::parse(&law.to_toml(), "again").unwrap(), law);
    let last = place.recording(learned).train_steps().unwrap().pop().unwrap();
    let weights: Vec<u64> = last.parameters[1..].iter().map(|x| x.to_bits()).collect();
    assert_eq!(law.weights.iter().map(|x| x.to_bits()).collect::<Vec<_>>(), weights);
    assert_eq!(law.parameters["alpha"].to_bits(), last.parameters[0].to_bits());
    assert_eq!((law.learned.loss.to_bits(), law.learned.steps), (last.loss.to_bits(), 4));

    // Another scene: more particles, another width and step, no constants of its own; the path is relative to it.
    std::fs::create_dir(place.path("scenes")).unwrap();
    let scene = "name = 'other'\ndimension = 3\nlaw = '../eos.toml'\n[fluid]\nparticles_per_side = 9\n\
                 h_over_spacing = 1.0\n[time]\nsteps = 3\n[forcing]\nkind = 'none'\n";
    std::fs::write(place.path("scenes/other.toml"), scene).unwrap();
    let run = place.run("simulate", &["scenes/other.toml", "--record", "other.mcap"]);
    assert_eq!(run.code, Some(0), "{}", run.err);
    for said in ["h/spacing 0.853, and runs at 1.000", "was learned at h 0.67", "steps of 0.0268"] {
        assert!(run.err.contains(said), "no `{said}` in {}", run.err);
    }
    assert!(run.out.contains("law small (eos-nn)"), "{}", run.out);
    // The recording holds the law, and can be run again without the file.
    let recording = place.recording("other.mcap");
    let kept = Scene::parse(&recording.run().scene_toml, "recorded", &[]).unwrap();
    assert_eq!(**kept.law.as_ref().unwrap(), law);
    assert_eq!(kept.fluid.c.to_bits(), law.constants.c.to_bits());
}

#[test]
fn a_law_that_does_not_fit_is_refused_with_what_to_do() {
    let place = Place::new();
    let learned = learned_network(&place);
    place.refuses(
        "simulate",
        &["inverse-2d", "--law", learned],
        &["2 dimensions", "choose a scene"],
    );
    let owned = ["small.toml", "--law", learned, "--set", "fluid.alpha=2"];
    place.refuses("simulate", &owned, &["fluid.alpha", "the file of the law"]);
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap", "--steps", "1"]);
    place.refuses("simulate", &["small.toml", "--law", "flow.mcap"], &["no iteration"]);
    place.refuses("simulate", &["small.toml", "--law", "small.toml"], &["export-law"]);
    let mut law = Law::open(&{
        place.json("export-law", &[learned, "--out", "eos.toml", "--json"]);
        place.path("eos.toml")
    })
    .unwrap();
    law.weights.pop();
    std::fs::write(place.path("short.toml"), law.to_toml()).unwrap();
    place.refuses("simulate", &["small.toml", "--law", "short.toml"], &["22 weights", "found 21"]);
}

#[test]
fn advice_is_a_scene_that_runs_with_each_number_and_its_reason() {
    let place = Place::new();
    let ask = [
        "--dimension",
        "2",
        "--reynolds",
        "20",
        "--particles",
        "150",
        "--h-over-spacing",
        "1.3",
        "--write",
        "mine.toml",
    ];
    let advice = place.json("advise", &[&ask[..], &["--json"]].concat());
    let scene = Scene::open(place.path("mine.toml").to_str().unwrap(), &[]).unwrap();
    assert_eq!(scene.particles(), 144);
    let items = advice["items"].as_array().unwrap();
    let number = |name: &str| {
        let item = items.iter().find(|item| item["name"] == name).unwrap();
        assert!(
            !item["reason"].as_str().unwrap().is_empty()
                && !item["source"].as_str().unwrap().is_empty()
        );
        item["number"].as_f64().unwrap()
    };
    assert_eq!(number("time.dt").to_bits(), scene.dt().to_bits());
    assert_eq!(number("fluid.c").to_bits(), scene.fluid.c.to_bits());
    assert_eq!(number("fluid.viscosity.nu").to_bits(), 0.05_f64.to_bits());
    assert_eq!(number("time.steps") as u64, scene.time.steps);
    assert!(number("memory") > 1e4 && number("time") > 0.0);
    let dt: Vec<f64> =
        advice["limits"].as_array().unwrap().iter().map(|l| l["dt"].as_f64().unwrap()).collect();
    assert!(dt.is_sorted() && dt[0] >= scene.dt() && dt.len() == 3, "{dt:?}");
    place.refuses("advise", &ask, &["mine.toml", "--overwrite"]);
    place.json("simulate", &["mine.toml", "--json", "--steps", "2", "--record", "mine.mcap"]);
}

#[test]
fn advice_names_the_limit_that_binds_and_what_cannot_be_had() {
    let place = Place::new();
    let binding = |more: &[&str]| {
        let ask = ["--json", "--no-measure", "--particles", "4096"];
        let advice = place.json("advise", &[&ask[..], more].concat());
        (advice["limits"][0]["name"].as_str().unwrap().to_owned(), advice)
    };
    assert_eq!(binding(&["--reynolds", "50"]).0, "Courant");
    assert_eq!(binding(&["--nu", "4"]).0, "viscous");
    assert_eq!(binding(&["--nu", "0.1", "--c", "0.5"]).0, "acceleration");
    let all = |advice: &Value| advice["warnings"].to_string();
    let (_, fast) = binding(&["--reynolds", "1e5"]);
    assert!(
        all(&fast).contains("too high for the spacing") && all(&fast).contains("particles a side")
    );
    let (_, loud) = binding(&["--nu", "1", "--mach", "0.6"]);
    assert!(all(&loud).contains("Mach number 0.60"), "{loud}");
    let (_, calm) = binding(&["--nu", "1"]);
    assert_eq!(all(&calm), "[]");
    let huge = place.json("advise", &["--json", "--no-measure", "--particles", "60000000"]);
    assert!(huge["price"]["bytes"].as_f64().unwrap() > 1e10);
    place.refuses("advise", &["--particles", "27"], &["particles along each axis"]);
}

#[test]
fn one_program_has_every_command_and_understands_misspelt_names() {
    let place = Place::new();
    let own =
        place.json("simulate", &["small.toml", "--json", "--steps", "2", "--record", "a.mcap"]);
    let one = place.json(
        "whirls",
        &["simulate", "small.toml", "--json", "--steps", "2", "--record", "b.mcap"],
    );
    assert_eq!(own["turbulence"], one["turbulence"]);
    let bytes = ["a.mcap", "b.mcap"].map(|name| std::fs::read(place.path(name)).unwrap());
    assert!(bytes[0] == bytes[1], "one command under two names");
    let help = place.run("whirls", &["--help"]).out;
    for command in [
        "train",
        "simulate",
        "import",
        "export-law",
        "assimilate",
        "evaluate",
        "trade",
        "replay",
        "reproduce",
        "advise",
    ] {
        assert!(help.contains(command), "{help}");
    }
    let completions = place.run("whirls", &["completions", "bash"]);
    assert!(completions.out.contains("complete -F _whirls"), "{}", completions.err);
    assert_eq!(place.run("whirls", &["man", "pages"]).code, Some(0));
    assert!(place.path("pages/whirls-train.1").exists());
    place.refuses("simulate", &["invers-3d"], &["did you mean inverse-3d?"]);
    place.refuses("simulate", &["small.toml", "--set", "fluid.alfa=2"], &["did you mean `alpha`?"]);
    place.refuses(
        "train",
        &["node-3d", "--set", "learn.model.width=7"],
        &["did you mean `height`?"],
    );
    place.refuses("simulate", &["2", "--set", "fluid.alpha"], &["no '='", "key=value"]);
}
