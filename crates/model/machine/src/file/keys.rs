//! Every key of the machine file, once: its form, unit, default, meaning and an example.
//!
//! The reader holds every file against this table (`structure.rs`), so that a key that does
//! not stand here is refused wherever it is used; the JSON schema and the tables of `docs/reference.md` are
//! made of it ([`crate::schema`]).

mod key;
mod term;
mod volume;

use crate::inputs::LAST_CHANNEL;

pub use key::{Form, Key, Need};
use key::{key, section};
pub use term::{TERM, TERM_KEYS};
use volume::{ANGULAR, ROTARY, TOOL_TIP};

use Form::{
    Boolean, Choice, Choices, Column, NotNegative, Number, Numbers, Positive, Rows, Terms, Text,
    Vector, Whole,
};

const AXES: &[&str] = &["x", "y", "z"];

const MACHINE: &[Key] = &[
    key("name", Text, "", "the machine's name; a board asks before it runs the calibration of a machine with another one")
        .required().as_in("\"mill\""),
    key("serial", Text, "", "its serial number, which tells it from another one of that name").as_in("\"4711\""),
    key("board", Text, "", "the board that the calibration is for: the 24 hexadecimal digits of its chip's number, as `trueup bridge info` prints them")
        .as_in("\"003b00213032470e39363634\""),
    key("kind", Choice(&["3-axis", "head-head", "table-table", "head-table", "lathe"]), "", "which rotary axes carry the tool (head) and which the workpiece (table); of a lathe the spindle carries the workpiece, and X is a radius")
        .required().as_in("\"3-axis\""),
    key("head_axes", Choices(&["a", "b", "c"]), "", "the rotary axes that carry the spindle, from the frame to the tool: two for head-head, one for head-table")
        .or("[]"),
    key("tool_direction", Vector, "", "from the spindle nose to the tip with all angles at zero, of a lathe from the turret to the chuck; of any length but 0")
        .or("[0.0, 0.0, -1.0]"),
    key("chain", Text, "", "which axis carries what, in the letters of ISO 10791-6: from the workpiece (w) over the bed (b) to the tool (t), with ' what moves the workpiece; X, Y and Z once each, next to the bed, the rotary axes of `head_axes` before t. Needed by `[angular]` and `[rotary]`")
        .as_in("\"w X' b Y Z t\""),
];

const SENSOR_INPUT: &[Key] = &[
    key("volts_full_scale", Positive, "V", "what the sensor gives at `counts_full_scale`").required().as_in("10.0"),
    key("counts_full_scale", Positive, "counts", "what a run file states at `volts_full_scale`: 27648 for a SIMATIC S7 input, 32768 for the paper's")
        .required().as_in("32768"),
    key("divider", Positive, "", "volts at the board's converter for one volt of the sensor; `volts_full_scale` · `divider` must not be above 3.3 V")
        .required().as_in("0.328"),
];

const THERMOMETER: &[Key] = &[
    key("channel", Whole(0, LAST_CHANNEL as u32), "", "the number of its converter on the board; no two share one")
        .required().as_in("0"),
    key("kind", Choice(&["pt100", "linear"]), "", "a PT100 by IEC 60751, or a line").required().as_in("\"pt100\""),
    key("zero_v", Number, "V", "of a line: the voltage at 0 °C, by the line's own slope also where the transmitter does not reach it; with `c_per_v`, or `zero_counts` and `counts_per_c`").as_in("0.0"),
    key("c_per_v", Number, "K/V", "of a line: kelvin for one volt at the input; not 0").as_in("10.0"),
    key("zero_counts", Number, "counts", "of a line in counts: the counts at 0 °C, in the place of `zero_v`").as_in("4000"),
    key("counts_per_c", Number, "counts/K", "of a line in counts: counts for one kelvin, not 0; in the place of `c_per_v`").as_in("16"),
    key("counts_full_scale", Positive, "counts", "of a line in counts: what the other converter gives at `full_scale_v` (27648 for a SIMATIC S7 input, 32768 for the paper's). Without it a count is a code of the board: 4096 at 3.3 V on the pin").as_in("27648"),
    key("full_scale_v", Positive, "V", "of a line: the largest voltage of the input").or("10.0"),
    key("divider", Positive, "", "of a line: volts at the board's converter for one volt at the input; `full_scale_v` · `divider` must not be above 3.3 V").or("0.328"),
    key("max_c_per_min", Positive, "K/min", "the fastest change that the mass at the thermometer can make, from 0.1 to 600; a faster reading is not believed until it has stayed within it for 60 s. Without it 10 where a law uses the thermometer; coolant, oil and air need more")
        .as_in("60.0"),
];

