//! Tables with a column for each pass (`hin 1`, `rück 1`, `hin 2`), as one row for each reading.

use trueup_machine::InputFileError;

use crate::{
    cell_grid::{Cell, CellContent, CellRow},
    column_meaning::{self, ColumnMeaning, TargetColumn},
    layout::{SourceColumn, SourceTable},
    unit,
};

/// Returns the table with one reading a row, in the order in which it was measured: there, then back. A table that
/// has no columns of passes stays unchanged.
///
/// # Errors
/// Some of these columns state a direction and others do not.
pub(crate) fn into_long_format(layout: SourceTable) -> Result<SourceTable, InputFileError> {
    let is_position = |column: &SourceColumn| {
        let parts = column_meaning::split_header(&column.header);
        let unit = unit::parse(if column.unit.is_empty() { &parts.unit } else { &column.unit });
        match column_meaning::classify_column(&column.header, &parts.name, unit) {
            ColumnMeaning::Position => true,
            ColumnMeaning::Known(target) => {
                ["x_mm", "y_mm", "z_mm"].contains(&target.name.as_str())
            }
            _ => false,
        }
    };
    let passes: Vec<Option<(Option<f64>, Option<u32>)>> = layout
        .columns
        .iter()
        // `Pos.` is a position, and not the positive way.
        .map(|column| {
            let name = column_meaning::split_header(&column.header).name;
            column_meaning::parse_pass_column(&name).filter(|_| !is_position(column))
        })
        .collect();
    let count = passes.iter().flatten().count();
    let positions = layout.columns.iter().filter(|column| is_position(column)).count();
    if count < 2 || positions != 1 {
        return Ok(layout);
    }
    let fixed: Vec<usize> = (0..passes.len()).filter(|at| passes[*at].is_none()).collect();
    let columns: Vec<usize> = (0..passes.len()).filter(|at| passes[*at].is_some()).collect();
    let has_way = |at: &usize| passes[*at].is_some_and(|(way, _)| way.is_some());
    let has_ways = columns.iter().all(has_way);
    if let Some(silent) =
        columns.iter().find(|at| !has_way(at)).filter(|_| columns.iter().any(has_way))
    {
        let SourceColumn { header, place, .. } = &layout.columns[*silent];
        let rule = format!("{header} states no direction, as other columns of readings do");
        let help = "Call each by its run and way: `Run 1 +` there, `Run 1 -` back";
        return Err(InputFileError::new(place.clone(), rule).with_help(help));
    }
    let first = &layout.columns[columns[0]];
    let source = |header: &str, meaning| SourceColumn {
        header: header.into(),
        unit: String::new(),
        meaning: Some(meaning),
        place: first.place.clone(),
    };
    let mut sources: Vec<SourceColumn> =
        fixed.iter().map(|at| layout.columns[*at].clone()).collect();
    sources.push(source("pass", ColumnMeaning::Known(TargetColumn::from_name("run"))));
    if has_ways {
        sources.push(source("way", ColumnMeaning::Direction));
    }
    // A bare number would name a column by its place.
    let header = match first.header.parse::<u32>() {
        Ok(number) => format!("pass {number}"),
        Err(_) => first.header.clone(),
    };
    // `Abw. X hin` says what is measured, `hin 1` does not.
    let parts = column_meaning::split_header(&first.header);
    let meant =
        column_meaning::classify_column(&first.header, &parts.name, unit::parse(&parts.unit));
    let meaning = match meant {
        ColumnMeaning::Known(target) if target.name.starts_with("measured_") => {
            ColumnMeaning::Known(target)
        }
        _ => ColumnMeaning::Measured,
    };
    sources.push(SourceColumn { header, meaning: Some(meaning), ..first.clone() });

    let mut rows = Vec::new();
    let mut runs_of_way = [0_u32; 2];
    for at in columns.iter().copied() {
        let (way, run) = passes[at].unwrap_or_default();
        let counter = &mut runs_of_way[usize::from(way == Some(-1.0))];
        *counter += 1;
        let run = run.unwrap_or(*counter);
        let pass = layout.rows.iter().filter(|row| !row.cells[at].is_empty()).map(|row| {
            let number =
                |value: f64| Cell { content: CellContent::Number(value), ..row.cells[at].clone() };
            let mut cells: Vec<Cell> = fixed.iter().map(|at| row.cells[*at].clone()).collect();
            cells.push(number(f64::from(run)));
            cells.extend(way.filter(|_| has_ways).map(number));
            cells.push(row.cells[at].clone());
            CellRow { line: row.line, cells }
        });
        let mut pass: Vec<CellRow> = pass.collect();
        if way == Some(-1.0) {
            pass.reverse();
        }
        rows.extend(pass);
    }
    let mut notes = layout.notes;
    notes.push(format!(
        "{count} columns are passes: one reading a row, the way back from the last target"
    ));
    Ok(SourceTable { columns: sources, rows, notes })
}
