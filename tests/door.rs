//! Checks of input data against themselves and the scene: each kind of mistake is refused or
//! reported with a remedy, and valid data are accepted without a warning.

#![allow(clippy::print_stdout, reason = "a test shows what it measured")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::small;

use small::{arrays, import, npy, record, scene, truth, write_arrays};
use std::path::Path;
use whirls::recording::Recording;
use whirls::run::{Admitted, Given, Lesson, admit, admit_state};
use whirls::truth::{Truth, summed_densities};
use whirls::vector::Vector;
use whirls::{Error, Flow, Result, Scene};

/// The findings for states that were recorded by one scene and are learned from in another.
fn admitted(truth: &Truth<2>, by: &Scene, into: &Scene, force: bool) -> Result<Admitted<2>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.mcap");
    record(truth, by, &path);
    let frames = into.learn.as_ref().unwrap().frames.min(truth.states.len() - 1);
    admit(&Recording::open(&path).unwrap(), into, (0, frames), force)
}

/// Asserts a refusal with these words, and a warning with the same words if it is forced.
#[track_caller]
fn refused(truth: &Truth<2>, (by, into): (&Scene, &Scene), parts: &[&str]) {
    let error = admitted(truth, by, into, false).unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
    let text = error.to_string();
    println!("{text}");
    for part in parts.iter().chain(&["expected", "found", "--force"]) {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    let forced = admitted(truth, by, into, true).unwrap();
    assert!(!forced.warnings.is_empty(), "taken without a word");
}

/// Asserts a refusal with these words, forced or not.
#[track_caller]
fn never(truth: &Truth<2>, parts: &[&str]) {
    for force in [false, true] {
        let error = admitted(truth, &scene(&[]), &scene(&[]), force).unwrap_err();
        let text = error.to_string();
        println!("{text}");
        parts.iter().for_each(|part| assert!(text.contains(part), "no `{part}` in: {text}"));
    }
}

/// Asserts acceptance with a warning of these words.
#[track_caller]
fn warned(truth: &Truth<2>, (by, into): (&Scene, &Scene), parts: &[&str]) -> Truth<2> {
    let admitted = admitted(truth, by, into, false).unwrap();
    let text = admitted.warnings.join("\n");
    println!("{text}");
    parts.iter().for_each(|part| assert!(text.contains(part), "no `{part}` in: {text}"));
    admitted.truth
}

#[test]
fn a_recording_of_the_same_scene_passes_with_its_bits_and_without_a_word() {
    let (flow, own) = (truth(), scene(&[]));
    let found = admitted(&flow, &own, &own, false).unwrap();
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    assert_eq!((&found.truth.states, &found.truth.densities), (&flow.states, &flow.densities));
}

#[test]
fn a_number_that_is_none_is_named_by_frame_and_particle() {
    let mut lost = truth();
    lost.states[3].positions[17].0[1] = f64::NAN;
    never(&lost, &["position of particle 17 in frame 3", "NaN"]);
    let mut lost = truth();
    lost.states[4].velocities[2].0[0] = f64::INFINITY;
    never(&lost, &["velocity of particle 2 in frame 4", "inf"]);
    let mut lost = truth();
    lost.densities[5][9] = -1.0;
    never(&lost, &["density (a positive number) of particle 9 in frame 5", "-1"]);
    let mut lost = truth();
    lost.states[0].positions[1].0[0] = 1e300;
    never(&lost, &["position of particle 1 in frame 0", "1e300"]);
}

#[test]
fn a_frame_of_other_particles_is_named() {
    let mut fewer = truth();
    fewer.states[6].positions.pop();
    fewer.states[6].velocities.pop();
    fewer.densities[6].pop();
    never(&fewer, &["64 particles in frame 6", "found 63"]);
}

#[test]
fn rows_in_another_order_are_told_from_other_mistakes() {
    let own = scene(&[]);
    let mut shuffled = truth();
    for (k, state) in shuffled.states.iter_mut().enumerate() {
        state.positions.rotate_left(7 * k % 64);
        state.velocities.rotate_left(7 * k % 64);
        shuffled.densities[k].rotate_left(7 * k % 64);
    }
    refused(&shuffled, (&own, &own), &["another row", "sort the rows"]);
}

#[test]
fn times_and_velocities_in_other_units_are_told_by_their_factor() {
    let own = scene(&[]);
    let mut fast = truth();
    fast.states.iter_mut().flat_map(|s| &mut s.velocities).for_each(|v| *v = *v * 100.0);
    refused(&fast, (&own, &own), &["0.0100 times as far as v dt", "other units"]);
    let mut late = truth();
    late.states.iter_mut().for_each(|state| state.time *= 10.0);
    refused(&late, (&own, &scene(&["time.dt=0.2"])), &["0.1000 times as far", "multiply"]);
    let mut back = truth();
    back.states.iter_mut().flat_map(|s| &mut s.velocities).for_each(|v| *v = *v * -1.0);
    refused(&back, (&own, &own), &["against v"]);
}

#[test]
fn a_small_disagreement_of_positions_and_velocities_is_said() {
    let own = scene(&[]);
    let mut off = truth();
    off.states.iter_mut().flat_map(|s| &mut s.velocities).for_each(|v| *v = *v * 1.05);
    warned(&off, (&own, &own), &["to 4.", "% only"]);
}

#[test]
fn a_particle_that_jumps_is_named() {
    let own = scene(&[]);
    let mut jump = truth();
    jump.states[5].positions[11].0[0] += 0.3;
    refused(&jump, (&own, &own), &["particle 11", "frame 5", "jump"]);
    let mut twitch = truth();
    twitch.states[5].positions[11].0[0] += 0.006;
    warned(&twitch, (&own, &own), &["particle 11", "frame 5"]);
}

#[test]
fn particles_that_leave_their_box_empty_look_like_those_of_another() {
    let folder = tempfile::tempdir().unwrap();
    let mut small = truth();
    for state in &mut small.states {
        state.positions.iter_mut().chain(&mut state.velocities).for_each(|x| *x = *x * 0.01);
    }
    write_arrays(folder.path(), &arrays(&small));
    let text = import(folder.path(), false, None).unwrap_err().to_string();
    println!("{text}");
    for part in ["a box of 6.28", "look like those of a box of 0.0628", "--box"] {
        assert!(text.contains(part), "{text}");
    }
    let mut large = truth();
    for state in &mut large.states {
        state.positions.iter_mut().chain(&mut state.velocities).for_each(|x| *x = *x * 7.3);
    }
    write_arrays(folder.path(), &arrays(&large));
    let text = import(folder.path(), false, None).unwrap_err().to_string();
    println!("{text}");
    for part in ["to 45.8", "folded into the box", "on top of each other", "--box"] {
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn two_dimensions_with_a_third_column_of_zeros_are_told_to_drop_it() {
    let (folder, flow) = (tempfile::tempdir().unwrap(), truth());
    let rows = |of: fn(&whirls::flow::State<2>) -> &Vec<Vector<f64, 2>>| {
        let all = flow.states.iter().flat_map(of).flat_map(|row| [row.0[0], row.0[1], 0.0]);
        npy(&[11, 64, 3], all.collect::<Vec<_>>())
    };
    let [r, v] = [rows(|s| &s.positions), rows(|s| &s.velocities)];
    write_arrays(folder.path(), &[r, v, arrays(&flow)[2].clone()]);
    let text = import(folder.path(), false, None).unwrap_err().to_string();
    println!("{text}");
    assert!(text.contains("z = 0") && text.contains("drop the third column"), "{text}");
}

#[test]
fn axes_in_another_order_are_told() {
    let (folder, flow) = (tempfile::tempdir().unwrap(), truth());
    let rows = |of: fn(&whirls::flow::State<2>) -> &Vec<Vector<f64, 2>>| {
        let all = (0..64).flat_map(|i| flow.states.iter().map(move |s| of(s)[i].0)).flatten();
        npy(&[64, 11, 2], all.collect::<Vec<_>>())
    };
    let [r, v] = [rows(|s| &s.positions), rows(|s| &s.velocities)];
    write_arrays(folder.path(), &[r, v, Vec::new()]);
    let text = import(folder.path(), false, None).unwrap_err().to_string();
    println!("{text}");
    assert!(text.contains("swapaxes"), "{text}");
}

#[test]
fn densities_that_are_not_given_are_summed_by_h_or_by_the_scene_and_never_one() {
    let (folder, flow) = (tempfile::tempdir().unwrap(), truth());
    write_arrays(folder.path(), &arrays(&flow));
    let out = folder.path().join("imported.mcap");
    for (h, densities) in [(Some(0.8), "summed"), (None, "none")] {
        assert_eq!(import(folder.path(), false, h).unwrap().densities, densities);
        let recording = Recording::open(&out).unwrap();
        let found = admit::<2>(&recording, &scene(&[]), (0, 10), false).unwrap();
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let pairs = found.truth.densities.iter().flatten().zip(flow.densities.iter().flatten());
        let worst = pairs.map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-12, "{worst:e} with {h:?}");
    }
}

#[test]
fn summed_densities_are_those_of_a_flow_in_every_kernel() {
    for kernel in ["cubic-spline", "wendland-c2", "wendland-c4", "w-2"] {
        let scene = scene(&[&format!("fluid.kernel={kernel}")]);
        let mut flow = Flow::<2>::new(&scene).unwrap();
        flow.start().unwrap();
        let space = scene.space();
        let sums = summed_densities((scene.fluid.kernel, 0.8), space, &flow.state().positions);
        for (sum, rho) in sums.iter().zip(flow.densities()) {
            assert!((sum / rho - 1.0).abs() < 1e-12, "{kernel}: {sum} {rho}");
        }
    }
}

#[test]
fn densities_of_one_are_taken_for_missing_ones() {
    let (own, mut ones) = (scene(&[]), truth());
    ones.densities.iter_mut().flatten().for_each(|rho| *rho = 1.0);
    let found = warned(&ones, (&own, &own), &["every density is 1", "summed"]);
    assert!((found.densities[3][5] / truth().densities[3][5] - 1.0).abs() < 1e-12);
}

#[test]
fn densities_in_other_units_are_refused() {
    let (own, mut si) = (scene(&[]), truth());
    si.densities.iter_mut().flatten().for_each(|rho| *rho *= 1000.0);
    refused(&si, (&own, &own), &["1000.0", "divide them by 1000.0"]);
    let folder = tempfile::tempdir().unwrap();
    write_arrays(folder.path(), &arrays(&si));
    let text = import(folder.path(), true, None).unwrap_err().to_string();
    println!("{text}");
    assert!(text.contains("reference density of 1") && text.contains("divide them by"), "{text}");
}

#[test]
fn densities_of_another_smoothing_length_are_refused_and_those_of_noise_are_not() {
    let own = scene(&[]);
    let space = whirls::space::Space::cube(own.fluid.box_length);
    for h in [0.67, 0.79, 0.81, 0.9] {
        let mut other = truth();
        for (state, rho) in other.states.iter().zip(&mut other.densities) {
            *rho = summed_densities((own.fluid.kernel, h), space, &state.positions);
        }
        refused(&other, (&own, &own), &["lasting from frame to frame", "fluid.smoothing_length"]);
    }
    let mut noisy = truth();
    for (k, rho) in noisy.densities.iter_mut().flatten().enumerate() {
        *rho *= 1.0 + 0.01 * (1.7 * (k * k % 977) as f64).sin();
    }
    let found = warned(&noisy, (&own, &own), &["the summed ones are taken"]);
    assert!((found.densities[3][5] / truth().densities[3][5] - 1.0).abs() < 1e-12);
}

#[test]
fn smoothing_length_kernel_and_kind_of_step_must_be_those_of_the_recording() {
    let (flow, own) = (truth(), scene(&[]));
    let other = |set: &str| scene(&[set]);
    refused(
        &flow,
        (&own, &other("fluid.smoothing_length=0.7")),
        &["smoothing length of 0.7", "found 0.8"],
    );
    refused(&flow, (&own, &other("fluid.kernel=wendland-c2")), &["wendland-c2", "cubic-spline"]);
    refused(&flow, (&own, &other("time.step=one-force")), &["one-force", "paper", "time.step"]);
    refused(&flow, (&own, &other("time.dt=0.021")), &["0.021 apart", "found 0.02"]);
    refused(&flow, (&own, &other("fluid.box_length=6.3")), &["a box of 6.3", "fluid.box_length"]);
}

#[test]
fn forcing_viscosity_and_constants_that_are_not_learned_are_said_where_they_differ() {
    let (flow, own) = (truth(), scene(&[]));
    let other = |set: &str| scene(&[set]);
    let stirred = other("forcing={kind='deterministic',theta=0.5}");
    warned(&flow, (&own, &stirred), &["[forcing]", "none", "theta = 0.5"]);
    let few = scene(&["learn.parameters=['c']", "fluid.gamma=5"]);
    warned(&flow, (&own, &few), &["gamma = 7", "learned at 5"]);
    warned(&flow, (&own, &other("fluid.particles_per_side=10")), &["64 particles", "100"]);
    // What is learned may differ.
    assert!(admitted(&flow, &own, &other("fluid.gamma=5"), false).unwrap().warnings.is_empty());
}

#[test]
fn the_time_between_frames_is_exact_at_a_nanosecond_and_at_ages() {
    for scale in [1e-9, 1e-3, 1.0, 1e17] {
        let dt = 0.02 * scale;
        let mut flow = truth();
        for (k, state) in flow.states.iter_mut().enumerate() {
            state.time = 1e3 * dt + k as f64 * dt;
            state.velocities.iter_mut().for_each(|v| *v = *v * (1.0 / scale));
        }
        let own = scene(&[&format!("time.dt={dt:e}"), &format!("fluid.c={:e}", 12.0 / scale)]);
        let found = admitted(&flow, &own, &own, false).unwrap();
        assert!(found.warnings.is_empty(), "{scale}: {:?}", found.warnings);
        for factor in [0.99, 1.0 + 1e-7] {
            let other = scene(&[&format!("time.dt={:e}", dt * factor)]);
            let error = admitted(&flow, &own, &other, false).unwrap_err();
            assert!(error.to_string().contains("apart"), "{error}");
        }
    }
}

#[test]
fn whirls_takes_its_own_recordings_at_large_times() {
    let own = scene(&["time.dt=3e13", "fluid.c=8e-15"]);
    let mut flow = truth();
    for (k, state) in flow.states.iter_mut().enumerate() {
        state.time = 1e17 + k as f64 * 3e13;
        state.velocities.iter_mut().for_each(|v| *v = *v * (0.02 / 3e13));
    }
    let found = admitted(&flow, &own, &own, false).unwrap();
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

#[test]
fn a_flow_that_goes_on_must_fit_box_and_dimension_and_may_change_the_rest() {
    let (folder, flow, own) = (tempfile::tempdir().unwrap(), truth(), scene(&[]));
    let path = folder.path().join("flow.mcap");
    record(&flow, &own, &path);
    let from =
        |into: &Scene, force: bool| admit_state::<2>(Given { path: &path, force }, into, Some(2));
    let (state, warnings) = from(&own, false).unwrap();
    assert_eq!((&state, warnings.len()), (&flow.states[2], 0));
    let free = scene(&["time.dt=0.01", "time.step=one-force", "fluid.c=9"]);
    assert!(from(&free, false).unwrap().1.is_empty());
    let text = from(&scene(&["fluid.box_length=5"]), false).unwrap_err().to_string();
    assert!(text.contains("a box of 5") && text.contains("--force"), "{text}");
    let wide = from(&scene(&["fluid.smoothing_length=0.7"]), false).unwrap().1.join("");
    assert!(wide.contains("0.8") && wide.contains("0.7"), "{wide}");
}

#[test]
fn rows_are_put_into_the_order_of_their_ids_and_ids_given_twice_are_refused() {
    let (folder, flow, own) = (tempfile::tempdir().unwrap(), truth(), scene(&[]));
    let (plain, shuffled) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    record(&flow, &own, &plain);
    rewrite(&plain, &shuffled, |k, rows| rows.rotate_left(5 * k));
    let found = admit::<2>(&Recording::open(&shuffled).unwrap(), &own, (0, 10), false).unwrap();
    assert_eq!(found.truth.states, flow.states);
    rewrite(&plain, &shuffled, |k, rows| {
        if k == 4 {
            rows[9] = rows[8].clone();
        }
    });
    let error = admit::<2>(&Recording::open(&shuffled).unwrap(), &own, (0, 10), false).unwrap_err();
    println!("{error}");
    assert!(error.to_string().contains("an `id` of its own"), "{error}");
    rewrite(&plain, &shuffled, |k, rows| {
        if k == 4 {
            rows[63][56..60].copy_from_slice(&99_u32.to_le_bytes());
        }
    });
    let error = admit::<2>(&Recording::open(&shuffled).unwrap(), &own, (0, 10), false).unwrap_err();
    println!("{error}");
    assert!(error.to_string().contains("particle 63 in frame 4"), "{error}");
}

/// Writes a recording again, with its rows of 64 bytes changed frame by frame.
fn rewrite(from: &Path, to: &Path, change: impl Fn(usize, &mut Vec<Vec<u8>>)) {
    let bytes = std::fs::read(from).unwrap();
    let mut writer = mcap::WriteOptions::new().create(std::fs::File::create(to).unwrap()).unwrap();
    let mut k = 0;
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let mut message = message.unwrap();
        if message.channel.topic == "/truth/particles" {
            let mut data = message.data.to_vec();
            // The rows end nine bytes of time, and possibly three bytes of step, before the end.
            let rows = 64 * 64;
            let tail = data.len() - rows;
            let start = (0..=tail).rev().find(|&s| is_first_row(&data[s..s + rows])).unwrap();
            let mut all: Vec<Vec<u8>> =
                data[start..start + rows].chunks(64).map(<[u8]>::to_vec).collect();
            change(k, &mut all);
            data[start..start + rows].copy_from_slice(&all.concat());
            message.data = data.into();
            k += 1;
        }
        writer.write(&message).unwrap();
    }
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for index in &summary.metadata_indexes {
        writer.write_metadata(&mcap::read::metadata(&bytes, index).unwrap()).unwrap();
    }
    writer.finish().unwrap();
}

/// Whether the rows starting here are numbered from zero.
fn is_first_row(rows: &[u8]) -> bool {
    (0..64_u32).all(|k| rows[64 * k as usize + 56..][..4] == k.to_le_bytes())
}

#[test]
fn a_state_outside_the_box_makes_the_same_bits_as_its_image_inside() {
    let own = scene(&[]);
    let length = own.fluid.box_length;
    let start = Flow::<2>::new(&own).unwrap().state();
    let mut moved = start.clone();
    for (k, r) in moved.positions.iter_mut().enumerate() {
        // Whole boxes away, and back by the same subtraction, so that both positions are equal to
        // the bit.
        let away = Vector(r.0.map(|x| x + length * (k % 3) as f64 - length));
        let space = whirls::space::Space::cube(length);
        *r = space.wrap(away);
    }
    let inside = moved.clone();
    for (k, r) in moved.positions.iter_mut().enumerate() {
        *r = Vector(start.positions[k].0.map(|x| x + length * (k % 3) as f64 - length));
    }
    let run = |state: &whirls::flow::State<2>, reset: bool| {
        let mut flow = Flow::<2>::from_state(&own, if reset { &start } else { state }).unwrap();
        if reset {
            flow.reset(state);
        }
        (0..5).try_for_each(|_| flow.step()).unwrap();
        (flow.state(), flow.densities())
    };
    assert_eq!(run(&moved, false), run(&inside, false));
    assert_eq!(run(&moved, true), run(&inside, false));
}

#[test]
fn a_lesson_knows_the_file_it_is_from() {
    let (folder, own) = (tempfile::tempdir().unwrap(), scene(&[]));
    let path = folder.path().join("flow.mcap");
    record(&truth(), &own, &path);
    let lesson = Lesson::<2>::new(&own, Some(Given { path: &path, force: false })).unwrap();
    let origin = lesson.origin.unwrap();
    assert_eq!(origin.path, std::fs::canonicalize(&path).unwrap());
    assert!(origin.must_be_there(&path).is_ok());
    std::fs::write(&path, "something else").unwrap();
    let error = origin.must_be_there(Path::new("learned.mcap")).unwrap_err();
    assert!(
        matches!(error, Error::Input { .. }) && error.to_string().contains("--truth"),
        "{error}"
    );
}
