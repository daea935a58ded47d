//! `trueup bridge pending`: the calibration that waits for the next start, shown, put to use or dropped.

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use trueup_client::{
    calibration_load,
    sdo_object::{self, PENDING_CALIBRATION, PENDING_CRC, QUALITY, RUNNING_CRC},
    session::Session,
};
use trueup_core::cnc::OffsetQuality;

use super::{PortArgs, bridge_identity, operator_questions::OpenQuestions};
use crate::{CommandOutcome, output};

#[derive(Args)]
pub struct PendingArgs {
    #[command(flatten)]
    port: PortArgs,
    /// Restart the board with it now.
    #[arg(long = "use", conflicts_with = "cancel")]
    takes: bool,
    /// Drop it: the board goes on with the calibration that it runs on, also after its next start.
    #[arg(long)]
    cancel: bool,
}

/// Shows what waits; with `--use` or `--cancel` nothing does any more.
pub fn run(args: &PendingArgs, as_json: bool) -> Result<CommandOutcome> {
    args.port.with_session(|session| resolve_pending_calibration(args, session, as_json))
}

fn resolve_pending_calibration(
    args: &PendingArgs,
    session: &mut Session,
    as_json: bool,
) -> Result<CommandOutcome> {
    let pending = sdo_object::read_number(session, PENDING_CRC)?;
    let mut running = sdo_object::read_number(session, RUNNING_CRC)?;
    let crc = |crc: u32| (crc != 0).then(|| format!("{crc:08x}"));
    let mut outcome = CommandOutcome::Done;
    let (mut changes, mut questions) = (None, None);
    let done = if pending == 0 {
        "nothing"
    } else if args.cancel {
        calibration_load::drop_pending_calibration(session)?;
        "cancelled"
    } else if args.takes {
        let quality = u8::try_from(sdo_object::read_number(session, QUALITY)?).ok();
        let quality = quality.and_then(OffsetQuality::from_wire);
        if !matches!(quality, Some(OffsetQuality::Off | OffsetQuality::Fault)) {
            bail!("nothing changes while offsets are being followed: let the CNC disengage first");
        }
        running = calibration_load::restart_with_permission(session, pending)?;
        let after = OpenQuestions::read(session)?;
        if running != pending || after.has_foreign_calibration() {
            outcome = CommandOutcome::NotMet;
        }
        questions = Some(after);
        "used"
    } else {
        let blob = sdo_object::read(session, PENDING_CALIBRATION, |_, _| ())?;
        changes = bridge_identity::describe_calibration_differences(session, &blob)?;
        "waits"
    };
    if as_json {
        output::print(json!({
            "pending_crc": crc(pending),
            "running_crc": crc(running),
            "done": done,
            "differences": changes,
            "asks": questions.as_ref().map(OpenQuestions::keywords),
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
    questions.map_or(Ok(()), |questions| questions.print())?;
    Ok(outcome)
}
