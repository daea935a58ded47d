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
    Unusable,
    build::{Build, COMMIT},
    holder::holder,
    line::{Line, LineEvent},
    object,
    poll::{Poll, PollOutcome},
    port::Port,
    record::Recorder,
};
use trueup_link::{
    frame::Frame,
    frames::{self, State as NodeState},
    slcan::Event,
};
use trueup_machine::file::Quantity;

use crate::{
    indicator::Indicator,
    laws::Laws,
    state::{Action, Key, Link, Source, State},
    view::{self, Theme},
};

/// From one sample of the trend to the next, and from one question for the growth to the next: as fast as
/// a number can be read while a finger pushes.
const SAMPLE: Duration = Duration::from_millis(200);
/// From one drawing to the next.
const DRAW: Duration = Duration::from_millis(100);
/// Characters of a picture of the screen, across and down.
const PICTURE: [u16; 2] = [80, 24];
/// A look at line and keys.
const TURN: Duration = Duration::from_millis(10);
/// A calibration is read once; after a refusal it is asked for again, not sooner than this.
const AGAIN: Duration = Duration::from_secs(3_600);

/// Options of the screen.
pub struct Options {
    /// Where the bridge is.
    pub port: String,
    /// Who shows it: a bridge of another source is reported.
    pub tool: Build,
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
    pub indicator: Option<Indicator>,
    /// A picture of the screen is written here after so long, and nothing is drawn.
    pub picture: Option<(PathBuf, Duration)>,
}

/// Shows the bridge until the user has seen enough; whether all that came was whole and in order.
///
/// # Errors
/// The port or the machine file is wrong; the terminal cannot be used; a recording cannot be written.
pub fn run(options: Options) -> Result<bool> {
    let port = Port::parse(&options.port)?;
    let laws = options.machine.as_deref().map(Laws::read).transpose()?;
    let mut state = State::new(&options.port, options.quantity, options.indicator.is_some());
    if let (Some(laws), Some(file)) = (laws, &options.machine) {
        let name = file.file_name().unwrap_or(file.as_os_str());
        state.source = Source::File(name.to_string_lossy().into_owned());
        state.laws = Some(laws);
    }
    let theme = Theme { has_colour: std::env::var_os("NO_COLOR").is_none_or(|it| it.is_empty()) };
    let interface = port.interface().to_owned();
    let kept = port.clone();
    let line = Line::keep(move || kept.open());
    let indicator = options.indicator.clone().map(Indicator::listen);
    let mut live = Live {
        state,
        options,
        port,
        interface,
        recorder: None,
        start: Instant::now(),
        growth: Poll::new(object::ELONGATION, SAMPLE, Instant::now()),
        commit: Poll::new(COMMIT, AGAIN, Instant::now()),
        calibration: None,
    };
    if live.options.record.is_some() && !live.options.is_strict {
        live.record()?;
    }
    if let Some((path, after)) = live.options.picture.clone() {
        live.watch(&line, after)?;
        let picture = view::picture::picture(&live.state, PICTURE);
        fs::write(&path, picture).with_context(|| format!("while writing {}", path.display()))?;
        return Ok(live.state.is_sound());
    }
    let terminal = ratatui::try_init().context("the terminal cannot be used; try --plain")?;
    let ended = live.turn(terminal, theme, &line, indicator.as_ref());
    // `restore` prints its failure to a standard error that may be gone.
    _ = ratatui::try_restore();
    ended?;
    if let Some(recorder) = &live.recorder {
        trueup_output::diagnostic(recorder.summary());
    }
    Ok(live.state.is_sound())
}

struct Live {
    state: State,
    options: Options,
    port: Port,
    interface: String,
    recorder: Option<Recorder>,
    start: Instant,
    growth: Poll,
    /// Asked for once as well.
    commit: Poll,
    /// The calibration of this CRC is being read, or was.
    calibration: Option<(u32, Poll)>,
}

