//! A section of a machine file by its name, as keys of constants name it: `axis.x.thermal`, `term[1]`.

use toml_edit::Item;

/// Returns the section within `root`; `None`: it is not there.
pub(crate) fn find_section<'d>(root: &'d mut Item, key: &str) -> Option<&'d mut Item> {
    key.split('.').try_fold(root, |item, name| {
        let Some((array, number)) = name.split_once('[') else {
            return item.as_table_like_mut()?.get_mut(name);
        };
        let number: usize = number.trim_end_matches(']').parse().ok()?;
        let array = item.as_table_like_mut()?.get_mut(array)?;
        // An array of tables, or an array of inline ones.
        let is_there = match &*array {
            Item::ArrayOfTables(tables) => number < tables.len(),
            other => other.as_array().is_some_and(|array| number < array.len()),
        };
        if is_there { array.get_mut(number) } else { None }
    })
}
