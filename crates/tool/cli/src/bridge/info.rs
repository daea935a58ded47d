//! `trueup bridge info`: who the bridge is, what it runs on, and how it is.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Result, bail};
use clap::Args;
use serde_json::{Value, json};
use trueup_client::{
    build::BuildVersion,
    firmware_slots::FirmwareSlots,
    port::PortAddress,
    reference::BridgeReference,
    sdo_object,
    session::Session,
    state_text::{
        fault_names, format_output, nmt_state_name, output_to_json, pending_action, state_names,
    },
    write_log,
};
use trueup_core::cnc::Output;
use trueup_learn::live_update;
use trueup_link::{
    frames::{self, NmtState},
    receiver::OffsetReceiver,
    slcan::AdapterMessage,
    status::{ResetReason, StateBits},
};
use trueup_machine::compile;
use trueup_store::write_log::WriteRecord;

use super::{bridge_identity, operator_questions::OpenQuestions};
use crate::{CommandOutcome, input_files, output};

#[derive(Args)]
pub struct InfoArgs {
    #[command(flatten)]
    port: super::PortArgs,
    /// Say whether the bridge runs on what this machine file makes, and what differs.
    #[arg(long, value_name = "M.toml")]
    machine: Option<PathBuf>,
}

/// How long answers, a heartbeat and offsets are waited for: 20 heartbeats.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Messages received from a bridge.
#[derive(Default)]
struct BridgeInfo {
    version: Option<String>,
    serial: Option<String>,
    heartbeat: Option<NmtState>,
    output: Option<Output>,
    offsets: OffsetReceiver,
}

impl BridgeInfo {
    fn receive(&mut self, event: &AdapterMessage) {
        match event {
            AdapterMessage::Other(line) => {
                let text = || String::from_utf8_lossy(line).into_owned();
                match line.first() {
                    Some(b'V') => self.version = Some(text()),
                    Some(b'N') => self.serial = Some(text()),
                    _ => {}
                }
            }
            AdapterMessage::Frame(frame) => {
                let state = frames::decode_heartbeat(frame).ok();
                // Boot-up is not a state yet; the next heartbeat has one.
                let state = state.filter(|state| *state != frames::NmtState::BootUp);
                self.heartbeat = state.or(self.heartbeat);
                self.output = self.offsets.accept(frame).ok().flatten().or(self.output);
            }
            AdapterMessage::Accepted | AdapterMessage::Rejected | AdapterMessage::Malformed(_) => {}
        }
    }

    /// Returns whether all has come; what an adapter says of itself only where there is one.
    fn is_complete(&self, has_adapter: bool) -> bool {
        (!has_adapter || self.version.is_some() && self.serial.is_some())
            && self.heartbeat.is_some()
            && self.output.is_some()
    }
}

/// Objects of the bridge, read by SDO.
struct BridgeObjects {
    device: String,
    hardware: String,
    software: BuildVersion,
    /// `None`: the board has no firmware slots.
    slots: Option<FirmwareSlots>,
    /// 0: it has no valid one.
    calibration: u32,
    /// The one for the next start; 0: none was loaded.
    new_calibration: u32,
    /// Name of the machine that it is for; empty: it says none.
    machine: String,
    /// Serial number of that machine.
    serial: String,
    /// Who has written to the board, the last at the end.
    writes: Vec<WriteRecord>,
    reference: BridgeReference,
    /// The learned values as they are applied, in words; `None`: none.
    learned: Option<String>,
    /// Tool and conditions that its terms go by, in words; `None`: they need none.
    conditions: Option<String>,
    faults: Vec<&'static str>,
    state: Vec<&'static str>,
    questions: OpenQuestions,
    reset: ResetReason,
    /// The traces of its last stop, in words; empty: none.
    stop: String,
    /// How often it has started since power-on, and why.
    resets: Vec<(&'static str, u32)>,
}

impl BridgeObjects {
    fn read(session: &mut Session) -> Result<Self> {
        Ok(Self {
            device: sdo_object::read_text(session, sdo_object::DEVICE_NAME)?,
            hardware: sdo_object::read_text(session, sdo_object::HARDWARE_VERSION)?,
            software: bridge_identity::read_and_check_firmware_build(session)?,
            slots: FirmwareSlots::read(session)?,
            calibration: sdo_object::read_number(session, sdo_object::RUNNING_CRC)?,
            new_calibration: sdo_object::read_number(session, sdo_object::PENDING_CRC)?,
            // An empty one is refused.
            machine: sdo_object::read_text(session, sdo_object::MACHINE_NAME).unwrap_or_default(),
            serial: sdo_object::read_text(session, sdo_object::MACHINE_SERIAL).unwrap_or_default(),
            writes: write_log::decode_write_records(
                &sdo_object::read(session, sdo_object::WRITE_LOG, |_, _| ()).unwrap_or_default(),
            ),
            reference: BridgeReference::read(session)?,
            learned: describe_learned_values(session),
            conditions: describe_conditions(session),
            faults: fault_names(sdo_object::read_faults(session)?),
            state: state_names(StateBits(sdo_object::read_number(
                session,
                sdo_object::STATE_BITS,
            )?)),
            questions: OpenQuestions::read(session)?,
            reset: u16::try_from(sdo_object::read_number(session, sdo_object::RESET_REASON)?)
                .ok()
                .and_then(ResetReason::from_wire)
                .unwrap_or_default(),
            stop: describe_crash_location(session)?,
            resets: read_reset_counts(session)?,
        })
    }

