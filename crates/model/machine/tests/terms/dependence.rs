//! A dependence on a column in each of its forms, as in a machine file.

pub const HINGE: &str = r#"column = "coolant_bar"
form = "hinge"
um_per_unit = 0.4
from = 35.0"#;
pub const LEVEL_BY_SPEED: &str = r#"column = "tool"
form = "level"
times = "speed2"
levels = [1.0, 2.0]
level_um_per_krpm2 = [0.01, 0.03]"#;
pub const LEVEL_BY_GROWTH: &str = r#"column = "tool"
form = "level"
times = "growth"
levels = [1.0, 2.0]
level_factor = [0.0, 0.3]"#;
pub const LINE_BY_POSITION: &str = r#"column = "coolant_bar"
form = "line"
times = "position"
um_per_unit_per_m = 0.4"#;
pub const HEAT_BY_POSITION: &str = r#"column = "temp_b_c"
form = "line"
times = "position"
um_per_unit_per_m = -90.0
reference = 21.5
lag_s = 30.0"#;
pub const RISE_BY_POSITION: &str = r#"column = "temp_a_c"
form = "line"
minus = "temp_b_c"
times = "position"
um_per_unit_per_m = 100.0
lag_s = 700.0"#;
pub const TOOL_BY_POSITION: &str = r#"column = "tool"
form = "level"
times = "position"
levels = [2.0, 65535.0]
level_um_per_m = [1.5, -2.0]
level_default = 0.4"#;
pub const SWITCH: &str = r#"column = "coolant_on"
form = "level"
levels = [0.0, 1.0]
level_um = [0.0, -4.7]"#;
pub const SWITCH_BEHIND_A_LAG: &str = r#"column = "coolant_on"
form = "level"
levels = [0.0, 1.0]
level_um = [0.0, 14.7]
lag_s = 60.0"#;
pub const SWITCH_BY_SPEED: &str = r#"column = "coolant_on"
form = "level"
times = "speed2"
levels = [1.0, 0.0]
level_um_per_krpm2 = [0.01, -0.03]"#;
pub const SWITCH_BY_GROWTH: &str = r#"column = "coolant_on"
form = "level"
times = "growth"
levels = [0.0, 1.0]
level_factor = [0.02, 0.13]
lag_s = 500.0"#;
pub const LATE_LINE: &str = r#"column = "coolant_bar"
form = "line"
um_per_unit = 0.3
reference = 20.0
lag_s = 900.0"#;
pub const CURVE: &str = r#"column = "coolant_bar"
form = "curve"
at = [2.0, 20.0, 40.0]
curve_um = [0.0, 4.0, 5.0]"#;
pub const LATE_DIFFERENCE: &str = r#"column = "temp_a_c"
form = "line"
minus = "temp_b_c"
um_per_unit = -1.7
reference = 0.5
lag_s = 700.0"#;
pub const LEVEL_IN_A_RANGE: &str = r#"column = "spindle_rpm"
form = "level"
level_um = [4.0]
where_column = "spindle_rpm"
where_above = 3000.0"#;
pub const GROWTH_IN_A_RANGE: &str = r#"um_per_krpm2 = 0.1
where_column = "temp_a_c"
where_below = 25.0"#;
