//! The keys of `[[term]]`: those that every term has, and those of the causes. Each is declared here alone; a page says
//! whether it needs it.

use crate::keys::key::{
    Key,
    ValueType::{self, Choice, NotNegative, Number, Numbers, Positive, Text, Whole},
    key,
};

const AXIS_NAMES: &[&str] = &["x", "y", "z"];

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
        CONSTANT_UM = constant_um(Number, "µm", "added as well: the reference of a measurement is arbitrary").with_default("0.0");
        WHERE_COLUMN = where_column(Text, "", "it acts only where this column is in a range").with_example_value("\"spindle_rpm\"");
        WHERE_ABOVE = where_above(Number, "", "above this value of `where_column`").with_example_value("10500.0");
        WHERE_BELOW = where_below(Number, "", "or below this one").with_example_value("10500.0");
    }
}

keys! {
    /// Keys of the causes, each with one form wherever it stands.
    TERM_KEYS {
        ALONG = along(Choice(AXIS_NAMES), "", "the axis whose position counts").with_example_value("\"x\"");
        AMPLITUDE_UM = amplitude_um(ValueType::NumberOrNumbers, "µm", "how large it is, or one of each for several waves").with_example_value("1.5");
        AT = at(Numbers, "", "values of the column, rising").with_example_value("[2.0, 20.0, 40.0]");
        AT_FEED_MM_PER_MIN = at_feed_mm_per_min(Number, "mm/min", "the feed at which the machine is used").with_example_value("1000.0");
        AT_S = at_s(Number, "s", "when, in the run's `time_s`").with_example_value("1200.0");
        AXIS = axis(Choice(AXIS_NAMES), "", "the other axis").with_example_value("\"y\"");
        COLUMN = column(Text, "", "the run's column that it follows").with_example_value("\"temp_bed_c\"");
        CONTROL_UM = control_um(Numbers, "µm", "control points of a curve").with_example_value("[0.0, 3.0]");
        CONTROL_URAD = control_urad(Numbers, "µrad", "control points of a curve of angles").with_example_value("[0.0, 3.0]");
        CURVE_UM = curve_um(Numbers, "µm", "what is added at each of `at`, the first 0").with_example_value("[0.0, 4.0, 5.0]");
        DESCRIPTION = description(Text, "", "in words").with_example_value("\"sweeps\"");
        FACTOR_PER_UNIT = factor_per_unit(Number, "", "times the growth, for one unit of the column").with_example_value("0.01");
        FEEDS_MM_PER_MIN = feeds_mm_per_min(Numbers, "mm/min", "feeds, rising").with_example_value("[100.0, 1000.0]");
        FORM = form(Choice(&["lag", "delay", "level", "line", "hinge", "curve"]), "", "in which way a thermometer is late, or an error depends on a column").with_example_value("\"lag\"");
        FORWARD_UM = forward_um(Numbers, "µm", "errors at points of equal distance").with_example_value("[0.0, 1.5]");
        FRACTION = fraction(NotNegative, "", "share of the rows").with_example_value("0.01");
        FROM = from(Number, "", "the value of the column above which it acts").with_example_value("35.0");
        GAIN = gain(Number, "", "the sensor's law times this").with_example_value("1.2");
        HARMONIC = harmonic(ValueType::NumberOrNumbers, "", "whole numbers from 1 to 1000").with_example_value("1");
        INPUT = input(Choice(&["speed", "speed2"]), "", "the heating speed").with_example_value("\"speed2\"");
        KNOTS_MM = knots_mm(Numbers, "mm", "knots of a curve").with_example_value("[0.0, 0.0, 100.0, 100.0]");
        LAG_S = lag_s(NotNegative, "s", "time constant by which a line, or `levels` 0 and 1, act").with_example_value("600.0");
        LEVEL_DEFAULT = level_default(Number, "", "what is added where the column is none of `levels`, in the unit of theirs; without it 0").with_example_value("0.0");
        LEVEL_FACTOR = level_factor(Numbers, "", "times the growth, at each of `levels`").with_example_value("[0.0, 0.1]");
        LEVEL_UM = level_um(Numbers, "µm", "what is added at each of `levels`").with_example_value("[0.0, 5.0]");
        LEVEL_UM_PER_KRPM2 = level_um_per_krpm2(Numbers, "µm", "at each of `levels`, for (1000 r/min)²").with_example_value("[0.0, 0.01]");
        LEVEL_UM_PER_M = level_um_per_m(Numbers, "µm/m", "at each of `levels`, for one metre").with_example_value("[0.0, 3.0]");
        LEVEL_UM_PER_UNIT = level_um_per_unit(Numbers, "µm", "at each of `levels`, for one unit of the second column").with_example_value("[0.0, 0.2]");
        LEVELS = levels(Numbers, "", "values of the column, the first adds nothing").with_example_value("[0.0, 1.0]");
        LEVER = lever(Choice(AXIS_NAMES), "", "the axis along which the lever is").with_example_value("\"z\"");
        LIMIT_UM = limit_um(Number, "µm", "where the sensor's range ends").with_example_value("90.0");
        MINUS = minus(Text, "", "the temperature that is taken away from that of `column`").with_example_value("\"temp_right_c\"");
        OFFSET_UM = offset_um(Number, "µm", "what is added").with_example_value("1.0");
        ORDER = order(Whole(2, 4), "", "degree of a curve plus one").with_example_value("2");
        ORIGIN_MM = origin_mm(Number, "mm", "where it is 0").with_example_value("0.0");
        PER_UM = per_um(Number, "1/µm", "c of p + c·p²").with_example_value("0.001");
        PERIOD_MM = period_mm(Positive, "mm", "the length of a wave").with_example_value("10.0");
        PERIOD_S = period_s(Positive, "s", "the period of what comes and goes with the clock").with_example_value("900.0");
        PHASE_DEG = phase_deg(ValueType::NumberOrNumbers, "°", "of a wave at 0 mm, or at start_s").with_example_value("0.0");
        REFERENCE = reference(Number, "", "the value of the column at which it is 0").with_example_value("20.0");
        REFERENCE_C = reference_c(Number, "°C", "where it is 0").with_example_value("20.0");
        REFERENCE_RUN = reference_run(Number, "", "the run at which it is 0").with_example_value("1.0");
        REVERSE_UM = reverse_um(Numbers, "µm", "errors approached in the negative direction").with_example_value("[0.5, 2.0]");
        SCALE = scale(Number, "", "the growth times this").with_example_value("1.1");
        SHIFT_C = shift_c(Number, "K", "what the reference temperature is higher by").with_example_value("0.5");
        SHIFT_S = shift_s(Number, "s", "by how much the measurement comes later").with_example_value("2.0");
        SIZE_UM = size_um(Number, "µm", "how far it went").with_example_value("5.0");
        SLOPE_OVER = slope_over(NotNegative, "", "over which share of the time constant the slope is taken, up to 1").with_example_value("0.2");
        START_MM = start_mm(Number, "mm", "the first point").with_example_value("0.0");
        START_S = start_s(Number, "s", "when it begins, in the run's `time_s`").with_example_value("0.0");
        STEP_MM = step_mm(Positive, "mm", "from point to point").with_example_value("100.0");
        TIME_CONSTANT_S = time_constant_s(NotNegative, "s", "of the first-order lag").with_example_value("600.0");
        TIMES = times(Text, "", "what it is multiplied by: `speed2`, `growth`, `position`, or the name of a column").with_example_value("\"speed2\"");
        TIMES_REFERENCE = times_reference(Number, "", "the value of the second column at which it is 0").with_example_value("20.0");
        UM_PER_C = um_per_c(Number, "µm/K", "for one kelvin").with_example_value("1.0");
        UM_PER_H = um_per_h(Number, "µm/h", "for one hour").with_example_value("0.5");
        UM_PER_KRPM = um_per_krpm(Number, "µm", "for 1000 r/min").with_example_value("0.5");
        UM_PER_KRPM2 = um_per_krpm2(Number, "µm", "for (1000 r/min)²").with_example_value("0.01");
        UM_PER_M = um_per_m(Number, "µm/m", "for one metre").with_example_value("3.0");
        UM_PER_M_PER_C = um_per_m_per_c(Number, "µm/(m·K)", "for one metre and kelvin").with_example_value("11.5");
        UM_PER_N = um_per_n(Number, "µm/N", "for one newton").with_example_value("0.01");
        UM_PER_RUN = um_per_run(Number, "µm", "from run to run").with_example_value("0.5");
        UM_PER_UNIT = um_per_unit(Number, "µm", "for one unit of the column").with_example_value("0.2");
        UM_PER_UNIT_PER_KRPM2 = um_per_unit_per_krpm2(Number, "µm", "for one unit of the column and (1000 r/min)²").with_example_value("0.001");
        UM_PER_UNIT_PER_M = um_per_unit_per_m(Number, "µm/m", "for one unit of the column and metre").with_example_value("0.1");
        UM_PER_UNIT_PER_UNIT = um_per_unit_per_unit(Number, "µm", "for one unit of either column").with_example_value("0.01");
        URAD_PER_M = urad_per_m(Number, "µrad/m", "angle for one metre").with_example_value("5.0");
        WIDTH_UM = width_um(ValueType::NumberOrNumbers, "µm", "of the backlash; one for each feed where it depends on it").with_example_value("4.0");
    }
}