const CONDITION: &[Key] = &[
    key(
        "kind",
        Choice(&["condition"]),
        "",
        "a condition of the machine that holds (1) or not (0), from the CNC",
    )
    .required()
    .as_in("\"condition\""),
    key("bit", Whole(0, 15), "", "its bit in `Conditions`; no two share one").required().as_in("0"),
    key("default", Whole(0, 1), "", "what counts while the CNC does not send it").or("0"),
];

const INPUTS: &[Key] = &[
    key("service_switch", Boolean, "", "nothing is written to the board (calibration, reference, settings) unless the switch on its pin PB7 is closed to ground; it holds from this calibration's first start on, also against the next one")
        .or("false"),
    key("mains_hz", Whole(50, 60), "Hz", "the mains, 50 or 60, whose hum the PT100 converters and the linear inputs suppress")
        .or("50"),
    section("sensor", SENSOR_INPUT, "how the displacement sensor reaches the board"),
    section(
        "temp_<name>_c",
        THERMOMETER,
        "how the thermometer of that column reaches the board; at most eight",
    ),
    section("<condition>", CONDITION, "a column of a run with 0 and 1, as `coolant_on`, that the CNC sends; known by `kind`"),
];

const SENSOR: &[Key] = &[
    key("k0_um", Number, "µm", "the growth at the zero reading").required().as_in("0.0"),
    key("zero_counts", Number, "counts", "the reading when the machine is cold; or `zero_v`").as_in("5048.0"),
    key("um_per_count", Number, "µm", "growth for one count, not 0; or `um_per_v`").as_in("0.0152587890625"),
    key("zero_v", Number, "V", "the reading when the machine is cold, as a voltmeter shows it, in the place of `zero_counts`; needs `[inputs] sensor`")
        .as_in("1.54"),
    key("um_per_v", Number, "µm/V", "growth for one volt, as the sensor's data sheet says it, in the place of `um_per_count`; needs `[inputs] sensor`")
        .as_in("50.0"),
    key("temperature", Column, "", "the column with the sensor's own temperature").as_in("\"temp_coil_c\""),
];

const WARMUP: &[Key] = &[
    key("lag_s", NotNegative, "s", "from the start of the spindle until growth begins")
        .required()
        .as_in("60.0"),
    key("warm_s", Positive, "s", "from the start until it ends; above `lag_s`")
        .required()
        .as_in("5400.0"),
    key("max_um", Number, "µm", "the growth in the end").required().as_in("80.0"),
    key("exponent", Positive, "", "how fast it rises; larger is faster at first")
        .required()
        .as_in("4.0"),
    key(
        "cool_s",
        Positive,
        "s",
        "time constant while the spindle stands; without it (`warm_s` − `lag_s`)/`exponent`",
    )
    .as_in("1335.0"),
    key("rated_rpm", Positive, "r/min", "the speed at which `max_um` was recorded")
        .as_in("24000.0"),
    key(
        "speed_exponent",
        NotNegative,
        "",
        "growth goes with (n/`rated_rpm`) to this; 0: any speed heats fully",
    )
    .or("0.0"),
];

const TEMPERATURE: &[Key] = &[
    key("sensor", Column, "", "the column of the temperature").required().as_in("\"temp_front_c\""),
    key("reference_c", Number, "°C", "the temperature at which nothing has grown")
        .required()
        .as_in("20.0"),
    key("k_um_per_c", Number, "µm/K", "growth for one kelvin").required().as_in("2.0"),
    key("lag_s", NotNegative, "s", "time constant by which growth follows the temperature")
        .or("0.0"),
];

const TOOL_GROWTH: Key = key("um_per_krpm2", Number, "µm", "growth with speed, for (1000 r/min)²")
    .required()
    .as_in("0.021");

const TOOL: &[Key] = &[
    TOOL_GROWTH,
    key("number", Whole(0, 65_535), "", "of a key that is a label: the number that the CNC sends; `compile` refuses a label without one").as_in("7"),
    key("label", Text, "", "of a key that is a number: what the column `tool` of a run file calls it").as_in("\"drill\""),
];

const TOOLS: &[Key] = &[
    Key {
        need: Need::Required,
        ..section(
            "default",
            &[TOOL_GROWTH],
            "every tool that is not in the list, and while no tool is known",
        )
    },
    section("<tool>", TOOL, "a tool, by the number that the CNC sends or by a label; at most 32"),
];

const SPINDLE: &[Key] = &[
    key("source", Choice(&["sensor", "warmup", "temperature"]), "", "the model of the growth in use; the others that are there are what the board falls back to. Without it nothing grows")
        .as_in("\"sensor\""),
    section("sensor", SENSOR, "growth by a displacement sensor: `k0_um` + (reading − zero) · slope"),
    section("warmup", WARMUP, "growth over the time that the spindle has run"),
    section("temperature", TEMPERATURE, "growth by a temperature: `k_um_per_c` · (T − `reference_c`)"),
    section("tools", TOOLS, "growth with speed by tool, added to the model in use: `um_per_krpm2` · (n/1000)²"),
];

