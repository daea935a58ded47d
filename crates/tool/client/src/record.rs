//! The monitor's recording: every frame as `candump -l` writes it, and next to it a run
//! file with a row every `ROW_PERIOD_MS`.
//!
//! The log is text, a frame a line, `(seconds.microseconds) interface identifier#data`, which
//! can-utils (`canplayer`, `log2asc`) and python-can read. The time is this machine's.
//!
//! The run file has the columns of any run: `time_s`, `spindle_rpm`, `load_n`, positions, directions,
//! temperatures; and as columns of their own the offsets, their quality and flags. A value not known
//! at a row is an empty cell: what the CNC sends can only be received on a CAN bus, not on the bridge's
//! own serial line. Its time is the bridge's, which sends a cycle a millisecond and counts them, so
//! it is right at any speed of a virtual bridge. With the machine file the temperatures have its
//! names, and where the board runs its law of the sensor, `sensor_counts` are what the law makes of the
//! elongation on the wire. That is the sensor's alone: what a diagnosis has found, a drift with the
//! sensor's temperature too, comes after it and is in the offsets only. So the counts are those that
//! the sensor gave, averaged by the board. `calibration_crc` names the calibration that the bridge ran,
//! as a decimal number. Next to these `diagnose` needs a measurement: a column `measured_…_um`, of
//! what is left while the CNC follows the offsets; they are taken out of it again. It is there where a
//! gauge is read, with a value in each row in which a reading was marked.

mod output_file;

