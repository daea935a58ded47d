//! The loop: what comes from the line, the keys and the gauge goes into the state, the state is drawn.

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use anyhow::{Context as _, Result};
use ratatui::{
    DefaultTerminal,
    crossterm::event::{
        self, Event as TerminalEvent, KeyCode, KeyEvent, KeyEventKind, KeyModifiers,
    },
};
use trueup_client::{
    UnusableInputError,
    build::BuildVersion,
    connection::{BridgeConnection, ConnectionEvent},
    poll::{ObjectPoller, PollOutcome},
    port::PortAddress,
    port_holder::port_holder,
    record::Recorder,
    sdo_object,
};
use trueup_link::{
    frame::Frame,
    frames::{self, NmtState as NodeState},
    slcan::AdapterMessage,
};
use trueup_machine::machine_file::Quantity;

use crate::{
    compensation_model::CompensationModel,
    indicator::IndicatorConfig,
    state::{LinkState, ModelSource, PressedKey, ScreenAction, ScreenState},
    view::{self, Theme},
};

/// From one sample of the trend to the next, and from one question for the growth to the next: as fast as
/// a number can be read while a finger pushes.
const SAMPLE_PERIOD: Duration = Duration::from_millis(200);
/// From one drawing to the next.
const DRAW_PERIOD: Duration = Duration::from_millis(100);
/// Characters of a picture of the screen, across and down.
const SNAPSHOT_SIZE_CHARS: [u16; 2] = [80, 24];
/// A look at line and keys.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// A calibration is read once; after a refusal it is requested again, not sooner than this.
const READ_RETRY_INTERVAL: Duration = Duration::from_secs(3_600);

/// Options of the screen.
pub struct ScreenOptions {
    /// Where the bridge is.
    pub port: String,
    /// Who shows it: a bridge of another source is reported.
    pub tool: BuildVersion,
    /// The machine file.
    pub machine: Option<PathBuf>,
    /// Where a recording goes, which begins at once; otherwise `r` begins one in a folder of this day and
    /// time.
    pub record: Option<PathBuf>,
    /// Record nothing of a bridge that runs on another calibration than the machine file makes.
    pub is_strict: bool,
    /// The quantity that the gauge measures.
    pub quantity: Quantity,
    /// A gauge that speaks.
    pub indicator: Option<IndicatorConfig>,
    /// A picture of the screen is written here after so long, and nothing is drawn.
    pub picture: Option<(PathBuf, Duration)>,
}

/// Shows the bridge until the user has seen enough; whether all that came was whole and in order.
///
/// # Errors
/// The port or the machine file is wrong; the terminal cannot be used; a recording cannot be written.
pub fn run(options: ScreenOptions) -> Result<bool> {
    let port = PortAddress::parse(&options.port)?;
    let laws = options.machine.as_deref().map(CompensationModel::read).transpose()?;
    let mut state = ScreenState::new(&options.port, options.quantity, options.indicator.is_some());
    if let (Some(laws), Some(file)) = (laws, &options.machine) {
        let name = file.file_name().unwrap_or(file.as_os_str());
        state.source = ModelSource::File(name.to_string_lossy().into_owned());
        state.laws = Some(laws);
    }
    let theme =
        Theme { has_colour: std::env::var_os("NO_COLOR").is_none_or(|var_os| var_os.is_empty()) };
    let interface = port.interface_name().to_owned();
    let port_name = port.clone();
    let line = BridgeConnection::spawn(move || port_name.open());
    let indicator = options.indicator.clone().map(IndicatorConfig::listen);
    let mut live = EventLoop {
        state,
        options,
        port,
        interface,
        recorder: None,
        start: Instant::now(),
        growth: ObjectPoller::new(sdo_object::ELONGATION, SAMPLE_PERIOD, Instant::now()),
        commit: ObjectPoller::new(sdo_object::COMMIT, READ_RETRY_INTERVAL, Instant::now()),
        calibration: None,
    };
    if live.options.record.is_some() && !live.options.is_strict {
        live.start_recording()?;
    }
    if let Some((path, after)) = live.options.picture.clone() {
        live.run_headless(&line, after)?;
        let picture = view::svg::render_svg(&live.state, SNAPSHOT_SIZE_CHARS);
        fs::write(&path, picture).with_context(|| format!("while writing {}", path.display()))?;
        return Ok(live.state.is_error_free());
    }
    let terminal = ratatui::try_init().context("the terminal cannot be used; try --plain")?;
    let ended = live.run_in_terminal(terminal, theme, &line, indicator.as_ref());
    // `restore` prints its failure to a standard error that may be gone.
    _ = ratatui::try_restore();
    ended?;
    if let Some(recorder) = &live.recorder {
        trueup_output::write_diagnostic(recorder.summary());
    }
    Ok(live.state.is_error_free())
}

struct EventLoop {
    state: ScreenState,
    options: ScreenOptions,
    port: PortAddress,
    interface: String,
    recorder: Option<Recorder>,
    start: Instant,
    growth: ObjectPoller,
    /// Requested once as well.
    commit: ObjectPoller,
    /// The calibration of this CRC is being read, or was.
    calibration: Option<(u32, ObjectPoller)>,
}

