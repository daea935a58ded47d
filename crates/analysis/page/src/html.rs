//! The page and its parts.

use std::fmt::{Display, Write as _};

use trueup_output::escape;

use crate::hyphen_breaks::prevent_hyphen_breaks;

/// One style for all pages. Colours are variables, so that a picture turns dark with its page; on paper
/// everything is dark on white, and no picture or table is cut by the end of a sheet.
const PAGE_STYLE: &str = "\
:root{--ink:#1d2329;--soft:#5b6670;--paper:#fff;--card:#f5f6f7;--rule:#d5dade;--before:#b5501f;\
--after:#1c62ad;--measured:#5b6670;--truth:#2e7d32;--good:#2e7d32;--open:#a86500;--bad:#b3261e}\
@media(prefers-color-scheme:dark){:root{--ink:#e4e8eb;--soft:#9aa5ae;--paper:#14181b;--card:#1e2428;\
--rule:#39424a;--before:#f0935f;--after:#6fb1f5;--measured:#9aa5ae;--truth:#74c47a;--good:#74c47a;\
--open:#e0a33e;--bad:#ff8a80}}\
*{box-sizing:border-box}\
body{font:16px/1.5 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:64rem;\
margin:0 auto;padding:1rem;overflow-wrap:break-word}\
h1{font-size:1.6rem;line-height:1.2}h2{font-size:1.25rem;margin:2rem 0 .5rem}h3{font-size:1.05rem;\
margin:1.2rem 0 .3rem}p{margin:.4rem 0}small,.soft{color:var(--soft)}\
.card{background:var(--card);border-left:6px solid var(--rule);padding:.6rem 1rem;margin:.8rem 0}\
.card h2{margin-top:0}.good{border-color:var(--good)}.open{border-color:var(--open)}\
.bad{border-color:var(--bad)}.bad h2{color:var(--bad)}\
.figures{display:flex;flex-wrap:wrap;gap:.5rem 2.5rem;margin:.8rem 0}.figures b{display:block;\
font-size:1.7rem;line-height:1.2}\
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,26rem),1fr));gap:1rem}\
figure{margin:.5rem 0;break-inside:avoid}svg{width:100%;height:auto;display:block}\
svg text{font:12px system-ui,sans-serif;fill:var(--soft)}\
figcaption{font-size:.9rem;color:var(--soft)}\
svg .grid{stroke:var(--rule);stroke-width:.7;fill:none}\
svg .zero{stroke:var(--soft);stroke-width:1;fill:none}svg .line{fill:none;stroke-width:1.7}\
svg .line.before{stroke:var(--before)}svg .line.after{stroke:var(--after)}\
svg .line.measured{stroke:var(--measured)}svg .line.truth{stroke:var(--truth);stroke-dasharray:6 4}\
svg .dots{fill:none;stroke-width:4.8;stroke-linecap:round}\
svg .dots.before{stroke:var(--before)}svg .dots.after{stroke:var(--after)}\
svg .dots.measured{stroke:var(--measured)}svg .dots.truth{stroke:var(--truth)}\
span.before,b.before{color:var(--before)}span.after,b.after{color:var(--after)}\
@media(min-width:601px){.w{white-space:nowrap}}.key{white-space:nowrap;margin-left:.8rem;font-weight:600}.key::before{content:\"● \"}\
.key.measured{color:var(--measured)}.key.truth{color:var(--truth)}\
.bars div{display:grid;grid-template-columns:minmax(7rem,16rem) 1fr 3rem;gap:.5rem;align-items:center;\
margin:.2rem 0}.bars .track{background:var(--card);height:.8rem}.bars i{display:block;height:100%}\
.bars i.before{background:var(--before)}.bars i.after{background:var(--after)}.bars b{text-align:right}\
.table{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums}\
td,th{padding:.2rem .8rem .2rem 0;text-align:right;vertical-align:top;border-bottom:1px solid var(--rule);\
overflow-wrap:normal}@media(max-width:600px){td,th{padding:.15rem .25rem .15rem 0;font-size:.66rem}}\
pre{font-size:.8rem;white-space:pre;overflow-x:auto}summary{cursor:pointer;margin:.8rem 0}\
.left td,.left th{text-align:left}td:first-child,th:first-child,td.text{text-align:left}\
@page{size:A4;margin:12mm 15mm}\
@media print{:root{--ink:#000;--soft:#444;--paper:#fff;--card:#f2f2f2;--rule:#bbb;--before:#a04010;\
--after:#104a90;--measured:#555;--truth:#1b5e20;--good:#1b5e20;--open:#8a5200;--bad:#a01010}\
body{max-width:none;padding:0;font-size:9pt;line-height:1.3}pre{white-space:pre-wrap}figure{max-width:10cm}\
.card{padding:.3rem .8rem;margin:.4rem 0}.card h2,h2{font-size:1.1rem}p{margin:.2rem 0}td,th{padding-block:.16rem}\
.figures{margin:.3rem 0;gap:.3rem 1.5rem}.figures b{font-size:1.2rem}h1{font-size:1.3rem;margin:.2rem 0}\
h2{margin:.6rem 0 .2rem}.card,tr{break-inside:avoid}h2,h3{break-after:avoid}\
.grid{grid-template-columns:1fr 1fr}*{print-color-adjust:exact}}";

/// The line before the commands to be typed next.
pub const NEXT_COMMANDS_HEADING: &str = "Next, in a terminal:";

/// A page that is being written.
#[derive(Clone, Debug)]
pub struct HtmlPage {
    title: String,
    body: String,
}

impl HtmlPage {
    /// Returns a page of this title, which is also its first heading.
    #[must_use]
    pub fn new(title: &str) -> Self {
        Self { title: title.into(), body: format!("<h1>{}</h1>\n", escape_html(title)) }
    }

