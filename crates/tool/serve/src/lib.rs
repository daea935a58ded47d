//! Publishes the state of a bridge: `trueup serve`.
//!
//! ```text
//!  bridge ─► line ─► bridge ─► snapshot ─┬─► sparkplug ─► mqtt ─► broker
//!                                        │                 ▲
//!                                        ├─► rows, events ─► spool (on disk)
//!                                        └─► mtconnect ─► agents
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`mod@bridge`] | frames in, a snapshot out; reads the identity of the bridge, and writes nothing to it |
//! | [`snapshot`] | the state at one moment, the events between two |
//! | `metrics` | names, units and values: one list for all that is published |
//! | [`sparkplug`] | payloads and topics of Sparkplug B; births, deaths and numbers |
//! | [`spool`] | records on disk until the broker has them |
//! | [`broker`] | where the broker is: URL, TLS, password |
//! | [`mqtt`] | the connection, again and again |
//! | [`mtconnect`] | lines of SHDR for agents, and `Devices.xml` |
//! | [`recorder`] | rows and events, onto the disk |
//! | `identity` | the identity of a publisher |
//! | [`mod@publisher`] | all of it, from the beginning to the end |
//! | [`shared_state`] | what the threads share; the thread of the line |
//! | [`clock`] | the time of day, and whether it was set |
//!
//! The line is read in a thread that waits for no disk and no network. Records go out at least once and carry an
//! identifier; the state goes out at most once, and is right again with the next birth.

pub mod bridge;
pub mod broker;
pub mod clock;
pub(crate) mod metrics;
pub mod mqtt;
pub mod mtconnect;
pub mod publisher;
pub(crate) mod publisher_identity;
pub mod recorder;
pub mod shared_state;
pub mod snapshot;
pub mod sparkplug;
pub mod spool;
