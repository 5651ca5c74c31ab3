//! What is known at the end of a search, in words.

use super::{Knowledge, Stop};

/// Relative residual at or below which the data are exact, and parameters are printed with all
/// their digits.
const EXACT: f64 = 1e-10;

/// Number of decimals of a parameter, maximum.
const DECIMALS: f64 = 12.0;

impl Knowledge {
    /// Whether the residuals are so small that parameters have all their digits.
    pub fn is_exact(&self) -> bool {
        self.stopped_by == Stop::RoundOff
            || self.relative_residual.is_some_and(|residual| residual <= EXACT)
    }

    /// A parameter with its significant digits and its standard error. A parameter that is not
    /// identified is printed as such, not as a result.
    pub fn value(&self, name: &str, value: f64) -> String {
        let error = self.standard_error.get(name).copied();
        match (self.doubts.get(name), error) {
            (Some(doubt), Some(error)) => {
                format!("not identified: {doubt} ({})", with_error(value, error))
            }
            (Some(doubt), None) => format!("not identified: {doubt} (left at {value:.3})"),
            (None, _) if self.is_exact() => format!("{value:.12}"),
            (None, Some(error)) => with_error(value, error),
            (None, None) => format!("{value:.6}"),
        }
    }

    /// Why the search stopped.
    pub fn why_stopped(&self) -> String {
        let percent = |share: f64| format!("{:.2} % of what was observed", 100.0 * share);
        match self.stopped_by {
            Stop::RoundOff => "stopped at round-off".to_owned(),
            Stop::Target => "stopped at the target of the loss (learn.target)".to_owned(),
            Stop::Noise => {
                let mut text =
                    "stopped at the noise of the data, or at what the model leaves out".to_owned();
                if let Some(residual) = self.residual_per_freedom {
                    text += &format!(": residual per degree of freedom {residual:.2e}");
                }
                text + &self
                    .relative_residual
                    .map_or_else(String::new, |r| format!(", {}", percent(r)))
            }
            Stop::Iterations => {
                "stopped at the limit of iterations (learn.iterations), before it came to rest"
                    .to_owned()
            }
            Stop::Stalled => {
                "stopped where no trial lowered the loss, although it is no minimum".to_owned()
            }
        }
    }

    /// Everything except the values: why the search stopped, correlations, missing standard errors,
    /// remarks.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.why_stopped()];
        lines.extend(self.correlated.iter().map(|(a, b, correlation)| {
            format!(
                "{a} and {b} are correlated by {correlation:+.3}: the data tell them apart badly"
            )
        }));
        if let Some(why) = &self.no_standard_error {
            let gradient = self.relative_gradient.map_or_else(String::new, |gradient| {
                format!("; |θ ∂L/∂θ| is {gradient:.1e} of the loss")
            });
            lines.push(format!("no standard errors: {why}{gradient}"));
        }
        lines.extend(self.first_frames.as_ref().map(super::FirstFrames::words));
        lines.extend(self.remarks.iter().cloned());
        lines
    }
}

/// A value with its standard error, to the second digit of the error.
fn with_error(value: f64, error: f64) -> String {
    let place = error.log10().floor();
    if error >= value.abs() * 1e3 || !(1e-4..1e7).contains(&value.abs()) {
        let digits = (value.abs() / error).log10().ceil().clamp(1.0, DECIMALS) as usize;
        return format!("{value:.digits$e} ± {error:.1e}");
    }
    let decimals = (1.0 - place).clamp(0.0, DECIMALS) as usize;
    format!("{value:.decimals$} ± {error:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_printed_to_the_second_digit_of_its_error() {
        assert_eq!(with_error(9.47123456, 0.1234), "9.47 ± 0.12");
        assert_eq!(with_error(1423.7, 31.0), "1424 ± 31");
        assert_eq!(with_error(2.0e-9, 1.5e-11), "2.000e-9 ± 1.5e-11");
        assert_eq!(with_error(0.3, 0.9), "0.30 ± 0.90");
        assert_eq!(with_error(0.0, 0.9), "0.0e0 ± 9.0e-1");
    }

    #[test]
    fn a_parameter_that_is_not_identified_is_never_printed_as_a_result() {
        let doubts = [("beta".to_owned(), "no effect on the loss".to_owned())];
        let knowledge = Knowledge { doubts: doubts.into(), ..Knowledge::default() };
        let text = knowledge.value("beta", 0.532_179_123_456);
        assert_eq!(text, "not identified: no effect on the loss (left at 0.532)");
    }
}
