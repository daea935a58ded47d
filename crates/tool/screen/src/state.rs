//! All that the screen knows, and what a key does. No terminal and no clock: time is an argument, in
//! seconds since the screen began.

use trueup_client::{
    cnc::CncState,
    remedy::find_remedies,
    state_text::{flag_names, offset_um, pending_action},
    status::BoardStatus,
};
use trueup_core::{cnc::Output, design_parameters::TEMPERATURE_CHANNEL_COUNT};
use trueup_link::{
    frame::Frame,
    receiver::{FrameCounters, OffsetReceiver},
    status::StatusItem,
};
use trueup_machine::machine_file::Quantity;

use crate::{
    compensation_model::{CompensationModel, LiveValues, OffsetContribution},
    trend::{GAUGE_DIFFERENCE_INDEX, TREND_SERIES_COUNT, TrendBuffer},
};

/// Offsets older than this are not shown as being of now: 1 s is a thousand cycles.
const MAX_OFFSET_AGE_S: f64 = 1.0;
/// A value of the status older than this is shown as old: each item comes every 1.5 s.
const MAX_STATUS_AGE_S: f64 = 4.0;
/// A requested reading of the sensor counts for this time; then the one of the status does.
const MAX_SENSOR_AGE_S: f64 = 1.0;
/// A gauge's reading older than this is not of the moment at which a key is pressed.
pub(crate) const MAX_GAUGE_AGE_S: f64 = 1.0;
/// Time for which a message is shown.
const MESSAGE_DURATION_S: f64 = 8.0;

/// A key that was pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PressedKey {
    /// A character.
    Char(char),
    /// Return.
    Enter,
    /// Escape.
    Escape,
    /// Backspace.
    Backspace,
    /// Ctrl-C.
    Interrupt,
}

/// An action for the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ScreenAction {
    /// End.
    Quit,
    /// Begin a recording.
    Record,
    /// End the recording.
    EndRecording,
    /// Write this reading of the gauge down, in µm.
    Mark(f64),
    /// Take the last reading out of the recording.
    Unmark,
}

/// The line to the bridge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LinkState {
    /// It is being opened.
    Opening,
    /// It is open.
    Up,
    /// It is not, and is tried again; why.
    Down(String),
}

/// Whose laws the screen uses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ModelSource {
    /// No laws.
    None,
    /// The board's own calibration; this many percent of it have come.
    Reading(u32),
    /// The board's own calibration.
    Board,
    /// A machine file of this name.
    File(String),
}

/// The gauge that measures the machine while the bridge runs.
#[derive(Clone, Debug)]
pub(crate) struct GaugeState {
    /// The quantity that it measures.
    pub quantity: Quantity,
    /// It speaks to this computer; otherwise its readings are typed.
    pub is_live: bool,
    /// The newest reading in µm, and when.
    pub latest: Option<(f64, f64)>,
    /// Its fault, as text for the user.
    pub connection_error: Option<String>,
}

/// When the items of the status came last, in s since the screen began.
#[derive(Clone, Copy, Debug, Default)]
struct ReceptionTimes {
    growth: Option<f64>,
    temperatures: [Option<f64>; TEMPERATURE_CHANNEL_COUNT / 2],
    state: Option<f64>,
}

/// All that the screen knows.
pub(crate) struct ScreenState {
    /// Where the bridge is, as the user wrote it.
    pub port: String,
    /// The line.
    pub link: LinkState,
    /// The laws that make shares and volts of what is received.
    pub laws: Option<CompensationModel>,
    /// Where they are from.
    pub source: ModelSource,
    /// The gauge.
    pub gauge: GaugeState,
    /// The part of a gauge's reading that is typed so far.
    pub prompt: Option<String>,
    /// Where the recording goes.
    pub recording: Option<String>,
    /// Readings of the gauge that stand in the recording.
    pub marks: usize,
    /// Rows of the recording.
    pub rows: u64,
    /// Every key is explained.
    pub is_helping: bool,
    /// The board's state, as it reports it.
    pub board: BoardStatus,
    /// The share of each cause.
    pub shares: Vec<OffsetContribution>,
    /// The last minutes.
    pub trend: TrendBuffer,
    /// Which of the series is drawn.
    pub series: usize,
    /// Frames in the last second.
    pub frames_per_s: f64,
    /// Lines that carry no frame that can be read.
    pub malformed_lines: u32,
    /// Frames that were too old to be used: the line had stalled.
    pub dropped: u32,
    offsets: OffsetReceiver,
    output: Option<(Output, f64)>,
    sensor_growth: Option<(Option<f64>, f64)>,
    /// When the elongation came last, each pair of temperatures, and anything of the status.
    reported_s: ReceptionTimes,
    cnc: CncState,
    frames: u32,
    counted_s: f64,
    message: Option<(String, f64)>,
    now_s: f64,
}

