//! The HAL files of a configuration: their commands with places, which signal a pin is on, and what a thread runs.
//!
//! Only what decides how offsets enter is understood: `net`, the `link…` commands, `unlinkp`, `delsig`, `addf`, `delf`,
//! `loadrt`, `loadusr`, `source`. `[SECTION]KEY` is replaced as `halcmd` does it.

use std::{collections::BTreeMap, path::PathBuf};

use trueup_machine::{
    InputFileError, Location, bounded_read, machine_file::MAX_MACHINE_FILE_BYTES,
};

use super::ini_file::{IniFile, IniValue, expand_home, is_file};

/// Where LinuxCNC keeps HAL files of its own, unless `HALLIB_DIR` says otherwise.
const HAL_LIBRARY_DIR: &str = "/usr/share/linuxcnc/hallib";
/// `source` may call files that call files, so deep.
const MAX_SOURCE_DEPTH: usize = 8;
/// Between the pins of a `net`.
const NET_ARROWS: [&str; 3] = ["=>", "<=", "<=>"];

/// A command of a HAL file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HalCommand {
    /// Its words, with the values of the INI file.
    pub words: Vec<String>,
    /// Its line.
    pub place: Location,
}

/// A signal that a pin is on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PinLink {
    /// Name of the signal.
    pub signal: String,
    /// The line that connects the pin.
    pub place: Location,
}

/// All HAL commands of a configuration but those of setup.
#[derive(Clone, Debug, Default)]
pub struct HalFiles {
    /// Commands of the HAL files, in their order.
    pub commands: Vec<HalCommand>,
    /// Commands after all HAL files: `HALCMD` lines, and those after the screen has come (`POSTGUI_HALFILE`).
    pub late: Vec<HalCommand>,
    /// The last `HALFILE` line that is the user's.
    pub last_line: Option<Location>,
    /// `HALFILE` lines that name a Tcl file.
    pub tcl: Vec<IniValue>,
}

impl HalFiles {
    /// Reads every HAL file that the INI file names.
    ///
    /// # Errors
    /// A file is missing or cannot be read.
    pub fn read(ini: &IniFile) -> Result<Self, InputFileError> {
        let mut all = Self::default();
        let users = |key| ini.values("HAL", key).into_iter().filter(|value| !value.is_ours);
        for value in users("HALFILE") {
            all.last_line = Some(value.place.clone());
            let name = value.text.split_whitespace().next().unwrap_or_default();
            if name.ends_with(".tcl") {
                all.tcl.push(value);
                continue;
            }
            let path = find_hal_file(ini, name).ok_or_else(|| {
                InputFileError::new(
                    value.place.clone(),
                    format!("HALFILE = {name}: there is no such file"),
                )
                .with_help("LinuxCNC looks next to the INI file and in its library")
            })?;
            append_commands(&mut all.commands, ini, &path, 0)?;
        }
        for value in users("HALCMD") {
            all.late.extend(parse_command(ini, &value.text, &value.place));
        }
        for value in users("POSTGUI_HALFILE") {
            let name = value.text.split_whitespace().next().unwrap_or_default();
            // A screen that is not installed leaves its file away.
            if let Some(path) = find_hal_file(ini, name).filter(|_| !name.ends_with(".tcl")) {
                append_commands(&mut all.late, ini, &path, 0)?;
            }
        }
        Ok(all)
    }

    /// Returns the signal that a pin is on after the HAL files.
    #[must_use]
    pub(crate) fn find_link(&self, pin: &str) -> Option<PinLink> {
        collect_links(&self.commands).remove(pin)
    }

    /// Returns the signal that a pin is on after the HAL files or after what comes later.
    #[must_use]
    pub(crate) fn find_final_link(&self, pin: &str) -> Option<PinLink> {
        self.find_link(pin).or_else(|| collect_links(&self.late).remove(pin))
    }

    /// Returns the line that names a pin after the HAL files.
    #[must_use]
    pub(crate) fn find_late_reference(&self, pin: &str) -> Option<Location> {
        let names = |command: &&HalCommand| command.words.iter().skip(1).any(|word| word == pin);
        self.late.iter().find(names).map(|command| command.place.clone())
    }

    /// Returns true if a command of the HAL files names this signal.
    #[must_use]
    pub(crate) fn has_signal(&self, signal: &str) -> bool {
        self.commands.iter().any(|command| command.words.iter().skip(1).any(|word| word == signal))
    }

    /// Returns the first command that loads this realtime module.
    #[must_use]
    pub(crate) fn find_loadrt(&self, module: &str) -> Option<&HalCommand> {
        let all = self.commands.iter().chain(&self.late);
        all.into_iter().find(|command| {
            command.words[0] == "loadrt" && command.words.get(1).is_some_and(|word| word == module)
        })
    }

