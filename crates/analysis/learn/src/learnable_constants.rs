//! The constants of a machine file that can follow the machine: those by which its prediction is
//! multiplied. A time constant, a reference, a table are none; they are for `trueup fit` and `diagnose`.
//!
//! Each constant c is learned as the share x by which it is more than the file says: c·(1 + x). The
//! prediction is linear in all of them, so that
//!
//! ```text
//! error = p₀ + x₀ + Σ xᵢ·gᵢ        gᵢ = (prediction with cᵢ twice as large) − p₀
//! ```
//!
//! x₀ is the zero of the reference, in µm: for the growth of a spindle it is written where the source
//! has a place for it; for an axis the file has none.
//!
//! A law over a thermometer has one value more where a record has the temperature of the air: the rise over the air that its
//! part has, in rises that the thermometer shows. It is 1 until the thermometer has moved ([`crate::temperature_rise`]).

use serde::{Deserialize, Serialize};
use toml_edit::{DocumentMut, Item, TableLike, Value};
use trueup_machine::{
    InputFileError, Machine, MachineFile, RunFile,
    effect::{Effect, PredictionStage},
    machine_file::{ElongationSource, LinearAxis, Quantity, writer},
    predict::RunPredictor,
};

use crate::{
    section_lookup::find_section,
    temperature_rise::{self, TemperatureRise},
};

/// A constant that is learned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnableConstant {
    /// Its place in the machine file: `spindle.temperature.k_um_per_c`, `term[1].um_per_c`.
    pub key: String,
    /// The value in the user's own file, in the unit of the key; not 0.
    pub believed: f64,
    /// Of a term its cause, quantity and columns: its number in the file may change. Else empty.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub(crate) term: String,
}

impl LearnableConstant {
    /// Returns true for the temperature at which an axis has no error: it moves only with the thermometer, so it is held until
    /// that has moved.
    pub(crate) fn is_reference_temperature(&self) -> bool {
        self.key.ends_with(".reference_c")
    }

    /// Returns true for the values that are held until a thermometer has moved.
    pub(crate) fn is_held(&self) -> bool {
        self.is_reference_temperature() || TemperatureRise::from_key(&self.key).is_some()
    }

    /// Returns the unit of its value, by its key.
    #[must_use]
    pub fn unit(&self) -> String {
        unit(&self.key)
    }

    /// Returns true if both are the same constant, whatever its number or value is.
    pub(crate) fn is_same_as(&self, other: &Self) -> bool {
        if self.term.is_empty() || other.term.is_empty() {
            return self.key == other.key;
        }
        let name = |constant: &Self| constant.key.rsplit('.').next().map(str::to_string);
        self.term == other.term && name(self) == name(other)
    }
}

/// Returns the unit of a constant, by its key.
pub(crate) fn unit(key: &str) -> String {
    let name = key.rsplit('.').next().unwrap_or(key);
    if TemperatureRise::from_key(key).is_some() {
        return "times".into();
    }
    if name.starts_with("width_") {
        return "µm".into();
    }
    if name.ends_with("reference_c") {
        return "°C".into();
    }
    let per = name.split_once("um_per_").map_or("", |(_, per)| per);
    match per {
        "" => "µm".into(),
        "c" => "µm/K".into(),
        "m_per_c" => "µm/(m·K)".into(),
        "m" => "µm/m".into(),
        "krpm" => "µm/(1000 r/min)".into(),
        "krpm2" => "µm/(1000 r/min)²".into(),
        other => format!("µm/{}", other.replace("_per_", "/")),
    }
}