impl ScreenState {
    /// Before anything was learnt of the bridge at `port`.
    #[must_use]
    pub fn new(port: &str, quantity: Quantity, has_indicator: bool) -> Self {
        Self {
            port: port.into(),
            link: LinkState::Opening,
            laws: None,
            source: ModelSource::None,
            gauge: GaugeState {
                quantity,
                is_live: has_indicator,
                latest: None,
                connection_error: None,
            },
            prompt: None,
            recording: None,
            marks: 0,
            rows: 0,
            is_helping: false,
            board: BoardStatus::default(),
            shares: Vec::new(),
            trend: TrendBuffer::default(),
            series: 0,
            frames_per_s: 0.0,
            malformed_lines: 0,
            dropped: 0,
            offsets: OffsetReceiver::new(),
            output: None,
            sensor_growth: None,
            reported_s: ReceptionTimes::default(),
            cnc: CncState::default(),
            frames: 0,
            counted_s: 0.0,
            message: None,
            now_s: 0.0,
        }
    }

    /// Takes a frame from the bus.
    pub fn receive(&mut self, frame: &Frame, now_s: f64) {
        self.now_s = now_s;
        self.frames += 1;
        match self.board.receive(frame) {
            Some(StatusItem::Elongation(_)) => self.reported_s.growth = Some(now_s),
            Some(StatusItem::Temperatures { pair, .. }) => {
                if let Some(place) = self.reported_s.temperatures.get_mut(usize::from(pair)) {
                    *place = Some(now_s);
                }
            }
            Some(StatusItem::State(_)) => self.reported_s.state = Some(now_s),
            _ => {}
        }
        self.cnc.receive(frame, (now_s * 1_000.0) as u64);
        // What is refused is counted in there.
        if let Ok(Some(output)) = self.offsets.accept(frame) {
            self.output = Some((output, now_s));
        }
    }

    /// The elongation that was requested, in µm; `None`: the sensor gives none.
    pub(crate) fn set_sensor_growth(&mut self, growth_um: Option<f64>, now_s: f64) {
        self.sensor_growth = Some((growth_um, now_s));
    }

    /// Takes the gauge's newest reading, or what is wrong with it. A reading that is waited for is written down.
    pub(crate) fn handle_gauge_reading(
        &mut self,
        reading: Result<f64, String>,
        now_s: f64,
    ) -> Option<ScreenAction> {
        self.now_s = now_s;
        match reading {
            Ok(um) => {
                self.gauge.latest = Some((um, now_s));
                self.gauge.connection_error = None;
                self.prompt.take().is_some().then_some(ScreenAction::Mark(um))
            }
            Err(why) => {
                self.gauge.connection_error = Some(why);
                None
            }
        }
    }

    /// Takes a sample for the trend, and the shares of this moment: a few times a second.
    pub(crate) fn sample_live_values(&mut self, now_s: f64) {
        self.now_s = now_s;
        if now_s - self.counted_s >= 1.0 {
            self.frames_per_s = f64::from(self.frames) / (now_s - self.counted_s);
            (self.frames, self.counted_s) = (0, now_s);
        }
        let growth_um = self.growth_um();
        // What is old says nothing of now.
        let centi_c: [Option<i16>; TEMPERATURE_CHANNEL_COUNT] = std::array::from_fn(|channel| {
            self.board.centi_c[channel].filter(|_| self.stale_temperature_age_s(channel).is_none())
        });
        self.shares = match &mut self.laws {
            Some(laws) => {
                let (centi_c, cnc) = (&centi_c[..], &self.cnc);
                laws.offset_contributions(&LiveValues { time_s: now_s, growth_um, centi_c, cnc })
            }
            None => Vec::new(),
        };
        let mut values = [f64::NAN; TREND_SERIES_COUNT];
        values[0] = growth_um.unwrap_or(f64::NAN);
        values[1..4].copy_from_slice(&self.offset_um().unwrap_or([f64::NAN; 3]));
        for (value, centi_c) in values[4..].iter_mut().zip(centi_c) {
            *value = centi_c.map_or(f64::NAN, |centi_c| f64::from(centi_c) / 100.0);
        }
        values[GAUGE_DIFFERENCE_INDEX] = self.gauge_difference_um().unwrap_or(f64::NAN);
        self.trend.push(now_s, values);
    }