use std::{
    fs,
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::Result;
use trueup_core::{cnc::Output, design_parameters::TEMPERATURE_CHANNEL_COUNT};
use trueup_link::{
    frame::Frame,
    frames::{OFFSET_XY_ID, e2e_counter},
    receiver::OffsetReceiver,
};
use trueup_machine::{
    Machine, MachineFile,
    machine_file::{Quantity, SensorModel},
    model::sensor_counts_from_elongation,
    tool_column::TOOL_COLUMN,
};

use self::output_file::RecordingFile;
use crate::{
    UnusableInputError,
    cnc::{self, CncState},
    state_text::offset_um,
    status::BoardStatus,
};

/// Milliseconds of the bridge from one row to the next.
pub(crate) const ROW_PERIOD_MS: u64 = 100;

/// Writes both files of a recording.
pub struct Recorder {
    log: RecordingFile,
    /// The name of the interface in the log.
    interface: String,
    run: RecordingFile,
    columns: MachineColumns,
    clock: BridgeClock,
    offsets: OffsetReceiver,
    cnc: CncState,
    board: BoardStatus,
    /// The CRC of the running calibration, 0 for none; `None`: not known.
    calibration: Option<u32>,
    /// The newest reading of the gauge since the last row, in µm; the quantity that it measures.
    marked_um: Option<f64>,
    gauge: Option<Quantity>,
    /// The readings that stand in rows: where their cells begin in the file, how long they are, and what they say.
    marks: Vec<(u64, usize, f64)>,
    next_row_ms: u64,
    frames: u64,
    rows: u64,
}

/// The columns that depend on the machine.
struct MachineColumns {
    /// Channel and name.
    temperatures: Vec<(u8, String)>,
    /// The law that makes the elongation on the wire out of counts.
    sensor: Option<SensorModel>,
    /// The names of the angles, in the order of the axes that carry the spindle.
    angles: [String; 2],
    /// Bit and name of each condition.
    conditions: Vec<(u8, String)>,
}

impl Recorder {
    /// Begins both files, which must not be there yet: `<path>.log` and `.csv` where `path` ends so, or `bridge.log` and
    /// `bridge.csv` in the folder `path`. In the log the frames come from this interface. A `gauge` that
    /// measures a quantity has its column.
    ///
    /// # Errors
    /// [`UnusableInputError`]: they cannot be made here; [`trueup_machine::InputFileError`]: the machine file. A disk
    /// that is full.
    pub fn create(
        path: &Path,
        machine: Option<&Path>,
        interface: &str,
        gauge: Option<Quantity>,
    ) -> Result<Self> {
        let columns = match machine {
            Some(machine) => MachineColumns::from_machine(&MachineFile::read(machine)?),
            None => MachineColumns::with_default_names(),
        };
        let is_file =
            path.extension().is_some_and(|extension| extension == "log" || extension == "csv");
        let log = if is_file {
            path.with_extension("log")
        } else {
            fs::create_dir_all(path)
                .map_err(|error| UnusableInputError::Folder { path: path.into(), error })?;
            path.join("bridge.log")
        };
        let run = log.with_extension("csv");
        let (log, mut run) = (RecordingFile::create(log)?, RecordingFile::create(run)?);
        let measured = gauge.map(|quantity| format!(",measured_{}_um", quantity.name()));
        run.write_line(&(columns.header() + &measured.unwrap_or_default()))?;
        Ok(Self {
            log,
            interface: interface.into(),
            run,
            columns,
            clock: BridgeClock::default(),
            offsets: OffsetReceiver::new(),
            cnc: CncState::default(),
            board: BoardStatus::default(),
            calibration: None,
            marked_um: None,
            gauge,
            marks: Vec::new(),
            next_row_ms: 0,
            frames: 0,
            rows: 0,
        })
    }

    /// From here on the bridge runs the calibration with this CRC; 0: it has none, `None`: it does not
    /// say.
    pub fn set_running_calibration(&mut self, calibration: Option<u32>) {
        self.calibration = calibration;
    }

    /// A reading of the gauge in µm; it stands in the next row. Without a gauge it is dropped.
    pub fn record_gauge_reading(&mut self, um: f64) {
        self.marked_um = self.gauge.map(|_| um);
    }

    /// Takes the last reading of the gauge out of the run file again: its cell is left blank. Returns what it was in
    /// µm; `None`: there is none.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn undo_gauge_reading(&mut self) -> Result<Option<f64>> {
        if let Some(um) = self.marked_um.take() {
            return Ok(Some(um));
        }
        let Some((at, length, um)) = self.marks.pop() else { return Ok(None) };
        self.run.overwrite_with_spaces(at, length)?;
        Ok(Some(um))
    }

    /// Returns how many readings of the gauge stand in the recording.
    #[must_use]
    pub fn gauge_reading_count(&self) -> usize {
        self.marks.len() + usize::from(self.marked_um.is_some())
    }

    /// Returns how many rows the run file has.
    #[must_use]
    pub fn row_count(&self) -> u64 {
        self.rows
    }

    /// Takes a frame that was received at this moment.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn receive(&mut self, frame: &Frame, at: SystemTime) -> Result<()> {
        self.frames += 1;
        self.log.write_line(&format_candump_line(&self.interface, frame, at))?;
        self.board.receive(frame);
        if frame.id() == OFFSET_XY_ID {
            self.clock.update(e2e_counter(frame), at);
        }
        self.cnc.receive(frame, self.clock.ms);
        // What is refused makes no row; the monitor counts it.
        if let Ok(Some(output)) = self.offsets.accept(frame)
            && self.clock.ms >= self.next_row_ms
        {
            self.next_row_ms = (self.clock.ms / ROW_PERIOD_MS + 1) * ROW_PERIOD_MS;
            self.rows += 1;
            let mut row = self.format_row(&output);
            if self.gauge.is_some() {
                row.push(',');
                if let Some(um) = self.marked_um.take() {
                    let cell = format_cell(Some(um), 3);
                    self.marks.push((self.run.length() + row.len() as u64, cell.len(), um));
                    row += &cell;
                }
            }
            self.run.write_line(&row)?;
        }
        Ok(())
    }

    /// All that was received stands in the files.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        self.log.flush()?;
        self.run.flush()
    }

    /// Returns what was written, in one sentence.
    #[must_use]
    pub fn summary(&self) -> String {
        format!(
            "{} frames in {}, {} rows in {}",
            self.frames,
            self.log.path.display(),
            self.rows,
            self.run.path.display()
        )
    }

    fn format_row(&self, output: &Output) -> String {
        let mut cells = vec![format_cell(Some(self.clock.ms as f64 / 1_000.0), 3)];
        let offset = offset_um(output);
        cells.extend((0..3).map(|axis| format_cell(offset.map(|all| all[axis]), 2)));
        cells.push((output.quality as u8).to_string());
        cells.push(output.flags.0.to_string());
        cells.push(output.age_ms.to_string());
        cells.push(self.calibration.map(|crc| crc.to_string()).unwrap_or_default());
        let elongation_um = self.board.elongation_um();
        cells.push(match &self.columns.sensor {
            Some(sensor) => {
                format_cell(elongation_um.map(|um| sensor_counts_from_elongation(sensor, um)), 2)
            }
            None => format_cell(elongation_um, 3),
        });
        cells.extend(self.columns.temperatures.iter().map(|(channel, _)| {
            let centi_c = self.board.centi_c.get(usize::from(*channel)).copied().flatten();
            format_cell(centi_c.map(|centi_c| f64::from(centi_c) / 100.0), 2)
        }));
        cells.extend(self.cnc.row_cells(self.clock.ms));
        let conditions = self.cnc.conditions(self.clock.ms);
        let cell = |value: Option<u16>| value.map(|value| value.to_string()).unwrap_or_default();
        cells.push(cell(conditions.map(|conditions| conditions.tool)));
        let bits = self.columns.conditions.iter();
        cells.extend(
            bits.map(|(bit, _)| cell(conditions.map(|conditions| conditions.is_set(*bit).into()))),
        );
        cells.join(",")
    }
}