impl EventLoop {
    fn run_in_terminal(
        &mut self,
        mut terminal: DefaultTerminal,
        theme: Theme,
        line: &BridgeConnection,
        indicator: Option<&std::sync::mpsc::Receiver<crate::indicator::IndicatorResult>>,
    ) -> Result<()> {
        let (mut sampled, mut drawn) = (None::<Instant>, None::<Instant>);
        loop {
            for received in line.take_events() {
                self.handle_connection_event(received, line)?;
            }
            for received in indicator.iter().flat_map(|indicator| indicator.try_iter()) {
                let action = self.state.handle_gauge_reading(received, self.now_s());
                self.perform_action(action)?;
            }
            let now = Instant::now();
            if sampled.is_none_or(|at| now - at >= SAMPLE_PERIOD) {
                sampled = Some(now);
                self.state.sample_live_values(self.now_s());
                self.send_due_requests(line, now);
            }
            if drawn.is_none_or(|at| now - at >= DRAW_PERIOD) {
                drawn = Some(now);
                terminal.draw(|frame| view::draw(frame, &self.state, theme))?;
                if let Some(recorder) = &mut self.recorder {
                    recorder.flush()?;
                }
            }
            while event::poll(POLL_INTERVAL)? {
                let pressed = match event::read()? {
                    TerminalEvent::Key(key) if key.kind != KeyEventKind::Release => {
                        self::convert_key_event(key)
                    }
                    _ => None,
                };
                let action = pressed.and_then(|key| self.state.handle_key(key));
                if self.perform_action(action)? {
                    return Ok(());
                }
                drawn = None;
            }
        }
    }

    /// Processes what comes for the time `length`, without a terminal.
    fn run_headless(&mut self, line: &BridgeConnection, length: Duration) -> Result<()> {
        while self.start.elapsed() < length {
            for event in line.take_events() {
                self.handle_connection_event(event, line)?;
            }
            self.state.sample_live_values(self.now_s());
            self.send_due_requests(line, Instant::now());
            std::thread::sleep(SAMPLE_PERIOD);
        }
        Ok(())
    }

    fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn handle_connection_event(
        &mut self,
        event: ConnectionEvent,
        line: &BridgeConnection,
    ) -> Result<()> {
        match event {
            ConnectionEvent::Up => self.state.link = LinkState::Up,
            ConnectionEvent::Down(why) => {
                let other = port_holder(&self.port);
                let other = other.map(|holder| format!("; {holder} has the line: end it first"));
                self.state.link = LinkState::Down(why + &other.unwrap_or_default());
            }
            ConnectionEvent::Received(AdapterMessage::Frame(frame)) => {
                self.handle_frame(&frame, line)?
            }
            ConnectionEvent::Received(AdapterMessage::Malformed(_)) => {
                self.state.malformed_lines += 1
            }
            ConnectionEvent::Late => {
                self.state.dropped += 1;
                self.state.show_message("the line has stalled: old samples are dropped");
            }
            ConnectionEvent::Received(_) => {}
        }
        Ok(())
    }

    fn handle_frame(&mut self, frame: &Frame, line: &BridgeConnection) -> Result<()> {
        let now = Instant::now();
        self.state.receive(frame, self.now_s());
        if let Some(recorder) = &mut self.recorder {
            recorder.set_running_calibration(self.state.board.calibration);
            recorder.receive(frame, SystemTime::now())?;
            self.state.set_recording_counts(recorder.gauge_reading_count(), recorder.row_count());
        }
        if frames::decode_heartbeat(frame) == Ok(NodeState::BootUp) {
            self.state.show_message("the bridge has started anew");
        }
        // What the bridge runs on is known now.
        let is_requested = self.options.is_strict && self.options.record.is_some();
        if is_requested && self.state.board.calibration.is_some() {
            self.start_recording()?;
        }
        // One transfer at a time: the calibration first, as it is requested once.
        if let Some((_, poll)) = &mut self.calibration
            && poll.is_running()
        {
            match poll.receive(frame, now) {
                PollOutcome::Request(request) => line.try_send(request),
                PollOutcome::Bytes(blob) => self.apply_board_calibration(&blob),
                PollOutcome::Rejected => self.state.source = ModelSource::None,
                PollOutcome::Nothing => {}
            }
            if let Some((_, poll)) = &self.calibration
                && let Some((bytes, of)) = poll.progress()
            {
                let percent = bytes as u64 * 100 / u64::from(of.max(1));
                self.state.source = ModelSource::Reading(u32::try_from(percent).unwrap_or(100));
            }
            return Ok(());
        }
        if self.commit.is_running() {
            if let PollOutcome::Bytes(answer) = self.commit.receive(frame, now) {
                let bridge = self.options.tool.with_commit(&answer);
                if let Some(difference) = self.options.tool.describe_difference(&bridge) {
                    self.state.show_message(difference);
                }
            }
            return Ok(());
        }
        match self.growth.receive(frame, now) {
            PollOutcome::Request(request) => line.try_send(request),
            PollOutcome::Bytes(bytes) => {
                let thousandths = bytes.first_chunk().copied().map(i32::from_le_bytes);
                let thousandths =
                    thousandths.filter(|thousandths| *thousandths != sdo_object::NOT_AVAILABLE);
                let growth_um = thousandths.map(|thousandths| f64::from(thousandths) / 1_000.0);
                self.state.set_sensor_growth(growth_um, self.now_s());
            }
            PollOutcome::Rejected | PollOutcome::Nothing => {}
        }
        Ok(())
    }

