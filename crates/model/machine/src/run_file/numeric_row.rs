//! A row of plain numbers, as nearly every row is one: read in one pass over its bytes. Of any other row nothing is
//! stated here: it is read field by field, where what is wrong with it is known.

/// Returns the value and the place of each field of `text`, if they are as many as `columns`, all characters are ASCII,
/// and each field is a finite number or nothing.
pub(super) fn parse_numeric_row(
    text: &str,
    separator: char,
    columns: usize,
) -> Option<Vec<(f64, usize)>> {
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

#[cfg(test)]
mod tests {
    use super::{super::fields::Fields, *};

    #[test]
    fn a_plain_row_is_what_its_fields_are_one_by_one() {
        for (text, is_plain) in [
            ("1,2.5,-3e-2", true),
            (" 1 , 2.5 ,+3.", true),
            (",,", true),
            ("  ,nan,  ", true),
            ("1,  ,3  ", true),
            ("1,2", false),
            ("1,2,3,4", false),
            ("1,2,3,", false),
            ("1,\"2\",3", false),
            ("1,inf,3", false),
            ("1,2 µm,3", false),
            ("1,2;3", false),
            ("2026-11-22T23:59:59Z,2,3", false),
            ("", false),
        ] {
            let plain = parse_numeric_row(text, ',', 3);
            assert_eq!(plain.is_some(), is_plain, "{text}");
            let one_by_one = Fields::new(text, ',').map(|field| {
                let field = field.ok().expect("no quote is left open");
                let text = if field.text.is_empty() { "nan" } else { &*field.text };
                (text.parse::<f64>().map(f64::to_bits).ok(), field.column)
            });
            for (plain, field) in plain.iter().flatten().zip(one_by_one) {
                assert_eq!((Some(plain.0.to_bits()), plain.1), field, "{text}");
            }
        }
    }
}
