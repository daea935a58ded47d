//! The summary that the program prints of a run: what the units did, and what the wires said.

use crate::{
    chip::Chip,
    frame::{Frame, crc},
    report::Grade,
    time::seconds,
    wire::Wire,
};
use std::collections::BTreeMap;

/// Returns what the board said on its wires and when it was reset, a line an event in the order of time, with the
/// report's violations and remarks at the end.
#[must_use]
pub fn log(c: &Chip, now: u64) -> String {
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
    lines.extend(answers(&c.world.wires[1]));
    lines.extend(c.resets.iter().map(|(at, why)| (*at, format!("reset {why}"))));
    lines.sort_by_key(|line| line.0);
    let at = |ticks: u64| seconds(ticks) * 1e3;
    let mut out: String =
        lines.into_iter().map(|(time, line)| format!("{:.4} {line}\n", at(time))).collect();
    for ((grade, text), item) in &c.report.items {
        let grade = match grade {
            Grade::Violation => "violation",
            Grade::Remark => "remark",
            _ => continue,
        };
        out += &format!("{:.4} {grade} {text} [{} x]\n", at(item.first), item.count);
    }
    out + &format!("{:.4} end\n", at(now))
}

/// Returns what the board said on the RS-485 line, cut where it paused: when it began, and the bytes.
fn answers(wire: &Wire) -> Vec<(u64, String)> {
    let mut all: Vec<(u64, String)> = Vec::new();
    let mut last = 0;
    for (at, byte) in &wire.heard {
        if all.is_empty() || at - last > 2 * wire.character() {
            all.push((at - wire.character(), "modbus ".into()));
        }
        last = *at;
        all.last_mut().expect("there is one").1 += &format!("{byte:02x}");
    }
    all
}

fn signed(v: u64, bits: u32) -> i64 {
    ((v << (64 - bits)) as i64) >> (64 - bits)
}

