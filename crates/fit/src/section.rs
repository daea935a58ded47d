//! Writes fitted constants as TOML: a section alone, or into the user's machine file.
//!
//! In the user's file the section's own keys are replaced, added or taken away, and nothing else
//! changes: order, blanks, comments (those beside the keys that are replaced as well), byte order
//! mark and line ends are the user's. It makes no difference whether the user wrote the section
//! under a header, with dotted keys, or as an inline table.
//!
//! A number is written in the fewest digits that read back to the same `f64`. Where digits beyond
//! the precision of the measurement would only be in the way, as in long tables, the fit rounds
//! first ([`rounded`]) and judges the rounded numbers.
//!
//! The result is read by [`MachineFile::parse`] before it is handed out.

use std::path::Path;

use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, TableLike};
use trueup_machine::{BadInput, MachineFile, Place};

/// Above so many elements an array is laid out over several lines.
const ELEMENTS_ON_A_LINE: usize = 8;

/// What changes in a machine file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Edit {
    /// Sections to replace or to add.
    pub sections: Vec<Section>,
    /// Sections or keys to take away, by their dotted names, because they contradict the new ones:
    /// `axis.x.backlash` beside a new reverse table. What is not there is no error.
    pub removed: Vec<String>,
    /// Keys to write only where the user has not: section, key, value.
    pub defaults: Vec<(String, &'static str, Value)>,
}

/// A section to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Its dotted name: `axis.x.pitch`.
    name: String,
    /// Lines of comment above it where it is new.
    remarks: Vec<String>,
    /// Its keys in their order.
    entries: Vec<(&'static str, Value)>,
    /// Keys of the user's that stay.
    kept: &'static [&'static str],
}

/// The value of a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A finite number.
    Number(f64),
    /// A whole number, written without a point.
    Whole(u32),
    /// A string.
    Text(String),
    /// An array of finite numbers.
    Numbers(Vec<f64>),
    /// An array of rows of three finite numbers.
    Rows(Vec<[f64; 3]>),
}

impl Section {
    /// The section with the dotted name `name`, without keys yet.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), remarks: Vec::new(), entries: Vec::new(), kept: &[] }
    }

    /// With `key` = `value`.
    #[must_use]
    pub fn number(self, key: &'static str, value: f64) -> Self {
        self.with(key, Value::Number(value))
    }

    /// With `key` = `value`, a whole number.
    #[must_use]
    pub fn whole(self, key: &'static str, value: u32) -> Self {
        self.with(key, Value::Whole(value))
    }

    /// With `key` = `text`.
    #[must_use]
    pub fn text(self, key: &'static str, text: impl Into<String>) -> Self {
        self.with(key, Value::Text(text.into()))
    }

    /// With `key` = an array of `values`.
    #[must_use]
    pub fn numbers(self, key: &'static str, values: impl Into<Vec<f64>>) -> Self {
        self.with(key, Value::Numbers(values.into()))
    }

    /// With `key` = an array of `rows`.
    #[must_use]
    pub fn rows(self, key: &'static str, rows: impl Into<Vec<[f64; 3]>>) -> Self {
        self.with(key, Value::Rows(rows.into()))
    }

    /// With a line of comment above it. In a user's file that has the section already the user's
    /// own comments stand, and this one is not written.
    #[must_use]
    pub fn remark(mut self, line: impl Into<String>) -> Self {
        // A line break would end the comment.
        self.remarks.push(line.into().replace(['\n', '\r'], " "));
        self
    }

    /// Keys that the fit does not determine, which stay if the user has written them. All other
    /// keys that are not written here are taken away: they belong to what is replaced.
    #[must_use]
    pub fn keeping(mut self, keys: &'static [&'static str]) -> Self {
        self.kept = keys;
        self
    }

    fn with(mut self, key: &'static str, value: Value) -> Self {
        self.entries.push((key, value));
        self
    }

    /// Its dotted name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The number `key`, if it is one of its own.
    #[must_use]
    pub fn number_of(&self, key: &str) -> Option<f64> {
        self.entries.iter().find_map(|(name, value)| match value {
            Value::Number(number) if *name == key => Some(*number),
            _ => None,
        })
    }
}

/// `value` to so many digits after the point; 0 is never negative.
#[must_use]
pub fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10_f64.powi(decimals);
    let rounded = (value * scale).round() / scale;
    // Beyond the range of exact integers, and for the infinite, rounding says nothing.
    if rounded.is_finite() { rounded + 0.0 } else { value }
}

impl Edit {
    /// An edit of one section.
    #[must_use]
    pub fn of(section: Section) -> Self {
        Self { sections: vec![section], ..Self::default() }
    }

