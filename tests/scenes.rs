//! Scenes: every mistake is refused with place, expectation, finding and remedy; every scene can be
//! written and read back.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use whirls::forcing::Power;
use whirls::parameters::Parameter;
use whirls::scene::{
    Forcing, Increments, KernelName, Optimiser, SHIPPED, Shipped, Speed, SpinUp, Times,
};
use whirls::systems::verlet::Step;
use whirls::{Error, Scene};

const GOOD: &str = r#"
name = "small"
dimension = 3

[fluid]
particles_per_side = 8
smoothing_length = 0.6
c = 10.0
alpha = 1.0
beta = 2.0
gamma = 7.0

[forcing]
kind = "deterministic"
theta = 0.5

[time]
courant = 0.4

[learn]
parameters = ["c", "alpha"]
frames = 10
"#;

/// The error of a refused scene, which must be one of bad input.
fn refusal(text: &str, overrides: &[&str]) -> String {
    let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
    let error = Scene::parse(text, "small.toml", &overrides).unwrap_err();
    assert!(matches!(error, Error::Input { .. }), "{error:?}");
    assert_eq!(error.exit_code(), 2, "{error}");
    error.to_string()
}

#[track_caller]
fn assert_says(message: &str, parts: &[&str]) {
    for part in parts.iter().chain(&["small.toml", "expected", "found"]) {
        assert!(message.contains(part), "no `{part}` in: {message}");
    }
}

fn open(name: &str, overrides: &[&str]) -> whirls::Result<Scene> {
    Scene::open(name, &overrides.iter().map(|&o| o.to_owned()).collect::<Vec<_>>())
}

#[test]
fn a_good_scene_is_accepted() {
    let scene = Scene::parse(GOOD, "small.toml", &[]).unwrap();
    assert_eq!((scene.particles(), scene.time.step), (512, Step::KickDriftKick));
    assert_eq!(scene.fluid.kernel, KernelName::CubicSpline);
    assert!((scene.fluid.box_length - std::f64::consts::TAU).abs() < f64::EPSILON);
    assert!((scene.dt() - 0.4 * 0.6 / 10.0).abs() < 1e-17);
    assert!((scene.mass() * 512.0 - scene.fluid.box_length.powi(3)).abs() < 1e-12);
}

#[test]
fn a_scene_without_a_skin_gets_a_quarter_of_a_particle_spacing_whatever_it_is_overridden_with() {
    let spacing = std::f64::consts::TAU / 8.0;
    let skin = |overrides: &[&str]| {
        let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
        Scene::parse(GOOD, "small.toml", &overrides).unwrap().time.skin
    };
    let usual = |spacings: f64, h: f64| spacings * spacing / h;
    for (found, expected) in [
        (skin(&[]), usual(0.26, 0.6)),
        (skin(&["fluid.smoothing_length=0.7"]), usual(0.26, 0.7)),
        (skin(&["dimension=2"]), usual(0.2, 0.6)),
        (
            open("nn-sum-3d", &["fluid.smoothing_length=0.4"]).unwrap().time.skin,
            0.26 * spacing / 0.8,
        ),
    ] {
        assert!((found - expected).abs() < 1e-15, "{found}, expected {expected}");
    }
    for given in [0.0, 0.2] {
        assert!((skin(&[&format!("time.skin={given}")]) - given).abs() < 1e-300);
    }
}

#[test]
fn every_shipped_scene_keeps_its_neighbours_when_the_resolution_changes() {
    for Shipped { name, .. } in SHIPPED {
        let usual = open(name, &[]).unwrap();
        let h = usual.fluid.smoothing_length;
        match (name, usual.dimension) {
            ("dns-3d", _) => assert!((h - 0.45).abs() < 1e-5, "{name} {h}"),
            (_, 2) => assert_eq!(h.to_bits(), 0.2_f64.to_bits(), "{name}"),
            _ => assert_eq!(h.to_bits(), 0.335_f64.to_bits(), "{name}"),
        }
        let width = |scene: &Scene| {
            let spacing = scene.fluid.box_length / scene.fluid.particles_per_side as f64;
            scene.fluid.smoothing_length / spacing
        };
        for side in [8, 32, 64] {
            let other = open(name, &[&format!("fluid.particles_per_side={side}")]).unwrap();
            assert!((width(&other) / width(&usual) - 1.0).abs() < 1e-14, "{name} {side}");
        }
    }
}

