//! A CANopen master by script: what it sends at which time, and what the board reports.

use crate::sdo_script::{download, questions as ask};

/// Returns the frames that load a blob into object 0x2100:02, and when the last was sent.
pub fn load(blob: &[u8], from_ms: f64) -> (String, f64) {
    download((0x2100, 2), blob, from_ms)
}

/// Returns what it runs on, what it has for the next start, and its state bits.
pub fn questions(from_ms: f64) -> String {
    ask(&[(0x2100, 3), (0x2100, 4), (0x2001, 6)], from_ms)
}

/// Reports of the board, with the times in ms.
#[derive(Default)]
pub struct Received {
    /// Answers of SDO.
    answers: Vec<(f64, [u8; 8])>,
    /// Codes of emergencies.
    pub emergencies: Vec<(f64, u16)>,
    pub offsets: Vec<f64>,
    /// The quality of each of them.
    pub qualities: Vec<u8>,
    pub resets: Vec<f64>,
}

impl Received {
    /// Of the model's events.
    pub fn of(events: &[String]) -> Self {
        let mut received = Self::default();
        for event in events {
            let mut words = event.split(' ');
            let time: f64 = words.next().and_then(|word| word.parse().ok()).expect("a time");
            match (words.next(), words.next(), words.next()) {
                (Some("reset"), ..) => received.resets.push(time),
                (Some("can"), Some("281"), Some(hex)) => {
                    received.offsets.push(time);
                    received.qualities.push(bytes(hex)[5] >> 4);
                }
                (Some("can"), Some("081"), Some(hex)) => {
                    let [low, high, ..] = bytes(hex);
                    received.emergencies.push((time, u16::from_le_bytes([low, high])));
                }
                (Some("can"), Some("581"), Some(hex)) => received.answers.push((time, bytes(hex))),
                _ => {}
            }
        }
        received
    }

    /// Returns the last value of an object of four bytes that was read after that time.
    pub fn object(&self, (index, subindex): (u16, u8), after: f64) -> Option<u32> {
        let [low, high] = index.to_le_bytes();
        let is_it = |(time, data): &&(f64, [u8; 8])| {
            *time > after && data[..4] == [0x43, low, high, subindex]
        };
        let (_, data) = self.answers.iter().rfind(is_it)?;
        Some(u32::from_le_bytes(*data.last_chunk().expect("eight bytes")))
    }

    /// Returns whether the last segment of a load was answered before that time: one answer to the first request, one
    /// to each of 88 segments.
    pub fn is_accepted(&self, before: f64) -> bool {
        let is_taken = |data: &[u8; 8]| data[0] == 0x60 || data[0] & 0xEF == 0x20;
        let taken = |(time, data): &&(f64, [u8; 8])| *time < before && is_taken(data);
        self.answers.iter().filter(taken).count() > 88
    }
}

fn bytes(hex: &str) -> [u8; 8] {
    std::array::from_fn(|n| {
        hex.get(2 * n..2 * n + 2)
            .and_then(|digits| u8::from_str_radix(digits, 16).ok())
            .unwrap_or(0)
    })
}
