//! The bridge for controls with a PLC: what it says goes into registers, what the PLC says comes out of
//! them.
//!
//! ```text
//!            ┌──────────── hub ────────────┐
//!  bridge ──►│ offsets, status ► input     │──► modbus: any number of masters read, one writes
//!     line   │                             │
//!  bridge ◄──│ frames ◄ cnc ◄ holding      │◄── s7: one data block of one CPU, written and read
//!            └─────────────────────────────┘
//! ```
//!
//! | module | does |
//! |---|---|
//! | [`hub`] | both blocks, with time as an argument: what is new, what is stale, whose block is taken |
//! | [`cnc`] | frames for the bridge from what the PLC says, no oftener than the bus permits |
//! | [`bridge`] | the thread that keeps the line to the bridge |
//! | [`modbus_tcp`] | Modbus TCP |
//! | [`modbus_rtu`] | Modbus RTU on a serial port |
//! | [`s7`] | ISO-on-TCP: the small client, and the loop that writes and reads the data block |
//! | [`gateway_status`] | how both ends are, as lines of JSON |
//! | [`journal`] | which of them are written: at most a megabyte a day |
//! | `backoff` | how long is waited before something is opened again |
//!
//! A gateway invents no life: an old offset never gets a new counter, and `Control` goes to the bridge
//! only when the PLC has sent a new block, and `Engage` only to a bridge on the pinned calibration. Whichever end dies, the other finds out by itself.

pub use trueup_client::pinned_calibration;

pub(crate) mod backoff;
pub mod bridge;
pub mod cnc;
pub mod gateway_status;
pub mod hub;
pub mod journal;
pub mod modbus_rtu;
pub mod modbus_tcp;
pub mod s7;
