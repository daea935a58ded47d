//! A data block of an S7 CPU: the input block is written into it and the holding block read out of it
//! periodically; after a fault the connection is made again.
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
    holding_block,
    register_map::{HOLDING_LEN, WHOLE_HOLDING_LEN},
};

use crate::{
    backoff::Backoff, bridge::SharedHub, gateway_status::SharedPlcStatus, hub::MASTER_TIMEOUT,
};
use client::{CpuAddress, Error, S7Client};

/// Where the holding block begins in the data block, in bytes.
pub(crate) const HOLDING_OFFSET_BYTES: usize = 64;
/// Bytes of the holding block, and of one in a data block that ends without tool and conditions.
const HOLDING_BYTES: usize = 2 * WHOLE_HOLDING_LEN;
const SHORT_HOLDING_BYTES: usize = 2 * HOLDING_LEN;
/// The one master there is.
const MASTER_ID: u64 = 0;

/// Where the block is.
#[derive(Clone, Debug)]
pub struct BlockExchangeSettings {
    /// The CPU.
    pub place: CpuAddress,
    /// The number of the data block.
    pub db: u16,
    /// From one write to the next.
    pub period: Duration,
    /// Content of the block.
    pub mode: InputBlockContent,
}

/// Content that is written into the block.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InputBlockContent {
    /// The offsets.
    #[default]
    Offsets,
    /// The constant and the slope of each: the NCK multiplies by its own position.
    Slope,
}

/// Writes and reads until the end.
pub fn serve(shared: &SharedHub, target: &BlockExchangeSettings, end: &SharedPlcStatus) {
    if target.mode == InputBlockContent::Slope {
        shared.lock_hub().expect_slopes(shared.now());
    }
    let mut pause = Backoff::default();
    while !shared.is_stop_requested() {
        let why = match S7Client::connect(&target.place) {
            Ok(mut client) => {
                end.update(|end| (end.is_up, end.why) = (true, None));
                let (why, has_written) = exchange_blocks(shared, target, &mut client, end);
                if has_written {
                    pause = Backoff::default();
                }
                shared.lock_hub().unregister_master(MASTER_ID);
                why
            }
            Err(error) => Some(error),
        };
        let Some(why) = why else { return };
        end.update(|end| (end.is_up, end.why) = (false, Some(why.to_string())));
        pause.wait(shared);
    }
}

/// Writes and reads until something breaks; why, and whether anything was written. `None`: it is the
/// end.
fn exchange_blocks(
    shared: &SharedHub,
    target: &BlockExchangeSettings,
    client: &mut S7Client,
    end: &SharedPlcStatus,
) -> (Option<Error>, bool) {
    let mut has_written = false;
    let mut length = HOLDING_BYTES;
    let mut seen = BlockChangeDetector::default();
    let mut due = Instant::now();
    while !shared.is_stop_requested() {
        let started = Instant::now();
        let block = encode_input_block(shared, target.mode);
        if let Err(error) = client.write(target.db, 0, &block) {
            return (Some(error), has_written);
        }
        has_written = true;
        let took = started.elapsed().as_secs_f64() * 1e3;
        end.update(|end| {
            end.given += 1;
            end.longest_ms = end.longest_ms.max(took);
        });
        let mut read = [0; HOLDING_BYTES];
        let requested_at = Instant::now();
        match client.read(target.db, HOLDING_OFFSET_BYTES, &mut read[..length]) {
            Ok(()) => {}
            Err(Error::Item(_)) if length == HOLDING_BYTES => {
                length = SHORT_HOLDING_BYTES;
                continue;
            }
            Err(error) => return (Some(error), has_written),
        }
        let block = decode_registers(&read);
        // An answer that took long may be as old as its question: it is seen, and not sent on.
        if seen.detect_change(block) && requested_at.elapsed() <= MASTER_TIMEOUT {
            // There is no second master here, and what is refused is reported in the block.
            shared.lock_hub().accept_block(shared.now(), MASTER_ID, &block).ok();
        }
        due += target.period;
        match due.checked_duration_since(Instant::now()) {
            Some(rest) => thread::sleep(rest),
            // Late: skipped cycles are not made up for.
            None => due = Instant::now(),
        }
    }
    (None, has_written)
}