#[test]
fn the_width_that_is_said_last_counts_and_two_in_one_text_are_refused() {
    let h = |overrides: &[&str]| open("inverse-3d", overrides).unwrap().fluid.smoothing_length;
    assert_eq!(h(&["fluid.smoothing_length=0.5"]).to_bits(), 0.5_f64.to_bits());
    assert_eq!(
        h(&["fluid.h_over_spacing=1.2", "fluid.smoothing_length=0.5"]).to_bits(),
        0.5_f64.to_bits()
    );
    assert_eq!(
        h(&["fluid.smoothing_length=0.5", "fluid.box_length=16", "fluid.h_over_spacing=1"])
            .to_bits(),
        1.0_f64.to_bits()
    );
    let both = GOOD.replace("smoothing_length", "h_over_spacing = 1.2\nsmoothing_length");
    assert_says(&refusal(&both, &[]), &["one of the two widths", "fluid.h_over_spacing"]);
    let text = refusal(GOOD, &["fluid.h_over_spacing=wide"]);
    assert_says(&text, &["fluid.h_over_spacing", "a number", "wide"]);
}

#[test]
fn a_misspelt_key_is_refused_with_its_line_and_the_keys_there_are() {
    let text = GOOD.replace("smoothing_length = 0.6", "smoothing = 0.6");
    let message = refusal(&text, &[]);
    assert_says(&message, &["line 7", "`smoothing = 0.6`", "smoothing_length"]);
    let message = refusal(&GOOD.replace("frames = 10", "frames = 10\nepochs = 3"), &[]);
    assert_says(&message, &["line 23", "epochs", "iterations"]);
}

#[test]
fn a_wrong_type_is_refused_with_its_line() {
    let message = refusal(&GOOD.replace("c = 10.0", "c = \"fast\""), &[]);
    assert_says(&message, &["line 8", "c = \"fast\"", "string"]);
    let message = refusal(&GOOD.replace("particles_per_side = 8", "particles_per_side = 8.5"), &[]);
    assert_says(&message, &["line 6", "8.5"]);
}

#[test]
fn a_missing_key_is_named() {
    let message = refusal(&GOOD.replace("gamma = 7.0\n", ""), &[]);
    assert_says(&message, &["gamma"]);
    assert_says(&refusal(&GOOD.replace("name = \"small\"\n", ""), &[]), &["name"]);
}

#[test]
fn text_that_is_no_toml_is_refused_with_its_line() {
    assert_says(&refusal(&GOOD.replace("c = 10.0", "c = = 10"), &[]), &["line 8"]);
    assert_says(&refusal(&format!("{GOOD}\n[fluid]\n"), &[]), &["fluid"]);
}

#[test]
fn names_that_are_not_in_a_list_are_refused_with_the_list() {
    let kernel = "beta = 2.0\nkernel = \"wendland\"";
    let message = refusal(&GOOD.replace("beta = 2.0", kernel), &[]);
    assert_says(&message, &["line 11", "wendland", "cubic-spline", "wendland-c2", "wendland-c4"]);
    let message = refusal(&GOOD.replace("courant = 0.4", "step = \"leapfrog\""), &[]);
    assert_says(&message, &["leapfrog", "kick-drift-kick", "paper", "one-force", "two-force"]);
    let message = refusal(&GOOD.replace("\"deterministic\"", "\"random\""), &[]);
    assert_says(&message, &["random", "deterministic", "stochastic"]);
    let message = refusal(&GOOD.replace("\"alpha\"]", "\"alfa\"]"), &[]);
    assert_says(&message, &["alfa", "alpha", "beta", "gamma", "theta"]);
}

