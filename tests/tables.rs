//! `import` of tracks: every layout becomes the same frames, and what cannot be is refused.

#![allow(clippy::print_stdout, reason = "a test shows what it measured")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;
use crate::small;

use npyz::{AutoSerialize, WriterBuilder};
use place::Place;
use serde_json::Value;
use std::fmt::Write as _;
use std::io::Write as _;
use whirls::kernel::KernelChoice;
use whirls::recording::{Flow, Frame};
use whirls::run::{Import, Origins};
use whirls::tables::{Derive, Tracks};

const FRAMES: usize = 8;
const PARTICLES: usize = 8;
const BOX: f64 = 2.0;
const DT: f64 = 0.125;

/// Particles that oscillate about the corners of a lattice, carried along its diagonal.
fn position(i: usize, t: f64) -> [f64; 3] {
    let corner = [i % 2, i / 2 % 2, i / 4];
    std::array::from_fn(|axis| {
        0.5 + corner[axis] as f64 + 0.25 * (t + (i + axis) as f64).sin() + 0.5 * t
    })
}

fn velocity(i: usize, t: f64) -> [f64; 3] {
    std::array::from_fn(|axis| 0.25 * (t + (i + axis) as f64).cos() + 0.5)
}

/// All particles in all frames: number, frame, position, velocity.
fn all() -> impl Iterator<Item = (usize, usize, [f64; 3], [f64; 3])> {
    let time = |k: usize| k as f64 * DT;
    (0..FRAMES).flat_map(move |k| {
        (0..PARTICLES).map(move |i| (i, k, position(i, time(k)), velocity(i, time(k))))
    })
}

fn write(place: &Place, name: &str, text: &str) {
    std::fs::write(place.path(name), text).unwrap();
}

/// Imports, and compares all frames; `off` is the error allowed of positions and of velocities.
#[track_caller]
fn becomes_the_flow(place: &Place, arguments: &[&str], off: [f64; 2]) -> Value {
    let out = ["--out", "out.mcap", "--overwrite", "--json"];
    let report = place.json("import", &[arguments, &out].concat());
    println!("{report}");
    let recording = place.recording("out.mcap");
    assert_eq!(recording.run().dimension, 3);
    assert_eq!(recording.frame_count(Flow::Truth), FRAMES);
    for k in 0..FRAMES {
        let Frame { time, positions, velocities, .. } = recording.frame(Flow::Truth, k).unwrap();
        assert!((time - k as f64 * DT).abs() < 1e-12, "{time}");
        assert_eq!(positions.len(), PARTICLES);
        for i in 0..PARTICLES {
            for axis in 0..3 {
                let apart = positions[i][axis] - position(i, time)[axis];
                let apart = apart - BOX * (apart / BOX).round();
                assert!(apart.abs() <= off[0], "particle {i}, frame {k}: {apart:e}");
                let slower = velocities[i][axis] - velocity(i, time)[axis];
                assert!(slower.abs() <= off[1], "particle {i}, frame {k}: {slower:e}");
            }
        }
    }
    report
}

/// Positions are printed with six digits, velocities where they are derived from eight frames.
const PRINTED: [f64; 2] = [1e-6, 1e-6];
const DERIVED: [f64; 2] = [1e-6, 1e-2];

const HOW: [&str; 4] = ["--box", "2", "--dt", "0.125"];
const DERIVE: [&str; 2] = ["--velocities", "derive"];

#[test]
fn csv_of_openlpt_by_its_header() {
    let place = Place::new();
    let mut text = "TrackID,FrameID,WorldX,WorldY,WorldZ,cam0_x(col),cam0_y(row)\n".to_owned();
    for (i, k, [x, y, z], _) in all() {
        writeln!(text, "{i},{k},{x:.6},{y:.6},{z:.6},512.25,300.75").unwrap();
    }
    write(&place, "tracks.csv", &text);
    let report = becomes_the_flow(&place, &[&["tracks.csv"], &HOW[..], &DERIVE].concat(), DERIVED);
    let tracks = &report["tracks"];
    assert_eq!(
        (&tracks["rows"], &tracks["longest"], &tracks["gaps"]),
        (&64.into(), &8.into(), &0.into())
    );
    assert!(tracks["dropped"].as_array().unwrap().is_empty());
}