/// Returns the channel and the name of each temperature of a machine file, by channel.
#[must_use]
pub fn temperature_columns(machine: &Machine) -> Vec<(u8, String)> {
    let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
    let mut temperatures: Vec<_> =
        inputs.map(|(name, input)| (input.channel, name.clone())).collect();
    temperatures.sort();
    temperatures
}

impl MachineColumns {
    fn from_machine(machine: &Machine) -> Self {
        let temperatures = temperature_columns(machine);
        let mut angles = Self::default_angle_columns();
        for (name, axis) in angles.iter_mut().zip(machine.angle_axes()) {
            *name = format!("{}_deg", axis.name());
        }
        let conditions = machine.inputs.iter().flat_map(|inputs| &inputs.conditions);
        let conditions =
            conditions.map(|(name, conditions)| (conditions.bit, name.clone())).collect();
        Self { temperatures, sensor: machine.board_sensor_model().cloned(), angles, conditions }
    }

    fn with_default_names() -> Self {
        let name = |channel| (channel, format!("temp_channel{channel}_c"));
        let temperatures = (0..TEMPERATURE_CHANNEL_COUNT as u8).map(name).collect();
        Self {
            temperatures,
            sensor: None,
            angles: Self::default_angle_columns(),
            conditions: Vec::new(),
        }
    }

    fn default_angle_columns() -> [String; 2] {
        [1, 2].map(|number| format!("angle{number}_deg"))
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
            "calibration_crc",
            sensor,
        ]
        .into_iter()
        .chain(temperatures)
        .chain(cnc::CNC_COLUMNS)
        .chain(self.angles.each_ref().map(String::as_str))
        .chain([TOOL_COLUMN])
        .chain(self.conditions.iter().map(|(_, name)| name.as_str()))
        .collect::<Vec<_>>()
        .join(",")
    }
}

/// The bridge's clock, by its counter of cycles of a millisecond each.
#[derive(Default)]
struct BridgeClock {
    ms: u64,
    last: Option<(u8, SystemTime)>,
}

impl BridgeClock {
    fn update(&mut self, counter: u8, at: SystemTime) {
        if let Some((last, received)) = self.last {
            let counted = u64::from(counter.wrapping_sub(last));
            // The counter comes round every 256 ms; how often it did in a longer silence, only
            // this machine's clock can say.
            let silent = at.duration_since(received).unwrap_or(Duration::ZERO);
            let silent_ms = u64::try_from(silent.as_millis()).unwrap_or(u64::MAX);
            let rounds =
                if silent_ms < 256 { 0 } else { (silent_ms.saturating_sub(counted) + 128) / 256 };
            self.ms += counted + 256 * rounds;
        }
        self.last = Some((counter, at));
    }
}

fn format_candump_line(interface: &str, frame: &Frame, at: SystemTime) -> String {
    let at = at.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    let data: String = frame.payload().iter().map(|byte| format!("{byte:02X}")).collect();
    let (seconds, micros) = (at.as_secs(), at.subsec_micros());
    format!("({seconds:010}.{micros:06}) {interface} {:03X}#{data}", frame.id())
}

fn format_cell(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(String::new, |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests;
