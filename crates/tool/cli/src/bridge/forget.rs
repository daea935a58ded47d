//! `trueup bridge forget-reference`: declines the reference that is offered, or drops the one in force.

use anyhow::Result;
use clap::Args;
use serde_json::json;
use trueup_client::{load, port::Port as Line, reference::BridgeReference, session::Session};

use super::{Port, asks::Asks};
use crate::{Outcome, output};

#[derive(Args)]
pub struct Forget {
    #[command(flatten)]
    port: Port,
}

/// Drops the reference; errors then count from the calibration's own zero.
pub fn run(args: &Forget, as_json: bool) -> Result<Outcome> {
    let mut session = Session::open(&Line::parse(&args.port.port)?)?;
    let done = BridgeReference::ask(&mut session).and_then(|before| {
        load::forget_reference(&mut session)?;
        Ok((before, Asks::of(&mut session)?))
    });
    session.close();
    let (before, asks) = done?;
    if as_json {
        output::print(json!({ "forgotten": before.json(), "asks": asks.words() }))?;
        return Ok(Outcome::Done);
    }
    match before.value() {
        None => output::print("there was no reference; what was learned is dropped")?,
        Some(_) => {
            output::print(format_args!("dropped: {}", before.text()))?;
            output::print(
                "errors count from the calibration's own zero now: touch off a tool, or set Zero, before anything is cut",
            )?;
        }
    }
    asks.print()?;
    Ok(Outcome::Done)
}
