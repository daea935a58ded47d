//! Records and events of bridges on the server: what `trueup serve --mqtt` publishes at least once.
//!
//! | on the server | holds |
//! |---|---|
//! | stream `$MQTT_msgs`, subjects `$MQTT.msgs.trueup.NAME.SERIAL.record` and `.event` | records and events, on the disk; the oldest give way |
//! | stream `$MQTT_rmsgs` | retained states, on the disk without waiting for it: a publisher repeats them when it connects |
//!
//! The server's listener for MQTT puts each message that is published at least once into `$MQTT_msgs`, and acknowledges
//! it when the stream has it. As the listener makes this stream, it keeps what a subscriber with a session waits for, and
//! acknowledges all else unkept. Here it is made before the listener is there, with limits in the place of interest: then
//! an acknowledgement says that the record is on the disk, with or without a reader. A stream of another name on the
//! topics themselves would get copies that no acknowledgement waits for.

use std::{fmt, io, time::Duration};

use async_nats::jetstream::{
    consumer::{AckPolicy, pull},
    stream::{Config, DiscardPolicy, PersistenceMode, RetentionPolicy, StorageType},
};
use futures_util::StreamExt as _;
use tokio::time::timeout;

use super::{
    ConnectionSettings, MULTIPART_RESPONSE_TIMEOUT, REQUEST_TIMEOUT, connect_jetstream,
    create_runtime,
};

const MQTT_MESSAGE_STREAM: &str = "$MQTT_msgs";
const MQTT_RETAINED_STREAM: &str = "$MQTT_rmsgs";
/// In front of the subject of a message in [`MQTT_MESSAGE_STREAM`].
const MQTT_MESSAGE_SUBJECT_PREFIX: &str = "$MQTT.msgs.";
/// How long the reader of an output may pause.
const CONSUMER_INACTIVE_THRESHOLD: Duration = Duration::from_secs(3_600);
/// Nothing is sent a second time to a consumer that acknowledges nothing.
const CONNECTION_BROKEN_MESSAGE: &str = "the connection broke; begin again";
/// Messages that are requested at once.
const RECORD_BATCH_SIZE: usize = 500;

/// Makes the streams of the listener for MQTT, or gives them this limit.
///
/// # Errors
/// The server does not answer, or has no room for these bytes.
pub fn create_streams(access: &ConnectionSettings, max_bytes: i64) -> io::Result<()> {
    let failed = |stream: &str, error: &dyn fmt::Display| {
        io::Error::other(format!("{}: the stream {stream} cannot be made: {error}", access.url))
    };
    create_runtime()?.block_on(async {
        let context = connect_jetstream(access).await?;
        let made = context.create_or_update_stream(message_stream_config(max_bytes)).await;
        made.map_err(|error| failed(MQTT_MESSAGE_STREAM, &error))?;
        let made = context.get_or_create_stream(retained_stream_config()).await;
        made.map(|_| ()).map_err(|error| failed(MQTT_RETAINED_STREAM, &error))
    })
}

fn message_stream_config(max_bytes: i64) -> Config {
    Config {
        name: MQTT_MESSAGE_STREAM.into(),
        subjects: vec![format!("{MQTT_MESSAGE_SUBJECT_PREFIX}>")],
        storage: StorageType::File,
        retention: RetentionPolicy::Limits,
        discard: DiscardPolicy::Old,
        max_bytes,
        num_replicas: 1,
        ..Default::default()
    }
}

/// As the listener makes it, but not synchronised: a state that changes each second need not be waited for. It is not in memory,
/// since such a stream would be gone when the listener's server starts. Servers before 2.12 do synchronise it.
fn retained_stream_config() -> Config {
    Config {
        name: MQTT_RETAINED_STREAM.into(),
        subjects: vec!["$MQTT.rmsgs.>".into()],
        storage: StorageType::File,
        persist_mode: Some(PersistenceMode::Async),
        retention: RetentionPolicy::Limits,
        max_messages_per_subject: 1,
        num_replicas: 1,
        ..Default::default()
    }
}

