//! Waits for what the person at the CNC does: the bridge says when it is done.

use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use trueup_client::{port::PortAddress, session::Session};
use trueup_core::cnc::{OffsetQuality, Output};
use trueup_link::{receiver::OffsetReceiver, slcan::AdapterMessage};

use super::board_backup::check_interrupt;

/// Time to walk to the machine, set a gauge and come back.
const OPERATOR_TIMEOUT: Duration = Duration::from_secs(600);

/// How often Ctrl-C is looked for.
const INTERRUPT_POLL_PERIOD: Duration = Duration::from_millis(200);

/// Until the bridge's offsets are as required.
pub fn wait_for_output(port: &str, is_requested: impl Fn(&Output) -> bool) -> Result<()> {
    let mut session = Session::open(&PortAddress::parse(port)?)?;
    let deadline = Instant::now() + OPERATOR_TIMEOUT;
    let mut offsets = OffsetReceiver::new();
    while Instant::now() < deadline {
        check_interrupt()?;
        let event = session.next_event(Instant::now() + INTERRUPT_POLL_PERIOD)?;
        let Some(AdapterMessage::Frame(frame)) = event else { continue };
        if let Ok(Some(output)) = offsets.accept(&frame)
            && is_requested(&output)
        {
            session.close();
            return Ok(());
        }
    }
    session.close();
    bail!(
        "the bridge does not come to it in {} min; the same command goes on",
        OPERATOR_TIMEOUT.as_secs() / 60
    )
}

/// Until nothing is followed; `tell` once, if it has to be waited for.
pub fn wait_until_disengaged(port: &str, report: impl Fn()) -> Result<()> {
    let is_reported = std::cell::Cell::new(false);
    wait_for_output(port, |output| {
        let is_off = matches!(output.quality, OffsetQuality::Off | OffsetQuality::Fault);
        if !is_off && !is_reported.replace(true) {
            report();
        }
        is_off
    })
}
