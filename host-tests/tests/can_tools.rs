//! Other people's CAN tools against our codec: cantools reads the DBC and writes C from it,
//! autosar-e2e protects and checks. Each gets the same frames, and each has to come to the same.

use std::{
    fmt::Write as _,
    fs,
    process::{Command, Stdio},
};

use anyhow::{Context as _, Result, ensure};
use trueup_canopen::emergency;
use trueup_core::{
    cnc::{AxisPosition, LinearAxis},
    units::{MicroDegrees, Position},
};
use trueup_emulator::setup;
use trueup_link::{
    e2e::{self, E2eChecker, E2eError},
    frame::Frame,
    frames::{self, DecodeError, OFFSET_XY_ID},
    layout::{
        CONDITIONS_ID, CONTROL_ID, EMERGENCY_ID, HEARTBEAT_ID, OFFSET_Z_ID, POSITION_X_ID,
        POSITION_Y_ID, POSITION_Z_ID, ROTARY_ID, SPINDLE_ID, STATUS_ID,
    },
    status::{self, StatusItem},
};
use trueup_node::test_vectors::XorShift32;

const FRAMES: u32 = 100_000;
const IDS: [u16; 12] = [
    OFFSET_XY_ID,
    OFFSET_Z_ID,
    STATUS_ID,
    HEARTBEAT_ID,
    EMERGENCY_ID,
    POSITION_X_ID,
    POSITION_Y_ID,
    POSITION_Z_ID,
    ROTARY_ID,
    SPINDLE_ID,
    CONTROL_ID,
    CONDITIONS_ID,
];

/// Names and values in the DBC's units; `None`: not available.
type Values = Vec<(String, Option<f64>)>;

/// Random bytes, of which those fields that only have a few meanings mostly have one of them, and
/// those that may be missing sometimes are.
fn random_frame(random: &mut XorShift32, id: u16) -> Result<Frame> {
    let words = [random.next_u32(), random.next_u32()].map(u32::to_le_bytes);
    let mut data: [u8; 8] = words.concat().try_into().ok().context("8 bytes")?;
    let is_tame = random.next_below(4) > 0;
    let is_missing = random.next_below(8) == 0;
    match id {
        OFFSET_XY_ID | OFFSET_Z_ID if is_missing => {
            data[3..5].fill(0);
            data[5] = data[5] & 0xF0 | 8;
        }
        STATUS_ID if is_missing => data[4..8].copy_from_slice(&[0, 0x80, 0, 0x80]),
        _ => {}
    }
    match id {
        OFFSET_Z_ID if is_tame => data[5] &= 0x7F,
        STATUS_ID if is_tame => data[3] = data[3] & 0x07 | (data[3] & 0x30),
        STATUS_ID if is_missing => data[4..8].copy_from_slice(&[0, 0, 0, 0x80]),
        EMERGENCY_ID if is_tame => {
            data[3] &= 0x0F;
            data[5] &= 0x07;
        }
        HEARTBEAT_ID if is_tame => {
            let state = usize::try_from(random.next_below(4))?;
            return Ok(Frame::new(id, &[[0, 4, 5, 127][state]])?);
        }
        HEARTBEAT_ID => return Ok(Frame::new(id, &data[..1])?),
        _ => {}
    }
    Ok(Frame::new(id, &data)?)
}

fn one(name: &str, value: f64) -> (String, Option<f64>) {
    (name.to_owned(), Some(value))
}

fn um(nm: i32) -> f64 {
    f64::from(nm) / 1_000.0
}

/// Returns the number and the values of an item of a status frame.
fn item(item: StatusItem) -> (u8, Values) {
    let number = |n: u16| f64::from(n);
    match item {
        StatusItem::Temperatures { pair, centi_c } => {
            let values = (0..).zip(centi_c).map(|(n, centi_c): (u8, _)| {
                let name = format!("Temperature{}", 2 * pair + n);
                (name, centi_c.map(|centi_c| f64::from(centi_c) / 100.0))
            });
            (pair, values.collect())
        }
        StatusItem::Elongation(it) => {
            (4, vec![("Elongation".into(), it.map(|elongation| um(elongation.0)))])
        }
        StatusItem::Refused { damaged, out_of_sequence } => (
            5,
            vec![one("Damaged", number(damaged)), one("OutOfSequence", number(out_of_sequence))],
        ),
        StatusItem::Received { malformed, lost } => {
            (6, vec![one("Malformed", number(malformed)), one("Lost", number(lost))])
        }
        StatusItem::Board { noise_thousandths, faults } => (
            7,
            vec![one("Noise", number(noise_thousandths) / 1_000.0), one("Faults", number(faults))],
        ),
        StatusItem::State(bits) => (8, vec![one("StateBits", bits.0.into())]),
        StatusItem::Reset { reason, free_stack } => (
            9,
            vec![one("ResetReason", f64::from(reason as u8)), one("FreeStack", number(free_stack))],
        ),
        StatusItem::Calibration(crc) => (10, vec![one("CalibrationCrc", crc.into())]),
        StatusItem::Slope { axis, constant, slope } => {
            let name = ["X", "Y", "Z"][usize::from(axis)];
            let constant = constant.map(|constant| f64::from(constant) / 10.0);
            let slope = one(&format!("OffsetSlope{name}"), f64::from(slope) / 10.0);
            (11 + axis, vec![(format!("OffsetConstant{name}"), constant), slope])
        }
    }
}

