//! A LinuxCNC that is abused: each way of entering offsets, where its figures are, and how it is brought in order again.

use std::{sync::mpsc::Receiver, thread, time::Duration};

use anyhow::{Context as _, Result, ensure};
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use trueup_emulator::{
    linuxcnc::headless_linuxcnc::{HeadlessLinuxCnc, SamplerGuard},
    setup::LockedLinuxCnc,
};
use trueup_machine::{MachineFile, compile};

use super::{
    super::{
        HEADROOM, MAX_ACCELERATION, MAX_VELOCITY, SLEW,
        events::load_component,
        fake_bridge::FakeBridge,
        joint_signals, no_board,
        record::{Cycle, record},
        stock,
        stock_files::ini,
    },
    judge::{Bounds, Entry, Judge, off_um},
};

/// The slew limit of external offsets, in mm/s: 0.8 % of the axis' speed, and so of its acceleration, is reserved.
const EOFFSET_SLEW: f64 = 0.24;
/// Largest offsets of the machine files, in mm.
const SIZE: [f64; 3] = [0.2, 0.2, 0.5];
/// An offset that is there is within this of where it has to be, in µm: X by its home switch, which is left at 0.1 mm/s
/// and seen in a servo cycle.
const OFF_UM: [f64; 3] = [0.35, 0.05, 0.05];
/// Places of X and Y between events, in mm.
const ROOM: f64 = 8.0;
/// The zero of the sensor without a board, in volts, and micrometres a volt.
const SENSOR: (f64, f64) = (1.540_527_3, 50.0);
/// The sensor moves by this at most, in µm: a spindle grows slowly.
const GROWS_UM: f64 = 20.0;
/// An offset without a board is right within this, in µm: by position (a wire bit is 10 nm), by the sensor, whose noise
/// is a sine of 0.1 µm.
const SCREW_WITHIN_UM: f64 = 0.05;
const SENSOR_WITHIN_UM: f64 = 0.2;
/// The backlash of Y in the machine file, in µm.
const BACKLASH_UM: f64 = 6.0;

/// Offsets of the bridge, in µm.
const OFFSETS: [&str; 3] = ["trueup.0.x-offset-um", "trueup.0.y-offset-um", "trueup.0.z-offset-um"];

/// A way of entering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// At the joint, with a bridge.
    Joint,
    /// As external offset, with a bridge.
    Eoffset,
    /// At the joint, without a board.
    NoBoard,
}

impl Way {
    pub(crate) const ALL: [Self; 3] = [Self::Joint, Self::Eoffset, Self::NoBoard];

    /// Returns the way with this word.
    pub(crate) fn parse(word: &str) -> Result<Self> {
        let way = Self::ALL.into_iter().find(|way| way.word() == word);
        way.with_context(|| format!("\"{word}\" is no way: joint, eoffset or no-board"))
    }

    /// Returns its word on the command line.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Eoffset => "eoffset",
            Self::NoBoard => "no-board",
        }
    }

    /// Returns what it is called in the table.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Joint => "at the joint",
            Self::Eoffset => "external offset",
            Self::NoBoard => "at the joint, without a board",
        }
    }

    fn bounds(self) -> Bounds {
        let planner = [MAX_VELOCITY, MAX_ACCELERATION];
        match self {
            Self::Joint | Self::NoBoard => Bounds {
                entry: Entry::Joint,
                planner,
                offset: [SLEW, HEADROOM * MAX_ACCELERATION],
                drive: [MAX_VELOCITY + SLEW, (1.0 + HEADROOM) * MAX_ACCELERATION],
                size: SIZE,
            },
            Self::Eoffset => Bounds {
                entry: Entry::Eoffset,
                planner,
                offset: planner.map(|of_axis| of_axis * EOFFSET_SLEW / MAX_VELOCITY),
                drive: planner,
                size: SIZE,
            },
        }
    }

    /// Returns the signals that are recorded, in the order of [`Cycle`].
    fn signals(self) -> Vec<String> {
        if self != Self::Eoffset {
            return joint_signals();
        }
        let axes = |end: &'static str| ["x", "y", "z"].map(|axis| format!("trueup-{axis}-{end}"));
        let drives = ["Xpos", "Ypos", "Zpos"].map(String::from);
        let mut signals: Vec<String> = axes("cmd").into_iter().chain(drives).collect();
        signals.extend(axes("eoff").into_iter().chain(axes("req")));
        signals.extend(["trueup-x-req", "trueup-on"].map(String::from));
        signals.extend((0..3).map(|joint| format!("reference-{joint} joint.{joint}.motor-offset")));
        signals.push("event screen.scenario".into());
        signals
    }

    /// Returns the pins of what the drives get.
    fn drives(self) -> [String; 3] {
        [0, 1, 2].map(|joint| match self {
            Self::Eoffset => format!("joint.{joint}.motor-pos-cmd"),
            Self::Joint | Self::NoBoard => format!("trueup-j{joint}.out"),
        })
    }
}

