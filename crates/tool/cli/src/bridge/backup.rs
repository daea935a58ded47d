//! `trueup bridge save` and `restore`: all that a board holds, in one file ([`SavedBoard`]), and back into another
//! board.
//!
//! The calibration goes back whole, with its names. The reference that `Zero` has taken is offered to the operator,
//! who takes it by `Confirm`: the tools may have been touched off with another one since. The log of writes is a
//! board's own and stays in the file to be read. Where a reference cannot be offered (`--keep-running`; a firmware
//! in which none can be written) `restore` warns, and ends with 3, because offsets would count from another zero.

use std::{
    fs,
    io::{IsTerminal as _, stdin},
    path::{Path, PathBuf},
};

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use trueup_client::{
    calibration_load,
    reference::{BridgeReference, format_reference},
    saved_board::{BoardIdentity, SavedBoard},
    session::Session,
};
use trueup_store::calibration::decode;

use super::{
    PortArgs,
    load::{LoadMode, LoadOutcome, confirm_with_user, load_calibration},
};
use crate::{CommandOutcome, UserError, input_files, output, report};

/// No save file has more: a calibration of 16 KiB, twice in hexadecimal digits, and a log.
const MAX_BACKUP_BYTES: u64 = 1 << 20;

#[derive(Args)]
pub struct SaveArgs {
    /// The file to write.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Replace the file, also if it is another machine's backup or none at all.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    port: PortArgs,
}

#[derive(Args)]
pub struct RestoreArgs {
    /// The file that `save` wrote.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    port: PortArgs,
    #[command(flatten)]
    how: LoadMode,
}

/// Writes all that the bridge holds to a file.
pub fn run_save(args: &SaveArgs, as_json: bool) -> Result<CommandOutcome> {
    let saved = args
        .port
        .with_session(|session| save_backup(session, &args.file, args.overwrite, as_json))?;
    let crc = saved.calibration_crc();
    if as_json {
        output::print(
            json!({ "output": args.file.to_string_lossy(), "crc": format!("{crc:08x}") }),
        )?;
    } else {
        let owner = saved.board_identity();
        output::print(format_args!(
            "{}: calibration {crc:08x} of {}, {} bytes",
            args.file.display(),
            owner.to_text(),
            saved.calibration.len()
        ))?;
    }
    Ok(CommandOutcome::Done)
}

/// Saves a bridge to a file. A file that holds anything else than its backup is not replaced without a yes.
pub fn save_backup(
    session: &mut Session,
    file: &Path,
    overwrite: bool,
    as_json: bool,
) -> Result<SavedBoard> {
    if !overwrite
        && let Some(there) = describe_foreign_content(file, &BoardIdentity::read(session)?)
    {
        let rule = format!("{}: {there}", file.display());
        if as_json || !stdin().is_terminal() {
            bail!(UserError(format!("{rule}. Give another file, or --overwrite to replace it")));
        }
        if !confirm_with_user(&format!("{rule}. Replace it? [y/N] "))? {
            bail!(UserError("not saved: you did not confirm".into()));
        }
    }
    let bar = super::bridge_identity::create_byte_progress_bar("reading the calibration", 0);
    let saved = SavedBoard::read(session, |got, of| {
        bar.set_length(of.unwrap_or_default().into());
        bar.set_position(got as u64);
    });
    bar.finish_and_clear();
    let saved = saved?;
    let text = saved.to_text()?;
    output::write_atomically(file, &[], |out| out.write_all(text.as_bytes()))?;
    Ok(saved)
}

/// Returns what the file holds, unless it is nothing, or a backup of the same owner.
fn describe_foreign_content(file: &Path, owner: &BoardIdentity) -> Option<String> {
    if output::is_standard_output(file)
        || !fs::metadata(file).is_ok_and(|metadata| metadata.is_file())
    {
        return None;
    }
    let text = input_files::read_text(file, MAX_BACKUP_BYTES).unwrap_or_else(|_| "?".into());
    if text.is_empty() {
        return None;
    }
    match SavedBoard::parse(&text).map(|saved| saved.board_identity()) {
        Ok(there) if there.is_consistent_with(owner) => None,
        Ok(there) => Some(format!(
            "is the backup of {}; this bridge is of {}",
            there.to_text(),
            owner.to_text()
        )),
        Err(_) => Some("is there already, and is no backup of a bridge that can be read".into()),
    }
}