/// Returns what our codec makes of a frame, and of that again.
fn ours(frame: &Frame) -> Result<(Frame, Values), DecodeError> {
    let counter = frames::e2e_counter(frame);
    Ok(match frame.id() {
        OFFSET_XY_ID => {
            let read = frames::decode_offset_xy(frame)?;
            let offset = read.offset.map(|[x, y]| [x, y, Default::default()]);
            let values = ["OffsetX", "OffsetY"].into_iter().enumerate();
            let values =
                values.map(|(n, name)| (name.into(), read.offset.map(|offset| um(offset[n].0))));
            let output = trueup_core::cnc::Output { offset, ..Default::default() };
            (frames::encode_offset_xy(&output, counter), values.collect())
        }
        OFFSET_Z_ID => {
            let read = frames::decode_offset_z(frame)?;
            let output = trueup_core::cnc::Output {
                offset: read.offset.map(|z| [Default::default(), Default::default(), z]),
                quality: read.quality,
                flags: read.flags,
                age_ms: read.age_ms,
            };
            let values = vec![
                ("OffsetZ".into(), read.offset.map(|z| um(z.0))),
                one("Quality", f64::from(read.quality as u8)),
                one("Flags", read.flags.0.into()),
                one("Age", read.age_ms.into()),
            ];
            (frames::encode_offset_z(&output, counter), values)
        }
        STATUS_ID => {
            let read = status::decode(frame)?;
            let (item, mut values) = item(read.item);
            values.push(one("Item", item.into()));
            values.push(one("LastRefused", f64::from(read.last_refused as u8)));
            (status::encode(&read, counter), values)
        }
        HEARTBEAT_ID => {
            let state = frames::decode_heartbeat(frame)?;
            (frames::encode_heartbeat(state), vec![one("State", f64::from(state as u8))])
        }
        EMERGENCY_ID => {
            let read = emergency::decode(frame)?;
            let values = vec![
                one("ErrorCode", read.code.into()),
                one("ErrorRegister", read.register.into()),
                one("Fault", f64::from(read.fault as u8)),
                one("Flags", read.flags.0.into()),
                one("Quality", f64::from(read.quality as u8)),
            ];
            (emergency::encode(&read), values)
        }
        ROTARY_ID => {
            let read = frames::decode_rotary(frame)?;
            let degrees =
                read.angles.map(|angles| f64::from(angles.0) / f64::from(MicroDegrees::PER_DEGREE));
            let values = vec![one("Angle1", degrees[0]), one("Angle2", degrees[1])];
            (frames::encode_rotary(read, counter), values)
        }
        SPINDLE_ID => {
            let read = frames::decode_spindle(frame)?;
            let values = vec![one("Speed", read.speed.0.into()), one("Load", read.load_n.into())];
            (frames::encode_spindle(read, counter), values)
        }
        CONDITIONS_ID => {
            let read = frames::decode_conditions(frame)?;
            let bit = |n: u8| one(&format!("Condition{n}"), f64::from(u8::from(read.is_set(n))));
            let values = [one("Tool", read.tool.into())].into_iter().chain((0..16).map(bit));
            (frames::encode_conditions(read, counter), values.collect())
        }
        CONTROL_ID => {
            let read = frames::decode_control(frame)?;
            let bit = |set: bool| f64::from(u8::from(set));
            let values = vec![
                one("Engage", bit(read.engage)),
                one("Referenced", bit(read.referenced)),
                one("Zero", bit(read.zero)),
                one("Service", bit(read.service)),
                one("Confirm", bit(read.confirm)),
                one("LearnedPart", read.learned.part.into()),
                one("Learned", f64::from(read.learned.amount) / 1_000.0),
                one("LearnedCrc", read.learned.calibration.into()),
            ];
            (frames::encode_control(read, counter), values)
        }
        id => {
            let axis =
                LinearAxis::ALL.into_iter().find(|axis| frames::position_frame_id(*axis) == id);
            let axis = axis.expect("no other identifier is drawn");
            let read: AxisPosition = frames::decode_position(axis, frame)?;
            let mm = f64::from(read.position.0) / f64::from(Position::PER_MILLIMETRE);
            let direction = f64::from(read.direction as i8);
            let values = vec![one("Position", mm), one("Direction", direction)];
            (frames::encode_position(read, counter), values)
        }
    })
}

