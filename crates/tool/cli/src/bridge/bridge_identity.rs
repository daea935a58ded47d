//! Who is who: the calibration that a bridge runs on against another one, in words; firmware and tool that are not of the same source.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_client::{build::BuildVersion, calibration_load, session::Session};
use trueup_machine::decompile::calibration_changes::describe_changes;
use trueup_store::calibration::decode;

use crate::report;

/// Returns what differs between the calibration that the bridge runs on and `new`, a sentence each; `None`: it has
/// no valid one, or gives none that this tool understands.
pub fn describe_calibration_differences(
    session: &mut Session,
    new: &[u8],
) -> Result<Option<Vec<String>>> {
    Ok(compare_with_running_calibration(session, new)?.1)
}

/// The calibration that a bridge runs on, and what differs from it.
pub type RunningCalibrationComparison = (Option<Vec<u8>>, Option<Vec<String>>);

/// Returns the same, and the calibration that the bridge runs on.
pub fn compare_with_running_calibration(
    session: &mut Session,
    new: &[u8],
) -> Result<RunningCalibrationComparison> {
    let bar = create_byte_progress_bar("reading the bridge's calibration", 0);
    let old = calibration_load::read_running_calibration(session, |got, of| {
        if let Some(of) = of {
            bar.set_length(of.into());
        }
        bar.set_position(got as u64);
    });
    bar.finish_and_clear();
    let Some(old) = old? else { return Ok((None, None)) };
    let differences = match (decode(&old), decode(new)) {
        (Ok(old), Ok(new)) => Some(describe_changes(&old, &new)),
        _ => None,
    };
    Ok((Some(old), differences))
}

/// This tool's.
pub fn tool_build_version() -> BuildVersion {
    BuildVersion::new(env!("CARGO_PKG_VERSION"), env!("TRUEUP_COMMIT"))
}

/// Says where the bridge's firmware is of another version or commit than this tool. Gives the firmware's.
pub fn read_and_check_firmware_build(session: &mut Session) -> Result<BuildVersion> {
    let bridge = BuildVersion::read(session)?;
    if let Some(difference) = tool_build_version().describe_difference(&bridge) {
        report::print_warning(difference);
    }
    Ok(bridge)
}

/// Returns a bar over this many bytes, on standard error.
pub fn create_byte_progress_bar(what: &'static str, bytes: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {bytes} of {total_bytes} {eta}");
    ProgressBar::with_draw_target(Some(bytes as u64), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