#[test]
fn numbers_that_no_run_could_use_are_refused_with_key_and_value() {
    let cases: &[(&str, &[&str])] = &[
        ("dimension=4", &["dimension", "2 or 3", "found 4"]),
        ("dimension=1", &["dimension", "2 or 3", "found 1"]),
        (
            "fluid.particles_per_side=0",
            &["fluid.particles_per_side", "at least one", "0 particles"],
        ),
        ("fluid.particles_per_side=500", &["fluid.particles_per_side", "at most", "500"]),
        ("fluid.smoothing_length=-0.1", &["fluid.smoothing_length", "positive", "-0.1"]),
        ("fluid.smoothing_length=nan", &["fluid.smoothing_length", "positive", "NaN"]),
        ("fluid.smoothing_length=1.6", &["fluid.smoothing_length", "half the box", "2h = 3.2"]),
        ("fluid.box_length=0.0", &["fluid.box_length", "positive"]),
        ("fluid.box_length=inf", &["fluid.box_length", "positive", "inf"]),
        ("fluid.c=0.0", &["fluid.c", "positive"]),
        ("fluid.alpha=-1.0", &["fluid.alpha", "zero or more", "-1"]),
        ("fluid.beta=nan", &["fluid.beta", "zero or more", "NaN"]),
        ("fluid.gamma=0.0", &["fluid.gamma", "positive"]),
        ("time.courant=0.0", &["time.courant", "positive"]),
        ("time.dt=-1.0", &["time.dt", "positive", "found -1;"]),
        ("time.skin=-0.1", &["time.skin", "zero or more", "-0.1"]),
        ("initial.jitter=-0.1", &["initial.jitter", "zero or more", "-0.1"]),
        ("initial.velocity=inf", &["initial.velocity", "zero or more", "inf"]),
        ("limits.courant=0.0", &["limits.courant", "positive"]),
        ("limits.energy=-1.0", &["limits.energy", "positive"]),
        ("forcing.theta=nan", &["forcing.theta", "a number", "NaN"]),
        ("learn.frames=0", &["learn.frames", "at least one"]),
        ("learn.every=0", &["learn.every", "at least one step"]),
        ("accuracy=0.0", &["accuracy", "positive number of smoothing lengths", "found 0"]),
        ("accuracy=-1e-3", &["accuracy", "positive", "-0.001"]),
        ("accuracy=nan", &["accuracy", "positive", "NaN"]),
        ("speed=fast", &["speed", "draft", "balanced", "exact"]),
        (
            "chosen={accuracy=1e-3,step='paper',dt=0.1,cost=1.0,error=1e-4}",
            &["chosen", "take [chosen] out", "None"],
        ),
        ("learn.mesh=0", &["learn.mesh", "at least one node"]),
        ("learn.target=-1.0", &["learn.target", "zero or more", "-1"]),
        ("learn.parameters=[]", &["learn.parameters", "at least one parameter"]),
        ("learn.parameters=['c','alpha','c']", &["learn.parameters", "each once"]),
        ("learn.windows=[3,3]", &["learn.windows", "growing", "[3, 3]"]),
        ("learn.windows=[5,2]", &["learn.windows", "growing", "[5, 2]"]),
        ("learn.windows=[0,2]", &["learn.windows", "[0, 2]"]),
        ("learn.windows=[3,11]", &["learn.windows", "learn.frames", "[3, 11]"]),
        ("learn.guess.beta=1.0", &["learn.guess", "learned parameters only", "beta"]),
        ("learn.loss.kl=-1.0", &["learn.loss", "zero or more", "kl -1"]),
        ("learn.loss.kl=1.0", &["learn.optimiser", "not a sum of squares", "levenberg"]),
        ("learn.increments.nodes=15", &["learn.increments.nodes", "at least 16", "15"]),
        ("learn.loss.field=-1.0", &["learn.loss", "zero or more", "-1"]),
        ("learn.loss={trajectory=0.0,field=0.0}", &["learn.loss", "one of them positive"]),
        ("learn.optimiser={kind='adam',rate=0.0}", &["learn.optimiser", "positive rate"]),
        ("learn.optimiser={kind='adam',rate=inf}", &["learn.optimiser", "positive rate"]),
        (
            "learn.optimiser={kind='adam',rate=0.1,decay=-1}",
            &["learn.optimiser.decay", "at most one", "-1"],
        ),
        ("learn.optimiser={kind='rmsprop',rate=0.1,decay=1.5}", &["learn.optimiser.decay", "1.5"]),
        ("learn.optimiser={kind='lbfgs',memory=0}", &["learn.optimiser.memory", "found 0"]),
        ("learn.guess.c=0", &["learn.guess.c", "a sound speed other than zero", "found 0"]),
        ("learn.guess.c=-3", &["learn.guess.c", "a positive number", "-3"]),
        ("learn.guess.c=nan", &["learn.guess.c", "a positive number", "NaN"]),
        ("learn.guess.alpha=inf", &["learn.guess.alpha", "zero or more", "inf"]),
        ("learn.guess.alpha=-1", &["learn.guess.alpha", "zero or more", "-1"]),
        ("learn.target=inf", &["learn.target", "a finite number", "inf"]),
        ("record.speed_scale=nan", &["record.speed_scale", "a finite number", "NaN"]),
        ("learn.parameters=['c','c']", &["found [c, c]"]),
    ];
    for (assignment, parts) in cases {
        let message = refusal(GOOD, &[assignment]);
        assert_says(&message, parts);
        assert!(message.contains("--set"), "{message}");
    }
}

