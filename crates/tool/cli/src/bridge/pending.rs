//! `trueup bridge pending`: the calibration that waits for the next start, shown, put to use or dropped.

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use trueup_client::{
    load,
    object::{self, NEW, NEW_CRC, QUALITY, RUNNING_CRC},
    port::Port as Line,
    session::Session,
};
use trueup_core::cnc::Quality;

use super::{Port, asks::Asks, who};
use crate::{Outcome, output};

#[derive(Args)]
pub struct Pending {
    #[command(flatten)]
    port: Port,
    /// Restart the board with it now.
    #[arg(long = "use", conflicts_with = "cancel")]
    takes: bool,
    /// Drop it: the board goes on with the calibration that it runs on, also after its next start.
    #[arg(long)]
    cancel: bool,
}

/// Shows what waits; with `--use` or `--cancel` nothing does any more.
pub fn run(args: &Pending, as_json: bool) -> Result<Outcome> {
    let mut session = Session::open(&Line::parse(&args.port.port)?)?;
    let done = settle(args, &mut session, as_json);
    session.close();
    done
}

fn settle(args: &Pending, session: &mut Session, as_json: bool) -> Result<Outcome> {
    let pending = object::number(session, NEW_CRC)?;
    let mut running = object::number(session, RUNNING_CRC)?;
    let crc = |crc: u32| (crc != 0).then(|| format!("{crc:08x}"));
    let mut outcome = Outcome::Done;
    let (mut changes, mut asks) = (None, None);
    let done = if pending == 0 {
        "nothing"
    } else if args.cancel {
        load::drop_pending(session)?;
        "cancelled"
    } else if args.takes {
        let quality = u8::try_from(object::number(session, QUALITY)?).ok();
        let quality = quality.and_then(Quality::from_wire);
        if !matches!(quality, Some(Quality::Off | Quality::Fault)) {
            bail!("nothing changes while offsets are being followed: let the CNC disengage first");
        }
        running = load::restart_allowed(session, pending)?;
        let after = Asks::of(session)?;
        if running != pending || after.is_foreign() {
            outcome = Outcome::NotMet;
        }
        asks = Some(after);
        "used"
    } else {
        let blob = object::read(session, NEW, |_, _| ())?;
        changes = who::differences(session, &blob)?;
        "waits"
    };
    if as_json {
        output::print(json!({
            "pending_crc": crc(pending),
            "running_crc": crc(running),
            "done": done,
            "differences": changes,
            "asks": asks.as_ref().map(Asks::words),
        }))?;
        return Ok(outcome);
    }
    output::print(match (pending, done) {
        (0, _) => "no calibration waits for the next start".to_owned(),
        (_, "cancelled") => format!("{pending:08x} is dropped: the bridge stays on {running:08x}"),
        (_, "used") => format!("the bridge has restarted, and runs on {running:08x}"),
        _ => format!(
            "{pending:08x} waits for the next start; now the bridge runs on {running:08x}. \
             With --use it is used now, with --cancel it is dropped"
        ),
    })?;
    for change in changes.iter().flatten() {
        output::print(format_args!("  {change}"))?;
    }
    asks.map_or(Ok(()), |asks| asks.print())?;
    Ok(outcome)
}