pub fn summary(c: &Chip, quiet: bool) {
    units(c);
    let mut by: Frames<'_> = BTreeMap::new();
    for (t, f) in &c.world.log {
        by.entry(f.id).or_default().push((*t, f));
    }
    frames(&by);
    offsets(&by);
    for (t, f) in by.get(&0x81).into_iter().flatten().take(20) {
        println!("   emergency at {:9.3} ms: {:02x?}", seconds(*t) * 1e3, f.data);
    }
    temperatures(&by);
    for id in [0x701, 0x581] {
        for (t, f) in by.get(&id).into_iter().flatten().take(4) {
            println!(
                "   {id:03X} at {:9.3} ms: {:02x?}",
                seconds(*t) * 1e3,
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
type Frames<'f> = BTreeMap<u32, Vec<(u64, &'f Frame)>>;

/// Prints the figures of each unit.
fn units(c: &Chip) {
    let lamp = c.world.lamp.len();
    let adc = &c.adc.unit[0];
    println!(
        "== chip: resets {:?}; ADC {} conversions, {:.3} Hz; DMA2 stream 0 {} transfers; lamp changed {lamp} times",
        c.resets.iter().map(|(t, w)| format!("{w} at {:.3} s", seconds(*t))).collect::<Vec<_>>(),
        adc.conversions,
        (adc.conversions.max(2) - 1) as f64
            / seconds(adc.last_at.saturating_sub(adc.first_at)).max(1e-9),
        c.dma[1].transfers[0]
    );
    println!(
        "   watchdog: {} feeds, longest pause {:.1} ms; flash: {} words programmed, erases {:?}, longest stall {:.1} ms",
        c.iwdg.feeds,
        seconds(c.iwdg.longest) * 1e3,
        c.flash.stats.words,
        c.flash.stats.erases,
        seconds(c.flash.stats.longest_stall) * 1e3
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
        seconds(c.can.longest_wait) * 1e3
    );
    println!(
        "   serial: {} bytes sent, {} received, {} overruns, a byte waits {:.1} µs at the longest (at {:.3} ms); a block of samples {:.1} µs (at {:.3} ms); SPI: {} bytes; interrupts {:?}",
        c.world.wires[0].heard.len(),
        c.uart[0].received,
        c.uart[0].overruns,
        seconds(c.uart[0].longest) * 1e6,
        seconds(c.uart[0].longest_at) * 1e3,
        seconds(c.dma[1].longest[0]) * 1e6,
        seconds(c.dma[1].longest_at[0]) * 1e3,
        c.spi.bytes,
        c.irq_counts.iter().enumerate().filter(|(_, n)| **n > 0).collect::<Vec<_>>()
    );
    let up: Vec<String> = (0..)
        .zip(c.irq_longest)
        .filter(|(_, longest)| *longest > 0)
        .map(|(n, longest): (usize, u64)| format!("{n}: {:.1} µs", seconds(longest) * 1e6))
        .collect();
    println!("   interrupt lines up at the longest: {}", up.join(", "));
    let plc = &c.uart[1];
    println!(
        "   RS-485: {} bytes sent, {} received, {} overruns, a byte waits {:.1} µs at the longest (at {:.3} ms)",
        c.world.wires[1].heard.len(),
        plc.received,
        plc.overruns,
        seconds(plc.longest) * 1e6,
        seconds(plc.longest_at) * 1e3
    );
    for (i, r) in c.world.rtds.iter().enumerate().filter(|(_, r)| r.conversions + r.reads > 0) {
        println!(
            "   MAX31865 {i}: {} conversions, {} reads, {} of them of an old result",
            r.conversions, r.reads, r.stale
        );
    }
}

/// How many frames of each identifier there were, how regular and how sound.
fn frames(by: &Frames<'_>) {
    for (id, frames) in by {
        let gaps: Vec<f64> = frames.windows(2).map(|w| seconds(w[1].0 - w[0].0) * 1e3).collect();
        let (low, high) = gaps.iter().fold((f64::MAX, 0f64), |a, g| (a.0.min(*g), a.1.max(*g)));
        let protected = matches!(id, 0x181 | 0x281 | 0x381);
        let bad = frames
            .iter()
            .filter(|(_, f)| {
                protected && crc(*id, &f.data) != u16::from_le_bytes([f.data[0], f.data[1]])
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
            seconds(frames[0].0) * 1e3,
            if gaps.is_empty() { 0.0 } else { low }
        );
    }
}

/// The offset of Z, where its quality or its flags change.
fn offsets(by: &Frames<'_>) {
    let mut last = (99, 99);
    let mut shown = 0;
    for (t, f) in by.get(&0x281).into_iter().flatten() {
        let v = u64::from_le_bytes(f.data);
        let (q, flags) = ((v >> 44 & 15) as u8, f.data[6]);
        if (q, flags) != last && shown < 40 {
            shown += 1;
            last = (q, flags);
            println!(
                "   OffsetZ at {:9.3} ms: {:8.2} µm, quality {q}, flags {flags:#04x}, age {}",
                seconds(*t) * 1e3,
                signed(v >> 24 & 0xf_ffff, 20) as f64 / 100.0,
                f.data[7]
            );
        }
    }
    if let Some((t, f)) = by.get(&0x281).and_then(|v| v.last()) {
        let v = u64::from_le_bytes(f.data);
        println!(
            "   OffsetZ at {:9.3} ms: {:8.2} µm, quality {}, flags {:#04x}, age {} (last)",
            seconds(*t) * 1e3,
            signed(v >> 24 & 0xf_ffff, 20) as f64 / 100.0,
            v >> 44 & 15,
            f.data[6],
            f.data[7]
        );
    }
}

/// The last temperature of each channel.
fn temperatures(by: &Frames<'_>) {
    let mut temperatures = BTreeMap::new();
    for (_, f) in by.get(&0x381).into_iter().flatten() {
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
