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
