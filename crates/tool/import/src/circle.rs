//! A table of angles and radial deviations, as a ball bar's software exports it, as positions on a circle.
//!
//! ```text
//! u = u₀ + R·cos φ,   v = v₀ + R·sin φ        φ counts from the first axis of the plane to the second
//! ```

use crate::{
    answers::{CircleGeometry, ImportAnswers},
    column_meaning::slugify,
    convert::ConvertedColumn,
    layout::SourceTable,
};

/// The column of deviations in a run file.
const RADIAL_DEVIATION_COLUMN: &str = "measured_dr_um";

/// Beginnings of the names of columns of angles.
const ANGLE_PREFIXES: &[&str] = &["angle", "winkel", "phi", "theta"];
/// Parts of the names of columns of deviations.
const DEVIATION_KEYWORDS: &[&str] =
    &["dr", "radial", "radius", "deviation", "abweichung", "error", "fehler"];

/// Returns the answers with the name of the deviation, which is of no axis here, where the user has not named it.
pub(crate) fn with_deviation_answer(
    layout: &SourceTable,
    answers: &ImportAnswers,
) -> ImportAnswers {
    let mut answers = answers.clone();
    let is_named = |(_, name): &(String, String)| name == RADIAL_DEVIATION_COLUMN;
    if answers.circle.is_some() && !answers.columns.iter().any(is_named) {
        let is_one = |header: &&String| {
            slugify(header).split('_').any(|word| DEVIATION_KEYWORDS.contains(&word))
        };
        let headers = layout.columns.iter().map(|column| &column.header);
        let found = headers
            .filter(is_one)
            .take(1)
            .map(|header| (header.clone(), RADIAL_DEVIATION_COLUMN.into()));
        answers.columns.extend(found.collect::<Vec<_>>());
    }
    answers
}

/// Puts positions in the place of the angles, and names the deviation.
///
/// # Errors
/// There is no column of angles, or none of deviations: the text names the option.
pub(crate) fn convert_angles_to_positions(
    columns: &mut Vec<ConvertedColumn>,
    circle: &CircleGeometry,
) -> Result<(), String> {
    let is_angle = |name: &str| {
        let of_unit = name.ends_with("_deg") || name.ends_with("_rad");
        of_unit && ANGLE_PREFIXES.iter().any(|word| name.starts_with(word))
    };
    let angle = columns
        .iter()
        .position(|column| is_angle(&column.name))
        .ok_or("there is no column of angles: name it, as in --column 1=angle_deg")?;
    let is_deviation = |name: &str| {
        let of_unit = name.ends_with("_um") || name.ends_with("_mm");
        of_unit && name.split('_').any(|word| DEVIATION_KEYWORDS.contains(&word))
    };
    let deviation = columns.iter().position(|column| is_deviation(&column.name)).ok_or(
        "there is no column of radial deviations: name it, as in --column 2=measured_dr_um",
    )?;
    let column = &mut columns[deviation];
    if column.name.ends_with("_mm") {
        column.values.iter_mut().for_each(|value| *value *= 1e3);
    }
    (column.name, column.to) = (RADIAL_DEVIATION_COLUMN.into(), "µm".into());

    let of_angle = columns.remove(angle);
    let is_deg = of_angle.name.ends_with("_deg");
    let angles: Vec<f64> = of_angle
        .values
        .iter()
        .map(|value| if is_deg { value.to_radians() } else { *value })
        .collect();
    let part = |axis: usize| ConvertedColumn {
        source: of_angle.source,
        name: format!("{}_mm", circle.axes[axis]),
        from: of_angle.from.clone(),
        to: "mm".into(),
        values: angles
            .iter()
            .map(|angle| {
                let share = if axis == 0 { angle.cos() } else { angle.sin() };
                // A tenth of a nanometre: more digits are those of the cosine.
                ((circle.centre_mm[axis] + circle.radius_mm * share) * 1e7).round() / 1e7
            })
            .collect(),
    };
    let mut places = vec![part(0), part(1)];
    places.extend(circle.is_clockwise.map(|is_clockwise| ConvertedColumn {
        source: of_angle.source,
        name: "dir".into(),
        from: String::new(),
        to: String::new(),
        values: vec![if is_clockwise { -1.0 } else { 1.0 }; angles.len()],
    }));
    columns.splice(0..0, places);
    Ok(())
}
