//! `trueup bridge update`: a new firmware to the slot that does not run, checked before the board is touched, compared
//! with what it runs, confirmed by the user, sent, and started on trial.

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context as _, Result, anyhow, bail};
use clap::Args;
use serde_json::json;
use trueup_boot::{
    boot_state::ImageStatus, flash_layout::Slot, reject_reason::FirmwareRejectReason,
};
use trueup_client::{
    firmware_file::{FirmwareFile, MAX_FIRMWARE_READ_BYTES, SlotFirmware},
    firmware_slots::{FirmwareSlots, SlotChoiceReason, UnsuitableFirmwareError},
    firmware_transfer::{self, FirmwareRejectedError, TransferReport},
    port::PortAddress as Line,
    session::Session,
};

use super::{
    PortArgs, bridge_identity,
    load::{LoadMode, check_disengaged, confirm_with_user},
    operator_questions::OpenQuestions,
};
use crate::{CommandOutcome, UserError, input_files, output};

#[derive(Args)]
pub struct UpdateArgs {
    /// The firmware, signed for both slots, as a release has it.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    port: PortArgs,
    /// Update without asking: for scripts.
    #[arg(long)]
    yes: bool,
    /// Leave the board running on the firmware it has; the new one is used from its next start.
    #[arg(long)]
    keep_running: bool,
}

/// Set by Ctrl-C: the update ends behind the bytes that the board has.
static IS_INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// The result of an update.
struct UpdateOutcome {
    stored: TransferReport,
    /// The slots before, and now.
    slots: [FirmwareSlots; 2],
    /// The questions of the bridge to its operator now.
    questions: OpenQuestions,
}

/// Updates the board with the firmware of a file.
pub fn run(args: &UpdateArgs, as_json: bool) -> Result<CommandOutcome> {
    // What counts is what becomes of the board.
    trueup_output::enable_best_effort_output();
    let file = read_firmware_file(&args.file)?;
    let how = LoadMode { yes: args.yes, keep_running: args.keep_running };
    how.check_confirmation_possible(as_json)?;
    let port = Line::parse(&args.port.port)?;
    ctrlc::set_handler(|| IS_INTERRUPTED.store(true, Ordering::Relaxed))
        .context("signal handler")?;
    let updated = super::with_session(&port, |session| update_firmware(session, &file, how));
    let (firmware, updated) = updated.map_err(to_user_error)?;
    let slot = firmware.image.header.slot;
    let is_met = how.keep_running || updated.slots[1].running == slot;
    if as_json {
        output::print(updated.to_json(firmware, how))?;
    } else {
        updated.print(firmware, how)?;
    }
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Reads and checks a file.
fn read_firmware_file(path: &Path) -> Result<FirmwareFile, UserError> {
    let bytes = input_files::read_bytes(path, MAX_FIRMWARE_READ_BYTES)?;
    FirmwareFile::parse(&bytes).map_err(|error| UserError(format!("{}: {error}", path.display())))
}

/// An error that another file mends is one of the user's.
fn to_user_error(error: anyhow::Error) -> anyhow::Error {
    if let Some(unsuitable) = error.downcast_ref::<UnsuitableFirmwareError>() {
        return UserError(format!("nothing is erased: {unsuitable}")).into();
    }
    match error.downcast_ref::<FirmwareRejectedError>() {
        Some(refused) if refused.is_board_intact() => {
            UserError(format!("{refused}. What runs is as before")).into()
        }
        _ => error,
    }
}

/// Shows what goes where, requires confirmation, and updates.
fn update_firmware<'f>(
    session: &mut Session,
    file: &'f FirmwareFile,
    how: LoadMode,
) -> Result<(&'f SlotFirmware, UpdateOutcome)> {
    firmware_transfer::abort_open_transfer(session)?;
    check_disengaged(session)?;
    let Some(before) = FirmwareSlots::read(session)? else {
        bail!(UserError(format!(
            "nothing is erased: {}. trueup firmware writes the images that this tool carries",
            FirmwareRejectReason::NoSlots
        )));
    };
    let firmware = before.select_firmware_for_spare_slot(file)?;
    let header = firmware.image.header;
    for slot in Slot::ALL {
        let runs = if slot == before.running { " (runs)" } else { "" };
        let content = before.slot_info(slot);
        trueup_output::write_diagnostic(format_args!("slot {}: {content}{runs}", slot.name()));
    }
    trueup_output::write_diagnostic(format_args!(
        "{} ({} bytes) goes to slot {}, which is erased; slot {} stays as it is, to go back to",
        header.version,
        header.length,
        header.slot.name(),
        before.running.name()
    ));
    if header.floor > before.floor {
        trueup_output::write_diagnostic(format_args!(
            "once it is confirmed, no version below {} may start any more",
            header.floor
        ));
    }
    if !how.yes && !confirm_with_user("Update it? [y/N] ")? {
        bail!(UserError("not updated: you did not confirm".into()));
    }
    let bar = bridge_identity::create_byte_progress_bar("updating", header.length as usize);
    let stored = firmware_transfer::store_firmware(session, firmware, &mut |bytes| {
        bar.set_position(bytes.into());
        match IS_INTERRUPTED.load(Ordering::Relaxed) {
            true => Err(anyhow!("you have stopped it")),
            false => Ok(()),
        }
    });
    bar.finish_and_clear();
    let stored = stored?;
    let now = match how.keep_running {
        true => FirmwareSlots::read(session)?.unwrap_or(before),
        false => firmware_transfer::restart(session, header.slot)
            .context("the firmware is on the board, and starts next")?,
    };
    let questions = OpenQuestions::read(session)?;
    Ok((firmware, UpdateOutcome { stored, slots: [before, now], questions }))
}

