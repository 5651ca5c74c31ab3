//! Units of a table: factors to metres, metres per second and seconds.

use crate::error::{Error, Result};

/// Units of lengths, in metres.
const LENGTHS: [(&str, f64); 8] = [
    ("m", 1.0),
    ("cm", 1e-2),
    ("mm", 1e-3),
    ("um", 1e-6),
    ("µm", 1e-6),
    ("nm", 1e-9),
    ("km", 1e3),
    ("in", 0.0254),
];

/// Units of times, in seconds.
const TIMES: [(&str, f64); 6] =
    [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("min", 60.0)];

/// Units of the numbers in a table; without any, numbers are taken as they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Units {
    /// Metres in one unit of length.
    pub length: f64,
    /// Metres per second in one unit of velocity; `None` where velocities are lengths per frame.
    pub velocity: Option<f64>,
    /// Seconds in one unit of time.
    pub time: f64,
    /// The text that was given; empty for none.
    pub text: String,
}

impl Default for Units {
    fn default() -> Self {
        Self { length: 1.0, velocity: Some(1.0), time: 1.0, text: String::new() }
    }
}

impl Units {
    /// Units from a text such as `mm`, `mm,m/s`, `mm,mm/frame` or `mm,m/s,ms`: of lengths, of
    /// velocities (by default lengths per second) and of the column of times (by default seconds).
    ///
    /// # Errors
    /// [`Error::Input`] for a unit that is not known.
    pub fn parse(text: &str) -> Result<Self> {
        let mut units = Self { text: text.to_owned(), ..Self::default() };
        let mut velocity = None;
        for part in text.split(',').map(str::trim) {
            match part.split_once('/') {
                Some(ratio) => velocity = Some(ratio),
                None => match (factor(&LENGTHS, part), factor(&TIMES, part)) {
                    (Some(length), _) => units.length = length,
                    (_, Some(time)) => units.time = time,
                    _ => return Err(unknown(part)),
                },
            }
        }
        units.velocity = match velocity {
            None => Some(units.length),
            Some((length, "frame")) if factor(&LENGTHS, length) == Some(units.length) => None,
            Some((length, time)) => match (factor(&LENGTHS, length), factor(&TIMES, time)) {
                (Some(length), Some(time)) => Some(length / time),
                _ => return Err(unknown(&format!("{length}/{time}"))),
            },
        };
        Ok(units)
    }

    /// Metres per second in one unit of velocity, for frames `dt` seconds apart.
    pub fn speed(&self, dt: f64) -> f64 {
        self.velocity.unwrap_or(self.length / dt)
    }
}

fn factor(table: &[(&str, f64)], name: &str) -> Option<f64> {
    table.iter().find(|(known, _)| *known == name).map(|(_, factor)| *factor)
}

fn unknown(found: &str) -> Error {
    let expected = "a unit of length (m, cm, mm, um, nm, km, in), of velocity (mm/s, m/s, mm/frame, …) or of time \
                    (s, ms, us, ns, min)";
    let remedy = "pixels have to be calibrated first; leave --units out for numbers without a unit";
    Error::input("--units", expected, format!("{found:?}"), remedy)
}

/// Seconds between frames from a rate such as `1000`, `1000Hz` or `2.5kHz`.
///
/// # Errors
/// [`Error::Input`] for a rate that is no positive number.
pub fn interval_of_rate(text: &str) -> Result<f64> {
    let lower = text.trim().to_ascii_lowercase();
    let (number, factor) = match (lower.strip_suffix("khz"), lower.strip_suffix("hz")) {
        (Some(number), _) => (number, 1e3),
        (None, Some(number)) => (number, 1.0),
        (None, None) => (lower.as_str(), 1.0),
    };
    match number.trim().parse::<f64>() {
        Ok(rate) if rate > 0.0 && rate.is_finite() => Ok(1.0 / (rate * factor)),
        _ => {
            let expected = "frames per second, such as 1000Hz or 2.5kHz";
            Err(Error::input("--rate", expected, format!("{text:?}"), "give a positive number"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_factors_to_metres_and_seconds() {
        let near = |found: f64, wanted: f64| (found - wanted).abs() <= 1e-15 * wanted;
        let units = Units::parse("mm, m/s, ms").unwrap();
        assert!(near(units.length, 1e-3) && near(units.time, 1e-3) && near(units.speed(0.1), 1.0));
        assert!(near(Units::parse("mm").unwrap().speed(0.1), 1e-3));
        assert!(near(Units::parse("mm,mm/frame").unwrap().speed(0.5), 2e-3));
        assert!(near(interval_of_rate("2.5kHz").unwrap(), 4e-4));
        for text in ["px", "mm,px/s", "mm,m/frame"] {
            assert!(Units::parse(text).unwrap_err().to_string().contains("calibrated"), "{text}");
        }
        assert!(interval_of_rate("-1Hz").is_err());
    }
}
