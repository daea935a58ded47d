//! Every fault has its emergency within 100 ms of being detected: a list, made by provoking each.

use std::fmt::Write as _;

use crate::rig::{Kind, Part, Rig, SPINDLE_CHANNEL, calibration};
use trueup_canopen::{
    dictionary::EntryContent,
    emergency::{Fault, Faults},
    sdo::{ObjectAccess as _, ObjectValue},
};
use trueup_core::{
    cnc::Control, design_parameters::TEMPERATURE_CHANNEL_COUNT,
    learned_changes::LearnedChangeRequest,
};
use trueup_link::{frame::Frame, frames};
use trueup_node::{
    configuration::NodeConfiguration,
    node::{Interface, Node},
};

/// The most between the moment at which a master can read a fault and its emergency.
const WITHIN_MS: u32 = 100;

fn number(rig: &Rig, what: EntryContent) -> u32 {
    match rig.node.read(what) {
        Ok(ObjectValue::Number(number)) => number,
        other => panic!("{what:?} is {other:?}"),
    }
}

/// Returns the bits of faults and state in the objects.
fn bits(rig: &Rig) -> [u32; 3] {
    [EntryContent::AllFaults, EntryContent::HighFaults, EntryContent::StateBits]
        .map(|object| number(rig, object))
}

/// `Control` from a master of its own line, as often as given.
fn controls(rig: &mut Rig, line: Interface, control: Control, from: u8, count: u8) {
    for n in 0..count {
        rig.node.receive(line, &frames::encode_control(control, from + n)).ok();
    }
}

/// Makes it happen.
fn provoke(fault: Fault, rig: &mut Rig) {
    let since = rig.ms + 1;
    let mut breaks = |part, kind| rig.fault = Some((part, kind, since));
    match fault {
        Fault::NoCalibration => rig.node = Node::new(NodeConfiguration::default()),
        Fault::Restarted => rig.node = Node::new(calibration().into()),
        Fault::Sensor => breaks(Part::Sensor, Kind::Short),
        Fault::SamplesMissing => breaks(Part::Blocks, Kind::Off),
        Fault::CncLost => breaks(Part::Control, Kind::Off),
        Fault::SpeedUnknown => breaks(Part::Speed, Kind::Off),
        Fault::SourceDead => breaks(Part::SpindleThermometer, Kind::Off),
        // 4 µm of heat and 15 to 19 µm of the table.
        Fault::Clamped => rig.offset_mm = 350.0,
        Fault::OutsideTable => breaks(Part::Position, Kind::Drift),
        Fault::PlaceLost => breaks(Part::Position, Kind::Off),
        Fault::PositionJump => breaks(Part::Position, Kind::Bias),
        Fault::SensorOdd => breaks(Part::Sensor, Kind::Bias),
        Fault::HeatUnknown => {
            rig.node = Node::new(calibration().into());
            rig.node.resume(None, 0);
        }
        Fault::OlderCalibration
        | Fault::ForeignMachine
        | Fault::ReferenceOffered
        | Fault::CalibrationChanged => rig.node.require_confirmation(fault),
        Fault::ExampleConstants => {
            let faults = Faults::default().with_fault_if(true, fault);
            rig.node = Node::new(NodeConfiguration { faults, ..calibration().into() });
        }
        Fault::SecondMaster => {
            controls(rig, Interface::Serial, Control::REFERENCED, 0, 1);
        }
        Fault::HeartbeatLost => {
            breaks(Part::Control, Kind::Off);
            let service = Control { service: true, ..Control::REFERENCED };
            rig.engage = false;
            rig.run(6_000);
            controls(rig, Interface::Can, service, 230, 4);
            rig.run(10);
            rig.node.write(EntryContent::ConsumerHeartbeat, 0x0002_0064).expect("allowed");
            let beat = Frame::new(0x702, &[5]).expect("a heartbeat");
            rig.node.receive(Interface::Can, &beat).expect("not for the receiver");
        }
        Fault::ZeroRefused => {
            let control = Control { referenced: false, ..Control::REFERENCED };
            breaks(Part::Control, Kind::Off);
            rig.run(6_000);
            controls(rig, Interface::Can, control, 200, 5);
            rig.run(20);
            controls(rig, Interface::Can, Control { zero: true, ..control }, 205, 5);
        }
        Fault::LearnedRefused => {
            // Of no cap, and of another calibration.
            let learned = LearnedChangeRequest { part: 1, amount: 1, calibration: 0 };
            breaks(Part::Control, Kind::Off);
            rig.run(6_000);
            controls(rig, Interface::Can, Control { learned, ..Control::REFERENCED }, 200, 5);
        }
        other => match channel_of(other) {
            Some((_, kind)) => rig.fault = Some((Part::SpindleThermometer, kind, since)),
            None => rig.node.set_fault(other),
        },
    }
}

