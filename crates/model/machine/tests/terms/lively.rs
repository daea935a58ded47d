//! A run in which all that a term may read moves.

/// Temperatures swing, the spindle turns and is cut against, the axis goes there and back.
pub fn lively_run() -> String {
    let mut csv = "time_s,sensor_counts,temp_a_c,temp_b_c,temp_coil_c,spindle_rpm,load_n,\
                   x_mm,y_mm,z_mm,dir_x,coolant_bar,tool,coolant_on\n"
        .to_string();
    for row in 0..400 {
        let t = f64::from(row) * 7.3;
        let wave = |period: f64| (t / period * std::f64::consts::TAU).sin();
        csv += &format!(
            "{t},{},{},{},{},{},{},{},{},{},{},{},{},{}\n",
            (90.0 + 80.0 * wave(900.0)).round(),
            24.0 + 6.0 * wave(700.0),
            26.0 - 5.0 * wave(430.0),
            30.0 + 4.0 * wave(1_200.0),
            if row % 50 < 30 { 18_000 } else { 0 },
            (200.0 * wave(77.0)).round(),
            3.0 + 2.5 * wave(310.0),
            4.0 + 4.0 * wave(610.0),
            1_000.0 * wave(800.0),
            if row % 7 < 4 { 1 } else { -1 },
            30.0 + 20.0 * wave(250.0),
            1 + row / 30 % 2,
            row / 45 % 2,
        );
    }
    csv
}
