//! Errors of a master on the RS-485 line of the flashable image, and a second master on it: the exception that
//! the standard names or no answer at all, and nothing moves. All times are the board's.

use anyhow::{Context as _, Result, ensure};
use trueup_core::cnc::{Control, OffsetQuality};
use trueup_emulator::{
    chip::ModelRunReport,
    plc_requests::{
        MODBUS_UNIT_ID, build_read_request_hex, build_read_request_pdu, build_write_request_hex,
        build_write_request_pdu, encode_hex, encode_rtu_frame,
    },
};
use trueup_link::status::StateBits;
use trueup_modbus::input_block::InputBlock;

use super::{
    blocks::offset,
    modbus::{FAST, sent_frame},
    support::{FAST_MACHINE, chip::Chip},
};

/// The offset stands from here on.
const SETTLED_MS: u32 = 620;
/// From a sign of life to the fault behind it: 43 bytes, the silence, 8 bytes.
const BEHIND_MS: u32 = 8;
/// The noise of the samples, and the rounding of the wire.
const STANDS: u32 = 10;

/// Something that a PLC should not send.
struct RequestFault {
    name: &'static str,
    bytes: Vec<u8>,
    /// Fault of its first byte at the UART, by the model's name for it; empty: none.
    line: &'static str,
    /// Here the line pauses, within what is to be one frame.
    pause_at: Option<usize>,
    /// The expected answer; `None`: nothing.
    answer: Option<Vec<u8>>,
}

impl RequestFault {
    fn with_exception(name: &'static str, pdu: &[u8], exception: u8) -> Self {
        let answer = encode_rtu_frame(MODBUS_UNIT_ID, &[pdu[0] | 0x80, exception]);
        Self { answer: Some(answer), ..Self::silent(name, encode_rtu_frame(MODBUS_UNIT_ID, pdu)) }
    }

    fn silent(name: &'static str, bytes: Vec<u8>) -> Self {
        Self { name, bytes, line: "", pause_at: None, answer: None }
    }
}

/// Returns all of them; wherever a block is written it would release the offset, and its counter is the next one.
fn faults(counter: u16) -> Vec<RequestFault> {
    let release = build_write_request_pdu(Control::REFERENCED, counter);
    let changed = |place: usize, value: u8| {
        let mut pdu = release.clone();
        pdu[place] = value;
        pdu
    };
    let whole = encode_rtu_frame(MODBUS_UNIT_ID, &release);
    let damaged = [&whole[..42], &[whole[42] ^ 1]].concat();
    let mut random = 1_u32;
    let mut noise = |length: usize| -> Vec<u8> {
        let byte = |_| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            random.to_be_bytes()[0]
        };
        (0..length).map(byte).collect()
    };
    vec![
        RequestFault::with_exception("read coils", &[1, 0, 0, 0, 8], 1),
        RequestFault::with_exception("read discrete inputs", &[2, 0, 0, 0, 8], 1),
        RequestFault::with_exception("write a coil", &[5, 0, 0, 0xFF, 0], 1),
        RequestFault::with_exception("write one register", &[6, 0, 1, 0, 2], 1),
        RequestFault::with_exception("diagnostics", &[8, 0, 0, 0, 0], 1),
        RequestFault::with_exception("read and write", &[23, 0, 0, 0, 1, 0, 1, 0, 1, 2, 0, 2], 1),
        RequestFault::with_exception("read behind the end", &[4, 0, 27, 0, 2], 2),
        RequestFault::with_exception("read elsewhere", &[4, 0xFF, 0xFF, 0, 1], 2),
        RequestFault::with_exception("read holding behind the end", &[3, 0, 20, 0, 1], 2),
        RequestFault::with_exception("read nothing", &[4, 0, 0, 0, 0], 3),
        RequestFault::with_exception("read more than may be", &[4, 0, 0, 0, 126], 3),
        RequestFault::with_exception("a byte is missing", &[4, 0, 0, 0], 3),
        RequestFault::with_exception("a byte too many", &[&release[..], &[0]].concat(), 3),
        RequestFault::with_exception(
            "write a part",
            &[&[16, 0, 0, 0, 5, 10], &release[6..16]].concat(),
            2,
        ),
        RequestFault::with_exception("write elsewhere", &changed(2, 1), 2),
        RequestFault::with_exception("write nothing", &[16, 0, 0, 0, 0, 0], 3),
        RequestFault::with_exception("another length than is stated", &changed(5, 32), 3),
        RequestFault::silent("to everybody", encode_rtu_frame(0, &release)),
        RequestFault::silent("to another unit", encode_rtu_frame(7, &release)),
        RequestFault::silent("to unit 255", encode_rtu_frame(255, &release)),
        RequestFault::silent("a wrong checksum", damaged),
        RequestFault::silent("half a request", whole[..20].to_vec()),
        RequestFault::silent("noise", noise(37)),
        RequestFault::silent("more than a frame holds", [&whole[..], &noise(257)].concat()),
        RequestFault {
            pause_at: Some(20),
            ..RequestFault::silent("a pause within", whole.clone())
        },
        RequestFault { line: "parity", ..RequestFault::silent("a wrong parity", whole.clone()) },
        RequestFault { line: "framing", ..RequestFault::silent("no stop bit", whole.clone()) },
        RequestFault { line: "break", ..RequestFault::silent("a break", whole.clone()) },
    ]
}

