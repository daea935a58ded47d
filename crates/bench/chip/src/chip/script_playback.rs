//! Plays a script: the CNC, the second master, floods, power cuts.

use super::{
    Chip,
    rcc::registers::{
        RCC_CSR_BORRSTF, RCC_CSR_IWDGRSTF, RCC_CSR_PINRSTF, RCC_CSR_PORRSTF, RCC_CSR_SFTRSTF,
    },
};
use crate::{
    can_ids::*,
    frame::{CanFrame, build_protected_frame, compute_e2e_crc},
    processor::SRAM_SIZE,
    script::StimulusScript,
    simulation_time::us_to_ticks,
};

/// 2^64 divided by the golden ratio: its multiples spread over 64 bits.
pub(crate) const GOLDEN_RATIO_MULTIPLIER: u64 = 0x9e37_79b9_7f4a_7c15;

/// The bit of the checksum that a damaged command has wrong.
const CRC_DAMAGE_MASK: u8 = 0x10;
/// The 29 bits of an extended identifier.
const EXTENDED_ID_MASK: u32 = 0x1fff_ffff;
/// First standard identifier that strangers draw: the one after the board's emergencies.
const FIRST_FOREIGN_ID: u32 = EMERGENCY_ID + 1;
/// Number of standard identifiers that strangers draw from.
const FOREIGN_ID_COUNT: u32 = 0x77d;

/// Bytes of two digits each.
fn parse_hex_bytes(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2)
        .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).expect("hex"))
        .collect()
}

/// Returns the number that is word `i` of a line.
fn parse_number(words: &[String], i: usize) -> f64 {
    words.get(i).and_then(|word| word.parse().ok()).unwrap_or_else(|| panic!("script: {words:?}"))
}

impl Chip {
    /// The supply is gone for this many seconds, and what it held. Time itself goes on for the backup domain only.
    pub(crate) fn simulate_power_loss(&mut self, seed: u64, seconds: u64) {
        self.apply_power_loss_to_backup_domain(seconds);
        for i in 0..SRAM_SIZE / 8 {
            let r = seed.wrapping_add(i).wrapping_mul(GOLDEN_RATIO_MULTIPLIER);
            self.sram.write_at(8 * i, &(r ^ r >> 29).to_le_bytes()).unwrap();
        }
        self.rcc.csr = 0;
    }

    /// A flash word is being written.
    pub(crate) fn handle_flash_word_write(&mut self) {
        let Some(s) = &mut self.world.script else { return };
        if s.cut_in > 0 {
            s.cut_in -= 1;
            if s.cut_in == 0 {
                let seed = s.next_random_bits();
                self.abort_flash_operation(seed);
                self.simulate_power_loss(seed, 0);
                self.request_reset(
                    RCC_CSR_PORRSTF | RCC_CSR_PINRSTF | RCC_CSR_BORRSTF,
                    "power, in a flash word",
                );
            }
        }
    }

    /// Once a millisecond.
    pub(crate) fn step_script(&mut self, n: u64) {
        let now = self.now;
        let Some(mut s) = self.world.script.take() else { return };
        while s.lines.front().is_some_and(|l| l.0 <= now) {
            let (at, words) = s.lines.pop_front().unwrap();
            self.execute_script_line(&mut s, at, &words);
        }
        self.send_control_frames(&mut s, n);
        self.send_motion_frames(&mut s, n);
        self.send_flood_frames(&mut s);
        self.queue_serial_bytes(&mut s);
        self.world.script = Some(s);
    }