#[test]
fn an_accuracy_is_asked_for_by_number_or_by_name_and_not_by_both() {
    let asked = |text: &str| {
        let scene = Scene::parse(GOOD, "small.toml", &[text.to_owned()]).unwrap();
        assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
        scene.accuracy_asked()
    };
    assert_eq!(asked("accuracy=1e-3"), Some(1e-3));
    assert_eq!(asked("accuracy=1"), Some(1.0));
    for speed in Speed::ALL {
        assert_eq!(asked(&format!("speed={}", speed.name())), Some(speed.accuracy()));
    }
    assert_eq!(Scene::parse(GOOD, "small.toml", &[]).unwrap().accuracy_asked(), None);
    let message = refusal(GOOD, &["accuracy=1e-3", "speed=draft"]);
    assert_says(&message, &["accuracy and speed", "one of them", "0.001", "draft"]);
}

#[test]
fn theta_is_learned_only_where_it_acts() {
    let theta = "learn.parameters=['c','theta']";
    assert!(Scene::parse(GOOD, "small.toml", &[theta.to_owned()]).is_ok());
    for forcing in ["forcing={kind='none'}", "forcing={kind='stochastic',interval=0.1}"] {
        let message = refusal(GOOD, &[theta, forcing]);
        assert_says(&message, &["learn.parameters", "theta", "deterministic"]);
    }
}

#[test]
fn a_stochastic_forcing_needs_an_interval() {
    assert_says(&refusal(GOOD, &["forcing={kind='stochastic'}"]), &["interval"]);
    let zero = "forcing={kind='stochastic',interval=0.0}";
    assert_says(&refusal(GOOD, &[zero]), &["forcing.interval", "positive"]);
}

