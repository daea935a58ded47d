//! A machine to make programs for.

use std::path::Path;

use trueup_machine::{Machine, MachineFile};

/// 1 m of X, 600 mm of Y, 400 mm of Z, and a spindle of 24 000 r/min.
pub fn machine() -> Machine {
    parse(
        "[machine]\nname = \"three axes\"\nkind = \"3-axis\"\n\
         [spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n\
         rated_rpm = 24000.0\n\
         [axis.x]\ntravel_mm = [0.0, 1000.0]\n\
         [axis.y]\ntravel_mm = [-300.0, 300.0]\n\
         [axis.z]\ntravel_mm = [-400.0, 0.0]\n",
    )
}

pub fn parse(text: &str) -> Machine {
    MachineFile::parse(text, Path::new("m.toml")).expect("a machine file")
}