    /// Whether there is nothing to write.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sections.is_empty()
    }

    /// The sections alone, as TOML; what a machine file may need beside them is said in comments.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        for section in &self.sections {
            if !text.is_empty() {
                text.push('\n');
            }
            for remark in &section.remarks {
                text.push_str(&format!("# {remark}\n"));
            }
            text.push_str(&format!("[{}]\n", section.name));
            for (key, value) in &section.entries {
                text.push_str(&format!("{key} = {}\n", value.to_item()));
            }
        }
        for (section, key, value) in &self.defaults {
            text.push_str(&format!("\n# A machine file that uses it says so in [{section}]:\n"));
            text.push_str(&format!("# {key} = {}\n", value.to_item()));
        }
        for name in &self.removed {
            text.push_str(&format!("\n# [{name}] must not stand beside it in a machine file.\n"));
        }
        text
    }

    /// `source`, the content of the machine file at `path`, with this edit.
    ///
    /// # Errors
    /// `source` is no machine file, or would not be one with the edit: the rule names the place in
    /// what would have been written.
    pub fn apply(&self, source: &str, path: &Path) -> Result<String, BadInput> {
        // Also refuses what toml_edit could only call invalid, with a place and a better rule.
        MachineFile::parse(source, path)?;
        let (mark, unmarked) = match source.strip_prefix('\u{feff}') {
            Some(rest) => ("\u{feff}", rest),
            None => ("", source),
        };
        let windows = unmarked.contains("\r\n");
        let mut document: DocumentMut =
            unmarked.replace("\r\n", "\n").parse().map_err(|error| {
                BadInput::new(Place::start_of(path), format!("cannot be edited: {error}"))
            })?;
        for name in &self.removed {
            remove(document.as_table_mut(), name);
        }
        for section in &self.sections {
            write_section(document.as_table_mut(), section);
        }
        for (section, key, value) in &self.defaults {
            let names: Vec<&str> = section.split('.').collect();
            if let Some(table) = descend(document.as_table_mut(), &names, &[])
                && !table.contains_key(key)
            {
                set(table, key, value);
            }
        }
        let mut text = document.to_string();
        if windows {
            text = text.replace('\n', "\r\n");
        }
        let text = format!("{mark}{text}");
        MachineFile::parse(&text, path).map_err(|mut error| {
            error.rule = format!("with the fitted section: {}", error.rule);
            error
        })?;
        Ok(text)
    }
}

impl Value {
    fn to_item(&self) -> toml_edit::Value {
        match self {
            Self::Number(number) => (*number).into(),
            Self::Whole(number) => i64::from(*number).into(),
            Self::Text(text) => text.into(),
            Self::Numbers(numbers) => laid_out(numbers.iter().copied().collect()).into(),
            Self::Rows(rows) => {
                let row = |row: &[f64; 3]| row.iter().copied().collect::<Array>();
                let mut array: Array = rows.iter().map(row).collect();
                if rows.len() > 2 {
                    one_on_each_line(&mut array, 1);
                }
                array.into()
            }
        }
    }
}

fn laid_out(mut array: Array) -> Array {
    if array.len() > ELEMENTS_ON_A_LINE {
        one_on_each_line(&mut array, ELEMENTS_ON_A_LINE);
    }
    array
}

/// Begins a new line before every `every`th element.
fn one_on_each_line(array: &mut Array, every: usize) {
    for (index, element) in array.iter_mut().enumerate() {
        element.decor_mut().set_prefix(if index % every == 0 { "\n    " } else { " " });
    }
    array.set_trailing_comma(true);
    array.set_trailing("\n");
}

fn write_section(root: &mut Table, section: &Section) {
    let names: Vec<&str> = section.name.split('.').collect();
    let Some(table) = descend(root, &names, &section.remarks) else { return };
    let stale: Vec<String> = table
        .iter()
        .map(|(key, _)| key.to_string())
        .filter(|key| !section.kept.contains(&key.as_str()))
        .filter(|key| section.entries.iter().all(|(own, _)| own != key))
        .collect();
    for key in stale {
        table.remove(&key);
    }
    for (key, value) in &section.entries {
        set(table, key, value);
    }
}

/// Sets `key`, the comment beside its old value kept.
fn set(table: &mut dyn TableLike, key: &str, value: &Value) {
    let mut new = value.to_item();
    match table.get_mut(key) {
        Some(Item::Value(old)) => {
            *new.decor_mut() = old.decor().clone();
            *old = new;
        }
        _ => {
            table.insert(key, Item::Value(new));
        }
    }
}

