//! A publisher with real parts around it: mosquitto or NATS, a Sparkplug host and an MTConnect agent that others wrote, and a
//! bridge that is the firmware's node. Each is killed in turn.
#![cfg(target_os = "linux")]
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a test says what it measured")]

mod bridge;
mod faults;
mod kills;
mod mtconnect;
mod nats;
mod parts;
mod scale;
mod sparkplug;