    /// Returns the thread that runs the motion controller and its functions in their order.
    ///
    /// # Errors
    /// No thread runs it, or a position is beyond the functions that are there.
    pub(crate) fn find_motion_thread(&self) -> Result<(String, Vec<String>), ThreadOrderError> {
        let controller = self.commands.iter().find(|command| {
            command.words[0] == "addf"
                && command.words[1..].first().is_some_and(|word| word == MOTION_CONTROLLER_FUNCTION)
        });
        let thread = controller
            .and_then(|controller| controller.words.get(2))
            .ok_or(ThreadOrderError(None))?
            .clone();
        let mut functions: Vec<String> = Vec::new();
        for command in &self.commands {
            match &command.words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
                ["addf", function, of, rest @ ..] if *of == thread => {
                    let position = rest.first().map_or(Ok(-1), |word| word.parse::<i32>());
                    let index = match position {
                        Ok(from_start @ 1..) => {
                            usize::try_from(from_start - 1).unwrap_or(usize::MAX)
                        }
                        // From the end: -1 is after the last one.
                        Ok(from_end @ ..=-1) => {
                            let back = usize::try_from(-(from_end + 1)).unwrap_or(usize::MAX);
                            functions.len().checked_sub(back).unwrap_or(usize::MAX)
                        }
                        _ => usize::MAX,
                    };
                    if index > functions.len() {
                        return Err(ThreadOrderError(Some(command.place.clone())));
                    }
                    functions.insert(index, (*function).to_owned());
                }
                ["delf", function, of] if *of == thread => {
                    functions.retain(|other| other != function)
                }
                _ => {}
            }
        }
        Ok((thread, functions))
    }
}

/// The function of LinuxCNC's motion controller.
pub(crate) const MOTION_CONTROLLER_FUNCTION: &str = "motion-controller";

/// A thread whose order is not known: no `addf` of the motion controller, or a bad position, with its line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ThreadOrderError(pub Option<Location>);

/// Looks for a HAL file as the script `linuxcnc` does.
fn find_hal_file(ini: &IniFile, name: &str) -> Option<PathBuf> {
    let library = std::env::var_os("HALLIB_DIR")
        .map_or_else(|| PathBuf::from(HAL_LIBRARY_DIR), PathBuf::from);
    let places = match name.strip_prefix("LIB:") {
        Some(name) => vec![library.join(name)],
        // An absolute path stays unchanged.
        None => vec![ini.folder().join(expand_home(name)), library.join(name)],
    };
    places.into_iter().find(|path| is_file(path))
}

fn append_commands(
    commands: &mut Vec<HalCommand>,
    ini: &IniFile,
    path: &std::path::Path,
    depth: usize,
) -> Result<(), InputFileError> {
    let text = bounded_read::read_text(path, MAX_MACHINE_FILE_BYTES)?;
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        let mut whole = line.trim_end().to_owned();
        while whole.ends_with('\\') {
            whole.pop();
            let Some((_, next)) = lines.next() else { break };
            whole.push(' ');
            whole.push_str(next.trim_end());
        }
        let place = Location { file: path.to_path_buf(), line: index + 1, column: 1 };
        let Some(command) = parse_command(ini, &whole, &place) else { continue };
        if let ["source", name] = &command.words.iter().map(String::as_str).collect::<Vec<_>>()[..]
        {
            let found = find_hal_file(ini, name).filter(|_| depth < MAX_SOURCE_DEPTH);
            let found = found.ok_or_else(|| {
                InputFileError::new(place, format!("source {name}: there is no such file"))
            })?;
            append_commands(commands, ini, &found, depth + 1)?;
        } else {
            commands.push(command);
        }
    }
    Ok(())
}

/// Returns the command of a line; `None` for a comment or an empty line.
fn parse_command(ini: &IniFile, line: &str, place: &Location) -> Option<HalCommand> {
    let line = line.split('#').next().unwrap_or_default();
    let replaced = line.split_whitespace().map(|word| substitute_ini_values(ini, word));
    // A value may be several words: `loadrt [KINS]KINEMATICS`.
    let words: Vec<String> = replaced
        .flat_map(|word| word.split_whitespace().map(str::to_owned).collect::<Vec<_>>())
        .collect();
    (!words.is_empty()).then(|| HalCommand { words, place: place.clone() })
}

/// Replaces `[SECTION]KEY` and `[SECTION](KEY)` in a word.
fn substitute_ini_values(ini: &IniFile, word: &str) -> String {
    let Some((before, rest)) = word.split_once('[') else { return word.to_owned() };
    let Some((section, rest)) = rest.split_once(']') else { return word.to_owned() };
    let (key, after) = match rest.strip_prefix('(').and_then(|rest| rest.split_once(')')) {
        Some(both) => both,
        None => {
            let end = rest
                .find(|character: char| !character.is_ascii_alphanumeric() && character != '_')
                .unwrap_or(rest.len());
            rest.split_at(end)
        }
    };
    match ini.value(section, key) {
        Some(value) => format!("{before}{}{}", value.text, substitute_ini_values(ini, after)),
        None => word.to_owned(),
    }
}

