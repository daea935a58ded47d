//! The hand at the CNC of a virtual bridge: what is typed where the bridge was started. From the first
//! `engage` or `disengage` on the bridge receives a CNC on its bus, homed and with `Engage` or without, where it
//! allows that it is written to; `confirm` answers a question of the bridge; `close` and `open` move the service
//! switch of the board; `again` plays the run from its start; `gauge` prints what gauges at the machine show. So that a
//! commissioning can be rehearsed, whose tool has the only line.

use std::{
    io::{self, IsTerminal as _},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU32, Ordering},
    },
    thread,
    time::Duration,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::getpgrp,
    termios::tcgetpgrp,
};
use trueup_core::cnc::Control;

use crate::gauge::SimulatedGauge;

/// How often it is looked whether this command has the terminal.
const TERMINAL_POLL_INTERVAL: Duration = Duration::from_millis(200);
/// A CNC that comes up does not engage at once: a bridge wants to have seen it without, as after a restart.
const STARTUP_MS: u32 = 300;
/// How long `Confirm` is pressed, and before that released: an edge is believed after three frames each.
const CONFIRM_CYCLE_MS: u32 = 400;
const CONFIRM_PRESS_MS: u32 = 200;

/// The state that the typed commands have set.
#[derive(Clone, Debug, Default)]
pub struct OperatorControls {
    control: Arc<Mutex<Option<Control>>>,
    /// This many milliseconds of the board are left in which the CNC is up and has not engaged yet.
    comes_up_ms: Arc<AtomicU32>,
    /// This many are left of an edge of `Confirm`.
    confirms_ms: Arc<AtomicU32>,
    again: Arc<AtomicBool>,
    switch_is_closed: Arc<AtomicBool>,
}

impl OperatorControls {
    /// Returns a hand that types at standard input, next to this gauge.
    #[must_use]
    pub(crate) fn from_stdin(gauge: SimulatedGauge) -> Self {
        let hand = Self::default();
        let typed = hand.clone();
        thread::spawn(move || {
            let mut line = String::new();
            while wait_for_input_line() {
                line.clear();
                match io::stdin().read_line(&mut line) {
                    Ok(1..) if line.trim() == "gauge" => {
                        trueup_output::write_diagnostic(gauge.describe())
                    }
                    Ok(1..) => trueup_output::write_diagnostic(typed.handle_command(line.trim())),
                    _ => return,
                }
            }
        });
        hand
    }

    /// Takes a word; returns the reply.
    fn handle_command(&self, word: &str) -> &'static str {
        let control = |engage| {
            let control = Control { engage, service: !engage, ..Control::REFERENCED };
            let before = self.lock_control().replace(control);
            let comes_up_ms = if before.is_none() { STARTUP_MS } else { 0 };
            self.comes_up_ms.store(comes_up_ms, Ordering::Relaxed);
        };
        match word {
            "engage" => {
                control(true);
                "the CNC engages"
            }
            "disengage" => {
                control(false);
                "the CNC has disengaged"
            }
            "confirm" => {
                if self.lock_control().is_none() {
                    return "there is no CNC yet: engage or disengage first";
                }
                self.confirms_ms.store(CONFIRM_CYCLE_MS, Ordering::Relaxed);
                "the operator confirms what the bridge requires first"
            }
            "again" => {
                self.again.store(true, Ordering::Relaxed);
                "the machine is cold; the run begins when the bridge has followed"
            }
            "close" => {
                self.switch_is_closed.store(true, Ordering::Relaxed);
                "the service switch is closed"
            }
            "open" => {
                self.switch_is_closed.store(false, Ordering::Relaxed);
                "the service switch is open"
            }
            _ => {
                "engage, disengage, confirm, gauge (what gauges show), again (the run from its start), close or open \
                 (the service switch)"
            }
        }
    }

    fn lock_control(&self) -> MutexGuard<'_, Option<Control>> {
        self.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what the CNC says in the next millisecond of the board; `None`: there is none on the bus.
    #[must_use]
    pub(crate) fn next_control(&self) -> Option<Control> {
        let control = *self.lock_control();
        let left = self.comes_up_ms.load(Ordering::Relaxed);
        self.comes_up_ms.store(left.saturating_sub(1), Ordering::Relaxed);
        let confirms = self.confirms_ms.load(Ordering::Relaxed);
        self.confirms_ms.store(confirms.saturating_sub(1), Ordering::Relaxed);
        let confirm = (1..=CONFIRM_PRESS_MS).contains(&confirms);
        let control = control.map(|control| Control { confirm, ..control });
        if left > 0 { control.map(|_| Control::REFERENCED) } else { control }
    }

    /// Returns whether the service switch of the board is closed; it begins open.
    #[must_use]
    pub(crate) fn is_service_switch_closed(&self) -> bool {
        self.switch_is_closed.load(Ordering::Relaxed)
    }

    /// Returns whether the run is to begin again, once.
    #[must_use]
    pub(crate) fn take_restart_request(&self) -> bool {
        self.again.swap(false, Ordering::Relaxed)
    }
}

/// Waits until a line is there to be read; `false`: never. A command in the background that reads its terminal
/// is stopped, so it does not.
fn wait_for_input_line() -> bool {
    let stdin = io::stdin();
    if !stdin.is_terminal() {
        return true;
    }
    let timeout = Timespec::try_from(TERMINAL_POLL_INTERVAL).ok();
    loop {
        if !tcgetpgrp(&stdin).is_ok_and(|group| group == getpgrp()) {
            thread::sleep(TERMINAL_POLL_INTERVAL);
            continue;
        }
        let mut poll_fds = [PollFd::new(&stdin, PollFlags::IN)];
        match poll(&mut poll_fds, timeout.as_ref()) {
            Ok(1..) => return true,
            // Nothing was typed, or a signal came.
            Ok(0) | Err(rustix::io::Errno::INTR) => {}
            Err(_) => return false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_taken_and_others_say_which_there_are() {
        let hand = OperatorControls::default();
        assert_eq!((hand.next_control(), hand.take_restart_request()), (None, false));
        hand.handle_command("engage");
        for _ in 0..STARTUP_MS {
            assert_eq!(hand.next_control(), Some(Control::REFERENCED), "it has just come up");
        }
        assert_eq!(hand.next_control(), Some(Control::ENGAGED));
        assert!(hand.handle_command("on").contains("disengage"));
        assert_eq!(hand.next_control(), Some(Control::ENGAGED));
        hand.handle_command("disengage");
        assert_eq!(hand.next_control(), Some(Control { service: true, ..Control::REFERENCED }));
        hand.handle_command("engage");
        assert_eq!(hand.next_control(), Some(Control::ENGAGED), "it was up");
        hand.handle_command("confirm");
        let pressed = (0..=CONFIRM_CYCLE_MS)
            .filter(|_| hand.next_control().is_some_and(|control| control.confirm));
        assert_eq!(pressed.count() as u32, CONFIRM_PRESS_MS);
        hand.handle_command("again");
        assert_eq!((hand.take_restart_request(), hand.take_restart_request()), (true, false));
    }
}
