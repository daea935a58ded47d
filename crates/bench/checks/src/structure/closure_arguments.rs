//! Closure arguments that do not say what they are.

use super::source_file::{SourceFile, is_identifier_byte};

/// The name that says nothing.
const PLACEHOLDER_ARGUMENT: &[u8] = b"it";

/// Returns `file:line` of each closure one of whose arguments is named `it`, those of tests included.
pub(super) fn find_placeholder_arguments(sources: &[SourceFile]) -> Vec<String> {
    let mut found = Vec::new();
    for source in sources {
        let code = source.code_with_tests().into_bytes();
        for place in find_closures_with_placeholder(&code) {
            let line = 1 + code[..place].iter().filter(|byte| **byte == b'\n').count();
            found.push(format!("{}:{line}", source.path));
        }
    }
    found
}

/// Returns where the bars stand that open the arguments of such closures.
fn find_closures_with_placeholder(code: &[u8]) -> Vec<usize> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(open) = find_closure_bar(code, at) {
        at = open + 1;
        if code.get(at) == Some(&b'|') {
            // No arguments, or the operator.
            at += 1;
            continue;
        }
        if !is_closure_start(&code[..open]) {
            continue;
        }
        let Some(close) = find_closure_bar(code, at) else { break };
        let arguments = &code[at..close];
        // A bar between the patterns of a match arm whose first one is in quotes.
        if arguments.windows(2).any(|pair| pair == b"=>") {
            continue;
        }
        if arguments
            .split(|byte| !is_identifier_byte(*byte))
            .any(|word| word == PLACEHOLDER_ARGUMENT)
        {
            found.push(open);
        }
        at = close + 1;
    }
    found
}

fn find_closure_bar(code: &[u8], from: usize) -> Option<usize> {
    code[from..].iter().position(|byte| *byte == b'|').map(|place| from + place)
}

/// Returns whether a bar after this code opens a closure's arguments: after an operand it is an operator.
fn is_closure_start(before: &[u8]) -> bool {
    let before = before.trim_ascii_end();
    before.last().is_none_or(|byte| b"(,=>{};:&[".contains(byte))
        || [b"move".as_slice(), b"return"].iter().any(|word| before.ends_with(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closure_argument_named_it_is_found() {
        let text = "let a = rows.map(|it| it.x);\nlet b = c.fold(0, |sum, &it| sum + it);\n\
                    let d = move |(at, it): (u8, u8)| at | it;\nlet e = &|it: &u8| *it;\n\
                    #[cfg(test)]\nmod tests {\n    fn f() { g(|it| it) }\n}\n";
        let found = find_placeholder_arguments(&[SourceFile::new("x.rs", text)]);
        assert_eq!(found, ["x.rs:1", "x.rs:2", "x.rs:3", "x.rs:4", "x.rs:7"]);
    }

    #[test]
    fn operators_patterns_and_other_names_are_no_such_arguments() {
        let text = "let a = b | it | c;\nlet d = rows.map(|row| row | it);\nlet e = || it || f || it;\n\
                    match c { '\"' | '\\\\' => [it], 'a' | 'b' => g }\n// |it| of a comment\nlet h = \"|it|\";\n\
                    let i = |item, italic| item;\nmatch j { Some(it) | Ok(it) => it | 1 }\n";
        let found = find_placeholder_arguments(&[SourceFile::new("x.rs", text)]);
        assert!(found.is_empty(), "{found:?}");
    }
}