/// Hands the topic and the payload of each message below `trueup/` to a function, the oldest first: all that are on the server
/// when this begins. A record that was sent twice is there twice. Returns how many messages have given way to newer ones.
///
/// # Errors
/// The server does not answer, keeps no records, or the connection breaks; or an error of the function.
pub fn read(
    access: &ConnectionSettings,
    receive: &mut dyn FnMut(&str, &[u8]) -> io::Result<()>,
) -> io::Result<u64> {
    let failed = |error: &dyn fmt::Display| {
        io::Error::other(format!("{}: the records cannot be read: {error}", access.url))
    };
    create_runtime()?.block_on(async {
        let context = connect_jetstream(access).await?;
        let stream = context.get_stream(MQTT_MESSAGE_STREAM).await.map_err(|error| {
            let why = format!(
                "{}: no records: {error}; trueup fleet server --mqtt HOST:PORT keeps them",
                access.url
            );
            io::Error::new(io::ErrorKind::NotFound, why)
        })?;
        let removed = stream.cached_info().state.first_sequence.saturating_sub(1);
        let config = pull::Config {
            filter_subject: format!("{MQTT_MESSAGE_SUBJECT_PREFIX}trueup.>"),
            ack_policy: AckPolicy::None,
            inactive_threshold: CONSUMER_INACTIVE_THRESHOLD,
            memory_storage: true,
            ..Default::default()
        };
        let consumer = stream.create_consumer(config).await.map_err(|error| failed(&error))?;
        let mut left = consumer.cached_info().num_pending;
        let mut next = 1;
        while left > 0 {
            let count = usize::try_from(left).unwrap_or(RECORD_BATCH_SIZE).min(RECORD_BATCH_SIZE);
            let requested =
                consumer.fetch().max_messages(count).expires(REQUEST_TIMEOUT).messages();
            let mut batch = timeout(MULTIPART_RESPONSE_TIMEOUT, requested)
                .await
                .map_err(|error| failed(&error))?
                .map_err(|error| failed(&error))?;
            // All of it before any is handed on: a function that waits for a reader would let the rest time out.
            let mut messages = Vec::with_capacity(count);
            while let Some(message) = timeout(MULTIPART_RESPONSE_TIMEOUT, batch.next())
                .await
                .map_err(|error| failed(&error))?
            {
                let message = message.map_err(|error| failed(&error))?;
                let number = message.info().map_err(|error| failed(&error))?.consumer_sequence;
                if number != next {
                    return Err(failed(&CONNECTION_BROKEN_MESSAGE));
                }
                next += 1;
                messages.push(message);
            }
            for message in &messages {
                receive(&mqtt_topic(&message.subject), &message.payload)?;
            }
            left = left.saturating_sub(messages.len() as u64);
            let info = consumer.get_info().await.map_err(|error| failed(&error))?;
            if info.delivered.consumer_sequence + 1 != next || messages.is_empty() {
                return Err(failed(&CONNECTION_BROKEN_MESSAGE));
            }
            // The oldest may have given way meanwhile.
            if info.num_pending == 0 {
                break;
            }
        }
        Ok(removed)
    })
}

/// Returns the topic of MQTT that the server has made this subject of.
fn mqtt_topic(subject: &str) -> String {
    let own = subject.strip_prefix(MQTT_MESSAGE_SUBJECT_PREFIX).unwrap_or(subject);
    let parts: Vec<String> = own.split("//").map(|part| part.replace('.', "/")).collect();
    parts.join(".")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_is_the_topic_that_it_was_made_of() {
        assert_eq!(
            mqtt_topic("$MQTT.msgs.trueup.mill-7.0000002a.record"),
            "trueup/mill-7/0000002a/record"
        );
        // The server writes a full stop as two strokes.
        assert_eq!(mqtt_topic("$MQTT.msgs.trueup.mill//7.event"), "trueup/mill.7/event");
    }

    #[test]
    fn records_are_kept_by_limits_and_states_wait_for_no_disk() {
        let records = message_stream_config(1 << 30);
        assert_eq!(records.retention, RetentionPolicy::Limits);
        assert_eq!((records.storage, records.max_bytes), (StorageType::File, 1 << 30));
        assert_eq!(records.persist_mode, None);
        let states = retained_stream_config();
        assert_eq!(
            (states.storage, states.persist_mode),
            (StorageType::File, Some(PersistenceMode::Async))
        );
    }
}
