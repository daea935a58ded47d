//! Modbus TCP: a thread for each master.
//!
//! Any number up to [`MAX`] may read, one writes: the first whose block was used, until it is gone
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
    cnc, input,
    server::{Bridge, Busy, HEADER_LEN, MAX_FRAME, Response, Transport, answer},
};

use crate::{bridge::Shared, hub::Master};

/// Masters at a time: as many as a small PLC has connections. One more is closed at once.
pub const MAX: usize = 16;
/// How long a connection waits before it looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);
/// How long the rest of a request may take.
const REST: Duration = Duration::from_secs(1);
/// How long a master may take to take in an answer.
const DEAF: Duration = Duration::from_secs(1);
/// The largest length that a header may give: unit and request.
const MAX_LENGTH: usize = MAX_FRAME - HEADER_LEN;

/// How many there are, and what they have been given.
#[derive(Clone, Debug, Default)]
pub struct Masters {
    connected: Arc<AtomicUsize>,
    answers: Arc<AtomicU64>,
}

impl Masters {
    /// Masters that are connected.
    #[must_use]
    pub fn connected(&self) -> usize {
        self.connected.load(Ordering::Relaxed)
    }

    /// Answers that were given, exceptions among them.
    #[must_use]
    pub fn answers(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }
}

/// One master's view of the hub.
pub struct Registers<'a> {
    /// The hub.
    pub shared: &'a Shared,
    /// The master's number.
    pub master: Master,
}

impl Bridge for Registers<'_> {
    fn input(&mut self) -> input::Registers {
        self.shared.hub().input()
    }

    fn holding(&mut self) -> cnc::Registers {
        self.shared.hub().holding()
    }

    fn take(&mut self, block: &cnc::Registers) -> Result<(), Busy> {
        let now = self.shared.now();
        self.shared.hub().take(now, self.master, block).map(drop)
    }
}

/// Serves masters, in threads of their own, until the end.
///
/// # Errors
/// The listener cannot be made non-blocking.
pub fn serve(shared: Shared, listener: TcpListener, unit: u8) -> io::Result<Masters> {
    listener.set_nonblocking(true)?;
    let masters = Masters::default();
    let all = masters.clone();
    thread::spawn(move || {
        let mut next = 0;
        while !shared.has_ended() {
            let Ok((stream, _)) = listener.accept() else {
                thread::sleep(LOOK);
                continue;
            };
            if all.connected.fetch_add(1, Ordering::Relaxed) >= MAX {
                all.connected.fetch_sub(1, Ordering::Relaxed);
                continue;
            }
            next += 1;
            let (shared, all, master) = (shared.clone(), all.clone(), next);
            thread::spawn(move || {
                shared.hub().join(shared.now(), master);
                // What breaks a connection concerns nobody but its master.
                serve_one(&shared, stream, master, unit, &all.answers).ok();
                shared.hub().leave(master);
                all.connected.fetch_sub(1, Ordering::Relaxed);
            });
        }
    });
    Ok(masters)
}

fn serve_one(
    shared: &Shared,
    mut stream: TcpStream,
    master: Master,
    unit: u8,
    answers: &AtomicU64,
) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(DEAF))?;
    let mut registers = Registers { shared, master };
    let mut response = Response::new();
    let (mut waiting, mut bytes) = (Vec::with_capacity(MAX_FRAME), [0; MAX_FRAME]);
    let mut since = Instant::now();
    while !shared.has_ended() {
        match stream.read(&mut bytes) {
            Ok(0) => return Ok(()),
            Ok(length) => {
                if waiting.is_empty() {
                    since = Instant::now();
                }
                waiting.extend_from_slice(&bytes[..length]);
            }
            Err(error) if trueup_client::ends::is_timeout(&error) => {}
            Err(error) => return Err(error),
        }
        while let Some(length) = frame_length(&waiting)? {
            let rest = waiting.split_off(length);
            if answer(Transport::Tcp, unit, &waiting, &mut registers, &mut response) {
                stream.write_all(&response)?;
                answers.fetch_add(1, Ordering::Relaxed);
            }
            waiting = rest;
            since = Instant::now();
        }
        if !waiting.is_empty() && since.elapsed() > REST {
            return Err(io::ErrorKind::TimedOut.into());
        }
    }
    Ok(())
}

/// Bytes of the first frame, once it is whole.
fn frame_length(bytes: &[u8]) -> io::Result<Option<usize>> {
    let &[_, _, a, b, high, low, ..] = bytes else { return Ok(None) };
    let length = usize::from(u16::from_be_bytes([high, low]));
    if (a, b) != (0, 0) || !(2..=MAX_LENGTH).contains(&length) {
        return Err(io::ErrorKind::InvalidData.into());
    }
    Ok((bytes.len() >= HEADER_LEN + length).then_some(HEADER_LEN + length))
}

#[cfg(test)]
mod tests;
