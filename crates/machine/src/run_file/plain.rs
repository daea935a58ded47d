//! A row of plain numbers, as nearly every row is one: read in one pass over its bytes. Of any other row nothing is
//! said here: it is read field by field, where what is wrong with it is known.

/// The value and the place of each field of `text`, if they are as many as `columns`, all characters are ASCII, and each
/// field is a finite number or nothing.
pub(super) fn fields(text: &str, separator: char, columns: usize) -> Option<Vec<(f64, usize)>> {
    let bytes = text.as_bytes();
    if !text.is_ascii() {
        return None;
    }
    let mut row = Vec::with_capacity(columns);
    let mut start = 0;
    while row.len() < columns {
        let rest = &bytes[start..];
        let length = rest.iter().position(|&byte| byte == separator as u8).unwrap_or(rest.len());
        let blanks = rest[..length].iter().take_while(|&&byte| byte == b' ').count();
        let value = match text[start + blanks..start + length].trim_ascii_end() {
            "" => f64::NAN,
            field => field.parse::<f64>().ok().filter(|value| !value.is_infinite())?,
        };
        // A field of blanks alone has no content to point at.
        let place = if blanks < length { start + blanks } else { start };
        row.push((value, place + 1));
        start += length + 1;
        if start > bytes.len() {
            return (row.len() == columns).then_some(row);
        }
    }
    None
}