    fn describe_machine(&self) -> String {
        match (&self.machine[..], &self.serial[..]) {
            ("", "") => "not named".into(),
            (name, "") => name.into(),
            (name, serial) => format!("{name}, serial {serial}"),
        }
    }

    fn describe_calibration(&self) -> String {
        let new = match self.new_calibration {
            0 => String::new(),
            crc if crc == self.calibration => String::new(),
            crc => format!(
                "; {crc:08x} WAITS for the next start: trueup bridge pending puts it to use or drops it"
            ),
        };
        match self.calibration {
            0 => format!("none that is valid{new}"),
            crc => format!("CRC {crc:08x}{new}"),
        }
    }
}

/// Prints the firmware slots of a board, the one that runs first.
fn print_firmware_slots(slots: &FirmwareSlots) -> Result<()> {
    let (running, spare) = (slots.running, slots.running.other());
    output::print(format_args!(
        "firmware     slot {} runs: {}",
        running.name(),
        slots.slot_info(running)
    ))?;
    output::print(format_args!("firmware     slot {}: {}", spare.name(), slots.slot_info(spare)))?;
    let by = if slots.reported.is_some() {
        ""
    } else {
        " (by what the slots hold now: this boot program does not report its reason)"
    };
    output::print(format_args!(
        "firmware     slot {} was chosen: {}{by}",
        running.name(),
        slots.choice_reason()
    ))?;
    output::print(format_args!("firmware     oldest version that may start: {}", slots.floor))
}

/// Returns the learned values in words; none of a bridge whose firmware is older than they are.
fn describe_learned_values(session: &mut Session) -> Option<String> {
    let amounts = sdo_object::LEARNED_VALUES
        .map(|at| sdo_object::read_number(session, at).unwrap_or_default().cast_signed());
    live_update::describe_amounts(&amounts)
}

/// Returns tool and conditions in words; none of a bridge whose firmware is older than the frame `Conditions`.
fn describe_conditions(session: &mut Session) -> Option<String> {
    let [tool, bits, origin] =
        sdo_object::CONDITIONS.map(|at| sdo_object::read_number(session, at).unwrap_or_default());
    let held: Vec<String> =
        (0..16).filter(|bit| bits & 1 << bit != 0).map(|bit| bit.to_string()).collect();
    let held = if held.is_empty() { "none".into() } else { format!("bit {}", held.join(", ")) };
    match origin {
        1 => Some(format!("tool {tool}; conditions that hold: {held}")),
        2 => Some("lost: by the defaults of the calibration".into()),
        _ => None,
    }
}

/// Where the last start stopped, in words that follow its reason; empty: nothing is known of it.
fn describe_crash_location(session: &mut Session) -> Result<String> {
    let mut numbers = [0; 5];
    for (number, at) in numbers.iter_mut().zip(sdo_object::CRASH_DETAILS) {
        *number = sdo_object::read_number(session, at)?;
    }
    let [pc, lr, status, address, line] = numbers;
    let mut words = String::new();
    if line != 0 {
        words +=
            &format!(" at {}:{line}", sdo_object::read_text(session, sdo_object::CRASH_FILE_NAME)?);
    }
    if pc != 0 || status != 0 {
        words += &format!(" at pc {pc:#010x}, lr {lr:#010x}, CFSR {status:#010x}");
    }
    if address != 0 {
        words += &format!(", address {address:#010x}");
    }
    let task = usize::try_from(sdo_object::read_number(session, sdo_object::CRASH_TASK)?)?;
    if let Some(task) = task.checked_sub(1).and_then(|at| sdo_object::TASK_NAMES.get(at)) {
        words += &format!(", in task {task}");
    }
    Ok(words)
}

/// Returns the reasons for which the board has started since power-on, and how often.
fn read_reset_counts(session: &mut Session) -> Result<Vec<(&'static str, u32)>> {
    let (index, first) = sdo_object::FIRST_RESET_COUNT;
    let mut all = Vec::new();
    for (number, subindex) in (0..).zip(first..).take(ResetReason::COUNT) {
        let count = sdo_object::read_number(session, (index, subindex))?;
        let word = ResetReason::from_wire(number).unwrap_or_default().as_str();
        all.extend((count > 0).then_some((word, count)));
    }
    Ok(all)
}

/// The comparison of the bridge's calibration with the machine file.
enum CalibrationComparison {
    /// No file was given, or the bridge did not answer.
    None,
    /// It runs on nothing that can be compared.
    NoComparableCalibration,
    /// The differences from the calibration that it runs on, a sentence each; empty: none.
    Differences(Vec<String>),
}

/// Reads the state of the bridge and prints it.
pub fn run(args: &InfoArgs, as_json: bool) -> Result<CommandOutcome> {
    let port = PortAddress::parse(&args.port.port)?;
    let requested = match &args.machine {
        Some(path) => Some(compile(&input_files::read_machine(path)?)?),
        None => None,
    };
    let has_adapter = port.uses_slcan();
    let mut session = Session::open(&port)?;
    session.write(b"V\rN\r")?;
    let deadline = Instant::now() + RESPONSE_TIMEOUT;
    let mut info = BridgeInfo::default();
    while !info.is_complete(has_adapter) {
        let Some(event) = session.next_event(deadline)? else { break };
        info.receive(&event);
    }
    // An adapter in between may say something else of itself, or nothing: what counts is that frames come.
    let is_silent = info.heartbeat.is_none() && info.output.is_none();
    if has_adapter && is_silent && (info.version.is_none() || info.serial.is_none()) {
        bail!(
            "no frame of a bridge came in {} s, and no version or serial number: check that it is a bridge and that the adapter has the right bit rate (1 Mbit/s)",
            RESPONSE_TIMEOUT.as_secs()
        );
    }
    // A bridge that sends no frame answers none.
    let objects = match info.heartbeat {
        Some(_) => Some(BridgeObjects::read(&mut session)?),
        None => None,
    };
    let mut comparison = CalibrationComparison::None;
    if let (Some(it), Some(requested)) = (&objects, &requested) {
        comparison = match bridge_identity::describe_calibration_differences(
            &mut session,
            requested.blob(),
        )? {
            // What the board computes is the same; the bytes may have been written by another version.
            Some(all) => CalibrationComparison::Differences(all),
            None if it.calibration == requested.crc() => {
                CalibrationComparison::Differences(Vec::new())
            }
            None => CalibrationComparison::NoComparableCalibration,
        };
    }
    session.close();
    if as_json {
        let mut all = info.to_json(objects.as_ref());
        if let CalibrationComparison::Differences(differences) = &comparison {
            all["differs_from_machine"] = json!(differences);
        }
        output::print(all)?;
    } else {
        info.print_info(objects.as_ref())?;
        comparison.print_comparison(args.machine.as_deref())?;
    }
    let is_other = match &comparison {
        CalibrationComparison::None => false,
        CalibrationComparison::NoComparableCalibration => true,
        CalibrationComparison::Differences(all) => !all.is_empty(),
    };
    let is_met = objects.is_some() && info.is_complete(false) && !is_other;
    Ok(if is_met { CommandOutcome::Done } else { CommandOutcome::NotMet })
}

impl CalibrationComparison {
    fn print_comparison(&self, machine: Option<&Path>) -> Result<()> {
        let file = machine.map(|path| path.display().to_string()).unwrap_or_default();
        match self {
            Self::None => Ok(()),
            Self::NoComparableCalibration => {
                output::print(format_args!("{file}: the bridge runs on nothing like it"))
            }
            Self::Differences(all) if all.is_empty() => {
                output::print(format_args!("{file}: the bridge runs on it"))
            }
            Self::Differences(all) => {
                output::print(format_args!("{file}: the bridge does NOT run on it; with it:"))?;
                all.iter().try_for_each(|change| output::print(format_args!("  {change}")))
            }
        }
    }
}

impl BridgeInfo {
    fn to_json(&self, objects: Option<&BridgeObjects>) -> Value {
        let crc = |crc: u32| (crc != 0).then(|| format!("{crc:08x}"));
        let mut all = output_to_json(self.output.as_ref());
        all["waiting_for"] = json!(self.pending_action(objects));
        all["version"] = json!(self.version);
        all["serial"] = json!(self.serial);
        all["heartbeat"] = json!(self.heartbeat.map(nmt_state_name));
        all["device"] = json!(objects.map(|objects| &objects.device));
        all["hardware"] = json!(objects.map(|objects| &objects.hardware));
        all["software"] = json!(objects.map(|objects| objects.software.to_string()));
        all["firmware_slots"] =
            json!(objects.and_then(|objects| objects.slots).map(|slots| slots.to_json()));
        all["calibration_crc"] = json!(objects.and_then(|objects| crc(objects.calibration)));
        all["new_calibration_crc"] =
            json!(objects.and_then(|objects| crc(objects.new_calibration)));
        let named = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        all["machine"] = json!(objects.and_then(|objects| named(&objects.machine)));
        all["machine_serial"] = json!(objects.and_then(|objects| named(&objects.serial)));
        all["writes"] = json!(objects.map(|objects| {
            objects.writes.iter().map(write_log::record_to_json).collect::<Vec<_>>()
        }));
        all["has_reference"] = json!(objects.map(|objects| objects.reference.in_force.is_some()));
        all["reference"] = json!(objects.map(|objects| objects.reference.to_json()));
        all["asks"] = json!(objects.map(|objects| objects.questions.keywords()));
        all["learned"] = json!(objects.and_then(|objects| objects.learned.as_ref()));
        all["conditions"] = json!(objects.and_then(|objects| objects.conditions.as_ref()));
        all["faults"] = json!(objects.map(|objects| &objects.faults));
        all["state"] = json!(objects.map(|objects| &objects.state));
        all["reset_reason"] = json!(objects.map(|objects| objects.reset.as_str()));
        all["reset_at"] =
            json!(objects.map(|objects| &objects.stop).filter(|stop| !stop.is_empty()));
        all["resets"] = json!(
            objects.map(|objects| objects.resets.iter().copied().collect::<BTreeMap<_, _>>())
        );
        all
    }