impl Live {
    fn turn(
        &mut self,
        mut terminal: DefaultTerminal,
        theme: Theme,
        line: &Line,
        indicator: Option<&std::sync::mpsc::Receiver<crate::indicator::IndicatorReading>>,
    ) -> Result<()> {
        let (mut sampled, mut drawn) = (None::<Instant>, None::<Instant>);
        loop {
            for heard in line.received() {
                self.receive(heard, line)?;
            }
            for heard in indicator.iter().flat_map(|it| it.try_iter()) {
                let action = self.state.gauged(heard, self.now_s());
                self.act(action)?;
            }
            let now = Instant::now();
            if sampled.is_none_or(|at| now - at >= SAMPLE) {
                sampled = Some(now);
                self.state.sample(self.now_s());
                self.ask(line, now);
            }
            if drawn.is_none_or(|at| now - at >= DRAW) {
                drawn = Some(now);
                terminal.draw(|frame| view::draw(frame, &self.state, theme))?;
                if let Some(recorder) = &mut self.recorder {
                    recorder.flush()?;
                }
            }
            while event::poll(TURN)? {
                let pressed = match event::read()? {
                    TerminalEvent::Key(key) if key.kind != KeyEventKind::Release => self::key(key),
                    _ => None,
                };
                let action = pressed.and_then(|key| self.state.key(key));
                if self.act(action)? {
                    return Ok(());
                }
                drawn = None;
            }
        }
    }

    /// Takes what comes for so long, without a terminal.
    fn watch(&mut self, line: &Line, length: Duration) -> Result<()> {
        while self.start.elapsed() < length {
            for heard in line.received() {
                self.receive(heard, line)?;
            }
            self.state.sample(self.now_s());
            self.ask(line, Instant::now());
            std::thread::sleep(SAMPLE);
        }
        Ok(())
    }

    fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn receive(&mut self, heard: LineEvent, line: &Line) -> Result<()> {
        match heard {
            LineEvent::Up => self.state.link = Link::Up,
            LineEvent::Down(why) => {
                let other = holder(&self.port);
                let other = other.map(|it| format!("; {it} has the line: end it first"));
                self.state.link = Link::Down(why + &other.unwrap_or_default());
            }
            LineEvent::Received(Event::Frame(frame)) => self.frame(&frame, line)?,
            LineEvent::Received(Event::Malformed(_)) => self.state.malformed_lines += 1,
            LineEvent::Late => {
                self.state.left_out += 1;
                self.state.show_message("the line has stalled: what is old is left out");
            }
            LineEvent::Received(_) => {}
        }
        Ok(())
    }

    fn frame(&mut self, frame: &Frame, line: &Line) -> Result<()> {
        let now = Instant::now();
        self.state.receive(frame, self.now_s());
        if let Some(recorder) = &mut self.recorder {
            recorder.runs(self.state.board.calibration);
            recorder.receive(frame, SystemTime::now())?;
            self.state.recorded(recorder.readings(), recorder.rows());
        }
        if frames::decode_heartbeat(frame) == Ok(NodeState::BootUp) {
            self.state.show_message("the bridge has started anew");
        }
        // What the bridge runs on is known now.
        let is_asked = self.options.is_strict && self.options.record.is_some();
        if is_asked && self.state.board.calibration.is_some() {
            self.record()?;
        }
        // One transfer at a time: the calibration first, as it is asked for once.
        if let Some((_, poll)) = &mut self.calibration
            && poll.is_running()
        {
            match poll.receive(frame, now) {
                PollOutcome::Ask(request) => line.send(request),
                PollOutcome::Bytes(blob) => self.learn(&blob),
                PollOutcome::Refused => self.state.source = Source::None,
                PollOutcome::Nothing => {}
            }
            if let Some((_, poll)) = &self.calibration
                && let Some((bytes, of)) = poll.progress()
            {
                let percent = bytes as u64 * 100 / u64::from(of.max(1));
                self.state.source = Source::Reading(u32::try_from(percent).unwrap_or(100));
            }
            return Ok(());
        }
        if self.commit.is_running() {
            if let PollOutcome::Bytes(answer) = self.commit.receive(frame, now) {
                let bridge = self.options.tool.with_commit(&answer);
                if let Some(difference) = self.options.tool.difference(&bridge) {
                    self.state.show_message(difference);
                }
            }
            return Ok(());
        }
        match self.growth.receive(frame, now) {
            PollOutcome::Ask(request) => line.send(request),
            PollOutcome::Bytes(bytes) => {
                let thousandths = bytes.first_chunk().copied().map(i32::from_le_bytes);
                let thousandths = thousandths.filter(|it| *it != object::NOT_AVAILABLE);
                let growth_um = thousandths.map(|it| f64::from(it) / 1_000.0);
                self.state.answered(growth_um, self.now_s());
            }
            PollOutcome::Refused | PollOutcome::Nothing => {}
        }
        Ok(())
    }