#[test]
fn an_ornstein_uhlenbeck_forcing_needs_a_power_a_time_and_a_band_with_waves() {
    let with = |text: &str| format!("forcing={{kind='ornstein-uhlenbeck',{text}}}");
    let scene = Scene::parse(GOOD, "small.toml", &[with("power=0.3,correlation_time=1")]).unwrap();
    let expected = Forcing::OrnsteinUhlenbeck { power: 0.3, correlation_time: 1.0, band: 2.5 };
    assert_eq!(scene.forcing, expected);
    assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
    let cases: &[(&str, &[&str])] = &[
        ("power=0.3", &["correlation_time"]),
        ("correlation_time=0.3", &["power"]),
        ("power=0.3,correlation_time=1,seed=2", &["unknown", "seed"]),
        ("power=0.0,correlation_time=1", &["forcing.power", "positive", "found 0"]),
        ("power=inf,correlation_time=1", &["forcing.power", "positive", "inf"]),
        ("power=0.3,correlation_time=-1", &["forcing.correlation_time", "positive", "-1"]),
        ("power=0.3,correlation_time=nan", &["forcing.correlation_time", "NaN"]),
        ("power=1e9,correlation_time=1e-308", &["forcing.correlation_time", "finite"]),
        ("power=0.3,correlation_time=1,band=0.5", &["forcing.band", "between 1 and 8", "0.5"]),
        ("power=0.3,correlation_time=1,band=nan", &["forcing.band", "NaN"]),
        ("power=0.3,correlation_time=1,band=9", &["forcing.band", "found 9"]),
    ];
    for (text, parts) in cases {
        assert_says(&refusal(GOOD, &[&with(text)]), parts);
    }
}

#[test]
fn an_override_without_a_key_or_a_value_is_refused() {
    let error = Scene::parse(GOOD, "small.toml", &["fluid.alpha".to_owned()]).unwrap_err();
    let message = error.to_string();
    assert_eq!(error.exit_code(), 2);
    for part in ["--set fluid.alpha", "key=value", "no '='"] {
        assert!(message.contains(part), "{message}");
    }
    let error = Scene::parse(GOOD, "small.toml", &["fluid.c.x=1".to_owned()]).unwrap_err();
    assert!(error.to_string().contains("`c` to be a table"), "{error}");
    let error = Scene::parse(GOOD, "small.toml", &["fluid.sigma=1".to_owned()]).unwrap_err();
    assert!(error.to_string().contains("sigma"), "{error}");
    let error = Scene::parse(GOOD, "small.toml", &["=1".to_owned()]).unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
}

#[test]
fn a_scene_that_is_not_there_is_refused_with_those_that_are() {
    let error = open("inverse-4d", &[]).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    for Shipped { name, .. } in SHIPPED {
        assert!(error.to_string().contains(name), "{error}");
    }
    assert!(error.to_string().contains("inverse-4d"), "{error}");
    let error = open("no/such/scene.toml", &[]).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("cannot read no/such/scene.toml"), "{error}");
}

#[test]
fn every_shipped_scene_is_good_and_survives_being_written_out() {
    assert!(SHIPPED.len() >= 3);
    for Shipped { name, .. } in SHIPPED {
        let scene = Scene::shipped(name).unwrap();
        assert_eq!(scene.name, name);
        assert!(!scene.about.is_empty() && scene.learn.is_some(), "{name}");
        let again = Scene::parse(&scene.to_toml(), "written out", &[]).unwrap();
        assert_eq!(again, scene);
        assert_eq!(again.to_toml(), scene.to_toml());
    }
}

