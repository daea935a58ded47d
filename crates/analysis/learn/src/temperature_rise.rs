//! The rise over the air of a part whose thermometer has moved: it shows a share of that rise, and no constant takes the rest off.
//!
//! ```text
//! T = T_air + m·(T_part − T_air)                       the thermometer shows the share m
//! c·(T_part − T₀) = c·(T − T₀) + c·δ·(T − T_air)       δ = 1/m − 1
//! ```
//!
//! The second part is a line over the difference of two temperatures, which a board has as a `[[term]]`. So what is learned is
//! 1 + δ, and it is written as such a term at the end of the file. It needs a thermometer in the air, in the record and on
//! the board.

use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, Value};
use trueup_core::design_parameters::MAX_TERMS;
use trueup_machine::{
    Machine, RunFile,
    machine_file::{ElongationSource, Quantity},
};

use crate::section_lookup::find_section;

/// Words of a column's name that say: the air.
const AIR_COLUMN_KEYWORDS: [&str; 4] = ["air", "ambient", "hall", "room"];
/// Terms of a board that a rise is, at most: two temperatures, at the zero and over the position.
const MAX_RISE_TERMS: usize = 4;

/// Returns the column of the air in `run`.
pub(crate) fn air_column_name(run: &RunFile) -> Option<String> {
    let names = run.columns().iter().map(|column| &column.name);
    let mut names = names.filter(|name| name.starts_with("temp_") && name.ends_with("_c"));
    names.find(|name| name.split('_').any(|word| AIR_COLUMN_KEYWORDS.contains(&word))).cloned()
}

/// Returns the keys of the rises over `air_column_name` by which a quantity may go.
pub(crate) fn rise_keys(machine: &Machine, quantity: Quantity, air: &str) -> Vec<String> {
    let has_air =
        machine.inputs.as_ref().is_none_or(|inputs| inputs.temperatures.contains_key(air));
    let on_board: usize = machine.terms.iter().map(|term| term.effect.board_terms().len()).sum();
    let has_room = on_board + MAX_RISE_TERMS <= MAX_TERMS;
    if !has_air || !has_room {
        return Vec::new();
    }
    let mut laws = Vec::new();
    let spindle = &machine.spindle;
    if spindle.source == Some(ElongationSource::Temperature)
        && let Some(law) = &spindle.temperature
        && quantity == Quantity::Elongation
    {
        laws.push(("spindle.temperature".to_string(), &law.sensor));
    }
    if let Some(axis) = quantity.axis()
        && let Some(law) = machine.axes[axis.index()].thermal.as_ref()
        && law.table.is_none()
    {
        laws.push((format!("axis.{}.thermal", axis.name()), &law.sensor));
    }
    let others = laws.into_iter().filter(|(_, sensor)| *sensor != air);
    others.map(|(section, sensor)| format!("{section}.{sensor}/{air}")).collect()
}

/// A rise, by its key.
pub(crate) struct TemperatureRise<'k> {
    /// The section of the law.
    section: &'k str,
    /// The column of the thermometer.
    pub thermometer: &'k str,
    /// The column of the air.
    pub air: &'k str,
}

impl<'k> TemperatureRise<'k> {
    /// Returns what a key names; `None`: another constant.
    pub(crate) fn from_key(key: &'k str) -> Option<Self> {
        let (key, air) = key.split_once('/')?;
        let (section, thermometer) = key.rsplit_once('.')?;
        Some(Self { section, thermometer, air })
    }

    /// Adds the terms by which the rise is `more` times larger than is shown to `document`; the constants are those of `own`, the
    /// user's file. `None`: the file has no such law.
    pub(crate) fn add_terms(
        &self,
        own: &DocumentMut,
        document: &mut DocumentMut,
        more: f64,
    ) -> Option<()> {
        let mut own = own.clone();
        let law = find_section(own.as_item_mut(), self.section)?.as_table_like_mut()?;
        let number = |key: &str| {
            let value = law.get(key).and_then(Item::as_value);
            value.and_then(|value| {
                value.as_float().or_else(|| value.as_integer().map(|integer| integer as f64))
            })
        };
        let (lag_s, mut amounts) = (number("lag_s").unwrap_or(0.0), Vec::new());
        let quantity =
            match self.section.split('.').nth(1).filter(|_| self.section.starts_with("axis")) {
                None => {
                    amounts.push((None, number("k_um_per_c")?));
                    "elongation".to_string()
                }
                Some(axis) => {
                    let mode = law.get("mode").and_then(Item::as_str)?;
                    let of = |is_used: bool, key: &str| if is_used { number(key) } else { None };
                    let slope = of(mode != "constant", "slope_um_per_m_per_c").unwrap_or(0.0);
                    let constant = of(mode != "position", "constant_um_per_c").unwrap_or(0.0);
                    let origin_mm = number("origin_mm").unwrap_or(0.0);
                    amounts.push((Some("position"), slope));
                    amounts.push((None, constant - slope * origin_mm / 1000.0));
                    format!("d{axis}")
                }
            };
        for (times, amount) in amounts.into_iter().filter(|entry| entry.1 != 0.0) {
            let key = if times.is_some() { "um_per_unit_per_m" } else { "um_per_unit" };
            let texts = [
                ("cause", Some("dependence")),
                ("quantity", Some(&*quantity)),
                ("column", Some(self.thermometer)),
                ("minus", Some(self.air)),
                ("form", Some("line")),
                ("times", times),
            ];
            let numbers = [(key, amount * more), ("reference", 0.0), ("lag_s", lag_s)];
            let texts = texts.into_iter().filter_map(|(key, text)| Some((key, text?.into())));
            let numbers =
                numbers.into_iter().filter(|(key, number)| *key != "lag_s" || *number != 0.0);
            let all = texts.chain(numbers.map(|(key, number)| (key, Value::from(number))));
            append_term(document, all.collect())?;
        }
        Some(())
    }
}

