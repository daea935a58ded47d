//! The foot of a page with its origin: without it a print is worth nothing a year later.

use crate::html::{HtmlPage, HtmlTable, escape_html};

/// Of what, when and by which version a page was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Provenance {
    /// The version of the tool.
    pub version: String,
    /// The day, as `2026-11-22`, in UTC.
    pub date: String,
    /// The files that were read, with the CRC-32 of each (that of zip and Ethernet).
    pub files: Vec<(String, u32)>,
}

impl HtmlPage {
    /// The foot of a page.
    pub fn add_provenance_footer(&mut self, origin: &Provenance) {
        let Provenance { version, date, files } = origin;
        let files: Vec<String> =
            files.iter().map(|(name, crc)| format!("{name} (CRC-32 {crc:08x})")).collect();
        let from =
            if files.is_empty() { String::new() } else { format!(" from {}", files.join(", ")) };
        let text = escape_html(&format!("Made by trueup {version} on {date} (UTC){from}."));
        // A path may break behind a slash, and nowhere else.
        self.add_raw_html(&format!("<p class=\"soft\">{}</p>\n", text.replace('/', "/<wbr>")));
    }

    /// Lines to be filled in by hand: who has measured what by what, and who answers for it.
    pub fn add_signature_block(&mut self) {
        let mut table = HtmlTable::new(&["to be filled in", ""]);
        for what in [
            "Machine, serial number",
            "Instrument, its number",
            "Calibrated until",
            "Operator",
            "Temperature at start and end, °C",
            "Date, signature",
        ] {
            table.add_row(&[what, &"_".repeat(20)]);
        }
        self.add_table(&table);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_version_day_and_files() {
        let files = vec![("a.csv".into(), 0xCBF4_3926), ("<m>".into(), 1)];
        let mut page = HtmlPage::new("t");
        page.add_provenance_footer(&Provenance {
            version: "1.2.3".into(),
            date: "2026-11-22".into(),
            files,
        });
        let html = page.to_html();
        let message = "Made by trueup 1.2.3 on 2026-11-22 (UTC) from a.csv (CRC-32 cbf43926), \
                    &lt;m&gt; (CRC-32 00000001).";
        assert!(html.contains(message), "{html}");
    }
}