/// Returns a rig with the spindle's thermometer on this channel, and the axis's on the next.
fn engaged_on(channel: usize) -> Rig {
    let channels = [channel, (channel + 1) % TEMPERATURE_CHANNEL_COUNT];
    let mut wired = calibration();
    let [spindle, axis] = channels.map(|channel| channel as u8);
    wired.thermometers = [wired.thermometers[SPINDLE_CHANNEL]; TEMPERATURE_CHANNEL_COUNT];
    wired.spindle.temperature.as_mut().expect("its model").channel = spindle;
    wired.axes[0].thermal.as_mut().expect("its law").channel = axis;
    let mut rig = Rig::new(7);
    (rig.node, rig.channels) = (Node::new(wired.into()), channels);
    rig.into_engaged()
}

/// Returns the channel of a thermometer's fault, and what breaks there.
fn channel_of(fault: Fault) -> Option<(usize, Kind)> {
    let of = |faults: [Fault; 8]| faults.into_iter().position(|candidate| candidate == fault);
    of(Fault::THERMOMETER_FAULTS)
        .map(|channel| (channel, Kind::Off))
        .or(of(Fault::TEMPERATURE_RATE_FAULTS).map(|channel| (channel, Kind::Bias)))
}

/// Milliseconds from the moment at which the objects report a fault to its emergency.
fn reported_after(fault: Fault) -> u32 {
    let mut rig = match fault {
        // Both are sent elsewhere at once.
        Fault::Clamped => Rig::engaged_within(20_000, 7),
        Fault::OutsideTable => Rig::engaged_within(200_000, 7),
        _ => channel_of(fault).map_or_else(|| Rig::engaged(7), |(channel, _)| engaged_on(channel)),
    };
    if fault == Fault::OutsideTable {
        // 10 mm a minute from 590 mm need long to leave the table: begin far out.
        rig.offset_mm = 405.0;
        rig.run(100);
    }
    let before = bits(&rig);
    rig.emergencies.clear();
    provoke(fault, &mut rig);
    let mut detected = None;
    for _ in 0..30_000 {
        rig.live();
        if bits(&rig) != before {
            detected.get_or_insert(rig.ms);
        }
        if let Some((at, _)) = rig.emergencies.iter().find(|(_, reported)| *reported == fault) {
            return at.saturating_sub(detected.unwrap_or(*at));
        }
    }
    panic!("{fault:?} is never reported");
}

/// Returns the list, a line each.
pub fn list() -> String {
    let mut text = String::from("| fault | code | emergency after |\n|---|---|---|\n");
    for fault in Fault::ALL {
        let after = reported_after(fault);
        writeln!(text, "| `{fault:?}` | {:04X} | {after} ms |", fault.code()).expect("a string");
    }
    text
}

#[test]
fn every_fault_has_its_emergency_within_100_ms() {
    for fault in Fault::ALL {
        let after = reported_after(fault);
        println!("{fault:?}: {after} ms");
        assert!(after <= WITHIN_MS, "{fault:?} is reported after {after} ms");
    }
}
