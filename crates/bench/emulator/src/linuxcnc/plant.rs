//! The machine in the loop: LinuxCNC moves its joints, the twin is the metal, the board is the
//! bridge.
//!
//! ```text
//!  LinuxCNC ─ sampler, every servo cycle ─► twin ─► volts, temperatures ─► bridge (QEMU or chip)
//!     ▲                                      └► true tool-tip error ─► record   │ SLCAN
//!     └─ external offset ◄─ trueup linuxcnc ◄───────────────────────────────────┘
//! ```
//!
//! In QEMU the board's clock is the machine's: a second of the wall is `factor` seconds of both. On the
//! model of the chip a second of the board is some of the wall, and `factor` seconds of the machine; the
//! record then has one servo cycle in this many, so that a cycle is a millisecond of the machine on both.
//! LinuxCNC lives in real time throughout. Two machines of the same make and seed are stepped: one receives
//! what LinuxCNC really commands its motors, with the offsets; the other receives the same less the
//! external offset that LinuxCNC reports, and so is the machine without compensation.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::ChildStdout,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering},
        mpsc::{self, Receiver, Sender},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, anyhow, bail};
use trueup_twin::machine::{DriveCommand, SimulatedMachine};

use super::emulated_bridge::EmulatedBridge;
use crate::board::MAX_BATCH_BLOCKS;

/// At real time the board may fall behind the clock by this much before its time slips. Compressed time
/// goes as fast as it can, and nothing waits. The model of the chip takes long to catch up, and its offsets
/// would be late until then: there a slow computer makes the board's time slower instead.
const MAX_BACKLOG_MS: f64 = 500.0;
const MAX_CHIP_BACKLOG_MS: f64 = 10.0;
/// While time is compressed, board and machine wait for a CNC that has been silent for this time: a
/// stall of this computer would count for a minute.
const CNC_SILENCE_TIMEOUT: Duration = Duration::from_millis(60);
/// How fast the spindle's drive changes its speed, in r/min a second of the machine.
const SPINDLE_ACCELERATION_RPM_PER_S: f64 = 4_800.0;
/// How often the loop looks when nothing is due.
const POLL_INTERVAL: Duration = Duration::from_micros(200);
/// Maximum silence of the real-time thread.
const REALTIME_TIMEOUT: Duration = Duration::from_secs(20);

/// The pins that `sampler` writes down, in this order; all are floats.
pub(crate) const SAMPLER_PINS: [&str; 12] = [
    // At the joint: what the drives get.
    "joint.0.motor-pos-cmd",
    "joint.1.motor-pos-cmd",
    "joint.2.motor-pos-cmd",
    // The head: C is next to the frame, A next to the tool.
    "joint.4.motor-pos-cmd",
    "joint.3.motor-pos-cmd",
    // At the joint: what `moveoff` adds.
    "axis.x.eoffset",
    "axis.y.eoffset",
    "axis.z.eoffset",
    "spindle.0.speed-out",
    "motion.analog-out-00",
    "motion.analog-out-01",
    "motion.analog-out-02",
];

/// One servo cycle.
#[derive(Clone, Copy, Debug, Default)]
pub struct ServoCycle {
    /// Its number, as `sampler` counts.
    pub number: u64,
    /// The machine's time in seconds.
    pub time_s: f64,
    /// Where the motors of X, Y and Z are sent, in mm.
    pub motor_mm: [f64; 3],
    /// Where the head's axes are sent, in degrees.
    pub head_deg: [f64; 2],
    /// The external offset that LinuxCNC applies, in mm.
    pub eoffset_mm: [f64; 3],
    /// The program's present step, in its own words.
    pub phase: u32,
    /// The pass that the program belongs to.
    pub pass: u32,
    /// The true error of the tool tip with compensation, in µm: what LinuxCNC has added is in it.
    pub with_um: [f64; 3],
    /// The same without.
    pub without_um: [f64; 3],
    /// How far the tool has grown, in µm.
    pub growth_um: f64,
    /// The speed that the spindle has, in r/min.
    pub spindle_rpm: f64,
}

impl ServoCycle {
    /// Where the program wants the tool tip, in mm.
    #[must_use]
    pub(crate) fn commanded_mm(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.motor_mm[axis] - self.eoffset_mm[axis])
    }
}

/// Requests to the loop, and its answers.
#[derive(Default)]
struct LoopState {
    factor: AtomicU32,
    stop: AtomicBool,
    board_ms: AtomicU64,
    slipped_ms: AtomicU64,
    lost_samples: AtomicU64,
    cycles: Mutex<Vec<ServoCycle>>,
    log: Mutex<Vec<String>>,
    swap: AtomicBool,
}

