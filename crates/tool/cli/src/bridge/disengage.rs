//! `trueup bridge disengage`: takes the offsets back to 0, where no CNC commands the bridge.

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_client::{
    disengage::{DisengageOutcome, disengage},
    state_text::quality_name,
};

use super::PortArgs;
use crate::{CommandOutcome, output, report};

/// Nanometres in a micrometre.
const NM_PER_UM: f64 = 1_000.0;

#[derive(Args)]
pub struct DisengageArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Takes them back, and waits until they are 0.
pub fn run(args: &DisengageArgs, as_json: bool) -> Result<CommandOutcome> {
    trueup_output::enable_best_effort_output();
    let mut is_reported = false;
    let mut report_start = |now_nm| {
        if !is_reported {
            is_reported = true;
            trueup_output::write_diagnostic(format_args!(
                "the offset, {}, goes to 0 at the slew limit of the calibration",
                format_offsets(now_nm)
            ));
        }
    };
    let done = args.port.with_session(|session| disengage(session, &mut report_start))?;
    let (word, nm) = match done {
        DisengageOutcome::AtRest(_) => ("nothing", [Some(0); 3]),
        DisengageOutcome::Done { from_nm, .. } => ("disengaged", from_nm),
        DisengageOutcome::CncCommands(nm) => ("refused", nm),
        DisengageOutcome::Stalled(nm) => ("stands", nm),
    };
    if as_json {
        let um = nm.map(|nm| nm.map(|nm| f64::from(nm) / NM_PER_UM));
        output::print(json!({ "done": word, "offset_um": um }))?;
    } else {
        match done {
            DisengageOutcome::AtRest(quality) => output::print(format_args!(
                "nothing is engaged: the bridge is {}, no offset is given",
                quality_name(quality)
            ))?,
            DisengageOutcome::Done { from_nm, took } => output::print(format_args!(
                "disengaged: the offset went from {} to 0 in {:.1} s. A CNC that comes back engages by its own Engage",
                format_offsets(from_nm),
                took.as_secs_f64()
            ))?,
            DisengageOutcome::CncCommands(_) | DisengageOutcome::Stalled(_) => {}
        }
    }
    match done {
        DisengageOutcome::AtRest(_) | DisengageOutcome::Done { .. } => {
            return Ok(CommandOutcome::Done);
        }
        DisengageOutcome::CncCommands(nm) => report::print_warning(format_args!(
            "a CNC commands this bridge and follows its offset, {}: nothing was sent, for it \
             may be cutting. Disengage there. LinuxCNC: halcmd setp trueup.0.enable 0 (or the \
             signal on that pin). SINUMERIK: the input ENABLE of the block. Modbus: bit 0 of \
             Control. trueup virtual: type disengage where it runs",
            format_offsets(nm)
        )),
        DisengageOutcome::Stalled(nm) => report::print_warning(format_args!(
            "the offset, {}, does not go to 0: another line commands the bridge; disengage there",
            format_offsets(nm)
        )),
    }
    Ok(CommandOutcome::NotMet)
}

/// Returns the offsets in µm.
fn format_offsets(nm: [Option<i32>; 3]) -> String {
    let axes = ["x", "y", "z"].into_iter().zip(nm);
    let all = axes.map(|(axis, nm)| match nm {
        Some(nm) => format!("{axis} {:+.2}", f64::from(nm) / NM_PER_UM),
        None => format!("{axis} none"),
    });
    format!("{} µm", all.collect::<Vec<_>>().join(", "))
}
