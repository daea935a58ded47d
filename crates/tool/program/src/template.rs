//! The run file to be filled in: a row for each reading, in the order of the program. Its first lines repeat
//! what moves and what must be clear, for the page that is printed of it.

use crate::plan::{Column, MeasurementPlan, PlannedReading};

const LINEAR_AXIS_NAMES: [&str; 3] = ["x", "y", "z"];
const ROTARY_AXIS_NAMES: [&str; 3] = ["a", "b", "c"];

/// Returns the run files of `plan`, by name: empty where something is to be measured.
#[must_use]
pub fn run_file_templates(plan: &MeasurementPlan) -> Vec<(String, String)> {
    let text = format_template(plan);
    if plan.records.is_empty() {
        return vec![(format!("{}.csv", plan.name), text)];
    }
    plan.records
        .iter()
        .map(|record| (format!("{}-{record}.csv", plan.name), text.clone()))
        .collect()
}

fn format_template(plan: &MeasurementPlan) -> String {
    let empty: Vec<&str> = plan.columns.iter().filter_map(empty_column_name).collect();
    let mut text = format!(
        "# {}: fill in {}, a row for each reading, errors as actual minus commanded\n",
        plan.name,
        empty.join(", "),
    );
    for line in &plan.then {
        text += &format!("# then: {line}\n");
    }
    for sentence in plan.first_stop_instructions().iter().chain(&plan.notes) {
        text += &format!("# {sentence}\n");
    }
    let names: Vec<String> = plan.columns.iter().map(column_name).collect();
    text += &names.join(",");
    text.push('\n');
    for reading in plan.readings() {
        let cells: Vec<String> =
            plan.columns.iter().map(|column| cell_text(column, &reading)).collect();
        text += &cells.join(",");
        text.push('\n');
    }
    text
}

fn empty_column_name(column: &Column) -> Option<&str> {
    match column {
        Column::Empty(name) => Some(name),
        _ => None,
    }
}

/// Returns the name of a column.
pub(crate) fn column_name(column: &Column) -> String {
    match column {
        Column::Run => "run".into(),
        Column::Time => "time_s".into(),
        Column::Position(axis) | Column::Stands(axis, _) => {
            format!("{}_mm", LINEAR_AXIS_NAMES[*axis])
        }
        Column::Direction(axis) => format!("dir_{}", LINEAR_AXIS_NAMES[*axis]),
        Column::Angle(axis) => format!("{}_deg", ROTARY_AXIS_NAMES[*axis]),
        Column::ToolLength => "tool_length_mm".into(),
        Column::Point => "point".into(),
        Column::Sense => "dir".into(),
        Column::Constant(name, _) => (*name).into(),
        Column::Feed => "feed_mm_per_min".into(),
        Column::Speed | Column::SpeedBetween(_) => "spindle_rpm".into(),
        Column::Empty(name) => name.clone(),
    }
}

/// Returns the cell of a column in the row of a reading; empty where it is to be filled in.
pub(crate) fn cell_text(column: &Column, reading: &PlannedReading) -> String {
    match column {
        Column::Run => reading.run.to_string(),
        Column::Time => reading.dwelt_s.to_string(),
        Column::Position(axis) => format_optional(reading.position_mm[*axis]),
        Column::Stands(_, mm) => mm.to_string(),
        Column::Angle(axis) => format_optional(reading.angle_deg[*axis]),
        Column::ToolLength => format_optional(reading.tool_length_mm),
        Column::Point => format_optional(reading.point),
        Column::Sense => reading.sense.to_string(),
        Column::Constant(_, value) => value.to_string(),
        Column::Direction(axis) => match reading.direction[*axis] {
            0 => String::new(),
            way => way.to_string(),
        },
        Column::Feed => format_optional(reading.feed_mm_per_min),
        Column::Speed => reading.spindle_rpm.to_string(),
        Column::SpeedBetween(rpm) => rpm.to_string(),
        Column::Empty(_) => String::new(),
    }
}

/// Returns a value as a cell; empty where there is none.
fn format_optional(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}