/// Result of the loop.
#[derive(Clone, Copy, Debug)]
pub struct LoopCounters {
    /// Milliseconds of the board.
    pub board_ms: u64,
    /// Milliseconds that the board should have lived through at real time and has not: this computer
    /// was too slow.
    pub slipped_ms: u64,
    /// Servo cycles that `sampler` could not keep.
    pub lost_samples: u64,
    /// Pairs of offsets passed on to LinuxCNC, and frames received from it, where they are counted.
    pub traffic: Option<(u64, u64)>,
}

/// State that the loop's thread leaves.
type FrameCounts = Option<(u64, u64)>;

/// The running machine.
pub struct RunningPlant {
    shared: Arc<LoopState>,
    to_loop: Sender<HalSample>,
    thread: Option<JoinHandle<Result<FrameCounts>>>,
    slower: u32,
    address: String,
    library: Option<PathBuf>,
    channels: Vec<u8>,
}

impl RunningPlant {
    /// Lets a machine live at a running bridge.
    ///
    /// # Errors
    /// The bridge listens nowhere.
    pub fn start(bridge: EmulatedBridge, twin: SimulatedMachine) -> Result<Self> {
        let (address, slower) = (bridge.address()?, bridge.slowdown_factor());
        let (library, channels) =
            (bridge.component_library().map(Path::to_path_buf), bridge.temperature_channels());
        let shared = Arc::new(LoopState { factor: AtomicU32::new(1), ..LoopState::default() });
        let (to_loop, samples) = mpsc::channel();
        let theirs = shared.clone();
        let thread = thread::spawn(move || SimulationLoop::new(twin, samples, theirs).run(bridge));
        Ok(Self { shared, to_loop, thread: Some(thread), slower, address, library, channels })
    }

    /// Returns the library of the component, and the channels of the thermometers, where there is no board.
    #[must_use]
    pub(crate) fn servo_component(&self) -> Option<(&Path, &[u8])> {
        self.library.as_deref().map(|library| (library, &self.channels[..]))
    }

    /// Where the bridge is to be found by the CNC.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Returns a second of the machine in motion, in seconds of the wall.
    #[must_use]
    pub(crate) fn slowdown_factor(&self) -> u32 {
        self.slower
    }

    /// Takes in LinuxCNC's servo cycles from now on.
    pub(crate) fn attach_sampler(&self, lines: ChildStdout) {
        let (to_loop, shared) = (self.to_loop.clone(), self.shared.clone());
        thread::spawn(move || {
            for line in BufReader::new(lines).lines().map_while(Result::ok) {
                match HalSample::parse(&line) {
                    Some(sample) if to_loop.send(sample).is_ok() => {}
                    Some(_) => return,
                    // `overrun`: nothing was kept of some cycles.
                    None => _ = shared.lost_samples.fetch_add(1, Ordering::Relaxed),
                }
            }
        });
    }

    /// Lets time pass this many times as fast for the machine.
    pub(crate) fn set_time_compression(&self, factor: u32) {
        self.shared.factor.store(factor, Ordering::Relaxed);
    }

    /// Takes the board's power and gives it the machine file of the warm-up.
    pub(crate) fn restart_for_warm_up(&self) {
        self.shared.swap.store(true, Ordering::Relaxed);
    }

    /// Returns the newest servo cycle.
    #[must_use]
    pub(crate) fn latest_cycle(&self) -> Option<ServoCycle> {
        lock(&self.shared.cycles).last().copied()
    }

    /// Returns what the board has logged since it was last asked.
    #[must_use]
    pub(crate) fn take_log(&self) -> Vec<String> {
        std::mem::take(&mut lock(&self.shared.log))
    }

    /// Fails if the loop has ended; with why.
    ///
    /// # Errors
    /// It has.
    pub(crate) fn check_running(&mut self) -> Result<()> {
        if self.thread.as_ref().is_some_and(JoinHandle::is_finished) {
            self.stop_and_join()?;
            bail!("the loop has ended");
        }
        Ok(())
    }

