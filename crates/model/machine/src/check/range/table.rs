//! The table of physical ranges: one row for a key, or for all keys of a unit.
//!
//! The first row whose pattern matches applies. `*` stands for any text; a term's key is
//! `term.<cause>.<key>`. Rows of single keys come first, those of whole units last: names carry
//! their unit. `hard` is what no machine can have, wide enough that nothing real is refused;
//! outside `likely` a value is doubted; `usual` is what machines have.

/// The range of a key, and what was probably done wrong where a value is outside.
#[derive(Clone, Copy, Debug)]
pub struct Range {
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
) -> Range {
    Range { keys, unit, hard, likely, usual, source, below: UNIT, above: UNIT }
}

impl Range {
    const fn below(self, below: &'static str) -> Self {
        Self { below, ..self }
    }

    const fn above(self, above: &'static str) -> Self {
        Self { above, ..self }
    }
}

const UNIT: &str = "its unit is probably another one";
/// The slip of a backlash that is negative.
pub(super) const REVERSED_OR_DIRECTION: &str = "the sign is that of an error measured the other way round \
                                                (errors are actual minus commanded), or of a direction of \
                                                approach (dir_x, dir_y, dir_z) that is reversed";
const SHRINKS: &str = "the spindle would shrink as it becomes warm: the sign is that of an error measured \
                       the other way round (an elongation is positive where the tool comes out of the spindle)";
const AXIS_SHRINKS: &str = "the axis would shrink as it becomes warm: the sign is that of an error measured \
                            the other way round (errors are actual minus commanded)";
const NANOMETRES: &str = "probably in nm instead of µm";
const MINUTES: &str = "probably in minutes instead of s";
const MILLISECONDS: &str = "probably in ms instead of s";
const KELVIN: &str = "probably in kelvin, °F or tenths instead of °C";
const ZERO_OF_GAUGE: &str =
    "a gauge that was not set to zero puts it there, or fault values of a thermometer";
const MICROMETRES: &str = "probably in µm instead of mm";
const EXPANSION: &str =
    "more than any metal expands by: its unit is probably not µm for one metre and one kelvin";
const SHRINKING_SENSOR: &str = "the growth would be turned round: the sign is that of an error measured the \
                                other way round, or of the sensor";

const MATERIALS: &str = "Invar 1, cast iron 10, steel 11.5, aluminium 23.8, plastics up to 100; a \
                         thermometer that sees a part of the heat makes it a few times as much";
const GROWTH: &str = "0.1 to 0.5 m of steel or ceramic, 11.5 µm/(m·K), seen by one thermometer";
const BODY: &str = "a body of thickness L settles in L²/(π²·a): 1 m of cast iron 2 h, a foundation of 2 m \
                    of concrete 5·10⁵ s";
const LASH: &str =
    "ISO 230-2 reports of screws; a negative one is that of a CNC that compensates too much";
const ERRORS: &str = "ISO 230-2 reports of machines up to 15 m; the board takes at most 4000 µm";
const LENGTHS: &str = "the longest machine tools travel 100 m";
const ROOMS: &str =
    "EN 60204-1: a machine works at 5 to 40 °C, and what runs in it is warmer by 30 K";
const ANGLES: &str = "ISO 230-1 reports; 2000 µm/m is 0.11°";
const SET: &str = "set by the user, and bounded by the board";
const FORM: &str = "the law's own form";
const ANY: f64 = 1e15;

