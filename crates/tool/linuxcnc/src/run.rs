//! The loop: pins in, frames in, a decision, pins out, frames out; some times in a servo cycle.

use std::{
    io,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant, SystemTime},
};

use trueup_client::{
    connection::{BridgeConnection, ConnectionEvent},
    duplex_stream::DuplexStream,
    pinned_calibration::PinnedCalibration,
    state_text::state_names,
};
use trueup_core::{cnc::OffsetQuality, learned_changes::LEARNED_PART_COUNT};
use trueup_link::status::StateBits;

use crate::{
    component::{Component, ComponentOptions, ComponentOutputs},
    component_pins::{ComponentPins, pid_pin_name},
    hal::{HalComponent, HalError},
    record::RecordFile,
};

/// How often adopted pins, and the wires, are looked after.
const PIN_REFRESH_PERIOD: Duration = Duration::from_millis(50);

/// How the component appears in the HAL.
#[derive(Clone, Debug)]
pub struct HalComponentSettings {
    /// The name of the component, `trueup`: `loadusr -W` waits for the program's name.
    pub name: String,
    /// Millimetres in a machine unit: 1 or 25.4.
    pub mm_per_unit: f64,
    /// How many `temp-NN` pins there are.
    pub temperatures: u8,
    /// CRC of what `compile` makes of the machine file; `None`: without one.
    pub calibration: Option<u32>,
    /// On which calibration the bridge has to run to be engaged.
    pub pinned: PinnedCalibration,
    /// From one turn of the loop to the next.
    pub turn: Duration,
    /// How it decides.
    pub options: ComponentOptions,
}

/// Corrections learned since the bridge's calibration was made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LearnedCorrectionUpdate {
    /// Each part in the bridge's units; `None`: as before.
    pub amounts: Option<[i16; LEARNED_PART_COUNT]>,
    /// Lines about it for the operator.
    pub notices: Vec<String>,
}

/// Runs the component until `stop` is set. `tell` gets a sentence whenever something has changed
/// that an operator wants to know; `record` gets its rows; `learned` says what has changed of what was learned, and
/// without it nothing was.
///
/// # Errors
/// The HAL refuses the component or a pin.
pub fn run(
    settings: &HalComponentSettings,
    open: impl FnMut() -> io::Result<DuplexStream> + Send + 'static,
    stop: &AtomicBool,
    mut record: Option<RecordFile>,
    learned: Option<impl Fn() -> Option<LearnedCorrectionUpdate>>,
    mut report: impl FnMut(&str),
) -> Result<(), HalError> {
    let HalComponentSettings {
        name,
        mm_per_unit,
        temperatures,
        calibration,
        pinned,
        turn,
        options,
    } = settings;
    let hal = HalComponent::new(name, &pid_pin_name(name))?;
    let pins = ComponentPins::new(&hal, name, *mm_per_unit, *temperatures, &options.joints)?;
    let line = BridgeConnection::spawn(open);
    let start = Instant::now();
    let mut component = Component::new(start.elapsed(), *options);
    pins.resume(&mut component);
    let mut news = StateReporter::new(pinned.clone());
    hal.set_ready()?;
    if hal.has_adopted_pins() {
        report("takes over the pins of a component that was killed");
    }
    let mut refreshed = Duration::ZERO;
    let mut cut = None;
    let mut lessons = LearnedCorrectionSender { news: learned, of: *calibration, amounts: None };
    while !stop.load(Ordering::Relaxed) {
        let now = start.elapsed();
        if now.saturating_sub(refreshed) >= PIN_REFRESH_PERIOD {
            refreshed = now;
            hal.refresh_adopted_pins();
            cut = pins.find_disconnected_pin();
            news.report_disconnected_pin(cut, &mut report);
        }
        for received in line.take_events() {
            match received {
                ConnectionEvent::Up => report("the line is open"),
                ConnectionEvent::Down(why) => news.report_connection_lost(&why, &mut report),
                ConnectionEvent::Received(event) => component.receive(now, &event),
                ConnectionEvent::Late => report(
                    "the line has stalled, and delivers what is old: not used until it is in time again",
                ),
            }
        }
        lessons.send_learned_corrections(&mut component, &mut report);
        let mut inputs = pins.read();
        inputs.enable &= news.pinned.is_engage_allowed();
        inputs.zero &= news.pinned.is_engage_allowed();
        let (mut outputs, frames) = component.step(now, &inputs);
        outputs.other_calibration = news.pinned.is_engage_refused();
        // The watchdog of the heartbeat holds the feed, as if the component were gone.
        outputs.heartbeat &= cut.is_none();
        pins.write(&outputs);
        let recorded = record
            .as_mut()
            .map(|record| record.write_row_if_due(SystemTime::now(), &inputs, &outputs));
        if let Some(Err(why)) = recorded {
            // The learner finds it too old, and says so.
            report(&format!("the record cannot be written, and is given up: {why}"));
            record = None;
        }
        for frame in frames {
            line.try_send(frame);
        }
        news.report_state_change(&outputs, &mut report);
        thread::sleep(*turn);
    }
    Ok(())
}