    /// Sends the requests to the bridge that are due: reading alone, and none while the line is down.
    fn ask(&mut self, line: &Line, now: Instant) {
        if self.state.link != Link::Up {
            return;
        }
        let running = self.state.board.calibration.filter(|crc| *crc != 0);
        let is_file = matches!(self.state.source, Source::File(_));
        if let (Some(crc), false) = (running, is_file)
            && self.calibration.as_ref().is_none_or(|(of, _)| *of != crc)
        {
            self.calibration = Some((crc, Poll::new(object::RUNNING, AGAIN, now)));
        }
        let calibration = self.calibration.as_mut().filter(|_| !self.commit.is_running());
        let calibration = calibration.and_then(|(_, poll)| poll.due(now));
        let is_reading = self.calibration.as_ref().is_some_and(|(_, poll)| poll.is_running());
        let commit = if is_reading { None } else { self.commit.due(now) };
        let is_asking = is_reading || self.commit.is_running();
        let growth = if is_asking { None } else { self.growth.due(now) };
        for request in calibration.into_iter().chain(commit).chain(growth) {
            line.send(request);
        }
    }

    fn learn(&mut self, blob: &[u8]) {
        self.state.laws = Laws::of_board(blob);
        self.state.source = match self.state.laws {
            Some(_) => Source::Board,
            None => Source::None,
        };
    }

    /// Does what a key has asked for; whether it was to end.
    fn act(&mut self, action: Option<Action>) -> Result<bool> {
        match action {
            None => {}
            Some(Action::Quit) => return Ok(true),
            Some(Action::Record) => {
                if let Err(error) = self.record() {
                    self.state.show_message(format!("{error:#}"));
                }
            }
            Some(Action::EndRecording) => {
                self.state.recording = None;
                if let Some(mut recorder) = self.recorder.take() {
                    recorder.flush()?;
                    self.state.show_message(recorder.summary());
                }
            }
            Some(Action::Mark(um)) => {
                if let Some(recorder) = &mut self.recorder {
                    recorder.mark(um);
                    self.state.recorded(recorder.readings(), recorder.rows());
                    self.state.mark(um);
                    self.state.show_message(format!("{um:+.2} µm written down; u takes it back"));
                }
            }
            Some(Action::Unmark) => {
                if let Some(recorder) = &mut self.recorder
                    && let Some(um) = recorder.unmark()?
                {
                    self.state.recorded(recorder.readings(), recorder.rows());
                    self.state.unmark();
                    self.state.show_message(format!("{um:+.2} µm taken out again"));
                }
            }
        }
        Ok(false)
    }

    fn record(&mut self) -> Result<()> {
        let expected = self.state.laws.as_ref().and_then(Laws::crc);
        if self.options.is_strict
            && (expected.is_none() || self.state.board.calibration != expected)
        {
            return Err(Unusable::OtherCalibration.into());
        }
        // A second recording must not be written over the first.
        let path = self.options.record.take().unwrap_or_else(|| folder_of(SystemTime::now()));
        let machine = self.options.machine.as_deref();
        let quantity = Some(self.options.quantity);
        self.recorder = Some(Recorder::begin(&path, machine, &self.interface, quantity)?);
        self.state.recorded(0, 0);
        self.state.recording = Some(shown(&path));
        Ok(())
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Returns a folder that no other recording has.
fn folder_of(now: SystemTime) -> PathBuf {
    let since = now.duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = u32::try_from(since.as_secs()).unwrap_or(u32::MAX);
    let stamp = trueup_client::writes::utc_text(seconds).replace([':', '-'], "");
    PathBuf::from(format!("bridge-{stamp}"))
}

fn key(event: KeyEvent) -> Option<Key> {
    Some(match event.code {
        KeyCode::Char('c') if event.modifiers.contains(KeyModifiers::CONTROL) => Key::Interrupt,
        KeyCode::Char(it) => Key::Char(it),
        KeyCode::Enter => Key::Enter,
        KeyCode::Esc => Key::Escape,
        KeyCode::Backspace => Key::Backspace,
        _ => return None,
    })
}