const THERMAL: &[Key] = &[
    key("mode", Choice(&["constant", "position", "both"]), "", "which part there is: the same everywhere, in proportion to the position, both")
        .required().as_in("\"position\""),
    key("sensor", Column, "", "the column of the temperature").required().as_in("\"temp_screw_c\""),
    key("reference_c", Number, "°C", "where the axis is right; needed without a `table`").as_in("20.0"),
    key("constant_um_per_c", Number, "µm/K", "the same at every position").or("0.0"),
    key("slope_um_per_m_per_c", Number, "µm/(m·K)", "in proportion to the distance from `origin_mm`; steel 11.5").or("0.0"),
    key("origin_mm", Number, "mm", "where the proportional part is 0").or("0.0"),
    key("lag_s", NotNegative, "s", "time constant by which the axis follows the temperature; on the board at least 1 s").or("0.0"),
    key("table", Rows, "°C, µm, µm/m", "rows of temperature, constant and slope in the place of the two constants; linear between, temperatures rising")
        .as_in("[[20.0, 0.0, 0.0], [40.0, 21.0, 230.0]]"),
];

pub(crate) const PITCH: &[Key] = &[
    key("start_mm", Number, "mm", "the first point").required().as_in("0.0"),
    key("step_mm", Positive, "mm", "from point to point").required().as_in("100.0"),
    key("forward_um", Numbers, "µm", "errors at the points, actual minus commanded; of an approach in the positive direction where there is `reverse_um`")
        .required().as_in("[0.0, 1.5, 2.0]"),
    key("reverse_um", Numbers, "µm", "the same of an approach in the negative direction, as many; it contains the backlash")
        .as_in("[0.5, 2.0, 2.5]"),
];

const BACKLASH: &[Key] = &[
    key("width_um", Number, "µm", "error after a move in the negative direction")
        .required()
        .as_in("4.0"),
    key("ramp_mm", NotNegative, "mm", "on the board: a ramp over this travel instead of a step")
        .or("0.0"),
    key("hysteresis_um", NotNegative, "µm", "on the board: how far a reversal must go to count")
        .or("0.0"),
];

const DUAL: &[Key] = &[
    key("across", Choice(AXES), "", "the axis along the beam, from drive to drive")
        .required()
        .as_in("\"y\""),
    key("first_mm", Number, "mm", "where on it the first drive is").required().as_in("0.0"),
    key("second_mm", Number, "mm", "where on it the second drive is").required().as_in("3000.0"),
    Key { need: Need::Required, ..section("pitch", PITCH, "the second drive's table") },
];

const AXIS: &[Key] = &[
    key("feedback", Choice(&["screw", "scale"]), "", "where the position is measured; backlash belongs to a screw").or("\"screw\""),
    key("travel_mm", Numbers, "mm", "the two ends of the travel, the lower one first; for `trueup program` and `check`, no correction depends on it")
        .as_in("[0.0, 1000.0]"),
    key("rapid_mm_per_min", Positive, "mm/min", "the rapid traverse: `trueup check` holds the slew limit against 1 % of it, and the board does not believe a position that the axis cannot have reached by it").as_in("15000.0"),
    section("thermal", THERMAL, "how the axis grows with a temperature"),
    section("pitch", PITCH, "position errors at points of equal distance, linear between them; of the first of two drives where there is `dual`"),
    section("backlash", BACKLASH, "what a reversal leaves behind; not together with `reverse_um`"),
    section("dual", DUAL, "a gantry driven at both ends: the second drive"),
];

const AXIS_SECTIONS: &[Key] = &[
    section("x", AXIS, "the X axis"),
    section("y", AXIS, "the Y axis"),
    section("z", AXIS, "the Z axis"),
];

const CURVE: &[Key] = &[
    key("order", Whole(2, 4), "", "degree plus one; 4 is cubic").required().as_in("4"),
    key("knots_mm", Numbers, "mm", "as many as control points and `order` together, not falling; the first and the last stand there `order` times")
        .required().as_in("[0.0, 0.0, 0.0, 0.0, 500.0, 1000.0, 1000.0, 1000.0, 1000.0]"),
    key("control_um", Numbers, "µm", "the control points").required().as_in("[0.0, 3.0, -2.0, 4.0, 0.0]"),
];