    /// A heading.
    pub fn add_heading(&mut self, text: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape_html(text));
    }

    /// A heading below a heading.
    pub fn add_subheading(&mut self, text: &str) {
        let _ = writeln!(self.body, "<h3>{}</h3>", escape_html(text));
    }

    /// A paragraph.
    pub fn add_paragraph(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape_html(text));
    }

    /// A paragraph of what stands behind: smaller in weight.
    pub fn add_note(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p class=\"soft\">{}</p>", escape_html(text));
    }

    /// Sentences, one below the other.
    pub fn add_list<T: AsRef<str>>(&mut self, sentences: &[T]) {
        if sentences.is_empty() {
            return;
        }
        self.body.push_str("<ul>\n");
        for sentence in sentences {
            let _ = writeln!(self.body, "<li>{}</li>", escape_html(sentence.as_ref()));
        }
        self.body.push_str("</ul>\n");
    }

    /// A result, in a card: `state` is `good`, `open` or `bad`.
    pub fn add_card<T: AsRef<str>>(&mut self, state: &str, heading: &str, sentences: &[T]) {
        self.add_card_with_commands(state, heading, sentences, &[]);
    }

    /// The same, with the lines to be typed next at its end.
    pub fn add_card_with_commands<T: AsRef<str>>(
        &mut self,
        state: &str,
        heading: &str,
        sentences: &[T],
        next: &[String],
    ) {
        let _ =
            writeln!(self.body, "<div class=\"card {state}\"><h2>{}</h2>", escape_html(heading));
        for sentence in sentences {
            self.add_paragraph(sentence.as_ref());
        }
        self.body.push_str(&commands_html(NEXT_COMMANDS_HEADING, next));
        self.body.push_str("</div>\n");
    }

    /// Large figures with what they are: (figure, meaning, class).
    pub fn add_key_figures(&mut self, figures: &[(String, String, &str)]) {
        self.body.push_str("<div class=\"figures\">");
        for (figure, meaning, class) in figures {
            let _ = write!(
                self.body,
                "<div><b class=\"{class}\">{}</b>{}</div>",
                escape_html(figure),
                escape_html(meaning)
            );
        }
        self.body.push_str("</div>\n");
    }

    /// Pictures side by side, where the page is wide enough.
    pub fn add_charts(&mut self, figures: &[String]) {
        let _ = writeln!(self.body, "<div class=\"grid\">{}</div>", figures.concat());
    }

    /// A table.
    pub fn add_table(&mut self, table: &HtmlTable) {
        self.body.push_str(&table.to_html());
    }

    /// A text that only some want to read, behind its heading, its lines as they are.
    pub fn add_details(&mut self, heading: &str, text: &str) {
        let (heading, text) = (escape_html(heading), escape_html(text));
        let _ =
            writeln!(self.body, "<details><summary>{heading}</summary><pre>{text}</pre></details>");
    }

    /// HTML that was made elsewhere, in the classes of the style; what a user wrote must be escaped in it.
    pub fn add_raw_html(&mut self, html: &str) {
        self.body.push_str(html);
    }

    /// Returns the whole page.
    #[must_use]
    pub fn to_html(&self) -> String {
        format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
             <meta name=\"color-scheme\" content=\"light dark\">\n\
             <title>{}</title>\n<style>{PAGE_STYLE}</style></head>\n<body>\n{}</body></html>\n",
            escape_html(&self.title),
            prevent_hyphen_breaks(&self.body)
        )
    }
}

/// Lines to be typed as HTML, with what they are for; an empty text where there are none.
#[must_use]
pub fn commands_html<T: AsRef<str>>(what: &str, lines: &[T]) -> String {
    let lines: Vec<&str> = lines.iter().map(AsRef::as_ref).collect();
    if lines.is_empty() {
        return String::new();
    }
    format!("<p>{}</p>\n<pre>{}</pre>\n", escape_html(what), escape_html(&lines.join("\n")))
}

/// A table.
#[derive(Clone, Debug, Default)]
pub struct HtmlTable {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl HtmlTable {
    /// Returns a table with these columns.
    #[must_use]
    pub fn new<T: Display>(head: &[T]) -> Self {
        Self { head: head.iter().map(ToString::to_string).collect(), rows: Vec::new() }
    }

    /// Adds a row.
    pub fn add_row<T: Display>(&mut self, cells: &[T]) {
        self.rows.push(cells.iter().map(ToString::to_string).collect());
    }

    fn to_html(&self) -> String {
        let line = |cells: &[String], tag: &str| {
            let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape_html(cell)));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows: String = self.rows.iter().map(|row| line(row, "td")).collect();
        format!("<div class=\"table\"><table>\n{}{rows}</table></div>\n", line(&self.head, "th"))
    }
}

/// `text` with what HTML takes for its own, and what turns the direction of a line, written out.
#[must_use]
pub fn escape_html(text: &str) -> String {
    let text = escape::escape_except_line_breaks(text);
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_stands_alone_and_what_a_user_wrote_is_text() {
        let mut page = HtmlPage::new("A <script>");
        page.add_card("good", "All right", &["1 < 2"]);
        let mut table = HtmlTable::new(&["a", "b"]);
        table.add_row(&["<b>", "2"]);
        page.add_table(&table);
        let html = page.to_html();
        for outside in ["<script", "<link", "src=", "href=", "url("] {
            assert!(!html.contains(outside), "{outside}");
        }
        for part in ["1 &lt; 2", "<td>&lt;b&gt;</td>", "prefers-color-scheme:dark", "size:A4"] {
            assert!(html.contains(part), "{part}");
        }
    }
}
