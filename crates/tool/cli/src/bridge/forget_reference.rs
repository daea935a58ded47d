//! `trueup bridge forget-reference`: declines the reference that is offered, or drops the one in force.

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_client::{calibration_load, reference::BridgeReference};

use super::{PortArgs, operator_questions::OpenQuestions};
use crate::{CommandOutcome, output};

#[derive(Args)]
pub struct ForgetReferenceArgs {
    #[command(flatten)]
    port: PortArgs,
}

/// Drops the reference; errors then count from the calibration's own zero.
pub fn run(args: &ForgetReferenceArgs, as_json: bool) -> Result<CommandOutcome> {
    let (before, questions) = args.port.with_session(|session| {
        let before = BridgeReference::read(session)?;
        calibration_load::forget_reference(session)?;
        Ok((before, OpenQuestions::read(session)?))
    })?;
    if as_json {
        output::print(json!({ "forgotten": before.to_json(), "asks": questions.keywords() }))?;
        return Ok(CommandOutcome::Done);
    }
    match before.effective_value() {
        None => output::print("there was no reference; what was learned is dropped")?,
        Some(_) => {
            output::print(format_args!("dropped: {}", before.to_text()))?;
            output::print(
                "errors count from the calibration's own zero now: touch off a tool, or set Zero, before anything is cut",
            )?;
        }
    }
    questions.print()?;
    Ok(CommandOutcome::Done)
}