#[test]
fn overrides_reach_every_level_and_make_tables_that_are_missing() {
    let scene = open(
        "inverse-3d",
        &[
            "name=other",
            "seed=7",
            "fluid.alpha=2",
            "fluid.kernel=wendland-c4",
            "time.step=two-force",
            "time.dt=0.001",
            "limits.courant=0.7",
            "record.every=5",
            "forcing.power=exact",
            "learn.guess.c=9.5",
            "learn.loss.trajectory=0.25",
            "learn.windows=[2, 4]",
            "learn.parameters=[\"gamma\", \"c\"]",
            "learn.optimiser={kind='adam', rate=0.05, decay=0.1}",
        ],
    )
    .unwrap();
    let learn = scene.learn.clone().unwrap();
    assert_eq!((scene.name.as_str(), scene.seed, scene.record.every), ("other", 7, 5));
    assert_eq!((scene.fluid.kernel, scene.time.step), (KernelName::WendlandC4, Step::TwoForce));
    let numbers = [scene.fluid.alpha, scene.dt(), scene.limits.courant, learn.guess["c"]];
    assert_eq!(numbers.map(f64::to_bits), [2.0, 0.001, 0.7, 9.5_f64].map(f64::to_bits));
    assert_eq!(scene.forcing, Forcing::Deterministic { theta: 0.5, power: Power::Exact });
    assert_eq!(learn.parameters, [Parameter::GAMMA, Parameter::C]);
    assert_eq!((learn.windows, learn.loss.trajectory.to_bits()), (vec![2, 4], 0.25_f64.to_bits()));
    assert_eq!(learn.optimiser, Optimiser::Adam { rate: 0.05, decay: 0.1 });
    assert_eq!(
        Scene::parse(&scene_text(&open("inverse-3d", &["seed=7"]).unwrap()), "x", &[])
            .unwrap()
            .seed,
        7
    );
    // The last of two overrides of one key holds.
    assert_eq!(open("inverse-3d", &["seed=1", "seed=2"]).unwrap().seed, 2);
}

fn scene_text(scene: &Scene) -> String {
    scene.to_toml()
}

#[test]
fn a_spin_up_runs_before_the_first_step_with_its_own_forcing() {
    let stirred = "forcing={kind='stochastic',interval=0.1}";
    let mut scene = Scene::parse(GOOD, "small.toml", &["initial.velocity=0.0".to_owned()]).unwrap();
    let stirring = Scene::parse(GOOD, "small.toml", &[stirred.to_owned()]).unwrap().forcing;
    scene.spin_up = Some(SpinUp { steps: 7, forcing: stirring.clone() });
    assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);

    let alone = Scene { forcing: stirring, spin_up: None, ..scene.clone() };
    let mut before = whirls::Flow::<3>::new(&alone).unwrap();
    (0..7).try_for_each(|_| before.step()).unwrap();
    let mut flow = whirls::Flow::<3>::new(&scene).unwrap();
    flow.start().unwrap();
    assert_eq!(flow.state(), before.state());
    assert!(flow.state().velocities.iter().any(|v| v.norm() > 1e-4), "it was stirred from rest");
    assert_eq!(flow.steps(), 0);
    let message = refusal(GOOD, &["spin_up={steps=3,forcing={kind='stochastic',interval=0.0}}"]);
    assert_says(&message, &["forcing.interval", "positive"]);
}

#[test]
fn a_scene_in_a_file_is_the_scene_in_the_text() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.toml");
    std::fs::write(&path, GOOD).unwrap();
    let scene = open(&path.display().to_string(), &[]).unwrap();
    assert_eq!(scene, Scene::parse(GOOD, "small.toml", &[]).unwrap());
    std::fs::write(&path, GOOD.replace("alpha = 1.0", "alpha = \"one\"")).unwrap();
    let error = open(&path.display().to_string(), &[]).unwrap_err();
    assert!(error.to_string().contains("small.toml, line 9"), "{error}");
}

#[test]
fn every_optional_table_survives_being_written_out() {
    for forcing in common::FORCINGS.map(|(_, forcing)| forcing) {
        for kernel in common::KERNELS {
            for step in Step::ALL {
                let mut scene = Scene::parse(GOOD, "small.toml", &[]).unwrap();
                (scene.fluid.kernel, scene.time.step) = (kernel, step);
                scene.forcing = forcing.clone();
                scene.time.dt = Some(0.1 + 0.2);
                scene.learn.as_mut().unwrap().mesh = Some(12);
                scene.learn.as_mut().unwrap().increments =
                    Increments { times: Times::All, nodes: 300 };
                scene.learn.as_mut().unwrap().guess.insert("c".to_owned(), 1.0 / 3.0);
                assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
                scene.learn = None;
                assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
            }
        }
    }
}

