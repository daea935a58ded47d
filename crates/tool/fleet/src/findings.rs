//! Constants with their errors, out of a `diagnosis.json`.
//!
//! A constant is one parameter of one cause, on one column, of one quantity. A time constant or a period is known by
//! ratios: its logarithm has the symmetric interval, and is what is pooled.

use serde_json::Value;

use crate::random_effects::{Estimate, NORMAL_QUANTILE_975};

/// Parameters of what happened once, in one record: no constants of a machine.
const EVENT_PARAMETERS: &[&str] =
    &["at_s", "size_um", "um_per_h", "um_per_run", "fraction", "duration_s", "shift_s"];
/// Parameters that are known by ratios.
const LOG_SCALE_PARAMETERS: &[&str] = &["time_constant_s", "period_mm", "period_s"];
/// Parameters that are 1 where a cause does nothing.
const GAIN_PARAMETERS: &[&str] = &["gain", "scale", "factor"];
/// Parameters whose value without the cause is what the machine file says: no value says that there is none.
const PARAMETERS_WITHOUT_NEUTRAL_VALUE: &[&str] =
    &["time_constant_s", "lag_s", "period_mm", "period_s"];

/// A parameter of a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatedConstant {
    /// Its name, with its unit.
    pub parameter: String,
    /// Its value, or the logarithm of it.
    pub estimate: Estimate,
}

/// A cause, its column and its form.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CauseIdentity {
    /// The cause.
    pub cause: String,
    /// Its column.
    pub column: Option<String>,
    /// Its form.
    pub form: Option<String>,
}

impl CauseIdentity {
    /// Returns the name of a finding of it.
    #[must_use]
    pub fn name(&self, quantity: &str) -> String {
        let words = [Some(&self.cause), self.column.as_ref(), self.form.as_ref()];
        words
            .into_iter()
            .flatten()
            .fold(quantity.to_string(), |name, word| format!("{name} {word}"))
    }
}

/// A finding of a diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedFinding {
    /// Quantity, cause, and what else distinguishes it from another finding: `dz extra-heat-path temp_bed_c`.
    pub name: String,
    /// What names it to the diagnosis of another machine; none where it is more than that: a range, or two columns.
    pub identity: Option<CauseIdentity>,
    /// True if it is claimed.
    pub claimed: bool,
    /// RMS in µm that it explains.
    pub explains_um: f64,
    /// Its constants.
    pub constants: Vec<EstimatedConstant>,
    /// Names of the causes that these data do not separate from it.
    pub alternatives: Vec<String>,
}

/// A difference of scores below which two causes are not separated (a BIC difference).
const MIN_BIC_DIFFERENCE: f64 = 6.0;

/// Returns whether a parameter is known by ratios.
#[must_use]
pub(crate) fn is_log_scaled(parameter: &str) -> bool {
    LOG_SCALE_PARAMETERS.contains(&parameter)
}

/// Returns the value of a parameter where its cause does nothing; none where that is not known.
#[must_use]
pub(crate) fn neutral_value(parameter: &str) -> Option<f64> {
    match parameter {
        it if PARAMETERS_WITHOUT_NEUTRAL_VALUE.contains(&it) => None,
        it if GAIN_PARAMETERS.contains(&it) => Some(1.0),
        _ => Some(0.0),
    }
}

/// Returns the findings of a diagnosis.
#[must_use]
pub fn parse_findings(diagnosis: &Value) -> Vec<NamedFinding> {
    let quantity = diagnosis["quantity"].as_str().unwrap_or_default();
    let findings = diagnosis["findings"].as_array();
    let findings = findings.into_iter().flatten();
    findings.flat_map(|finding| parse_finding(quantity, finding)).collect()
}

/// A finding, and those that are only certain together with it.
fn parse_finding(quantity: &str, finding: &Value) -> Vec<NamedFinding> {
    let claimed = finding["claimed"].as_bool().unwrap_or(false);
    let gain = |key: &str| finding["gain"][key].as_f64().unwrap_or(f64::NAN);
    let explained = gain("rms_before_um").powi(2) - gain("rms_after_um").powi(2);
    let alternative_fits = finding["rivals"].as_array();
    let is_open = |rival: &&Value| {
        rival["score_gap"].as_f64().is_some_and(|value| value < MIN_BIC_DIFFERENCE)
    };
    let alternatives = alternative_fits.into_iter().flatten().filter(is_open);
    let alternatives: Vec<String> =
        alternatives.map(|alternative| finding_name(quantity, alternative)).collect();
    let one = |of: &Value, alternatives: Vec<String>| NamedFinding {
        name: finding_name(quantity, of),
        identity: parse_cause_identity(of),
        claimed,
        explains_um: explained.max(0.0).sqrt(),
        constants: parse_constants(&of["parameters"]),
        alternatives,
    };
    let partners = finding["together_with"].as_array();
    let partners: Vec<NamedFinding> =
        partners.into_iter().flatten().map(|partner| one(partner, Vec::new())).collect();
    let mut all = vec![one(finding, alternatives)];
    all.extend(partners);
    all
}