    /// Ends the loop and gives all cycles.
    ///
    /// # Errors
    /// It had ended before, for a reason of its own.
    pub fn finish(mut self) -> Result<(Vec<ServoCycle>, LoopCounters)> {
        let traffic = self.stop_and_join()?;
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let account = LoopCounters {
            board_ms: load(&self.shared.board_ms),
            slipped_ms: load(&self.shared.slipped_ms),
            lost_samples: load(&self.shared.lost_samples),
            traffic,
        };
        Ok((std::mem::take(&mut lock(&self.shared.cycles)), account))
    }

    fn stop_and_join(&mut self) -> Result<FrameCounts> {
        self.shared.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().context("the loop has ended before")?;
        thread.join().map_err(|_| anyhow!("the loop has panicked"))?
    }
}

impl Drop for RunningPlant {
    fn drop(&mut self) {
        if self.thread.is_some() {
            // The reason of its end is reported by its owner.
            self.stop_and_join().ok();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A servo cycle, as `sampler` has recorded it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct HalSample {
    number: u64,
    pins: [f64; SAMPLER_PINS.len()],
}

impl HalSample {
    /// Returns the cycle's number, then the pins.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_ascii_whitespace();
        let number = words.next()?.parse().ok()?;
        let mut pins = [0.0; SAMPLER_PINS.len()];
        for pin in &mut pins {
            *pin = words.next()?.parse().ok()?;
        }
        Some(Self { number, pins })
    }

    fn to_servo_cycle(self) -> ServoCycle {
        let [x, y, z, c, a, ex, ey, ez, spindle_rpm, _, phase, pass] = self.pins;
        ServoCycle {
            number: self.number,
            motor_mm: [x, y, z],
            head_deg: [c, a],
            eoffset_mm: [ex, ey, ez],
            phase: round_to_u32(phase),
            pass: round_to_u32(pass),
            spindle_rpm,
            ..ServoCycle::default()
        }
    }

    fn load_n(&self) -> f64 {
        self.pins[9]
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a cast saturates")]
fn round_to_u32(value: f64) -> u32 {
    value.round() as u32
}

/// The loop itself.
struct SimulationLoop {
    with: SimulatedMachine,
    without: SimulatedMachine,
    samples: Receiver<HalSample>,
    shared: Arc<LoopState>,
    /// Milliseconds of the machine that the board has lived through and the machine has not.
    ahead_ms: f64,
    last_received: Option<Instant>,
    /// Speed that the spindle's drive has reached, in r/min.
    spindle_rpm: f64,
}

impl SimulationLoop {
    fn new(twin: SimulatedMachine, samples: Receiver<HalSample>, shared: Arc<LoopState>) -> Self {
        Self {
            with: twin.clone(),
            without: twin,
            samples,
            shared,
            ahead_ms: 0.0,
            last_received: None,
            spindle_rpm: 0.0,
        }
    }

    fn run(mut self, mut bridge: EmulatedBridge) -> Result<FrameCounts> {
        let mut owed_ms = 0.0;
        let mut last = Instant::now();
        while !self.shared.stop.load(Ordering::Relaxed) {
            if self.shared.swap.swap(false, Ordering::Relaxed) {
                // A power cut, and another machine file behind it.
                bridge = bridge.restart_for_warm_up()?;
                last = Instant::now();
                self.last_received = self.last_received.map(|_| last);
            }
            let factor = self.shared.factor.load(Ordering::Relaxed);
            let [of_board, of_machine] = bridge.time_ratios(factor);
            let now = Instant::now();
            owed_ms += now.duration_since(last).as_secs_f64() * 1e3 * of_board;
            last = now;
            let is_compressed = of_board > 1.0;
            let most_ms = match of_board {
                more if more > 1.0 => f64::from(MAX_BATCH_BLOCKS),
                1.0 => MAX_BACKLOG_MS,
                _ => MAX_CHIP_BACKLOG_MS,
            };
            if owed_ms > most_ms {
                if !is_compressed {
                    let slipped = (owed_ms - most_ms).round();
                    self.shared.slipped_ms.fetch_add(floor_to_u64(slipped), Ordering::Relaxed);
                }
                owed_ms = most_ms;
            }
            if is_compressed && !self.is_cnc_alive(&bridge) {
                owed_ms = 0.0;
            }
            let due = owed_ms.floor().min(f64::from(MAX_BATCH_BLOCKS));
            self.process_samples(bridge.slowdown_factor())?;
            if bridge.is_clocked_by_cnc() && self.last_received.is_none() {
                owed_ms = 0.0;
                thread::sleep(POLL_INTERVAL);
                continue;
            }
            if due < 1.0 {
                thread::sleep(POLL_INTERVAL);
                continue;
            }
            owed_ms -= due;
            self.advance(&mut bridge, floor_to_u64(due), factor)?;
            self.ahead_ms += due * of_machine;
        }
        bridge.shut_down()
    }

    /// Returns whether both halves of the CNC, its real-time part and the component, have just been received.
    fn is_cnc_alive(&self, bridge: &EmulatedBridge) -> bool {
        let moves =
            self.last_received.is_some_and(|received| received.elapsed() < CNC_SILENCE_TIMEOUT);
        moves && bridge.has_received_from_cnc_within(CNC_SILENCE_TIMEOUT)
    }

    /// Lets the board live through this many milliseconds of the machine as it stands.
    fn advance(&mut self, bridge: &mut EmulatedBridge, ms: u64, factor: u32) -> Result<()> {
        let shown = self.with.read_temperatures_c().into_iter();
        let celsius = shown.map(|(column, shown_c)| (column.to_owned(), shown_c)).collect();
        bridge.advance(ms, factor, || self.with.read_sensor_volts().unwrap_or(0.0), &celsius)?;
        self.shared.board_ms.fetch_add(ms, Ordering::Relaxed);
        let log = bridge.take_log();
        if !log.is_empty() {
            lock(&self.shared.log).extend(log);
        }
        Ok(())
    }

    /// Lets the machine do what LinuxCNC has commanded meanwhile. Its time is the board's, spread
    /// evenly over the servo cycles that have come.
    fn process_samples(&mut self, slower: u32) -> Result<()> {
        if slower > 1 && self.ahead_ms <= 0.0 {
            // Frames within a millisecond of the board belong to it.
            return Ok(());
        }
        let samples: Vec<HalSample> = self.samples.try_iter().collect();
        if samples.is_empty() {
            if self.last_received.is_some_and(|received| received.elapsed() > REALTIME_TIMEOUT) {
                bail!("LinuxCNC's real-time part has been silent for {REALTIME_TIMEOUT:?}");
            }
            return Ok(());
        }
        self.last_received = Some(Instant::now());
        if self.ahead_ms <= 0.0 {
            // The board is behind: the machine waits for it, but its axes move on.
            self.ahead_ms = MIN_MACHINE_STEP_MS * samples.len() as f64;
        }
        let dt_s = self.ahead_ms / 1e3 / samples.len() as f64;
        self.ahead_ms = 0.0;
        let mut cycles = Vec::with_capacity(samples.len());
        for sample in &samples {
            let mut cycle = sample.to_servo_cycle();
            let most = SPINDLE_ACCELERATION_RPM_PER_S * dt_s;
            self.spindle_rpm += (cycle.spindle_rpm - self.spindle_rpm).clamp(-most, most);
            cycle.spindle_rpm = self.spindle_rpm;
            let command = |position_mm: [f64; 3]| DriveCommand {
                position_mm,
                head_deg: cycle.head_deg,
                spindle_rpm: cycle.spindle_rpm,
                load_n: sample.load_n(),
                ..DriveCommand::default()
            };
            self.with.step(dt_s, &command(cycle.motor_mm));
            self.without.step(dt_s, &command(cycle.commanded_mm()));
            let machine_um = self.with.tip_error_um();
            cycle.with_um =
                std::array::from_fn(|axis| machine_um[axis] + cycle.eoffset_mm[axis] * 1e3);
            cycle.without_um = self.without.tip_error_um();
            cycle.growth_um = self.without.elongation_um();
            cycle.time_s = self.with.time_s();
            if sample.number.is_multiple_of(slower.into()) {
                cycle.number /= u64::from(slower);
                cycles.push(cycle);
            }
        }
        lock(&self.shared.cycles).append(&mut cycles);
        Ok(())
    }
}

/// The machine's time goes on by at least this much in a servo cycle.
const MIN_MACHINE_STEP_MS: f64 = 1e-3;

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, not negative")]
fn floor_to_u64(ms: f64) -> u64 {
    ms as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_sampler_is_a_cycle() {
        let sample =
            HalSample::parse("17 1 2 3 90 -30 0.01 0.02 -0.03 24000 150 4 2 ").expect("whole");
        let cycle = sample.to_servo_cycle();
        assert_eq!((cycle.number, cycle.phase, cycle.pass), (17, 4, 2));
        assert_eq!((cycle.head_deg, cycle.commanded_mm()[2]), ([90.0, -30.0], 3.03));
        assert_eq!(sample.load_n(), 150.0);
        assert_eq!(HalSample::parse("overrun"), None);
    }
}
