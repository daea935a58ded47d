//! `trueup bridge monitor` in lines: the offsets once a second, how well they arrive, and what the bridge
//! says of itself; on request, all of it written down.

use std::{
    path::Path,
    thread,
    time::{Duration, Instant, SystemTime},
};

use anyhow::{Result, bail};
use serde_json::{Value, json};
use trueup_client::{
    port::PortAddress,
    record::Recorder,
    sdo_object,
    session::Session,
    state_text::{format_output, output_to_json, pending_action},
    status::BoardStatus,
};
use trueup_core::cnc::Output;
use trueup_link::{
    frames::{self, NmtState},
    receiver::{FrameCounters, OffsetReceiver},
    slcan::AdapterMessage,
};

use trueup_machine::{MachineFile, compile};

use crate::{CommandOutcome, UserError, output};

/// From one line to the next.
const OUTPUT_LINE_PERIOD: Duration = Duration::from_secs(1);
/// Between two tries to open a line that was lost.
const RECONNECT_DELAY: Duration = Duration::from_millis(250);
/// Without any offsets for this many lines there is nothing to monitor.
const MAX_SILENT_LINES: u32 = 3;

/// Prints `count` lines, or lines without end. `record` is where a recording begins, with the
/// machine file that names its columns; `is_strict`: only of a bridge that runs on what that file makes.
pub fn run(
    port: &str,
    count: Option<u64>,
    record: Option<(&Path, Option<&Path>)>,
    is_strict: bool,
    as_json: bool,
) -> Result<CommandOutcome> {
    let port = PortAddress::parse(port)?;
    let machine = record.and_then(|(_, machine)| machine);
    let expected = match machine {
        Some(machine) if is_strict => Some(compile(&MachineFile::read(machine)?)?.crc()),
        machine => machine.and_then(compile_calibration_crc),
    };
    let mut line = Session::open(&port)?;
    let calibration = ExpectedCalibration { expected, is_strict };
    let running = record.map(|_| calibration.read_and_check_running_crc(&mut line)).transpose()?;
    let mut recorder = record
        .map(|(path, machine)| Recorder::create(path, machine, port.interface_name(), None))
        .transpose()?;
    trueup_output::write_diagnostic("listening only: this command engages nothing");
    if let (Some(recorder), Some(running)) = (&mut recorder, running) {
        recorder.set_running_calibration(running);
    }
    let mut tally = MonitorStatistics::default();
    let mut outcome = CommandOutcome::Done;
    let mut silent_lines = 0;
    // While it is lost it is opened again, if something is recorded.
    let mut session = Some(line);
    let start = Instant::now();
    let mut line_start = start;
    let mut lines = 0_u64;
    while count.is_none_or(|count| lines < count) {
        let line_end = line_start + OUTPUT_LINE_PERIOD;
        match &mut session {
            Some(open) => {
                let received = receive_events_until(
                    open,
                    line_end,
                    &mut tally,
                    recorder.as_mut(),
                    &calibration,
                );
                match (received, &recorder) {
                    (Err(error), Some(_)) if error.is::<ConnectionLost>() => {
                        trueup_output::write_diagnostic(format_args!(
                            "{error:#}: it is opened again, and the recording goes on with a gap"
                        ));
                        session = None;
                    }
                    (received, _) => received?,
                }
            }
            None => {
                session = reconnect(&port, line_end, recorder.as_mut(), &calibration)?;
            }
        }
        if let Some(recorder) = &mut recorder {
            recorder.flush()?;
        }
        let now = Instant::now();
        let second = tally.take_line(now - line_start);
        line_start = now;
        lines += 1;
        if as_json {
            output::print(second.to_json(now - start, &tally.board))?;
        } else {
            output::print(second.to_text(&tally.board) + &tally.board.to_text())?;
        }
        silent_lines = if second.output.is_none() { silent_lines + 1 } else { 0 };
        if silent_lines == MAX_SILENT_LINES && recorder.is_none() {
            let hint = match tally.frames {
                0 => "no frame came: check that the board samples and that its plant runs",
                _ => "frames came, but no valid pair of offsets",
            };
            bail!("no offsets for {} s: {hint}", MAX_SILENT_LINES);
        }
        if !second.is_error_free() {
            outcome = CommandOutcome::NotMet;
        }
        // A recording does not need a reader, and goes on.
        if !trueup_output::has_stdout_reader() && recorder.is_none() {
            break;
        }
    }
    if let Some(session) = session {
        session.close();
    }
    if let Some(recorder) = &recorder {
        trueup_output::write_diagnostic(recorder.summary());
    }
    Ok(outcome)
}

