//! A data block of an S7 CPU: the input block is written into it, the holding block read out of it, so
//! many times a second; after a fault the connection is made again.
//!
//! ```text
//!  byte   0 … 55    input block, written by the gateway alone; in mode slope 0 … 63
//!        64 … 103   holding block, written by the PLC's program alone; without tool and conditions (older block) … 97
//! ```

pub mod client;

use std::{
    thread,
    time::{Duration, Instant},
};

use trueup_modbus::{
    cnc,
    table::{HOLDING_LEN, WHOLE_HOLDING_LEN},
};

use crate::{bridge::Shared, health::End, hub::MASTER_LASTS, pause::Pause};
use client::{Client, Error, Place};

/// Where the holding block begins in the data block, in bytes.
pub(crate) const HOLDING_AT: usize = 64;
/// Bytes of the holding block, and of one in a data block that ends without tool and conditions.
const HOLDING_BYTES: usize = 2 * WHOLE_HOLDING_LEN;
const SHORT_HOLDING_BYTES: usize = 2 * HOLDING_LEN;
/// The one master there is.
const PLC: u64 = 0;

/// Where the block is.
#[derive(Clone, Debug)]
pub struct Target {
    /// The CPU.
    pub place: Place,
    /// The number of the data block.
    pub db: u16,
    /// From one write to the next.
    pub period: Duration,
    /// Content of the block.
    pub mode: Mode,
}

/// Content that is written into the block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// The offsets.
    #[default]
    Offsets,
    /// The constant and the slope of each: the NCK multiplies by its own position.
    Slope,
}

/// Writes and reads until the end.
pub fn serve(shared: &Shared, target: &Target, end: &End) {
    if target.mode == Mode::Slope {
        shared.hub().expect_slopes(shared.now());
    }
    let mut pause = Pause::default();
    while !shared.has_ended() {
        let why = match Client::connect(&target.place) {
            Ok(mut client) => {
                end.change(|end| (end.is_up, end.why) = (true, None));
                let (why, has_written) = exchange(shared, target, &mut client, end);
                if has_written {
                    pause = Pause::default();
                }
                shared.hub().leave(PLC);
                why
            }
            Err(error) => Some(error),
        };
        let Some(why) = why else { return };
        end.change(|end| (end.is_up, end.why) = (false, Some(why.to_string())));
        pause.wait(shared);
    }
}

/// Writes and reads until something breaks; why, and whether anything was written. `None`: it is the
/// end.
fn exchange(
    shared: &Shared,
    target: &Target,
    client: &mut Client,
    end: &End,
) -> (Option<Error>, bool) {
    let mut has_written = false;
    let mut length = HOLDING_BYTES;
    let mut seen = Seen::default();
    let mut due = Instant::now();
    while !shared.has_ended() {
        let started = Instant::now();
        let block = input(shared, target.mode);
        if let Err(error) = client.write(target.db, 0, &block) {
            return (Some(error), has_written);
        }
        has_written = true;
        let took = started.elapsed().as_secs_f64() * 1e3;
        end.change(|end| {
            end.given += 1;
            end.longest_ms = end.longest_ms.max(took);
        });
        let mut read = [0; HOLDING_BYTES];
        let asked = Instant::now();
        match client.read(target.db, HOLDING_AT, &mut read[..length]) {
            Ok(()) => {}
            Err(Error::Item(_)) if length == HOLDING_BYTES => {
                length = SHORT_HOLDING_BYTES;
                continue;
            }
            Err(error) => return (Some(error), has_written),
        }
        let block = registers(&read);
        // An answer that took long may be as old as its question: it is seen, and not said.
        if seen.is_new(block) && asked.elapsed() <= MASTER_LASTS {
            // There is no second master here, and what is refused is reported in the block.
            shared.hub().take(shared.now(), PLC, &block).ok();
        }
        due += target.period;
        match due.checked_duration_since(Instant::now()) {
            Some(rest) => thread::sleep(rest),
            // Late: what was left out is not made up for.
            None => due = Instant::now(),
        }
    }
    (None, has_written)
}

