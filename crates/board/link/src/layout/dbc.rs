//! `trueup.dbc`, printed from the table: the description of the signals that CAN tools read.

use core::fmt;
use std::{format, string::String};

use super::frame_table::{FRAMES, FrameSpec, Multiplexing, SignalSpec};

/// Prints the whole file.
///
/// # Errors
/// None but those of `out`.
pub(crate) fn write_dbc(out: &mut impl fmt::Write) -> fmt::Result {
    out.write_str(DBC_HEADER)?;
    FRAMES.iter().try_for_each(|frame| write_frame(out, frame))?;
    out.write_str(NETWORK_COMMENTS)?;
    FRAMES.iter().try_for_each(|frame| write_frame_comment(out, frame))?;
    for frame in FRAMES {
        for signal in frame.signals() {
            writeln!(out, "CM_ SG_ {} {} \"{}\";", frame.id, signal.name, signal.comment)?;
        }
    }
    out.write_str(CYCLE_TIME_ATTRIBUTE)?;
    for frame in FRAMES {
        writeln!(out, "BA_ \"GenMsgCycleTime\" BO_ {} {};", frame.id, frame.period_ms)?;
    }
    out.write_str("\n")?;
    FRAMES.iter().try_for_each(|frame| write_value_descriptions(out, frame))
}

const DBC_HEADER: &str = concat!(
    "VERSION \"1\"\n\nNS_ :\n\tCM_\n\tBA_DEF_\n\tBA_\n\tVAL_\n\tBA_DEF_DEF_\n\nBS_:\n\n",
    "BU_: Bridge CNC\n\n",
);

const NETWORK_COMMENTS: &str = concat!(
    "CM_ \"Messages between the trueup bridge and a CNC, on CAN (2.0, standard identifiers, ",
    "1 Mbit/s) and as SLCAN lines on a serial port. Bits that no signal covers are sent as 0 and ",
    "ignored by the receiver. Every frame with the signals Crc and Counter is protected by AUTOSAR ",
    "E2E profile 5: Crc is CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected, no ",
    "final XOR) over byte 2 to the last byte, followed by the low and the high byte of the data ",
    "ID. The data ID of a frame is its CAN identifier. Example: data ID 0x0181, payload ",
    "0000001122334455 becomes 8bcb001122334455.\";\n",
    "CM_ BU_ Bridge \"The trueup bridge, CANopen node 1: reads the spindle sensor and the ",
    "temperatures, sends offsets.\";\n",
    "CM_ BU_ CNC \"The machine's control: adds the offsets to its commanded positions.\";\n",
);

const CYCLE_TIME_ATTRIBUTE: &str =
    "\nBA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 65535;\nBA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n";

fn write_frame(out: &mut impl fmt::Write, frame: &FrameSpec) -> fmt::Result {
    writeln!(out, "BO_ {} {}: {} {}", frame.id, frame.name, frame.len, frame.sender)?;
    let receiver = if frame.sender == "CNC" { "Bridge" } else { "CNC" };
    for SignalSpec { name, place, multiplexing, factor, unit, range, .. } in frame.signals() {
        let item = match multiplexing {
            Multiplexing::None => String::new(),
            Multiplexing::Selector => " M".into(),
            Multiplexing::Item(item) => format!(" m{item}"),
        };
        let sign = if place.signed { '-' } else { '+' };
        let [one, min, max] = [1, range.0, range.1].map(|raw| format_scaled_decimal(raw, *factor));
        writeln!(
            out,
            " SG_ {name}{item} : {}|{}@1{sign} ({one},0) [{min}|{max}] \"{unit}\" {receiver}",
            place.start, place.length
        )?;
    }
    out.write_str("\n")
}

/// Returns `raw` times the factor in all its decimals.
fn format_scaled_decimal(raw: i64, (numerator, denominator): (i32, i32)) -> String {
    let product = raw * i64::from(numerator);
    let sign = if product < 0 { "-" } else { "" };
    let (magnitude, one) = (product.unsigned_abs(), u64::from(denominator.unsigned_abs()));
    let width = one.ilog10() as usize;
    let (whole, fraction) = (magnitude / one, magnitude % one);
    let digits = format!("{sign}{whole}.{fraction:0width$}");
    digits.trim_end_matches('0').trim_end_matches('.').into()
}

fn write_frame_comment(out: &mut impl fmt::Write, frame: &FrameSpec) -> fmt::Result {
    write!(out, "CM_ BO_ {} \"{}", frame.id, frame.comment)?;
    if frame.is_protected() {
        write!(out, " E2E profile 5, data ID 0x{:04X}.", frame.id)?;
    }
    out.write_str("\";\n")
}

/// Prints the named values. Of multiplexed signals, those whose only name says that the value is
/// missing come last: the order that the file has always had.
fn write_value_descriptions(out: &mut impl fmt::Write, frame: &FrameSpec) -> fmt::Result {
    let is_late =
        |signal: &SignalSpec| signal.multiplexing != Multiplexing::None && signal.names.len() == 1;
    for late in [false, true] {
        for signal in frame.signals().filter(|spec| !spec.names.is_empty() && is_late(spec) == late)
        {
            write!(out, "VAL_ {} {}", frame.id, signal.name)?;
            for (raw, name) in signal.names {
                write!(out, " {raw} \"{name}\"")?;
            }
            out.write_str(" ;\n")?;
        }
    }
    Ok(())
}
