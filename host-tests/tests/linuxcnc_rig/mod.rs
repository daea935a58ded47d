//! A bridge and a LinuxCNC with the sample configuration, shared by the tests that run at a time.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

pub mod bridge;
pub mod control;
pub mod samples;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use anyhow::{Result, ensure};
use serde_json::json;
use trueup_emulator::{linuxcnc::headless_linuxcnc::HeadlessLinuxCnc, setup};
use trueup_machine::{Machine, MachineFile};

use self::{
    bridge::{Damage, RigBridge},
    samples::Sample,
};

/// By how much the spindle has grown while a test begins.
pub const GROWN_UM: f64 = 40.0;
/// An offset is applied when it is within this of its target: the noise of the emulated sensor
/// moves the target a little all the time.
pub const CLOSE_UM: f64 = 0.5;
/// The slew limit of the sample's machine file, in nm a servo cycle of 1 ms.
pub const SLEW_NM: f64 = 500.0;
/// Error of LinuxCNC's arithmetic in double, in nm.
pub const NOISE_NM: f64 = 0.01;

/// Offsets in µm, and where they come from.
pub const OFFSETS: [&str; 3] =
    ["trueup.0.x-offset-um", "trueup.0.y-offset-um", "trueup.0.z-offset-um"];
pub const APPLIED: [&str; 3] =
    ["trueup.0.x-applied-um", "trueup.0.y-applied-um", "trueup.0.z-applied-um"];

/// A virtual bridge and a LinuxCNC that it corrects.
pub struct Rig {
    pub bridge: RigBridge,
    pub cnc: HeadlessLinuxCnc,
    /// Messages of LinuxCNC and the component from before the bridge was there.
    pub messages_at_start: String,
    scenario: i32,
    /// How far the recording has been read.
    read: u64,
}

/// Returns the sample's machine file.
pub fn machine() -> Result<Machine> {
    let path = setup::project_root().join("integrations/linuxcnc/trueup_gantry.toml");
    Ok(MachineFile::read(&path)?)
}

/// Returns the shared one. It ends with the last test that holds it.
pub fn shared() -> Result<Option<Arc<Mutex<Rig>>>> {
    static RIG: Mutex<Weak<Mutex<Rig>>> = Mutex::new(Weak::new());
    let mut weak = RIG.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(rig) = weak.upgrade() {
        return Ok(Some(rig));
    }
    let Some(rig) = Rig::start()? else { return Ok(None) };
    let rig = Arc::new(Mutex::new(rig));
    *weak = Arc::downgrade(&rig);
    Ok(Some(rig))
}

