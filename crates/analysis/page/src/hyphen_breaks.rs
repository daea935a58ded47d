//! Words with a hyphen (`sensor-gain`, `2026-11-22`) that stand alone, as in the cell of a table: a browser may end a line
//! behind any hyphen between letters, and does so in a narrow column. On a telephone it may: a table has to fit there.

/// A word longer than this does not fit a telephone, and may be broken.
const MAX_UNBROKEN_CHARS: usize = 40;
/// Where lines are never broken, or as they are written.
const SKIPPED_ELEMENTS: [&str; 2] = ["svg", "pre"];

/// Returns `html` with each such word in a `span` that keeps it on one line.
pub(crate) fn prevent_hyphen_breaks(html: &str) -> String {
    let mut out = String::with_capacity(html.len() + html.len() / 16);
    let mut rest = html;
    let mut inside: Option<&str> = None;
    while let Some(begin) = rest.find('<') {
        let (text, tag) = rest.split_at(begin);
        push_text(text, inside.is_some(), &mut out);
        let end = tag.find('>').map_or(tag.len(), |at| at + 1);
        let (tag, after) = tag.split_at(end);
        out.push_str(tag);
        let name = |tag: &str| {
            let name = tag.trim_start_matches(['<', '/']);
            SKIPPED_ELEMENTS.into_iter().find(|element| {
                name.strip_prefix(element).is_some_and(|rest| rest.starts_with([' ', '>']))
            })
        };
        match inside {
            Some(of) if tag.starts_with("</") && name(tag) == Some(of) => inside = None,
            None if !tag.starts_with("</") => inside = name(tag),
            _ => {}
        }
        rest = after;
    }
    push_text(rest, inside.is_some(), &mut out);
    out
}

fn push_text(text: &str, as_it_is: bool, out: &mut String) {
    if as_it_is || !text.contains('-') {
        out.push_str(text);
        return;
    }
    let word = text.trim();
    let is_word = !word.contains(char::is_whitespace) && word.chars().count() <= MAX_UNBROKEN_CHARS;
    if is_word && has_inner_hyphen(word) {
        let (before, after) = text.split_at(text.len() - text.trim_start().len());
        out.push_str(before);
        out.push_str("<span class=\"w\">");
        out.push_str(word);
        out.push_str("</span>");
        out.push_str(after.get(word.len()..).unwrap_or_default());
    } else {
        out.push_str(text);
    }
}

/// Returns whether a hyphen stands between two letters or digits.
fn has_inner_hyphen(word: &str) -> bool {
    let letters: Vec<char> = word.chars().collect();
    letters.windows(3).any(|window| {
        window[0].is_alphanumeric() && window[1] == '-' && window[2].is_alphanumeric()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_with_a_hyphen_stay_whole_and_nothing_else_changes() {
        for (html, requested) in [
            ("<p>no hyphen, -3 µm</p>", None),
            ("<pre>extra-heat-path</pre>", None),
            ("<svg aria-label=\"a-b\"><text>a-b</text></svg>", None),
            ("<td class=\"a-b\">c</td>", None),
            ("<td>sensor-gain</td>", Some("<td><span class=\"w\">sensor-gain</span></td>")),
            ("<b> 2026-11-22</b>", Some("<b> <span class=\"w\">2026-11-22</span></b>")),
            // A sentence ends its lines where it likes.
            ("<p>the time-shift of 2026-11-22</p>", None),
        ] {
            assert_eq!(prevent_hyphen_breaks(html), requested.unwrap_or(html));
        }
        let long = format!("<p>{}</p>", "a-b".repeat(20));
        assert_eq!(prevent_hyphen_breaks(&long), long);
    }
}
