//! `trueup bridge load`: a calibration to the board, read back and put to use.

use std::{fs, path::Path};

use anyhow::{Context as _, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use trueup_client::{
    load::{self, Step},
    object::{self, NEW_CRC, QUALITY, RUNNING_CRC},
    port::Port,
    session::Session,
    words::quality_word,
};
use trueup_core::cnc::Quality;
use trueup_store::calibration::{decode, identity, whole};

use crate::{Outcome, UserError, output};

/// Loads the calibration in the file `from`; unless `keep_running`, the board then restarts with
/// it.
pub fn run(from: &Path, port: &str, keep_running: bool, as_json: bool) -> Result<Outcome> {
    let bad = |rule: String| UserError(format!("{}: {rule}", from.display()));
    let bytes = fs::read(from).map_err(|error| bad(format!("cannot be read: {error}")))?;
    decode(&bytes).map_err(|error| bad(error.to_string()))?;
    // What follows the blob is not part of it.
    let blob = whole(&bytes).map_err(|error| bad(error.to_string()))?;
    let crc = identity(blob);

    let mut session = Session::open(&Port::parse(port)?)?;
    let quality = object::number(&mut session, QUALITY)?;
    let quality = u8::try_from(quality).ok().and_then(Quality::from_wire);
    let quality = quality.context("the bridge sends an unknown quality")?;
    if !matches!(quality, Quality::Off | Quality::Fault) {
        bail!(
            "nothing is loaded while offsets are being followed (the bridge is {}): let the CNC \
             disengage first",
            quality_word(quality)
        );
    }

    let waiting = object::number(&mut session, NEW_CRC)?;
    if waiting != 0 && waiting != crc && waiting != object::number(&mut session, RUNNING_CRC)? {
        eprintln!(
            "warning: the calibration {waiting:08x} was loaded before and never used; this one takes \
             its place"
        );
    }

    let mut bar: Option<(Step, ProgressBar)> = None;
    let stored = load::store(&mut session, blob, crc, &mut |step, bytes| {
        if bar.as_ref().is_none_or(|(of, _)| *of != step) {
            let what = if step == Step::Sending { "loading" } else { "reading back" };
            if let Some((_, before)) = bar.replace((step, self::bar(what, blob.len()))) {
                before.finish_and_clear();
            }
        }
        if let Some((_, bar)) = &bar {
            bar.set_position(bytes as u64);
        }
    });
    if let Some((_, bar)) = bar {
        bar.finish_and_clear();
    }
    stored?;

    let mut running = object::number(&mut session, RUNNING_CRC)?;
    if !keep_running {
        running = load::restart(&mut session, crc)?;
    }
    session.close();
    let is_met = keep_running || running == crc;
    if as_json {
        output::print(json!({
            "bytes": blob.len(),
            "crc": format!("{crc:08x}"),
            "read_back_is_equal": true,
            "restarted": !keep_running,
            "running_crc": format!("{running:08x}"),
        }))?;
    } else {
        output::print(format_args!(
            "{} bytes stored and read back the same, CRC {crc:08x}",
            blob.len()
        ))?;
        output::print(match (keep_running, is_met) {
            (true, _) => format!("used from the next start; now the bridge runs on {running:08x}"),
            (false, true) => "the bridge has restarted and uses it".into(),
            (false, false) => format!("the bridge has restarted, but uses {running:08x}"),
        })?;
    }
    Ok(if is_met { Outcome::Done } else { Outcome::NotMet })
}

fn bar(what: &'static str, bytes: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {bytes} of {total_bytes} {eta}");
    ProgressBar::with_draw_target(Some(bytes as u64), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