/// Returns true if the offsets of the bridge without a board are right, by what the machine file says of this place and
/// this growth, in µm: X by its screw, Y by its backlash, Z by the sensor.
fn is_right(offset_um: &[f64], x_mm: f64, growth_um: f64) -> bool {
    let within = |axis: usize, right: f64, um: f64| (offset_um[axis] - right).abs() <= um;
    within(0, -no_board::error_um(x_mm), SCREW_WITHIN_UM)
        && [0.0, -BACKLASH_UM].into_iter().any(|right| within(1, right, SCREW_WITHIN_UM))
        && within(2, growth_um, SENSOR_WITHIN_UM)
}

/// One that is abused.
pub(crate) struct Abused {
    pub way: Way,
    pub cnc: HeadlessLinuxCnc,
    /// None without a board.
    pub bridge: Option<FakeBridge>,
    /// CRC of the calibration that the component expects.
    pub calibration: u32,
    pub random: ChaCha8Rng,
    pub judge: Judge,
    sent_um: [f64; 3],
    /// By how much each axis was off when all was in order last, in µm.
    pub off_um: [f64; 3],
    cycles: Receiver<Option<Cycle>>,
    _sampler: SamplerGuard,
}

impl Abused {
    pub(crate) fn start(way: Way, control: LockedLinuxCnc, seed: u64) -> Result<Self> {
        let (mut cnc, bridge) = match way {
            Way::NoBoard => (no_board::start(control, "joint", 1_000)?, None),
            Way::Joint | Way::Eoffset => {
                let bridge = FakeBridge::start()?;
                let (by, slew) = match way {
                    Way::Eoffset => ("eoffset", EOFFSET_SLEW),
                    _ => ("joint", SLEW),
                };
                (stock(control, &ini(), by, slew, &bridge)?, Some(bridge))
            }
        };
        let machine = MachineFile::read(&cnc.folder().join("machine.toml"))?;
        let calibration = compile(&machine)?.crc();
        if let Some(bridge) = &bridge {
            bridge.run_on(calibration);
        }
        let (sampler, cycles) = record(&mut cnc, &way.signals())?;
        let mut rig = Self {
            way,
            cnc,
            bridge,
            calibration,
            random: ChaCha8Rng::seed_from_u64(seed),
            judge: Judge::new(way.bounds()),
            sent_um: [0.0; 3],
            off_um: [0.0; 3],
            cycles,
            _sampler: sampler,
        };
        rig.cnc.power_on_and_home()?;
        rig.mdi("G53 G0 X-5 Y0 Z-1")?;
        rig.settle()?;
        Ok(rig)
    }

    /// Draws a number of this range.
    pub(crate) fn draw(&mut self, from: f64, to: f64) -> f64 {
        self.random.random_range(from..to)
    }

    /// Waits for a drawn time.
    pub(crate) fn rest(&mut self, from_ms: u64, to_ms: u64) {
        let ms = self.random.random_range(from_ms..=to_ms);
        thread::sleep(Duration::from_millis(ms));
    }

