//! Bars side by side: what was found, and how much worse its rivals are.

use std::fmt::Write as _;

use crate::{chart::ColourRole, html::escape_html};

/// Named sizes, each a bar; a size below 0 is drawn as 0 and written as it is.
#[derive(Clone, Debug)]
pub struct BarChart {
    /// The caption: the meaning of the sizes, in a sentence.
    pub title: String,
    /// Names and sizes.
    pub bars: Vec<(String, f64)>,
    /// From this size on a bar is clearly different, and drawn in another colour.
    pub clear: f64,
}

impl BarChart {
    /// Returns the bars as a figure; an empty text where there are none.
    #[must_use]
    pub fn to_figure(&self) -> String {
        let largest = self.bars.iter().map(|(_, size)| *size).fold(self.clear, f64::max);
        if self.bars.is_empty() || !(largest.is_finite() && largest > 0.0) {
            return String::new();
        }
        let mut out = String::from("<figure class=\"bars\">");
        for (name, size) in &self.bars {
            let colour = if *size >= self.clear { ColourRole::After } else { ColourRole::Before };
            let _ = write!(
                out,
                "<div><span class=\"name\">{}</span><span class=\"track\"><i class=\"{}\" \
                 style=\"width:{:.1}%\"></i></span><b>{:.0}</b></div>",
                escape_html(name),
                colour.css_class(),
                (100.0 * size / largest).clamp(0.0, 100.0),
                size
            );
        }
        let _ = writeln!(out, "<figcaption>{}</figcaption></figure>", escape_html(&self.title));
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_as_long_as_its_size_and_none_is_longer_than_its_track() {
        let bars = vec![("near".to_string(), 3.0), ("far".to_string(), 30.0), ("no".into(), -4.0)];
        let figure = BarChart { title: "t".into(), bars, clear: 6.0 }.to_figure();
        for part in ["before\" style=\"width:10.0%", "after\" style=\"width:100.0%", "width:0.0%"] {
            assert!(figure.contains(part), "{part}: {figure}");
        }
        assert_eq!(BarChart { title: String::new(), bars: Vec::new(), clear: 6.0 }.to_figure(), "");
    }
}
