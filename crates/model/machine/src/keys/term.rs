//! The keys of `[[term]]`: those that every term has, and those of the causes. Each is declared here alone, with the range
//! of its numbers; a page says whether it needs it.

use super::{
    key::{
        Key,
        ValueType::{self, Choice, NotNegative, Number, Numbers, Positive, Text, Whole},
        key,
    },
    plausible_range::*,
};

const LINEAR_AXIS_NAMES: &[&str] = &["x", "y", "z"];

/// Declares keys, each as a constant, and the list of all.
macro_rules! keys {
    (
        $(#[$attribute:meta])*
        $ALL:ident {
            $($KEY:ident = $name:ident($form:expr, $unit:literal, $meaning:literal)
                $(.$property:ident($($argument:expr),*))*;)*
        }
    ) => {
        $(pub(crate) const $KEY: Key = key(stringify!($name), $form, $unit, $meaning)
            $(.$property($($argument),*))*;)*

        $(#[$attribute])*
        pub const $ALL: &[Key] = &[$($KEY),*];
    };
}

keys! {
    /// Keys that every term has.
    TERM {
        CAUSE = cause(Text, "", "its name in the table of causes").required().with_example_value("\"pitch-scale\"");
        QUANTITY = quantity(Choice(&["elongation", "dx", "dy", "dz"]), "", "what it changes").required().with_example_value("\"dx\"");
        CONSTANT_UM = constant_um(Number, "µm", "added as well: the reference of a measurement is arbitrary").with_default("0.0").with_range(range([-1e6, 1e6], [-5000.0, 5000.0], [-500.0, 500.0], "the zero of a gauge is arbitrary"));
        WHERE_COLUMN = where_column(Text, "", "it acts only where this column is in a range").with_example_value("\"spindle_rpm\"");
        WHERE_ABOVE = where_above(Number, "", "above this value of `where_column`").with_example_value("10500.0").with_range(USER_UNIT_RANGE);
        WHERE_BELOW = where_below(Number, "", "or below this one").with_example_value("10500.0").with_range(USER_UNIT_RANGE);
    }
}

keys! {
    /// Keys of the causes, each with one form wherever it stands.
    TERM_KEYS {
        ALONG = along(Choice(LINEAR_AXIS_NAMES), "", "the axis whose position counts").with_example_value("\"x\"");
        AMPLITUDE_UM = amplitude_um(ValueType::NumberOrNumbers, "µm", "how large it is, or one of each for several waves").with_example_value("1.5");
        AT = at(Numbers, "", "values of the column, rising").with_example_value("[2.0, 20.0, 40.0]").with_range(USER_UNIT_RANGE);
        AT_FEED_MM_PER_MIN = at_feed_mm_per_min(Number, "mm/min", "the feed at which the machine is used").with_example_value("1000.0");
        AT_S = at_s(Number, "s", "when, in the run's `time_s`").with_example_value("1200.0").with_range(CLOCK_TIME_RANGE);
        AXIS = axis(Choice(LINEAR_AXIS_NAMES), "", "the other axis").with_example_value("\"y\"");
        COLUMN = column(Text, "", "the run's column that it follows").with_example_value("\"temp_bed_c\"");
        CONTROL_UM = control_um(Numbers, "µm", "control points of a curve").with_example_value("[0.0, 3.0]");
        CONTROL_URAD = control_urad(Numbers, "µrad", "control points of a curve of angles").with_example_value("[0.0, 3.0]");
        CURVE_UM = curve_um(Numbers, "µm", "what is added at each of `at`, the first 0").with_example_value("[0.0, 4.0, 5.0]").with_range(USER_UNIT_RANGE);
        DESCRIPTION = description(Text, "", "in words").with_example_value("\"sweeps\"");
        FACTOR_PER_UNIT = factor_per_unit(Number, "", "times the growth, for one unit of the column").with_example_value("0.01").with_range(USER_UNIT_RANGE);
        FEEDS_MM_PER_MIN = feeds_mm_per_min(Numbers, "mm/min", "feeds, rising").with_example_value("[100.0, 1000.0]");
        FORM = form(Choice(&["lag", "delay", "level", "line", "hinge", "curve"]), "", "in which way a thermometer is late, or an error depends on a column").with_example_value("\"lag\"");
        FORWARD_UM = forward_um(Numbers, "µm", "errors at points of equal distance").with_example_value("[0.0, 1.5]");
        FRACTION = fraction(NotNegative, "", "share of the rows").with_example_value("0.01").with_range(range([0.0, 1.0], [0.0, 0.5], [0.0, 0.05], LAW_FORM_SOURCE));
        FROM = from(Number, "", "the value of the column above which it acts").with_example_value("35.0").with_range(USER_UNIT_RANGE);
        GAIN = gain(Number, "", "the sensor's law times this").with_example_value("1.2").with_range(range([-1e3, 1e3], [0.1, 10.0], [0.5, 2.0], "the paper's sensor has 1.2 to 1.3").with_hint_below(SENSOR_SIGN_HINT));
        HARMONIC = harmonic(ValueType::NumberOrNumbers, "", "whole numbers from 1 to 1000").with_example_value("1").with_range(range([1.0, 1e3], [1.0, 1e3], [1.0, 10.0], LAW_FORM_SOURCE));
        INPUT = input(Choice(&["speed", "speed2"]), "", "the heating speed").with_example_value("\"speed2\"");
        KNOTS_MM = knots_mm(Numbers, "mm", "knots of a curve").with_example_value("[0.0, 0.0, 100.0, 100.0]");
        LAG_S = lag_s(NotNegative, "s", "time constant by which a line, or `levels` 0 and 1, act").with_example_value("600.0").with_range(range([0.0, 1e9], [0.0, 2e6], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT));
        LEVEL_DEFAULT = level_default(Number, "", "what is added where the column is none of `levels`, in the unit of theirs; without it 0").with_example_value("0.0").with_range(USER_UNIT_RANGE);
        LEVEL_FACTOR = level_factor(Numbers, "", "times the growth, at each of `levels`").with_example_value("[0.0, 0.1]").with_range(USER_UNIT_RANGE);
        LEVEL_UM = level_um(Numbers, "µm", "what is added at each of `levels`").with_example_value("[0.0, 5.0]").with_range(range([-1e5, 1e5], [-4000.0, 4000.0], [-200.0, 200.0], ERROR_RANGE_SOURCE).with_hint_below(NANOMETRES_HINT).with_hint_above(NANOMETRES_HINT));
        LEVEL_UM_PER_KRPM2 = level_um_per_krpm2(Numbers, "µm", "at each of `levels`, for (1000 r/min)²").with_example_value("[0.0, 0.01]").with_range(USER_UNIT_RANGE);
        LEVEL_UM_PER_M = level_um_per_m(Numbers, "µm/m", "at each of `levels`, for one metre").with_example_value("[0.0, 3.0]").with_range(USER_UNIT_RANGE);
        LEVEL_UM_PER_UNIT = level_um_per_unit(Numbers, "µm", "at each of `levels`, for one unit of the second column").with_example_value("[0.0, 0.2]").with_range(USER_UNIT_RANGE);
        LEVELS = levels(Numbers, "", "values of the column, the first adds nothing").with_example_value("[0.0, 1.0]").with_range(USER_UNIT_RANGE);
        LEVER = lever(Choice(LINEAR_AXIS_NAMES), "", "the axis along which the lever is").with_example_value("\"z\"");
        LIMIT_UM = limit_um(Number, "µm", "where the sensor's range ends").with_example_value("90.0");
        MINUS = minus(Text, "", "the temperature that is taken away from that of `column`").with_example_value("\"temp_right_c\"");
        OFFSET_UM = offset_um(Number, "µm", "what is added").with_example_value("1.0").with_range(range([-2e4, 2e4], [-1000.0, 1000.0], [-200.0, 200.0], GROWTH_SOURCE).with_hint_above(NANOMETRES_HINT));
        ORDER = order(Whole(2, 4), "", "degree of a curve plus one").with_example_value("2").with_range(SPLINE_ORDER_RANGE);
        ORIGIN_MM = origin_mm(Number, "mm", "where it is 0").with_example_value("0.0");
        PER_UM = per_um(Number, "1/µm", "c of p + c·p²").with_example_value("0.001").with_range(range([-10.0, 10.0], [-0.1, 0.1], [-0.01, 0.01], LAW_FORM_SOURCE));
        PERIOD_MM = period_mm(Positive, "mm", "the length of a wave").with_example_value("10.0").with_range(range([0.0, 1e6], [1e-3, 1e5], [0.02, 100.0], LENGTH_SOURCE).with_hint_below(MICROMETRES_HINT));
        PERIOD_S = period_s(Positive, "s", "the period of the error in time").with_example_value("900.0").with_range(unbounded("an error that is periodic in time has any period"));
        PHASE_DEG = phase_deg(ValueType::NumberOrNumbers, "°", "of a wave at 0 mm, or at start_s").with_example_value("0.0");
        REFERENCE = reference(Number, "", "the value of the column at which it is 0").with_example_value("20.0").with_range(USER_UNIT_RANGE);
        REFERENCE_C = reference_c(Number, "°C", "where it is 0").with_example_value("20.0");
        REFERENCE_RUN = reference_run(Number, "", "the run at which it is 0").with_example_value("1.0").with_range(unbounded("runs are numbered from anywhere"));
        REVERSE_UM = reverse_um(Numbers, "µm", "errors approached in the negative direction").with_example_value("[0.5, 2.0]");
        SCALE = scale(Number, "", "the growth times this").with_example_value("1.1").with_range(range([-1e3, 1e3], [0.0, 10.0], [0.3, 3.0], GROWTH_SOURCE).with_hint_below(SPINDLE_SIGN_HINT));
        SHIFT_C = shift_c(Number, "K", "what the reference temperature is higher by").with_example_value("0.5").with_range(range([-300.0, 300.0], [-40.0, 40.0], [-10.0, 10.0], TEMPERATURE_SOURCE).with_hint_above(TEMPERATURE_UNIT_HINT));
        SHIFT_S = shift_s(Number, "s", "by how much the measurement comes later").with_example_value("2.0").with_range(range([-1e7, 1e7], [-7200.0, 7200.0], [-60.0, 60.0], "two clocks of one workshop").with_hint_below(MILLISECONDS_HINT).with_hint_above(MILLISECONDS_HINT));
        SIZE_UM = size_um(Number, "µm", "how far it went").with_example_value("5.0");
        SLOPE_OVER = slope_over(NotNegative, "", "over which share of the time constant the slope is taken, up to 1").with_example_value("0.2").with_range(range([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], LAW_FORM_SOURCE));
        START_MM = start_mm(Number, "mm", "the first point").with_example_value("0.0");
        START_S = start_s(Number, "s", "when it begins, in the run's `time_s`").with_example_value("0.0").with_range(CLOCK_TIME_RANGE);
        STEP_MM = step_mm(Positive, "mm", "from point to point").with_example_value("100.0").with_range(range([0.0, 1e6], [1e-3, 1e4], [1.0, 500.0], LENGTH_SOURCE).with_hint_above(MICROMETRES_HINT));
        TIME_CONSTANT_S = time_constant_s(NotNegative, "s", "of the first-order lag").with_example_value("600.0").with_range(range([0.0, 1e9], [0.0, 2e6], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT));
        TIMES = times(Text, "", "what it is multiplied by: `speed2`, `growth`, `position`, or the name of a column").with_example_value("\"speed2\"");
        TIMES_REFERENCE = times_reference(Number, "", "the value of the second column at which it is 0").with_example_value("20.0").with_range(USER_UNIT_RANGE);
        UM_PER_C = um_per_c(Number, "µm/K", "for one kelvin").with_example_value("1.0").with_range(range([-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], EXPANSION_SOURCE).with_hint_above(NANOMETRES_HINT));
        UM_PER_H = um_per_h(Number, "µm/h", "for one hour").with_example_value("0.5");
        UM_PER_KRPM = um_per_krpm(Number, "µm", "for 1000 r/min").with_example_value("0.5").with_range(range([-1e3, 1e3], [-50.0, 50.0], [-5.0, 5.0], "20 to 60 µm at 24 000 r/min").with_hint_above("probably for r/min instead of 1000 r/min"));
        UM_PER_KRPM2 = um_per_krpm2(Number, "µm", "for (1000 r/min)²").with_example_value("0.01").with_range(SPEED_GROWTH_RANGE);
        UM_PER_M = um_per_m(Number, "µm/m", "for one metre").with_example_value("3.0");
        UM_PER_M_PER_C = um_per_m_per_c(Number, "µm/(m·K)", "for one metre and kelvin").with_example_value("11.5").with_range(range([-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], EXPANSION_SOURCE).with_hint_below(AXIS_SIGN_HINT).with_hint_above(EXPANSION_UNIT_HINT));
        UM_PER_N = um_per_n(Number, "µm/N", "for one newton").with_example_value("0.01").with_range(range([-100.0, 100.0], [-1.0, 1.0], [-0.1, 0.1], "a stiffness of 10 to 200 N/µm").with_hint_above("probably in µm for one kN"));
        UM_PER_RUN = um_per_run(Number, "µm", "from run to run").with_example_value("0.5").with_range(range([-1e5, 1e5], [-2000.0, 2000.0], [-20.0, 20.0], ERROR_RANGE_SOURCE));
        UM_PER_UNIT = um_per_unit(Number, "µm", "for one unit of the column").with_example_value("0.2").with_range(USER_UNIT_RANGE);
        UM_PER_UNIT_PER_KRPM2 = um_per_unit_per_krpm2(Number, "µm", "for one unit of the column and (1000 r/min)²").with_example_value("0.001").with_range(USER_UNIT_RANGE);
        UM_PER_UNIT_PER_M = um_per_unit_per_m(Number, "µm/m", "for one unit of the column and metre").with_example_value("0.1").with_range(USER_UNIT_RANGE);
        UM_PER_UNIT_PER_UNIT = um_per_unit_per_unit(Number, "µm", "for one unit of either column").with_example_value("0.01").with_range(USER_UNIT_RANGE);
        URAD_PER_M = urad_per_m(Number, "µrad/m", "angle for one metre").with_example_value("5.0");
        WIDTH_UM = width_um(ValueType::NumberOrNumbers, "µm", "of the backlash; one for each feed where it depends on it").with_example_value("4.0").with_range(range([-5000.0, 5000.0], [-300.0, 300.0], [-30.0, 30.0], BACKLASH_SOURCE).with_hint_above(NANOMETRES_HINT));
    }
}
