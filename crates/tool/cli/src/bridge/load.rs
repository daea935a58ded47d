//! `trueup bridge load`: a calibration to the board, compared with what it runs on, confirmed by the user, read back and
//! put to use.

use std::{
    io::{IsTerminal as _, stdin},
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, anyhow, bail};
use clap::Args;
use indicatif::ProgressBar;
use serde_json::json;
use trueup_client::{
    calibration_load::{self, StoreStep},
    previous_calibration::PreviousCalibrationStore,
    reference::BridgeReference,
    sdo_object::{self, PENDING_CRC, QUALITY, RUNNING_CRC},
    session::Session,
    state_text::quality_name,
};
use trueup_core::cnc::OffsetQuality;
use trueup_machine::{
    InputFileError,
    check::{list_implausible_values, no_correction_warning},
    compile::decompile,
    envelope,
};
use trueup_store::calibration::{calibration_crc, decode, validate_blob};

use super::{PortArgs, bridge_identity, operator_questions::OpenQuestions};
use crate::{
    CommandOutcome, UserError, input_files, output, report, show::MAX_CALIBRATION_FILE_BYTES,
};

#[derive(Args)]
pub struct LoadArgs {
    /// The calibration, as `compile` writes it.
    #[arg(value_name = "CAL.bin", required_unless_present = "previous")]
    calibration: Option<PathBuf>,
    /// Load the calibration that the board ran on before, where this computer has loaded the present one.
    #[arg(long, conflicts_with = "calibration")]
    previous: bool,
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    how: LoadMode,
}

/// How a calibration is put to use.
#[derive(Args, Clone, Copy)]
pub struct LoadMode {
    /// Load without asking: for scripts.
    #[arg(long)]
    pub yes: bool,
    /// Leave the board running on the calibration it has; the new one is used from its next start.
    #[arg(long)]
    pub keep_running: bool,
}

impl LoadMode {
    /// Checks that the user can confirm, or need not.
    pub fn check_confirmation_possible(self, as_json: bool) -> Result<(), UserError> {
        if self.yes || !as_json && stdin().is_terminal() {
            return Ok(());
        }
        let rule = "there is no terminal on which to confirm the load; --yes loads it without confirmation";
        Err(UserError(rule.into()))
    }
}

/// The result of a load.
pub struct LoadOutcome {
    /// CRC of the calibration that was loaded.
    pub crc: u32,
    /// CRC of the one that the bridge runs on now.
    pub running: u32,
    /// The changes by it; `None`: the bridge ran on nothing that could be compared.
    pub differences: Option<Vec<String>>,
    /// The reference before and after.
    pub references: [BridgeReference; 2],
    /// The questions of the bridge to its operator now.
    pub questions: OpenQuestions,
}

impl LoadOutcome {
    /// The board runs on it, or is not to yet, and works for its machine.
    pub fn is_successful(&self, how: LoadMode) -> bool {
        how.keep_running || self.running == self.crc && !self.questions.has_foreign_calibration()
    }
}

