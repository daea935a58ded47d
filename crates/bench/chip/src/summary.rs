//! The summary that the program prints of a run: what the units did, and what was on the wires.

use crate::{
    can_ids::*,
    chip::Chip,
    frame::{CanFrame, compute_e2e_crc},
    report::Severity,
    serial_line::SerialLine,
    simulation_time::ticks_to_seconds,
};
use std::collections::BTreeMap;

/// Returns what the board sent on its wires and when it was reset, a line an event in the order of time, with the
/// report's violations and remarks at the end.
#[must_use]
pub fn format_event_log(c: &Chip, now: u64) -> String {
    let mut lines: Vec<(u64, String)> = Vec::new();
    for (at, frame) in &c.world.log {
        let bytes: String =
            frame.data[..frame.len as usize].iter().map(|b| format!("{b:02x}")).collect();
        lines.push((*at, format!("can {:03X} {bytes}", frame.id)));
    }
    let mut text = String::new();
    for (at, byte) in &c.world.wires[0].heard {
        match *byte {
            b'\r' => lines.push((*at, format!("serial {}", std::mem::take(&mut text)))),
            7 => lines.push((*at, format!("serial {}\\a", std::mem::take(&mut text)))),
            byte => text.push(byte.into()),
        }
    }
    lines.extend(format_rs485_responses(&c.world.wires[1]));
    lines.extend(c.resets.iter().map(|(at, why)| (*at, format!("reset {why}"))));
    lines.sort_by_key(|line| line.0);
    let at = |ticks: u64| ticks_to_seconds(ticks) * 1e3;
    let mut out: String =
        lines.into_iter().map(|(time, line)| format!("{:.4} {line}\n", at(time))).collect();
    for ((grade, text), item) in &c.report.items {
        let grade = match grade {
            Severity::Violation => "violation",
            Severity::Remark => "remark",
            _ => continue,
        };
        out += &format!("{:.4} {grade} {text} [{} x]\n", at(item.first), item.count);
    }
    out + &format!("{:.4} end\n", at(now))
}

/// Returns what the board sent on the RS-485 line, cut where it paused: when it began, and the bytes.
fn format_rs485_responses(wire: &SerialLine) -> Vec<(u64, String)> {
    let mut all: Vec<(u64, String)> = Vec::new();
    let mut last = 0;
    for (at, byte) in &wire.heard {
        if all.is_empty() || at - last > 2 * wire.character_ticks() {
            all.push((at - wire.character_ticks(), "modbus ".into()));
        }
        last = *at;
        all.last_mut().expect("there is one").1 += &format!("{byte:02x}");
    }
    all
}

/// `OffsetZ`: position of the offset, in 1/100 µm.
const OFFSET_Z_SHIFT: u32 = 24;
/// `OffsetZ`: bits of the offset.
const OFFSET_Z_BITS: u32 = 20;
/// `OffsetZ`: the offset, shifted down.
const OFFSET_Z_MASK: u64 = 0xf_ffff;
/// `OffsetZ`: position of the quality.
const QUALITY_SHIFT: u32 = 44;
/// `OffsetZ`: the quality, shifted down.
const QUALITY_MASK: u64 = 0xf;

fn sign_extend(v: u64, bits: u32) -> i64 {
    ((v << (64 - bits)) as i64) >> (64 - bits)
}

/// Prints the summary; `quiet`: without the bytes of the serial line.
pub fn print_summary(c: &Chip, quiet: bool) {
    print_peripheral_statistics(c);
    let mut by: FramesById<'_> = BTreeMap::new();
    for (t, f) in &c.world.log {
        by.entry(f.id).or_default().push((*t, f));
    }
    print_frame_statistics(&by);
    print_offset_status_changes(&by);
    for (t, f) in by.get(&EMERGENCY_ID).into_iter().flatten().take(20) {
        println!("   emergency at {:9.3} ms: {:02x?}", ticks_to_seconds(*t) * 1e3, f.data);
    }
    print_temperatures(&by);
    for id in [HEARTBEAT_ID, SDO_RESPONSE_ID] {
        for (t, f) in by.get(&id).into_iter().flatten().take(4) {
            println!(
                "   {id:03X} at {:9.3} ms: {:02x?}",
                ticks_to_seconds(*t) * 1e3,
                &f.data[..f.len as usize]
            );
        }
    }
    if !quiet && !c.world.wires[0].heard.is_empty() {
        let text: String = c.world.wires[0].heard.iter().map(|b| b.1 as char).collect();
        for line in text.split('\r').take(12) {
            println!("   serial: {line:?}");
        }
    }
}