#[test]
fn csv_of_pandas_with_an_index_and_of_spreadsheets_with_semicolons() {
    let place = Place::new();
    let mut pandas = ",z,y,x,frame,particle\n".to_owned();
    let mut sheet = "\u{feff}x [mm];y [mm];z [mm];vx;vy;vz;id;t\r\n".to_owned();
    for (row, (i, k, [x, y, z], [u, v, w])) in all().enumerate() {
        writeln!(pandas, "{row},{z},{y},{x},{}.0,{i}", 10 * k + 7).unwrap();
        write!(sheet, "{x:.9};{y:.9};{z:.9};{u:.9};{v:.9};{w:.9};{i};{}\r\n", k as f64 * DT)
            .unwrap();
    }
    write(&place, "trackpy.csv", &pandas);
    write(&place, "sheet.csv", &sheet);
    // Every tenth frame at ten times the rate.
    let by_tens = ["trackpy.csv", "--box", "2", "--rate", "80Hz", "--velocities", "central"];
    let report = becomes_the_flow(&place, &by_tens, DERIVED);
    assert_eq!(report["tracks"]["stride"], 10);
    becomes_the_flow(&place, &["sheet.csv", "--box", "2x2x2"], PRINTED);
}

#[test]
fn spots_of_trackmate_with_four_lines_of_header() {
    let place = Place::new();
    let mut text = "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME\n\
                    Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame\n\
                    Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame\n\
                    ,,,(quality),(micron),(micron),(micron),(sec),\n"
        .to_owned();
    for (row, (i, k, [x, y, z], _)) in all().enumerate() {
        let t = k as f64 * DT;
        writeln!(text, "ID{row},{},{i},3.5,{x},{y},{z},{t},{k}", 900 + row).unwrap();
    }
    write(&place, "spots.csv", &text);
    becomes_the_flow(&place, &[&["spots.csv", "--box", "2"], &DERIVE[..]].concat(), DERIVED);
}

#[test]
fn text_of_myptv_without_header_raw_and_smoothed() {
    let place = Place::new();
    let (mut smoothed, mut raw) = (String::new(), String::new());
    for (i, k, [x, y, z], [u, v, w]) in all() {
        writeln!(smoothed, "{i}\t{x}\t{y}\t{z}\t{u}\t{v}\t{w}\t0.014\t-0.004\t-0.045\t{k}.000")
            .unwrap();
        writeln!(raw, "{i}\t{x}\t{y}\t{z}\t12\t13\t-1\t0.02\t{k}.000").unwrap();
    }
    raw += "-1\t0.5\t0.5\t0.5\t3\t-1\t4\t0.09\t2.000\n";
    write(&place, "smoothed", &smoothed);
    write(&place, "raw.txt", &raw);
    let columns = ["smoothed", "--columns", "track,x,y,z,u,v,w,...,frame"];
    becomes_the_flow(&place, &[&columns[..], &HOW].concat(), PRINTED);
    let columns = ["raw.txt", "--columns", "track,x,y,z,...,frame"];
    let report = becomes_the_flow(&place, &[&columns[..], &HOW, &DERIVE].concat(), DERIVED);
    let dropped = &report["tracks"]["dropped"][0];
    assert_eq!((&dropped["count"], &dropped["what"]), (&1.into(), &"rows".into()));
    assert!(dropped["why"].as_str().unwrap().contains("not linked"), "{dropped}");
}