    /// A line whose time has come.
    fn execute_script_line(&mut self, s: &mut StimulusScript, at: u64, words: &[String]) {
        let now = self.now;
        let number = |i: usize| parse_number(words, i);
        match words[0].as_str() {
            "flags" => s.flags = number(1) as u8,
            "control" => s.period = number(1) as u64,
            "damage" => s.damage = words[1].clone(),
            "flags2" => s.flags2 = number(1) as u8,
            "control2" => s.period2 = number(1) as u64,
            "counter2" => s.counter2 = (number(1) as u8).wrapping_sub(1),
            "rpm" => s.rpm = number(1) as u16,
            "spindle" => s.spindle = number(1) != 0.0,
            "positions" => s.positions = number(1) as u64,
            "feed" => s.feed = number(1),
            "jump" => s.jump = number(1) != 0.0,
            "code" => {
                s.code = number(1);
                s.slope = 0.0;
                s.chatter = None
            }
            "slope" => {
                s.slope = number(1);
                s.since = now
            }
            "pattern" => {
                s.pattern = words[1..].iter().map(|w| w.parse().expect("a code")).collect()
            }
            "noise" => s.noise = number(1),
            "chatter" => s.chatter = Some(number(1)),
            "spike" => s.spike = number(1),
            "rtd" => {
                self.world.rtds[number(1) as usize].celsius = match words[2].as_str() {
                    "open" => None,
                    // As few ohms as there can be.
                    "short" => Some(-242.0),
                    t => Some(t.parse().expect("a temperature")),
                }
            }
            "supply" => self.world.supply = number(1),
            "input" => self.world.inputs[number(1) as usize] = number(2),
            "adc_stall" => self.faults.adc_stalls = now,
            "flood" => s.flood = (words[1].clone(), number(2) as u64),
            "serial_flood" => {
                // Bytes a millisecond; none: as fast as the line.
                s.serial_rate = words.get(2).map_or(0, |_| number(2) as usize);
                s.serial = match words[1].as_str() {
                    "off" => Vec::new(),
                    t => t.replace("\\r", "\r").into_bytes(),
                };
            }
            "say" => self.world.wires[0]
                .to_board
                .extend(words[1].replace("\\r", "\r").bytes().map(|b| (at.max(now), b))),
            "modbus" => {
                let bytes = parse_hex_bytes(&words[1]);
                self.world.wires[1].to_board.extend(bytes.iter().map(|b| (at.max(now), *b)));
            }
            "frame" => {
                let id = u32::from_str_radix(&words[1], 16).expect("hex");
                self.world.queue_can_frame(now, CanFrame::new(id, &parse_hex_bytes(&words[2])));
            }
            "alone" => self.faults.can_alone = number(1) != 0.0,
            "short" => self.faults.can_short = number(1) != 0.0,
            "stuck" => {
                let on = number(1) != 0.0;
                (self.faults.can_stuck, self.faults.can_short) = (on, on);
                if !on {
                    self.handle_can_bus_idle();
                }
            }
            "hse" => {
                if number(1) == 0.0 {
                    self.inject_hse_failure()
                } else {
                    self.faults.hse_dead = false
                }
            }
            "lse" => self.set_lse_running(number(1) != 0.0),
            "cut" => s.cut_in = number(1) as u64,
            // As `reset`, if no `abort_flash_operation` has come before it.
            "reset_if_uncut" if s.cut_in == 0 => {}
            "reset" | "reset_if_uncut" => self.execute_script_reset(s, words),
            _ if self.inject_fault(words) => {}
            _ => panic!("script: {words:?}"),
        }
    }

    /// Resets the board, as `power`, `pin`, `watchdog`, `brown_out` or by software.
    fn execute_script_reset(&mut self, s: &mut StimulusScript, words: &[String]) {
        let (cause, why) = match words[1].as_str() {
            "power" => (RCC_CSR_PORRSTF | RCC_CSR_PINRSTF | RCC_CSR_BORRSTF, "power"),
            "pin" => (RCC_CSR_PINRSTF, "pin"),
            "watchdog" => (RCC_CSR_IWDGRSTF | RCC_CSR_PINRSTF, "watchdog (forced)"),
            // 7.3.21: the brown-out sets BORRSTF alone next to the pin's.
            "brown_out" => (RCC_CSR_PINRSTF | RCC_CSR_BORRSTF, "brown-out"),
            _ => (RCC_CSR_SFTRSTF | RCC_CSR_PINRSTF, "software (forced)"),
        };
        let seed = s.next_random_bits();
        s.cut_in = 0;
        self.abort_flash_operation(seed);
        if why == "power" {
            self.simulate_power_loss(
                seed,
                words.get(2).map_or(0, |_| parse_number(words, 2) as u64),
            );
        }
        self.request_reset(cause, why);
    }

    /// The CNC's own commands, whole or damaged, and those of a second master.
    fn send_control_frames(&mut self, s: &mut StimulusScript, n: u64) {
        let now = self.now;
        if s.period > 0 && n.is_multiple_of(s.period) {
            let body = [s.flags];
            match s.damage.as_str() {
                "crc" => {
                    s.counter = s.counter.wrapping_add(1);
                    let mut f = build_protected_frame(CONTROL_ID, s.counter, &body);
                    f.data[0] ^= CRC_DAMAGE_MASK;
                    self.world.queue_can_frame(now, f);
                }
                "repeat" => self
                    .world
                    .queue_can_frame(now, build_protected_frame(CONTROL_ID, s.counter, &body)),
                "jump" => {
                    s.counter = s.counter.wrapping_add(100);
                    self.world
                        .queue_can_frame(now, build_protected_frame(CONTROL_ID, s.counter, &body));
                }
                _ => {
                    s.counter = s.counter.wrapping_add(1);
                    self.world
                        .queue_can_frame(now, build_protected_frame(CONTROL_ID, s.counter, &body));
                }
            }
        }
        if s.period2 > 0 && (n + 7).is_multiple_of(s.period2) {
            s.counter2 = s.counter2.wrapping_add(1);
            self.world
                .queue_can_frame(now, build_protected_frame(CONTROL_ID, s.counter2, &[s.flags2]));
        }
    }