/// Returns a test that has failed leaves the rig as it is; the next one brings it into order.
pub fn lock(rig: &Mutex<Rig>) -> MutexGuard<'_, Rig> {
    rig.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Rig {
    /// LinuxCNC comes up while the bridge's plug is out.
    fn start() -> Result<Option<Self>> {
        // Another process may use it for a while.
        let Some(linuxcnc) = setup::install_and_lock_linuxcnc()? else { return Ok(None) };
        let bridge = RigBridge::start(&machine()?)?;
        bridge.plug(false);
        let mut cnc = control::start(linuxcnc, &bridge.address(), &[])?;
        cnc.wait_for_pins(
            "nobody is there",
            10,
            &["trueup.0.fault", "trueup.0.connected"],
            |seen| seen == [1.0, 0.0],
        )?;
        let messages_at_start = cnc.recent_log();
        bridge.plug(true);
        Ok(Some(Self { bridge, cnc, messages_at_start, scenario: 0, read: 0 }))
    }

    /// Ends LinuxCNC and starts it again, with the bridge as it is, and with these files more.
    pub fn restart_linuxcnc(&mut self, files: &[(&str, &str)]) -> Result<()> {
        let linuxcnc = self.cnc.shut_down()?;
        self.cnc = control::start(linuxcnc, &self.bridge.address(), files)?;
        self.read = 0;
        Ok(())
    }

    /// Everything in order: the bridge plugged in and grown by [`GROWN_UM`], the machine on, homed,
    /// at 0, in teleop mode, the offsets applied.
    pub fn ready(&mut self) -> Result<()> {
        self.bridge.damage(Damage::default());
        self.bridge.plug(true);
        self.bridge.grow_to(GROWN_UM);
        self.cnc.send_request(&json!({"do": "abort"}))?;
        self.cnc.send_request_with_argument("zero", "on", false)?;
        self.cnc.power_on_and_home()?;
        self.cnc.send_request_with_argument("mdi", "text", "G53 G0 X0 Y0 Z0")?;
        self.cnc.send_request_with_argument("teleop", "on", true)?;
        if self.applied_within(8, GROWN_UM).is_ok() {
            return Ok(());
        }
        // A test that has failed may have left its reference.
        self.set_reference(0.0)?;
        self.bridge.grow_to(GROWN_UM);
        self.applied()
    }

    /// This growth becomes the reference, whatever it was.
    pub fn set_reference(&mut self, growth_um: f64) -> Result<()> {
        self.bridge.grow_to(growth_um);
        // The sensor's filter, and a busy computer.
        std::thread::sleep(std::time::Duration::from_secs(1));
        self.cnc.send_request_with_argument("zero", "on", true)?;
        self.applied_at(0.0)?;
        self.cnc.send_request_with_argument("zero", "on", false)?;
        Ok(())
    }

    /// Waits until the offsets are live and LinuxCNC has applied them.
    pub fn applied(&mut self) -> Result<()> {
        self.applied_at(GROWN_UM)
    }

    /// The same, with this growth since the reference.
    pub fn applied_at(&mut self, z_um: f64) -> Result<()> {
        self.applied_within(30, z_um)
    }

    fn applied_within(&mut self, seconds: u64, z_um: f64) -> Result<()> {
        let names = ["trueup.0.connected", "trueup.0.fault", "trueup.0.quality"];
        let names = [&names[..], &OFFSETS, &APPLIED].concat();
        self.cnc.wait_for_pins(
            "the offset that is applied equals its target",
            seconds,
            &names,
            |seen| {
                let equal = (0..3).all(|axis| (seen[3 + axis] - seen[6 + axis]).abs() < CLOSE_UM);
                seen[..3] == [1.0, 0.0, 1.0] && equal && (seen[8] - z_um).abs() < CLOSE_UM
            },
        )
    }

    /// Returns what is applied, in µm, once it has not changed for two seconds: a busy computer takes its time
    /// to send the board the positions of the axes.
    pub fn settled_um(&mut self) -> Result<[f64; 3]> {
        let mut last = [f64::INFINITY; 3];
        let mut since = std::time::Instant::now();
        let end = since + std::time::Duration::from_secs(30);
        while since.elapsed() < std::time::Duration::from_secs(2) {
            let now = self.cnc.read_pins(&APPLIED)?;
            let moved = (0..3).any(|axis| (now[axis] - last[axis]).abs() >= CLOSE_UM);
            if moved {
                last.copy_from_slice(&now);
                since = std::time::Instant::now();
            }
            ensure!(since < end, "it does not settle: {now:?}");
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        Ok(last)
    }

    /// Returns what is applied on Z, in µm.
    pub fn z_um(&mut self) -> Result<f64> {
        Ok(self.cnc.read_pin("axis.z.eoffset")? * 1_000.0)
    }

    /// From here on cycles belong to a new scenario.
    pub fn begin(&mut self) -> Result<()> {
        self.scenario += 1;
        self.cnc.send_request_with_argument("mark", "scenario", self.scenario)?;
        Ok(())
    }

    /// Returns every servo cycle since [`Rig::begin`]. The recorder writes behind, so it is waited for.
    pub fn cycles(&mut self) -> Result<Vec<Sample>> {
        let number = self.scenario;
        self.cnc.send_request_with_argument("mark", "scenario", 0)?;
        let recording = self.cnc.folder().join(control::RECORDING);
        let mut all = Vec::new();
        let end = std::time::Instant::now() + std::time::Duration::from_secs(10);
        loop {
            all.extend(samples::read(&recording, &mut self.read)?);
            let first = all.iter().position(|sample: &Sample| sample.scenario == number);
            let over = first
                .and_then(|first| all[first..].iter().position(|sample| sample.scenario != number));
            if let (Some(first), Some(length)) = (first, over) {
                return Ok(all[first..first + length].to_vec());
            }
            ensure!(std::time::Instant::now() < end, "the recorder does not write");
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }

    /// The end of a scenario: the offset equals its target again, and in no servo cycle since
    /// [`Rig::begin`] did a joint step by more than the slew limit allows.
    pub fn end(&mut self) -> Result<()> {
        let cycles = self.cycles()?;
        let seen = samples::steps(&cycles)?;
        println!(
            "{} servo cycles: a joint steps by at most {:.1} nm of {SLEW_NM} nm, what is asked for \
             by {:.1} nm",
            seen.cycles, seen.joint_nm, seen.request_nm
        );
        assert!(seen.joint_nm <= SLEW_NM + NOISE_NM, "a joint steps by {} nm", seen.joint_nm);
        // The sample has LinuxCNC itself keep the joint's limit; this one is the component's.
        assert!(seen.request_nm <= SLEW_NM + NOISE_NM, "it asks for {} nm", seen.request_nm);
        Ok(())
    }
}
