//! `trueup bridge load`: a calibration to the board, read back and put to use.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use trueup_client::{
    object::{self, NEW, NEW_CRC, QUALITY, RUNNING_CRC},
    port::Port,
    session::Session,
    words::quality_word,
};
use trueup_core::cnc::Quality;
use trueup_link::{
    frame::Frame,
    frames::{self, State},
    layout::NMT_ID,
    slcan::Event,
};
use trueup_store::calibration::{decode, identity, whole};

use crate::{Outcome, UserError, output};

/// NMT: node 1 restarts.
const RESET_NODE: [u8; 2] = [0x81, 1];
/// How long the bridge may take to send its first heartbeat after that.
const BOOT_TIMEOUT: Duration = Duration::from_secs(5);

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

    let bar = bar("loading", blob.len());
    object::write(&mut session, NEW, blob, |sent| bar.set_position(sent as u64))
        .context("the calibration is not loaded")?;
    bar.finish_and_clear();
    let bar = self::bar("reading back", blob.len());
    let back = object::read(&mut session, NEW, |got, _| bar.set_position(got as u64))?;
    bar.finish_and_clear();
    let stored_crc = object::number(&mut session, NEW_CRC)?;
    if back != blob || stored_crc != crc {
        bail!("what the bridge has stored is not what was sent; load it again");
    }

    let mut running = object::number(&mut session, RUNNING_CRC)?;
    if !keep_running {
        session.send(&Frame::new(NMT_ID, &RESET_NODE).context("a frame of two bytes")?)?;
        running = running_after_boot(&mut session, crc)?;
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

/// What the bridge runs on once it is up again: `wanted`, or another if it stays with that. A bridge
/// that is slow to hear of its restart still answers for the old one, so one answer is not believed.
fn running_after_boot(session: &mut Session, wanted: u32) -> Result<u32> {
    let deadline = Instant::now() + BOOT_TIMEOUT;
    loop {
        let told =
            wait_for_boot(session, deadline).and_then(|()| object::number(session, RUNNING_CRC));
        match told {
            Ok(running) if running == wanted || Instant::now() > deadline => return Ok(running),
            Err(error) if Instant::now() > deadline => return Err(error),
            _ => {}
        }
    }
}

/// Until the bridge is up again: an SLCAN channel has to be opened again.
fn wait_for_boot(session: &mut Session, deadline: Instant) -> Result<()> {
    // A board that stores or supervises takes up to 10 ms to hear of it.
    let restarts = Instant::now() + Duration::from_millis(50);
    while session.next_event(restarts)?.is_some() {}
    session.reopen().context("the bridge does not come back after its restart")?;
    while let Some(event) = session.next_event(deadline.max(restarts))? {
        let Event::Frame(frame) = event else { continue };
        if frames::decode_heartbeat(&frame).is_ok_and(|state| state != State::BootUp) {
            return Ok(());
        }
    }
    bail!("the bridge sends no heartbeat after its restart")
}

fn bar(what: &'static str, bytes: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {bytes} of {total_bytes} {eta}");
    ProgressBar::with_draw_target(Some(bytes as u64), ProgressDrawTarget::stderr())
        .with_style(style.expect("the template is a constant"))
        .with_message(what)
}