    /// Sends the requests to the bridge that are due: reading alone, and none while the line is down.
    fn send_due_requests(&mut self, line: &BridgeConnection, now: Instant) {
        if self.state.link != LinkState::Up {
            return;
        }
        let running = self.state.board.calibration.filter(|crc| *crc != 0);
        let is_file = matches!(self.state.source, ModelSource::File(_));
        if let (Some(crc), false) = (running, is_file)
            && self.calibration.as_ref().is_none_or(|(of, _)| *of != crc)
        {
            self.calibration = Some((
                crc,
                ObjectPoller::new(sdo_object::RUNNING_CALIBRATION, READ_RETRY_INTERVAL, now),
            ));
        }
        let calibration = self.calibration.as_mut().filter(|_| !self.commit.is_running());
        let calibration = calibration.and_then(|(_, poll)| poll.take_due_request(now));
        let is_reading = self.calibration.as_ref().is_some_and(|(_, poll)| poll.is_running());
        let commit = if is_reading { None } else { self.commit.take_due_request(now) };
        let is_asking = is_reading || self.commit.is_running();
        let growth = if is_asking { None } else { self.growth.take_due_request(now) };
        for request in calibration.into_iter().chain(commit).chain(growth) {
            line.try_send(request);
        }
    }

    fn apply_board_calibration(&mut self, blob: &[u8]) {
        self.state.laws = CompensationModel::from_board_blob(blob);
        self.state.source = match self.state.laws {
            Some(_) => ModelSource::Board,
            None => ModelSource::None,
        };
    }

    /// Executes what a key has requested; returns whether it was to end.
    fn perform_action(&mut self, action: Option<ScreenAction>) -> Result<bool> {
        match action {
            None => {}
            Some(ScreenAction::Quit) => return Ok(true),
            Some(ScreenAction::Record) => {
                if let Err(error) = self.start_recording() {
                    self.state.show_message(format!("{error:#}"));
                }
            }
            Some(ScreenAction::EndRecording) => {
                self.state.recording = None;
                if let Some(mut recorder) = self.recorder.take() {
                    recorder.flush()?;
                    self.state.show_message(recorder.summary());
                }
            }
            Some(ScreenAction::Mark(um)) => {
                if let Some(recorder) = &mut self.recorder {
                    recorder.record_gauge_reading(um);
                    self.state
                        .set_recording_counts(recorder.gauge_reading_count(), recorder.row_count());
                    self.state.record_gauge_reading(um);
                    self.state.show_message(format!("{um:+.2} µm written down; u takes it back"));
                }
            }
            Some(ScreenAction::Unmark) => {
                if let Some(recorder) = &mut self.recorder
                    && let Some(um) = recorder.undo_gauge_reading()?
                {
                    self.state
                        .set_recording_counts(recorder.gauge_reading_count(), recorder.row_count());
                    self.state.undo_gauge_reading();
                    self.state.show_message(format!("{um:+.2} µm taken out again"));
                }
            }
        }
        Ok(false)
    }

    fn start_recording(&mut self) -> Result<()> {
        let expected = self.state.laws.as_ref().and_then(CompensationModel::crc);
        if self.options.is_strict
            && (expected.is_none() || self.state.board.calibration != expected)
        {
            return Err(UnusableInputError::OtherCalibration.into());
        }
        // A second recording must not be written over the first.
        let path = self
            .options
            .record
            .take()
            .unwrap_or_else(|| unique_recording_folder(SystemTime::now()));
        let machine = self.options.machine.as_deref();
        let quantity = Some(self.options.quantity);
        self.recorder = Some(Recorder::create(&path, machine, &self.interface, quantity)?);
        self.state.set_recording_counts(0, 0);
        self.state.recording = Some(display_path(&path));
        Ok(())
    }
}

fn display_path(path: &Path) -> String {
    path.display().to_string()
}

/// Returns a folder that no other recording has.
fn unique_recording_folder(now: SystemTime) -> PathBuf {
    let since = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = u32::try_from(since.as_secs()).unwrap_or(u32::MAX);
    let stamp = trueup_client::write_log::format_utc(seconds).replace([':', '-'], "");
    PathBuf::from(format!("bridge-{stamp}"))
}

fn convert_key_event(event: KeyEvent) -> Option<PressedKey> {
    Some(match event.code {
        KeyCode::Char('c') if event.modifiers.contains(KeyModifiers::CONTROL) => {
            PressedKey::Interrupt
        }
        KeyCode::Char(it) => PressedKey::Char(it),
        KeyCode::Enter => PressedKey::Enter,
        KeyCode::Esc => PressedKey::Escape,
        KeyCode::Backspace => PressedKey::Backspace,
        _ => return None,
    })
}
