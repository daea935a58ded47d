//! `trueup bridge save` and `restore`: all that a board holds, in one file, and back into another board.
//!
//! The file is JSON. The calibration goes back whole, with its names, and so does the reference that `Zero` has
//! taken. The log of writes is a board's own and stays in the file to be read. Where a reference cannot go back
//! (`--keep-running`; a firmware before 0.2) `restore` warns, and ends with 3, because offsets would count from
//! another zero.

use std::{fs, path::PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use serde_json::{Value, json};
use trueup_client::{load, object, port::Port as Line, session::Session, writes};
use trueup_store::calibration::{decode, identity};

use super::{
    Port,
    load::{How, put},
};
use crate::{Outcome, UserError, output, report};

/// What the file says that it is.
const FORMAT: &str = "trueup-bridge-1";
/// What the file calls the parts of the reference.
const REFERENCE: [&str; 4] = ["elongation_nm", "x_nm", "y_nm", "z_nm"];

#[derive(Args)]
pub struct Save {
    /// The file to write.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    port: Port,
}

#[derive(Args)]
pub struct Restore {
    /// The file that `save` wrote.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    #[command(flatten)]
    port: Port,
    #[command(flatten)]
    how: How,
}

/// Writes all that the bridge holds to a file.
pub fn save(args: &Save, as_json: bool) -> Result<Outcome> {
    let mut session = Session::open(&Line::parse(&args.port.port)?)?;
    let text = |session: &mut Session, at| object::text(session, at).unwrap_or_default();
    let bar = super::who::bar("reading the calibration", 0);
    let calibration = load::running(&mut session, |got, of| {
        bar.set_length(of.unwrap_or_default().into());
        bar.set_position(got as u64);
    });
    bar.finish_and_clear();
    let Some(calibration) = calibration? else {
        bail!("the bridge has no valid calibration: there is nothing to save");
    };
    let crc = identity(&calibration);
    let new_crc = object::number(&mut session, object::NEW_CRC)?;
    let waiting = match new_crc {
        0 => None,
        it if it == crc => None,
        _ => Some(hex(&object::read(&mut session, object::NEW, |_, _| ())?)),
    };
    let mut reference = Value::Null;
    if object::number(&mut session, object::HAS_REFERENCE)? != 0 {
        reference = json!({});
        for (at, name) in object::REFERENCE.into_iter().zip(REFERENCE) {
            reference[name] = json!(object::number(&mut session, at)?.cast_signed());
        }
    }
    let log = object::read(&mut session, object::WRITES, |_, _| ()).unwrap_or_default();
    let all = json!({
        "format": FORMAT,
        "device": text(&mut session, object::NAME),
        "hardware": text(&mut session, object::HARDWARE),
        "software": text(&mut session, object::SOFTWARE),
        "machine": text(&mut session, object::MACHINE_NAME),
        "machine_serial": text(&mut session, object::MACHINE_SERIAL),
        "calibration_crc": format!("{crc:08x}"),
        "calibration": hex(&calibration),
        "calibration_for_the_next_start": waiting,
        "reference": reference,
        "writes": writes::writes(&log).iter().map(writes::json).collect::<Vec<_>>(),
    });
    session.close();
    let written = serde_json::to_string_pretty(&all)? + "\n";
    output::write_whole(&args.file, &[], |out| out.write_all(written.as_bytes()))?;
    if as_json {
        output::print(
            json!({ "output": args.file.to_string_lossy(), "crc": format!("{crc:08x}") }),
        )?;
    } else {
        let name = all["machine"].as_str().filter(|it| !it.is_empty()).unwrap_or("no name");
        output::print(format_args!(
            "{}: calibration {crc:08x} of \"{name}\", {} bytes",
            args.file.display(),
            calibration.len()
        ))?;
    }
    Ok(Outcome::Done)
}

/// Gives a bridge what `save` has kept of another one.
pub fn restore(args: &Restore, as_json: bool) -> Result<Outcome> {
    // What counts is what becomes of the board.
    trueup_output::best_effort();
    let bad = |rule: String| UserError(format!("{}: {rule}", args.file.display()));
    let text =
        fs::read_to_string(&args.file).map_err(|error| bad(format!("cannot be read: {error}")))?;
    let all: Value = serde_json::from_str(&text)
        .map_err(|error| bad(format!("is not what bridge save writes: {error}")))?;
    if all["format"] != FORMAT {
        return Err(bad(format!("is not what bridge save writes: format is not {FORMAT}")).into());
    }
    let blob = all["calibration"].as_str().and_then(bytes_of);
    let blob = blob.ok_or_else(|| bad("the calibration is not in hexadecimal digits".into()))?;
    let calibration = decode(&blob).map_err(|error| bad(error.to_string()))?;
    let crc = identity(&blob);
    if all["calibration_crc"] != format!("{crc:08x}") {
        return Err(bad("the calibration is not the one of its CRC".into()).into());
    }
    let reference = match &all["reference"] {
        Value::Null => None,
        parts => Some(
            reference_of(parts)
                .ok_or_else(|| bad("the reference is not four lengths in nm".into()))?,
        ),
    };
    let is_bound = calibration.names.board != [0; 3];

    args.how.can_ask(as_json)?;
    let mut session = Session::open(&Line::parse(&args.port.port)?)?;
    let loaded = put(&mut session, &blob, args.how);
    let runs = loaded.as_ref().is_ok_and(|loaded| !args.how.keep_running && loaded.running == crc);
    // It belongs to the calibration that it was taken with.
    let taken = match reference {
        Some(nm) if runs => {
            load::put_reference(&mut session, nm).map_err(|error| format!("{error:#}"))
        }
        Some(_) => Err("the board does not run on this calibration yet".into()),
        None => Ok(()),
    };
    session.close();
    let loaded = loaded?;
    let mut notes = Vec::new();
    if is_bound {
        notes.push(
            "the calibration names a board: another one asks for Confirm (foreign-machine)".into(),
        );
    }
    match (reference, &taken) {
        (Some(nm), Ok(())) => notes.push(format!(
            "the reference that Zero had taken is in force ({}); this board's converter is another one: touch off \
             a tool before anything is cut",
            in_micrometres(nm)
        )),
        (Some(nm), Err(why)) => report::warn(format_args!(
            "the reference that Zero had taken is NOT on this board ({}): {why}. Its offsets count from the \
             calibration's own zero. Before anything is cut: bring the machine into the state in which tools \
             are touched off, home it, and let the CNC set Zero again (LinuxCNC: pin trueup.zero)",
            in_micrometres(nm)
        )),
        (None, _) => {}
    }
    let is_used = args.how.keep_running || loaded.running == loaded.crc;
    let is_met = is_used && taken.is_ok();
    if as_json {
        output::print(json!({
            "crc": format!("{crc:08x}"),
            "running_crc": format!("{:08x}", loaded.running),
            "reference": reference.map(|_| taken.is_ok()),
            "notes": notes,
        }))?;
    } else {
        output::print(format_args!("calibration {crc:08x}, {} bytes, restored", blob.len()))?;
        notes.iter().try_for_each(output::print)?;
    }
    Ok(if is_met { Outcome::Done } else { Outcome::NotMet })
}

/// The parts of a reference, as the file has them.
fn reference_of(parts: &Value) -> Option<[i32; 4]> {
    let mut nm = [0; 4];
    for (place, name) in nm.iter_mut().zip(REFERENCE) {
        *place = parts[name].as_i64().and_then(|nm| i32::try_from(nm).ok())?;
    }
    Some(nm)
}

fn in_micrometres(reference: [i32; 4]) -> String {
    let parts = ["elongation", "X", "Y", "Z"].into_iter().zip(reference);
    let parts = parts.map(|(name, nm)| format!("{name} {:+.2} µm", f64::from(nm) / 1_000.0));
    parts.collect::<Vec<_>>().join(", ")
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn bytes_of(hex: &str) -> Option<Vec<u8>> {
    let (pairs, []) = hex.as_bytes().as_chunks::<2>() else { return None };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    pairs.iter().map(byte).collect()
}