#[test]
fn tecplot_with_a_file_a_frame_and_with_a_zone_a_frame() {
    let place = Place::new();
    let mut zones =
        "TITLE = \"all\"\nVARIABLES = \"X\" \"Y\"\n\"Z\" \"U\" \"V\" \"W\" \"PartID\"\n".to_owned();
    let mut names = Vec::new();
    for k in 0..FRAMES {
        let mut file = format!(
            "Title = Snapshot {k}\nVariables = X Y Z PartID\nZone I={PARTICLES}, F=POINT\n"
        );
        writeln!(
            zones,
            "ZONE T=\"{k}\", I={PARTICLES}, DATAPACKING=POINT, SOLUTIONTIME={}",
            k as f64 * DT
        )
        .unwrap();
        for (i, _, [x, y, z], [u, v, w]) in all().filter(|row| row.1 == k) {
            writeln!(file, " {x:.7}  {y:.7}  {z:.7}  {i}").unwrap();
            writeln!(zones, "{x} {y} {z} {u} {v} {w} {i}").unwrap();
        }
        // Without leading zeros, 10 stands before 9 in a list.
        let name = format!("snapshot_{}.dat", k + 5);
        write(&place, &name, &file);
        names.push(name);
    }
    names.sort();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    becomes_the_flow(&place, &[&names[..], &HOW, &DERIVE].concat(), DERIVED);
    write(&place, "zones.dat", &zones);
    becomes_the_flow(&place, &["zones.dat", "--box", "2"], PRINTED);
    write(&place, "block.dat", &zones.replace("=POINT", "=BLOCK"));
    let refused = ["block.dat", "--box", "2", "--out", "o.mcap"];
    place.refuses("import", &refused, &["block.dat, line 4", "DATAPACKING=POINT"]);
}

#[test]
fn links_of_openptv_become_tracks() {
    let place = Place::new();
    let (mut links, mut splines) = (Vec::new(), Vec::new());
    for k in 0..FRAMES {
        // Rows stand in another order in every second frame.
        let order: Vec<usize> =
            (0..PARTICLES).map(|row| if k % 2 == 0 { row } else { PARTICLES - 1 - row }).collect();
        let (mut is, mut xuap) = (format!("{}\n", PARTICLES + 1), format!("{PARTICLES}\n"));
        for &i in &order {
            let t = k as f64 * DT;
            let ([x, y, z], [u, v, w]) = (position(i, t), velocity(i, t));
            let previous = if k == 0 { -1 } else { (PARTICLES - 1 - row_of(&order, i)) as i64 };
            let next =
                if k + 1 == FRAMES { -2 } else { (PARTICLES - 1 - row_of(&order, i)) as i64 };
            writeln!(is, "{previous:4} {next:4} {x:10.7} {y:10.7} {z:10.7}").unwrap();
            writeln!(xuap, "{previous} {next} 9 9 9 {x} {y} {z} {u} {v} {w} 0 0 0 1").unwrap();
        }
        // A particle without links.
        writeln!(is, "  -1   -2  1.0  1.0  1.0").unwrap();
        for (name, text, list) in [("ptv_is", is, &mut links), ("xuap", xuap, &mut splines)] {
            let name = format!("{name}.{}", 10_001 + k);
            write(&place, &name, &text);
            list.push(name);
        }
    }
    let with = |names: &[String], more: &[&str]| -> Vec<String> {
        names.iter().cloned().chain(HOW.iter().chain(more).map(|x| x.to_string())).collect()
    };
    let links = with(&links, &DERIVE);
    let links: Vec<&str> = links.iter().map(String::as_str).collect();
    let report = becomes_the_flow(&place, &links, DERIVED);
    assert_eq!(
        (&report["tracks"]["tracks"], &report["tracks"]["shortest"]),
        (&16.into(), &1.into())
    );
    let splines = with(&splines, &[]);
    let splines: Vec<&str> = splines.iter().map(String::as_str).collect();
    becomes_the_flow(&place, &splines, PRINTED);
    write(&place, "ptv_is.10003", "9\n-1 -2 1 1 1\n");
    let refused = [&links[..], &["--out", "o.mcap"]].concat();
    place.refuses("import", &refused, &["ptv_is.10003", "9 rows", "found 1"]);
}

fn row_of(order: &[usize], particle: usize) -> usize {
    order.iter().position(|i| *i == particle).unwrap()
}

/// An archive as of `numpy.savez`, by crates that `import` does not use.
struct Npz(zip::ZipWriter<std::fs::File>);

impl Npz {
    fn new(place: &Place, name: &str) -> Self {
        Self(zip::ZipWriter::new(std::fs::File::create(place.path(name)).unwrap()))
    }

