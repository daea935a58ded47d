//! The table of physical ranges: one row for a key, or for all keys of a unit.
//!
//! The first row whose pattern matches applies. `*` stands for any text; a term's key is
//! `term.<cause>.<key>`. Rows of single keys come first, those of whole units last: names carry
//! their unit. `hard` is what no machine can have, wide enough that nothing real is refused;
//! outside `likely` a value is doubted; `usual` is what machines have.

/// The range of a key, and what was probably done wrong where a value is outside.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlausibleRange {
    /// The keys that it holds for.
    pub keys: &'static str,
    /// Their unit; empty for a bare number.
    pub unit: &'static str,
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

const fn range(
    keys: &'static str,
    unit: &'static str,
    hard: [f64; 2],
    likely: [f64; 2],
    usual: [f64; 2],
    source: &'static str,
) -> PlausibleRange {
    PlausibleRange { keys, unit, hard, likely, usual, source, below: UNIT_HINT, above: UNIT_HINT }
}

impl PlausibleRange {
    const fn with_hint_below(self, below: &'static str) -> Self {
        Self { below, ..self }
    }

    const fn with_hint_above(self, above: &'static str) -> Self {
        Self { above, ..self }
    }
}

const UNIT_HINT: &str = "its unit is probably another one";
/// The slip of a backlash that is negative.
pub(super) const REVERSED_SIGN_HINT: &str = "the sign is that of an error measured the other way round \
                                                (errors are actual minus commanded), or of a direction of \
                                                approach (dir_x, dir_y, dir_z) that is reversed";
const SPINDLE_SIGN_HINT: &str = "the spindle would shrink as it becomes warm: the sign is that of an error measured \
                       the other way round (an elongation is positive where the tool comes out of the spindle)";
const AXIS_SIGN_HINT: &str = "the axis would shrink as it becomes warm: the sign is that of an error measured \
                            the other way round (errors are actual minus commanded)";
const NANOMETRES_HINT: &str = "probably in nm instead of µm";
const MINUTES_HINT: &str = "probably in minutes instead of s";
const MILLISECONDS_HINT: &str = "probably in ms instead of s";
const KELVIN_HINT: &str = "probably in kelvin, °F or tenths instead of °C";
const GAUGE_ZERO_HINT: &str =
    "a gauge that was not set to zero puts it there, or fault values of a thermometer";
const MICROMETRES_HINT: &str = "probably in µm instead of mm";
const EXPANSION_UNIT_HINT: &str =
    "more than any metal expands by: its unit is probably not µm for one metre and one kelvin";
const SENSOR_SIGN_HINT: &str = "the growth would be turned round: the sign is that of an error measured the \
                                other way round, or of the sensor";

const EXPANSION_SOURCE: &str = "Invar 1, cast iron 10, steel 11.5, aluminium 23.8, plastics up to 100; a \
                         thermometer that sees a part of the heat makes it a few times as much";
const GROWTH_SOURCE: &str =
    "0.1 to 0.5 m of steel or ceramic, 11.5 µm/(m·K), seen by one thermometer";
const TIME_CONSTANT_SOURCE: &str = "a body of thickness L settles in L²/(π²·a): 1 m of cast iron 2 h, a foundation of 2 m \
                    of concrete 5·10⁵ s";
const BACKLASH_SOURCE: &str =
    "ISO 230-2 reports of screws; a negative one is that of a CNC that compensates too much";
const ERROR_RANGE_SOURCE: &str =
    "ISO 230-2 reports of machines up to 15 m; the board takes at most 4000 µm";
const LENGTH_SOURCE: &str = "the longest machine tools travel 100 m";
const TEMPERATURE_SOURCE: &str =
    "EN 60204-1: a machine works at 5 to 40 °C, and what runs in it is warmer by 30 K";
const ANGLE_SOURCE: &str = "ISO 230-1 reports; 2000 µm/m is 0.11°";
const USER_SETTING_SOURCE: &str = "set by the user, and bounded by the board";
const LAW_FORM_SOURCE: &str = "the law's own form";
const UNBOUNDED: f64 = 1e15;