impl UpdateOutcome {
    fn to_json(&self, firmware: &SlotFirmware, how: LoadMode) -> serde_json::Value {
        let header = firmware.image.header;
        let [before, now] = &self.slots;
        json!({
            "version": header.version.to_string(),
            "slot": header.slot.name(),
            "bytes": header.length,
            "resumed_from": self.stored.resumed_from,
            "restarted": !how.keep_running,
            "runs": now.running == header.slot,
            "slots_before": before.to_json(),
            "slots": now.to_json(),
            "asks": self.questions.keywords(),
        })
    }

    fn print(&self, firmware: &SlotFirmware, how: LoadMode) -> Result<()> {
        let header = firmware.image.header;
        let (version, slot) = (header.version, header.slot.name());
        let resumed = match self.stored.resumed_from {
            0 => String::new(),
            byte => format!(", the first {byte} of them by an earlier command"),
        };
        output::print(format_args!(
            "{} bytes in slot {slot}{resumed}; the board has verified CRC, SHA-256 and signature",
            header.length
        ))?;
        let [_, now] = &self.slots;
        let (running, content) = (now.running.name(), now.slot_info(now.running));
        let target = now.slot_info(header.slot);
        output::print(match (how.keep_running, now.running == header.slot) {
            (true, _) => format!(
                "{version} is used from the next start; now the bridge runs from slot {running}: {content}"
            ),
            (false, true) => self.confirmation_instructions(),
            (false, false) => {
                let why = match target.status {
                    Some(ImageStatus::Rejected) => {
                        "it crashed, hung, or reset the board at its start"
                    }
                    Some(ImageStatus::Verified) => {
                        "it did not hold at the start, or the board has not restarted"
                    }
                    _ => "the boot program has skipped it",
                };
                format!(
                    "the bridge has restarted, and runs from slot {running} as before: {content}\n\
                     slot {slot}: {target}; {why}. Report it, with what trueup bridge info prints"
                )
            }
        })?;
        if how.keep_running { Ok(()) } else { self.questions.print() }
    }

    /// Returns what to do with a firmware that has started.
    fn confirmation_instructions(&self) -> String {
        let [_, now] = &self.slots;
        let (slot, other) = (now.running, now.running.other());
        let (content, back) = (now.slot_info(slot), now.slot_info(other));
        let begin =
            format!("the bridge has restarted, and runs from slot {}: {content}", slot.name());
        match now.choice_reason() {
            SlotChoiceReason::Trial(_) => format!(
                "{begin}\nengage, and let it give offsets for a minute: that confirms it. Until then a crash or a hang goes \
                 back to slot {}: {back}",
                other.name()
            ),
            choice => format!("{begin}\n{choice}"),
        }
    }
}