/// The learned corrections, as they are sent to the bridge.
struct LearnedCorrectionSender<F> {
    /// The change since the last one sent; `None`: nothing is learned here.
    news: Option<F>,
    /// CRC of the calibration that it is a change of.
    of: Option<u32>,
    /// As it was last reported; `None`: it is not known yet.
    amounts: Option<[i16; LEARNED_PART_COUNT]>,
}

impl<F: Fn() -> Option<LearnedCorrectionUpdate>> LearnedCorrectionSender<F> {
    /// Without a source, a bridge receives the order to forget what a component before this one has sent.
    fn send_learned_corrections(
        &mut self,
        component: &mut Component,
        report: &mut impl FnMut(&str),
    ) {
        let Some(news) = &self.news else { return component.clear_learned_values() };
        if let Some(news) = news() {
            news.notices.iter().for_each(|text| report(text));
            self.amounts = news.amounts.or(self.amounts);
        }
        component.set_learned_values(self.amounts.zip(self.of));
    }
}

/// The last report.
#[derive(Debug)]
struct StateReporter {
    down: Option<String>,
    state: Option<(bool, bool, bool, bool, OffsetQuality)>,
    pinned: PinnedCalibration,
    bits: StateBits,
    cut: Option<String>,
}

impl StateReporter {
    /// Nothing was reported.
    fn new(pinned: PinnedCalibration) -> Self {
        Self { down: None, state: None, pinned, bits: StateBits::default(), cut: None }
    }

    /// A wire that is cut is reported once, and that it is whole again.
    fn report_disconnected_pin(&mut self, cut: Option<&str>, report: &mut impl FnMut(&str)) {
        if self.cut.as_deref() == cut {
            return;
        }
        self.cut = cut.map(String::from);
        match cut {
            Some(pin) => report(&format!(
                "the pin {pin} is no longer connected: the heartbeat stops, and with trueup_watchdog.hal the feed"
            )),
            None => report("all pins are connected again: the heartbeat goes on"),
        }
    }

    /// The same reason is reported once.
    fn report_connection_lost(&mut self, why: &str, report: &mut impl FnMut(&str)) {
        if self.down.as_deref() != Some(why) {
            report(&format!("the line is down: {why}; trying again"));
            self.down = Some(why.into());
        }
    }

    /// The bridge's version and state, when they change.
    fn report_bridge_state(&mut self, outputs: &ComponentOutputs, report: &mut impl FnMut(&str)) {
        if let Some(notices) = self.pinned.update_running_crc(outputs.calibration) {
            report(&notices);
        }
        if outputs.state != self.bits {
            self.bits = outputs.state;
            let words = state_names(self.bits);
            match words[..] {
                [] => report("the bridge reports no fault"),
                _ => report(&format!("the bridge says: {}", words.join(" "))),
            }
        }
    }

