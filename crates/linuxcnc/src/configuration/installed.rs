//! What of ours is in a configuration already: by setup, or by hand.

use trueup_machine::Location;

use super::{
    Entry,
    hal_files::{HalCommand, HalFiles},
    ini_lines::IniLines,
};

/// The section of the INI file.
pub const SECTION: &str = "TRUEUP";

/// Where the bridge is, and what it was loaded with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bridge {
    /// Port of the component.
    pub port: String,
    /// Machine file, as the INI file names it.
    pub machine: Option<String>,
    /// How often positions are sent.
    pub position_period_ms: u64,
}

/// What setup has written before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Installed {
    /// Where offsets enter.
    pub entry: Entry,
    /// The bridge.
    pub bridge: Bridge,
}

impl Installed {
    /// Returns what setup has written; `None` if nothing.
    #[must_use]
    pub fn of(ini: &IniLines) -> Option<Self> {
        let ours =
            |key| ini.value(SECTION, key).filter(|value| value.is_ours).map(|value| value.text);
        Some(Self {
            entry: Entry::parse(&ours("BY")?)?,
            bridge: Bridge {
                port: ours("PORT")?,
                machine: ours("MACHINE"),
                position_period_ms: ours("POSITION_PERIOD_MS")?.parse().ok()?,
            },
        })
    }
}

/// Returns where the user has connected the component by hand, and where offsets enter there.
#[must_use]
pub fn by_hand(ini: &IniLines, hal: &HalFiles) -> Option<(Location, Entry)> {
    let is_component = |command: &&HalCommand| {
        command.words[0] == "loadusr"
            && command
                .words
                .windows(2)
                .any(|two| two[0].ends_with("trueup") && two[1] == "linuxcnc")
    };
    let entry = |command: &HalCommand| {
        let by = command.words.windows(2).find(|two| two[0] == "--by");
        by.and_then(|two| Entry::parse(&two[1])).unwrap_or_default()
    };
    let command = hal.commands.iter().chain(&hal.late).find(is_component);
    let value = || ini.value(SECTION, "PORT").filter(|value| !value.is_ours);
    command
        .map(|it| (it.place.clone(), entry(it)))
        .or_else(|| value().map(|value| (value.place, Entry::default())))
}