/// The small scene with a velocity field.
fn with_field(dimension: usize, field: &str) -> whirls::Result<Scene> {
    let all = [
        format!("dimension={dimension}"),
        "fluid.particles_per_side=16".to_owned(),
        format!("initial.field={field}"),
    ];
    Scene::parse(GOOD, "small.toml", &all)
}

#[test]
fn a_velocity_field_is_named_or_written_as_a_table_and_survives_being_written_out() {
    let band = "{kind='random-solenoidal',spectrum={kind='band',smallest=2,largest=3}}";
    for (short, long) in [
        ("normal", "{kind='normal'}"),
        ("taylor-green", "{kind='taylor-green'}"),
        ("abc", "{kind='abc',a=1,b=1.0}"),
        (band, band),
        (
            "{kind='random-solenoidal',spectrum={kind='power-law',exponent=-2,largest=7}}",
            "{kind='random-solenoidal',spectrum={kind='power-law',exponent=-2.0,smallest=1,largest=7}}",
        ),
    ] {
        let scene = with_field(3, short).unwrap();
        assert_eq!(scene, with_field(3, long).unwrap());
        assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
    }
}

#[test]
fn a_scene_without_a_velocity_field_is_written_out_without_one() {
    let text = Scene::parse(GOOD, "small.toml", &[]).unwrap().to_toml();
    assert!(text.contains("\n[initial]\njitter = 0.0025\nvelocity = 1.0\n\n"), "{text}");
    assert_eq!(with_field(3, "normal").unwrap(), with_field(3, "{kind='normal'}").unwrap());
    for Shipped { name, .. } in SHIPPED {
        assert!(!Scene::shipped(name).unwrap().to_toml().contains("initial.field"), "{name}");
    }
}

#[test]
fn a_velocity_field_that_no_flow_could_start_with_is_refused_with_its_key() {
    let spectrum = |text: &str| format!("{{kind='random-solenoidal',spectrum={{{text}}}}}");
    let cases: &[(usize, String, &[&str])] = &[
        (2, "abc".into(), &["initial.field", "dimension 2", "only a form in three"]),
        (3, "vortex".into(), &["vortex", "taylor-green", "random-solenoidal"]),
        (3, "{kind='vortex'}".into(), &["vortex", "taylor-green", "random-solenoidal"]),
        (3, "{a=1.0}".into(), &["kind"]),
        (3, "7".into(), &["name of a velocity field", "kind"]),
        (3, "random-solenoidal".into(), &["spectrum"]),
        (3, "{kind='normal',width=1.0}".into(), &["unknown", "width"]),
        (3, "{kind='taylor-green',k=2}".into(), &["unknown", "`k`"]),
        (3, "{kind='abc',d=1.0}".into(), &["unknown", "`d`", "`a`"]),
        (3, "{kind='abc',a=nan}".into(), &["initial.field.a", "zero or more", "NaN"]),
        (3, "{kind='abc',b=-1}".into(), &["initial.field.b", "zero or more", "-1"]),
        (3, "{kind='abc',c=inf}".into(), &["initial.field.c", "zero or more", "inf"]),
        (3, spectrum("kind='band',largest=8"), &["spectrum.largest", "half", "16 particles"]),
        (3, spectrum("kind='band',largest=-1"), &["spectrum.largest", "at least 1", "-1"]),
        (3, spectrum("kind='band',smallest=4,largest=3"), &["spectrum.smallest", "found 4"]),
        (3, spectrum("kind='band',smallest=-2,largest=3"), &["spectrum.smallest", "found -2"]),
        (3, spectrum("kind='band',largest=3,peak=2"), &["unknown", "peak"]),
        (3, spectrum("kind='von-karman',peak=nan,largest=3"), &["spectrum.peak", "NaN"]),
        (3, spectrum("kind='von-karman',peak=-2.0,largest=3"), &["spectrum.peak", "-2"]),
        (3, spectrum("kind='power-law',exponent=inf,largest=3"), &["spectrum.exponent", "inf"]),
        (3, spectrum("kind='power-law',largest=3"), &["exponent"]),
    ];
    for (dimension, field, parts) in cases {
        let error = with_field(*dimension, field).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        assert_says(&error.to_string(), parts);
    }
}

