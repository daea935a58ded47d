//! The text of a file, whatever its encoding.

use std::path::Path;

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use trueup_machine::{InputFileError, Location};

/// Decodes `bytes`: by `label` where there is one, else UTF-8 or UTF-16 where they are that, else Windows-1252, which
/// has all of Latin-1.
///
/// Returns the text without a byte order mark, and the name of its encoding.
///
/// # Errors
/// The label is not known, or the bytes are no text in that encoding.
pub(crate) fn decode(
    bytes: &[u8],
    label: Option<&str>,
    path: &Path,
) -> Result<(String, &'static str), InputFileError> {
    let start = || Location::start_of_file(path);
    let encoding = match label {
        Some(label) => Encoding::for_label(label.as_bytes()).ok_or_else(|| {
            InputFileError::new(start(), format!("{label} is no encoding that is known")).with_help(
                "--encoding utf-8, utf-16le, latin1, windows-1252, iso-8859-15, ibm866 …",
            )
        })?,
        None => detect_encoding(bytes),
    };
    let (text, used, has_errors) = encoding.decode(bytes);
    let is_binary = text.chars().take(1 << 16).any(|c| c < ' ' && !"\t\n\r\u{c}".contains(c));
    if has_errors || is_binary {
        let rule = format!("is no text in {}", used.name());
        let help = "give the table as csv, tsv, txt, xlsx or ods; or name its encoding: --encoding";
        return Err(InputFileError::new(start(), rule).with_help(help));
    }
    Ok((text.into_owned(), used.name()))
}

fn detect_encoding(bytes: &[u8]) -> &'static Encoding {
    if let Some((encoding, _)) = Encoding::for_bom(bytes) {
        return encoding;
    }
    // Text of the West in UTF-16 has a zero in every second byte.
    let head = &bytes[..bytes.len().min(4096)];
    let zeros =
        |first: usize| head.iter().skip(first).step_by(2).filter(|byte| **byte == 0).count();
    let half = head.len() / 2;
    if half > 1 && zeros(1) * 2 > half && zeros(0) == 0 {
        return UTF_16LE;
    }
    if half > 1 && zeros(0) * 2 > half && zeros(1) == 0 {
        return UTF_16BE;
    }
    if str::from_utf8(bytes).is_ok() { UTF_8 } else { WINDOWS_1252 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_encoding_gives_the_same_text() {
        let text = "Zeit;Weg [µm];Öl [°C]\r\n1;2;3\r\n";
        let utf16 = |big: bool| -> Vec<u8> {
            let bytes = |unit: u16| if big { unit.to_be_bytes() } else { unit.to_le_bytes() };
            text.encode_utf16().flat_map(bytes).collect()
        };
        let with = |mark: &[u8], bytes: Vec<u8>| [mark, &bytes].concat();
        let latin = text.chars().map(|c| u8::try_from(u32::from(c)).expect("Latin-1")).collect();
        for (bytes, name) in [
            (text.as_bytes().to_vec(), "UTF-8"),
            (with(b"\xef\xbb\xbf", text.into()), "UTF-8"),
            (utf16(false), "UTF-16LE"),
            (utf16(true), "UTF-16BE"),
            (with(b"\xff\xfe", utf16(false)), "UTF-16LE"),
            (with(b"\xfe\xff", utf16(true)), "UTF-16BE"),
            (latin, "windows-1252"),
        ] {
            assert_eq!(decode(&bytes, None, Path::new("a")), Ok((text.to_string(), name)));
        }
        assert!(decode(b"\x00\x01\x02\x03", None, Path::new("a")).is_err());
        assert!(decode(b"a", Some("klingon"), Path::new("a")).is_err());
    }
}