/// A master that has this to say, and knows what it has been reported.
struct Master {
    script: String,
    counter: u16,
}

impl Master {
    /// It lets go for five blocks, then engages, 20 ms each, up to this time.
    fn engaging(until_ms: u32) -> Self {
        let mut script = "0 control 0\n0 spindle 0\n0 positions 0\n".to_string();
        let times = (300..until_ms).step_by(20);
        let mut counter = 0;
        for at in times {
            let control = if counter < 5 { Control::REFERENCED } else { Control::ENGAGED };
            script += &format!("{at} modbus {}\n", build_write_request_hex(control, counter));
            counter += 1;
        }
        Self { script, counter }
    }

    fn lives(&mut self, at: u32) {
        self.script +=
            &format!("{at} modbus {}\n", build_write_request_hex(Control::ENGAGED, self.counter));
        self.counter += 1;
    }
}

/// Answers of the board.
struct Answers(Vec<(f64, Vec<u8>)>);

impl Answers {
    fn of(report: &ModelRunReport) -> Self {
        Self(report.events.iter().filter_map(|event| sent_frame(event, "modbus")).collect())
    }

    fn between(&self, from: u32, to: u32) -> Vec<&[u8]> {
        let is_within = |at: f64| (f64::from(from)..f64::from(to)).contains(&at);
        self.0.iter().filter(|(at, _)| is_within(*at)).map(|(_, bytes)| &bytes[..]).collect()
    }

    /// Returns the input block that was read in this time.
    fn input(&self, from: u32, to: u32) -> Result<InputBlock> {
        let [answer] = self.between(from, to)[..] else { anyhow::bail!("no answer, or several") };
        let (words, _) = answer.get(3..59).context("the whole block")?.as_chunks::<2>();
        let words: Vec<u16> = words.iter().map(|word| u16::from_be_bytes(*word)).collect();
        InputBlock::decode(&words.try_into().ok().context("28 registers")?).context("half old")
    }
}

/// Offsets in Z on CAN with their quality, in this time.
fn course(report: &ModelRunReport, from: u32, to: u32) -> Vec<(i32, u8)> {
    let frames = report.events.iter().filter_map(|event| sent_frame(event, "can 281"));
    let within = frames.filter(|(at, _)| (f64::from(from)..f64::from(to)).contains(at));
    let value = |(_, data): (f64, Vec<u8>)| {
        let data: [u8; 8] = data.try_into().expect("eight bytes");
        (offset(&data), data[5] >> 4)
    };
    within.map(value).collect()
}

/// Live and where it was in all this time.
fn stands(report: &ModelRunReport, from: u32, to: u32) -> Result<()> {
    let course = course(report, from, to);
    let (first, _) = *course.first().context("offsets on CAN")?;
    ensure!(course.len() > 100 && first.abs() > 1_000, "{} offsets of {first}", course.len());
    let moved = course
        .iter()
        .find(|(z, quality)| z.abs_diff(first) > STANDS || *quality != OffsetQuality::Live as u8);
    ensure!(moved.is_none(), "{moved:?} where {first} stood, × 10 nm");
    Ok(())
}