/// Adds a term at the end of the file.
fn append_term(document: &mut DocumentMut, keys: Vec<(&str, Value)>) -> Option<()> {
    let terms = document.entry("term").or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
    match terms {
        Item::ArrayOfTables(tables) => {
            let mut table = Table::new();
            keys.into_iter().for_each(|(key, value)| _ = table.insert(key, value.into()));
            tables.push(table);
        }
        inline => inline.as_array_mut()?.push(Value::InlineTable(keys.into_iter().collect())),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use trueup_machine::{MachineFile, compile, predict::RunPredictor};

    use super::*;
    use crate::{learnable_constants::replace_constants, live_update::LiveUpdate};

    const INPUTS: &str = "[inputs]\ntemp_screw_c = { channel = 0, kind = \"pt100\" }\n\
        temp_air_c = { channel = 1, kind = \"pt100\" }\n";
    const AXIS: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[axis.x]\nfeedback = \"screw\"\n[axis.x.thermal]\n\
        mode = \"both\"\nsensor = \"temp_screw_c\"\nreference_c = 20.0\nconstant_um_per_c = 1.0\n\
        slope_um_per_m_per_c = 10.0\norigin_mm = 100.0\n";
    const SPINDLE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"temperature\"\n\
        [spindle.temperature]\nsensor = \"temp_front_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\nlag_s = 900.0\n";

    fn machine(text: &str) -> Machine {
        MachineFile::parse(text, Path::new("m.toml")).expect("a machine file")
    }

    /// At 25 °C, in air of 22 °C, at 500 mm: K₀ + tanβ·0.4 m = 5 + 50·0.4 = 25 µm. A thermometer that shows 1/1.3 of the rise
    /// of its screw over the air leaves 0.3·3 K: 0.9 + 9·0.4 = 4.5 µm more.
    #[test]
    fn an_axis_whose_thermometer_shows_less_of_the_rise_grows_by_the_rest() {
        let run = "time_s,x_mm,dir_x,temp_screw_c,temp_air_c,measured_dx_um\n0,500,1,25,22,0\n";
        let run = RunFile::from_reader(run.as_bytes(), Path::new("r.csv")).expect("a run");
        let text = format!("{AXIS}{INPUTS}");
        let keys =
            rise_keys(&machine(&text), Quantity::Dx, &air_column_name(&run).expect("the air"));
        assert_eq!(keys, ["axis.x.thermal.temp_screw_c/temp_air_c"]);
        let predicted = |text: &str| {
            let machine = machine(text);
            let rows = RunPredictor::new(&machine, &run).expect("a prediction");
            rows.model_values().map(|values| values.to_array()[1]).next().expect("a row")
        };
        let learned =
            replace_constants(&text, &[(keys[0].clone(), 1.3)]).expect("the law is there");
        assert!((predicted(&text) - 25.0).abs() < 1e-9, "{}", predicted(&text));
        assert!((predicted(&learned) - 29.5).abs() < 1e-9, "{learned}");
        // A board runs it.
        let blob = |text: &str| compile(&machine(text)).expect("it is for a board").blob().to_vec();
        assert_ne!(blob(&learned), blob(&text));
        // One that runs on the first file gets no part of it: what the term adds, no share of the slope can.
        let live = LiveUpdate::from_difference(&machine(&text), &machine(&learned))
            .expect("both are for a board");
        assert!(live.amounts == [0; 5] && live.rest.len() == 2, "{live:?}");
    }

    #[test]
    fn a_spindle_has_the_lag_of_its_law() {
        let text = format!("{SPINDLE}{INPUTS}").replace("temp_screw_c", "temp_front_c");
        let keys = rise_keys(&machine(&text), Quantity::Elongation, "temp_air_c");
        let learned =
            replace_constants(&text, &[(keys[0].clone(), 1.25)]).expect("the law is there");
        let term = "\n[[term]]\ncause = \"dependence\"\nquantity = \"elongation\"\ncolumn = \"temp_front_c\"\n\
                    minus = \"temp_air_c\"\nform = \"line\"\num_per_unit = 0.5\nreference = 0.0\nlag_s = 900.0\n";
        assert_eq!(learned, text + term);
        assert!(compile(&machine(&learned)).is_ok());
    }

    #[test]
    fn a_board_without_a_thermometer_in_the_air_has_no_such_term() {
        let without = format!("{AXIS}{}", INPUTS.lines().take(2).collect::<Vec<_>>().join("\n"));
        assert!(rise_keys(&machine(&without), Quantity::Dx, "temp_air_c").is_empty());
        // A law over the air itself has no rise over it, nor has an axis another one's.
        assert!(rise_keys(&machine(AXIS), Quantity::Dx, "temp_screw_c").is_empty());
        assert!(rise_keys(&machine(AXIS), Quantity::Dy, "temp_air_c").is_empty());
    }
}
