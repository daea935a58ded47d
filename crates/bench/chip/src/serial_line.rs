//! A serial wire of the board, and the host at its other end.

use crate::simulation_time::TICKS_PER_SECOND;
use std::{
    collections::VecDeque,
    io::{ErrorKind, Read as _, Write as _},
    net::{TcpListener, TcpStream},
};

/// Parity of a character: the bit between its eight bits and its stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Parity {
    /// No parity bit.
    #[default]
    None,
    /// An even number of ones, parity bit included.
    Even,
}

/// A wire.
#[derive(Default)]
pub struct SerialLine {
    /// The host's speed.
    pub baud: f64,
    /// The host's parity.
    pub parity: Parity,
    /// The host's stop bits.
    pub stop_bits: u32,
    /// The pin that has to be high for what the board sends to reach it: port, pin.
    pub drive: Option<(usize, u32)>,
    /// Bytes from the board, each with its time.
    pub heard: Vec<(u64, u8)>,
    /// Bytes from the host, each with the time from which on it is due.
    pub to_board: VecDeque<(u64, u8)>,
    /// Where a client may be the host.
    pub port: Option<TcpListener>,
    client: Option<TcpStream>,
    /// Bytes not yet given to the client.
    owed: Vec<u8>,
}

/// A client is given what the board has sent when the line falls silent, and after this many bytes at the latest.
const MAX_CHUNK_BYTES: usize = 256;

impl SerialLine {
    /// Returns one that is driven all the time, with ten bits to a character.
    #[must_use]
    pub fn new(baud: f64) -> Self {
        Self { baud, stop_bits: 1, ..Self::default() }
    }

    /// Returns how long one of the host's characters takes, in ticks.
    #[must_use]
    pub fn character_ticks(&self) -> u64 {
        let bits = 9 + u32::from(self.parity != Parity::None) + self.stop_bits;
        (f64::from(bits) * TICKS_PER_SECOND as f64 / self.baud) as u64
    }

    pub(crate) fn push_byte_from_board(&mut self, now: u64, byte: u8) {
        self.heard.push((now, byte));
        if self.client.is_some() {
            self.owed.push(byte);
        }
        if self.owed.len() >= MAX_CHUNK_BYTES {
            self.flush_to_client();
        }
    }

    /// Gives the client what it is owed: nothing follows the last byte for now.
    pub(crate) fn flush_to_client(&mut self) {
        let owed = std::mem::take(&mut self.owed);
        if let Some(client) = &mut self.client
            && client.write_all(&owed).is_err()
        {
            self.client = None;
        }
    }

    pub(crate) fn next_host_byte_time(&self) -> Option<u64> {
        self.to_board.front().map(|byte| byte.0)
    }

    pub(crate) fn pop_host_byte(&mut self) -> Option<u8> {
        self.to_board.pop_front().map(|byte| byte.1)
    }

    /// Takes what the client at the port has sent; who has gone makes room for the next.
    pub(crate) fn receive_from_client(&mut self, now: u64) {
        let Some(port) = &self.port else { return };
        if self.client.is_none() {
            self.owed.clear();
            self.client = port.accept().ok().map(|(client, _)| {
                client.set_nonblocking(true).expect("a socket");
                client.set_nodelay(true).expect("a socket");
                client
            });
        }
        let mut buffer = [0; 256];
        match self.client.as_mut().map(|client| client.read(&mut buffer)) {
            Some(Ok(0)) => self.client = None,
            Some(Ok(len)) => self.to_board.extend(buffer[..len].iter().map(|byte| (now, *byte))),
            Some(Err(error)) if error.kind() != ErrorKind::WouldBlock => self.client = None,
            _ => {}
        }
    }
}