/// The line to the bridge is broken.
#[derive(Debug, thiserror::Error)]
#[error("the line is lost")]
struct ConnectionLost;

/// Takes what comes until `line_end`.
fn receive_events_until(
    session: &mut Session,
    line_end: Instant,
    tally: &mut MonitorStatistics,
    mut recorder: Option<&mut Recorder>,
    calibration: &ExpectedCalibration,
) -> Result<()> {
    // Without a recording it is an error as it stands.
    let goes_on = recorder.is_some();
    let next = |session: &mut Session| match session.next_event(line_end) {
        Err(error) if goes_on => Err(error.context(ConnectionLost)),
        other => other,
    };
    while let Some(event) = next(session)? {
        tally.receive(&event);
        if let (Some(recorder), AdapterMessage::Frame(frame)) = (&mut recorder, &event) {
            recorder.receive(frame, SystemTime::now())?;
            // It may have been given another one.
            if frames::decode_heartbeat(frame) == Ok(NmtState::BootUp) {
                recorder.set_running_calibration(calibration.read_and_check_running_crc(session)?);
            }
        }
    }
    Ok(())
}

/// Opens the line again, if that is possible until `line_end`.
fn reconnect(
    port: &PortAddress,
    line_end: Instant,
    recorder: Option<&mut Recorder>,
    calibration: &ExpectedCalibration,
) -> Result<Option<Session>> {
    while Instant::now() < line_end {
        if let Ok(mut session) = Session::open(port) {
            trueup_output::write_diagnostic("the line is open again");
            // Another board may be behind it.
            if let Some(recorder) = recorder {
                recorder
                    .set_running_calibration(calibration.read_and_check_running_crc(&mut session)?);
            }
            return Ok(Some(session));
        }
        thread::sleep(RECONNECT_DELAY.min(line_end.saturating_duration_since(Instant::now())));
    }
    Ok(None)
}

/// The calibration that the bridge should run.
struct ExpectedCalibration {
    /// The CRC of the machine file's calibration.
    expected: Option<u32>,
    /// Any other is refused.
    is_strict: bool,
}

impl ExpectedCalibration {
    /// Returns the CRC of the calibration that the bridge runs; `None`, with a warning, where it does not say.
    /// One that is not expected is reported, or refused.
    fn read_and_check_running_crc(&self, session: &mut Session) -> Result<Option<u32>> {
        let crc = sdo_object::read_number(session, sdo_object::RUNNING_CRC);
        let sentence = match (&crc, self.expected) {
            (Ok(running), Some(expected)) if *running != expected => format!(
                "the bridge runs on the calibration {running:08x}, the machine file makes \
                 {expected:08x}: what is recorded is not of this file"
            ),
            (Err(error), _) => {
                format!("{error}; in the recording calibration_crc is left empty")
            }
            _ => return Ok(crc.ok()),
        };
        if self.is_strict {
            bail!(UserError(sentence));
        }
        trueup_output::write_diagnostic(format_args!("warning: {sentence}"));
        Ok(crc.ok())
    }
}

/// Returns the CRC of the calibration of a machine file; `None`: it cannot be read or does not compile.
fn compile_calibration_crc(machine: &Path) -> Option<u32> {
    let machine = MachineFile::read(machine).ok()?;
    compile(&machine).ok().map(|compiled| compiled.crc())
}

