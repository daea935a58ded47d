//! What the monitor hears, written down: every frame as `candump -l` writes it, and beside it a run
//! file with a row every [`ROW_MS`].
//!
//! The log is text, a frame a line, `(seconds.microseconds) interface identifier#data`, which
//! can-utils (`canplayer`, `log2asc`) and python-can read. The time is this machine's.
//!
//! The run file has the columns of any run: `time_s`, `spindle_rpm`, `load_n`, positions, directions,
//! temperatures; and as columns of their own the offsets, their quality and flags. What is not known
//! at a row is an empty cell: what the CNC sends can only be heard on a CAN bus, not on the bridge's
//! own serial line. Its time is the bridge's, which sends a cycle a millisecond and counts them, so
//! it is right at any speed of a virtual bridge. With the machine file the temperatures have its
//! names, and `sensor_counts` are what its law of the sensor makes of the elongation. What `diagnose`
//! needs besides is a measurement: a column `measured_…_um`.

use std::{
    fs::{self, File, OpenOptions},
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::{Context as _, Result};
use trueup_core::{
    cnc::{Command, Output},
    units::{MicroDegrees, NANOMETRES_PER_MICROMETRE, Position},
};
use trueup_link::{
    frame::Frame,
    frames::{OFFSET_XY_ID, counter},
    receiver::{OffsetReceiver, Receiver},
};
use trueup_machine::{Machine, MachineFile};

use crate::{Mend, status::Board, words::offset_um};

/// Milliseconds of the bridge from one row to the next.
pub const ROW_MS: u64 = 100;
/// What the CNC has said counts for so long.
const CNC_TIMEOUT_MS: u64 = 500;
const CHANNELS: usize = 8;

/// Both files.
pub struct Recorder {
    log: Out,
    /// The name of the interface in the log.
    interface: String,
    run: Out,
    columns: Columns,
    clock: Clock,
    offsets: OffsetReceiver,
    cnc: Cnc,
    board: Board,
    next_row_ms: u64,
    frames: u64,
    rows: u64,
}

/// A file that is being written.
struct Out {
    path: PathBuf,
    file: BufWriter<File>,
}

/// The columns that depend on the machine.
struct Columns {
    /// Channel and name.
    temperatures: Vec<(u8, String)>,
    /// Elongation at a reading of 0 counts, and for one count, both in µm.
    sensor: Option<[f64; 2]>,
}

impl Recorder {
    /// Begins both files, which must not be there yet: `<path>.log` and `.csv`, or `bridge.log` and
    /// `bridge.csv` in the folder `path`. In the log the frames come from this interface.
    pub fn begin(path: &Path, machine: Option<&Path>, interface: &str) -> Result<Self> {
        let columns = match machine {
            Some(machine) => Columns::of(&MachineFile::read(machine)?),
            None => Columns::unnamed(),
        };
        let cannot = |error| Mend(format!("{}: cannot be made: {error}", path.display()));
        let log = if path.extension().is_some_and(|it| it == "log") {
            path.to_path_buf()
        } else {
            fs::create_dir_all(path).map_err(cannot)?;
            path.join("bridge.log")
        };
        let run = log.with_extension("csv");
        let (log, mut run) = (Out::create(log)?, Out::create(run)?);
        run.line(&columns.header())?;
        Ok(Self {
            log,
            interface: interface.into(),
            run,
            columns,
            clock: Clock::default(),
            offsets: OffsetReceiver::new(),
            cnc: Cnc::default(),
            board: Board::default(),
            next_row_ms: 0,
            frames: 0,
            rows: 0,
        })
    }

    /// Takes a frame that was heard at this moment.
    pub fn hear(&mut self, frame: &Frame, at: SystemTime) -> Result<()> {
        self.frames += 1;
        self.log.line(&candump_line(&self.interface, frame, at))?;
        self.board.hear(frame);
        if frame.id() == OFFSET_XY_ID {
            self.clock.hear(counter(frame), at);
        }
        self.cnc.hear(frame, self.clock.ms);
        // What is refused makes no row; the monitor counts it.
        if let Ok(Some(output)) = self.offsets.accept(frame)
            && self.clock.ms >= self.next_row_ms
        {
            self.next_row_ms = (self.clock.ms / ROW_MS + 1) * ROW_MS;
            self.rows += 1;
            let row = self.row(&output);
            self.run.line(&row)?;
        }
        Ok(())
    }

    /// All that was heard stands in the files.
    pub fn flush(&mut self) -> Result<()> {
        self.log.flush()?;
        self.run.flush()
    }

    /// What was written, in one sentence.
    pub fn summary(&self) -> String {
        format!(
            "{} frames in {}, {} rows in {}",
            self.frames,
            self.log.path.display(),
            self.rows,
            self.run.path.display()
        )
    }

    fn row(&self, output: &Output) -> String {
        let mut cells = vec![decimals(Some(self.clock.ms as f64 / 1_000.0), 3)];
        let offset = offset_um(output);
        cells.extend((0..3).map(|axis| decimals(offset.map(|all| all[axis]), 2)));
        cells.push((output.quality as u8).to_string());
        cells.push(output.flags.0.to_string());
        cells.push(output.age_ms.to_string());
        let um = |nm: i32| f64::from(nm) / f64::from(NANOMETRES_PER_MICROMETRE);
        let elongation_um = self.board.elongation.map(|it| um(it.0));
        cells.push(match self.columns.sensor {
            Some([at_0, per_count]) => decimals(elongation_um.map(|um| (um - at_0) / per_count), 2),
            None => decimals(elongation_um, 3),
        });
        cells.extend(self.columns.temperatures.iter().map(|(channel, _)| {
            let centi_c = self.board.centi_c.get(usize::from(*channel)).copied().flatten();
            decimals(centi_c.map(|it| f64::from(it) / 100.0), 2)
        }));
        cells.extend(self.cnc.cells(self.clock.ms));
        cells.join(",")
    }
}

impl Columns {
    fn of(machine: &Machine) -> Self {
        let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
        let mut temperatures: Vec<_> =
            inputs.map(|(name, input)| (input.channel, name.clone())).collect();
        temperatures.sort();
        let sensor = machine.spindle.sensor.as_ref();
        let sensor =
            sensor.map(|law| [law.k0_um - law.zero_counts * law.um_per_count, law.um_per_count]);
        Self { temperatures, sensor }
    }

    fn unnamed() -> Self {
        let name = |channel| (channel, format!("temp_channel{channel}_c"));
        Self { temperatures: (0..CHANNELS as u8).map(name).collect(), sensor: None }
    }

    fn header(&self) -> String {
        let sensor = if self.sensor.is_some() { "sensor_counts" } else { "elongation_um" };
        let temperatures = self.temperatures.iter().map(|(_, name)| name.as_str());
        [
            "time_s",
            "offset_x_um",
            "offset_y_um",
            "offset_z_um",
            "quality",
            "flags",
            "age_ms",
            sensor,
        ]
        .into_iter()
        .chain(temperatures)
        .chain(CNC_COLUMNS)
        .collect::<Vec<_>>()
        .join(",")
    }
}

const CNC_COLUMNS: [&str; 10] = [
    "spindle_rpm",
    "load_n",
    "x_mm",
    "y_mm",
    "z_mm",
    "dir_x",
    "dir_y",
    "dir_z",
    "angle1_deg",
    "angle2_deg",
];

/// What the CNC has said, where it can be heard: the cells, and when.
#[derive(Default)]
struct Cnc {
    receiver: Receiver,
    cells: [Option<(String, u64)>; CNC_COLUMNS.len()],
}

impl Cnc {
    fn hear(&mut self, frame: &Frame, now_ms: u64) {
        let Ok(Some(command)) = self.receiver.accept(frame) else { return };
        let mut note = |column: usize, cell: String| self.cells[column] = Some((cell, now_ms));
        match command {
            Command::Control(_) => {}
            Command::Spindle(spindle) => {
                note(0, spindle.speed.0.to_string());
                note(1, spindle.load_n.to_string());
            }
            Command::Position(it) => {
                let mm = f64::from(it.position.0) / f64::from(Position::PER_MILLIMETRE);
                note(2 + it.axis as usize, decimals(Some(mm), 5));
                note(5 + it.axis as usize, (it.direction as i8).to_string());
            }
            Command::Rotary(it) => {
                for (column, angle) in (8..).zip(it.angles) {
                    let degrees = f64::from(angle.0) / f64::from(MicroDegrees::PER_DEGREE);
                    note(column, decimals(Some(degrees), 4));
                }
            }
        }
    }

    fn cells(&self, now_ms: u64) -> impl Iterator<Item = String> {
        self.cells.iter().map(move |cell| match cell {
            Some((cell, at_ms)) if now_ms.saturating_sub(*at_ms) <= CNC_TIMEOUT_MS => cell.clone(),
            _ => String::new(),
        })
    }
}

/// The bridge's clock, by its counter of cycles of a millisecond each.
#[derive(Default)]
struct Clock {
    ms: u64,
    last: Option<(u8, SystemTime)>,
}

impl Clock {
    fn hear(&mut self, counter: u8, at: SystemTime) {
        if let Some((last, heard)) = self.last {
            let counted = u64::from(counter.wrapping_sub(last));
            // The counter comes round every 256 ms; how often it did in a longer silence, only
            // this machine's clock can say.
            let silent = at.duration_since(heard).unwrap_or(Duration::ZERO);
            let silent_ms = u64::try_from(silent.as_millis()).unwrap_or(u64::MAX);
            let rounds =
                if silent_ms < 256 { 0 } else { (silent_ms.saturating_sub(counted) + 128) / 256 };
            self.ms += counted + 256 * rounds;
        }
        self.last = Some((counter, at));
    }
}

fn candump_line(interface: &str, frame: &Frame, at: SystemTime) -> String {
    let at = at.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    let data: String = frame.payload().iter().map(|byte| format!("{byte:02X}")).collect();
    let (seconds, micros) = (at.as_secs(), at.subsec_micros());
    format!("({seconds:010}.{micros:06}) {interface} {:03X}#{data}", frame.id())
}

fn decimals(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(String::new, |value| format!("{value:.decimals$}"))
}

impl Out {
    fn create(path: PathBuf) -> Result<Self> {
        let file =
            OpenOptions::new().write(true).create_new(true).open(&path).map_err(|error| {
                Mend(format!("{}: a recording is not begun here: {error}", path.display()))
            })?;
        Ok(Self { path, file: BufWriter::new(file) })
    }

    fn line(&mut self, line: &str) -> Result<()> {
        writeln!(self.file, "{line}")
            .with_context(|| format!("while writing {}", self.path.display()))
    }

    fn flush(&mut self) -> Result<()> {
        self.file.flush().with_context(|| format!("while writing {}", self.path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_log_is_candumps() {
        let at = UNIX_EPOCH + Duration::from_micros(1_436_509_052_249_713);
        let frame = Frame::new(0x181, &[0x8B, 0xCB, 0, 0x11]).expect("short");
        assert_eq!(candump_line("can0", &frame, at), "(1436509052.249713) can0 181#8BCB0011");
        let empty = Frame::new(0x001, &[]).expect("short");
        assert_eq!(candump_line("vcan1", &empty, UNIX_EPOCH), "(0000000000.000000) vcan1 001#");
    }

    #[test]
    fn the_clock_counts_lost_cycles_and_whole_rounds_of_the_counter() {
        let mut clock = Clock::default();
        let mut at = UNIX_EPOCH;
        for (counter, after_ms, ms) in [
            (250, 0, 0),
            (251, 1, 1),
            (251, 0, 1),
            (5, 3, 11),
            (6, 1_025, 1_036),
            (6, 2_560, 3_596),
        ] {
            at += Duration::from_millis(after_ms);
            clock.hear(counter, at);
            assert_eq!(clock.ms, ms, "counter {counter}");
        }
    }
}
