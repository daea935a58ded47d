//! The range that the numbers of a key should have, declared with the key, or for all keys of a unit.
//!
//! A key has its own range, else that of its section, else that of its unit ([`UNIT_RANGES`]). `hard` is what no machine can
//! have, wide enough that nothing real is refused; outside `likely` a value is doubted; `usual` is what machines have.

/// The range of a key, and what was probably done wrong where a value is outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlausibleRange {
    /// Outside, the value is impossible.
    pub hard: [f64; 2],
    /// Outside, it is unlikely.
    pub likely: [f64; 2],
    /// The range that is usual for machines.
    pub usual: [f64; 2],
    /// The source, or the reason.
    pub source: &'static str,
    /// The likely slip of a value that is too small or negative.
    pub below: &'static str,
    /// The likely slip of a value that is too large.
    pub above: &'static str,
}

/// Declares a range: what is possible, what is likely, what is usual, and the source.
pub(crate) const fn range(
    hard: [f64; 2],
    likely: [f64; 2],
    usual: [f64; 2],
    source: &'static str,
) -> PlausibleRange {
    PlausibleRange { hard, likely, usual, source, below: UNIT_HINT, above: UNIT_HINT }
}

/// Declares that any number can be meant.
pub(crate) const fn unbounded(source: &'static str) -> PlausibleRange {
    let all = [-UNBOUNDED_LIMIT, UNBOUNDED_LIMIT];
    range(all, all, all, source)
}

impl PlausibleRange {
    /// Returns it with the likely slip of a value that is too small or negative.
    pub(crate) const fn with_hint_below(self, below: &'static str) -> Self {
        Self { below, ..self }
    }

    /// Returns it with the likely slip of a value that is too large.
    pub(crate) const fn with_hint_above(self, above: &'static str) -> Self {
        Self { above, ..self }
    }
}

const UNIT_HINT: &str = "its unit is probably another one";
/// The slip of a backlash that is negative.
pub(crate) const REVERSED_SIGN_HINT: &str = "the sign is reversed: errors are actual minus commanded; or the direction of \
                                                approach (dir_x, dir_y, dir_z) is reversed";
pub(crate) const SPINDLE_SIGN_HINT: &str = "the spindle would shrink as it becomes warm; the sign is reversed: an elongation is \
                       positive where the tool comes out of the spindle";
pub(crate) const AXIS_SIGN_HINT: &str = "the axis would shrink as it becomes warm; the sign is reversed: errors are actual minus \
                            commanded";
pub(crate) const NANOMETRES_HINT: &str = "probably in nm instead of µm";
pub(crate) const MINUTES_HINT: &str = "probably in minutes instead of s";
pub(crate) const MILLISECONDS_HINT: &str = "probably in ms instead of s";
pub(crate) const TEMPERATURE_UNIT_HINT: &str = "probably in kelvin, °F or tenths instead of °C";
pub(crate) const GAUGE_ZERO_HINT: &str =
    "a gauge that was not set to zero puts it there, or fault values of a thermometer";
pub(crate) const MICROMETRES_HINT: &str = "probably in µm instead of mm";
pub(crate) const EXPANSION_UNIT_HINT: &str =
    "more than any metal expands by: its unit is probably not µm for one metre and one kelvin";
pub(crate) const SENSOR_SIGN_HINT: &str = "the growth would be turned round: the sign is that of an error measured the \
                                other way round, or of the sensor";

pub(crate) const EXPANSION_SOURCE: &str = "Invar 1, cast iron 10, steel 11.5, aluminium 23.8, \
    plastics up to 100. A thermometer that sees a part of the heat makes it a few times as much";
pub(crate) const GROWTH_SOURCE: &str =
    "0.1 to 0.5 m of steel or ceramic, 11.5 µm/(m·K), seen by one thermometer";
pub(crate) const TIME_CONSTANT_SOURCE: &str = "a body of thickness L settles in L²/(π²·a): 1 m of cast iron 2 h, a foundation of 2 m \
                    of concrete 5·10⁵ s";
