//! Promises of `replay --html`: a page for recordings of every command, in one file.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use place::Place;
use serde_json::Value;

/// A page, and the data of its slice.
fn page(place: &Place, recording: &str, more: &[&str]) -> (String, Value) {
    let arguments = [&[recording, "--html", "page.html", "--json"], more].concat();
    let report = place.json("replay", &arguments);
    let html = std::fs::read_to_string(place.path("page.html")).unwrap();
    assert_eq!(report["bytes"], Value::from(html.len()));
    for outside in ["src=", "@import", "url(", "<link", "http://", "fetch("] {
        let without_names = html.replace("http://www.w3.org/2000/svg", "");
        assert!(!without_names.contains(outside), "{outside}");
    }
    let data = html.split("id=\"slice-data\">").nth(1).unwrap().split("</script>").next().unwrap();
    (html.clone(), serde_json::from_str(data).unwrap())
}

/// Bytes that a text in Base64 stands for, padding included.
fn decoded_length(text: &Value) -> usize {
    let text = text.as_str().unwrap();
    3 * text.len() / 4 - text.bytes().filter(|letter| *letter == b'=').count()
}

/// Channels that were found, as `flow quantity difference`, each with a code for every frame and node.
fn channels(slice: &Value, frames: usize) -> Vec<String> {
    let nodes = slice["nodes"][0].as_u64().unwrap() * slice["nodes"][1].as_u64().unwrap();
    let described = |channel: &Value| {
        assert_eq!(decoded_length(&channel["codes"]), frames * nodes as usize);
        assert!(channel["range"].as_f64().unwrap() > 0.0);
        format!(
            "{} {} {}",
            channel["flow"],
            channel["quantity"].as_str().unwrap(),
            channel["difference"]
        )
    };
    slice["channels"].as_array().unwrap().iter().map(described).collect()
}

#[test]
fn the_page_of_a_training_has_its_search_and_both_flows_with_their_difference() {
    let place = Place::new();
    place.json("train", &["small.toml", "--json", "--record", "learned.mcap"]);
    let (html, slice) = page(&place, "learned.mcap", &[]);
    assert_eq!(slice["flows"], Value::from(vec!["truth", "learned"]));
    assert_eq!(slice["moments"].as_array().unwrap().len(), 5);
    let expected = [
        "0 vorticity false",
        "0 speed false",
        "1 vorticity false",
        "1 vorticity true",
        "1 speed false",
        "1 speed true",
    ];
    assert_eq!(channels(&slice, 5), expected);
    // A learned flow that is the true one to round-off, from the first frame on.
    let difference = &slice["channels"][5];
    assert_eq!(difference["there"], Value::from(vec![true; 5]));
    assert!(difference["range"].as_f64().unwrap() < 1e-6, "{}", difference["range"]);
    assert!(slice["height"].as_f64().is_some());
    for figure in
        ["loss", "parameters", "errors", "difference", "u-rms", "spectrum", "energy", "momentum"]
    {
        assert!(html.contains(&format!("<figure id=\"{figure}\"")), "{figure}");
    }
    for words in ["window of 1 frame", "over 4 frames", "id=\"learned\"", "eddy time"] {
        assert!(html.contains(words), "{words}");
    }
}

#[test]
fn every_page_says_which_frames_it_has_and_equal_recordings_have_equal_pages() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let (all, slice) = page(&place, "flow.mcap", &[]);
    assert_eq!(slice["flows"], Value::from(vec!["flow"]));
    assert_eq!(channels(&slice, 7), ["0 vorticity false", "0 speed false"]);
    let (again, _) = page(&place, "flow.mcap", &[]);
    assert!(all == again, "the same recording");
    let (_, fewer) = page(&place, "flow.mcap", &["--every", "4"]);
    let steps =
        fewer["moments"].as_array().unwrap().iter().map(|now| now["step"].as_u64().unwrap());
    assert_eq!(steps.collect::<Vec<_>>(), [0, 4, 6]);
}

#[test]
fn tracers_of_a_direct_numerical_simulation_have_a_page_with_its_numbers_and_spectrum() {
    let place = Place::new();
    std::fs::write(place.path("dns.toml"), crate::dns_scenes::SMALL_DNS).unwrap();
    place.json("simulate", &["dns.toml", "--json", "--record", "dns.mcap"]);
    let (html, slice) = page(&place, "dns.mcap", &[]);
    assert_eq!(slice["height"], Value::Null);
    assert_eq!(channels(&slice, 4), ["0 vorticity false", "0 speed false"]);
    for figure in ["recorded-energies", "recorded-reynolds", "recorded-spectrum"] {
        assert!(html.contains(&format!("<figure id=\"{figure}\"")), "{figure}");
    }
}

#[test]
fn learned_flows_of_an_evaluation_are_compared_with_the_truth_one_by_one() {
    let place = Place::new();
    for (name, more) in [("a.mcap", "c=9.0"), ("b.mcap", "c=10.0")] {
        let guess = format!("--set=learn.guess={{{more},alpha=1.0,beta=2.0,gamma=7.0}}");
        let options =
            ["small.toml", "--json", "--set=learn.iterations=0", &guess, "--record", name];
        place.json("train", &options);
    }
    let options =
        ["a.mcap", "b.mcap", "--quick", "--steps", "8", "--every", "4", "--out", "e", "--json"];
    place.json("evaluate", &options);
    let (html, slice) = page(&place, "e/evaluation.mcap", &[]);
    assert_eq!(slice["flows"][0], Value::from("truth"));
    assert_eq!(slice["flows"].as_array().unwrap().len(), 3);
    let frames = slice["moments"].as_array().unwrap().len();
    assert_eq!(channels(&slice, frames).len(), 10);
    assert!(html.contains("data-part=\"flow\"") && html.contains("<figure id=\"errors-field\""));
}

#[test]
fn what_is_left_of_a_recording_has_a_page_and_what_has_none_is_refused() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let bytes = std::fs::read(place.path("flow.mcap")).unwrap();
    std::fs::write(place.path("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).unwrap();
    let done = place.run("replay", &["cut.mcap", "--html", "cut.html"]);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.err.contains("replay --recover cut.mcap"), "{}", done.err);
    let html = std::fs::read_to_string(place.path("cut.html")).unwrap();
    assert!(html.contains("cut short"));

    place.refuses("replay", &["flow.mcap", "--html", "flow.mcap"], &["ends in .html"]);
    place.refuses("replay", &["flow.mcap", "flow.mcap", "--html", "page.html"], &["one recording"]);
    place.refuses("replay", &["flow.mcap", "--every", "2"], &["--html"]);
    assert!(!place.path("page.html").exists());
    assert_eq!(std::fs::read(place.path("flow.mcap")).unwrap(), bytes);
}