/// The ranges, in the order in which they are looked up.
#[rustfmt::skip]
pub(crate) const RANGES: &[Range] = &[
    // the spindle
    range("spindle.temperature.k_um_per_c", "µm/K", [-200.0, 200.0], [0.0, 30.0], [0.1, 15.0], GROWTH)
        .below(SHRINKS).above(NANOMETRES),
    range("spindle.temperature.lag_s", "s", [0.0, 5e5], [0.0, 1e5], [0.0, 2e4], BODY).above(MILLISECONDS),
    range("spindle.warmup.lag_s", "s", [0.0, 1e5], [0.0, 7200.0], [0.0, 600.0], BODY).above(MILLISECONDS),
    range("spindle.warmup.warm_s", "s", [0.0, 5e5], [120.0, 1e5], [1200.0, 2e4], BODY)
        .below(MINUTES).above(MILLISECONDS),
    range("spindle.warmup.max_um", "µm", [-2000.0, 2000.0], [0.0, 500.0], [5.0, 200.0], GROWTH)
        .below(SHRINKS).above(NANOMETRES),
    range("spindle.warmup.exponent", "", [0.0, 1e3], [0.01, 50.0], [0.5, 8.0], FORM),
    range("spindle.warmup.cool_s", "s", [0.0, 5e5], [10.0, 1e5], [300.0, 2e4], BODY)
        .below(MINUTES).above(MILLISECONDS),
    range("spindle.warmup.rated_rpm", "r/min", [0.0, 1e6], [100.0, 2e5], [3000.0, 6e4], "data sheets of spindles")
        .below("probably in 1000 r/min or r/s instead of r/min"),
    range("spindle.warmup.speed_exponent", "", [0.0, 20.0], [0.0, 4.0], [0.0, 2.0], FORM),
    range("spindle.sensor.k0_um", "µm", [-1e5, 1e5], [-5000.0, 5000.0], [-500.0, 500.0], "the range of a displacement sensor"),
    range("spindle.sensor.*", "", [-1e10, 1e10], [-1e9, 1e9], [-1e5, 1e5], "`check` holds it against [inputs] sensor"),
    range("spindle.tools.*.number", "", [0.0, 65535.0], [0.0, 65535.0], [1.0, 100.0], SET),
    // the axes
    range("axis.*.thermal.slope_um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], MATERIALS)
        .below(AXIS_SHRINKS).above(EXPANSION),
    range("axis.*.thermal.constant_um_per_c", "µm/K", [-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], MATERIALS)
        .above(NANOMETRES),
    range("axis.*.thermal.lag_s", "s", [0.0, 5e5], [0.0, 2e5], [0.0, 4e4], BODY).above(MILLISECONDS),
    range("axis.*.backlash.width_um", "µm", [-5000.0, 5000.0], [-0.5, 300.0], [0.0, 30.0], LASH)
        .below(REVERSED_OR_DIRECTION).above(NANOMETRES),
    range("axis.*.backlash.ramp_mm", "mm", [0.0, 1e4], [0.0, 50.0], [0.0, 1.0], LASH).above(MICROMETRES),
    range("axis.*.backlash.hysteresis_um", "µm", [0.0, 1e4], [0.0, 300.0], [0.0, 10.0], LASH).above(NANOMETRES),
    range("axis.*.rapid_mm_per_min", "mm/min", [0.0, 1e7], [100.0, 3e5], [5000.0, 1e5], "data sheets of machine tools")
        .below("probably in m/min instead of mm/min"),
    // causes: each after its page
    range("term.expansion-slope.um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], MATERIALS)
        .below(AXIS_SHRINKS).above(EXPANSION),
    range("term.axis-expansion.um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], MATERIALS)
        .below(AXIS_SHRINKS).above(EXPANSION),
    range("term.*.scale", "", [-1e3, 1e3], [0.0, 10.0], [0.3, 3.0], GROWTH).below(SHRINKS),
    range("term.*.gain", "", [-1e3, 1e3], [0.1, 10.0], [0.5, 2.0], "the paper's sensor has 1.2 to 1.3")
        .below(SHRINKING_SENSOR),
    range("term.*.per_um", "1/µm", [-10.0, 10.0], [-0.1, 0.1], [-0.01, 0.01], FORM),
    range("term.sensor-offset.offset_um", "µm", [-2e4, 2e4], [-1000.0, 1000.0], [-200.0, 200.0], GROWTH).above(NANOMETRES),
    range("term.slow-mode.amplitude_um", "µm", [-2e4, 2e4], [-500.0, 500.0], [-100.0, 100.0], GROWTH).above(NANOMETRES),
    range("term.*.fraction", "", [0.0, 1.0], [0.0, 0.5], [0.0, 0.05], FORM),
    range("term.*.slope_over", "", [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], FORM),
    range("term.*.shift_c", "K", [-300.0, 300.0], [-40.0, 40.0], [-10.0, 10.0], ROOMS).above(KELVIN),
    range("term.*.shift_s", "s", [-1e7, 1e7], [-7200.0, 7200.0], [-60.0, 60.0], "two clocks of one workshop")
        .below(MILLISECONDS).above(MILLISECONDS),
    range("term.*.width_um", "µm", [-5000.0, 5000.0], [-300.0, 300.0], [-30.0, 30.0], LASH).above(NANOMETRES),
    range("term.*.um_per_c", "µm/K", [-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], MATERIALS).above(NANOMETRES),
    range("term.*.um_per_n", "µm/N", [-100.0, 100.0], [-1.0, 1.0], [-0.1, 0.1], "a stiffness of 10 to 200 N/µm")
        .above("probably in µm for one kN"),
    range("term.dependence.level_um", "µm", [-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERRORS).below(NANOMETRES).above(NANOMETRES),
    range("term.dependence.lag_s", "s", [0.0, 1e9], [0.0, 2e6], [0.0, 4e4], BODY).above(MILLISECONDS),
    range("term.*.where_above", "", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "the unit of the column is the user's"),
    range("term.*.where_below", "", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "the unit of the column is the user's"),
    range("term.dependence.*", "", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "the unit of the column is the user's"),
    // A diagnosis of weeks finds what takes months.
    range("term.*.time_constant_s", "s", [0.0, 1e9], [0.0, 2e6], [0.0, 4e4], BODY).above(MILLISECONDS),
    range("term.*.harmonic", "", [1.0, 1e3], [1.0, 1e3], [1.0, 10.0], FORM),
    range("term.*.constant_um", "µm", [-1e6, 1e6], [-5000.0, 5000.0], [-500.0, 500.0], "the zero of a gauge is arbitrary"),
    range("term.*.at_s", "s", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "a clock counts from anywhere"),
    range("term.*.start_s", "s", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "a clock counts from anywhere"),
    range("term.*.reference_run", "", [-ANY, ANY], [-ANY, ANY], [-ANY, ANY], "runs are numbered from anywhere"),
    // what the user sets
    range("machine.*", "", [-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], "a direction, at length 1"),
    range("limits.*", "", [0.0, ANY], [0.0, ANY], [0.0, ANY], SET),
    range("thermal_state.*", "K", [0.0, 100.0], [0.0, 5.0], [0.2, 1.0], SET),
    range("instrument.*", "µm", [0.0, 1e5], [0.001, 100.0], [0.1, 5.0], "data sheets of gauges, interferometers and probes")
        .below("probably in mm instead of µm").above(NANOMETRES),
    range("inputs.sensor.volts_full_scale", "V", [0.0, 1e4], [0.1, 100.0], [1.0, 10.0], "data sheets of sensors")
        .above("probably in mV instead of V"),
    range("inputs.sensor.divider", "", [0.0, 1e3], [1e-3, 10.0], [0.1, 1.0], SET),
    range("inputs.*.max_c_per_min", "K/min", [0.0, 1e4], [0.1, 600.0], [1.0, 60.0], SET),
    range("inputs.*", "", [-ANY, ANY], [-1e10, 1e10], [-1e5, 1e5], SET),
    // whole units
    range("*feed_mm_per_min", "mm/min", [0.0, 1e7], [0.1, 3e5], [10.0, 1e5], "data sheets of machine tools"),
    range("*feeds_mm_per_min", "mm/min", [0.0, 1e7], [0.1, 3e5], [10.0, 1e5], "data sheets of machine tools"),
    range("*um_per_m_per_c", "µm/(m·K)", [-500.0, 500.0], [-100.0, 100.0], [-25.0, 25.0], MATERIALS).above(EXPANSION),
    range("*um_per_m", "µm/m", [-1e5, 1e5], [-2000.0, 2000.0], [-100.0, 100.0], ANGLES).above("probably in nm for one metre"),
    range("*urad_per_m", "µrad/m", [-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLES),
    range("*_urad", "µrad", [-1e6, 1e6], [-5000.0, 5000.0], [-200.0, 200.0], ANGLES),
    range("*um_per_krpm2", "µm", [-100.0, 100.0], [-5.0, 5.0], [-0.2, 0.2], "20 to 60 µm at 24 000 r/min")
        .above("probably for r/min instead of 1000 r/min"),
    range("*um_per_krpm", "µm", [-1e3, 1e3], [-50.0, 50.0], [-5.0, 5.0], "20 to 60 µm at 24 000 r/min")
        .above("probably for r/min instead of 1000 r/min"),
    range("*um_per_h", "µm/h", [-1e6, 1e6], [-1000.0, 1000.0], [-20.0, 20.0], ERRORS),
    range("*um_per_run", "µm", [-1e5, 1e5], [-2000.0, 2000.0], [-20.0, 20.0], ERRORS),
    range("*period_mm", "mm", [0.0, 1e6], [1e-3, 1e5], [0.02, 100.0], LENGTHS).below(MICROMETRES),
    range("*step_mm", "mm", [0.0, 1e6], [1e-3, 1e4], [1.0, 500.0], LENGTHS).above(MICROMETRES),
    range("*_mm", "mm", [-1e6, 1e6], [-1e5, 1e5], [-2e4, 2e4], LENGTHS).below(MICROMETRES).above(MICROMETRES),
    range("*_um", "µm", [-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERRORS).below(NANOMETRES).above(NANOMETRES),
    range("*_c", "°C", [-200.0, 850.0], [-40.0, 150.0], [15.0, 40.0], ROOMS)
        .below(ZERO_OF_GAUGE).above(KELVIN),
    range("*_deg", "°", [-1e6, 1e6], [-1e5, 1e5], [-360.0, 360.0], FORM),
    range("*order", "", [2.0, 4.0], [2.0, 4.0], [2.0, 4.0], FORM),
    range("*.table", "", [-1e6, 1e6], [-1e5, 1e5], [-1e3, 1e3], ERRORS),
];