/// The block that was last read. Memory keeps a block long after the program that wrote it has stopped: only
/// a change counts as sent now.
#[derive(Default)]
struct BlockChangeDetector(Option<holding_block::HoldingRegisters>);

impl BlockChangeDetector {
    /// Returns whether the PLC has sent this since the last look: not at the first, and not what stands there.
    fn detect_change(&mut self, block: holding_block::HoldingRegisters) -> bool {
        self.0.replace(block).is_some_and(|before| before != block)
    }
}

/// Writes the present block once and reads it back.
///
/// # Errors
/// The CPU cannot be reached, has no such data block, or has not kept what was written.
pub fn write_and_verify(shared: &SharedHub, target: &BlockExchangeSettings) -> Result<(), Error> {
    let mut client = S7Client::connect(&target.place)?;
    let written = encode_input_block(shared, target.mode);
    client.write(target.db, 0, &written)?;
    let mut read = vec![0; written.len()];
    client.read(target.db, 0, &mut read)?;
    if read == written { Ok(()) } else { Err(Error::NotStored) }
}

/// Returns the present input block.
fn encode_input_block(shared: &SharedHub, mode: InputBlockContent) -> Vec<u8> {
    let hub = shared.lock_hub();
    match mode {
        InputBlockContent::Offsets => encode_registers(&hub.input_registers()),
        InputBlockContent::Slope => encode_registers(&hub.input_registers_with_slopes()),
    }
}

fn encode_registers(block: &[u16]) -> Vec<u8> {
    block.iter().flat_map(|word| word.to_be_bytes()).collect()
}

fn decode_registers(bytes: &[u8; HOLDING_BYTES]) -> holding_block::HoldingRegisters {
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
    use trueup_client::pinned_calibration::{CalibrationPolicy, PinnedCalibration};
    use trueup_modbus::holding_block::CncData;

    /// A data block of before tool and conditions ends at byte 97: what reads beyond it gets an error of its item.
    #[test]
    fn a_data_block_of_before_is_read_as_far_as_it_goes() {
        let block = |counter| {
            let registers = CncData::default().encode(counter);
            let bytes: Vec<u8> =
                registers.iter().flat_map(|register| register.to_be_bytes()).collect();
            [&[0xFF, 4, 1, 16][..], &bytes[..SHORT_HOLDING_BYTES]].concat()
        };
        let mut answers = vec![tpkt(CONFIRM), set_up(1, 240)];
        let exchanges = [vec![5, 0, 0, 0], block(1), block(2)];
        for (data, reference) in exchanges.into_iter().zip([2, 4, 6]) {
            answers.push(answer(reference, &[5, 1], &[0xFF]));
            answers.push(answer(reference + 1, &[4, 1], &data));
        }
        let shared = SharedHub::new(
            Arc::new(AtomicBool::new(false)),
            PinnedCalibration::new(CalibrationPolicy::Any),
        );
        let place = cpu(answers, 1_000);
        let target = BlockExchangeSettings {
            place,
            db: 900,
            period: Duration::from_millis(1),
            mode: InputBlockContent::Offsets,
        };
        let mut client = S7Client::connect(&target.place).expect("a CPU");
        // It goes at its end.
        let (why, has_written) =
            exchange_blocks(&shared, &target, &mut client, &SharedPlcStatus::default());
        assert!(has_written && matches!(why, Some(Error::Io(_))), "{why:?}");
        assert_eq!(shared.lock_hub().holding_registers(), CncData::default().encode(2));
    }

    #[test]
    fn what_a_stopped_program_has_left_in_the_block_is_no_sign_of_life() {
        let mut seen = BlockChangeDetector::default();
        let blocks = [7, 7, 7, 8, 8, 9].map(|counter| CncData::default().encode(counter));
        let new = blocks.map(|block| seen.detect_change(block));
        assert_eq!(new, [false, false, false, true, false, true]);
    }
}
