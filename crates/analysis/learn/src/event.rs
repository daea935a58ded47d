//! Events: something happened to the machine, its thermometers or its probe, that is no slow change of a constant.

use serde::{Deserialize, Serialize};

/// The kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// The reference has moved: a crash, a touch-off, a probe that sits elsewhere.
    ZeroStep,
    /// A constant of the machine file is another one: a new bearing, another screw.
    ConstantChanged,
    /// A thermometer shows another share of the heat.
    ThermometerMoved,
    /// Readings scatter more.
    ScatterGrown,
    /// A backlash grows slowly.
    Wear,
    /// The probe's own calibration drifts, by its checks.
    ProbeDrift,
    /// Something happened that the readings do not name yet.
    Unknown,
}

impl EventKind {
    /// Returns the name as JSON has it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ZeroStep => "zero-step",
            Self::ConstantChanged => "constant-changed",
            Self::ThermometerMoved => "thermometer-moved",
            Self::ScatterGrown => "scatter-grown",
            Self::Wear => "wear",
            Self::ProbeDrift => "probe-drift",
            Self::Unknown => "unknown",
        }
    }

    /// Returns the sentence that says where to look.
    fn inspection_instruction(self) -> &'static str {
        match self {
            Self::ZeroStep => {
                "Was there a crash, or was the reference touched off or moved? Touch off again (Zero). The constants stay, and \
                 readings count from the new zero."
            }
            Self::ConstantChanged => {
                "Was a part changed that this constant belongs to (a bearing, a screw, its preload)? Readings follow the new \
                 constant; measure it again with trueup fit."
            }
            Self::ThermometerMoved => {
                "Does the thermometer still sit where it sat, tight and with its paste? Put it back, or measure its constant again \
                 with trueup fit."
            }
            Self::ScatterGrown => {
                "Is the probe tight and clean, the reference fixed, coolant off it? Repeat one reading ten times."
            }
            Self::Wear => {
                "Does the nut or the belt have play? Measure the backlash (trueup program backlash) and plan the repair."
            }
            Self::ProbeDrift => {
                "The checks against the certified reference drift. They are taken off every reading; have the probe calibrated."
            }
            Self::Unknown => "The readings do not show yet which it is.",
        }
    }
}

/// An event, as the state file and `--json` have it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DetectedEvent {
    /// Its kind.
    pub event: EventKind,
    /// The constant or the temperature column that it belongs to.
    pub constant: Option<String>,
    /// The clock of the first reading after it, in s.
    pub at: Option<f64>,
    /// The clock of the reading by which it was certain, in s.
    pub certain_at: Option<f64>,
    /// Its size in `unit`.
    pub size: f64,
    /// The unit of `size`.
    pub unit: String,
    /// The 95 % interval of `size`.
    pub ci95: [f64; 2],
    /// The check to make, a sentence for the user.
    pub check: String,
    /// Other kinds that explain the readings as well; where there are any, `event` is `unknown`, and they are all of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alternatives: Vec<EventKind>,
    /// The number of the first reading after it.
    pub(crate) sequence: u64,
    /// Its effect on the estimate.
    pub(crate) action: EventAction,
    /// Whether later readings may still change its name and size.
    pub(crate) is_open: bool,
}

/// The effect of an event on the estimate, before the first reading after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum EventAction {
    /// Readings count from a zero that is this many µm higher.
    Zero(f64),
    /// These values change: each by this much, known to a standard deviation.
    Shift(Vec<(usize, f64, f64)>),
    /// Readings scatter this many times as much.
    Scatter(f64),
    /// Nothing.
    Nothing,
}

impl DetectedEvent {
    /// Returns the sentence for the user: what to check, and between which causes the readings do not decide.
    pub(crate) fn advice(kind: EventKind, alternatives: &[EventKind]) -> String {
        if alternatives.is_empty() {
            return kind.inspection_instruction().into();
        }
        let all = alternatives.iter().map(|alternative| {
            format!("{}: {}", alternative.name(), alternative.inspection_instruction())
        });
        let all: Vec<String> = all.collect();
        format!("{} {}", kind.inspection_instruction(), all.join(" "))
    }

    /// Returns the event in one line.
    #[must_use]
    pub fn describe(&self) -> String {
        let of = self.constant.as_ref().map_or(String::new(), |of| format!(" of {of}"));
        let names: Vec<&str> =
            self.alternatives.iter().map(|alternative| alternative.name()).collect();
        let names =
            if names.is_empty() { String::new() } else { format!(" ({})", names.join(" or ")) };
        let at = self.at.map_or(String::new(), |at| format!(" at {}", format_timestamp(at)));
        let certain = self
            .certain_at
            .map_or(String::new(), |at| format!(", certain at {}", format_timestamp(at)));
        let [low, high] = self.ci95.map(round_to_three_digits);
        format!(
            "{}{names}{of}{at}{certain}: {:+} {} ({low:+} to {high:+}). {}",
            self.event.name(),
            round_to_three_digits(self.size),
            self.unit,
            self.check
        )
    }
}

/// Three digits, as a size is known.
pub(crate) fn round_to_three_digits(number: f64) -> f64 {
    format!("{number:.2e}").parse().unwrap_or(number)
}

/// Returns a clock in s: a date where it can only be seconds of Unix, else seconds.
#[must_use]
pub(crate) fn format_timestamp(s: f64) -> String {
    const UNIX_TIME_RANGE_S: std::ops::Range<f64> = 1e9..4e9;
    if !UNIX_TIME_RANGE_S.contains(&s) {
        return format!("{s:.0} s");
    }
    let (days, rest) = ((s / 86_400.0).floor() as i64, s.rem_euclid(86_400.0) as i64);
    // Days to a date, by years that begin in March (Hinnant): the leap day is the last.
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let doe = z.rem_euclid(146_097);
    let yoe = (doe - doe / 1_460 + doe / 36_524 - doe / 146_096) / 365;
    let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
    let mp = (5 * doy + 2) / 153;
    let (day, month) = (doy - (153 * mp + 2) / 5 + 1, if mp < 10 { mp + 3 } else { mp - 9 });
    let year = yoe + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02} UTC", rest / 3600, rest / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_of_unix_is_a_date_and_another_one_seconds() {
        assert_eq!(format_timestamp(1_709_210_096.0), "2024-02-29 12:34 UTC");
        assert_eq!(format_timestamp(86_400.0), "86400 s");
    }
}