/// The table at `names`, made where it is not there; `None` where a name on the way is no table,
/// which no machine file has.
fn descend<'t>(
    root: &'t mut Table,
    names: &[&str],
    remarks: &[String],
) -> Option<&'t mut dyn TableLike> {
    let mut table: &mut dyn TableLike = root;
    let mut inline = false;
    for (depth, name) in names.iter().enumerate() {
        if !table.contains_key(name) {
            let is_last = depth + 1 == names.len();
            let new = if inline {
                Item::Value(InlineTable::new().into())
            } else {
                let mut new = Table::new();
                // Without keys of its own it needs no header.
                new.set_implicit(!is_last);
                if is_last {
                    let remarks: String =
                        remarks.iter().map(|remark| format!("# {remark}\n")).collect();
                    new.decor_mut().set_prefix(format!("\n{remarks}"));
                }
                Item::Table(new)
            };
            table.insert(name, new);
        }
        let item = table.get_mut(name)?;
        inline |= matches!(item, Item::Value(_));
        table = item.as_table_like_mut()?;
    }
    Some(table)
}

fn remove(root: &mut Table, name: &str) {
    let names: Vec<&str> = name.split('.').collect();
    let Some((last, parents)) = names.split_last() else { return };
    let mut table: &mut dyn TableLike = root;
    for name in parents {
        match table.get_mut(name).and_then(Item::as_table_like_mut) {
            Some(inner) => table = inner,
            None => return,
        }
    }
    table.remove(last);
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: &str = "m.toml";

    fn sensor() -> Section {
        Section::new("spindle.sensor")
            .number("k0_um", -4.0)
            .number("zero_counts", 5048.0)
            .number("um_per_count", 0.019_798_276_521_3)
            .keeping(&["temperature"])
            .remark("15 rows, 0.84 um RMS")
    }

    fn applied(source: &str, edit: &Edit) -> String {
        edit.apply(source, Path::new(PATH)).expect("a machine file and a valid section")
    }

    const PLAIN: &str = "# my mill\n[machine]\nname = \"mill\" # the old one\nkind = \"3-axis\"\n";

    #[test]
    fn a_section_that_is_there_is_replaced_and_nothing_else_changes() {
        let source = format!(
            "{PLAIN}\n[spindle]\nsource = \"sensor\"\n\n# from the paper\n[spindle.sensor]\n\
             zero_counts = 5048.0  # after 24 h\ntemperature = \"temp_coil_c\"\nk0_um=0\n\
             um_per_count = 0.0152587890625\n\n[limits]\nhold_ms = 0x10 # as long as that\n"
        );
        let expected = source
            .replace("k0_um=0", "k0_um=-4.0")
            .replace("um_per_count = 0.0152587890625", "um_per_count = 0.0197982765213");
        assert_eq!(applied(&source, &Edit::of(sensor())), expected);
    }

    #[test]
    fn a_section_that_is_not_there_is_added_with_its_remark_and_its_source() {
        let mut edit = Edit::of(sensor());
        edit.defaults.push(("spindle".into(), "source", Value::Text("sensor".into())));
        let text = applied(PLAIN, &edit);
        assert_eq!(
            text,
            format!(
                "{PLAIN}\n[spindle]\nsource = \"sensor\"\n\n# 15 rows, 0.84 um RMS\n\
                 [spindle.sensor]\nk0_um = -4.0\nzero_counts = 5048.0\n\
                 um_per_count = 0.0197982765213\n"
            )
        );
        // What the user has chosen already stays.
        let chosen = format!(
            "{PLAIN}[spindle]\nsource = \"temperature\"\n[spindle.temperature]\n\
             sensor = \"temp_a_c\"\nreference_c = 20\nk_um_per_c = 2\n"
        );
        assert!(applied(&chosen, &edit).contains("source = \"temperature\""));
    }

    #[test]
    fn it_makes_no_difference_how_the_user_wrote_the_section() {
        let numbers = "k0_um = 0, zero_counts = 1, um_per_count = 2";
        let forms = [
            format!("[spindle]\nsource = \"sensor\"\nsensor = {{ {numbers} }}\n"),
            format!("[spindle.sensor]\n{}\n", numbers.replace(", ", "\n")),
            "[spindle]\nsensor.k0_um = 0\nsensor.zero_counts = 1\nsensor.um_per_count = 2\n".into(),
            format!("[spindle]\nsensor = {{ {numbers}, temperature = \"temp_coil_c\" }}\n"),
            "[axis.x]\nfeedback = \"scale\"\n".into(),
            "[axis]\nx = { feedback = \"scale\" }\n".into(),
            "[axis]\nx.feedback = \"scale\"\n".into(),
        ];
        for form in forms {
            let mut edit = Edit::of(sensor());
            let pitch = Section::new("axis.x.pitch").number("start_mm", 0.0);
            let pitch = pitch.number("step_mm", 0.1).numbers("forward_um", [0.1 + 0.2; 20]);
            edit.sections.push(pitch);
            let text = applied(&format!("{PLAIN}{form}"), &edit);
            let machine = MachineFile::parse(&text, Path::new(PATH)).expect("checked by apply");
            let sensor = machine.spindle.sensor.expect("just written");
            assert_eq!(sensor.um_per_count, 0.019_798_276_521_3, "{text}");
            assert_eq!(sensor.temperature.is_some(), form.contains("temp_coil_c"), "{text}");
            let pitch = machine.axes[0].pitch.as_ref().expect("just written");
            assert_eq!(pitch.forward_um, [0.1 + 0.2; 20], "{text}");
        }
    }

    #[test]
    fn what_contradicts_the_new_section_is_taken_away() {
        let source = format!(
            "{PLAIN}[axis.x.backlash]\nwidth_um = 4\n[axis.y.backlash]\nwidth_um = 5 # keep\n"
        );
        let pitch = Section::new("axis.x.pitch").number("start_mm", 0.0).number("step_mm", 1.0);
        let pitch = pitch.numbers("forward_um", [0.0, 1.0]).numbers("reverse_um", [1.0, 2.0]);
        let mut edit = Edit::of(pitch);
        let refused = edit.apply(&source, Path::new(PATH)).expect_err("both tables and backlash");
        assert!(refused.rule.starts_with("with the fitted section: "), "{refused}");
        edit.removed.push("axis.x.backlash".into());
        edit.removed.push("axis.z.backlash".into());
        let text = applied(&source, &edit);
        assert!(!text.contains("axis.x.backlash") && text.contains("width_um = 5 # keep"));
        assert!(edit.to_toml().contains("# [axis.x.backlash] must not stand beside it"));
    }

    #[test]
    fn windows_line_ends_and_the_byte_order_mark_stay() {
        let source = format!("\u{feff}{}", PLAIN.replace('\n', "\r\n"));
        let text = applied(&source, &Edit::of(sensor()));
        assert!(text.starts_with("\u{feff}# my mill\r\n"));
        assert_eq!(text.matches('\n').count(), text.matches("\r\n").count());
    }

    #[test]
    fn the_section_alone_is_the_same_section() {
        let alone = Edit::of(sensor().remark("a line\nbreak")).to_toml();
        assert_eq!(
            alone,
            "# 15 rows, 0.84 um RMS\n# a line break\n[spindle.sensor]\nk0_um = -4.0\n\
             zero_counts = 5048.0\num_per_count = 0.0197982765213\n"
        );
        let text = format!("{PLAIN}{alone}");
        let machine = MachineFile::parse(&text, Path::new(PATH)).expect("a machine file");
        assert_eq!(machine.spindle.sensor.expect("written").k0_um, -4.0);
    }

    #[test]
    fn every_number_reads_back_to_the_same_bits() {
        for number in [1e-300, 1.0 / 3.0, -0.1, 1e22, 123_456_789.123_456_79, 5e-324, 1e300] {
            let section = Section::new("axis.x.pitch").number("start_mm", number);
            let section = section.number("step_mm", 1.0).numbers("forward_um", [number]);
            let text = applied(PLAIN, &Edit::of(section));
            let machine = MachineFile::parse(&text, Path::new(PATH)).expect("checked by apply");
            let pitch = machine.axes[0].pitch.as_ref().expect("just written");
            assert_eq!(pitch.start_mm.to_bits(), number.to_bits(), "{text}");
            assert_eq!(pitch.forward_um[0].to_bits(), number.to_bits(), "{text}");
        }
    }

    #[test]
    fn rounding_takes_what_the_measurement_cannot_give() {
        assert_eq!(rounded(7.123_456_789, 4), 7.1235);
        assert_eq!(rounded(-0.000_001, 4).to_bits(), 0.0_f64.to_bits());
        assert_eq!(rounded(1e300, 4), 1e300);
        assert!(rounded(f64::NAN, 4).is_nan());
    }

    #[test]
    fn a_file_that_is_no_machine_file_is_refused_at_its_own_place() {
        let error = Edit::of(sensor()).apply("[machine]\nnam = 1\n", Path::new(PATH));
        let error = error.expect_err("a misspelt key").to_string();
        assert_eq!(error, "m.toml:2:1: unknown key machine.nam; did you mean name?");
    }
}