    /// Lets the bridge say these offsets; without a board the sensor says that of Z.
    pub(crate) fn set_offset(&mut self, um: [f64; 3]) -> Result<()> {
        self.sent_um = um;
        if let Some(bridge) = &self.bridge {
            bridge.set_offset(um);
            return Ok(());
        }
        let (zero, um_per_volt) = SENSOR;
        self.sensor(zero + um[2] / um_per_volt)
    }

    /// Sets the sensor without a board, in volts.
    pub(crate) fn sensor(&mut self, volts: f64) -> Result<()> {
        self.cnc.set_pin("siggen.0.offset", volts)
    }

    /// Lets the bridge say offsets that are drawn.
    pub(crate) fn say_any(&mut self) -> Result<()> {
        let largest = match self.way {
            Way::Joint => [150.0, 150.0, 200.0],
            // Slower by five times.
            Way::Eoffset => [40.0; 3],
            Way::NoBoard => [0.0, 0.0, GROWS_UM],
        };
        let um = largest.map(|most| most * self.random.random_range(-1.0..1.0));
        self.set_offset(um)
    }

    /// Returns a place: X on the other side of where it is now, so that it moves far enough to reach all of its
    /// acceleration.
    pub(crate) fn place(&mut self) -> Result<[f64; 3]> {
        let x = self.cnc.read_pin("axis.x.pos-cmd")?;
        let other_side = if x > 0.0 { -1.0 } else { 1.0 };
        Ok([
            other_side * self.draw(ROOM / 4.0, ROOM),
            self.draw(-ROOM, ROOM),
            self.draw(-2.5, -0.5),
        ])
    }

    pub(crate) fn mdi(&mut self, text: &str) -> Result<()> {
        self.cnc.send_request_with_argument("mdi", "text", text).map(drop)
    }

    /// Waits until nothing moves and the interpreter has nothing to do.
    pub(crate) fn idle(&mut self) -> Result<()> {
        self.cnc.send_request(&json!({ "do": "idle" })).map(drop)
    }

    /// Returns the state of LinuxCNC.
    pub(crate) fn stat(&mut self) -> Result<Value> {
        self.cnc.send_request(&json!({ "do": "stat" }))
    }

    /// Returns what the drives get, in mm.
    pub(crate) fn drives(&mut self) -> Result<[f64; 3]> {
        let names = self.way.drives();
        let seen = self.cnc.read_pins(&names.each_ref().map(String::as_str))?;
        seen.try_into().ok().context("three drives")
    }

    /// Returns the offsets that act, in mm, by the pins of LinuxCNC.
    pub(crate) fn acting(&mut self) -> Result<[f64; 3]> {
        let names = match self.way {
            Way::Eoffset => ["axis.x.eoffset", "axis.y.eoffset", "axis.z.eoffset"],
            Way::Joint | Way::NoBoard => {
                ["trueup-j0.offset", "trueup-j1.offset", "trueup-j2.offset"]
            }
        };
        self.cnc.read_pins(&names)?.try_into().ok().context("three offsets")
    }