    /// For whom the bridge waits that gives no offset.
    fn pending_action(&self, objects: Option<&BridgeObjects>) -> Option<&'static str> {
        let objects = objects?;
        pending_action(
            self.output.as_ref()?.quality,
            objects.questions.state_bits(),
            Some(objects.calibration),
        )
    }

    fn print_info(&self, objects: Option<&BridgeObjects>) -> Result<()> {
        let missing = format!("none in {} s", RESPONSE_TIMEOUT.as_secs());
        if let (Some(version), Some(serial)) = (&self.version, &self.serial) {
            output::print(format_args!("version      {version}"))?;
            output::print(format_args!("serial       {serial}"))?;
        }
        // Of CANopen's words: no sign of a fault, as long as a heartbeat comes.
        let heartbeat = match self.heartbeat {
            None => missing.clone(),
            Some(NmtState::Stopped) => "alive; no offsets are available (CANopen: stopped)".into(),
            Some(state) => format!("alive (CANopen: {})", nmt_state_name(state)),
        };
        output::print(format_args!("heartbeat    {heartbeat}"))?;
        let offsets = self.output.as_ref().map_or_else(|| missing.clone(), format_output);
        let waits = self.pending_action(objects).map(|what| format!("waiting for {what}: "));
        output::print(format_args!("offsets      {}{offsets}", waits.unwrap_or_default()))?;
        let Some(it) = objects else { return Ok(()) };
        let BridgeObjects { device, hardware, software, .. } = it;
        output::print(format_args!("device       {device} {software} on {hardware}"))?;
        it.slots.as_ref().map_or(Ok(()), print_firmware_slots)?;
        output::print(format_args!("calibration  {}", it.describe_calibration()))?;
        output::print(format_args!("machine      {}", it.describe_machine()))?;
        output::print(format_args!("reference    {}", it.reference.to_text()))?;
        let learned = it.learned.as_deref().unwrap_or("nothing apart from the calibration");
        output::print(format_args!("learned      {learned}"))?;
        if let Some(conditions) = &it.conditions {
            output::print(format_args!("conditions   {conditions}"))?;
        }
        let faults = if it.faults.is_empty() { "none".into() } else { it.faults.join(" ") };
        output::print(format_args!("faults       {faults}"))?;
        let state = if it.state.is_empty() { "all well".into() } else { it.state.join(" ") };
        output::print(format_args!("state        {state}"))?;
        it.questions.print()?;
        output::print(format_args!("last reset   {}{}", it.reset.as_str(), it.stop))?;
        let resets: Vec<String> =
            it.resets.iter().map(|(word, count)| format!("{word} {count}")).collect();
        let resets = if resets.is_empty() {
            "none counted since power-on".into()
        } else {
            resets.join(", ")
        };
        output::print(format_args!("starts       {resets}"))?;
        if !it.writes.is_empty() {
            output::print("written      to the board, the last first, #number in its log:")?;
        }
        it.writes.iter().rev().try_for_each(|write| {
            output::print(format_args!("written      {}", write_log::format_record(write)))
        })
    }
}
