//! Prints what a bridge sends for a second: `cargo run -p trueup-client --example listen -- tcp:127.0.0.1:7700`.
#![allow(clippy::print_stdout, reason = "an example prints")]

use std::{
    env,
    time::{Duration, Instant},
};

use trueup_client::{port::Port, session::Session};

fn main() -> anyhow::Result<()> {
    let name = env::args().nth(1).unwrap_or_else(|| "tcp:127.0.0.1:7700".into());
    let mut session = Session::open(&Port::parse(&name)?)?;
    let deadline = Instant::now() + Duration::from_secs(1);
    while let Some(event) = session.next_event(deadline)? {
        println!("{event:?}");
    }
    session.close();
    Ok(())
}
