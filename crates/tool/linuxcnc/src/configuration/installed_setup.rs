//! Finds our lines in a configuration: by setup, or by hand.

use trueup_machine::Location;

use super::{
    OffsetEntryPoint,
    hal_files::{HalCommand, HalFiles},
    ini_file::IniFile,
};

/// The section of the INI file.
pub(crate) const TRUEUP_INI_SECTION: &str = "TRUEUP";

/// Where the bridge is, and what it was loaded with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BridgeSettings {
    /// Port of the component; `None`: there is no board.
    pub port: Option<String>,
    /// Machine file, as the INI file names it.
    pub machine: Option<String>,
    /// How often positions are sent.
    pub position_period_ms: u64,
}

/// Lines that setup has written before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstalledSetup {
    /// Where offsets enter.
    pub entry: OffsetEntryPoint,
    /// The bridge.
    pub bridge: BridgeSettings,
}

impl InstalledSetup {
    /// Returns what setup has written; `None` if nothing.
    #[must_use]
    pub fn from_ini(ini: &IniFile) -> Option<Self> {
        let ours = |key| {
            ini.value(TRUEUP_INI_SECTION, key).filter(|value| value.is_ours).map(|value| value.text)
        };
        // Either a board at a port, or none.
        ours("PORT").or_else(|| ours("CALIBRATION"))?;
        Some(Self {
            entry: OffsetEntryPoint::parse(&ours("BY")?)?,
            bridge: BridgeSettings {
                port: ours("PORT"),
                machine: ours("MACHINE"),
                position_period_ms: ours("POSITION_PERIOD_MS")
                    .map_or(Some(0), |text| text.parse().ok())?,
            },
        })
    }
}

/// Returns where the user has connected the component by hand, and where offsets enter there.
#[must_use]
pub fn find_manual_setup(ini: &IniFile, hal: &HalFiles) -> Option<(Location, OffsetEntryPoint)> {
    let is_component = |command: &&HalCommand| {
        command.words[0] == "loadusr"
            && command
                .words
                .windows(2)
                .any(|two| two[0].ends_with("trueup") && two[1] == "linuxcnc")
    };
    let entry = |command: &HalCommand| {
        let next = |two: &[String]| (two[0] == "--by").then(|| two[1].clone());
        let joined = |word: &String| word.strip_prefix("--by=").map(String::from);
        let by = command.words.windows(2).find_map(next);
        let by = by.or_else(|| command.words.iter().find_map(joined));
        by.and_then(|by| OffsetEntryPoint::parse(&by)).unwrap_or_default()
    };
    let command = hal.commands.iter().chain(&hal.late).find(is_component);
    let value = || ini.value(TRUEUP_INI_SECTION, "PORT").filter(|value| !value.is_ours);
    command
        .map(|command| (command.place.clone(), entry(command)))
        .or_else(|| value().map(|value| (value.place, OffsetEntryPoint::default())))
}

#[cfg(test)]
mod tests {
    use super::{super::hal_files::tests::configuration, *};

    #[test]
    fn both_ways_to_write_an_option_say_where_offsets_enter_by_hand() {
        for (option, entry) in [
            ("--by joint", OffsetEntryPoint::Joint),
            ("--by=joint", OffsetEntryPoint::Joint),
            ("--by=eoffset", OffsetEntryPoint::Eoffset),
            ("", OffsetEntryPoint::Eoffset),
        ] {
            let hal = format!("loadusr -W /opt/trueup linuxcnc {option} --port x\n");
            let (_folder, ini, hal) =
                configuration(&[("m.ini", "[HAL]\nHALFILE = m.hal\n"), ("m.hal", &hal)]);
            let found = find_manual_setup(&ini, &hal.expect("reads"));
            assert_eq!(found.map(|entry| entry.1), Some(entry), "{option}");
        }
    }
}
