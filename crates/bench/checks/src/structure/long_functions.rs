//! Functions that are too long to be read at once.

use super::source_file::{SourceFile, is_identifier_byte};

/// Lines that a function may have, from its name to its last brace.
pub(crate) const MAX_FUNCTION_LINES: usize = 100;

/// A function above [`MAX_FUNCTION_LINES`] lines.
pub(crate) struct LongFunction {
    /// Its lines.
    pub lines: usize,
    /// `file:line`.
    pub place: String,
    /// Its name.
    pub name: String,
}

/// Returns all functions above [`MAX_FUNCTION_LINES`] lines, tests and examples included.
pub(crate) fn find_long_functions(sources: &[SourceFile]) -> Vec<LongFunction> {
    sources.iter().flat_map(find_long_functions_in_file).collect()
}

fn find_long_functions_in_file(source: &SourceFile) -> Vec<LongFunction> {
    let code = source.code_with_tests();
    let bytes = code.as_bytes();
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ") {
        let follows_a_name =
            at.checked_sub(1).is_some_and(|before| is_identifier_byte(bytes[before]));
        let name: String = code[at + 3..]
            .chars()
            .take_while(|character| character.is_alphanumeric() || *character == '_')
            .collect();
        if follows_a_name || name.is_empty() {
            continue;
        }
        let Some(end) = find_body_end(bytes, at) else { continue };
        let lines = code[at..end].lines().count();
        if lines > MAX_FUNCTION_LINES {
            let line = code[..at].matches('\n').count() + 1;
            found.push(LongFunction { lines, place: format!("{}:{line}", source.path), name });
        }
    }
    found
}

/// Returns the byte behind the brace that closes the body; `None` where a `;` ends the signature.
fn find_body_end(code: &[u8], from: usize) -> Option<usize> {
    let (mut nested, mut braces) = (0usize, 0usize);
    for (at, &byte) in code.iter().enumerate().skip(from) {
        match byte {
            b'(' | b'[' if braces == 0 => nested += 1,
            b')' | b']' if braces == 0 => nested = nested.saturating_sub(1),
            b';' if braces == 0 && nested == 0 => return None,
            b'{' if nested == 0 => braces += 1,
            b'}' if nested == 0 => {
                braces = braces.saturating_sub(1);
                if braces == 0 {
                    return Some(at + 1);
                }
            }
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_is_as_long_as_from_its_name_to_its_brace() {
        let body = |lines: usize| "    g();\n".repeat(lines);
        let text = format!(
            "trait T {{ fn declared(a: [u8; 2]); }}\nfn short() {{\n{}}}\n#[cfg(test)]\nmod tests {{\nfn \
             long(a: [u8; 2]) {{\n    let brace = \"}}\";\n{}}}\n}}",
            body(98),
            body(98)
        );
        let found = find_long_functions(&[SourceFile::new("x.rs", &text)]);
        let found: Vec<_> = found
            .iter()
            .map(|function| (function.lines, function.name.as_str(), function.place.as_str()))
            .collect();
        assert_eq!(found, [(101, "long", "x.rs:104")]);
    }
}
