//! The map of headers: what the user has stated about a kind of file once, in TOML.
//!
//! ```toml
//! decimal = "comma"
//! date = "dmy"
//! [columns."Messuhr [µm]"]
//! name = "measured_dx_um"
//! unit = "µm"
//! ```

use std::path::Path;

use toml_edit::{Document, DocumentMut, Item, Table, TableLike, Value, value};
use trueup_machine::{InputFileError, Location};

use crate::{
    answers::{ImportAnswers, QuestionTopic},
    number::DecimalSeparator,
    timestamp::DateOrder,
};

/// The keys of a map and of a column in it.
const MAP_KEYS: [&str; 8] =
    ["decimal", "date", "encoding", "sheet", "counts_per_v", "summer_time", "runs", "columns"];
const COLUMN_KEYS: [&str; 3] = ["name", "unit", "negate"];

/// Reads a map.
///
/// # Errors
/// It is no TOML, has a key that is not known, or a value that a key cannot have.
pub fn parse(text: &str, path: &Path) -> Result<ImportAnswers, InputFileError> {
    let place = |span: Option<std::ops::Range<usize>>| {
        Location::from_byte_offset(path, text, span.map_or(0, |span| span.start))
    };
    let document = Document::parse(text)
        .map_err(|error| InputFileError::new(place(error.span()), error.message().to_string()))?;
    let bad = |item: &Item, rule: String| InputFileError::new(place(item.span()), rule);
    let mut answers = ImportAnswers::default();
    for (key, item) in document.iter() {
        let word = || item.as_str().ok_or_else(|| bad(item, format!("{key} must be a text")));
        let taken = match key {
            "decimal" => answers.record_answer(&QuestionTopic::Decimal, word()?),
            "date" => answers.record_answer(&QuestionTopic::Date, word()?),
            "encoding" => {
                answers.encoding = Some(word()?.into());
                Ok(())
            }
            "sheet" => answers.record_answer(&QuestionTopic::Sheet, word()?),
            "runs" => answers.record_answer(&QuestionTopic::Runs, word()?),
            "summer_time" => {
                answers.summer_time = Some(
                    item.as_bool()
                        .ok_or_else(|| bad(item, format!("{key} must be true or false")))?,
                );
                Ok(())
            }
            "counts_per_v" => {
                let number =
                    item.as_float().or_else(|| item.as_integer().map(|value| value as f64));
                answers.record_answer(
                    &QuestionTopic::CountsPerV,
                    &number.map(|number| number.to_string()).unwrap_or_default(),
                )
            }
            "columns" => {
                let table = item
                    .as_table_like()
                    .ok_or_else(|| bad(item, "columns must be a table".into()))?;
                for (header, item) in table.iter() {
                    record_column_answers(header, item, &mut answers)
                        .map_err(|rule| bad(item, rule))?;
                }
                Ok(())
            }
            _ => Err(format!("{key} is no key of a map; there are {}", MAP_KEYS.join(", "))),
        };
        taken.map_err(|rule| bad(item, rule))?;
    }
    Ok(answers)
}

fn record_column_answers(
    header: &str,
    item: &Item,
    answers: &mut ImportAnswers,
) -> Result<(), String> {
    let table = item.as_table_like().ok_or("a column must be a table with name and unit")?;
    answers.of_map.push(header.into());
    for (key, item) in table.iter() {
        let word = || item.as_str().ok_or_else(|| format!("{key} must be a text"));
        match key {
            "name" => answers.record_answer(&QuestionTopic::Column(header.into()), word()?)?,
            "unit" => answers.record_answer(&QuestionTopic::Unit(header.into()), word()?)?,
            "negate" => {
                if item.as_bool().ok_or("negate must be true or false")? {
                    answers.negate.push(header.into());
                }
            }
            _ => {
                return Err(format!(
                    "{key} is no key of a column; there are {}",
                    COLUMN_KEYS.join(", ")
                ));
            }
        }
    }
    Ok(())
}

