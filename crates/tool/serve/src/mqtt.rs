//! The connection to the broker: state at most once, records at least once, births and deaths by the rules of Sparkplug.
//!
//! A connection that breaks is given up with all that was on its way. The next one has a new number, a new will and
//! an empty session, and begins with the births; records that were not acknowledged, or not long ago, go out again
//! with the same identifiers. So no state of the client library has to survive a connection.

mod connection;
mod primary_host;

use std::{
    collections::{HashMap, VecDeque},
    hash::{BuildHasher as _, RandomState},
    sync::atomic::Ordering,
    thread,
    time::{Duration, Instant},
};

use rumqttc::{Publish, QoS};

use self::{
    connection::{ConnectionEvent, MqttConnection},
    primary_host::PrimaryHost,
};
use crate::{
    broker::BrokerConfig,
    clock,
    shared_state::SharedState,
    sparkplug::{
        self,
        node::{EdgeNode, NodeStatistics},
    },
};

/// From one publication of values that have changed to the next.
const PUBLISH_PERIOD: Duration = Duration::from_secs(1);
/// The same where a word has changed: a fault, a quality, a calibration.
const MIN_STATE_PUBLISH_INTERVAL: Duration = Duration::from_millis(100);
/// From one look at what is to be sent to the next.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Records that wait for their acknowledgement at most.
const MAX_UNACKNOWLEDGED_RECORDS: usize = 64;
/// Minimum time between two requests of a host for all births.
const MIN_REBIRTH_INTERVAL: Duration = Duration::from_millis(500);
/// Births that are known again when they come back.
const MAX_REMEMBERED_BIRTHS: usize = 4_096;
/// Topics on which another publisher is reported at most.
const MAX_REPORTED_TOPICS: usize = 16;
/// How long the last messages may take.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);
/// The first and the longest pause before the next try.
const RECONNECT_DELAY_RANGE: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(1)];
/// A connection that lasted so long was a good one: the pauses begin anew.
const STABLE_CONNECTION_TIME: Duration = Duration::from_secs(10);

/// Who publishes.
pub struct MqttPublisherConfig {
    /// The broker.
    pub broker: BrokerConfig,
    /// The name of the edge node.
    pub name: String,
    /// An identifier that no other publisher has.
    pub id: String,
    /// The host application without which nothing is published.
    pub primary_host: Option<String>,
    /// Keeps the number of the last connection.
    pub keep_bd_seq: Box<dyn Fn(u8) + Send>,
    /// Reports something to people.
    pub report: Box<dyn Fn(&str) + Send>,
}

/// Publishes until the end.
pub fn run(shared: &SharedState, publisher: &MqttPublisherConfig, node: &mut EdgeNode) {
    let mut pause = RECONNECT_DELAY_RANGE[0];
    let mut reported = None;
    while !shared.is_stop_requested() {
        let began = Instant::now();
        let why = run_connection(shared, publisher, node, &mut reported);
        shared.counts().is_online.store(false, Ordering::Relaxed);
        if shared.is_stop_requested() {
            return;
        }
        shared.lock_spool().rewind();
        if reported.as_ref() != Some(&why) {
            (publisher.report)(&format!("the broker is not connected: {why}; it is tried again"));
            reported = Some(why);
        }
        pause = if began.elapsed() > STABLE_CONNECTION_TIME {
            RECONNECT_DELAY_RANGE[0]
        } else {
            RECONNECT_DELAY_RANGE[1].min(2 * pause)
        };
        let until = Instant::now() + pause;
        while Instant::now() < until && !shared.is_stop_requested() {
            thread::sleep(POLL_INTERVAL);
        }
    }
}

