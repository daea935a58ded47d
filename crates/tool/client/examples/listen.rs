//! Prints what a bridge sends for a second: `cargo run -p trueup-client --example listen -- tcp:127.0.0.1:7700`.
#![allow(clippy::print_stdout, reason = "an example prints")]

use std::{
    env,
    time::{Duration, Instant},
};

use trueup_client::{port::PortAddress, session::Session};
use trueup_link::slcan::AdapterMessage;

/// Hands over each event of the bridge on `port` for this long.
pub fn listen(
    port: &str,
    duration: Duration,
    mut receive: impl FnMut(AdapterMessage),
) -> anyhow::Result<()> {
    let mut session = Session::open(&PortAddress::parse(port)?)?;
    let deadline = Instant::now() + duration;
    while let Some(event) = session.next_event(deadline)? {
        receive(event);
    }
    session.close();
    Ok(())
}

/// Prints the events of a second.
pub fn main() -> anyhow::Result<()> {
    let port = env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1:7700".into());
    listen(&port, Duration::from_secs(1), |event| println!("{event:?}"))
}