/// Returns what can be learned of `quantity`, in the order of the file; `air` is the column of the air.
pub(crate) fn learnable_constants(
    machine: &Machine,
    quantity: Quantity,
    air: Option<&str>,
) -> Vec<LearnableConstant> {
    let mut all = Vec::new();
    let mut add = |key: String, believed: f64| {
        if believed != 0.0 && believed.is_finite() {
            all.push(LearnableConstant { key, believed, term: String::new() });
        }
    };
    let spindle = &machine.spindle;
    match spindle.source {
        Some(ElongationSource::Sensor) => {
            if let Some(sensor) = &spindle.sensor {
                add("spindle.sensor.um_per_count".into(), sensor.um_per_count);
            }
        }
        Some(ElongationSource::Warmup) => {
            if let Some(warmup) = &spindle.warmup {
                add("spindle.warmup.max_um".into(), warmup.max_um);
            }
        }
        Some(ElongationSource::Temperature) => {
            if let Some(law) = &spindle.temperature {
                add("spindle.temperature.k_um_per_c".into(), law.k_um_per_c);
            }
        }
        None => {}
    }
    if let Some(axis) = quantity.axis() {
        let (model, name) = (&machine.axes[axis.index()], axis.name());
        if let Some(thermal) = model.thermal.as_ref().filter(|thermal| thermal.table.is_none()) {
            if thermal.mode.has_constant_term() {
                add(format!("axis.{name}.thermal.constant_um_per_c"), thermal.constant_um_per_c);
            }
            if thermal.mode.has_position_term() {
                let slope = thermal.slope_um_per_m_per_c;
                add(format!("axis.{name}.thermal.slope_um_per_m_per_c"), slope);
                if slope != 0.0 {
                    add(format!("axis.{name}.thermal.reference_c"), thermal.reference_c);
                }
            }
        }
        if let Some(backlash) = &model.backlash {
            add(format!("axis.{name}.backlash.width_um"), backlash.width_um);
        }
    }
    for (index, term) in machine.terms.iter().enumerate() {
        let is_of = term.quantity == quantity
            || term.quantity == Quantity::Elongation && quantity.axis().is_some();
        let Some((key, believed)) = single_amplitude(&term.effect).filter(|_| is_of) else {
            continue;
        };
        if believed == 0.0 || !believed.is_finite() {
            continue;
        }
        let texts = term.effect.entries().into_iter().filter_map(|(_, value)| match value {
            writer::Value::Number(_) => None,
            other => Some(format!("{other:?}")),
        });
        let named = [term.effect.name().to_string(), term.quantity.name().to_string()];
        let mut name = named.into_iter().chain(texts).collect::<Vec<_>>().join(" ");
        let same = all
            .iter()
            .filter(|constant: &&LearnableConstant| constant.term.split('#').next() == Some(&name));
        if let count @ 1.. = same.count() {
            name += &format!("#{count}");
        }
        all.push(LearnableConstant { key: format!("term[{index}].{key}"), believed, term: name });
    }
    let rises = air.map_or(Vec::new(), |air| temperature_rise::rise_keys(machine, quantity, air));
    let rises = rises.into_iter();
    all.extend(rises.map(|key| LearnableConstant { key, believed: 1.0, term: String::new() }));
    all
}

/// Returns the one amplitude of a term that is added, with its key.
fn single_amplitude(effect: &Effect) -> Option<(&'static str, f64)> {
    let is_one = effect.stage() == PredictionStage::Sum
        && effect.amplitude_count() == 1
        && effect.is_compensable();
    let last = *effect.values().last().filter(|_| is_one)?;
    let entries = effect.entries().into_iter();
    entries.into_iter().find_map(|(key, value)| match value {
        writer::Value::Number(number) if number == last && key.contains("um") => {
            Some((key, number))
        }
        _ => None,
    })
}

/// `source`, the user's machine file, with other constants; what else it says, comments too, stays. `None`
/// where it has no section for one.
pub(crate) fn replace_constants(source: &str, changed: &[(String, f64)]) -> Option<String> {
    let mut document: DocumentMut = source.parse().ok()?;
    let counts_per_v = counts_per_v(&document);
    let (rises, changed): (Vec<_>, Vec<_>) =
        changed.iter().partition(|(key, _)| TemperatureRise::from_key(key).is_some());
    for (key, number) in changed {
        let (section, name) = key.rsplit_once('.')?;
        let section = find_section(document.as_item_mut(), section)?.as_table_like_mut()?;
        let (name, number) = to_user_unit(section, name, *number, counts_per_v)?;
        let decor = section.get(name).and_then(Item::as_value).map(|old| old.decor().clone());
        let mut new = Value::from(number);
        if let Some(decor) = decor {
            *new.decor_mut() = decor;
        }
        section.insert(name, new.into());
    }
    let own: DocumentMut = source.parse().ok()?;
    for (key, number) in rises {
        TemperatureRise::from_key(key)?.add_terms(&own, &mut document, number - 1.0)?;
    }
    Some(document.to_string())
}

