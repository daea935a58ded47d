//! Tests of no tier: the tiers choose by the name of a test, its reader by its reason, and the two have to agree.
//!
//! A campaign whose name does not begin with `campaign_` runs in the long tier, for minutes and unnoticed.

use super::source_file::SourceFile;

/// The attribute as it stands at the beginning of a line.
const IGNORE_ATTRIBUTE: &str = "#[ignore";

/// Returns `file: name` of each ignored test whose reason is neither `long: …`, nor `campaign: …` with a name that begins
/// with `campaign_`.
pub(crate) fn find_untiered_tests(sources: &[SourceFile]) -> Vec<String> {
    let found = sources.iter().flat_map(|source| {
        find_ignored_tests(&source.text)
            .filter(|(reason, name)| match reason.split_once(": ") {
                Some(("long", _)) => name.starts_with("campaign_"),
                Some(("campaign", _)) => !name.starts_with("campaign_"),
                _ => true,
            })
            .map(|(_, name)| format!("{}: {name}", source.path))
    });
    found.collect()
}

/// Returns reason and name of each ignored test.
fn find_ignored_tests(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let attributes = text.match_indices(IGNORE_ATTRIBUTE).filter(|(at, _)| {
        text[..*at].chars().rev().take_while(|c| *c != '\n').all(char::is_whitespace)
    });
    attributes.filter_map(|(at, _)| {
        let (attribute, rest) = text[at..].split_once("]\n")?;
        let name = rest.split_once("fn ")?.1.split('(').next()?;
        Some((attribute.split('"').nth(1).unwrap_or_default(), name))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reason_and_name_agree_or_the_test_is_named() {
        // In quotes, so that none of them begins a line of this file.
        let text = [
            "#[test]",
            "#[ignore = \"long: an hour\"]",
            "fn a() {}",
            "#[ignore = \"campaign: cargo test any\"]",
            "fn any_word() {}",
            "#[ignore = \"campaign: cargo test b\"]",
            "async fn campaign_b() {}",
            "    #[ignore]",
            "    fn without_a_reason() {}",
            "// #[ignore]",
            "#[ignore = \"long: never\"]",
            "fn campaign_c() {}",
        ]
        .join("\n");
        let found = find_untiered_tests(&[SourceFile::new("x.rs", &text)]);
        assert_eq!(found, ["x.rs: any_word", "x.rs: without_a_reason", "x.rs: campaign_c"]);
    }
}