/// Returns each pin's signal after these commands.
fn collect_links(commands: &[HalCommand]) -> BTreeMap<String, PinLink> {
    let mut links: BTreeMap<String, PinLink> = BTreeMap::new();
    for HalCommand { words, place } in commands {
        let link = |signal: &str| PinLink { signal: signal.to_owned(), place: place.clone() };
        let words: Vec<&str> =
            words.iter().map(String::as_str).filter(|word| !NET_ARROWS.contains(word)).collect();
        match &words[..] {
            ["net", signal, pins @ ..] => {
                links.extend(pins.iter().map(|pin| ((*pin).to_owned(), link(signal))));
            }
            ["linksp", signal, pin] | ["linkps", pin, signal] => {
                links.insert((*pin).to_owned(), link(signal));
            }
            ["linkpp", one, other] => {
                let signal =
                    links.get(*one).or_else(|| links.get(*other)).map(|link| link.signal.clone());
                // The name that `halcmd` gives.
                let signal = signal.unwrap_or_else(|| (*one).to_owned());
                links.extend([one, other].map(|pin| ((*pin).to_owned(), link(&signal))));
            }
            ["unlinkp", pin] => {
                links.remove(*pin);
            }
            ["delsig", "all"] => links.clear(),
            ["delsig", signal] => links.retain(|_, link| link.signal != *signal),
            _ => {}
        }
    }
    links
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a configuration in a folder that lives as long as it.
    pub(crate) fn configuration(
        files: &[(&str, &str)],
    ) -> (tempfile::TempDir, IniFile, Result<HalFiles, InputFileError>) {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).expect("writes");
        }
        let ini = IniFile::read(&folder.path().join(files[0].0)).expect("reads");
        let hal = HalFiles::read(&ini);
        (folder, ini, hal)
    }

    #[test]
    fn signals_follow_every_kind_of_link_and_are_taken_off_again() {
        let hal = "net a p1 => p2 \\\n  p3 # and more\nlinksp b p4\nlinkps p5 => b\nlinkpp p6 p7\n\
                   unlinkp p3\nnet a <= p8\ndelsig b\nsource more.hal\n";
        let (_folder, _, hal) = configuration(&[
            ("m.ini", "[HAL]\nHALFILE = m.hal\nHALCMD = net c p10\n"),
            ("m.hal", hal),
            ("more.hal", "net [W](NAME)-x p9\n"),
        ]);
        let hal = hal.expect("reads");
        let on = |pin: &str| hal.find_link(pin).map(|link| link.signal);
        let expected =
            [("p2", Some("a")), ("p3", None), ("p4", None), ("p7", Some("p6")), ("p8", Some("a"))];
        for (pin, signal) in expected {
            assert_eq!(on(pin).as_deref(), signal, "{pin}");
        }
        // A HALCMD line runs after all HAL files, and so after those of setup.
        assert_eq!(on("p10"), None);
        assert_eq!(hal.find_final_link("p10").map(|link| link.signal).as_deref(), Some("c"));
        assert_eq!(hal.find_late_reference("p10").map(|command| command.line), Some(3));
        assert_eq!(hal.find_link("p2").expect("linked").place.line, 1);
        assert!(on("p9").is_some(), "a sourced file counts");
    }

    #[test]
    fn the_order_of_a_thread_is_that_of_halcmd() {
        let hal = "addf motion-controller servo-thread\naddf late servo-thread\naddf first servo-thread 1\n\
                   addf other base-thread\naddf before-last servo-thread -2\naddf gone servo-thread\ndelf gone servo-thread\n";
        let (_folder, _, hal) =
            configuration(&[("m.ini", "[HAL]\nHALFILE = m.hal\n"), ("m.hal", hal)]);
        let (thread, functions) = hal.expect("reads").find_motion_thread().expect("one");
        assert_eq!(thread, "servo-thread");
        assert_eq!(functions, ["first", "motion-controller", "before-last", "late"]);
        let (_folder, _, hal) = configuration(&[
            ("m.ini", "[HAL]\nHALFILE = m.hal\n"),
            ("m.hal", "addf x servo-thread\n"),
        ]);
        assert_eq!(hal.expect("reads").find_motion_thread(), Err(ThreadOrderError(None)));
    }

    #[test]
    fn a_file_that_is_missing_has_the_place_of_its_line() {
        let (_folder, _, hal) = configuration(&[("m.ini", "[HAL]\nHALFILE = none.hal\n")]);
        let error = hal.expect_err("missing");
        assert_eq!((error.place.line, error.rule.contains("none.hal")), (2, true));
    }
}
