//! The look of every report: a page that stands alone, light or dark as the reader's screen is, that
//! prints on A4 and fits a telephone.
//!
//! ```text
//!  Page ─► html          one style; sections, cards, tables
//!  Chart ─► figure       an SVG with its legend next to it, ticks without needless digits
//!  Polar ─► figure       deviations from a circle, enlarged
//!  Bars ─► figure        rivals side by side
//!  Forest ─► figure      one value of many machines, with intervals
//! ```
#![forbid(unsafe_code)]

mod bar_chart;
mod chart;
mod forest_plot;
mod html;
mod hyphen_breaks;
mod number;
mod point_reduction;
mod polar_plot;
mod provenance;

pub use bar_chart::BarChart;
pub use chart::{Chart, ChartSeries, ColourRole};
pub use forest_plot::{ForestPlot, ForestRow, IntervalEstimate};
pub use html::{HtmlPage, HtmlTable, NEXT_COMMANDS_HEADING, commands_html, escape_html};
pub use number::{
    choose_time_unit, decimals_for_half_width, format_micrometres, format_three_digits,
    format_with_interval,
};
pub use polar_plot::PolarPlot;
pub use provenance::Provenance;
