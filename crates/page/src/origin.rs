//! What a page was made from: without it a print is worth nothing a year later.

use crate::html::Page;

/// Of what, when and by which version a page was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The version of the tool.
    pub version: String,
    /// The day, as `2026-11-22`, in UTC.
    pub date: String,
    /// The files that were read, with the CRC-32 of each (that of zip and Ethernet).
    pub files: Vec<(String, u32)>,
}

impl Page {
    /// The foot of a page.
    pub fn origin(&mut self, origin: &Origin) {
        let Origin { version, date, files } = origin;
        let files: Vec<String> =
            files.iter().map(|(name, crc)| format!("{name} (CRC-32 {crc:08x})")).collect();
        self.note(&format!("Made by trueup {version} on {date} (UTC) from {}.", files.join(", ")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_version_day_and_files() {
        let files = vec![("a.csv".into(), 0xCBF4_3926), ("<m>".into(), 1)];
        let mut page = Page::new("t");
        page.origin(&Origin { version: "1.2.3".into(), date: "2026-11-22".into(), files });
        let html = page.html();
        let said = "Made by trueup 1.2.3 on 2026-11-22 (UTC) from a.csv (CRC-32 cbf43926), \
                    &lt;m&gt; (CRC-32 00000001).";
        assert!(html.contains(said), "{html}");
    }
}