/// The frames of each identifier, with their times.
type FramesById<'f> = BTreeMap<u32, Vec<(u64, &'f CanFrame)>>;

/// Prints the figures of each unit.
fn print_peripheral_statistics(c: &Chip) {
    let lamp = c.world.lamp.len();
    let adc = &c.adc.unit[0];
    println!(
        "== chip: resets {:?}; ADC {} conversions, {:.3} Hz; DMA2 stream 0 {} transfers; lamp changed {lamp} times",
        c.resets
            .iter()
            .map(|(t, w)| format!("{w} at {:.3} s", ticks_to_seconds(*t)))
            .collect::<Vec<_>>(),
        adc.conversions,
        (adc.conversions.max(2) - 1) as f64
            / ticks_to_seconds(adc.last_at.saturating_sub(adc.first_at)).max(1e-9),
        c.dma[1].transfers[0]
    );
    println!(
        "   watchdog: {} feeds, longest pause {:.1} ms; flash: {} words programmed, erases {:?}, longest stall {:.1} ms",
        c.iwdg.feeds,
        ticks_to_seconds(c.iwdg.longest) * 1e3,
        c.flash.stats.words,
        c.flash.stats.erases,
        ticks_to_seconds(c.flash.stats.longest_stall) * 1e3
    );
    println!(
        "   CAN: {} sent, {} taken, {} filtered out, {} lost in FIFOs, {} unheard; bus load {:.1} %; TEC {}, bus-off {}; longest wait in a mailbox {:.3} ms",
        c.can.sent,
        c.can.taken,
        c.can.filtered,
        c.can.lost,
        c.can.unheard,
        100.0 * c.can.busy as f64 / c.now as f64,
        c.can.tec,
        c.can.boff,
        ticks_to_seconds(c.can.longest_wait) * 1e3
    );
    println!(
        "   serial: {} bytes sent, {} received, {} overruns, a byte waits {:.1} µs at the longest (at {:.3} ms); a block of samples {:.1} µs (at {:.3} ms); SPI: {} bytes; interrupts {:?}",
        c.world.wires[0].heard.len(),
        c.uart[0].received,
        c.uart[0].overruns,
        ticks_to_seconds(c.uart[0].longest) * 1e6,
        ticks_to_seconds(c.uart[0].longest_at) * 1e3,
        ticks_to_seconds(c.dma[1].longest[0]) * 1e6,
        ticks_to_seconds(c.dma[1].longest_at[0]) * 1e3,
        c.spi.bytes,
        c.irq_counts.iter().enumerate().filter(|(_, n)| **n > 0).collect::<Vec<_>>()
    );
    let up: Vec<String> = (0..)
        .zip(c.irq_longest)
        .filter(|(_, longest)| *longest > 0)
        .map(|(n, longest): (usize, u64)| format!("{n}: {:.1} µs", ticks_to_seconds(longest) * 1e6))
        .collect();
    println!("   interrupt lines up at the longest: {}", up.join(", "));
    let plc = &c.uart[1];
    println!(
        "   RS-485: {} bytes sent, {} received, {} overruns, a byte waits {:.1} µs at the longest (at {:.3} ms)",
        c.world.wires[1].heard.len(),
        plc.received,
        plc.overruns,
        ticks_to_seconds(plc.longest) * 1e6,
        ticks_to_seconds(plc.longest_at) * 1e3
    );
    for (i, r) in c.world.rtds.iter().enumerate().filter(|(_, r)| r.conversions + r.reads > 0) {
        println!(
            "   MAX31865 {i}: {} conversions, {} reads, {} of them of an old result",
            r.conversions, r.reads, r.stale
        );
    }
}