/// Every `kind` of every table, including those without keys of their own.
#[test]
fn an_unknown_key_is_refused_beside_every_kind() {
    let whole = [
        "forcing={kind='none'}",
        "forcing={kind='deterministic',theta=0.5}",
        "forcing={kind='stochastic',interval=0.1}",
        "forcing={kind='ornstein-uhlenbeck',power=1,correlation_time=1}",
        "spin_up={steps=1,forcing={kind='none'}}",
        "learn.model={kind='physics'}",
        "learn.model={kind='eos-nn',height=4}",
        "learn.model={kind='grad-p',height=4}",
        "learn.model={kind='rot-inv',height=4}",
        "learn.model={kind='nn-sum',height=4}",
        "learn.model={kind='node',height=4}",
        "learn.model={kind='exchange',height=4}",
        "learn.optimiser={kind='levenberg-marquardt'}",
        "learn.optimiser={kind='lbfgs'}",
        "learn.optimiser={kind='adam',rate=0.1}",
        "learn.optimiser={kind='rmsprop',rate=0.1}",
        "fluid.viscosity={kind='morris',nu=0.1}",
        "fluid.viscosity={kind='monaghan-cleary',nu=0.1}",
        "fluid.kernel={kind='w-2'}",
        "fluid.kernel={kind='cubic-spline'}",
        "initial.field={kind='normal'}",
        "initial.field={kind='taylor-green'}",
        "initial.field={kind='abc'}",
    ];
    for table in whole {
        let before = table.replace("learn.optimiser", "learn.loss.field=1.0\nlearn.optimiser");
        let good: Vec<String> = before.lines().map(str::to_owned).collect();
        if !table.contains("'cubic-spline'") {
            Scene::parse(GOOD, "small.toml", &good).unwrap();
        }
        let at = table.rfind('}').unwrap() - usize::from(table.ends_with("}}"));
        let bad = format!("{},thetta=0.5{}", &table[..at], &table[at..]);
        let message = refusal(GOOD, &[&bad]);
        assert!(message.contains("thetta"), "{bad}: {message}");
    }
}

#[test]
fn an_unknown_key_in_a_table_with_a_kind_is_refused_with_its_own_line() {
    let text =
        GOOD.replace("kind = \"deterministic\"\ntheta = 0.5", "kind = \"none\"\nthetta = 0.5");
    let message = refusal(&text, &[]);
    assert_says(&message, &["line 15", "`thetta = 0.5`"]);
}

#[test]
fn what_is_given_in_place_of_a_scene_is_called_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let utf16: Vec<u8> = "name = 1".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let cases: [(&str, Vec<u8>, &[&str]); 5] = [
        (
            "utf16.toml",
            [b"\xff\xfe".to_vec(), utf16].concat(),
            &["UTF-16", "Set-Content -Encoding utf8"],
        ),
        ("data.mcap", b"\x89MCAP0\r\n".to_vec(), &["an MCAP recording", "--truth FILE.mcap"]),
        ("r.npy", b"\x93NUMPY\x01\x00".to_vec(), &["a .npy array", "import --help"]),
        ("r.npz", b"PK\x03\x04".to_vec(), &["a zip archive", "import --help"]),
        ("latin.toml", b"name = \"caf\xe9\"".to_vec(), &["no UTF-8", "save it as UTF-8"]),
    ];
    for (name, bytes, parts) in cases {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = open(&path.display().to_string(), &[]).unwrap_err();
        assert_eq!(error.exit_code(), 2, "{error}");
        println!("{error}");
        assert_says(&error.to_string().replace(name, "small.toml"), parts);
    }
}