fn hex(frame: &Frame) -> String {
    frame.payload().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Runs one of the scripts; its last line on standard output is what it has found.
fn script(name: &str, arguments: &[&std::path::Path]) -> Result<String> {
    let output = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python").join(name))
        .args(arguments)
        .stdin(Stdio::null())
        // Its progress.
        .stderr(Stdio::inherit())
        .output()?;
    let stdout = String::from_utf8(output.stdout)?;
    ensure!(output.status.success(), "{stdout}");
    Ok(stdout)
}

#[test]
fn cantools_and_the_c_code_it_writes_read_and_write_every_message_as_the_codec_does() -> Result<()>
{
    let mut random = XorShift32::new(0xCAFE);
    let mut lines = String::new();
    let mut taken = [0_u32; IDS.len()];
    for number in 0..FRAMES {
        let which = usize::try_from(number)? % IDS.len();
        let frame = random_frame(&mut random, IDS[which])?;
        write!(lines, "{:x} {} ", frame.id(), hex(&frame))?;
        match ours(&frame) {
            Err(DecodeError::Value { signal, .. }) => writeln!(lines, "{signal}")?,
            Err(error) => return Err(error).context("the length is right"),
            Ok((again, values)) => {
                taken[which] += 1;
                write!(lines, "ok {}", hex(&again))?;
                for (name, value) in values {
                    match value {
                        Some(value) => write!(lines, " {name}={value}")?,
                        None => write!(lines, " {name}=na")?,
                    }
                }
                writeln!(lines)?;
            }
        }
    }
    println!("taken by our codec, of {}: {taken:?}", FRAMES as usize / IDS.len());
    assert!(taken.iter().all(|count| *count > 1_000), "{taken:?}");
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("frames.txt");
    fs::write(&file, lines)?;
    let dbc = setup::project_root().join("crates/board/link/trueup.dbc");
    let found = script("dbc_codec.py", &[&dbc, &file, folder.path()])?;
    println!("{found}");
    let expected =
        format!("{FRAMES} frames, {} of them taken, 0 differ", taken.iter().sum::<u32>());
    assert_eq!(found.lines().last(), Some(expected.as_str()));
    Ok(())
}

#[test]
fn autosar_e2e_comes_to_the_same_verdict_on_every_frame() -> Result<()> {
    let mut random = XorShift32::new(0xE2E);
    let mut checkers: Vec<(u16, u8, Option<Frame>, E2eChecker)> =
        IDS.iter().map(|id| (*id, 0, None, E2eChecker::new(*id))).collect();
    let mut lines = String::new();
    let mut counts = std::collections::BTreeMap::<&str, u32>::new();
    let mut count = 0;
    while count < FRAMES {
        let which = usize::try_from(random.next_below(u32::try_from(IDS.len())?))?;
        let (id, counter, before, checker) = &mut checkers[which];
        let words = [random.next_u32(), random.next_u32()].map(u32::to_le_bytes);
        let mut data: [u8; 8] = words.concat().try_into().ok().context("8 bytes")?;
        // Mostly the next; a copy; some lost; far away; out of order; a sender that restarts.
        *counter = match random.next_below(16) {
            0 => *counter,
            1 => counter.wrapping_add(u8::try_from(2 + random.next_below(14))?),
            2 => counter.wrapping_add(u8::try_from(16 + random.next_below(200))?),
            3 => counter.wrapping_sub(u8::try_from(1 + random.next_below(3))?),
            4 => 0,
            _ => counter.wrapping_add(1),
        };
        e2e::protect(*id, *counter, &mut data);
        let fate = random.next_below(16);
        let frame = match (fate, &before) {
            // One bit, three bits, another identifier's frame, the very same frame.
            (0, _) => flipped(&mut random, *id, data, 1)?,
            (1, _) => flipped(&mut random, *id, data, 3)?,
            (2, _) => {
                e2e::protect(*id ^ 0x100, *counter, &mut data);
                Frame::new(*id, &data)?
            }
            (3, Some(before)) => *before,
            _ => Frame::new(*id, &data)?,
        };
        *before = Some(frame);
        let verdict = match checker.check(&frame) {
            Ok(0) => "ok",
            Ok(_) => "some-lost",
            Err(E2eError::Crc { .. }) => "crc",
            Err(E2eError::Repeated { .. }) => "repeated",
            Err(E2eError::WrongSequence { .. }) => "wrong-sequence",
            Err(E2eError::TooShort { .. }) => "short",
        };
        *counts.entry(verdict).or_default() += 1;
        writeln!(lines, "{id:x} {} {verdict}", hex(&frame))?;
        count += 1;
    }
    println!("our verdicts: {counts:?}");
    assert_eq!(counts.len(), 5, "all but \"short\": {counts:?}");
    assert!(counts.values().all(|count| *count > 1_000), "{counts:?}");
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("frames.txt");
    fs::write(&file, lines)?;
    let found = script("e2e_verdicts.py", &[&file])?;
    println!("{found}");
    assert_eq!(found.trim(), format!("{FRAMES} frames, 0 differ"));
    Ok(())
}

/// Returns a frame with this many bits wrong, anywhere.
fn flipped(random: &mut XorShift32, id: u16, mut data: [u8; 8], bits: u32) -> Result<Frame> {
    let first = random.next_below(64);
    for n in 0..bits {
        let bit = usize::try_from((first + 17 * n) % 64)?;
        data[bit / 8] ^= 1 << (bit % 8);
    }
    Ok(Frame::new(id, &data)?)
}