#[test]
fn what_a_master_does_wrong_gets_the_exception_of_the_standard_or_silence_and_moves_nothing()
-> Result<()> {
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(()) };
    let mut master = Master::engaging(SETTLED_MS);
    let written = encode_rtu_frame(MODBUS_UNIT_ID, &[16, 0, 0, 0, 17]);
    let mut slots = Vec::new();
    let mut at = SETTLED_MS;
    for number in 0..faults(0).len() {
        master.lives(at);
        let fault = faults(master.counter).swap_remove(number);
        let from = at + BEHIND_MS;
        if !fault.line.is_empty() {
            master.script += &format!("{from} modbus_error {} 1\n", fault.line);
        }
        let (before, behind) = fault.bytes.split_at(fault.pause_at.unwrap_or(fault.bytes.len()));
        master.script += &format!("{from} modbus {}\n", encode_hex(before));
        if !behind.is_empty() {
            // 20 bytes take 1.9 ms; the pause is over 750 µs and below 1.75 ms.
            master.script += &format!("{} modbus {}\n", from + 3, encode_hex(behind));
        }
        let next = from + 10 + fault.bytes.len() as u32 / 10;
        slots.push((at, from, next, fault));
        at = next;
    }
    // Two that are acknowledged, and not used: its registers are wrong, and its counter stands still.
    let mut block = build_write_request_pdu(Control::REFERENCED, master.counter);
    block[7] ^= 4;
    let not_used = [block, build_write_request_pdu(Control::REFERENCED, master.counter - 1)];
    let acknowledged = at;
    for pdu in &not_used {
        master.script +=
            &format!("{at} modbus {}\n", encode_hex(&encode_rtu_frame(MODBUS_UNIT_ID, pdu)));
        at += 10;
    }
    master.lives(at);
    let read_at = at + 10;
    master.script += &format!("{read_at} modbus {}\n", build_read_request_hex());
    // And the proof that it would have been seen.
    let released = read_at + 12;
    master.script += &format!(
        "{released} modbus {}\n",
        build_write_request_hex(Control::REFERENCED, master.counter)
    );
    let report = chip.live(released + 60, &master.script, &FAST)?;

    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let answers = Answers::of(&report);
    for (lives, from, next, fault) in &slots {
        let alive = answers.between(*lives, *from);
        ensure!(alive == [&written[..]], "before {}: {alive:02x?}", fault.name);
        let received = answers.between(*from, *next);
        let expected: Vec<&[u8]> = fault.answer.iter().map(|bytes| &bytes[..]).collect();
        ensure!(received == expected, "{}: {received:02x?} for {expected:02x?}", fault.name);
    }
    for at in [acknowledged, acknowledged + 10] {
        ensure!(answers.between(at, at + 10) == [&written[..]], "it is acknowledged");
    }
    let input = answers.input(read_at, released)?;
    ensure!((input.refused, input.last_refused) == (2, 3), "{input:?}");
    stands(&report, SETTLED_MS, released)?;
    let last = *course(&report, released, released + 60).last().context("offsets")?;
    ensure!(last == (0, OffsetQuality::Off as u8), "a block that is whole does move it: {last:?}");
    println!("{} faults, {} of them without an answer", slots.len() + 2, {
        slots.iter().filter(|(.., fault)| fault.answer.is_none()).count()
    });
    Ok(())
}

#[test]
fn a_cnc_on_can_next_to_a_plc_and_a_plc_next_to_a_cnc_are_reported_and_move_nothing() -> Result<()>
{
    let Some(chip) = Chip::of_machine(FAST_MACHINE)? else { return Ok(()) };
    let end = SETTLED_MS + 200;
    // A CNC that lets the offset go, next to a PLC that has it.
    let mut master = Master::engaging(SETTLED_MS);
    master.script += &format!("{} flags 2\n{} control 20\n", SETTLED_MS + 40, SETTLED_MS + 41);
    for at in (SETTLED_MS..end).step_by(20) {
        master.lives(at);
    }
    master.script += &format!("{} modbus {}\n", end + 1, build_read_request_hex());
    let report = chip.live(end + 20, &master.script, &FAST)?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let is_reported =
        |input: &InputBlock| StateBits(input.state).contains(StateBits::SECOND_MASTER);
    let input = Answers::of(&report).input(end, end + 20)?;
    ensure!(is_reported(&input) && input.refused == 0, "{input:?}");
    stands(&report, SETTLED_MS, end + 20)?;

    // A PLC that does, next to a CNC; then the CNC falls silent.
    let mut script = "0 flags 2\n0 spindle 0\n0 positions 0\n380 flags 3\n".to_string();
    let busy = encode_rtu_frame(MODBUS_UNIT_ID, &[0x90, 6]);
    let requested: Vec<u32> = (SETTLED_MS + 5..end).step_by(20).collect();
    for (counter, at) in (0..).zip(&requested) {
        script +=
            &format!("{at} modbus {}\n", build_write_request_hex(Control::REFERENCED, counter));
    }
    let (silent, free) = (end + 20, end + 560);
    script += &format!(
        "{} modbus {}\n{silent} control 0\n",
        end + 1,
        encode_hex(&encode_rtu_frame(MODBUS_UNIT_ID, &build_read_request_pdu()))
    );
    script += &format!("{free} modbus {}\n", build_write_request_hex(Control::REFERENCED, 900));
    let report = chip.live(free + 20, &script, &FAST)?;
    ensure!(report.clean, "a violation:\n{}", report.stdout);
    let answers = Answers::of(&report);
    for at in requested {
        ensure!(answers.between(at, at + 15) == [&busy[..]], "at {at} ms");
    }
    ensure!(is_reported(&answers.input(end, silent)?), "it is reported");
    stands(&report, SETTLED_MS, silent)?;
    let admitted = answers.between(free, free + 20);
    ensure!(
        admitted == [&encode_rtu_frame(MODBUS_UNIT_ID, &[16, 0, 0, 0, 17])[..]],
        "{admitted:02x?}"
    );
    Ok(())
}
