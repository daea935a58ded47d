//! Who is who: the calibration that a bridge runs on against another one, in words; versions that differ.

use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use trueup_client::{
    load,
    object::{self, SOFTWARE},
    session::Session,
};
use trueup_machine::show::changes::changes;
use trueup_store::calibration::decode;

use crate::report;

/// What differs between the calibration that the bridge runs on and `new`, a sentence each; `None`: it has
/// no valid one, or gives none that this tool understands.
pub fn differences(session: &mut Session, new: &[u8]) -> Result<Option<Vec<String>>> {
    let bar = bar("reading the bridge's calibration", 0);
    let old = load::running(session, |got, of| {
        if let Some(of) = of {
            bar.set_length(of.into());
        }
        bar.set_position(got as u64);
    });
    bar.finish_and_clear();
    let Some(old) = old? else { return Ok(None) };
    Ok(match (decode(&old), decode(new)) {
        (Ok(old), Ok(new)) => Some(changes(&old, &new)),
        _ => None,
    })
}

/// Says where the bridge's firmware is of another version than this tool.
pub fn compare_versions(session: &mut Session) -> Result<()> {
    let (tool, bridge) = (env!("CARGO_PKG_VERSION"), object::text(session, SOFTWARE)?);
    if bridge != tool {
        report::warn(format_args!(
            "the bridge's firmware is {bridge}, this tool {tool}: flash the image of this version, or use \
             the tool of that one"
        ));
    }
    Ok(())
}

/// A bar over so many bytes, on standard error.
pub fn bar(what: &'static str, bytes: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {bytes} of {total_bytes} {eta}");
    ProgressBar::with_draw_target(Some(bytes as u64), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
