//! The project's Rust files, and their text without what is not code.

use std::{fs, path::Path};

use anyhow::{Context as _, Result};

/// A Rust file of the project.
pub(crate) struct SourceFile {
    /// From the project's root, with `/`.
    pub path: String,
    /// The unchanged text.
    pub text: String,
    /// As long as [`Self::text`], with blanks for comments and for what is compiled for tests only.
    pub words: String,
    /// As [`Self::words`], with blanks inside texts in quotes too.
    pub code: String,
}

impl SourceFile {
    /// Reads a file's text.
    pub fn new(path: impl Into<String>, text: &str) -> Self {
        let (words, code) = blank_out_comments_and_tests(text);
        Self { path: path.into(), text: text.to_owned(), words, code }
    }

    /// Returns the code with what is compiled for tests, as long as [`Self::text`].
    pub(crate) fn code_with_tests(&self) -> String {
        String::from_utf8_lossy(&blank_out_comments(&self.text).1).into_owned()
    }

    /// Returns how many lines it has.
    pub(crate) fn line_count(&self) -> usize {
        self.text.lines().count()
    }

    /// Returns how many lines are code: those of tests and examples, comments and blank ones do not count.
    pub(crate) fn code_line_count(&self) -> usize {
        let is_code = |line: &&str| !line.trim().is_empty();
        if self.is_test_or_example() { 0 } else { self.words.lines().filter(is_code).count() }
    }

    /// Returns whether all of it is there for tests or examples.
    pub(crate) fn is_test_or_example(&self) -> bool {
        let mut parts = self.path.split('/');
        parts.any(|part| matches!(part, "tests" | "tests.rs" | "examples" | "host-tests"))
    }
}

/// Reads all Rust files below a folder, in the order of their paths; build output and hidden folders
/// are excluded.
pub(crate) fn read_sources(root: &Path) -> Result<Vec<SourceFile>> {
    let mut sources = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name == "target" || name.starts_with('.') {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if name.ends_with(".rs") {
                let text = fs::read_to_string(&path)?;
                let below = path.strip_prefix(root).unwrap_or(&path);
                sources.push(SourceFile::new(below.to_string_lossy().replace('\\', "/"), &text));
            }
        }
    }
    sources.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(sources)
}

/// Returns whether a name stands in a line, as a whole.
pub(crate) fn contains_word(line: &str, name: &str) -> bool {
    let bytes = line.as_bytes();
    let whole = |at: usize| {
        let before = at.checked_sub(1).and_then(|before| bytes.get(before));
        let after = bytes.get(at + name.len());
        ![before, after].into_iter().flatten().any(|&byte| is_identifier_byte(byte))
    };
    line.match_indices(name).any(|(at, _)| whole(at))
}

/// Returns the text with blanks for comments and test code, once with what is in quotes and once without.
fn blank_out_comments_and_tests(text: &str) -> (String, String) {
    let (mut words, mut code) = blank_out_comments(text);
    const TEST_ATTRIBUTE: &[u8] = b"#[cfg(test)]";
    let mut from = 0;
    while let Some(start) = find_subslice(&code[from..], TEST_ATTRIBUTE).map(|at| at + from) {
        let end = find_item_end(&code, start + TEST_ATTRIBUTE.len());
        for part in [&mut words, &mut code] {
            overwrite_with_spaces(&mut part[start..end]);
        }
        from = end;
    }
    let string = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    (string(words), string(code))
}

fn find_subslice(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

/// Where the item ends that begins here: after its `;`, or after the brace that closes its body.
pub(super) fn find_item_end(code: &[u8], from: usize) -> usize {
    let mut depth = 0usize;
    for (at, &byte) in code.iter().enumerate().skip(from) {
        match byte {
            b'{' => depth += 1,
            b'}' => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    return at + 1;
                }
            }
            b';' if depth == 0 => return at + 1,
            _ => {}
        }
    }
    code.len()
}

fn overwrite_with_spaces(bytes: &mut [u8]) {
    bytes.iter_mut().filter(|byte| **byte != b'\n').for_each(|byte| *byte = b' ');
}

