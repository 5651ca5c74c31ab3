//! The known name that is most like a misspelt one.

/// Similarity (Jaro–Winkler, 1 for equal words) above which a name is suggested.
const ALIKE: f64 = 0.8;

/// Names of other programs for keys of a scene.
const SYNONYMS: [(&str, &str); 6] = [
    ("width", "height"),
    ("units", "height"),
    ("neighbours", "nearest"),
    ("neighbors", "nearest"),
    ("h", "smoothing_length"),
    ("n", "particles_per_side"),
];

/// The known name that is most like a word; none if all are unlike it.
pub(super) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let meant = SYNONYMS.iter().find(|(name, _)| *name == word).map(|(_, meant)| *meant);
    let alike = |name: &'a str| match meant {
        Some(meant) if meant == name => (1.0, name),
        _ => (strsim::jaro_winkler(word, name), name),
    };
    let best = known.into_iter().map(alike).max_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(likeness, _)| *likeness > ALIKE).map(|(_, name)| name)
}

/// The name that a message of an unknown key or kind means: the words in backquotes are the one found, then those
/// that are known.
pub(super) fn meant(message: &str) -> Option<&str> {
    if !message.starts_with("unknown ") {
        return None;
    }
    let mut words = message.split('`').skip(1).step_by(2);
    nearest(words.next()?, words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_name_and_a_name_of_other_programs_are_understood() {
        let known = ["alpha", "beta", "gamma"];
        assert_eq!(nearest("alfa", known), Some("alpha"));
        assert_eq!(nearest("viscosity", known), None);
        let message = "unknown field `width`, expected one of `height`, `scales`";
        assert_eq!(meant(message), Some("height"));
        assert_eq!(meant("missing field `alpha`"), None);
    }
}