    /// Speed and positions.
    fn send_motion_frames(&mut self, s: &mut StimulusScript, n: u64) {
        let now = self.now;
        if s.spindle && n % 20 == 10 {
            let rpm = s.rpm.to_le_bytes();
            self.world.queue_can_frame(
                now + us_to_ticks(30),
                build_protected_frame(SPINDLE_ID, (n / 20) as u8, &[rpm[0], rpm[1], 0, 0]),
            );
        }
        if s.positions > 0 && n.is_multiple_of(1000 / s.positions) {
            s.x += s.feed / s.positions as f64;
            for (i, id) in POSITION_IDS.into_iter().enumerate() {
                let mm = if s.jump {
                    30_000.0 * (s.next_random_fraction() - 0.5)
                } else {
                    s.x + 100.0 * i as f64
                };
                let p = ((mm * 1e5) as i32).to_le_bytes();
                let d = if s.feed > 0.0 {
                    1
                } else if s.feed < 0.0 {
                    3
                } else {
                    0
                };
                self.world.queue_can_frame(
                    now + us_to_ticks(10),
                    build_protected_frame(
                        id,
                        (n / (1000 / s.positions)) as u8,
                        &[p[0], p[1], p[2], p[3], d],
                    ),
                );
            }
        }
    }

    /// Frames of strangers.
    fn send_flood_frames(&mut self, s: &mut StimulusScript) {
        let now = self.now;
        for i in 0..s.flood.1 {
            let r = s.next_random_bits();
            let data = (r ^ r.rotate_left(23)).to_le_bytes();
            let mut f = CanFrame::new(FOREIGN_FRAME_ID, &data);
            match s.flood.0.as_str() {
                "foreign" => {
                    f.ext = r >> 40 & 3 == 0;
                    f.id = if f.ext {
                        (r >> 13) as u32 & EXTENDED_ID_MASK
                    } else {
                        FIRST_FOREIGN_ID + (r >> 13) as u32 % FOREIGN_ID_COUNT
                    };
                    f.len = (r >> 7 & 7) as u8 + 1;
                    f.rtr = r >> 50 & 7 == 0;
                    if !f.ext
                        && [
                            OFFSET_XY_ID,
                            OFFSET_Z_ID,
                            STATUS_ID,
                            POSITION_X_ID,
                            SPINDLE_ID,
                            POSITION_Y_ID,
                            CONTROL_ID,
                            POSITION_Z_ID,
                            ROTARY_ID,
                            SDO_RESPONSE_ID,
                            SDO_REQUEST_ID,
                            HEARTBEAT_ID,
                        ]
                        .contains(&f.id)
                    {
                        f.id = FOREIGN_FRAME_ID + 1;
                    }
                }
                // Its own identifiers, as a stranger would send them: no checksum is right.
                _ => {
                    f.id = [
                        CONTROL_ID,
                        POSITION_X_ID,
                        POSITION_Y_ID,
                        POSITION_Z_ID,
                        SPINDLE_ID,
                        ROTARY_ID,
                    ][(r % 6) as usize]
                }
            }
            if f.id < FOREIGN_FRAME_ID
                || f.ext
                || compute_e2e_crc(f.id, &f.data) != u16::from_le_bytes([f.data[0], f.data[1]])
            {
                self.world.queue_can_frame(now + us_to_ticks(100 * i), f);
            }
        }
    }

    /// Puts the script's bytes, or noise, on the serial line.
    fn queue_serial_bytes(&mut self, s: &mut StimulusScript) {
        let now = self.now;
        if !s.serial.is_empty() {
            let most = if s.serial_rate > 0 {
                self.world.wires[0].to_board.len() + s.serial_rate
            } else {
                200
            };
            while self.world.wires[0].to_board.len() < most {
                let bytes: Vec<u8> = if s.serial == b"noise" {
                    (0..8).map(|_| s.next_random_bits() as u8).collect()
                } else {
                    s.serial.clone()
                };
                self.world.wires[0].to_board.extend(bytes.into_iter().map(|b| (now, b)));
            }
        }
    }
}
