//! A machine to make programs for.

use std::path::Path;

use trueup_machine::{Machine, MachineFile};
use trueup_program::MeasurementOptions;

/// 1 m of X, 600 mm of Y, 400 mm of Z within the margins, and a spindle of 24 000 r/min.
pub fn machine() -> Machine {
    parse(
        "[machine]\nname = \"three axes\"\nkind = \"3-axis\"\n\
         [spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n\
         rated_rpm = 24000.0\n\
         [axis.x]\ntravel_mm = [-2.0, 1002.0]\n\
         [axis.y]\ntravel_mm = [-302.0, 302.0]\n\
         [axis.z]\ntravel_mm = [-402.0, 2.0]\n",
    )
}

/// Z may move over all of its travel.
pub fn with_z() -> MeasurementOptions {
    MeasurementOptions {
        range_mm: [None, None, Some([-402.0, 2.0])],
        ..MeasurementOptions::default()
    }
}

pub fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("a machine file")
}