/// Returns the map `text` with what it lacks of `answers`; its own entries and comments stay. An empty text begins
/// a new one.
///
/// # Errors
/// `text` is no map: [`parse`] says so first.
pub fn merge_answers(text: &str, answers: &ImportAnswers) -> Result<String, String> {
    const MAP_FILE_HEADER: &str = "# How `trueup import --map` reads this kind of file. Edit it as you like: name = \"-\" leaves a column out.\n";
    let is_new = text.trim().is_empty();
    let mut document: DocumentMut =
        text.parse().map_err(|error: toml_edit::TomlError| error.to_string())?;
    let mut set = |key: &str, to: Option<Value>| {
        if let Some(to) = to
            && !document.contains_key(key)
        {
            document[key] = value(to);
        }
    };
    set("decimal", answers.decimal.map(DecimalSeparator::name).map(Value::from));
    set("date", answers.date.map(DateOrder::name).map(Value::from));
    set("encoding", answers.encoding.clone().map(Value::from));
    set("sheet", answers.sheet.clone().map(Value::from));
    set("counts_per_v", answers.counts_per_v.map(Value::from));
    set("summer_time", answers.summer_time.map(Value::from));
    let runs = |back| if back { "there-and-back" } else { "one-way" };
    set("runs", answers.there_and_back.map(runs).map(Value::from));
    let mut add = |header: &str, key: &str, to: Value| {
        let columns = document.entry("columns").or_insert_with(|| {
            let mut table = Table::new();
            table.set_implicit(true);
            Item::Table(table)
        });
        if let Some(columns) = columns.as_table_like_mut() {
            let column = columns.entry(header).or_insert_with(|| Item::Table(Table::new()));
            let lacks = column
                .as_table_like()
                .is_some_and(|table: &dyn TableLike| !table.contains_key(key));
            if let Some(column) = column.as_table_like_mut().filter(|_| lacks) {
                column.insert(key, value(to));
            }
        }
    };
    for (header, name) in &answers.columns {
        add(header, "name", name.as_str().into());
    }
    for (header, unit) in &answers.units {
        add(header, "unit", unit.as_str().into());
    }
    for header in &answers.negate {
        add(header, "negate", true.into());
    }
    let body = document.to_string();
    Ok(if is_new { format!("{MAP_FILE_HEADER}{body}") } else { body })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_gives_back_what_was_answered_and_keeps_what_is_there() {
        let mut answers = ImportAnswers { negate: vec!["Uhr".into()], ..ImportAnswers::default() };
        for (topic, value) in [
            (QuestionTopic::Decimal, "comma"),
            (QuestionTopic::Date, "mdy"),
            (QuestionTopic::Column("Messuhr [µm]".into()), "measured_dx_um"),
            (QuestionTopic::Unit("Uhr".into()), "mil"),
            (QuestionTopic::CountsPerV, "2764.8"),
            (QuestionTopic::Runs, "there-and-back"),
        ] {
            answers.record_answer(&topic, value).expect("an answer");
        }
        let text = merge_answers("", &answers).expect("a map");
        let of_map = vec!["Messuhr [µm]".into(), "Uhr".into()];
        let expected = ImportAnswers { of_map, ..answers.clone() };
        assert_eq!(parse(&text, Path::new("m.toml")), Ok(expected), "{text}");
        let edited = format!("# mine\n{}", text.replace("measured_dx_um", "measured_dy_um"));
        let again = merge_answers(&edited, &answers).expect("a map");
        assert_eq!(again, edited);
    }

    #[test]
    fn a_wrong_key_or_value_has_its_place() {
        for (text, line, phrase) in [
            ("decimal = \"comma\"\ndelimiter = \";\"\n", 2, "delimiter is no key"),
            ("decimal = \"semi\"\n", 1, "comma or point"),
            ("[columns.X]\nunit = \"parsec\"\n", 1, "a unit"),
            ("date = 3\n", 1, "must be a text"),
            ("x = = 1\n", 1, ""),
        ] {
            let error = parse(text, Path::new("m.toml")).expect_err("a fault");
            assert_eq!(error.place.line, line, "{error}");
            assert!(error.rule.contains(phrase), "{error}");
        }
    }
}