const STRAIGHTNESS: &[Key] = &[
    section("y_of_x", CURVE, "the B-spline of Y's deviation while X moves"),
    section("z_of_x", CURVE, "of Z while X moves"),
    section("z_of_y", CURVE, "of Z while Y moves"),
    section("x_of_y", CURVE, "of X while Y moves"),
    section("x_of_z", CURVE, "of X while Z moves"),
    section("y_of_z", CURVE, "of Y while Z moves"),
];

const fn line(name: &'static str, meaning: &'static str) -> Key {
    key(name, Number, "µm/m", meaning).as_in("3.5")
}

const SQUARENESS: &[Key] = &[
    line("y_of_x_um_per_m", "error of Y for each metre of X"),
    line("z_of_x_um_per_m", "of Z for each metre of X"),
    line("z_of_y_um_per_m", "of Z for each metre of Y"),
    line("x_of_y_um_per_m", "of X for each metre of Y"),
    line("x_of_z_um_per_m", "of X for each metre of Z"),
    line("y_of_z_um_per_m", "of Y for each metre of Z"),
];

const fn limit(name: &'static str, default: &'static str) -> Key {
    key(name, NotNegative, "µm", "on this axis, either way").or(default)
}

const MAX: &[Key] = &[limit("x", "200.0"), limit("y", "200.0"), limit("z", "500.0")];

const LIMITS: &[Key] = &[
    section("max_um", MAX, "the largest offset; a board takes at most 4000 µm from any calibration (14.3 m of steel grow by it at 20 K)"),
    key("slew_um_per_s", Positive, "µm/s", "the fastest change of an offset; a board takes at most 10000. A table, curve or wave must not be steeper than what this follows at 30 mm/min (40 µm/mm)")
        .or("20.0"),
    key("link_timeout_ms", Whole(1, u32::MAX), "ms", "without the CNC's `Control` for so long it is lost; a board takes at most 60000").or("500"),
    key("hold_ms", Whole(0, u32::MAX), "ms", "the last offset is held for so long, then taken back; a board takes at most 600000").or("2000"),
    key("rejoin_um_per_s", Positive, "µm/s", "how fast the difference between two sources of the growth is taken back when the better one has returned; a board takes 0.001 to 1")
        .or("0.01"),
    section("learned", LEARNED, "how far what `trueup learn` has learned may change the correction while the bridge runs, either way; without it nothing may"),
];

const LEARNED: &[Key] = &[
    cap(
        "growth_percent",
        "%",
        "of the growth of the spindle; a board takes at most 25, in steps of 0.1",
        "5.0",
    ),
    cap(
        "axes_percent",
        "%",
        "of the expansion of each axis; a board takes at most 25, in steps of 0.1",
        "5.0",
    ),
    cap(
        "zero_um",
        "µm",
        "the zero of the growth; a board takes at most 20, in steps of 0.1",
        "10.0",
    ),
];

const fn cap(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
    example: &'static str,
) -> Key {
    key(name, NotNegative, unit, meaning).or("0.0").as_in(example)
}

const THERMAL_STATE: &[Key] = &[
    key("cold_within_c", NotNegative, "K", "after a power cut the machine counts as cold if at least two thermometers agree within this; a board takes at most 5")
        .required().as_in("0.5"),
];

const INSTRUMENT: &[Key] = &[key(
    "uncertainty_um",
    Positive,
    "µm",
    "what the measuring instrument is worth, 95 %; for `trueup diagnose`",
)
.required()
.as_in("0.5")];

/// The file itself.
pub const FILE: &[Key] = &[
    Key {
        need: Need::Required,
        ..section("machine", MACHINE, "which machine it is, and where its tool points")
    },
    section(
        "inputs",
        INPUTS,
        "what is connected to the board; needed to run on one, not to predict",
    ),
    section("spindle", SPINDLE, "how the spindle grows"),
    section("axis", AXIS_SECTIONS, "what is known of each linear axis"),
    section("straightness", STRAIGHTNESS, "errors of one axis while another one moves"),
    section("squareness", SQUARENESS, "angles between the axes"),
    section(
        "angular",
        ANGULAR,
        "angular errors of the linear axes, in the letters of ISO 230-1; needs `machine.chain`",
    ),
    section(
        "rotary",
        ROTARY,
        "location errors of the rotary axes, in the letters of ISO 230-7; needs `machine.chain`",
    ),
    section("tool", TOOL_TIP, "where the tool tip is, which angular errors move by their lever"),
    section(
        "limits",
        LIMITS,
        "how far and how fast an offset may go, and how long silence is tolerated",
    ),
    section(
        "thermal_state",
        THERMAL_STATE,
        "what the board takes for a machine without heat of its own; without it 0.5 K",
    ),
    section("instrument", INSTRUMENT, "what the machine is measured with"),
    key("term", Terms, "", "a cause that `trueup diagnose` has added"),
];
