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