/// The ranges, in the order in which they are looked up.
#[rustfmt::skip]
pub(crate) const PLAUSIBLE_RANGES: &[PlausibleRange] = &[
    // the spindle
    range("spindle.temperature.k_um_per_c", "µm/K", [-200.0, 200.0], [0.0, 30.0], [0.1, 15.0], GROWTH_SOURCE)
        .with_hint_below(SPINDLE_SIGN_HINT).with_hint_above(NANOMETRES_HINT),
    range("spindle.temperature.lag_s", "s", [0.0, 5e5], [0.0, 1e5], [0.0, 2e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT),
    range("spindle.warmup.lag_s", "s", [0.0, 1e5], [0.0, 7200.0], [0.0, 600.0], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT),
    range("spindle.warmup.warm_s", "s", [0.0, 5e5], [120.0, 1e5], [1200.0, 2e4], TIME_CONSTANT_SOURCE)
        .with_hint_below(MINUTES_HINT).with_hint_above(MILLISECONDS_HINT),
    range("spindle.warmup.max_um", "µm", [-2000.0, 2000.0], [0.0, 500.0], [5.0, 200.0], GROWTH_SOURCE)
        .with_hint_below(SPINDLE_SIGN_HINT).with_hint_above(NANOMETRES_HINT),
    range("spindle.warmup.exponent", "", [0.0, 1e3], [0.01, 50.0], [0.5, 8.0], LAW_FORM_SOURCE),
    range("spindle.warmup.cool_s", "s", [0.0, 5e5], [10.0, 1e5], [300.0, 2e4], TIME_CONSTANT_SOURCE)
        .with_hint_below(MINUTES_HINT).with_hint_above(MILLISECONDS_HINT),
    range("spindle.warmup.rated_rpm", "r/min", [0.0, 1e6], [100.0, 2e5], [3000.0, 6e4], "data sheets of spindles")
        .with_hint_below("probably in 1000 r/min or r/s instead of r/min"),
    range("spindle.warmup.speed_exponent", "", [0.0, 20.0], [0.0, 4.0], [0.0, 2.0], LAW_FORM_SOURCE),
    range("spindle.sensor.k0_um", "µm", [-1e5, 1e5], [-5000.0, 5000.0], [-500.0, 500.0], "the range of a displacement sensor"),
    range("spindle.sensor.*", "", [-1e10, 1e10], [-1e9, 1e9], [-1e5, 1e5], "`check` holds it against [inputs] sensor"),
    range("spindle.tools.*.number", "", [0.0, 65535.0], [0.0, 65535.0], [1.0, 100.0], USER_SETTING_SOURCE),
    // the axes
    range("axis.*.thermal.slope_um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], EXPANSION_SOURCE)
        .with_hint_below(AXIS_SIGN_HINT).with_hint_above(EXPANSION_UNIT_HINT),
    range("axis.*.thermal.constant_um_per_c", "µm/K", [-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], EXPANSION_SOURCE)
        .with_hint_above(NANOMETRES_HINT),
    range("axis.*.thermal.lag_s", "s", [0.0, 5e5], [0.0, 2e5], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT),
    range("axis.*.backlash.width_um", "µm", [-5000.0, 5000.0], [-0.5, 300.0], [0.0, 30.0], BACKLASH_SOURCE)
        .with_hint_below(REVERSED_SIGN_HINT).with_hint_above(NANOMETRES_HINT),
    range("axis.*.backlash.ramp_mm", "mm", [0.0, 1e4], [0.0, 50.0], [0.0, 1.0], BACKLASH_SOURCE).with_hint_above(MICROMETRES_HINT),
    range("axis.*.backlash.hysteresis_um", "µm", [0.0, 1e4], [0.0, 300.0], [0.0, 10.0], BACKLASH_SOURCE).with_hint_above(NANOMETRES_HINT),
    range("axis.*.rapid_mm_per_min", "mm/min", [0.0, 1e7], [100.0, 3e5], [5000.0, 1e5], "data sheets of machine tools")
        .with_hint_below("probably in m/min instead of mm/min"),
    // causes: each after its page
    range("term.expansion-slope.um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], EXPANSION_SOURCE)
        .with_hint_below(AXIS_SIGN_HINT).with_hint_above(EXPANSION_UNIT_HINT),
    range("term.axis-expansion.um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], EXPANSION_SOURCE)
        .with_hint_below(AXIS_SIGN_HINT).with_hint_above(EXPANSION_UNIT_HINT),
    range("term.*.scale", "", [-1e3, 1e3], [0.0, 10.0], [0.3, 3.0], GROWTH_SOURCE).with_hint_below(SPINDLE_SIGN_HINT),
    range("term.*.gain", "", [-1e3, 1e3], [0.1, 10.0], [0.5, 2.0], "the paper's sensor has 1.2 to 1.3")
        .with_hint_below(SENSOR_SIGN_HINT),
    range("term.*.per_um", "1/µm", [-10.0, 10.0], [-0.1, 0.1], [-0.01, 0.01], LAW_FORM_SOURCE),
    range("term.sensor-offset.offset_um", "µm", [-2e4, 2e4], [-1000.0, 1000.0], [-200.0, 200.0], GROWTH_SOURCE).with_hint_above(NANOMETRES_HINT),
    range("term.slow-mode.amplitude_um", "µm", [-2e4, 2e4], [-500.0, 500.0], [-100.0, 100.0], GROWTH_SOURCE).with_hint_above(NANOMETRES_HINT),
    range("term.*.fraction", "", [0.0, 1.0], [0.0, 0.5], [0.0, 0.05], LAW_FORM_SOURCE),
    range("term.*.slope_over", "", [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], LAW_FORM_SOURCE),
    range("term.*.shift_c", "K", [-300.0, 300.0], [-40.0, 40.0], [-10.0, 10.0], TEMPERATURE_SOURCE).with_hint_above(KELVIN_HINT),
    range("term.*.shift_s", "s", [-1e7, 1e7], [-7200.0, 7200.0], [-60.0, 60.0], "two clocks of one workshop")
        .with_hint_below(MILLISECONDS_HINT).with_hint_above(MILLISECONDS_HINT),
    range("term.*.width_um", "µm", [-5000.0, 5000.0], [-300.0, 300.0], [-30.0, 30.0], BACKLASH_SOURCE).with_hint_above(NANOMETRES_HINT),
    range("term.*.um_per_c", "µm/K", [-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], EXPANSION_SOURCE).with_hint_above(NANOMETRES_HINT),
    range("term.*.um_per_n", "µm/N", [-100.0, 100.0], [-1.0, 1.0], [-0.1, 0.1], "a stiffness of 10 to 200 N/µm")
        .with_hint_above("probably in µm for one kN"),
    range("term.dependence.level_um", "µm", [-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERROR_RANGE_SOURCE).with_hint_below(NANOMETRES_HINT).with_hint_above(NANOMETRES_HINT),
    range("term.dependence.lag_s", "s", [0.0, 1e9], [0.0, 2e6], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT),
    range("term.*.where_above", "", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "the unit of the column is the user's"),
    range("term.*.where_below", "", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "the unit of the column is the user's"),
    range("term.dependence.*", "", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "the unit of the column is the user's"),
    // A diagnosis of weeks finds what takes months.
    range("term.*.time_constant_s", "s", [0.0, 1e9], [0.0, 2e6], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT),
    range("term.*.harmonic", "", [1.0, 1e3], [1.0, 1e3], [1.0, 10.0], LAW_FORM_SOURCE),
    range("term.*.constant_um", "µm", [-1e6, 1e6], [-5000.0, 5000.0], [-500.0, 500.0], "the zero of a gauge is arbitrary"),
    range("term.*.at_s", "s", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "a clock counts from anywhere"),
    range("term.*.start_s", "s", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "a clock counts from anywhere"),
    range("term.*.reference_run", "", [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], "runs are numbered from anywhere"),
    // what the user sets
    range("machine.*", "", [-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], "a direction, at length 1"),
    range("limits.*", "", [0.0, UNBOUNDED], [0.0, UNBOUNDED], [0.0, UNBOUNDED], USER_SETTING_SOURCE),
    range("thermal_state.*", "K", [0.0, 100.0], [0.0, 5.0], [0.2, 1.0], USER_SETTING_SOURCE),
    range("instrument.*", "µm", [0.0, 1e5], [0.001, 100.0], [0.1, 5.0], "data sheets of gauges, interferometers and probes")
        .with_hint_below("probably in mm instead of µm").with_hint_above(NANOMETRES_HINT),
    range("inputs.sensor.volts_full_scale", "V", [0.0, 1e4], [0.1, 100.0], [1.0, 10.0], "data sheets of sensors")
        .with_hint_above("probably in mV instead of V"),
    range("inputs.sensor.divider", "", [0.0, 1e3], [1e-3, 10.0], [0.1, 1.0], USER_SETTING_SOURCE),
    range("inputs.*.max_c_per_min", "K/min", [0.0, 1e4], [0.1, 600.0], [1.0, 60.0], USER_SETTING_SOURCE),
    range("inputs.*", "", [-UNBOUNDED, UNBOUNDED], [-1e10, 1e10], [-1e5, 1e5], USER_SETTING_SOURCE),
    // whole units
    range("*feed_mm_per_min", "mm/min", [0.0, 1e7], [0.1, 3e5], [10.0, 1e5], "data sheets of machine tools"),
    range("*feeds_mm_per_min", "mm/min", [0.0, 1e7], [0.1, 3e5], [10.0, 1e5], "data sheets of machine tools"),
    range("*um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [-100.0, 100.0], [-25.0, 25.0], EXPANSION_SOURCE).with_hint_above(EXPANSION_UNIT_HINT),
    range("*um_per_m", "µm/m", [-1e5, 1e5], [-2000.0, 2000.0], [-100.0, 100.0], ANGLE_SOURCE).with_hint_above("probably in nm for one metre"),
    range("*urad_per_m", "µrad/m", [-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLE_SOURCE),
    range("*_urad", "µrad", [-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLE_SOURCE),
    range("*um_per_krpm2", "µm", [-100.0, 100.0], [-5.0, 5.0], [-0.2, 0.2], "20 to 60 µm at 24 000 r/min")
        .with_hint_above("probably for r/min instead of 1000 r/min"),
    range("*um_per_krpm", "µm", [-1e3, 1e3], [-50.0, 50.0], [-5.0, 5.0], "20 to 60 µm at 24 000 r/min")
        .with_hint_above("probably for r/min instead of 1000 r/min"),
    range("*um_per_h", "µm/h", [-1e6, 1e6], [-1000.0, 1000.0], [-20.0, 20.0], ERROR_RANGE_SOURCE),
    range("*um_per_run", "µm", [-1e5, 1e5], [-2000.0, 2000.0], [-20.0, 20.0], ERROR_RANGE_SOURCE),
    range("*period_mm", "mm", [0.0, 1e6], [1e-3, 1e5], [0.02, 100.0], LENGTH_SOURCE).with_hint_below(MICROMETRES_HINT),
    range("*step_mm", "mm", [0.0, 1e6], [1e-3, 1e4], [1.0, 500.0], LENGTH_SOURCE).with_hint_above(MICROMETRES_HINT),
    range("*_mm", "mm", [-1e6, 1e6], [-1e5, 1e5], [-2e4, 2e4], LENGTH_SOURCE).with_hint_below(MICROMETRES_HINT).with_hint_above(MICROMETRES_HINT),
    range("*_um", "µm", [-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERROR_RANGE_SOURCE).with_hint_below(NANOMETRES_HINT).with_hint_above(NANOMETRES_HINT),
    range("*_c", "°C", [-200.0, 850.0], [-40.0, 150.0], [15.0, 40.0], TEMPERATURE_SOURCE)
        .with_hint_below(GAUGE_ZERO_HINT).with_hint_above(KELVIN_HINT),
    range("*_deg", "°", [-1e6, 1e6], [-1e5, 1e5], [-360.0, 360.0], LAW_FORM_SOURCE),
    range("*order", "", [2.0, 4.0], [2.0, 4.0], [2.0, 4.0], LAW_FORM_SOURCE),
    range("*.table", "", [-1e6, 1e6], [-1e5, 1e5], [-1e3, 1e3], ERROR_RANGE_SOURCE),
];
