//! The effects of commands on files, and the files that stopped commands leave.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use place::{Done, Place};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use whirls::output::{Output, leftovers, readable};
use whirls::recording::{Flow, Recording};

/// A long search.
const LONG: [&str; 8] = [
    "small.toml",
    "--threads=1",
    "--set=learn.optimiser={kind='adam',rate=1e-7}",
    "--set=learn.iterations=1000000",
    "--set=learn.target=0.0",
    "--set=learn.guess={c=9.0,alpha=0.9,beta=1.9,gamma=6.5}",
    "--record",
    "long.mcap",
];

/// A search of two iterations.
const SHORT: [&str; 4] =
    ["small.toml", "--json", "--set=learn.iterations=2", "--set=learn.windows=[]"];

fn with<'a>(some: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [some, more].concat()
}

/// Starts a command, and waits until a file of a given name can be read.
fn running(place: &Place, command: &str, arguments: &[&str], name: &str) -> Child {
    let mut command = place.command(command, arguments);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let patience = Instant::now();
    let has_begun = || {
        let counts = Recording::open(&place.path(name)).map(|recording| recording.counts());
        let topics = ["/train/step", "/diag/conservation"];
        counts.is_ok_and(|counts| topics.iter().any(|topic| counts.contains_key(*topic)))
    };
    while !has_begun() {
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        assert!(patience.elapsed() < Duration::from_secs(120), "nothing was recorded");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

/// Waits until a process handles its signals, according to Linux.
fn listening(id: u32) {
    let caught = || -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
        let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"))?;
        u64::from_str_radix(mask.trim(), 16).ok()
    };
    let patience = Instant::now();
    // SIGINT is number two.
    while caught().is_some_and(|mask| mask & 0b10 == 0) {
        assert!(patience.elapsed() < Duration::from_secs(60), "it never listens");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Sends a signal and waits for the end.
fn stopped(child: Child, signal: &str) -> Done {
    let kill = format!("kill {signal} {}", child.id());
    assert!(std::process::Command::new("bash").args(["-c", &kill]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Done { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

fn bytes(place: &Place, name: &str) -> Vec<u8> {
    std::fs::read(place.path(name)).unwrap()
}

/// Arrays of two frames, in which nothing moves.
fn arrays(place: &Place) {
    let position = |k: u64| (k % 12 * 5 % 12) as f64 / 2.0;
    write_array((place, "r.npy"), [2, 4, 3], position);
    write_array((place, "v.npy"), [2, 4, 3], |_| 0.0);
}

/// An array, number by number.
fn write_array((place, name): (&Place, &str), shape: [u64; 3], of: impl Fn(u64) -> f64) {
    use npyz::WriterBuilder as _;
    let file = std::io::BufWriter::new(std::fs::File::create(place.path(name)).unwrap());
    let options = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file);
    let mut writer = options.begin_nd().unwrap();
    writer.extend((0..shape.iter().product()).map(of)).unwrap();
    writer.finish().unwrap();
}

const IMPORT: [&str; 7] =
    ["--positions", "r.npy", "--velocities", "v.npy", "--dt=0.1", "--json", "--out"];

#[test]
fn no_command_writes_over_what_it_reads() {
    let place = Place::new();
    arrays(&place);
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    place.json("train", &with(&SHORT, &["--record", "learned.mcap"]));
    std::fs::create_dir(place.path("out")).unwrap();
    std::fs::copy(place.path("learned.mcap"), place.path("out/evaluation.mcap")).unwrap();
    std::fs::hard_link(place.path("flow.mcap"), place.path("hard.mcap")).unwrap();
    std::os::unix::fs::symlink(place.path("flow.mcap"), place.path("soft.mcap")).unwrap();
    let before = ["flow.mcap", "learned.mcap", "r.npy", "small.toml"].map(|f| bytes(&place, f));
    let same = "the same file as the input";
    for other in ["flow.mcap", "./flow.mcap", "hard.mcap", "soft.mcap"] {
        for more in [&[][..], &["--overwrite"]] {
            let onto = with(&["small.toml", "--record", other], more);
            place.refuses("train", &with(&onto, &["--truth", "flow.mcap"]), &[other, same]);
            place.refuses("simulate", &with(&onto, &["--from", "flow.mcap"]), &[other, same]);
        }
    }
    for command in ["train", "simulate"] {
        let onto = ["small.toml", "--overwrite", "--record", "small.toml"];
        place.refuses(command, &onto, &["small.toml", same]);
    }
    place.refuses("import", &with(&IMPORT, &["r.npy", "--overwrite"]), &["r.npy", same]);
    let evaluate = ["out/evaluation.mcap", "--quick", "--out", "out"];
    place.refuses("evaluate", &evaluate, &["out/evaluation.mcap", same]);
    std::fs::create_dir(place.path("trade")).unwrap();
    std::fs::copy(place.path("small.toml"), place.path("trade/prices.json")).unwrap();
    place.refuses("trade", &["trade/prices.json", "--out", "trade"], &["prices.json", same]);
    let recover = ["--recover", "flow.mcap", "--out", "hard.mcap"];
    place.refuses("replay", &recover, &["hard.mcap", same]);
    // A resumed recording is replaced only on request.
    let resume = with(&SHORT, &["--resume", "learned.mcap", "--record", "learned.mcap"]);
    place.refuses("train", &resume, &["the recording that is resumed", "--overwrite"]);
    assert!(
        before == ["flow.mcap", "learned.mcap", "r.npy", "small.toml"].map(|f| bytes(&place, f))
    );
}

#[test]
fn a_recording_replaces_one_of_the_same_command_and_nothing_else_unless_told_to() {
    let place = Place::new();
    arrays(&place);
    std::fs::create_dir(place.path("recordings")).unwrap();
    std::fs::write(place.path("notes.txt"), "what was thought").unwrap();
    place.json("import", &with(&IMPORT, &["recordings/small.mcap"]));
    place.json("import", &with(&IMPORT, &["recordings/small.flow.mcap"]));
    for (command, name) in [("train", "small.mcap"), ("simulate", "small.flow.mcap")] {
        let run = ["small.toml", "--json", "--set=learn.iterations=1"];
        let found = ["a recording of `import`", "--overwrite"];
        place.refuses(command, &run, &[&[name][..], &found[..]].concat());
        let onto = with(&run, &["--record", "notes.txt"]);
        place.refuses(command, &onto, &["notes.txt", "did not record", "--overwrite"]);
        // The default and the explicit name of the same command, twice each.
        place.json(command, &with(&run, &["--overwrite"]));
        place.json(command, &run);
        place.json(command, &with(&run, &["--record", "own.mcap", "--overwrite"]));
        place.json(command, &with(&run, &["--record", "own.mcap"]));
        // An empty file holds nothing.
        std::fs::write(place.path("empty"), "").unwrap();
        place.json(command, &with(&run, &["--record", "empty"]));
        std::fs::remove_file(place.path("empty")).unwrap();
    }
    place.refuses("train", &with(&SHORT, &["--record", "own.mcap"]), &["recording of `simulate`"]);
    place.refuses("import", &with(&IMPORT, &["own.mcap"]), &["recording of `simulate`"]);
    assert_eq!(bytes(&place, "notes.txt"), b"what was thought");
    place.json("simulate", &["small.toml", "--json", "--record", "notes.txt", "--overwrite"]);
    assert_eq!(place.recording("notes.txt").frame_count(Flow::Truth), 7);
}

#[test]
fn a_recording_has_its_name_only_when_it_is_complete() {
    let place = Place::new();
    place.json("train", &with(&SHORT, &["--record", "long.mcap"]));
    let before = bytes(&place, "long.mcap");
    let mut child = running(&place, "train", &LONG, "long.unfinished.mcap");
    assert!(bytes(&place, "long.mcap") == before, "the old one is there while the new one runs");
    assert!(place.recording("long.unfinished.mcap").is_truncated(), "and both can be looked at");
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(bytes(&place, "long.mcap") == before, "and after a kill");
    let cut = place.recording("long.unfinished.mcap").train_steps().unwrap();
    assert!(!cut.is_empty());
    // The next run keeps the unfinished file, and reports it.
    let done = place.run("train", &with(&SHORT, &["--record", "long.mcap"]));
    let told = ["warning: long.unfinished.mcap", "train --resume", "replay --recover"];
    assert!(
        done.code == Some(0) && told.iter().all(|part| done.err.contains(part)),
        "{}",
        done.err
    );
    assert_eq!(place.recording("long.unfinished.mcap").train_steps().unwrap(), cut);
    assert!(bytes(&place, "long.mcap") == before, "equal bytes of equal runs");
    assert_eq!(leftovers(&place.path("long.mcap")).len(), 1);
    place.json("replay", &["--recover", "long.unfinished.mcap", "--json"]);
    let whole = place.recording("long.unfinished.recovered.mcap");
    assert!(!whole.is_truncated() && whole.train_steps().unwrap() == cut);
    let resume = with(&SHORT, &["--resume", "long.unfinished.mcap", "--record", "long.mcap"]);
    place.json("train", &resume);
    assert_eq!(place.recording("long.mcap").train_steps().unwrap()[..cut.len()], cut);
}

#[test]
fn a_second_run_into_a_file_is_refused_while_the_first_writes_it() {
    let place = Place::new();
    let child = running(&place, "train", &LONG, "long.mcap");
    let parts = ["long.mcap", "no other run is writing", "long.unfinished.mcap", "another name"];
    place.refuses("train", &LONG, &parts);
    place.refuses("simulate", &["small.toml", "--record", "long.mcap", "--overwrite"], &parts);
    assert_eq!(stopped(child, "-TERM").code, Some(143));
    place.json("train", &with(&SHORT, &["--record", "long.mcap"]));
    // The same holds in one process.
    let path = place.path("of-a-library.mcap");
    let first = Output::create(&path).unwrap();
    assert!(Output::create(&path).unwrap_err().to_string().contains("no other run"));
    drop(first);
    assert!(leftovers(&path).is_empty(), "nothing was written, nothing is left");
    Output::create(&path).unwrap();
}

#[test]
fn a_resumed_search_keeps_the_iterations_before_it() {
    let place = Place::new();
    place.json("train", &with(&SHORT, &["--record", "first.mcap"]));
    let first = place.recording("first.mcap").train_steps().unwrap();
    let resume = with(&SHORT, &["--resume", "first.mcap", "--record"]);
    let report = place.json("train", &with(&resume, &["second.mcap"]));
    assert_eq!((&report["iterations"], &report["iterations_before"]), (&4.into(), &2.into()));
    let second = place.recording("second.mcap").train_steps().unwrap();
    assert_eq!(second[..first.len()], first);
    let counted: Vec<u64> = second.iter().map(|step| step.iteration).collect();
    assert_eq!(counted, [0, 1, 2, 3, 4]);
    // Into the same name, with equal bytes.
    let again = place.json("train", &with(&resume, &["first.mcap", "--overwrite"]));
    assert_eq!(again["loss_final"], report["loss_final"]);
    assert!(bytes(&place, "first.mcap") == bytes(&place, "second.mcap"));
    let words = with(&["small.toml", "--set=learn.iterations=1"], &["--resume", "first.mcap"]);
    let done = place.run("train", &words);
    assert!(done.out.contains("in 1 iterations after 4 earlier ones"), "{}{}", done.out, done.err);
}

#[test]
fn a_signal_ends_a_search_in_order_and_it_can_be_gone_on_with() {
    for (signal, name, code) in [("-INT", "SIGINT", 130), ("-TERM", "SIGTERM", 143)] {
        let place = Place::new();
        let done = stopped(running(&place, "train", &LONG, "long.mcap"), signal);
        assert_eq!(done.code, Some(code), "{}", done.err);
        for part in [name, "long.unfinished.mcap, which is whole", "--resume long.unfinished.mcap"]
        {
            assert!(done.err.contains(part), "no `{part}` in: {}", done.err);
        }
        assert!(!place.path("long.mcap").exists());
        let kept = place.recording("long.unfinished.mcap");
        assert!(
            !kept.is_truncated()
                && kept.logs().unwrap().last().unwrap().text.contains("interrupted")
        );
        let steps = kept.train_steps().unwrap();
        assert!(steps.iter().enumerate().all(|(k, step)| step.iteration == k as u64));
        let resume = ["--resume", "long.unfinished.mcap", "--record", "long.mcap"];
        place.json("train", &with(&SHORT, &resume));
        assert_eq!(place.recording("long.mcap").train_steps().unwrap()[..steps.len()], steps);
    }
}

#[test]
fn a_signal_ends_a_simulation_in_order_and_it_can_be_gone_on_with() {
    let place = Place::new();
    let run = ["small.toml", "--steps=1000000", "--set=record.every=10", "--record", "flow.mcap"];
    let done = stopped(running(&place, "simulate", &run, "flow.mcap"), "-INT");
    assert_eq!(done.code, Some(130), "{}", done.err);
    assert!(done.err.contains("of 1000000 steps are in flow.unfinished.mcap"), "{}", done.err);
    let advice = done.err.split("--from ").nth(1).unwrap().trim();
    let advice: Vec<&str> = advice.split(' ').collect();
    assert_eq!((advice[0], advice[1]), ("flow.unfinished.mcap", "--steps"));
    let kept = place.recording("flow.unfinished.mcap");
    assert!(!kept.is_truncated() && kept.frame_count(Flow::Truth) > 0);
    let on = ["small.toml", "--from", advice[0], "--steps=2", "--record", "flow.mcap", "--json"];
    place.json("simulate", &on);
}

/// Truths, searches in price lists, evaluations and stages: no incomplete result is written as
/// complete.
#[test]
fn a_signal_ends_every_other_command_without_half_a_result() {
    let place = Place::new();
    place.json("train", &with(&SHORT, &["--record", "learned.mcap"]));
    let runs: [(&str, &[&str], &str); 4] = [
        ("train", &["small.toml", "--set=learn.after=1000000", "--record", "x.mcap"], "x.mcap"),
        ("evaluate", &["learned.mcap", "--steps=100000", "--out", "x"], "x/evaluation.json"),
        ("trade", &["small.toml", "--steps=100000", "--out", "x"], "x/prices.json"),
        ("reproduce", &["--quick", "--out", "x"], "x/reproduction.json"),
    ];
    for (command, arguments, result) in runs {
        let mut child = place.command(command, arguments);
        let child = child.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        listening(child.id());
        std::thread::sleep(Duration::from_millis(500));
        let clock = Instant::now();
        let done = stopped(child, "-INT");
        assert_eq!(done.code, Some(130), "{command}: {}", done.err);
        assert!(done.err.contains("error: interrupted by SIGINT: "), "{command}: {}", done.err);
        assert!(clock.elapsed() < Duration::from_secs(20), "{command} took {:?}", clock.elapsed());
        assert!(!place.path(result).exists() && leftovers(&place.path(result)).is_empty());
    }
}

#[test]
fn a_signal_ends_an_import_without_half_a_recording() {
    let place = Place::new();
    let shape = [200, 4096, 3];
    // A lattice of sixteen particles a side at rest: axis `k % 3` of particle `k / 3 % 4096`.
    let along = |k: u64| ((k / 3 % 4096) >> (4 * (k % 3))) % 16;
    write_array((&place, "r.npy"), shape, |k| along(k) as f64 * std::f64::consts::TAU / 16.0);
    write_array((&place, "v.npy"), shape, |_| 0.0);
    let mut child = place.command("import", &with(&IMPORT, &["x.mcap"]));
    let child = child.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    listening(child.id());
    let done = stopped(child, "-INT");
    assert_eq!(done.code, Some(130), "{}", done.err);
    assert!(done.err.contains("interrupted by SIGINT: nothing was written"), "{}", done.err);
    assert!(!place.path("x.mcap").exists() && leftovers(&place.path("x.mcap")).is_empty());
}

#[test]
fn a_full_disk_is_told_as_what_it_is() {
    let place = Place::new();
    arrays(&place);
    let runs: [(&str, &[&str]); 3] = [
        ("simulate", &["small.toml", "--record", "/dev/full"]),
        ("train", &["small.toml", "--record", "/dev/full"]),
        ("import", &with(&IMPORT, &["/dev/full"])),
    ];
    for (command, arguments) in runs {
        let done = place.run(command, arguments);
        let reason = "cannot write /dev/full: No space left on device";
        assert!(done.code == Some(1) && done.err.contains(reason), "{command}: {}", done.err);
    }
}

#[test]
fn a_report_that_cannot_be_printed_is_a_failure_and_a_reader_that_went_is_none() {
    let place = Place::new();
    place.json("train", &with(&SHORT, &["--record", "learned.mcap"]));
    let train = with(&SHORT, &["--record", "learned.mcap"]);
    for (command, arguments) in [("train", &train[..]), ("replay", &["--info", "learned.mcap"])] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = place.command(command, arguments).stdout(full).output().unwrap();
        let err = String::from_utf8(output.stderr).unwrap();
        let reason = "cannot write standard output: No space left on device";
        assert!(output.status.code() == Some(1) && err.contains(reason), "{command}: {err}");
        let mut child = place.command(command, arguments).stdout(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{command}");
    }
    assert!(!place.recording("learned.mcap").is_truncated());
}

#[test]
fn results_that_cannot_be_written_are_refused_before_the_work() {
    let place = Place::new();
    place.json("train", &with(&SHORT, &["--record", "learned.mcap"]));
    std::fs::create_dir_all(place.path("taken/evaluation.html")).unwrap();
    std::fs::create_dir_all(place.path("taken/prices.mcap")).unwrap();
    for (command, first) in [("evaluate", "learned.mcap"), ("trade", "small.toml")] {
        let clock = Instant::now();
        let done = place.run(command, &[first, "--steps=100000", "--out", "small.toml"]);
        assert!(done.code == Some(1) && done.err.contains("small.toml"), "{}", done.err);
        let taken = [first, "--steps=100000", "--out", "taken"];
        place.refuses(command, &taken, &["taken/", "a folder", "--out"]);
        assert!(clock.elapsed() < Duration::from_secs(20));
    }
}

/// A command in a shell that limits its address space, in kilobytes.
fn limited(place: &Place, kilobytes: u32, command: &str, arguments: &[&str]) -> Done {
    let program = place.command(command, &[]).get_program().to_owned();
    let mut shell = std::process::Command::new("bash");
    shell.args(["-c", &format!("ulimit -v {kilobytes}; exec \"$0\" \"$@\"")]).arg(program);
    let output = shell.args(arguments).current_dir(place.path(".")).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Done { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

#[test]
fn a_run_too_large_for_the_memory_is_refused_with_the_estimate() {
    let place = Place::new();
    let large =
        ["inverse-3d", "--set=fluid.particles_per_side=160", "--set=fluid.smoothing_length=0.0335"];
    let adam = "--set=learn.optimiser={kind='adam',rate=0.1}";
    let runs: [(&str, &[&str]); 5] = [
        ("simulate", &large),
        ("train", &large),
        ("trade", &large),
        ("train", &["inverse-3d", "--set=learn.mesh=406"]),
        ("train", &["inverse-3d", adam, "--set=learn.frames=3000"]),
    ];
    for (command, arguments) in runs {
        let done = limited(&place, 2_000_000, command, &with(arguments, &["--threads=2"]));
        assert_eq!(done.code, Some(2), "{command} {arguments:?}: {}", done.err);
        for part in ["bytes for each of", "of address space (ulimit -v)", "take fewer", "--explain"]
        {
            assert!(done.err.contains(part), "no `{part}` in: {}", done.err);
        }
    }
    // Smaller runs still work.
    let done = limited(&place, 2_000_000, "train", &with(&SHORT, &["--threads=2"]));
    assert_eq!(done.code, Some(0), "{}", done.err);
}

#[test]
fn a_long_job_without_a_terminal_says_how_far_it_is() {
    let place = Place::new();
    let child = running(&place, "train", &LONG, "long.mcap");
    std::thread::sleep(Duration::from_secs(12));
    let err = stopped(child, "-TERM").err;
    let line = err.lines().find(|line| line.starts_with("train: ")).unwrap_or_default();
    for part in [" of 1000000", "loss ", "s so far, about ", " left)"] {
        assert!(line.contains(part), "no `{part}` in: {err}");
    }
    let clock = Instant::now();
    let short = place.run("train", &SHORT);
    let quiet = short.err.is_empty() || clock.elapsed() > Duration::from_secs(10);
    assert!(short.code == Some(0) && quiet, "a short job is quiet: {}", short.err);
}

#[test]
fn a_name_that_is_not_there_yet_is_read_from_what_is_unfinished() {
    let place = Place::new();
    let path = place.path("flow.mcap");
    assert_eq!(readable(&path), path);
    std::fs::write(place.path("flow.unfinished.mcap"), "a").unwrap();
    std::fs::write(place.path("flow.unfinished-2.mcap"), "b").unwrap();
    assert_eq!(readable(&path), place.path("flow.unfinished-2.mcap"));
    Output::write(&path, b"c").unwrap();
    assert_eq!(readable(&path), path);
}
