//! Files of instruments and controls whose form no public source states: refused by name, with the form that would do.
//!
//! | file | looked for, and found |
//! |---|---|
//! | `.b5r`, `.b20` of a ball-bar | no public description, reader or file |
//! | `.rtx` of a laser (dynamic capture) | a public reader; it is a record over time, not over positions |
//! | log of a probing cycle of a HEIDENHAIN (`TCHPR….TXT`) | the manual of the cycles: one feature, no readings over positions |
//! | console of RepRapFirmware (`G30`) | its source: `Stopped at height …`, without the position |
//! | profile of Mach3 (XML), `Machine.ini` of Mach4 | the pages of the screw mapping: first position, length, points, the error at each; how a profile keeps them is stated nowhere |

use std::path::Path;

use trueup_machine::{InputFileError, Location};

/// Words in the head of a log of a probing cycle.
const CYCLE_LOG_TITLES: [&str; 2] = ["probing cycle", "antastzyklus"];

/// Returns why `path` with `bytes` is not read, where it is a file of this kind.
pub(crate) fn unsupported_format_error(bytes: &[u8], path: &Path) -> Option<InputFileError> {
    let ending = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]).to_lowercase();
    let is_xml = head.trim_start_matches('\u{feff}').trim_start().starts_with("<?xml");
    let is_profile = head.contains("<profile>") || head.contains("<preferences>");
    let stem =
        path.file_stem().map(|stem| stem.to_string_lossy().to_lowercase()).unwrap_or_default();
    let (rule, help) = match ending.as_deref() {
        Some("b5r" | "b20") => (
            "is a record of a ball-bar, whose form is not published",
            "a circle is no input of fit or diagnose. Backlash and pitch do: measure with `trueup program backlash` or `pitch`",
        ),
        Some("rtx") => (
            "is a dynamic capture of a laser, a record over time",
            "give the positions there and back: target data (.rtl), or a csv with target position, direction, run and error",
        ),
        _ if is_xml && is_profile => (
            "is a profile of Mach3, and where it keeps a screw table is not published",
            "type the screw map as csv: a row `position [mm];error [µm]`, below it a line for each point; the error is actual minus commanded",
        ),
        Some("ini") if head.contains("screwmap") || head.contains("[motor0]") => (
            "is a profile of Mach4, and how it keeps a screw map is not published",
            "type the screw map as csv: a row `position [mm];error [µm]`, below it a line for each point; the error is actual minus commanded",
        ),
        _ if head.matches("stopped at height").count() > 1 => (
            "is a console of RepRapFirmware, whose heights stand there without their positions",
            "probe a grid with G29 and give its heightmap.csv",
        ),
        _ if stem.starts_with("tchpr") => return Some(cycle_log_error(path)),
        _ if is_xml => (
            "is XML, and no form of it is read",
            "export the table as csv, tsv, txt, xlsx or ods: the first row names the columns, each row below is one reading",
        ),
        _ => return None,
    };
    Some(InputFileError::new(Location::start_of_file(path), rule).with_help(help))
}

/// Returns why a file without a table is not read, where its head is that of a log of a probing cycle. A table below
/// such a title is read, so this is called only where none was found.
pub(crate) fn detect_cycle_log(bytes: &[u8], path: &Path) -> Option<InputFileError> {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]).to_lowercase();
    CYCLE_LOG_TITLES.iter().any(|title| head.contains(title)).then(|| cycle_log_error(path))
}

fn cycle_log_error(path: &Path) -> InputFileError {
    let rule = "is the log of a single probing cycle, and no table";
    InputFileError::new(Location::start_of_file(path), rule).with_help(
        "let the control print a line for each reading (HEIDENHAIN: FN16, SINUMERIK: columns of the log): position and error, or target and actual position",
    )
}