/// The block that was last read. Memory keeps a block long after the program that wrote it has stopped: only
/// a change counts as said now.
#[derive(Default)]
struct Seen(Option<cnc::Registers>);

impl Seen {
    /// Returns whether the PLC has said this since the last look: not at the first, and not what stands there.
    fn is_new(&mut self, block: cnc::Registers) -> bool {
        self.0.replace(block).is_some_and(|before| before != block)
    }
}

/// Writes the present block once and reads it back.
///
/// # Errors
/// The CPU cannot be reached, has no such data block, or has not kept what was written.
pub fn once(shared: &Shared, target: &Target) -> Result<(), Error> {
    let mut client = Client::connect(&target.place)?;
    let written = input(shared, target.mode);
    client.write(target.db, 0, &written)?;
    let mut read = vec![0; written.len()];
    client.read(target.db, 0, &mut read)?;
    if read == written { Ok(()) } else { Err(Error::NotKept) }
}

/// Returns the present input block.
fn input(shared: &Shared, mode: Mode) -> Vec<u8> {
    let hub = shared.hub();
    match mode {
        Mode::Offsets => bytes(&hub.input()),
        Mode::Slope => bytes(&hub.input_with_slopes()),
    }
}

fn bytes(block: &[u16]) -> Vec<u8> {
    block.iter().flat_map(|word| word.to_be_bytes()).collect()
}

fn registers(bytes: &[u8; HOLDING_BYTES]) -> cnc::Registers {
    let mut block = [0; WHOLE_HOLDING_LEN];
    for (place, word) in block.iter_mut().zip(bytes.as_chunks::<2>().0) {
        *place = u16::from_be_bytes(*word);
    }
    block
}

#[cfg(test)]
mod tests {
    use super::{
        client::tests::{CONFIRM, answer, cpu, set_up, tpkt},
        *,
    };
    use std::sync::{Arc, atomic::AtomicBool};
    use trueup_client::pinned::{Pinned, Rule};
    use trueup_modbus::cnc::Cnc;

    /// A data block of before tool and conditions ends at byte 97: what reads beyond it gets an error of its item.
    #[test]
    fn a_data_block_of_before_is_read_as_far_as_it_goes() {
        let block = |counter| {
            let registers = Cnc::default().encode(counter);
            let bytes: Vec<u8> = registers.iter().flat_map(|it| it.to_be_bytes()).collect();
            [&[0xFF, 4, 1, 16][..], &bytes[..SHORT_HOLDING_BYTES]].concat()
        };
        let mut answers = vec![tpkt(CONFIRM), set_up(1, 240)];
        let exchanges = [vec![5, 0, 0, 0], block(1), block(2)];
        for (data, reference) in exchanges.into_iter().zip([2, 4, 6]) {
            answers.push(answer(reference, &[5, 1], &[0xFF]));
            answers.push(answer(reference + 1, &[4, 1], &data));
        }
        let shared = Shared::new(Arc::new(AtomicBool::new(false)), Pinned::new(Rule::Any));
        let place = cpu(answers, 1_000);
        let target =
            Target { place, db: 900, period: Duration::from_millis(1), mode: Mode::Offsets };
        let mut client = Client::connect(&target.place).expect("a CPU");
        // It goes at its end.
        let (why, has_written) = exchange(&shared, &target, &mut client, &End::default());
        assert!(has_written && matches!(why, Some(Error::Io(_))), "{why:?}");
        assert_eq!(shared.hub().holding(), Cnc::default().encode(2));
    }

    #[test]
    fn what_a_stopped_program_has_left_in_the_block_is_no_sign_of_life() {
        let mut seen = Seen::default();
        let blocks = [7, 7, 7, 8, 8, 9].map(|counter| Cnc::default().encode(counter));
        let new = blocks.map(|block| seen.is_new(block));
        assert_eq!(new, [false, false, false, true, false, true]);
    }
}
