//! The axes of positions, directions and errors whose headers do not name them.

use super::ColumnInference;
use crate::{
    answers::{Question, QuestionTopic},
    column_meaning::{ColumnMeaning, TargetColumn},
};

/// Gives positions, directions and errors their axes, or asks for them.
pub(super) fn assign_axes(drafts: &mut [ColumnInference<'_>], questions: &mut Vec<Question>) {
    let ask = |draft: &ColumnInference<'_>, text: &str, choices: &[&str]| Question {
        place: draft.source.place.clone(),
        text: format!("{} {text}", draft.source.header),
        topic: QuestionTopic::Column(draft.source.header.clone()),
        choices: choices.iter().map(ToString::to_string).collect(),
        is_open: true,
    };
    let actual_axis = drafts.iter().find_map(|draft| match draft.meaning {
        ColumnMeaning::Actual(axis) => axis,
        _ => None,
    });
    let known = |drafts: &[ColumnInference<'_>]| -> Vec<char> {
        let axes = ['x', 'y', 'z'].into_iter();
        axes.filter(|axis| {
            let name = format!("{axis}_mm");
            drafts.iter().any(
                |draft| matches!(&draft.meaning, ColumnMeaning::Known(target) if target.name == name),
            )
        })
        .collect()
    };
    let mut has_open_position = false;
    for draft in drafts.iter_mut() {
        if draft.meaning == ColumnMeaning::Position {
            match actual_axis {
                Some(axis) => {
                    draft.meaning =
                        ColumnMeaning::Known(TargetColumn::from_name(&format!("{axis}_mm")))
                }
                None => {
                    has_open_position = true;
                    questions.push(ask(
                        draft,
                        "is a position of which axis?",
                        &["x_mm", "y_mm", "z_mm"],
                    ));
                }
            }
        }
    }
    let positions = known(drafts);
    let only = if let [axis] = positions[..] { Some(axis) } else { None };
    let has_measured = drafts.iter().any(|draft| {
        draft.meaning == ColumnMeaning::Measured
            || matches!(&draft.meaning, ColumnMeaning::Known(target) if target.name.starts_with("measured_"))
    });
    for draft in drafts.iter_mut() {
        match draft.meaning {
            ColumnMeaning::Actual(_) if has_measured => draft.meaning = ColumnMeaning::Nothing,
            ColumnMeaning::Actual(None) if only.is_some() => {
                draft.meaning = ColumnMeaning::Actual(only)
            }
            ColumnMeaning::Actual(None) if has_open_position => {}
            ColumnMeaning::Actual(_) if positions.is_empty() => {
                questions.push(ask(
                    draft,
                    "is a position of which axis?",
                    &["x_mm", "y_mm", "z_mm"],
                ));
            }
            ColumnMeaning::Actual(None) => {
                questions.push(ask(draft, "is an actual position of which axis?", &["-"]));
            }
            ColumnMeaning::Direction => match only {
                Some(axis) => {
                    draft.meaning =
                        ColumnMeaning::Known(TargetColumn::from_name(&format!("dir_{axis}")))
                }
                None if has_open_position => {}
                None => questions.push(ask(
                    draft,
                    "is the direction of which axis?",
                    &["dir_x", "dir_y", "dir_z"],
                )),
            },
            ColumnMeaning::Measured => {
                let mut choices = vec![
                    "measured_dx_um",
                    "measured_dy_um",
                    "measured_dz_um",
                    "measured_elongation_um",
                ];
                // The likeliest first: along the axis that moves, of a spindle where none does.
                match only {
                    Some('y') => choices.swap(0, 1),
                    Some('z') => choices.swap(0, 2),
                    None if positions.is_empty() && !has_open_position => choices.swap(0, 3),
                    _ => {}
                }
                questions.push(ask(
                    draft,
                    "is the error in which direction (actual minus commanded)?",
                    &choices,
                ));
            }
            _ => {}
        }
    }
}