    fn report_state_change(&mut self, outputs: &ComponentOutputs, report: &mut impl FnMut(&str)) {
        self.report_bridge_state(outputs, report);
        let ComponentOutputs { connected, fault, limited, not_taken, quality, .. } = *outputs;
        let state = (connected, fault, limited, not_taken, quality);
        if self.state.replace(state) == Some(state) {
            return;
        }
        if connected {
            self.down = None;
        }
        let mut text = match quality {
            OffsetQuality::Off => "offsets are off",
            OffsetQuality::Live => "offsets are live",
            OffsetQuality::TemperatureModel => "offsets come from the temperature model",
            OffsetQuality::WarmUpModel => "offsets come from the warm-up model",
            OffsetQuality::Hold => "offsets are held",
            OffsetQuality::RampingOut => "offsets are taken back",
            OffsetQuality::Fault => "no offsets are sent",
        }
        .to_owned();
        if !connected {
            text += "; the bridge sends no valid offsets";
        }
        if fault {
            text += "; fault";
        }
        if not_taken {
            text +=
                "; LinuxCNC does not take the offsets (are all pins connected as in trueup.hal?)";
        }
        if limited {
            text +=
                "; LinuxCNC does not let an axis follow (soft limit, joint mode, OFFSET_AV_RATIO)";
        }
        report(&text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        component::ComponentInputs, joint_offsets::MAX_JOINTS, offset_follower::RateLimits,
        offset_target::OffsetLimits,
    };
    use std::cell::Cell;
    use trueup_client::pinned_calibration::CalibrationPolicy;
    use trueup_core::{
        cnc::CncMessage,
        learned_changes::{LearnedChangeRequest, calibration_id},
    };
    use trueup_link::{
        receiver::CncReceiver,
        slcan::AdapterMessage,
        status::{self, Status, StatusItem},
    };

    const RUNNING: u32 = 0x1234_ABCD;

    fn component() -> Component {
        let pace = RateLimits {
            slew_nm_per_s: 500e3,
            cycle_s: 1e-3,
            acceleration_nm_per_s2: f64::INFINITY,
            planner_keeps_slew: true,
        };
        let limits = OffsetLimits {
            max_nm: [200_000; 3],
            stale: Duration::from_millis(100),
            hold: Duration::from_millis(2_000),
        };
        let options = ComponentOptions {
            limits,
            pace: [pace; 3],
            position_period: Duration::from_millis(2),
            sends_rotary: false,
            against_um: [Some(0.0); 3],
            joints: [None; MAX_JOINTS],
        };
        Component::new(Duration::ZERO, options)
    }

    /// Returns what a component says of what was learned in five frames of `Control`, to a bridge that runs on
    /// `RUNNING`.
    fn taught(
        news: Option<impl Fn() -> Option<LearnedCorrectionUpdate>>,
        of: Option<u32>,
    ) -> Vec<(u8, i16)> {
        let (mut component, mut receiver) = (component(), CncReceiver::new());
        let item = StatusItem::Calibration(RUNNING);
        let reported =
            status::encode(&Status { last_refused: status::FrameRejectReason::None, item }, 0);
        component.receive(Duration::ZERO, &AdapterMessage::Frame(reported));
        let mut lessons = LearnedCorrectionSender { news, of, amounts: None };
        let mut all = Vec::new();
        for turn in 0..5 {
            lessons.send_learned_corrections(&mut component, &mut |_: &str| ());
            let (_, frames) =
                component.step(Duration::from_millis(20 * turn), &ComponentInputs::default());
            for frame in &frames {
                if let Some(CncMessage::Control(it)) = receiver.accept(frame).expect("in order") {
                    let LearnedChangeRequest { part, amount, calibration } = it.learned;
                    assert!(
                        part == 0 || calibration == calibration_id(RUNNING),
                        "{:?}",
                        it.learned
                    );
                    all.push((part, amount));
                }
            }
        }
        all.sort_unstable();
        all
    }

    #[test]
    fn without_a_learned_file_any_bridge_receives_that_nothing_was_learned() {
        let none = None::<fn() -> Option<LearnedCorrectionUpdate>>;
        for of in [None, Some(RUNNING), Some(RUNNING ^ 1)] {
            assert_eq!(taught(none, of), [(1, 0), (2, 0), (3, 0), (4, 0), (5, 0)], "{of:?}");
        }
    }

    #[test]
    fn of_a_learned_file_nothing_is_reported_until_it_is_read_and_then_only_to_its_own_calibration()
    {
        let nothing = [(0, 0); 5];
        let (ours, other) = (Some(RUNNING), Some(RUNNING ^ 1));
        assert_eq!(taught(Some(|| None), ours), nothing, "not looked at yet");
        assert_eq!(
            taught(Some(|| Some(LearnedCorrectionUpdate::default())), ours),
            nothing,
            "not readable"
        );
        let read = || {
            Some(LearnedCorrectionUpdate {
                amounts: Some([10, 20, 30, 40, -50]),
                notices: Vec::new(),
            })
        };
        assert_eq!(taught(Some(read), ours), [(1, 10), (2, 20), (3, 30), (4, 40), (5, -50)]);
        let looks = Cell::new(0);
        let gone = || match looks.replace(looks.get() + 1) {
            0 => read(),
            _ => Some(LearnedCorrectionUpdate::default()),
        };
        assert_eq!(taught(Some(gone), ours), taught(Some(read), ours), "a file that is gone");
        assert_eq!(taught(Some(read), other), nothing, "another calibration");
        assert_eq!(taught(Some(read), None), nothing, "the machine file does not compile");
    }

    #[test]
    fn another_calibration_than_the_machine_files_is_reported_once_and_so_is_each_state() {
        let rule = CalibrationPolicy::Machine { crc: 0xABCD, path: "m.toml".into() };
        let mut news = StateReporter::new(PinnedCalibration::new(rule));
        let mut messages = Vec::new();
        let shows = |calibration, state| ComponentOutputs {
            calibration,
            state,
            ..ComponentOutputs::default()
        };
        for (outputs, is_engage_allowed) in [
            (shows(None, StateBits::default()), false),
            (shows(Some(0xABCD), StateBits::default()), true),
            (shows(Some(0x1234), StateBits::default()), false),
            (shows(Some(0x1234), StateBits::OLDER_CALIBRATION), false),
            (shows(Some(0x1234), StateBits::OLDER_CALIBRATION), false),
            (shows(Some(0xABCD), StateBits::default()), true),
        ] {
            news.report_bridge_state(&outputs, &mut |text: &str| messages.push(text.to_owned()));
            assert_eq!(news.pinned.is_engage_allowed(), is_engage_allowed, "{outputs:?}");
        }
        assert_eq!(messages.len(), 3, "{messages:#?}");
        assert!(messages[0].contains("00001234") && messages[0].contains("0000abcd"));
        assert_eq!(messages[1], "the bridge says: older-calibration");
        assert_eq!(messages[2], "the bridge reports no fault");
    }

    #[test]
    fn a_wire_that_is_cut_is_reported_once_and_so_is_its_mending() {
        let mut news = StateReporter::new(PinnedCalibration::new(CalibrationPolicy::Any));
        let mut messages = Vec::new();
        for cut in [None, Some("trueup.0.z-counts"), Some("trueup.0.z-counts"), None, None] {
            news.report_disconnected_pin(cut, &mut |text: &str| messages.push(text.to_owned()));
        }
        assert_eq!(messages.len(), 2, "{messages:#?}");
        assert!(messages[0].contains("trueup.0.z-counts") && messages[1].contains("again"));
    }
}
