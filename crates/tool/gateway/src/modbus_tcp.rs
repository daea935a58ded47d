//! Modbus TCP: a thread for each master.
//!
//! Any number up to `MAX_MASTERS` may read, one writes: the first whose block was used, until it is gone
//! or silent. A connection that says what is no request, or half of one for too long, is closed; the
//! others do not notice.

use std::{
    io::{self, Read as _, Write as _},
    net::{TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use trueup_modbus::{
    holding_block, input_block,
    server::{
        MAX_FRAME_BYTES, MBAP_PREFIX_LEN, RegisterStore, RegistersBusy, ResponseBuffer, Transport,
        handle_request,
    },
};

use crate::{bridge::SharedHub, hub::MasterId};

/// Masters at a time: as many as a small PLC has connections. One more is closed at once.
pub(crate) const MAX_MASTERS: usize = 16;
/// How long a connection waits before it looks whether it is to end.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// How long the rest of a request may take.
const REQUEST_READ_TIMEOUT: Duration = Duration::from_secs(1);
/// How long a master may take to take in an answer.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// The largest length that a header may give: unit and request.
const MAX_LENGTH_FIELD: usize = MAX_FRAME_BYTES - MBAP_PREFIX_LEN;

/// How many there are, and what they have been given.
#[derive(Clone, Debug, Default)]
pub struct MasterCounters {
    connected: Arc<AtomicUsize>,
    answers: Arc<AtomicU64>,
}

impl MasterCounters {
    /// Masters that are connected.
    #[must_use]
    pub fn connection_count(&self) -> usize {
        self.connected.load(Ordering::Relaxed)
    }

    /// Answers that were given, exceptions among them.
    #[must_use]
    pub fn response_count(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }
}

/// One master's view of the hub.
pub(crate) struct HubView<'a> {
    /// The hub.
    pub shared: &'a SharedHub,
    /// The master's number.
    pub master: MasterId,
}

impl RegisterStore for HubView<'_> {
    fn input_registers(&mut self) -> input_block::InputRegisters {
        self.shared.lock_hub().input_registers()
    }

    fn holding_registers(&mut self) -> holding_block::HoldingRegisters {
        self.shared.lock_hub().holding_registers()
    }

    fn write_holding_registers(
        &mut self,
        block: &holding_block::HoldingRegisters,
    ) -> Result<(), RegistersBusy> {
        let now = self.shared.now();
        self.shared.lock_hub().accept_block(now, self.master, block).map(drop)
    }
}

/// Serves masters, in threads of their own, until the end.
///
/// # Errors
/// The listener cannot be made non-blocking.
pub fn serve(shared: SharedHub, listener: TcpListener, unit: u8) -> io::Result<MasterCounters> {
    listener.set_nonblocking(true)?;
    let masters = MasterCounters::default();
    let all = masters.clone();
    thread::spawn(move || {
        let mut next = 0;
        while !shared.is_stop_requested() {
            let Ok((stream, _)) = listener.accept() else {
                thread::sleep(POLL_INTERVAL);
                continue;
            };
            if all.connected.fetch_add(1, Ordering::Relaxed) >= MAX_MASTERS {
                all.connected.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            next += 1;
            let (shared, all, master) = (shared.clone(), all.clone(), next);
            thread::spawn(move || {
                shared.lock_hub().register_master(shared.now(), master);
                // What breaks a connection concerns only its master.
                serve_master(&shared, stream, master, unit, &all.answers).ok();
                shared.lock_hub().unregister_master(master);
                all.connected.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
    Ok(masters)
}

fn serve_master(
    shared: &SharedHub,
    mut stream: TcpStream,
    master: MasterId,
    unit: u8,
    answers: &AtomicU64,
) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(POLL_INTERVAL))?;
    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
    let mut registers = HubView { shared, master };
    let mut response = ResponseBuffer::new();
    let (mut waiting, mut bytes) = (Vec::with_capacity(MAX_FRAME_BYTES), [0; MAX_FRAME_BYTES]);
    let mut since = Instant::now();
    while !shared.is_stop_requested() {
        match stream.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(length) => {
                if waiting.is_empty() {
                    since = Instant::now();
                }
                waiting.extend_from_slice(&bytes[..length]);
            }
            Err(error) if trueup_client::duplex_stream::is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
        while let Some(length) = frame_length(&waiting)? {
            let rest = waiting.split_off(length);
            if handle_request(Transport::Tcp, unit, &waiting, &mut registers, &mut response) {
                stream.write_all(&response)?;
                answers.fetch_add(1, Ordering::Relaxed);
            }
            waiting = rest;
            since = Instant::now();
        }
        if !waiting.is_empty() && since.elapsed() > REQUEST_READ_TIMEOUT {
            return Err(io::ErrorKind::TimedOut.into());
        }
    }
    Ok(())
}

/// Bytes of the first frame, once it is whole.
fn frame_length(bytes: &[u8]) -> io::Result<Option<usize>> {
    let &[_, _, a, b, high, low, ..] = bytes else { return Ok(None) };
    let length = usize::from(u16::from_be_bytes([high, low]));
    if (a, b) != (0, 0) || !(2..=MAX_LENGTH_FIELD).contains(&length) {
        return Err(io::ErrorKind::InvalidData.into());
    }
    Ok((bytes.len() >= MBAP_PREFIX_LEN + length).then_some(MBAP_PREFIX_LEN + length))
}

#[cfg(test)]
mod tests;