    /// Takes a key. Returns the action that it requests.
    pub(crate) fn handle_key(&mut self, key: PressedKey) -> Option<ScreenAction> {
        if key == PressedKey::Interrupt {
            return Some(ScreenAction::Quit);
        }
        if self.prompt.is_some() {
            return self.handle_prompt_key(key);
        }
        let is_helping = std::mem::take(&mut self.is_helping);
        match key {
            PressedKey::Char('q' | 'Q') => return Some(ScreenAction::Quit),
            PressedKey::Char('r' | 'R') => {
                let is_recording = self.recording.is_some();
                return Some(if is_recording {
                    ScreenAction::EndRecording
                } else {
                    ScreenAction::Record
                });
            }
            PressedKey::Char('g' | 'G') => return self.request_gauge_reading(),
            PressedKey::Char('u' | 'U') if self.marks > 0 => return Some(ScreenAction::Unmark),
            PressedKey::Char('u' | 'U') => {
                self.show_message("no reading of the gauge is in the recording")
            }
            PressedKey::Char('t' | 'T') => self.select_next_series(),
            PressedKey::Char('?' | 'h') => self.is_helping = !is_helping,
            _ => {}
        }
        None
    }

    fn request_gauge_reading(&mut self) -> Option<ScreenAction> {
        if self.recording.is_none() {
            self.show_message("press r first: a gauge reading is written into a recording");
            return None;
        }
        match self.gauge.latest {
            Some((um, at_s)) if self.gauge.is_live && self.now_s - at_s <= MAX_GAUGE_AGE_S => {
                Some(ScreenAction::Mark(um))
            }
            _ => {
                self.prompt = Some(String::new());
                None
            }
        }
    }

    fn handle_prompt_key(&mut self, key: PressedKey) -> Option<ScreenAction> {
        let text = self.prompt.as_mut()?;
        match key {
            PressedKey::Char(it @ ('0'..='9' | '+' | '-' | '.')) => text.push(it),
            // Where numbers are written with a comma: left out, 1,5 would be 15.
            PressedKey::Char(',') => text.push('.'),
            PressedKey::Backspace => _ = text.pop(),
            PressedKey::Enter => match text.parse::<f64>() {
                Ok(um) => {
                    self.prompt = None;
                    self.gauge.latest = Some((um, self.now_s));
                    return Some(ScreenAction::Mark(um));
                }
                Err(_) => self
                    .show_message("type the reading in µm, such as -3.5, then Enter; Esc leaves"),
            },
            PressedKey::Escape => self.prompt = None,
            PressedKey::Char(_) | PressedKey::Interrupt => {}
        }
        None
    }

    /// The next series of which something is known.
    fn select_next_series(&mut self) {
        let after = (1..=TREND_SERIES_COUNT).map(|step| (self.series + step) % TREND_SERIES_COUNT);
        let known = after.into_iter().find(|which| !self.trend.series(*which).is_empty());
        self.series = known.unwrap_or(self.series);
    }

    /// Shows the user a message.
    pub(crate) fn show_message(&mut self, message: impl Into<String>) {
        self.message = Some((message.into(), self.now_s));
    }

    /// Returns the message, while it is new.
    #[must_use]
    pub fn message(&self) -> Option<&str> {
        let (message, at_s) = self.message.as_ref()?;
        (self.now_s - at_s < MESSAGE_DURATION_S).then_some(message)
    }