    fn add<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        numbers: impl IntoIterator<Item = T>,
    ) {
        let deflated = zip::write::SimpleFileOptions::default();
        self.0.start_file(format!("{name}.npy"), deflated).unwrap();
        let mut bytes = Vec::new();
        let options = npyz::WriteOptions::new().default_dtype().shape(shape);
        let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
        writer.extend(numbers).unwrap();
        writer.finish().unwrap();
        self.0.write_all(&bytes).unwrap();
    }
}

#[test]
fn archives_of_numpy_with_columns_and_with_stacked_arrays() {
    let place = Place::new();
    let rows = [(FRAMES * PARTICLES) as u64];
    let mut long = Npz::new(&place, "long.npz");
    long.add("particle", &rows, all().map(|row| row.0 as i32));
    long.add("frame", &rows, all().map(|row| row.1 as u16));
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        long.add(name, &rows, all().map(move |row| row.2[axis]));
    }
    long.0.finish().unwrap();
    becomes_the_flow(&place, &[&["long.npz"], &HOW[..], &DERIVE].concat(), DERIVED);
    let shape = [FRAMES as u64, PARTICLES as u64, 3];
    let mut stacked = Npz::new(&place, "stacked.npz");
    stacked.add("position", &shape, all().flat_map(|row| row.2.map(|x| x as f32)));
    stacked.add("velocity", &shape, all().flat_map(|row| row.3));
    stacked.add("dt", &[], [DT]);
    stacked.add("box", &[], [BOX]);
    stacked.0.finish().unwrap();
    becomes_the_flow(&place, &["stacked.npz"], PRINTED);
    let mut other = Npz::new(&place, "other.npz");
    other.add("x", &[4, 2], [0_i8; 8]);
    other.0.finish().unwrap();
    let refused = [&["other.npz", "--out", "o.mcap"], &DERIVE[..]].concat();
    place.refuses("import", &refused, &["other.npz", "columns"]);
}

#[test]
fn an_array_of_positions_gets_derived_velocities() {
    let place = Place::new();
    let shape = [FRAMES as u64, PARTICLES as u64, 3];
    std::fs::write(place.path("r.npy"), small::npy(&shape, all().flat_map(|row| row.2))).unwrap();
    let given = [&["--positions", "r.npy"], &HOW[..], &DERIVE].concat();
    becomes_the_flow(&place, &given, DERIVED);
    becomes_the_flow(&place, &[&["r.npy"], &HOW[..], &DERIVE].concat(), DERIVED);
}

/// The files of `tests/tables/make.py`, by h5py.
#[cfg(feature = "hdf5")]
#[test]
fn hdf5_of_lagrangebench_and_of_flowtracks() {
    let place = Place::new();
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tables");
    let train = format!("{folder}/lagrangebench/train.h5");
    let report = becomes_the_flow(&place, &[&[&*train], &DERIVE[..]].concat(), DERIVED);
    assert_eq!(report["sides"], serde_json::json!([BOX, BOX, BOX]));
    let other = ["--trajectory", "00002", "--out", "o.mcap"];
    let refused = [&[&*train], &DERIVE[..], &other].concat();
    place.refuses("import", &refused, &["--trajectory", "00000 to 00001"]);
    let tracks = format!("{folder}/flowtracks.h5");
    becomes_the_flow(&place, &[&[&*tracks], &HOW[..]].concat(), [1e-12; 2]);
    let metadata =
        std::fs::read_to_string(format!("{folder}/lagrangebench/metadata.json")).unwrap();
    std::fs::copy(&train, place.path("walls.h5")).unwrap();
    write(&place, "metadata.json", &metadata.replacen("true", "false", 1));
    let refused = [&["walls.h5", "--out", "o.mcap"], &DERIVE[..]].concat();
    place.refuses("import", &refused, &["metadata.json", "no walls", "--crop"]);
}

