//! The table as a page: figures by curve and diagonal, and the corners of straight lines as the jumps of speed
//! that they are.

use trueup_page::{
    Chart, ChartSeries, ColourRole, HtmlPage, HtmlTable, Provenance, format_micrometres,
};

use super::{CurveMethod, MethodResult, MethodTable, MethodTableEntry};

/// The ways that are drawn: the correction as the bridge has it, and the two that the paper holds it against.
const PLOTTED_METHODS: [(CurveMethod, ColourRole); 3] = [
    (CurveMethod::Lines, ColourRole::Before),
    (CurveMethod::Polynomial, ColourRole::Measured),
    (CurveMethod::LeastSquares, ColourRole::After),
];

pub(super) fn render_html(table: &MethodTable, origin: &Provenance) -> String {
    let mut page = HtmlPage::new("Ways to a straightness curve");
    page.add_paragraph(&format!(
        "The residual of each method, and the speed jumps and accelerations that it requires. \
         They are for {} mm/min, in a control that updates its axes every {} ms.",
        table.feed_mm_per_min, table.cycle_ms
    ));
    for entry in &table.entries {
        page.add_heading(&entry.name);
        page.add_table(&residual_table(entry));
        page.add_charts(&[speed_chart(entry).to_figure()]);
        if !entry.steps.is_empty() {
            let step =
                |(points, um): &(usize, f64)| format!("{points}: {}", format_micrometres(*um));
            let steps: Vec<String> = entry.steps.iter().map(step).collect();
            page.add_note(&format!(
                "The paper's way, control points and the largest residual with them: {}.",
                steps.join(", ")
            ));
        }
    }
    page.add_note(
        "Range, mean and mean square (about the mean) as in the table of the paper. Straight \
         lines leave nothing at the places that were read, whatever lies between them. Against \
         them speak the jump of speed at each, and the noise of each reading, which they cut \
         into the part. A polynomial has no jumps and cannot follow.",
    );
    page.add_provenance_footer(origin);
    page.to_html()
}

fn residual_table(entry: &MethodTableEntry) -> HtmlTable {
    let mut table = HtmlTable::new(&[
        "",
        "coefficients",
        "range, µm",
        "mean, µm",
        "mean square, µm²",
        "within any metre, µm",
        "from one position to the next, µm",
        "jump of speed, mm/s",
        "acceleration, mm/s²",
    ]);
    let left = |name: String,
                coefficients: String,
                left: &super::ResidualDeviation,
                requested: [String; 2]| {
        let [jump, acceleration] = requested;
        [
            name,
            coefficients,
            format!("{:.2}", left.residual.range_um),
            format!("{:.2}", left.residual.mean_um),
            format!("{:.2}", left.residual.mean_square_um2),
            format!("{:.2}", left.over_a_metre_um),
            format!("{:.2}", left.step_um),
            jump,
            acceleration,
        ]
    };
    let nothing = || [String::new(), String::new()];
    table.add_row(&left("without".into(), String::new(), &entry.without, nothing()));
    for row in &entry.rows {
        let requested =
            [format!("{:.6}", row.jump_mm_per_s), format!("{:.4}", row.acceleration_mm_per_s2)];
        table.add_row(&left(
            row.way.to_string(),
            row.coefficients.to_string(),
            &row.left,
            requested,
        ));
    }
    table
}

fn speed_chart(entry: &MethodTableEntry) -> Chart {
    let series = PLOTTED_METHODS.into_iter().filter_map(|(way, colour)| {
        let row: &MethodResult = entry.rows.iter().find(|row| row.way == way)?;
        Some(ChartSeries::line(&way.to_string(), colour, row.speed.clone()))
    });
    Chart {
        title: format!("The correction's own speed: {}", entry.name),
        x: "along the way, mm".into(),
        y: "µm/s".into(),
        series: series.collect(),
    }
}