/// Returns the key and the number as the user has written that constant: growth for a volt, in the place of a count.
fn to_user_unit<'k>(
    section: &dyn TableLike,
    name: &'k str,
    number: f64,
    counts_per_v: Option<f64>,
) -> Option<(&'k str, f64)> {
    match name {
        "um_per_count" if section.contains_key("um_per_v") => {
            Some(("um_per_v", number * counts_per_v?))
        }
        _ => Some((name, number)),
    }
}

/// Returns how many counts a volt of the displacement sensor is, where the file says it.
fn counts_per_v(document: &DocumentMut) -> Option<f64> {
    let sensor = document.get("inputs")?.get("sensor")?.as_table_like()?;
    let number = |key: &str| {
        let value = sensor.get(key)?.as_value()?;
        value.as_float().or_else(|| value.as_integer().map(|value| value as f64))
    };
    Some(number("counts_full_scale")? / number("volts_full_scale")?)
}

/// Where the zero of the growth is written, and what an added micrometre makes of the number there;
/// `None` where the file has no place for it.
pub(crate) fn zero_location(
    machine: &Machine,
    quantity: Quantity,
) -> Option<(&'static str, f64, f64)> {
    if quantity != Quantity::Elongation {
        return None;
    }
    let spindle = &machine.spindle;
    match spindle.source? {
        ElongationSource::Sensor => {
            Some(("spindle.sensor.k0_um", spindle.sensor.as_ref()?.k0_um, 1.0))
        }
        ElongationSource::Temperature => {
            let law = spindle.temperature.as_ref()?;
            Some(("spindle.temperature.reference_c", law.reference_c, -1.0 / law.k_um_per_c))
        }
        ElongationSource::Warmup => None,
    }
}

/// The prediction by the file's own constants, and the addition to it by each that is twice as large, in µm.
pub(crate) struct PredictionSensitivities {
    /// By row; NaN where the row does not say enough.
    pub believed_um: Vec<f64>,
    /// By row: 1 for the zero, then one for each constant.
    pub um: Vec<Vec<f64>>,
    /// The temperature columns that the prediction depends on.
    pub thermometers: Vec<String>,
    /// By thermometer and row: by how much more the prediction changes where it shows all of its rise over the air once
    /// more, in µm.
    pub shares_um: Vec<Vec<f64>>,
}

/// Without a second thermometer the air has this temperature.
const DEFAULT_AIR_TEMPERATURE_C: f64 = 20.0;
/// The share by which a thermometer is altered to see what depends on it.
const RELATIVE_PERTURBATION: f64 = 0.1;

impl PredictionSensitivities {
    /// Of `run` by the machine file `source`, to which the shares `applied` are applied.
    ///
    /// # Errors
    /// `source` is no machine file; the run lacks a column without which nothing can be predicted.
    pub fn from_run(
        source: &str,
        (constants, applied): (&[LearnableConstant], &[f64]),
        run: &RunFile,
        quantity: Quantity,
    ) -> Result<Self, InputFileError> {
        let predicted = |text: &str| -> Result<Vec<f64>, InputFileError> {
            let machine = MachineFile::parse(text, run.path())?;
            let index =
                Quantity::ALL.iter().position(|candidate| *candidate == quantity).unwrap_or(0);
            let rows = RunPredictor::new(&machine, run)?;
            let um: Vec<f64> = rows.model_values().map(|values| values.to_array()[index]).collect();
            Ok(um)
        };
        let believed_um = predicted(source)?;
        let mut um: Vec<Vec<f64>> = believed_um.iter().map(|_| vec![1.0]).collect();
        for (LearnableConstant { key, believed, .. }, share) in constants.iter().zip(&applied[1..])
        {
            let rise = TemperatureRise::from_key(key);
            let has_column = rise.as_ref().is_none_or(|rise| run.column(rise.air).is_some());
            let twice =
                replace_constants(source, &[(key.clone(), 2.0 * believed)]).unwrap_or_default();
            let twice = if has_column { predicted(&twice)? } else { vec![f64::NAN; um.len()] };
            // Without the air nothing is known of what is over it; as long as nothing is, none of it is missing.
            let is_idle = rise.is_some() && *share == 0.0;
            for ((row, twice), once) in um.iter_mut().zip(twice).zip(&believed_um) {
                let g = twice - once;
                row.push(if is_idle && g.is_nan() && !once.is_nan() { 0.0 } else { g });
            }
        }
        let (mut thermometers, mut shares_um) = (Vec::new(), Vec::new());
        let is_one = |name: &str| name.starts_with("temp_") && name.ends_with("_c");
        let names = run.columns().iter().map(|column| column.name.clone());
        let machine = MachineFile::parse(source, run.path())?;
        let index = Quantity::ALL.iter().position(|candidate| *candidate == quantity).unwrap_or(0);
        // By the file and not by the rows: a record that grows has the same ones.
        let is_used = |name: &String| is_one(name) && source.contains(&format!("\"{name}\""));
        for name in names.filter(is_used) {
            let air_c: Vec<f64> = (0..run.row_count())
                .map(|row| {
                    let others = run
                        .columns()
                        .iter()
                        .filter(|column| is_one(&column.name) && column.name != name);
                    let there = others.map(|change| change.values[row]).filter(|c| c.is_finite());
                    there.reduce(f64::min).unwrap_or(DEFAULT_AIR_TEMPERATURE_C)
                })
                .collect();
            let altered = run.with_altered_values(run.row_count(), |column, values| {
                if column == name {
                    let rows = values.iter_mut().zip(&air_c);
                    rows.for_each(|(value, air_c)| {
                        *value += RELATIVE_PERTURBATION * (*value - air_c)
                    });
                }
            });
            let rows = RunPredictor::new(&machine, &altered)?;
            let all = rows.model_values().zip(&believed_um);
            let um: Vec<f64> = all
                .map(|(values, once)| (values.to_array()[index] - once) / RELATIVE_PERTURBATION)
                .collect();
            thermometers.push(name);
            shares_um.push(um);
        }
        Ok(Self { believed_um, um, thermometers, shares_um })
    }
}