    /// Returns the moment that the screen shows, in s since it began.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.now_s
    }

    /// Returns the newest offsets; `None` where none came lately.
    #[must_use]
    pub fn output(&self) -> Option<&Output> {
        let (output, at_s) = self.output.as_ref()?;
        (self.now_s - at_s <= MAX_OFFSET_AGE_S).then_some(output)
    }

    /// Returns the offsets of X, Y and Z in µm, if they are available.
    #[must_use]
    pub fn offset_um(&self) -> Option<[f64; 3]> {
        self.output().and_then(offset_um)
    }

    /// Returns the growth by the sensor, in µm: the newest that is known, as long as it is not old.
    #[must_use]
    pub fn growth_um(&self) -> Option<f64> {
        self.last_growth_um().filter(|(_, age_s)| age_s.is_none()).map(|(um, _)| um)
    }

    /// Returns the last growth that came, in µm, and its age in s where it is old.
    pub(crate) fn last_growth_um(&self) -> Option<(f64, Option<f64>)> {
        match self.sensor_growth {
            Some((growth_um, at_s)) if self.now_s - at_s <= MAX_SENSOR_AGE_S => {
                Some((growth_um?, None))
            }
            _ => Some((self.board.elongation_um()?, self.stale_age_s(self.reported_s.growth))),
        }
    }

    /// Returns how long ago offsets came last, in s; `None`: none ever did.
    pub(crate) fn output_age_s(&self) -> Option<f64> {
        self.output.as_ref().map(|(_, at_s)| self.now_s - at_s)
    }

    /// Returns the last offsets that came, in µm, and their age in s; `None`: they are new, were not available, or none
    /// came.
    pub(crate) fn stale_offset_um(&self) -> Option<([f64; 3], f64)> {
        let (output, at_s) = self.output.as_ref()?;
        let age_s = self.now_s - at_s;
        Some((offset_um(output)?, age_s)).filter(|_| age_s > MAX_OFFSET_AGE_S)
    }

    /// Returns the age in s of a channel's temperature, where it is old.
    pub(crate) fn stale_temperature_age_s(&self, channel: usize) -> Option<f64> {
        self.stale_age_s(self.reported_s.temperatures.get(channel / 2).copied().flatten())
    }

    /// Returns the age in s of the last report of the board about its faults, where it is old.
    pub(crate) fn stale_state_age_s(&self) -> Option<f64> {
        self.stale_age_s(self.reported_s.state)
    }

    /// Returns how long ago this was, in s, where it is too long.
    fn stale_age_s(&self, at_s: Option<f64>) -> Option<f64> {
        let age_s = self.now_s - at_s?;
        (age_s > MAX_STATUS_AGE_S).then_some(age_s)
    }

    /// Returns what the bridge has for the quantity of the gauge, in µm: the growth, or the error of an axis that its
    /// offset corrects.
    pub(crate) fn bridge_value_um(&self) -> Option<f64> {
        let axis = match self.gauge.quantity {
            Quantity::Elongation => return self.growth_um(),
            Quantity::Dx => 0,
            Quantity::Dy => 1,
            Quantity::Dz => 2,
        };
        self.offset_um().map(|um| 0.0 - um[axis])
    }

    /// Returns the gauge minus the bridge, in µm, while the gauge's reading is of now.
    #[must_use]
    pub(crate) fn gauge_difference_um(&self) -> Option<f64> {
        let (um, at_s) = self.gauge.latest?;
        (self.now_s - at_s <= MAX_GAUGE_AGE_S).then_some(um - self.bridge_value_um()?)
    }

    /// For whom the bridge waits that gives no offset: "engage" or "confirm".
    pub(crate) fn pending_action(&self) -> Option<&'static str> {
        pending_action(self.output()?.quality, self.board.state, self.board.calibration)
    }

    /// A reading of the gauge was written down, or taken out: its number and the rows of the recording.
    pub(crate) fn set_recording_counts(&mut self, readings: usize, rows: u64) {
        (self.marks, self.rows) = (readings, rows);
    }

    /// The reading is drawn where it was taken.
    pub(crate) fn record_gauge_reading(&mut self, um: f64) {
        self.trend.record_gauge_reading(self.now_s, um);
    }

    /// The last of them is not drawn any more.
    pub(crate) fn undo_gauge_reading(&mut self) {
        self.trend.undo_gauge_reading();
    }

    /// Returns what was received of the offsets, since the screen began.
    #[must_use]
    pub fn counters(&self) -> FrameCounters {
        self.offsets.counters()
    }

    /// Halves of offsets that were dropped because their other half never came.
    #[must_use]
    pub fn unpaired_frame_count(&self) -> u32 {
        self.offsets.unpaired_frame_count()
    }

    /// Returns the tool and the conditions that the laws depend on, by their names; NaN: the CNC does not say.
    #[must_use]
    pub fn conditions(&self) -> Vec<(String, f64)> {
        let now_ms = (self.now_s * 1_000.0) as u64;
        self.laws.as_ref().map(|laws| laws.conditions(&self.cnc, now_ms)).unwrap_or_default()
    }

    /// Returns what is wrong, with what to do about it.
    pub(crate) fn alarms(&self) -> Vec<(&'static str, &'static str)> {
        let mut words = self.board.fault_and_state_names();
        words.extend(self.output().map(|output| flag_names(output.flags)).unwrap_or_default());
        let of_cnc = ["cnc-damaged", "cnc-sequence", "cnc-malformed"];
        let refused = of_cnc.into_iter().zip(self.board.rejected_cnc_frame_counts());
        words.extend(refused.filter(|(_, count)| *count > 0).map(|(word, _)| word));
        find_remedies(&words)
    }

    /// Nothing on the line was damaged or out of order.
    #[must_use]
    pub fn is_error_free(&self) -> bool {
        let FrameCounters { malformed, crc_errors, sequence_errors, .. } = self.counters();
        let refused = self.board.rejected_status_frame_count() + self.malformed_lines;
        // What was dropped as too old is missing in the sequence, and is no error of a frame.
        let sequence_errors = if self.dropped == 0 { sequence_errors } else { 0 };
        malformed + crc_errors + sequence_errors + refused == 0
    }
}