/// How many frames of each identifier there were, how regular and how sound.
fn print_frame_statistics(by: &FramesById<'_>) {
    for (id, frames) in by {
        let gaps: Vec<f64> =
            frames.windows(2).map(|w| ticks_to_seconds(w[1].0 - w[0].0) * 1e3).collect();
        let (low, high) = gaps.iter().fold((f64::MAX, 0f64), |a, g| (a.0.min(*g), a.1.max(*g)));
        let protected = matches!(*id, OFFSET_XY_ID | OFFSET_Z_ID | STATUS_ID);
        let bad = frames
            .iter()
            .filter(|(_, f)| {
                protected
                    && compute_e2e_crc(*id, &f.data) != u16::from_le_bytes([f.data[0], f.data[1]])
            })
            .count();
        let skipped = frames
            .windows(2)
            .filter(|w| protected && w[1].1.data[2] != w[0].1.data[2].wrapping_add(1))
            .count();
        let mean = gaps.iter().sum::<f64>() / gaps.len().max(1) as f64;
        println!(
            "   {id:03X}: {:6} frames from {:.3} ms, every {mean:.4} ms ({:.4} to {high:.4}); wrong CRC {bad}, counter jumps {skipped}",
            frames.len(),
            ticks_to_seconds(frames[0].0) * 1e3,
            if gaps.is_empty() { 0.0 } else { low }
        );
    }
}

/// The offset of Z, where its quality or its flags change.
fn print_offset_status_changes(by: &FramesById<'_>) {
    let mut last = (99, 99);
    let mut shown = 0;
    for (t, f) in by.get(&OFFSET_Z_ID).into_iter().flatten() {
        let v = u64::from_le_bytes(f.data);
        let (q, flags) = ((v >> QUALITY_SHIFT & QUALITY_MASK) as u8, f.data[6]);
        if (q, flags) != last && shown < 40 {
            shown += 1;
            last = (q, flags);
            println!(
                "   OffsetZ at {:9.3} ms: {:8.2} µm, quality {q}, flags {flags:#04x}, age {}",
                ticks_to_seconds(*t) * 1e3,
                sign_extend(v >> OFFSET_Z_SHIFT & OFFSET_Z_MASK, OFFSET_Z_BITS) as f64 / 100.0,
                f.data[7]
            );
        }
    }
    if let Some((t, f)) = by.get(&OFFSET_Z_ID).and_then(|v| v.last()) {
        let v = u64::from_le_bytes(f.data);
        println!(
            "   OffsetZ at {:9.3} ms: {:8.2} µm, quality {}, flags {:#04x}, age {} (last)",
            ticks_to_seconds(*t) * 1e3,
            sign_extend(v >> OFFSET_Z_SHIFT & OFFSET_Z_MASK, OFFSET_Z_BITS) as f64 / 100.0,
            v >> QUALITY_SHIFT & QUALITY_MASK,
            f.data[6],
            f.data[7]
        );
    }
}

/// The last temperature of each channel.
fn print_temperatures(by: &FramesById<'_>) {
    let mut temperatures = BTreeMap::new();
    for (_, f) in by.get(&STATUS_ID).into_iter().flatten() {
        let item = f.data[3] & 15;
        if item < 4 {
            for i in 0..2 {
                let raw = i16::from_le_bytes([f.data[4 + 2 * i], f.data[5 + 2 * i]]);
                temperatures.insert(2 * item as usize + i, raw);
            }
        }
    }
    println!(
        "   temperatures {:?}",
        temperatures
            .iter()
            .filter(|(_, v)| **v != i16::MIN)
            .map(|(k, v)| format!("{k}: {:.2} °C", f64::from(*v) / 100.0))
            .collect::<Vec<_>>()
    );
}