/// The small flow in millimetres and milliseconds, 100 mm wide, with births, deaths and gaps, and
/// without velocities.
fn measured(place: &Place) -> usize {
    let flow = small::truth();
    let scale = 100.0 / std::f64::consts::TAU;
    let mut text = "track,frame,x,y\n".to_owned();
    let mut single_gaps = 0;
    for (k, state) in flow.states.iter().enumerate() {
        for (i, r) in state.positions.iter().enumerate() {
            let born_later = i % 9 == 0 && k < 2;
            let dead = i % 9 == 1 && k > 8;
            let gap = i % 9 == 2 && k == 5;
            single_gaps += usize::from(gap);
            if !(born_later || dead || gap) {
                let [x, y] = r.0.map(|x| scale * x - 50.0);
                writeln!(text, "{},{},{x:.9},{y:.9}", i + 1, k + 300).unwrap();
            }
        }
    }
    write(place, "tracks.csv", &text);
    single_gaps
}

const MEASURED: [&str; 8] =
    ["tracks.csv", "--units", "mm", "--rate", "1kHz", "--box", "100", "--velocities"];

#[test]
fn tracks_in_millimetres_with_births_deaths_and_gaps_are_imported_and_learned_from() {
    let place = Place::new();
    let gaps = measured(&place);
    let whole = ["derive", "--frames", "302..308", "--fill-gaps", "--scene", "mine.toml"];
    let out = ["--out", "truth.mcap", "--json"];
    let report = place.json("import", &[&MEASURED, &whole[..], &out].concat());
    println!("{report}");
    let tracks = &report["tracks"];
    assert_eq!((&report["particles"], &report["frames"]), (&64.into(), &7.into()));
    assert_eq!((&tracks["single_frame_gaps"], &tracks["filled"]), (&gaps.into(), &gaps.into()));
    assert!((report["sides"][0].as_f64().unwrap() - 0.1).abs() < 1e-15);
    assert!((report["dt"].as_f64().unwrap() - 1e-3).abs() < 1e-15);

    let train = ["mine.toml", "--truth", "truth.mcap", "--record", "learned.mcap", "--json"];
    let two = ["--set", "learn.iterations=2"];
    let done = place.run("train", &[&train[..], &two].concat());
    println!("{}{}", done.out, done.err);
    assert_eq!(done.code, Some(0), "{}", done.err);
    let steps = place.recording("learned.mcap").train_steps().unwrap();
    assert_eq!(steps.last().unwrap().iteration, 2);
    let losses: Vec<f64> = steps.iter().map(|step| step.loss).collect();
    assert!(losses.iter().all(|loss| loss.is_finite()), "{losses:?}");
    assert!(losses[2] < losses[0], "{losses:?}");
}

#[test]
fn the_range_that_keeps_most_is_taken_and_the_rest_is_accounted_for() {
    let place = Place::new();
    measured(&place);
    let given = ["derive", "--out", "truth.mcap", "--json", "--force"];
    let done = place.run("import", &[&MEASURED, &given[..]].concat());
    println!("{}", done.out);
    let report: Value = serde_json::from_str(done.out.lines().last().unwrap()).unwrap();
    let tracks = &report["tracks"];
    let kept = tracks["kept_tracks"].as_u64().unwrap();
    let dropped = tracks["dropped"].as_array().unwrap();
    let lost: u64 = dropped.iter().map(|row| row["count"].as_u64().unwrap()).sum();
    assert_eq!(kept + lost, tracks["tracks"].as_u64().unwrap());
    // All eleven frames keep 64 − 8 − 7 − 7 tracks: their 420 steps of particles are the most.
    assert_eq!((kept, &tracks["kept_frames"]), (42, &serde_json::json!([300, 310])));
    for part in
        ["42 tracks that are seen in all of them", "that begin after frame 300", "seeding", "noise"]
    {
        assert!(done.out.contains(part), "no `{part}` in: {}", done.out);
    }
}

