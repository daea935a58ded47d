//! The columns of a run file that the project knows: the one list, from which `docs/reference.md` is made.

/// A column that is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownColumn {
    /// Its name; `<name>` stands for any word.
    pub name: &'static str,
    /// Its unit, or the values that it may have; empty where it is a bare number.
    pub unit: &'static str,
    /// Its meaning.
    pub meaning: &'static str,
}

const fn define_column(
    name: &'static str,
    unit: &'static str,
    meaning: &'static str,
) -> KnownColumn {
    KnownColumn { name, unit, meaning }
}

const APPROACH_DIRECTION_DESCRIPTION: &str =
    "direction in which the position was approached; +1 where the column is missing";
const COMMANDED_POSITION_DESCRIPTION: &str = "commanded position";
const ROTARY_AXIS_DESCRIPTION: &str = "rotary axis";
const MEASURED_ERROR_DESCRIPTION: &str = "the error on an axis, actual minus commanded";
const OFFSET_DESCRIPTION: &str =
    "the offset that a bridge sent to the CNC while the row was measured";

/// All of them, in the order of the reference.
pub(crate) const KNOWN_COLUMNS: &[KnownColumn] = &[
    define_column("time_s", "s", "time"),
    define_column(
        "gauge_time_s",
        "s",
        "the clock of the gauge's own logger, next to `time_s`; with it `diagnose` takes the gauge to be early \
         as well as late",
    ),
    define_column("run", "", "number of the repeat"),
    define_column(
        "setup",
        "",
        "number of the set-up of the instrument, of `fit circle` and `fit volume`: each has a zero, an alignment and a centre of its own",
    ),
    define_column(
        "point",
        "",
        "number of the ball, or of the point of a straight edge, of `fit volume`: the same in all set-ups",
    ),
    define_column(
        "square",
        "",
        "number of the square whose faces were touched, of `fit volume`: both faces have one alignment",
    ),
    define_column(
        "tool_length_mm",
        "mm",
        "the tool or stylus in the spindle, in the place of `[tool] length_mm`; the board knows that of the machine file",
    ),
    define_column(
        "tool",
        "",
        "the tool in the spindle: the number that the CNC sends, 0 for none, or a label that has its number in \
         `[spindle.tools]`",
    ),
    define_column("sensor_counts", "counts", "the spindle's displacement sensor"),
    define_column("spindle_rpm", "r/min", "speed; without it the spindle counts as running"),
    define_column("load_n", "N", "axial cutting force; pushing the tool back is positive"),
    define_column("temp_<name>_c", "°C", "any number of temperatures"),
    define_column("x_mm", "mm", COMMANDED_POSITION_DESCRIPTION),
    define_column(
        "x_dia_mm",
        "mm",
        "in the place of `x_mm`, of a lathe: commanded diameter. It is read as `x_mm`, half of it; an error in X is of the \
         radius",
    ),
    define_column("y_mm", "mm", COMMANDED_POSITION_DESCRIPTION),
    define_column("z_mm", "mm", COMMANDED_POSITION_DESCRIPTION),
    define_column("a_deg", "°", ROTARY_AXIS_DESCRIPTION),
    define_column("b_deg", "°", ROTARY_AXIS_DESCRIPTION),
    define_column("c_deg", "°", ROTARY_AXIS_DESCRIPTION),
    define_column("dir_x", "+1, −1", APPROACH_DIRECTION_DESCRIPTION),
    define_column("dir_y", "+1, −1", APPROACH_DIRECTION_DESCRIPTION),
    define_column("dir_z", "+1, −1", APPROACH_DIRECTION_DESCRIPTION),
    define_column(
        "dir",
        "+1, −1",
        "direction on a circle, +1 counter-clockwise; without it that of the order of the rows",
    ),
    define_column(
        "feed_mm_per_min",
        "mm/min",
        "the feed at which the position was approached; `fit backlash` shows whether backlash depends on it",
    ),
    define_column("measured_elongation_um", "µm", "the growth of the spindle"),
    define_column("measured_dx_um", "µm", MEASURED_ERROR_DESCRIPTION),
    define_column("measured_dy_um", "µm", MEASURED_ERROR_DESCRIPTION),
    define_column("measured_dz_um", "µm", MEASURED_ERROR_DESCRIPTION),
    define_column(
        "measured_dr_um",
        "µm",
        "the radial deviation on a circle, actual minus nominal radius, at the commanded position; `fit circle`",
    ),
    define_column(
        "measured_diagonal_um",
        "µm",
        "the error along the diagonal, actual minus commanded, of the way from the first to the last row of the set-up; `fit volume`",
    ),
    define_column("offset_x_um", "µm", OFFSET_DESCRIPTION),
    define_column("offset_y_um", "µm", OFFSET_DESCRIPTION),
    define_column("offset_z_um", "µm", OFFSET_DESCRIPTION),
    define_column(
        "quality",
        "0…6",
        "of these offsets: 0 off, 1 to 3 on, 4 held, 5 ramping out, 6 not available",
    ),
    define_column(
        "check_um",
        "µm",
        "a check of the probe: the reading of a certified reference less its value at 20 °C. `learn` takes it off \
         every reading, linear between checks",
    ),
    define_column(
        "calibration_crc",
        "",
        "the calibration that the bridge ran, as a decimal number",
    ),
];

/// Returns the known column of this name.
pub(crate) fn find_known_column(name: &str) -> Option<&'static KnownColumn> {
    let is_it = |known: &&KnownColumn| match known.name.split_once("<name>") {
        None => known.name == name,
        Some((before, after)) => name
            .strip_prefix(before)
            .and_then(|rest| rest.strip_suffix(after))
            .is_some_and(|inner| !inner.is_empty() && !inner.starts_with('_')),
    };
    KNOWN_COLUMNS.iter().find(is_it)
}

/// Returns whether a column of this name is known.
///
/// ```
/// use trueup_machine::run_file::is_known_column;
/// assert!(is_known_column("temp_bed_c") && is_known_column("x_mm"));
/// assert!(!is_known_column("temp__c") && !is_known_column("flow"));
/// ```
#[must_use]
pub fn is_known_column(name: &str) -> bool {
    find_known_column(name).is_some()
}
