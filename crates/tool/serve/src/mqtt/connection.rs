//! One connection of the client library: what goes out, and what happened, with the number of a record in place of the
//! library's packet identifier.

use std::{
    collections::VecDeque,
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use rumqttc::{Client, Event, LastWill, MqttOptions, Outgoing, Packet, Publish, QoS};

use crate::{broker::BrokerConfig, sparkplug::node::MqttMessage, spool::segment::SpoolRecord};

/// A broker that is silent for one and a half of these is given up, and gives this publisher up.
const MQTT_KEEP_ALIVE_PERIOD: Duration = Duration::from_secs(5);
/// A broker may take so long to accept a connection, or what is sent, in s.
const NETWORK_TIMEOUT_S: u64 = 15;
/// Requests that the library takes before it has sent them.
const REQUEST_QUEUE_CAPACITY: usize = 8_192;
/// Messages at least once that the library has on their way at most.
const MAX_INFLIGHT_MESSAGES: u16 = 256;
/// Maximum bytes of a message that comes, and of one that goes.
const MAX_PACKET_BYTES: [usize; 2] = [64 << 10, 2 << 20];

/// An event of the connection.
pub enum ConnectionEvent {
    /// The broker has accepted it.
    Accepted,
    /// A record was sent under this packet identifier.
    Sent {
        /// The packet identifier.
        id: u16,
        /// The number of the record.
        number: u64,
    },
    /// The broker has acknowledged the packet.
    Acknowledged(u16),
    /// A message came.
    MessageReceived(Publish),
    /// It is over; why.
    Ended(String),
}

/// A connection, from its beginning to its end.
pub(crate) struct MqttConnection {
    client: Client,
    events: Receiver<Result<Event, String>>,
    /// The records among the requests that the library has not sent; it sends them in order.
    requested: VecDeque<Option<u64>>,
}

impl MqttConnection {
    /// Begins a connection.
    pub fn open(broker: &BrokerConfig, id: &str, will: &MqttMessage) -> Self {
        let mut options = MqttOptions::new(id, broker.host.as_str(), broker.port);
        options
            .set_keep_alive(MQTT_KEEP_ALIVE_PERIOD)
            .set_clean_session(true)
            .set_inflight(MAX_INFLIGHT_MESSAGES);
        options.set_transport(broker.transport());
        let [incoming, outgoing] = MAX_PACKET_BYTES;
        options.set_max_packet_size(incoming, outgoing);
        let payload = will.payload.clone();
        options.set_last_will(LastWill::new(&will.topic, payload, QoS::AtLeastOnce, false));
        if let Some((user, password)) = &broker.login {
            options.set_credentials(user, password);
        }
        let (client, mut connection) = Client::new(options, REQUEST_QUEUE_CAPACITY);
        connection.eventloop.network_options.set_connection_timeout(NETWORK_TIMEOUT_S);
        let (sender, events) = mpsc::channel();
        thread::spawn(move || {
            for event in connection.iter() {
                let event = event.map_err(|error| error.to_string());
                let is_over = event.is_err();
                if sender.send(event).is_err() || is_over {
                    return;
                }
            }
        });
        Self { client, events, requested: VecDeque::new() }
    }

    /// Returns what has happened, after this time at the latest.
    pub(crate) fn wait_for_events(&mut self, time: Duration) -> Vec<ConnectionEvent> {
        let first = match self.events.recv_timeout(time) {
            Ok(first) => first,
            Err(RecvTimeoutError::Timeout) => return Vec::new(),
            Err(RecvTimeoutError::Disconnected) => {
                return vec![ConnectionEvent::Ended("it ended".into())];
            }
        };
        let events: Vec<_> = std::iter::once(first).chain(self.events.try_iter()).collect();
        events.into_iter().filter_map(|event| self.handle_event(event)).collect()
    }

    fn handle_event(&mut self, event: Result<Event, String>) -> Option<ConnectionEvent> {
        match event {
            Err(why) => Some(ConnectionEvent::Ended(why)),
            Ok(Event::Incoming(Packet::ConnAck(_))) => Some(ConnectionEvent::Accepted),
            Ok(Event::Incoming(Packet::PubAck(ack))) => {
                Some(ConnectionEvent::Acknowledged(ack.pkid))
            }
            Ok(Event::Incoming(Packet::Publish(message))) => {
                Some(ConnectionEvent::MessageReceived(message))
            }
            Ok(Event::Outgoing(Outgoing::Publish(id))) => {
                let number = self.requested.pop_front().flatten()?;
                Some(ConnectionEvent::Sent { id, number })
            }
            Ok(_) => None,
        }
    }

    /// Publishes at most once. A message that finds no place is dropped: the next one says something newer.
    pub fn publish(&mut self, topic: &str, payload: Vec<u8>, is_retained: bool) {
        if self.client.try_publish(topic, QoS::AtMostOnce, is_retained, payload).is_ok() {
            self.requested.push_back(None);
        }
    }

    /// Publishes at least once; false: there is no place.
    pub(crate) fn publish_record(&mut self, record: SpoolRecord) -> bool {
        let SpoolRecord { topic, payload, number, .. } = record;
        let is_taken = self.client.try_publish(topic, QoS::AtLeastOnce, false, payload).is_ok();
        if is_taken {
            self.requested.push_back(Some(number));
        }
        is_taken
    }

    /// Returns how many requests the library has not sent.
    pub(crate) fn unsent_request_count(&self) -> usize {
        self.requested.len()
    }

    /// Subscribes.
    pub(crate) fn subscribe(&self, topic: &str, qos: QoS) {
        // If there is no place the connection is about to end.
        self.client.try_subscribe(topic, qos).ok();
    }

    /// Ends the connection in order: the broker does not publish the will.
    pub(crate) fn disconnect(&mut self, within: Duration) {
        self.client.try_disconnect().ok();
        let until = Instant::now() + within;
        while let Some(left) = until.checked_duration_since(Instant::now()) {
            if self
                .wait_for_events(left)
                .iter()
                .any(|event| matches!(event, ConnectionEvent::Ended(_)))
            {
                return;
            }
        }
    }
}