#[test]
fn a_cropped_cube_is_the_box_and_what_is_outside_is_dropped() {
    let place = Place::new();
    let mut text = "track frame x y z u v w\n".to_owned();
    for (i, k, [x, y, z], [u, v, w]) in all() {
        writeln!(text, "{i} {k} {} {} {} {u} {v} {w}", x + 10.0, y - 5.0, z).unwrap();
        writeln!(text, "{} {k} {} {} {} {u} {v} {w}", i + 100, x + 20.0, y, z).unwrap();
    }
    write(&place, "wide.txt", &text);
    let crop = [
        "wide.txt",
        "--dt",
        "0.125",
        "--crop",
        "10:14,-5:-1,0:3",
        "--out",
        "o.mcap",
        "--json",
        "--force",
    ];
    let report = place.json("import", &crop);
    assert_eq!(report["sides"], serde_json::json!([4.0, 4.0, 3.0]));
    assert_eq!(report["particles"], 8);
    assert_eq!(report["tracks"]["origin"], serde_json::json!([10.0, -5.0, 0.0]));
    let frame = place.recording("o.mcap").frame(Flow::Truth, 3).unwrap();
    for (i, found) in frame.positions.iter().enumerate() {
        let wanted = position(i, 3.0 * DT);
        assert!((0..3).all(|axis| (found[axis] - wanted[axis]).abs() < 1e-12), "{i}");
    }
    assert_eq!(place.recording("o.mcap").run().sides, [4.0, 4.0, 3.0]);
}

#[test]
fn open_axes_have_the_extent_of_the_positions_and_no_images() {
    let place = Place::new();
    let mut text = "track,frame,x,y,z\n".to_owned();
    for (i, k, [x, y, z], _) in all() {
        writeln!(text, "{i},{k},{},{},{}", 1e3 * x - 700.0, 1e3 * y, 1e3 * z).unwrap();
    }
    write(&place, "t.csv", &text);
    let how =
        ["t.csv", "--units", "mm", "--dt", "0.125", "--boundary", "open", "--scene", "mine.toml"];
    let report =
        place.json("import", &[&how[..], &DERIVE, &["--out", "o.mcap", "--json"]].concat());
    let recording = place.recording("o.mcap");
    let low: Vec<f64> = serde_json::from_value(report["tracks"]["origin"].clone()).unwrap();
    for k in 0..FRAMES {
        let frame = recording.frame(Flow::Truth, k).unwrap();
        for (i, found) in frame.positions.iter().enumerate() {
            let wanted = position(i, k as f64 * DT);
            let shift = [-0.7, 0.0, 0.0];
            assert!((0..3).all(|axis| {
                (found[axis] + low[axis] - wanted[axis] - shift[axis]).abs() < 1e-12
            }));
        }
    }
    assert_eq!(recording.run().boundary, [whirls::space::Axis::Open; 3]);
    let scene = std::fs::read_to_string(place.path("mine.toml")).unwrap();
    assert!(scene.contains("boundary = [\"open\", \"open\", \"open\"]"), "{scene}");
    // The scene is one that runs: sides are whole numbers of spacings.
    whirls::Scene::parse(&scene, "mine.toml", &[]).unwrap();
}

