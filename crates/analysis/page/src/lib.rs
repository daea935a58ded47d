//! The look of every report: a page that stands alone, light or dark as the reader's screen is, that
//! prints on A4 and fits a telephone.
//!
//! ```text
//!  Page ─► html          one style; sections, cards, tables
//!  Chart ─► figure       an SVG with its legend beside it, ticks without needless digits
//!  Polar ─► figure       deviations from a circle, enlarged
//!  Bars ─► figure        rivals side by side
//!  Forest ─► figure      one value of many machines, with intervals
//! ```
#![forbid(unsafe_code)]

mod bars;
mod chart;
mod forest;
mod html;
mod number;
mod origin;
mod polar;
mod seen;
mod unbroken;

pub use bars::Bars;
pub use chart::{Chart, Colour, Series};
pub use forest::{Forest, ForestRow, Ranged};
pub use html::{NEXT, Page, Table, commands, escaped};
pub use number::{decimals_of_half_width, micrometres, significant, time_unit, within};
pub use origin::Origin;
pub use polar::Polar;