/// Counts and newest values since the start, and since the last line.
#[derive(Default)]
struct MonitorStatistics {
    offsets: OffsetReceiver,
    board: BoardStatus,
    frames: u64,
    frames_at_last_line: u64,
    /// Lines that carry no frame that can be read.
    malformed_lines: u32,
    output: Option<Output>,
}

/// A line of the monitor.
struct MonitorLine {
    /// The newest offsets; `None` if none came.
    output: Option<Output>,
    frames_per_s: f64,
    /// Since the start.
    counters: FrameCounters,
    /// Since the start.
    refused_statuses: u32,
    /// Since the start.
    malformed_lines: u32,
    /// Since the start.
    unpaired: u32,
}

impl MonitorStatistics {
    fn receive(&mut self, event: &AdapterMessage) {
        match event {
            AdapterMessage::Frame(frame) => {
                self.frames += 1;
                self.board.receive(frame);
                // What is refused is counted in `offsets`.
                if let Ok(Some(output)) = self.offsets.accept(frame) {
                    self.output = Some(output);
                }
            }
            AdapterMessage::Malformed(_) => {
                self.malformed_lines = self.malformed_lines.saturating_add(1)
            }
            AdapterMessage::Accepted | AdapterMessage::Rejected | AdapterMessage::Other(_) => {}
        }
    }

    fn take_line(&mut self, elapsed: Duration) -> MonitorLine {
        let frames = self.frames - self.frames_at_last_line;
        self.frames_at_last_line = self.frames;
        MonitorLine {
            output: self.output.take(),
            frames_per_s: frames as f64 / elapsed.as_secs_f64(),
            counters: self.offsets.counters(),
            refused_statuses: self.board.rejected_status_frame_count(),
            malformed_lines: self.malformed_lines,
            unpaired: self.offsets.unpaired_frame_count(),
        }
    }
}

impl MonitorLine {
    /// Offsets came, and until now no frame was damaged or out of order.
    fn is_error_free(&self) -> bool {
        let FrameCounters { malformed, crc_errors, sequence_errors, .. } = self.counters;
        self.output.is_some()
            && malformed == 0
            && crc_errors == 0
            && sequence_errors == 0
            && self.malformed_lines == 0
            && self.refused_statuses == 0
    }

    fn to_text(&self, board: &BoardStatus) -> String {
        let output = match &self.output {
            Some(output) => match pending_action(output.quality, board.state, board.calibration) {
                Some(what) => format!("waiting for {what}: {}", format_output(output)),
                None => format_output(output),
            },
            None => "no offsets came".into(),
        };
        let FrameCounters { malformed, crc_errors, sequence_errors, lost, .. } = self.counters;
        format!(
            "{output}  {:.0} frames/s  errors: crc {crc_errors}, sequence {sequence_errors}, \
             malformed {}, lost {lost}, unpaired {}",
            self.frames_per_s,
            malformed.saturating_add(self.malformed_lines),
            self.unpaired,
        )
    }

    fn to_json(&self, since_start: Duration, board: &BoardStatus) -> Value {
        let FrameCounters { malformed, crc_errors, sequence_errors, lost, .. } = self.counters;
        let mut line = output_to_json(self.output.as_ref());
        line["time_s"] = json!(since_start.as_secs_f64());
        line["frames_per_s"] = json!(self.frames_per_s);
        line["crc_errors"] = json!(crc_errors);
        line["sequence_errors"] = json!(sequence_errors);
        line["malformed"] = json!(malformed.saturating_add(self.malformed_lines));
        line["lost"] = json!(lost);
        line["unpaired"] = json!(self.unpaired);
        line["refused_statuses"] = json!(self.refused_statuses);
        let waits =
            |output: &Output| pending_action(output.quality, board.state, board.calibration);
        line["waiting_for"] = json!(self.output.as_ref().and_then(waits));
        line["board"] = board.to_json();
        line
    }
}