/// Loads the calibration of a file.
pub fn run(args: &LoadArgs, as_json: bool) -> Result<CommandOutcome> {
    // What counts is what becomes of the board.
    trueup_output::enable_best_effort_output();
    let named = args.calibration.as_deref().map(read_calibration_file).transpose()?;
    args.how.check_confirmation_possible(as_json)?;
    let (loaded, blob) = args.port.with_session(|session| {
        let blob = match named {
            Some(blob) => blob,
            None => read_calibration_file(&find_previous_calibration_file(session)?)?,
        };
        Ok((load_calibration(session, &blob, args.how)?, blob))
    })?;
    let is_met = loaded.is_successful(args.how);
    let LoadOutcome { crc, running, differences, references: [before, after], questions } = loaded;
    let keep_running = args.how.keep_running;
    if as_json {
        output::print(json!({
            "bytes": blob.len(),
            "crc": format!("{crc:08x}"),
            "differences": differences,
            "read_back_is_equal": true,
            "restarted": !keep_running,
            "running_crc": format!("{running:08x}"),
            "reference_before": before.to_json(),
            "reference": after.to_json(),
            "asks": questions.keywords(),
        }))?;
    } else {
        output::print(format_args!(
            "{} bytes stored and read back the same, CRC {crc:08x}",
            blob.len()
        ))?;
        output::print(match (keep_running, running == crc) {
            (true, _) => format!(
                "used from the next start (trueup bridge pending --cancel drops it); now the bridge runs on {running:08x}"
            ),
            (false, true) if questions.permits_offsets() => {
                "the bridge has restarted and uses it".into()
            }
            (false, true) => {
                "the bridge has restarted on it, and engages nothing until it is confirmed".into()
            }
            (false, false) => format!("the bridge has restarted, but uses {running:08x}"),
        })?;
        if !keep_running {
            output::print(format_args!("reference: {}", after.to_text()))?;
            questions.print()?;
        }
    }
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

/// Reads the calibration in a file, without what follows it.
fn read_calibration_file(path: &Path) -> Result<Vec<u8>> {
    let bad = |rule: String| UserError(format!("{}: {rule}", path.display()));
    let bytes = input_files::read_bytes(path, MAX_CALIBRATION_FILE_BYTES)?;
    let calibration = decode(&bytes).map_err(|error| bad(error.to_string()))?;
    let machine = decompile(&calibration);
    input_files::report_implausible_values(
        &path.display().to_string(),
        &list_implausible_values(&machine),
    )?;
    envelope::reject_limit_violations(&machine).map_err(|InputFileError { rule, .. }| bad(rule))?;
    if no_correction_warning(&machine).is_some() {
        report::print_warning(format_args!(
            "{}: corrects nothing: a board with it leaves every offset at 0",
            path.display()
        ));
    }
    Ok(validate_blob(&bytes).map_err(|error| bad(error.to_string()))?.to_vec())
}

/// Returns the file with the calibration that the bridge ran on before the present one.
fn find_previous_calibration_file(session: &mut Session) -> Result<PathBuf> {
    let running = sdo_object::read_number(session, RUNNING_CRC)?;
    let board = sdo_object::read_number(session, sdo_object::SERIAL_NUMBER)?;
    let place = PreviousCalibrationStore::for_board(board);
    if let Some(path) = place.as_ref().and_then(|place| place.find(running)) {
        return Ok(path);
    }
    let place =
        place.map_or("no folder for states".into(), |place| place.folder().display().to_string());
    bail!(UserError(format!(
        "this computer has no calibration that {running:08x} has replaced on this board \
         ({place}). It was loaded elsewhere, or is the board's first. trueup bridge info lists \
         what was loaded. Load its file, or a backup (trueup bridge restore)"
    )))
}

/// Keeps the calibration that was replaced. That it cannot be kept is no fault of the load.
fn store_previous_calibration(session: &mut Session, replaced: &[u8], by: u32) {
    let Ok(board) = sdo_object::read_number(session, sdo_object::SERIAL_NUMBER) else { return };
    let Some(place) = PreviousCalibrationStore::for_board(board) else { return };
    if let Err(error) = place.save(replaced, by) {
        report::print_warning(format_args!(
            "the previous calibration is not saved for --previous: {}: {error}",
            place.folder().display()
        ));
    }
}

/// Shows what `blob` changes, requires confirmation, and loads it; unless `keep_running`, the board then restarts with it.
pub fn load_calibration(session: &mut Session, blob: &[u8], how: LoadMode) -> Result<LoadOutcome> {
    let crc = calibration_crc(blob);
    check_disengaged(session)?;
    bridge_identity::read_and_check_firmware_build(session)?;
    let waiting = sdo_object::read_number(session, PENDING_CRC)?;
    if waiting != 0 && waiting != crc && waiting != sdo_object::read_number(session, RUNNING_CRC)? {
        report::print_warning(format_args!(
            "the calibration {waiting:08x} was loaded before and never used; this one takes its place"
        ));
    }
    let (replaced, differences) = bridge_identity::compare_with_running_calibration(session, blob)?;
    let before = BridgeReference::read(session)?;
    match &differences {
        None => trueup_output::write_diagnostic("the bridge has no calibration to compare with"),
        Some(all) if all.is_empty() => {
            trueup_output::write_diagnostic("the bridge runs on the same laws already")
        }
        Some(all) => {
            trueup_output::write_diagnostic("what changes:");
            all.iter()
                .for_each(|change| trueup_output::write_diagnostic(format_args!("  {change}")));
        }
    }
    if let Some(nm) = before.effective_value() {
        let largest = nm.into_iter().map(i32::unsigned_abs).max().unwrap_or_default();
        let moves = match before.offered {
            None => format!(
                "by this alone the offsets move by up to {:.2} µm",
                f64::from(largest) / 1_000.0
            ),
            Some(_) => "it was offered, and is not any more".into(),
        };
        trueup_output::write_diagnostic(format_args!(
            "the reference is dropped, for a calibration that is loaded starts without one:\n  {}\n  {moves}. If this \
             calibration had one of its own, the bridge offers that one",
            before.to_text()
        ));
    }
    if !how.yes && !confirm_with_user("Load it? [y/N] ")? {
        bail!(UserError("not loaded: you did not confirm".into()));
    }
    store_calibration(session, blob, crc)?;
    if let Some(replaced) = replaced {
        store_previous_calibration(session, &replaced, crc);
    }
    let running = match how.keep_running {
        true => sdo_object::read_number(session, RUNNING_CRC)?,
        false => match calibration_load::restart(session, crc) {
            Ok(running) if running != crc => {
                let waits = sdo_object::read_number(session, PENDING_CRC)? == crc;
                if waits {
                    let failed = anyhow!("the bridge has not restarted");
                    return Err(calibration_load::discard_failed_load(session, failed));
                }
                running
            }
            other => {
                other.map_err(|error| calibration_load::discard_failed_load(session, error))?
            }
        },
    };
    let after = BridgeReference::read(session)?;
    let questions = OpenQuestions::read(session)?;
    Ok(LoadOutcome { crc, running, differences, references: [before, after], questions })
}

/// Checks that no offset is being followed.
pub fn check_disengaged(session: &mut Session) -> Result<()> {
    let quality = sdo_object::read_number(session, QUALITY)?;
    let quality = u8::try_from(quality).ok().and_then(OffsetQuality::from_wire);
    let quality = quality.context("the bridge sends an unknown quality")?;
    if !matches!(quality, OffsetQuality::Off | OffsetQuality::Fault) {
        bail!(
            "nothing is loaded while offsets are being followed (the bridge is {}): let the CNC \
             disengage first",
            quality_name(quality)
        );
    }
    Ok(())
}

/// Requires a yes from the user.
pub fn confirm_with_user(question: &str) -> Result<bool> {
    trueup_output::write_prompt(question);
    let mut answer = String::new();
    stdin().read_line(&mut answer)?;
    Ok(matches!(answer.trim().to_ascii_lowercase().as_str(), "y" | "yes"))
}

fn store_calibration(session: &mut Session, blob: &[u8], crc: u32) -> Result<()> {
    let mut bar: Option<(StoreStep, ProgressBar)> = None;
    let stored = calibration_load::store_calibration(session, blob, crc, &mut |step, bytes| {
        if bar.as_ref().is_none_or(|(of, _)| *of != step) {
            let what = if step == StoreStep::Sending { "loading" } else { "reading back" };
            if let Some((_, before)) =
                bar.replace((step, bridge_identity::create_byte_progress_bar(what, blob.len())))
            {
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
    stored
}