/// One connection; returns why it ended.
fn run_connection(
    shared: &SharedState,
    publisher: &MqttPublisherConfig,
    node: &mut EdgeNode,
    reported: &mut Option<String>,
) -> String {
    (publisher.keep_bd_seq)(node.begin_connection());
    let will = node.build_death_message(clock::now_ms());
    let mut connection = MqttConnection::open(&publisher.broker, &publisher.id, &will);
    let mut link = BrokerSession {
        shared,
        publisher,
        host: publisher.primary_host.as_ref().map(|_| PrimaryHost::new()),
        open: HashMap::new(),
        is_born: false,
        is_birth_requested: false,
        born_at: None,
        published_at: Instant::now(),
        looked_at: Instant::now(),
        sent: VecDeque::new(),
        hasher: RandomState::new(),
        others: Vec::new(),
    };
    loop {
        for happened in connection.wait_for_events(POLL_INTERVAL) {
            match happened {
                ConnectionEvent::Accepted => {
                    link.subscribe_topics(&connection);
                    link.is_birth_requested = link.host.is_none();
                    if reported.take().is_some() {
                        (publisher.report)("the broker is connected again");
                    }
                }
                ConnectionEvent::Sent { id, number } => drop(link.open.insert(id, number)),
                ConnectionEvent::Acknowledged(id) => link.record_acknowledgement(id),
                ConnectionEvent::MessageReceived(message) => link.handle_message(&message),
                ConnectionEvent::Ended(why) => return why,
            }
        }
        let is_lost = link.host.as_ref().is_some_and(|host| !host.is_online()) && link.is_born;
        if is_lost || shared.is_stop_requested() {
            let death = node.build_death_message(clock::now_ms());
            connection.publish(&death.topic, death.payload, false);
            connection.disconnect(SHUTDOWN_TIMEOUT);
            return "the primary host application is offline".into();
        }
        link.publish_due_messages(&mut connection, node);
    }
}

/// A connection that the broker has accepted.
struct BrokerSession<'a> {
    shared: &'a SharedState,
    publisher: &'a MqttPublisherConfig,
    host: Option<PrimaryHost>,
    /// The numbers of the records that are on their way, by their packet identifier.
    open: HashMap<u16, u64>,
    is_born: bool,
    is_birth_requested: bool,
    born_at: Option<Instant>,
    published_at: Instant,
    looked_at: Instant,
    /// Hashes of the last births of this connection: the broker sends them back.
    sent: VecDeque<u64>,
    hasher: RandomState,
    /// Topics on which another publisher was reported.
    others: Vec<String>,
}