/// Returns the text with blanks for comments, once with what is in quotes and once without.
fn blank_out_comments(text: &str) -> (Vec<u8>, Vec<u8>) {
    let bytes = text.as_bytes();
    let (mut words, mut code) = (bytes.to_vec(), bytes.to_vec());
    let mut at = 0;
    while at < bytes.len() {
        let end = match bytes[at] {
            b'/' if bytes[at..].starts_with(b"//") => {
                let end =
                    find_subslice(&bytes[at..], b"\n").map_or(bytes.len(), |length| at + length);
                overwrite_with_spaces(&mut words[at..end]);
                end
            }
            b'/' if bytes[at..].starts_with(b"/*") => {
                let end = find_block_comment_end(bytes, at);
                overwrite_with_spaces(&mut words[at..end]);
                end
            }
            b'"' => find_string_end(bytes, at),
            b'r' if is_raw_string_start(bytes, at) => find_raw_string_end(bytes, at),
            b'\'' => find_char_literal_end(bytes, at),
            _ => {
                at += 1;
                continue;
            }
        };
        overwrite_with_spaces(&mut code[at..end]);
        at = end;
    }
    (words, code)
}

fn find_block_comment_end(bytes: &[u8], from: usize) -> usize {
    let (mut depth, mut at) = (0usize, from);
    while at < bytes.len() {
        if bytes[at..].starts_with(b"/*") {
            (depth, at) = (depth + 1, at + 2);
        } else if bytes[at..].starts_with(b"*/") {
            (depth, at) = (depth - 1, at + 2);
            if depth == 0 {
                break;
            }
        } else {
            at += 1;
        }
    }
    at
}

fn find_string_end(bytes: &[u8], from: usize) -> usize {
    let mut at = from + 1;
    while at < bytes.len() && bytes[at] != b'"' {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    (at + 1).min(bytes.len())
}

/// `r"`, `r#"` and so on, not the end of a name and not a raw name.
fn is_raw_string_start(bytes: &[u8], at: usize) -> bool {
    let hashes = bytes[at + 1..].iter().take_while(|&&byte| byte == b'#').count();
    let in_name = at > 0 && is_identifier_byte(bytes[at - 1]) && bytes[at - 1] != b'b';
    bytes.get(at + 1 + hashes) == Some(&b'"') && !in_name
}

fn find_raw_string_end(bytes: &[u8], from: usize) -> usize {
    let hashes = bytes[from + 1..].iter().take_while(|&&byte| byte == b'#').count();
    let close = [b"\"".as_slice(), &b"#".repeat(hashes)].concat();
    let inside = from + hashes + 2;
    find_subslice(&bytes[inside..], &close)
        .map_or(bytes.len(), |length| inside + length + close.len())
}

/// Returns a character in single quotes; a lifetime ends behind its quote.
fn find_char_literal_end(bytes: &[u8], from: usize) -> usize {
    let rest = &bytes[from + 1..];
    let length = match rest.first() {
        Some(b'\\') => rest.iter().skip(2).position(|&byte| byte == b'\'').map(|at| at + 2),
        // A character may take up to four bytes.
        _ => (1..=4).find(|&length| rest.get(length) == Some(&b'\'')).filter(|&length| {
            std::str::from_utf8(&rest[..length]).is_ok_and(|text| text.chars().count() == 1)
        }),
    };
    length.map_or(from + 1, |length| from + length + 2)
}

/// Returns whether a byte may stand in a name.
pub(crate) fn is_identifier_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_quotes_and_tests_are_no_code() {
        let text = "use a; // use b\nlet x = \"use c\"; /* d /* e */ f */ let y = 'g';\n\
                    let z: &'h str = r#\"use i\"#;\n#[cfg(test)]\nmod tests { use j; }\nuse k;";
        let source = SourceFile::new("x.rs", text);
        for (word, in_words, in_code) in [
            ("use a", true, true),
            ("use b", false, false),
            ("use c", true, false),
            (" d ", false, false),
            (" f ", false, false),
            ("h str", true, true),
            ("use i", true, false),
            ("use j", false, false),
            ("use k", true, true),
        ] {
            assert_eq!(source.words.contains(word), in_words, "{word} in words");
            assert_eq!(source.code.contains(word), in_code, "{word} in code");
        }
        assert_eq!(source.code.len(), text.len());
        assert_eq!(source.code_line_count(), 4);
    }
}
