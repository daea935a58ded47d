//! `trueup fleet records`: records and events of bridges on a NATS server, as lines of JSON.

use std::{
    collections::{BTreeMap, HashMap},
    io,
    path::PathBuf,
};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};
use trueup_fleet::nats::records;
use trueup_serve::sparkplug::payload_to_json;

use super::location::resolve_server_connection;
use crate::{CommandOutcome, UserError, output, report};

/// Prints the records and events that bridges have published to the server, the oldest first, each once: a line of JSON
/// each.
///
/// `trueup serve --mqtt` publishes them, `trueup fleet server --mqtt` keeps them. It ends with the newest one.
#[derive(Args)]
pub struct RecordsArgs {
    /// The NATS server, nats://HOST:PORT or tls://HOST:PORT. Name and password: TRUEUP_NATS_USER and
    /// TRUEUP_NATS_PASSWORD.
    #[arg(long, value_name = "URL")]
    nats: String,
    /// The certificate of the authority that the server's certificate is of, in PEM.
    #[arg(long, value_name = "CA.pem")]
    nats_ca: Option<PathBuf>,
}

pub fn run(args: &RecordsArgs) -> Result<CommandOutcome> {
    let access = resolve_server_connection(&args.nats, args.nats_ca.as_deref())?;
    let (mut known, mut foreign) = (PrintedRecords::default(), 0_u64);
    let mut failed = None;
    let read = records::read(&access, &mut |topic: &str, payload: &[u8]| {
        let Some(mut record) = payload_to_json(payload) else {
            foreign += 1;
            return Ok(());
        };
        if parse_record_id(&record).is_some_and(|(file, number)| !known.insert(file, number)) {
            return Ok(());
        }
        record["topic"] = json!(topic);
        output::print(record).map_err(|error| {
            failed = Some(error);
            io::Error::other("the output")
        })
    });
    // An output that has an end of its own, as that of `head`, is no fault of the server.
    if let Some(error) = failed {
        return Err(error);
    }
    let removed = read.map_err(|error| UserError(error.to_string()))?;
    if removed > 0 {
        report::print_warning(format_args!(
            "the {removed} oldest messages have given way: fleet server --records-gb keeps more"
        ));
    }
    if foreign > 0 {
        report::print_warning(format_args!(
            "{foreign} messages are no payload of Sparkplug and are skipped"
        ));
    }
    Ok(CommandOutcome::Done)
}

/// The records that were printed: by file of a spool the first and the last number of each row of them. Millions take little
/// memory, since the numbers of a file come in order.
#[derive(Default)]
struct PrintedRecords(HashMap<u64, BTreeMap<u64, u64>>);

impl PrintedRecords {
    /// Returns whether this record is a new one.
    fn insert(&mut self, file: u64, number: u64) -> bool {
        let rows = self.0.entry(file).or_default();
        let before = rows.range(..=number).next_back().map(|(first, last)| (*first, *last));
        if before.is_some_and(|(_, last)| number <= last) {
            return false;
        }
        let follows = before.filter(|(_, last)| number - last == 1);
        let first = follows.map_or(number, |(first, _)| first);
        let last = number.checked_add(1).and_then(|next| rows.remove(&next)).unwrap_or(number);
        rows.insert(first, last);
        true
    }
}

/// Returns the two numbers of the identifier of a record.
fn parse_record_id(record: &Value) -> Option<(u64, u64)> {
    let (file, number) = record["id"].as_str()?.split_once('-')?;
    Some((u64::from_str_radix(file, 16).ok()?, number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_record_is_new_once_in_whatever_order() {
        let mut known = PrintedRecords::default();
        let numbers = [1, 2, 5, 4, 3, 2, 6, 1, u64::MAX, 7, 5, u64::MAX, 0];
        let is_new = numbers.map(|numbers| known.insert(255, numbers));
        let expected = [1, 1, 1, 1, 1, 0, 1, 0, 1, 1, 0, 0, 1].map(|bit| bit == 1);
        assert_eq!(is_new, expected);
        assert_eq!(known.0[&255], BTreeMap::from([(0, 7), (u64::MAX, u64::MAX)]));
        assert!(known.insert(254, 1), "of another file");
    }

    #[test]
    fn a_record_that_came_twice_has_one_identifier() {
        let id = |text: &str| parse_record_id(&json!({ "id": text }));
        assert_eq!(id("00000000000000ff-12"), Some((255, 12)));
        assert_ne!(id("00000000000000ff-12"), id("00000000000000fe-12"));
        assert_eq!(id("of another program"), None);
    }
}
