//! The keys of `[[term]]`: those that every term has, and those of the causes.

use crate::file::key::{
    Form::{self, Choice, NotNegative, Number, Numbers, Positive, Text, Whole},
    Key, key,
};

const AXES: &[&str] = &["x", "y", "z"];

/// Keys that every term has.
pub const TERM: &[Key] = &[
    key("cause", Text, "", "its name in the table of causes").required().as_in("\"pitch-scale\""),
    key("quantity", Choice(&["elongation", "dx", "dy", "dz"]), "", "what it changes")
        .required()
        .as_in("\"dx\""),
    key("constant_um", Number, "µm", "added as well: the reference of a measurement is arbitrary")
        .or("0.0"),
    key("where_column", Text, "", "it acts only where this column is in a range")
        .as_in("\"spindle_rpm\""),
    key("where_above", Number, "", "above this value of `where_column`").as_in("10500.0"),
    key("where_below", Number, "", "or below this one").as_in("10500.0"),
];

/// Keys of the causes, each with one form wherever it stands.
pub const TERM_KEYS: &[Key] = &[
    key("along", Choice(AXES), "", "the axis whose position counts").as_in("\"x\""),
    key(
        "amplitude_um",
        Form::NumberOrNumbers,
        "µm",
        "how large it is, or one of each for several waves",
    )
    .as_in("1.5"),
    key("at", Numbers, "", "values of the column, rising").as_in("[2.0, 20.0, 40.0]"),
    key("at_feed_mm_per_min", Number, "mm/min", "the feed at which the machine is used")
        .as_in("1000.0"),
    key("at_s", Number, "s", "when, in the run's `time_s`").as_in("1200.0"),
    key("axis", Choice(AXES), "", "the other axis").as_in("\"y\""),
    key("column", Text, "", "the run's column that it follows").as_in("\"temp_bed_c\""),
    key("control_um", Numbers, "µm", "control points of a curve").as_in("[0.0, 3.0]"),
    key("control_urad", Numbers, "µrad", "control points of a curve of angles").as_in("[0.0, 3.0]"),
    key("curve_um", Numbers, "µm", "what is added at each of `at`, the first 0")
        .as_in("[0.0, 4.0, 5.0]"),
    key("description", Text, "", "in words").as_in("\"sweeps\""),
    key("factor_per_unit", Number, "", "times the growth, for one unit of the column")
        .as_in("0.01"),
    key("feeds_mm_per_min", Numbers, "mm/min", "feeds, rising").as_in("[100.0, 1000.0]"),
    key(
        "form",
        Choice(&["lag", "delay", "level", "line", "hinge", "curve"]),
        "",
        "in which way a thermometer is late, or an error depends on a column",
    )
    .as_in("\"lag\""),
    key("forward_um", Numbers, "µm", "errors at points of equal distance").as_in("[0.0, 1.5]"),
    key("fraction", NotNegative, "", "share of the rows").as_in("0.01"),
    key("from", Number, "", "the value of the column above which it acts").as_in("35.0"),
    key("gain", Number, "", "the sensor's law times this").as_in("1.2"),
    key("harmonic", Form::NumberOrNumbers, "", "whole numbers from 1 to 1000").as_in("1"),
    key("input", Choice(&["speed", "speed2"]), "", "the heating speed").as_in("\"speed2\""),
    key("knots_mm", Numbers, "mm", "knots of a curve").as_in("[0.0, 0.0, 100.0, 100.0]"),
    key("lag_s", NotNegative, "s", "time constant by which a line, or `levels` 0 and 1, act")
        .as_in("600.0"),
    key(
        "level_default",
        Number,
        "",
        "what is added where the column is none of `levels`, in the unit of theirs; without it 0",
    )
    .as_in("0.0"),
    key("level_factor", Numbers, "", "times the growth, at each of `levels`").as_in("[0.0, 0.1]"),
    key("level_um", Numbers, "µm", "what is added at each of `levels`").as_in("[0.0, 5.0]"),
    key("level_um_per_krpm2", Numbers, "µm", "at each of `levels`, for (1000 r/min)²")
        .as_in("[0.0, 0.01]"),
    key("level_um_per_m", Numbers, "µm/m", "at each of `levels`, for one metre")
        .as_in("[0.0, 3.0]"),
    key(
        "level_um_per_unit",
        Numbers,
        "µm",
        "at each of `levels`, for one unit of the second column",
    )
    .as_in("[0.0, 0.2]"),
    key("levels", Numbers, "", "values of the column, the first adds nothing").as_in("[0.0, 1.0]"),
    key("lever", Choice(AXES), "", "the axis along which the lever is").as_in("\"z\""),
    key("limit_um", Number, "µm", "where the sensor's range ends").as_in("90.0"),
    key("minus", Text, "", "the temperature that is taken away from that of `column`")
        .as_in("\"temp_right_c\""),
    key("offset_um", Number, "µm", "what is added").as_in("1.0"),
    key("order", Whole(2, 4), "", "degree of a curve plus one").as_in("2"),
    key("origin_mm", Number, "mm", "where it is 0").as_in("0.0"),
    key("per_um", Number, "1/µm", "c of p + c·p²").as_in("0.001"),
    key("period_mm", Positive, "mm", "the length of a wave").as_in("10.0"),
    key("period_s", Positive, "s", "the period of what comes and goes with the clock")
        .as_in("900.0"),
    key("phase_deg", Form::NumberOrNumbers, "°", "of a wave at 0 mm, or at start_s").as_in("0.0"),
    key("reference", Number, "", "the value of the column at which it is 0").as_in("20.0"),
    key("reference_c", Number, "°C", "where it is 0").as_in("20.0"),
    key("reference_run", Number, "", "the run at which it is 0").as_in("1.0"),
    key("reverse_um", Numbers, "µm", "errors approached in the negative direction")
        .as_in("[0.5, 2.0]"),
    key("scale", Number, "", "the growth times this").as_in("1.1"),
    key("shift_c", Number, "K", "what the reference temperature is higher by").as_in("0.5"),
    key("shift_s", Number, "s", "by how much the measurement comes later").as_in("2.0"),
    key("size_um", Number, "µm", "how far it went").as_in("5.0"),
    key(
        "slope_over",
        NotNegative,
        "",
        "over which share of the time constant the slope is taken, up to 1",
    )
    .as_in("0.2"),
    key("start_mm", Number, "mm", "the first point").as_in("0.0"),
    key("start_s", Number, "s", "when it begins, in the run's `time_s`").as_in("0.0"),
    key("step_mm", Positive, "mm", "from point to point").as_in("100.0"),
    key("time_constant_s", NotNegative, "s", "of the first-order lag").as_in("600.0"),
    key(
        "times",
        Text,
        "",
        "what it is multiplied by: `speed2`, `growth`, `position`, or the name of a column",
    )
    .as_in("\"speed2\""),
    key("times_reference", Number, "", "the value of the second column at which it is 0")
        .as_in("20.0"),
    key("um_per_c", Number, "µm/K", "for one kelvin").as_in("1.0"),
    key("um_per_h", Number, "µm/h", "for one hour").as_in("0.5"),
    key("um_per_krpm", Number, "µm", "for 1000 r/min").as_in("0.5"),
    key("um_per_krpm2", Number, "µm", "for (1000 r/min)²").as_in("0.01"),
    key("um_per_m", Number, "µm/m", "for one metre").as_in("3.0"),
    key("um_per_m_per_c", Number, "µm/(m·K)", "for one metre and kelvin").as_in("11.5"),
    key("um_per_n", Number, "µm/N", "for one newton").as_in("0.01"),
    key("um_per_run", Number, "µm", "from run to run").as_in("0.5"),
    key("um_per_unit", Number, "µm", "for one unit of the column").as_in("0.2"),
    key("um_per_unit_per_krpm2", Number, "µm", "for one unit of the column and (1000 r/min)²")
        .as_in("0.001"),
    key("um_per_unit_per_m", Number, "µm/m", "for one unit of the column and metre").as_in("0.1"),
    key("um_per_unit_per_unit", Number, "µm", "for one unit of either column").as_in("0.01"),
    key("urad_per_m", Number, "µrad/m", "angle for one metre").as_in("5.0"),
    key(
        "width_um",
        Form::NumberOrNumbers,
        "µm",
        "of the backlash; one for each feed where it depends on it",
    )
    .as_in("4.0"),
];