fn parse_cause_identity(of: &Value) -> Option<CauseIdentity> {
    let is_more = ["columns", "where", "times"].iter().any(|key| !of[key].is_null());
    let owned = |key: &str| of[key].as_str().map(String::from);
    let identity =
        CauseIdentity { cause: owned("cause")?, column: owned("column"), form: owned("form") };
    (!is_more).then_some(identity)
}

fn string_field<'v>(of: &'v Value, key: &str) -> &'v str {
    of[key].as_str().unwrap_or_default()
}

/// Returns what distinguishes a finding from others.
fn finding_name(quantity: &str, of: &Value) -> String {
    let mut name = format!("{quantity} {}", string_field(of, "cause"));
    let mut add = |word: &str| {
        if !word.is_empty() {
            name.push(' ');
            name.push_str(word);
        }
    };
    match of["columns"].as_array() {
        Some(columns) => columns.iter().filter_map(Value::as_str).for_each(&mut add),
        None => add(string_field(of, "column")),
    }
    add(string_field(of, "form"));
    add(string_field(of, "times"));
    if let Some(column) = of["where"]["column"].as_str() {
        add("where");
        add(column);
        add(if of["where"]["above"].is_number() { "above" } else { "below" });
    }
    name
}

fn parse_constants(parameters: &Value) -> Vec<EstimatedConstant> {
    let all = parameters.as_object().into_iter().flatten();
    all.filter(|(name, _)| !EVENT_PARAMETERS.contains(&name.as_str()))
        .filter_map(|(name, value)| {
            let number = value["value"].as_f64()?;
            let [low, high] = [0, 1].map(|end| value["ci95"][end].as_f64());
            let estimate = estimate_from_interval(name, number, [low?, high?])?;
            Some(EstimatedConstant { parameter: name.clone(), estimate })
        })
        .collect()
}

/// Returns a value with its error out of its interval; none where the interval has no width, or no end.
fn estimate_from_interval(parameter: &str, value: f64, [low, high]: [f64; 2]) -> Option<Estimate> {
    let estimate = if is_log_scaled(parameter) {
        if !(low > 0.0 && value > 0.0) {
            return None;
        }
        Estimate { value: value.ln(), se: (high / low).ln() / (2.0 * NORMAL_QUANTILE_975) }
    } else {
        Estimate { value, se: (high - low) / (2.0 * NORMAL_QUANTILE_975) }
    };
    let is_known = estimate.value.is_finite() && estimate.se.is_finite() && estimate.se > 0.0;
    is_known.then_some(estimate)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn finding() -> Value {
        json!({
            "cause": "heat", "column": "temp_bed_c", "claimed": false,
            "gain": {"rms_before_um": 5.0, "rms_after_um": 3.0},
            "parameters": {
                "um_per_c": {"value": 2.0, "ci95": [1.02, 2.98]},
                "time_constant_s": {"value": 600.0, "ci95": [300.0, 1200.0]},
                "reference_c": {"value": 20.0},
                "at_s": {"value": 5.0, "ci95": [4.0, 6.0]},
            },
            "rivals": [
                {"cause": "slow", "column": "temp_bed_c", "score_gap": 2.0},
                {"cause": "late", "score_gap": 30.0},
            ],
        })
    }

    #[test]
    fn a_finding_gives_its_constants_with_their_errors() {
        let found = parse_findings(&json!({"quantity": "dz", "findings": [finding()]}));
        assert_eq!(found.len(), 1);
        let it = &found[0];
        assert_eq!((it.name.as_str(), it.claimed), ("dz heat temp_bed_c", false));
        assert_eq!(it.alternatives, ["dz slow temp_bed_c"]);
        assert!((it.explains_um - 4.0).abs() < 1e-12);
        let of = |name: &str| it.constants.iter().find(|constant| constant.parameter == name);
        let heat = of("um_per_c").expect("it has an interval").estimate;
        assert!((heat.value - 2.0).abs() < 1e-12 && (heat.se - 0.5).abs() < 1e-12);
        let time = of("time_constant_s").expect("it has an interval").estimate;
        assert!((time.value - 600_f64.ln()).abs() < 1e-12);
        assert!((time.se - 4_f64.ln() / 3.92).abs() < 1e-12);
        assert!(of("reference_c").is_none() && of("at_s").is_none());
    }

    #[test]
    fn what_is_only_certain_together_has_constants_of_its_own() {
        let mut one = finding();
        let partner = json!({"um_per_c": {"value": 1.0, "ci95": [0.0, 2.0]}});
        one["together_with"] = json!([{"cause": "slow", "parameters": partner}]);
        let found = parse_findings(&json!({"quantity": "dz", "findings": [one]}));
        assert_eq!(
            found.iter().map(|finding| finding.name.as_str()).collect::<Vec<_>>(),
            ["dz heat temp_bed_c", "dz slow"]
        );
    }
}
