//! The machine's last hours, written down every two seconds: heat lags, so what a probe finds now says nothing of
//! constants without the speeds and temperatures that led to it.
//!
//! A run file as `trueup learn` reads it, with the names of the machine file: `time_s` (seconds since 1970), speed,
//! load, positions, the bridge's temperatures, and the sensor's counts where the board runs a law of the sensor. What
//! is not known at a row is an empty cell. No offsets stand in it: with external offsets a probed point contains them.
//! One at the joint is in no probed point, and nothing is learned from it.

use std::{
    collections::VecDeque,
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use trueup_client::record::temperature_columns;
use trueup_machine::{
    Machine,
    machine_file::SensorModel,
    model::{required_columns, sensor_counts_from_elongation},
    tool_column::TOOL_COLUMN,
};

use crate::component::{ComponentInputs, ComponentOutputs};

/// From row to row: a spindle that changes its speed grows at once by micrometres.
const ROW_PERIOD_S: u64 = 2;
/// Kept are at least twelve hours, eight times the slowest time constant of a machine tool's column; at twice as much
/// the older half goes.
const MIN_RETAINED_ROWS: usize = 12 * 3600 / ROW_PERIOD_S as usize;

/// The record.
#[derive(Debug)]
pub struct RecordFile {
    path: PathBuf,
    header: String,
    temperatures: Vec<(u8, String)>,
    sensor: Option<SensorModel>,
    has_tool: bool,
    /// Bit and column of each condition.
    conditions: Vec<(u8, String)>,
    rows: VecDeque<String>,
    last_s: Option<u64>,
}

impl RecordFile {
    /// Goes on with what stands at `path`, if that has the same columns, or begins anew.
    ///
    /// # Errors
    /// It cannot be read or written there.
    pub fn open(path: &Path, machine: &Machine) -> io::Result<Self> {
        let temperatures = temperature_columns(machine);
        let sensor = machine.board_sensor_model().cloned();
        let names = temperatures.iter().map(|(_, name)| name.as_str());
        let first = ["time_s", "spindle_rpm", "load_n", "x_mm", "y_mm", "z_mm"];
        let counts = sensor.as_ref().map(|_| "sensor_counts");
        // A machine that goes by neither keeps the columns that it has had.
        let conditions = machine.inputs.iter().flat_map(|inputs| &inputs.conditions);
        let conditions: Vec<(u8, String)> =
            conditions.map(|(name, conditions)| (conditions.bit, name.clone())).collect();
        let has_tool = required_columns(machine).iter().any(|column| column == TOOL_COLUMN);
        let of_conditions = conditions.iter().map(|(_, name)| name.as_str());
        let header = first.into_iter().chain(counts).chain(names);
        let header = header.chain(has_tool.then_some(TOOL_COLUMN)).chain(of_conditions);
        let header = header.collect::<Vec<_>>().join(",");
        let there = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let mut lines = there.lines();
        let is_same = lines.next() == Some(&header);
        // A process that is killed may leave half a row.
        let cells = header.split(',').count();
        let whole = lines.filter(|line| line.split(',').count() == cells);
        let rows: VecDeque<String> =
            if is_same { whole.map(String::from).collect() } else { VecDeque::new() };
        let last_s = rows.back().and_then(|row| row.split(',').next()?.parse().ok());
        let path = path.into();
        let it = Self { path, header, temperatures, sensor, has_tool, conditions, rows, last_s };
        it.write_all()?;
        Ok(it)
    }

    /// Writes a row, if one is due.
    ///
    /// # Errors
    /// It cannot be written.
    pub(crate) fn write_row_if_due(
        &mut self,
        now: SystemTime,
        inputs: &ComponentInputs,
        outputs: &ComponentOutputs,
    ) -> io::Result<()> {
        let now_s = now.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
        if self.last_s.is_some_and(|last_s| (last_s..last_s + ROW_PERIOD_S).contains(&now_s)) {
            return Ok(());
        }
        // A clock that was set back: what came before is no past of what comes now.
        let is_back = self.last_s.is_some_and(|last_s| now_s < last_s);
        if is_back {
            self.rows.clear();
        }
        self.last_s = Some(now_s);
        let row = self.format_row(now_s, inputs, outputs);
        self.rows.push_back(row);
        if self.rows.len() > 2 * MIN_RETAINED_ROWS {
            self.rows.drain(..MIN_RETAINED_ROWS);
            return self.write_all();
        }
        if is_back {
            return self.write_all();
        }
        let mut file = OpenOptions::new().append(true).create(true).open(&self.path)?;
        // In one piece: who reads meanwhile finds whole rows.
        file.write_all(format!("{}\n", self.rows[self.rows.len() - 1]).as_bytes())
    }

    fn format_row(
        &self,
        now_s: u64,
        inputs: &ComponentInputs,
        outputs: &ComponentOutputs,
    ) -> String {
        let cell = |value: f64, decimals: usize| {
            if value.is_finite() { format!("{value:.decimals$}") } else { String::new() }
        };
        let mut cells =
            vec![now_s.to_string(), cell(inputs.spindle_rpm, 1), cell(inputs.load_n, 1)];
        cells.extend(inputs.position_mm.map(|mm| cell(mm, 4)));
        let unknown = f64::NAN;
        if let Some(sensor) = &self.sensor {
            let counts = outputs.elongation_um.map(|um| sensor_counts_from_elongation(sensor, um));
            cells.push(cell(counts.unwrap_or(unknown), 2));
        }
        for (channel, _) in &self.temperatures {
            let celsius = outputs.temperatures_c.get(usize::from(*channel)).copied().flatten();
            cells.push(cell(celsius.unwrap_or(unknown), 2));
        }
        let reported = inputs.conditions;
        let whole = |value: Option<u16>| cell(value.map_or(unknown, f64::from), 0);
        cells.extend(self.has_tool.then(|| whole(reported.map(|conditions| conditions.tool))));
        let bits = self.conditions.iter();
        cells.extend(
            bits.map(|(bit, _)| whole(reported.map(|conditions| conditions.is_set(*bit).into()))),
        );
        cells.join(",")
    }

    /// The whole of it, by way of a file next to it, so that there is never half of one.
    fn write_all(&self) -> io::Result<()> {
        let mut text = self.header.clone() + "\n";
        for row in &self.rows {
            text += row;
            text.push('\n');
        }
        let adjacent = self.path.with_extension("new");
        fs::write(&adjacent, text)?;
        fs::rename(&adjacent, &self.path)
    }
}

#[cfg(test)]
mod tests {
    use trueup_machine::{MachineFile, RunFile};

    use super::*;

    const MACHINE: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[inputs]\n\
                           temp_b_c = { channel = 3, kind = \"pt100\" }\n\
                           sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.328 }\n\
                           [spindle]\nsource = \"sensor\"\n[spindle.sensor]\nk0_um = 0.0\n\
                           zero_counts = 5000.0\num_per_count = 0.01\n";

    fn record(path: &Path) -> RecordFile {
        let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file");
        RecordFile::open(path, &machine).expect("it can be written")
    }

    fn at(record: &mut RecordFile, now_s: u64) {
        let inputs = ComponentInputs {
            spindle_rpm: 12_000.0,
            position_mm: [1.5, f64::NAN, -3.0],
            ..ComponentInputs::default()
        };
        let mut outputs =
            ComponentOutputs { elongation_um: Some(20.0), ..ComponentOutputs::default() };
        outputs.temperatures_c[3] = Some(23.5);
        let now = UNIX_EPOCH + Duration::from_secs(now_s);
        record.write_row_if_due(now, &inputs, &outputs).expect("it can be written");
    }

    fn times(path: &Path) -> Vec<f64> {
        RunFile::read(path).expect("a run file").column("time_s").expect("there").to_vec()
    }

    #[test]
    fn a_row_is_a_row_of_a_run_file_with_the_machines_names() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("record.csv");
        let mut record = record(&path);
        (1000..1005).for_each(|now_s| at(&mut record, now_s));
        let run = RunFile::read(&path).expect("a run file");
        let last = |name: &str| *run.column(name).expect("there").last().expect("rows");
        assert_eq!(run.column("time_s"), Some(&[1000.0, 1002.0, 1004.0][..]));
        assert_eq!((last("spindle_rpm"), last("x_mm"), last("temp_b_c")), (12_000.0, 1.5, 23.5));
        assert_eq!(last("sensor_counts"), 7000.0);
        assert!(last("y_mm").is_nan(), "it received no position of Y");
    }

    #[test]
    fn it_goes_on_after_a_restart_and_begins_anew_when_the_clock_is_set_back() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("record.csv");
        at(&mut record(&path), 1000);
        let mut text = fs::read_to_string(&path).expect("there");
        text += "1002,12";
        fs::write(&path, text).expect("half a row");
        let mut again = record(&path);
        at(&mut again, 1001);
        at(&mut again, 1003);
        assert_eq!(times(&path), [1000.0, 1003.0]);
        at(&mut again, 500);
        assert_eq!(times(&path), [500.0]);
        // Another machine's columns are not gone on with.
        fs::write(&path, "time_s,temp_other_c\n1,2\n").expect("it can be written");
        at(&mut record(&path), 600);
        assert_eq!(times(&path), [600.0]);
    }

    #[test]
    fn of_a_long_life_the_last_half_day_stays() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("record.csv");
        let mut record = record(&path);
        let full = 2 * MIN_RETAINED_ROWS;
        record.rows = (0..full as u64)
            .map(|row| {
                record.format_row(
                    ROW_PERIOD_S * row,
                    &ComponentInputs::default(),
                    &ComponentOutputs::default(),
                )
            })
            .collect();
        let next_s = ROW_PERIOD_S * full as u64;
        at(&mut record, next_s);
        let left = times(&path);
        assert_eq!((left.len(), left[left.len() - 1]), (MIN_RETAINED_ROWS + 1, next_s as f64));
        assert_eq!(left[0], (ROW_PERIOD_S as usize * MIN_RETAINED_ROWS) as f64);
    }
}