/// Returns what is measured in `run`: the `requested` quantity, or the only one.
///
/// # Errors
/// It is not there, or there are several to choose from.
pub(crate) fn resolve_quantity(
    run: &RunFile,
    requested: Option<Quantity>,
) -> Result<Quantity, InputFileError> {
    let name = |quantity: Quantity| format!("measured_{}_um", quantity.name());
    if let Some(requested) = requested {
        return run.require_column(&name(requested)).map(|_| requested);
    }
    let is_there = |quantity: &Quantity| run.column(&name(*quantity)).is_some();
    let there: Vec<Quantity> = Quantity::ALL.into_iter().filter(is_there).collect();
    match there[..] {
        [only] => Ok(only),
        [] => run.require_column("measured_elongation_um").map(|_| Quantity::Elongation),
        ref several => {
            let names: Vec<&str> = several.iter().map(|quantity| quantity.name()).collect();
            let rule = format!("measures {}: say which with --quantity", names.join(", "));
            Err(run.value_error(0, &name(several[0]), rule))
        }
    }
}

/// Returns the name of an axis's quantity, or the elongation.
pub(crate) fn learnable_quantity_by_name(name: &str) -> Option<Quantity> {
    let axes = LinearAxis::ALL.len();
    Quantity::ALL.into_iter().take(axes + 1).find(|quantity| quantity.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_number_leaves_the_rest_of_the_file_as_it_is() {
        let source = "# mine\n[spindle.temperature]\nk_um_per_c = 2.0 # by hand\n\n[[term]]\na = 1\n\
                      [[term]]\num_per_c = 3.0\n";
        let changed =
            [("spindle.temperature.k_um_per_c".into(), 2.5), ("term[1].um_per_c".into(), 4.0)];
        let text = replace_constants(source, &changed).expect("both are there");
        assert_eq!(text, source.replace("2.0 #", "2.5 #").replace("3.0", "4.0"));
        // What was left to its default is written; a section that is not there is not made up.
        let zero = replace_constants(source, &[("spindle.temperature.lag_s".into(), 1.0)])
            .expect("a section");
        assert!(zero.contains("lag_s = 1.0"), "{zero}");
        assert_eq!(replace_constants(source, &[("spindle.sensor.k0_um".into(), 1.0)]), None);
    }

    #[test]
    fn a_sensor_that_is_written_for_a_volt_stays_so() {
        let source = "[inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32000 }\n\
                      [spindle.sensor]\num_per_v = 50.0 # the data sheet's\n";
        let changed = [("spindle.sensor.um_per_count".into(), 0.016)];
        let text = replace_constants(source, &changed).expect("it is there");
        assert_eq!(text, source.replace("50.0", "51.2"));
    }
}