impl BrokerSession<'_> {
    fn subscribe_topics(&self, connection: &MqttConnection) {
        let name = &self.publisher.name;
        connection.subscribe(&sparkplug::topic("NCMD", name, None), QoS::AtLeastOnce);
        connection.subscribe(&sparkplug::topic("NBIRTH", name, None), QoS::AtMostOnce);
        for bridge in self.shared.snapshots() {
            if let Some(serial) = bridge.identity.serial {
                let device = sparkplug::device_id(serial);
                let topic = sparkplug::topic("DBIRTH", "+", Some(&device));
                connection.subscribe(&topic, QoS::AtMostOnce);
            }
        }
        if let Some(host) = &self.publisher.primary_host {
            connection.subscribe(&sparkplug::state_topic(host), QoS::AtLeastOnce);
        }
    }

    fn record_acknowledgement(&mut self, id: u16) {
        if let Some(number) = self.open.remove(&id) {
            self.shared.lock_spool().acknowledge(number, Instant::now());
            self.shared.counts().acknowledged.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Takes a message of the broker. It may hold anything.
    fn handle_message(&mut self, message: &Publish) {
        let topic = message.topic.as_str();
        let is_state =
            self.publisher.primary_host.as_deref().map(sparkplug::state_topic).as_deref()
                == Some(topic);
        if is_state && let Some(host) = &mut self.host {
            let is_state = host.update_state(&message.payload).is_some();
            self.is_birth_requested |= host.is_online() && !self.is_born;
            if !is_state {
                self.count_malformed_message(topic);
            }
        } else if topic == sparkplug::topic("NCMD", &self.publisher.name, None) {
            match sparkplug::is_rebirth_command(&message.payload) {
                Some(is_requested) => self.is_birth_requested |= is_requested && self.is_born,
                None => self.count_malformed_message(topic),
            }
        } else if topic.contains("BIRTH/") {
            self.report_duplicate_publisher(topic, &message.payload);
        }
    }

    fn report_duplicate_publisher(&mut self, topic: &str, payload: &[u8]) {
        let is_own = self.sent.contains(&self.hasher.hash_one((topic, payload)));
        let is_reported = self.others.iter().any(|other| other == topic);
        if is_own || is_reported || self.others.len() >= MAX_REPORTED_TOPICS {
            return;
        }
        self.others.push(topic.to_owned());
        (self.publisher.report)(&format!(
            "warning: another publisher publishes as {topic}: hosts see both in turn; give each \
             edge node a --name of its own, and each bridge one publisher"
        ));
    }

    fn count_malformed_message(&self, topic: &str) {
        if self.shared.counts().hostile.fetch_add(1, Ordering::Relaxed) == 0 {
            (self.publisher.report)(&format!(
                "warning: a message on {topic} is no payload of Sparkplug; it is ignored, and \
                 counted from now on"
            ));
        }
    }

    /// Publishes what is due.
    fn publish_due_messages(&mut self, connection: &mut MqttConnection, node: &mut EdgeNode) {
        let now = Instant::now();
        let may_be_born = self.born_at.is_none_or(|at| now - at >= MIN_REBIRTH_INTERVAL);
        if self.is_birth_requested && may_be_born {
            let messages = node.build_rebirth_messages(
                self.node_statistics(),
                &self.shared.snapshots(),
                clock::now_ms(),
            );
            (self.is_born, self.is_birth_requested, self.born_at) = (true, false, Some(now));
            (self.published_at, self.looked_at) = (now, now);
            self.send_messages(connection, messages);
            self.shared.counts().is_online.store(true, Ordering::Relaxed);
        } else if self.is_born && now - self.looked_at >= MIN_STATE_PUBLISH_INTERVAL {
            self.looked_at = now;
            let bridges = self.shared.snapshots();
            let is_due = now - self.published_at >= PUBLISH_PERIOD;
            if is_due || node.has_state_change(&bridges) {
                self.published_at = now;
                let messages = node.update(self.node_statistics(), &bridges, clock::now_ms());
                self.send_messages(connection, messages);
            }
            if is_due {
                self.shared.lock_spool().settle(now);
            }
        }
        while self.is_born
            && self.open.len() + connection.unsent_request_count() < MAX_UNACKNOWLEDGED_RECORDS
        {
            let Some(record) = self.shared.lock_spool().next_unsent_record(now) else { break };
            let number = record.number;
            if !connection.publish_record(record) {
                self.shared.lock_spool().requeue(number);
                break;
            }
        }
    }

    fn send_messages(
        &mut self,
        connection: &mut MqttConnection,
        messages: Vec<sparkplug::node::MqttMessage>,
    ) {
        for message in messages {
            if message.topic.contains("BIRTH/") {
                let hash = (message.topic.as_str(), message.payload.as_slice());
                self.sent.push_back(self.hasher.hash_one(hash));
                if self.sent.len() > MAX_REMEMBERED_BIRTHS {
                    self.sent.pop_front();
                }
                if message.topic.contains("DBIRTH/")
                    && let Some((_, device)) = message.topic.rsplit_once('/')
                {
                    let all = sparkplug::topic("DBIRTH", "+", Some(device));
                    connection.subscribe(&all, QoS::AtMostOnce);
                }
            }
            connection.publish(&message.topic, message.payload, message.is_retained);
        }
    }

    fn node_statistics(&self) -> NodeStatistics {
        let counts = self.shared.counts();
        let lost = counts.lost.load(Ordering::Relaxed);
        NodeStatistics {
            recorded: counts.recorded.load(Ordering::Relaxed),
            waiting: self.shared.lock_spool().unacknowledged_count() as u64,
            lost: lost + counts.not_recorded.load(Ordering::Relaxed),
        }
    }
}
