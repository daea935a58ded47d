//! A row of plain numbers, as nearly every row is one: read in one pass over its bytes. Of any other row nothing is
//! said here: it is read field by field, where what is wrong with it is known.

/// The value and the place of each field of `text` into `row`, if they are as many as `row` has columns to take, all
/// characters are ASCII, and each field is a finite number or nothing; else false, and `row` is worth nothing.
pub(super) fn read(
    text: &str,
    separator: char,
    columns: usize,
    row: &mut Vec<(f64, usize)>,
) -> bool {
    let bytes = text.as_bytes();
    if !text.is_ascii() {
        return false;
    }
    let mut start = 0;
    while row.len() < columns {
        let rest = &bytes[start..];
        let length = rest.iter().position(|&byte| byte == separator as u8).unwrap_or(rest.len());
        let blanks = rest[..length].iter().take_while(|&&byte| byte == b' ').count();
        let value = match text[start + blanks..start + length].trim_ascii_end() {
            "" => f64::NAN,
            field => match field.parse::<f64>() {
                Ok(value) if !value.is_infinite() => value,
                _ => return false,
            },
        };
        // A field of blanks alone has no content to point at.
        let place = if blanks < length { start + blanks } else { start };
        row.push((value, place + 1));
        start += length + 1;
        if start > bytes.len() {
            return row.len() == columns;
        }
    }
    false
}
