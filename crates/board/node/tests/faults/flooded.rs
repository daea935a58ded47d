//! One wire is flooded while the CNC is on the other: its offsets arrive as if nothing were.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use trueup_core::cnc::OffsetQuality;
use trueup_link::{
    frame::Frame,
    layout::SDO_REQUEST_ID,
    slcan::{LineSplitter, decode_line, encode_line},
};
use trueup_node::node::Interface;

use crate::rig::Rig;

/// As many bytes as 921 600 Bd bring in a millisecond.
const BYTES_PER_MS: usize = 92;
/// As many frames of 8 bytes as 1 Mbit/s bring in a millisecond, without stuffing.
const FRAMES_PER_MS: usize = 9;

/// The flood on the wire: noise, and whole frames of any sender.
#[derive(Clone, Copy, Debug)]
enum Flood {
    Bytes,
    Lines,
    CommandsWithoutCrc,
    Requests,
}

const FLOODS: [Flood; 4] = [Flood::Bytes, Flood::Lines, Flood::CommandsWithoutCrc, Flood::Requests];

/// Returns a frame of the flood, or `None`: bytes that need not be one.
fn drawn(rig: &mut Rig, flood: Flood) -> Option<Frame> {
    // Position X, Y and Z, the angles, the speed, `Control`.
    const COMMANDS: [u16; 6] = [0x201, 0x301, 0x401, 0x501, 0x202, 0x302];
    let bits = rig.bits();
    let id = match flood {
        Flood::Bytes => return None,
        Flood::Lines => (bits % 0x800) as u16,
        Flood::CommandsWithoutCrc => COMMANDS[(bits >> 20) as usize % COMMANDS.len()],
        Flood::Requests => SDO_REQUEST_ID,
    };
    Some(Frame::new(id, &rig.bits().to_le_bytes()).expect("8 bytes"))
}

/// In how many of these milliseconds the offset is that of a bridge without the flood, and live.
fn arrives(flood: Flood, over: Interface, ms: u32) -> u32 {
    let cnc = if over == Interface::Can { Interface::Serial } else { Interface::Can };
    let (mut rig, mut twin) = (Rig::engaged_over(cnc, 9), Rig::engaged_over(cnc, 9));
    // The flood has a generator of its own, so that both bridges have the same codes.
    let mut random = Rig::new(10);
    let mut lines = LineSplitter::new();
    let mut right = 0;
    for _ in 0..ms {
        match over {
            Interface::Can => {
                let frames = (0..FRAMES_PER_MS).filter_map(|_| drawn(&mut random, flood));
                for frame in frames {
                    rig.node.receive(over, &frame).ok();
                }
            }
            Interface::Serial => {
                let mut bytes = Vec::new();
                while bytes.len() < BYTES_PER_MS {
                    match drawn(&mut random, flood) {
                        Some(frame) => bytes.extend(encode_line(&frame).as_bytes()),
                        None => bytes.push(random.bits() as u8),
                    }
                }
                for byte in bytes {
                    if let Some(Ok(line)) = lines.push(byte)
                        && let Ok(frame) = decode_line(line)
                    {
                        rig.node.receive(over, &frame).ok();
                    }
                }
            }
            Interface::Modbus => {
                let block = std::array::from_fn(|_| random.bits() as u16);
                rig.node.receive_registers(&block).ok();
            }
        }
        rig.live();
        twin.live();
        let is_live = rig.last.quality == OffsetQuality::Live;
        right += u32::from(is_live && rig.last.offset == twin.last.offset);
    }
    println!("{flood:?} over {over:?}: {right} of {ms} offsets");
    right
}

#[test]
fn a_flooded_wire_takes_no_offset_from_the_other_one() {
    let ms = 3_000;
    for flood in FLOODS {
        // Bytes that are no frame do not come over CAN.
        let lines: &[Interface] = match flood {
            Flood::Bytes => &[Interface::Serial, Interface::Modbus],
            _ => &[Interface::Serial, Interface::Can],
        };
        for &over in lines {
            assert!(arrives(flood, over, ms) * 100 >= ms * 99, "{flood:?} over {over:?}");
        }
    }
}