/// The result of a restore.
pub struct RestoreOutcome {
    /// Of its calibration.
    pub loaded: LoadOutcome,
    /// Of its reference; `None`: it has none.
    pub reference: Option<Result<BridgeReference, String>>,
}

impl RestoreOutcome {
    fn is_successful(&self, how: LoadMode) -> bool {
        self.loaded.is_successful(how) && !matches!(self.reference, Some(Err(_)))
    }
}

/// Reads a file that `save` wrote.
pub fn read_backup(file: &Path) -> Result<SavedBoard, UserError> {
    let bad = |rule: String| UserError(format!("{}: {rule}", file.display()));
    let text = input_files::read_text(file, MAX_BACKUP_BYTES)?;
    SavedBoard::parse(&text).map_err(bad)
}

/// Loads the calibration, and offers the reference.
pub fn restore_board(
    session: &mut Session,
    saved: &SavedBoard,
    how: LoadMode,
) -> Result<RestoreOutcome> {
    let mut loaded = load_calibration(session, &saved.calibration, how)?;
    let runs = !how.keep_running && loaded.running == loaded.crc;
    // It belongs to the calibration that it was taken with.
    let reference = saved.reference.map(|nm| match runs {
        true => {
            calibration_load::offer_reference(session, nm).map_err(|error| format!("{error:#}"))
        }
        false => Err("the board does not run on this calibration yet".into()),
    });
    if runs {
        loaded.questions = super::operator_questions::OpenQuestions::read(session)?;
    }
    Ok(RestoreOutcome { loaded, reference })
}

/// Gives a bridge what `save` has kept of another one.
pub fn run_restore(args: &RestoreArgs, as_json: bool) -> Result<CommandOutcome> {
    // What counts is what becomes of the board.
    trueup_output::enable_best_effort_output();
    let saved = read_backup(&args.file)?;
    let is_bound =
        decode(&saved.calibration).is_ok_and(|calibration| calibration.names.board != [0; 3]);
    if !saved.has_checksum() && saved.reference.is_some() {
        report::print_warning(format_args!(
            "{}: has no checksum (version 0.2 wrote it): look at the reference before you confirm it",
            args.file.display()
        ));
    }
    args.how.check_confirmation_possible(as_json)?;
    let restored = args.port.with_session(|session| restore_board(session, &saved, args.how))?;
    let is_met = restored.is_successful(args.how);
    let RestoreOutcome { loaded, reference } = restored;
    let mut notes = Vec::new();
    if is_bound {
        notes.push(
            "the calibration names a board: another board requires Confirm (foreign-machine)"
                .into(),
        );
    }
    match (saved.reference, &reference) {
        (Some(_), Some(Ok(now))) => notes.push(format!(
            "the reference that Zero had taken: {}. This board's converter is another one: touch off a tool before \
             anything is cut",
            now.to_text()
        )),
        (Some(nm), Some(Err(why))) => report::print_warning(format_args!(
            "the reference that Zero had taken is NOT on this board ({}): {why}. Its offsets \
             count from the calibration's own zero. Before anything is cut: bring the machine \
             into the state in which tools are touched off and home it. Then let the CNC set \
             Zero again (LinuxCNC: pin trueup.zero)",
            format_reference(nm)
        )),
        _ => {}
    }
    let crc = loaded.crc;
    if as_json {
        output::print(json!({
            "crc": format!("{crc:08x}"),
            "running_crc": format!("{:08x}", loaded.running),
            "reference": reference.as_ref().map(Result::is_ok),
            "asks": loaded.questions.keywords(),
            "notes": notes,
        }))?;
    } else {
        let bytes = saved.calibration.len();
        output::print(match (args.how.keep_running, loaded.running == crc) {
            (true, _) => format!(
                "calibration {crc:08x}, {bytes} bytes, stored for the next start; now the bridge runs on {:08x}",
                loaded.running
            ),
            (false, true) => format!("calibration {crc:08x}, {bytes} bytes, restored"),
            (false, false) => format!(
                "calibration {crc:08x}, {bytes} bytes, stored, but the bridge runs on {:08x}",
                loaded.running
            ),
        })?;
        notes.iter().try_for_each(output::print)?;
        loaded.questions.print()?;
    }
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}
