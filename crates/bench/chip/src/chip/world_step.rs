//! The world outside, once a millisecond: the CNC speaks, and the client of the serial line.

use super::Chip;
use crate::can_ids::{CONTROL_ID, POSITION_IDS, SPINDLE_ID};
use crate::simulation_time::{ms_to_ticks, us_to_ticks};

impl Chip {
    /// Once a millisecond: the CNC's frames, and what the serial line's client has sent.
    pub(crate) fn step_world(&mut self) {
        let now = self.now;
        let n = now / ms_to_ticks(1);
        if self.faults.stray_write > 0 && now >= self.faults.stray_write {
            self.faults.stray_write = 0;
            self.report_stray_flash_write();
        }
        let w = &mut self.world;
        w.next_at = (n + 1) * ms_to_ticks(1);
        if w.script.is_some() {
            self.step_script(n);
            return self.receive_from_clients();
        }
        if now >= w.plan.cnc_from && now < w.plan.cnc_until {
            if n.is_multiple_of(20) {
                let flags =
                    2 | u8::from(now >= w.plan.engage_at) | u8::from(now >= w.plan.zero_at) << 2;
                w.queue_protected_frame(now, CONTROL_ID, 0, &[flags]);
            }
            if n % 20 == 10 {
                let rpm = w.plan.rpm.to_le_bytes();
                w.queue_protected_frame(
                    now + us_to_ticks(30),
                    SPINDLE_ID,
                    1,
                    &[rpm[0], rpm[1], 0, 0],
                );
            }
            if w.plan.positions > 0 && n.is_multiple_of(1000 / w.plan.positions) {
                for (i, id) in POSITION_IDS.into_iter().enumerate() {
                    let mm = 100.0 + n as f64 * 1e-3 * (i as f64 + 1.0);
                    let p = ((mm * 1e5) as i32).to_le_bytes();
                    w.queue_protected_frame(
                        now + us_to_ticks(10),
                        id,
                        2 + i,
                        &[p[0], p[1], p[2], p[3], 1],
                    );
                }
            }
        }
        self.receive_from_clients();
    }

    /// Receives the bytes of the hosts of the wires.
    fn receive_from_clients(&mut self) {
        for n in 0..self.uart.len() {
            self.world.wires[n].receive_from_client(self.now);
            self.schedule_uart_reception(n);
        }
    }
}
