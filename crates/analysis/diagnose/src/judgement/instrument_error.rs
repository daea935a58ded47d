//! An error of the instrument next to a table over the same position: whose is it?
//!
//! Both depend on the position and nothing else, and a table of more points takes any wave. They differ in that no
//! machine is so uneven: a wave that turns more often than the table has intervals, and that was looked at.

use crate::{
    judgement::context::JudgementContext,
    term_kind::{ModelPart, TermKind},
};

/// Returns the table of the answer that may be short of what this wave of the instrument does: none where the wave was
/// looked at in most of its turns, at places less than half a turn apart, and turns more often than the table has
/// intervals.
pub(super) fn find_insufficient_table(
    case: &JudgementContext<'_>,
    part: &ModelPart,
) -> Option<TermKind> {
    let &[constant_mm, origin_mm, ..] = part.values.as_slice() else { return None };
    if !part.kind.is_instrument_error() || part.kind.column().is_some() {
        return None;
    }
    let parts = case.found.fitted.model.parts.iter();
    let (points, table) =
        parts.filter_map(|part| Some((part.kind.list_length()?, &part.kind))).next()?;
    let data = &case.problem.data;
    let position = data.own_position_mm()?;
    let rows = (0..data.rows).filter(|&row| data.used[row]);
    let mut turns: Vec<f64> = rows.map(|row| constant_mm / (position[row] + origin_mm)).collect();
    turns.retain(|turn| turn.is_finite());
    turns.sort_unstable_by(f64::total_cmp);
    let all = turns.last()? - turns.first()?;
    let apart = turns.windows(2).map(|pair| pair[1] - pair[0]);
    let looked_at: f64 = apart.filter(|apart| *apart < 0.5).sum();
    let is_separable = looked_at > 0.5 * all && all > points as f64;
    (!is_separable).then(|| table.clone())
}