pub(crate) const BACKLASH_SOURCE: &str =
    "ISO 230-2 reports of screws; a negative one is that of a CNC that compensates too much";
pub(crate) const ERROR_RANGE_SOURCE: &str =
    "ISO 230-2 reports of machines up to 15 m; the board takes at most 4000 µm";
pub(crate) const LENGTH_SOURCE: &str = "the longest machine tools travel 100 m";
pub(crate) const TEMPERATURE_SOURCE: &str =
    "EN 60204-1: a machine works at 5 to 40 °C, and what runs in it is warmer by 30 K";
pub(crate) const ANGLE_SOURCE: &str = "ISO 230-1 reports; 2000 µm/m is 0.11°";
pub(crate) const USER_SETTING_SOURCE: &str = "set by the user, and bounded by the board";
pub(crate) const LAW_FORM_SOURCE: &str = "the law's own form";
pub(crate) const MACHINE_DATA_SOURCE: &str = "data sheets of machine tools";

/// Larger than any value.
pub(crate) const UNBOUNDED_LIMIT: f64 = 1e15;

/// Of a number in the unit of a column that the user has named.
pub(crate) const USER_UNIT_RANGE: PlausibleRange =
    unbounded("the unit of the column is the user's");

/// Of a time of the run's clock.
pub(crate) const CLOCK_TIME_RANGE: PlausibleRange = unbounded("a clock counts from anywhere");

/// Of a growth with speed, for (1000 r/min)².
pub(crate) const SPEED_GROWTH_RANGE: PlausibleRange =
    range([-100.0, 100.0], [-5.0, 5.0], [-0.2, 0.2], "20 to 60 µm at 24 000 r/min")
        .with_hint_above("probably for r/min instead of 1000 r/min");

/// Of the degree of a spline plus one.
pub(crate) const SPLINE_ORDER_RANGE: PlausibleRange =
    range([2.0, 4.0], [2.0, 4.0], [2.0, 4.0], LAW_FORM_SOURCE);

/// The ranges of the keys that have none of their own, by their unit.
#[rustfmt::skip]
const UNIT_RANGES: &[(&str, PlausibleRange)] = &[
    ("mm/min", range([0.0, 1e7], [0.1, 3e5], [10.0, 1e5], MACHINE_DATA_SOURCE)),
    ("µm/(m·K)", range([-500.0, 500.0], [-100.0, 100.0], [-25.0, 25.0], EXPANSION_SOURCE).with_hint_above(EXPANSION_UNIT_HINT)),
    ("µm/m", range([-1e5, 1e5], [-2000.0, 2000.0], [-100.0, 100.0], ANGLE_SOURCE).with_hint_above("probably in nm for one metre")),
    ("µrad/m", range([-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLE_SOURCE)),
    ("µrad", range([-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLE_SOURCE)),
    ("µm/h", range([-1e6, 1e6], [-1000.0, 1000.0], [-20.0, 20.0], ERROR_RANGE_SOURCE)),
    ("mm", range([-1e6, 1e6], [-1e5, 1e5], [-2e4, 2e4], LENGTH_SOURCE).with_hint_below(MICROMETRES_HINT).with_hint_above(MICROMETRES_HINT)),
    ("µm", range([-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERROR_RANGE_SOURCE).with_hint_below(NANOMETRES_HINT).with_hint_above(NANOMETRES_HINT)),
    ("°C", range([-200.0, 850.0], [-40.0, 150.0], [15.0, 40.0], TEMPERATURE_SOURCE)
        .with_hint_below(GAUGE_ZERO_HINT).with_hint_above(TEMPERATURE_UNIT_HINT)),
    ("°", range([-1e6, 1e6], [-1e5, 1e5], [-360.0, 360.0], LAW_FORM_SOURCE)),
];

/// Returns the range of the keys of a unit that have none of their own.
pub(crate) fn default_range_for_unit(unit: &str) -> Option<PlausibleRange> {
    UNIT_RANGES.iter().find(|(of, _)| *of == unit).map(|(_, range)| *range)
}