#[test]
fn tables_that_do_not_say_enough_are_refused_with_what_to_type() {
    let place = Place::new();
    let mut text = "particle,frame,x,y,z\n".to_owned();
    for (i, k, [x, y, z], _) in all() {
        writeln!(text, "{i},{k},{x},{y},{z}").unwrap();
    }
    write(&place, "t.csv", &text);
    let refuses = |arguments: &[&str], parts: &[&str]| {
        let arguments = [arguments, &["--out", "o.mcap"]].concat();
        println!("{}", place.run("import", &arguments).err);
        place.refuses("import", &arguments, parts);
        assert!(!place.path("o.mcap").exists());
    };
    refuses(&["t.csv", "--dt", "1"], &["--velocities derive"]);
    refuses(&["t.csv", "--velocities", "derive"], &["--rate 1000Hz"]);
    let derived = ["t.csv", "--dt", "1", "--velocities", "derive"];
    let with = |more: &[&'static str]| [&derived[..], more].concat();
    refuses(&with(&["--units", "mm"]), &["positions within", "--crop"]);
    refuses(&with(&["--units", "px"]), &["\"px\"", "calibrated"]);
    refuses(&with(&["--box", "1x2"]), &["--box", "one for all axes, or 3"]);
    refuses(&with(&["--box", "1x-2x1"]), &["--box", "positive"]);
    refuses(&with(&["--frames", "3..99"]), &["--frames", "0..7"]);
    refuses(&with(&["--columns", "track,frame,x,y,z,u"]), &["--columns", "at most 5 names"]);
    refuses(&with(&["--columns", "x=X_um"]), &["X_um", "particle, frame, x, y, z"]);
    refuses(&with(&["--format", "excel"]), &["excel", "tecplot"]);
    let broken =
        |name: &str, from: &str, to: &str| write(&place, name, &text.replacen(from, to, 1));
    broken("t.csv", "\n3,2,", "\n3,2,oops,");
    refuses(&derived, &["t.csv, line 21", "a number in column 3", "oops"]);
    broken("t.csv", "\n3,2,", "\n4,2,");
    refuses(&derived, &["track 4", "two rows in frame 2"]);
    write(&place, "t.csv", "a,b,c\n1,2,3\n");
    refuses(&derived, &["columns x and y", "--columns track,frame,x,y,z"]);
    write(&place, "t.csv", "not a table\n");
    refuses(&derived, &["rows of numbers"]);
    write(&place, "t.csv", "id,t,x,y\n0,0,1,1\n0,0.1,1,1\n0,0.2,1,1\n0,0.34,1,1\n0,0.4,1,1\n");
    refuses(&["t.csv", "--velocities", "derive"], &["whole multiples", "after"]);
}

/// Reads a file of that name with these bytes; a value or an error, and no panic.
fn reads(place: &Place, name: &str, bytes: &[u8]) -> bool {
    std::fs::write(place.path(name), bytes).unwrap();
    let tracks = Tracks {
        files: vec![place.path(name)],
        derive: Some(Derive::Central),
        ..Tracks::default()
    };
    let import = Import {
        from: Origins::Tracks(Box::new(tracks)),
        dt: Some(DT),
        sides: vec![BOX],
        boundary: Vec::new(),
        smoothing_length: None,
        kernel: KernelChoice::CubicSpline,
        force: true,
        out: whirls::output::Output::beside(&place.path("out.mcap")).unwrap(),
    };
    import.run().is_ok()
}

#[test]
fn a_damaged_table_gives_a_value_or_an_error() {
    let place = Place::new();
    let mut text = "track,frame,x,y,z\n".to_owned();
    let mut tecplot = "Variables = X Y Z PartID\n".to_owned();
    for (i, k, [x, y, z], _) in all() {
        writeln!(text, "{i},{k},{x:.4},{y:.4},{z:.4}").unwrap();
        if i == 0 {
            writeln!(tecplot, "Zone I={PARTICLES}, F=POINT").unwrap();
        }
        writeln!(tecplot, "{x:.4} {y:.4} {z:.4} {i}").unwrap();
    }
    let mut archive = Npz::new(&place, "a.npz");
    let shape = [FRAMES as u64, PARTICLES as u64, 3];
    archive.add("positions", &shape, all().flat_map(|row| row.2));
    archive.0.finish().unwrap();
    let mut files = vec![
        ("t.csv", text.into_bytes()),
        ("t.dat", tecplot.into_bytes()),
        ("a.npz", std::fs::read(place.path("a.npz")).unwrap()),
    ];
    if cfg!(feature = "hdf5") {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tables");
        files.push(("l.h5", std::fs::read(format!("{folder}/lagrangebench/train.h5")).unwrap()));
        files.push(("f.h5", std::fs::read(format!("{folder}/flowtracks.h5")).unwrap()));
    }
    let mut state = 1_u64;
    let mut draw = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) as usize % below
    };
    for (name, whole) in &files {
        assert!(reads(&place, name, whole), "{name}");
        for _ in 0..150 {
            let mut bytes = whole.clone();
            match draw(3) {
                0 => bytes.truncate(draw(whole.len())),
                1 => bytes[draw(whole.len())] = draw(256) as u8,
                _ => {
                    let at = draw(whole.len() - 8);
                    bytes[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
                }
            }
            reads(&place, name, &bytes);
        }
    }
}
