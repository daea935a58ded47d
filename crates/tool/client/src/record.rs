//! The monitor's recording: every frame as `candump -l` writes it, and next to it a run
//! file with a row every `ROW_MS`.
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

mod out;

use std::{
    fs,
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::Result;
use trueup_core::{cnc::Output, dimensions::CHANNELS};
use trueup_link::{
    frame::Frame,
    frames::{OFFSET_XY_ID, counter},
    receiver::OffsetReceiver,
};
use trueup_machine::{
    Machine, MachineFile,
    file::{Quantity, SensorModel, TOOL_COLUMN},
    model::sensor_counts,
};

use self::out::Out;
use crate::{
    Unusable,
    cnc::{self, Cnc},
    status::Board,
    words::offset_um,
};

/// Milliseconds of the bridge from one row to the next.
pub(crate) const ROW_MS: u64 = 100;

/// Writes both files of a recording.
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
struct Columns {
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
    /// [`Unusable`]: they cannot be made here; [`trueup_machine::BadInput`]: the machine file. A disk
    /// that is full.
    pub fn begin(
        path: &Path,
        machine: Option<&Path>,
        interface: &str,
        gauge: Option<Quantity>,
    ) -> Result<Self> {
        let columns = match machine {
            Some(machine) => Columns::of(&MachineFile::read(machine)?),
            None => Columns::unnamed(),
        };
        let is_file = path.extension().is_some_and(|it| it == "log" || it == "csv");
        let log = if is_file {
            path.with_extension("log")
        } else {
            fs::create_dir_all(path)
                .map_err(|error| Unusable::Folder { path: path.into(), error })?;
            path.join("bridge.log")
        };
        let run = log.with_extension("csv");
        let (log, mut run) = (Out::create(log)?, Out::create(run)?);
        let measured = gauge.map(|quantity| format!(",measured_{}_um", quantity.name()));
        run.line(&(columns.header() + &measured.unwrap_or_default()))?;
        Ok(Self {
            log,
            interface: interface.into(),
            run,
            columns,
            clock: Clock::default(),
            offsets: OffsetReceiver::new(),
            cnc: Cnc::default(),
            board: Board::default(),
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
    pub fn runs(&mut self, calibration: Option<u32>) {
        self.calibration = calibration;
    }

    /// A reading of the gauge in µm; it stands in the next row. Without a gauge it is dropped.
    pub fn mark(&mut self, um: f64) {
        self.marked_um = self.gauge.map(|_| um);
    }

    /// Takes the last reading of the gauge out of the run file again: its cell is left blank. Returns what it was in
    /// µm; `None`: there is none.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn unmark(&mut self) -> Result<Option<f64>> {
        if let Some(um) = self.marked_um.take() {
            return Ok(Some(um));
        }
        let Some((at, length, um)) = self.marks.pop() else { return Ok(None) };
        self.run.blank(at, length)?;
        Ok(Some(um))
    }

    /// Returns how many readings of the gauge stand in the recording.
    #[must_use]
    pub fn readings(&self) -> usize {
        self.marks.len() + usize::from(self.marked_um.is_some())
    }

    /// Returns how many rows the run file has.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Takes a frame that was received at this moment.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn receive(&mut self, frame: &Frame, at: SystemTime) -> Result<()> {
        self.frames += 1;
        self.log.line(&candump_line(&self.interface, frame, at))?;
        self.board.receive(frame);
        if frame.id() == OFFSET_XY_ID {
            self.clock.receive(counter(frame), at);
        }
        self.cnc.receive(frame, self.clock.ms);
        // What is refused makes no row; the monitor counts it.
        if let Ok(Some(output)) = self.offsets.accept(frame)
            && self.clock.ms >= self.next_row_ms
        {
            self.next_row_ms = (self.clock.ms / ROW_MS + 1) * ROW_MS;
            self.rows += 1;
            let mut row = self.row(&output);
            if self.gauge.is_some() {
                row.push(',');
                if let Some(um) = self.marked_um.take() {
                    let cell = decimals(Some(um), 3);
                    self.marks.push((self.run.length() + row.len() as u64, cell.len(), um));
                    row += &cell;
                }
            }
            self.run.line(&row)?;
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

    fn row(&self, output: &Output) -> String {
        let mut cells = vec![decimals(Some(self.clock.ms as f64 / 1_000.0), 3)];
        let offset = offset_um(output);
        cells.extend((0..3).map(|axis| decimals(offset.map(|all| all[axis]), 2)));
        cells.push((output.quality as u8).to_string());
        cells.push(output.flags.0.to_string());
        cells.push(output.age_ms.to_string());
        cells.push(self.calibration.map(|crc| crc.to_string()).unwrap_or_default());
        let elongation_um = self.board.elongation_um();
        cells.push(match &self.columns.sensor {
            Some(sensor) => decimals(elongation_um.map(|um| sensor_counts(sensor, um)), 2),
            None => decimals(elongation_um, 3),
        });
        cells.extend(self.columns.temperatures.iter().map(|(channel, _)| {
            let centi_c = self.board.centi_c.get(usize::from(*channel)).copied().flatten();
            decimals(centi_c.map(|it| f64::from(it) / 100.0), 2)
        }));
        cells.extend(self.cnc.cells(self.clock.ms));
        let conditions = self.cnc.conditions(self.clock.ms);
        let cell = |value: Option<u16>| value.map(|it| it.to_string()).unwrap_or_default();
        cells.push(cell(conditions.map(|it| it.tool)));
        let bits = self.columns.conditions.iter();
        cells.extend(bits.map(|(bit, _)| cell(conditions.map(|it| it.has(*bit).into()))));
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

impl Columns {
    fn of(machine: &Machine) -> Self {
        let temperatures = temperature_columns(machine);
        let mut angles = Self::numbered();
        for (name, axis) in angles.iter_mut().zip(machine.angle_axes()) {
            *name = format!("{}_deg", axis.name());
        }
        let conditions = machine.inputs.iter().flat_map(|inputs| &inputs.conditions);
        let conditions = conditions.map(|(name, it)| (it.bit, name.clone())).collect();
        Self { temperatures, sensor: machine.sensor_on_board().cloned(), angles, conditions }
    }

    fn unnamed() -> Self {
        let name = |channel| (channel, format!("temp_channel{channel}_c"));
        let temperatures = (0..CHANNELS as u8).map(name).collect();
        Self { temperatures, sensor: None, angles: Self::numbered(), conditions: Vec::new() }
    }

    fn numbered() -> [String; 2] {
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
        .chain(cnc::COLUMNS)
        .chain(self.angles.each_ref().map(String::as_str))
        .chain([TOOL_COLUMN])
        .chain(self.conditions.iter().map(|(_, name)| name.as_str()))
        .collect::<Vec<_>>()
        .join(",")
    }
}

/// The bridge's clock, by its counter of cycles of a millisecond each.
#[derive(Default)]
struct Clock {
    ms: u64,
    last: Option<(u8, SystemTime)>,
}

impl Clock {
    fn receive(&mut self, counter: u8, at: SystemTime) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use trueup_core::{
        bridge::Input,
        cnc::Control,
        dimensions::CODES_PER_TICK,
        thermometer::Raw,
        units::{Code, Rpm},
    };
    use trueup_link::frames;
    use trueup_machine::{RunFile, compile};
    use trueup_node::node::{Interface, Node};

    /// A spindle whose sensor drifts with its own temperature by 0.2 µm/°C.
    const DRIFTING: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
        [inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
        temp_coil_c = { channel = 0, kind = \"pt100\" }\n\
        [spindle]\nsource = \"sensor\"\n\
        [spindle.sensor]\nk0_um = 0.0\nzero_counts = 5048.0\num_per_count = 0.0152587890625\n\
        temperature = \"temp_coil_c\"\n\
        [[term]]\nquantity = \"elongation\"\ncause = \"sensor-temperature-drift\"\n\
        column = \"temp_coil_c\"\num_per_c = 0.2\nreference_c = 20.0\n";

    #[test]
    fn the_counts_of_a_sensor_with_a_temperature_are_those_that_the_board_was_given() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("m.toml");
        fs::write(&path, DRIFTING).expect("a folder of ours");
        let machine = MachineFile::read(&path).expect("right");
        let compiled = compile(&machine).expect("it fits");
        let mut node = Node::new(Some(compiled.calibration()), false);
        let log = folder.path().join("run.log");
        let mut recorder = Recorder::begin(&log, Some(&path), "can0", None).expect("a new file");

        // On average 100.5 codes of 12 bits above the zero of 631, so 804 counts and 12.27 µm.
        let codes: [Code; CODES_PER_TICK] = std::array::from_fn(|n| Code(731 + (n % 2) as u16));
        let mut temperatures = [Raw::NONE; CHANNELS];
        // A PT100 at 30 °C: 100·(1 + 3.9083·10⁻³·30 − 5.775·10⁻⁷·30²) Ω.
        temperatures[0] = Raw(111_672_925);
        for ms in 0..3_000_u32 {
            if ms % 20 == 0 {
                let engaged = Control { engage: ms >= 60, ..Control::REFERENCED };
                let control = frames::control(engaged, (ms / 20) as u8);
                node.receive(Interface::Can, &control).expect("in order");
            }
            let input = Input {
                codes: Some(&codes),
                speed: Some(Rpm(24_000)),
                temperatures: Some(&temperatures),
            };
            let at = UNIX_EPOCH + Duration::from_millis(ms.into());
            for frame in node.tick(1, input).into_iter().chain(node.service()) {
                recorder.receive(&frame, at).expect("the disk is not full");
            }
        }
        recorder.flush().expect("the disk is not full");

        let run = RunFile::read(&log.with_extension("csv")).expect("a run file");
        let last = |name: &str| *run.column(name).expect(name).last().expect("a row");
        let [counts, offset_um, coil_c] = ["sensor_counts", "offset_z_um", "temp_coil_c"].map(last);
        println!("{counts} counts, {offset_um} µm, {coil_c} °C");
        // A nanometre on the wire is 0.066 counts.
        assert!((counts - 5852.0).abs() < 0.1, "{counts} counts");
        assert!((coil_c - 30.0).abs() < 0.011, "{coil_c} °C");
        // The drift is in the offsets: 12.27 + 0.2·(30 − 20) µm.
        assert!((offset_um - 14.27).abs() < 0.011, "{offset_um} µm");
    }

    #[test]
    fn the_last_readings_are_undone_one_after_the_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.csv");
        let mut recorder =
            Recorder::begin(&path, None, "can0", Some(Quantity::Dz)).expect("a new file");
        let mut node = Node::new(None, false);
        for ms in 0..2_000_u32 {
            // A reading each half second; the last but one was a slip, and so was the one that waits.
            if ms % 500 == 250 {
                recorder.mark(f64::from(ms) / 100.0);
            }
            if ms == 1_400 {
                assert_eq!(recorder.readings(), 3);
                assert_eq!(recorder.unmark().expect("the disk is not full"), Some(12.5));
            }
            for frame in node.tick(1, Input::default()) {
                let at = UNIX_EPOCH + Duration::from_millis(ms.into());
                recorder.receive(&frame, at).expect("the disk is not full");
            }
        }
        recorder.mark(99.0);
        assert_eq!(recorder.unmark().expect("the disk is not full"), Some(99.0));
        recorder.flush().expect("the disk is not full");
        assert_eq!(recorder.readings(), 3);
        let run = RunFile::read(&path).expect("a run file, with its log beside it");
        let read = run.column("measured_dz_um").expect("the gauge's column").iter();
        let read: Vec<f64> = read.copied().filter(|um| !um.is_nan()).collect();
        assert_eq!((read, run.rows() as u64), (vec![2.5, 7.5, 17.5], recorder.rows()));
        assert!(path.with_extension("log").exists());
    }

    #[test]
    fn without_a_law_on_the_board_the_elongation_itself_is_written_down() {
        let column = |text: &str| {
            let machine = MachineFile::parse(text, Path::new("m.toml")).expect("right");
            Columns::of(&machine).header().split(',').nth(8).map(str::to_owned)
        };
        assert_eq!(column(DRIFTING).as_deref(), Some("sensor_counts"));
        // The board would tell 0 µm for ever.
        let unused = DRIFTING.replace("source = \"sensor\"\n", "");
        let unused = unused.split("[[term]]").next().expect("what is before it");
        assert_eq!(column(unused).as_deref(), Some("elongation_um"));
    }

    #[test]
    fn a_recording_that_cannot_begin_is_for_the_user_to_mend() {
        let folder = tempfile::tempdir().expect("a folder");
        let begin = |name: &str| Recorder::begin(&folder.path().join(name), None, "can0", None);
        begin("here").expect("a new folder");
        for (name, phrase) in [
            ("here", "bridge.log: the recording cannot be created: another one is there"),
            ("here/bridge.csv", "bridge.log: the recording cannot be created: "),
            ("none/run.log", "run.log: the recording cannot be created: "),
        ] {
            let error = begin(name).err().expect("it is in the way");
            assert!(error.is::<Unusable>() && error.to_string().contains(phrase), "{error:#}");
        }
    }

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
            clock.receive(counter, at);
            assert_eq!(clock.ms, ms, "counter {counter}");
        }
    }
}