    /// Waits until the offsets act that the bridge says; without a board those that are right for place and growth.
    pub(crate) fn applied(&mut self) -> Result<()> {
        let pins = ["axis.x.pos-cmd", "trueup.0.fault", "trueup.0.applied"];
        let names = [&OFFSETS[..], &pins].concat();
        let (sent_um, way) = (self.sent_um, self.way);
        // Pins are read one after the other: twice, so that all are of one state.
        for _ in 0..2 {
            self.cnc.wait_for_pins(&format!("{sent_um:.3?} act"), 15, &names, |seen| {
                let is_there = match way {
                    Way::NoBoard => is_right(&seen[..3], seen[3], sent_um[2]),
                    _ => (0..3).all(|axis| (seen[axis] - sent_um[axis]).abs() < 0.02),
                };
                is_there && seen[4..] == [0.0, 1.0]
            })?;
            thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    /// Brings everything in order: the bridge lives, the machine is on, homed and in teleop mode, the offsets act. Then
    /// nothing may be lost; returns by how much each axis is off, in µm.
    pub(crate) fn settle(&mut self) -> Result<[f64; 3]> {
        if let Some(bridge) = &self.bridge {
            bridge.silence(false);
            bridge.kill(false);
            bridge.run_on(self.calibration);
        }
        self.on()?;
        self.applied()?;
        let drives = self.drives()?;
        let names = ["axis.x.pos-cmd", "axis.y.pos-cmd", "axis.z.pos-cmd"];
        let axes: [f64; 3] = self.cnc.read_pins(&names)?.try_into().ok().context("three axes")?;
        let sent_um = match self.bridge {
            Some(_) => self.sent_um,
            None => self.cnc.read_pins(&OFFSETS)?.try_into().ok().context("three offsets")?,
        };
        let off = off_um(drives, axes, sent_um);
        let is_off = (0..3).any(|axis| off[axis].abs() > OFF_UM[axis]);
        ensure!(!is_off, "the drives are off by {off:.3?} um of {sent_um:.3?} um");
        self.off_um = off;
        Ok(off)
    }

    /// Returns what the pins of X say, for a look at what was lost.
    pub(crate) fn state(&mut self) -> Result<String> {
        let drive = self.way.drives()[0].clone();
        let limiter =
            ["in-0", "current-0", "min-0", "max-0"].map(|end| format!("trueup-mv.offset-{end}"));
        let mut names = vec![
            "motion.motion-enabled",
            "motion.is-all-homed",
            "joint.0.homing",
            "joint.0.home-state",
            "joint.0.motor-offset",
            "joint.0.pos-cmd",
            "axis.x.pos-cmd",
            "trueup.0.quality",
            "trueup.0.limited",
            &drive,
        ];
        if self.way != Way::Eoffset {
            names.extend(limiter.iter().map(String::as_str));
        }
        let values = self.cnc.read_pins(&names)?;
        let each = names.iter().zip(values).map(|(name, value)| format!("{name} {value:.6}"));
        Ok(each.collect::<Vec<_>>().join(", "))
    }

    /// Brings everything in order after something was lost.
    pub(crate) fn recover(&mut self) -> Result<()> {
        self.cnc.send_request(&json!({ "do": "abort" }))?;
        self.cnc.send_request(&json!({ "do": "overrides", "feed": 1.0, "rapid": 1.0 }))?;
        self.cnc.set_pin("joint.1.amp-fault-in", 0)?;
        self.cnc.set_pin("spindle.0.amp-fault-in", 0)?;
        if self.cnc.read_pin("motion.feed-inhibit")? != 0.0 {
            // It was killed, and has left its wires.
            load_component(&mut self.cnc, "KILL")?;
        }
        self.on()?;
        self.mdi("G53 G0 X-5 Y0 Z-1")?;
        self.settle().map(drop)
    }

    /// Switches the machine on, and homes X where that was broken off. Y and Z have no switch: homed again, they would
    /// be at 0 wherever they stand.
    pub(crate) fn on(&mut self) -> Result<()> {
        self.cnc.send_request_with_argument("state", "name", "reset")?;
        self.cnc.send_request_with_argument("state", "name", "on")?;
        if self.cnc.read_pin("joint.0.homed")? == 0.0 {
            self.cnc.send_request_with_argument("home", "joint", 0)?;
        }
        self.cnc.power_on_and_home()
    }

    /// Returns the version of LinuxCNC.
    pub(crate) fn version(&mut self) -> Result<String> {
        let version = self.cnc.send_request(&json!({ "do": "version" }))?;
        Ok(version.as_str().context("a version")?.to_owned())
    }

    /// Judges the cycles that were recorded meanwhile.
    pub(crate) fn judge(&mut self) {
        while let Ok(cycle) = self.cycles.try_recv() {
            self.judge.take(cycle);
        }
    }
}
