//! How a value looks in a machine file, and where in a document its key stands.

use toml_edit::{Array, InlineTable, Item, Table, TableLike};
use trueup_output::escape::escape_line;

use crate::keys::section::Value;

/// Above this many elements an array is laid out over several lines.
const ELEMENTS_PER_LINE: usize = 8;

/// `value` as it is written.
pub(super) fn to_toml_value(value: &Value) -> toml_edit::Value {
    match value {
        Value::Number(value) => to_toml_number(*value),
        Value::Whole(number) => i64::from(*number).into(),
        Value::Boolean(value) => (*value).into(),
        Value::Text(text) => text.into(),
        Value::Numbers(numbers) => {
            wrap_long_array(numbers.iter().copied().map(to_toml_number).collect()).into()
        }
        Value::Wholes(numbers) => {
            wrap_long_array(numbers.iter().copied().map(i64::from).collect()).into()
        }
        Value::Texts(texts) => texts.iter().collect::<Array>().into(),
        Value::Rows(rows) => {
            let row = |row: &[f64; 3]| row.iter().copied().map(to_toml_number).collect::<Array>();
            let mut array: Array = rows.iter().map(row).collect();
            if rows.len() > 1 {
                wrap_elements(&mut array, 1);
            }
            array.into()
        }
        Value::Inline(entries) => {
            let mut table = InlineTable::new();
            for (key, inner) in entries {
                table.insert(key, self::to_toml_value(inner));
            }
            table.into()
        }
    }
}

/// Very small and very large numbers with an exponent.
fn to_toml_number(number: f64) -> toml_edit::Value {
    format!("{number:?}").parse().unwrap_or_else(|_| number.into())
}

fn wrap_long_array(mut array: Array) -> Array {
    if array.len() > ELEMENTS_PER_LINE {
        wrap_elements(&mut array, ELEMENTS_PER_LINE);
    }
    array
}

/// Begins a new line before every `every`th element.
fn wrap_elements(array: &mut Array, every: usize) {
    for (index, element) in array.iter_mut().enumerate() {
        element.decor_mut().set_prefix(if index % every == 0 { "\n    " } else { " " });
    }
    array.set_trailing_comma(true);
    array.set_trailing("\n");
}

/// Sets `key`, the comment next to its old value kept; `note` stands next to a new one.
pub(super) fn set_key(table: &mut dyn TableLike, key: &str, new: &Value, note: Option<&str>) {
    let mut new = to_toml_value(new);
    match table.get_mut(key) {
        Some(Item::Value(old)) => {
            *new.decor_mut() = old.decor().clone();
            *old = new;
        }
        _ => {
            if let Some(note) = note {
                new.decor_mut().set_suffix(format!(" # {}", escape_line(note)));
            }
            table.insert(key, Item::Value(new));
        }
    }
}

/// Returns a table under a header of its own, `remarks` above it.
pub(super) fn new_table(remarks: &[String]) -> Table {
    let mut table = Table::new();
    let remarks: String =
        remarks.iter().map(|remark| format!("# {}\n", escape_line(remark))).collect();
    table.decor_mut().set_prefix(format!("\n{remarks}"));
    table
}

/// Returns the table at `names`, made where it is not there, with `remarks` above it; `None` where a name
/// on the way is no table, which no machine file has.
pub(super) fn find_or_insert_table<'t>(
    root: &'t mut Table,
    names: &[&str],
    remarks: &[String],
) -> Option<&'t mut dyn TableLike> {
    let mut inner: &mut dyn TableLike = root;
    let mut is_inline = false;
    for (depth, name) in names.iter().enumerate() {
        if !inner.contains_key(name) {
            let is_last = depth + 1 == names.len();
            let new = if is_inline {
                Item::Value(InlineTable::new().into())
            } else if is_last {
                Item::Table(new_table(remarks))
            } else {
                // Without keys of its own it needs no header.
                let mut new = Table::new();
                new.set_implicit(true);
                Item::Table(new)
            };
            inner.insert(name, new);
        }
        let item = inner.get_mut(name)?;
        is_inline |= matches!(item, Item::Value(_));
        inner = item.as_table_like_mut()?;
    }
    Some(inner)
}
