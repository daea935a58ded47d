//! For each row of a run: what the model says, and what the board's integers make of it.
//!
//! Two columns a quantity, both before filter, limits, slew and wire rounding:
//!
//! ```text
//! row ─► model, f64 ─────────────────────────────────────────► predicted_<quantity>_um
//!    └► nearest reading, position, temperature ─► the board's own code ─► bridge_<quantity>_um
//! ```
//!
//! The bridge's side runs the functions of `trueup-core` that the firmware runs, on the calibration
//! that [`compile`](mod@crate::compile) gives the board, so the difference between the two columns
//! is what fixed-point arithmetic costs. Heat is stepped as the board steps it, every 100 ms of the
//! run's time.
//!
//! A quantity that depends on a column that the run does not have stays empty; a run from which
//! nothing can be predicted is refused.

use std::{
    borrow::Cow,
    io::{self, Write},
};

use trueup_core::{
    calibration::Calibration,
    dimensions::CHANNELS,
    dimensions::STEP_MS,
    heat::{FIRST_TERM, Heat},
    lag::SmoothingFactor,
    place::Place as BoardPlace,
    term::{self, OperatingPoint},
    tip::{self, UNLIMITED},
    travel::Travel,
    units::{MicroDegrees, NANOMETRES_PER_MICROMETRE, Nanometres, Position, Rpm, Temperature},
};

use crate::{
    compile::{Compiled, compile, term::PARTS_OF_N},
    effect::OnBoard,
    file::{LinearAxis, Machine, Quantity, RotaryAxis, Source},
    inputs::{Inputs, LAST_CHANNEL, SensorInput, TemperatureInput, TemperatureKind},
    model::{Reference, Situation, required_columns, shifted, time_shift_s},
    place::{BadInput, Place},
    run_file::RunFile,
};

pub use crate::model::Values;

/// The columns that a prediction adds to those of the run, in their order.
pub const COLUMNS: [&str; 8] = [
    "predicted_elongation_um",
    "bridge_elongation_um",
    "predicted_dx_um",
    "bridge_dx_um",
    "predicted_dy_um",
    "bridge_dy_um",
    "predicted_dz_um",
    "bridge_dz_um",
];

const NM_PER_UM: f64 = NANOMETRES_PER_MICROMETRE as f64;
const UNITS_PER_MM: f64 = Position::PER_MILLIMETRE as f64;

/// Both sides for one row; a value that cannot be predicted is NaN on both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The reference arithmetic.
    pub model: Values,
    /// The same without the terms that only explain (`drift`, `time-shift` and the like): what the
    /// board is to correct.
    pub compensated: Values,
    /// The board's arithmetic; `None` where the machine does not say how the sensor is connected.
    pub bridge: Option<Values>,
}

impl Prediction {
    /// The largest difference between the bridge and what it is to correct, in nm; `None` without a
    /// bridge or a value.
    #[must_use]
    pub fn difference_nm(&self) -> Option<f64> {
        let bridge = self.bridge?.all();
        let apart =
            self.compensated.all().into_iter().zip(bridge).map(|(model, bridge)| model - bridge);
        apart.filter(|um| !um.is_nan()).map(|um| um.abs() * NM_PER_UM).reduce(f64::max)
    }
}

/// A machine's prediction for a run, checked and ready to be written.
#[derive(Clone, Debug)]
pub struct Predictor<'a> {
    machine: &'a Machine,
    run: &'a RunFile,
    columns: Columns<'a>,
    missing: Vec<String>,
    bridge: Result<Bridge, String>,
}

/// The columns of the run that the model knows.
#[derive(Clone, Debug)]
struct Columns<'a> {
    time_s: Option<&'a [f64]>,
    sensor_counts: Option<&'a [f64]>,
    spindle_rpm: Option<&'a [f64]>,
    load_n: Option<&'a [f64]>,
    temperatures_c: Vec<(&'a str, &'a [f64])>,
    position_mm: [Option<&'a [f64]>; 3],
    angle_deg: [Option<&'a [f64]>; 3],
    direction: [Option<&'a [f64]>; 3],
}

/// The board's side.
#[derive(Clone, Debug)]
struct Bridge {
    /// `None` if no law needs a reading.
    input: Option<SensorInput>,
    /// The temperature column of each channel.
    channels: [Option<String>; CHANNELS],
    compiled: Compiled,
}

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// Rows of the run.
    pub rows: usize,
    /// Rows whose counts are missing, of which at least the elongation is not predicted.
    pub rows_without_counts: usize,
    /// Rows whose counts the sensor cannot give. They are predicted like all others.
    pub rows_out_of_range: usize,
    /// Where the first of these stands.
    pub first_out_of_range: Option<Place>,
    /// The largest difference between model and bridge, in nm; `None` without a bridge or rows.
    pub largest_difference_nm: Option<f64>,
}

impl<'a> Predictor<'a> {
    /// The prediction of `machine` for `run`.
    ///
    /// `[inputs]` may be missing: without the sensor that is the source there is no bridge side
    /// then; temperatures are taken to be on channels of their own.
    ///
    /// # Errors
    /// A column is missing without which nothing can be predicted; a column of the run has the name
    /// of one that is to be written.
    pub fn new(machine: &'a Machine, run: &'a RunFile) -> Result<Self, BadInput> {
        for name in COLUMNS {
            if run.column(name).is_some() {
                let rule = format!("column {name} is already there, and would be repeated");
                return Err(BadInput::new(run.header_place(), rule));
            }
        }
        let missing: Vec<String> = required_columns(machine)
            .into_iter()
            .filter(|name| run.column(name).is_none())
            .collect();
        let columns = Columns::of(run);
        if let Some(first) = missing.first()
            && nothing_is_known(machine, &columns)
        {
            run.require(first)?;
        }
        Ok(Self { machine, run, columns, missing, bridge: Bridge::of(machine) })
    }

    /// Why there is no bridge side, if there is none: the machine does not say how the sensor is
    /// connected, or the board could not run it, with the place and the rule.
    #[must_use]
    pub fn why_no_bridge(&self) -> Option<&str> {
        self.bridge.as_ref().err().map(String::as_str)
    }

    /// Columns that the machine's model needs and the run does not have: what depends on them is
    /// not predicted.
    #[must_use]
    pub fn missing_columns(&self) -> &[String] {
        &self.missing
    }

    /// Both sides, row by row: heat is a state.
    pub fn rows(&self) -> impl Iterator<Item = Prediction> {
        let mut model = self.model();
        let compensated = self.machine.compensated();
        // Where nothing is left out it is the model, and is not computed twice.
        let only_explains = matches!(compensated, Cow::Owned(_));
        let mut compensated = only_explains.then(|| Reference::of(compensated));
        let mut bridge =
            self.bridge.as_ref().ok().map(|bridge| BridgeRun::new(self.machine, bridge));
        (0..self.run.rows()).map(move |row| {
            let temperatures = self.columns.temperatures(row);
            let situation = self.columns.situation(row, &temperatures);
            let model = model.next().expect("one for each row");
            let compensated = compensated.as_mut().map_or(model, |it| it.step(&situation).values());
            let bridge = bridge.as_mut().map(|bridge| {
                let bridge = bridge.step(&situation);
                // What the model cannot know the board does not know either.
                let known = |model: f64, bridge: f64| if model.is_nan() { model } else { bridge };
                Values {
                    elongation_um: known(compensated.elongation_um, bridge.elongation_um),
                    error_um: [0, 1, 2].map(|n| known(compensated.error_um[n], bridge.error_um[n])),
                }
            });
            Prediction { model, compensated, bridge }
        })
    }

    /// The model's values row by row. A time shift looks ahead and back, so that all of them are
    /// there before the first is given; otherwise none is kept.
    fn model(&self) -> Box<dyn Iterator<Item = Values> + '_> {
        let mut reference = Reference::new(self.machine);
        let in_time = (0..self.run.rows()).map(move |row| {
            let temperatures = self.columns.temperatures(row);
            reference.step(&self.columns.situation(row, &temperatures)).values()
        });
        let shifts_s = Quantity::ALL.map(|it| time_shift_s(&self.machine.terms, it));
        if shifts_s == [0.0; 4] {
            return Box::new(in_time);
        }
        let mut columns = [const { Vec::new() }; 4];
        for values in in_time {
            for (column, value) in columns.iter_mut().zip(values.all()) {
                column.push(value);
            }
        }
        let never;
        let time_s = match self.columns.time_s {
            Some(time_s) => time_s,
            None => {
                never = vec![f64::NAN; self.run.rows()];
                &never
            }
        };
        let [elongation, dx, dy, dz] =
            [0, 1, 2, 3].map(|n| shifted(time_s, &columns[n], shifts_s[n]));
        Box::new((0..self.run.rows()).map(move |row| Values {
            elongation_um: elongation[row],
            error_um: [dx[row], dy[row], dz[row]],
        }))
    }

    /// Writes the run as CSV with [`COLUMNS`] after its own; a value that is missing is an empty
    /// cell. `row_done` hears of every row.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write(&self, mut out: impl Write, mut row_done: impl FnMut()) -> io::Result<Written> {
        let mut written = Written {
            rows: self.run.rows(),
            rows_without_counts: 0,
            rows_out_of_range: 0,
            first_out_of_range: None,
            largest_difference_nm: None,
        };
        for column in self.run.columns() {
            write_name(&mut out, &column.name)?;
            out.write_all(b",")?;
        }
        writeln!(out, "{}", COLUMNS.join(","))?;
        for (row, prediction) in self.rows().enumerate() {
            for column in self.run.columns() {
                let value = column.values.get(row).copied().unwrap_or(f64::NAN);
                if !value.is_nan() {
                    write!(out, "{value}")?;
                }
                out.write_all(b",")?;
            }
            write_prediction(&mut out, &prediction)?;
            self.note(row, &prediction, &mut written);
            row_done();
        }
        out.flush()?;
        Ok(written)
    }

    fn note(&self, row: usize, prediction: &Prediction, written: &mut Written) {
        if let Some(difference_nm) = prediction.difference_nm() {
            let before = written.largest_difference_nm.unwrap_or(0.0);
            written.largest_difference_nm = Some(before.max(difference_nm));
        }
        if self.machine.spindle.source != Some(Source::Sensor) {
            return;
        }
        let counts = at(self.columns.sensor_counts, row);
        if counts.is_nan() {
            written.rows_without_counts += 1;
            return;
        }
        let input = self.bridge.as_ref().ok().and_then(|bridge| bridge.input);
        if input.is_some_and(|input| !input.is_in_range(counts)) {
            written.rows_out_of_range += 1;
            let place = || self.run.place(row, "sensor_counts");
            written.first_out_of_range.get_or_insert_with(place);
        }
    }
}

/// Whether no quantity that the machine's model describes can be had from these columns.
fn nothing_is_known(machine: &Machine, columns: &Columns<'_>) -> bool {
    // A row in which every column that is there has a value.
    let there = |column: &Option<&[f64]>| column.map_or(f64::NAN, |_| 1.0);
    let temperatures: Vec<_> =
        columns.temperatures_c.iter().map(|(name, _)| (*name, 20.0)).collect();
    let situation = Situation {
        time_s: columns.time_s.map(|_| 0.0),
        sensor_counts: there(&columns.sensor_counts),
        spindle_rpm: columns.spindle_rpm.map(|_| 1.0),
        load_n: columns.load_n.map(|_| 1.0),
        temperatures_c: &temperatures,
        position_mm: columns.position_mm.each_ref().map(there),
        angle_deg: columns.angle_deg.each_ref().map(there),
        direction: [1.0; 3],
    };
    let nothing = Situation { temperatures_c: &[], ..Situation::UNKNOWN };
    let known = Reference::new(machine).step(&situation).values().all();
    let blind = Reference::new(machine).step(&nothing).values().all();
    // Zero and known without any column is no quantity of this machine.
    known.iter().zip(blind).all(|(known, blind)| known.is_nan() || !blind.is_nan())
}

fn at(column: Option<&[f64]>, row: usize) -> f64 {
    column.and_then(|values| values.get(row)).copied().unwrap_or(f64::NAN)
}

impl<'a> Columns<'a> {
    fn of(run: &'a RunFile) -> Self {
        let linear =
            |name: fn(&str) -> String| LinearAxis::ALL.map(|axis| run.column(&name(axis.name())));
        let temperatures =
            run.columns().iter().filter(|column| crate::file::is_temperature_column(&column.name));
        Self {
            time_s: run.column("time_s"),
            sensor_counts: run.column("sensor_counts"),
            spindle_rpm: run.column("spindle_rpm"),
            load_n: run.column("load_n"),
            temperatures_c: temperatures
                .map(|column| (column.name.as_str(), column.values.as_slice()))
                .collect(),
            position_mm: linear(|axis| format!("{axis}_mm")),
            angle_deg: RotaryAxis::ALL.map(|axis| run.column(&format!("{}_deg", axis.name()))),
            direction: linear(|axis| format!("dir_{axis}")),
        }
    }

    fn temperatures(&self, row: usize) -> Vec<(&'a str, f64)> {
        self.temperatures_c.iter().map(|(name, values)| (*name, at(Some(values), row))).collect()
    }

    fn situation<'t>(&self, row: usize, temperatures_c: &'t [(&'a str, f64)]) -> Situation<'t> {
        Situation {
            time_s: self.time_s.map(|times| at(Some(times), row)),
            sensor_counts: at(self.sensor_counts, row),
            spindle_rpm: self.spindle_rpm.map(|speeds| at(Some(speeds), row)),
            load_n: self.load_n.map(|loads| at(Some(loads), row)),
            temperatures_c,
            position_mm: self.position_mm.map(|values| at(values, row)),
            angle_deg: self.angle_deg.map(|values| at(values, row)),
            direction: self.direction.map(|values| at(values, row)),
        }
    }
}

impl Bridge {
    /// The error says why there is none, which keeps nobody from predicting.
    fn of(machine: &Machine) -> Result<Self, String> {
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
        if machine.spindle.source == Some(Source::Sensor) && input.is_none() {
            return Err("without [inputs] sensor".into());
        }
        let wired = with_all_temperatures(machine);
        let compiled = match compile(&wired) {
            Ok(compiled) => compiled,
            Err(error) => return Err(error.to_string()),
        };
        let mut channels = [const { None }; CHANNELS];
        for (name, temperature) in wired.inputs.iter().flat_map(|inputs| &inputs.temperatures) {
            if let Some(channel) = channels.get_mut(usize::from(temperature.channel)) {
                *channel = Some(name.clone());
            }
        }
        Ok(Self { input, channels, compiled })
    }
}

/// The machine with a channel for every temperature that its model uses: to predict, nobody need
/// say how they are connected.
fn with_all_temperatures(machine: &Machine) -> Machine {
    let mut wired = machine.clone();
    let axes = machine.axes.iter().filter_map(|axis| axis.thermal.as_ref());
    let spindle = machine.spindle.temperature.iter().map(|model| &model.sensor);
    let of_terms = machine.terms.iter().filter_map(|term| term.effect.temperature());
    let used: Vec<String> =
        axes.map(|thermal| &thermal.sensor).chain(spindle).cloned().chain(of_terms).collect();
    let inputs = wired.inputs.get_or_insert_with(Inputs::default);
    for name in used {
        let taken = |channel: &u8| inputs.temperatures.values().any(|it| it.channel == *channel);
        if !inputs.temperatures.contains_key(&name)
            && let Some(channel) = (0..=LAST_CHANNEL).find(|channel| !taken(channel))
        {
            let input = TemperatureInput { channel, kind: TemperatureKind::Pt100 };
            inputs.temperatures.insert(name, input);
        }
    }
    wired
}

/// The board's side on its way through a run.
struct BridgeRun<'b> {
    bridge: &'b Bridge,
    calibration: Calibration<'b>,
    /// In the order of `head_axes`, each the place of its angle among A, B and C.
    head_axes: Vec<usize>,
    rated: Rpm,
    /// When each of the terms over time starts, in the run's time.
    starts_s: Vec<f64>,
    heat: Heat,
    /// The time of the first row, and the steps taken since.
    clock: Option<(f64, u64)>,
    last_s: f64,
}

impl<'b> BridgeRun<'b> {
    fn new(machine: &Machine, bridge: &'b Bridge) -> Self {
        let rated = machine.spindle.warmup.as_ref().and_then(|warmup| warmup.rated_rpm);
        Self {
            bridge,
            calibration: bridge.compiled.calibration(),
            head_axes: machine.head_axes.iter().map(|axis| axis.index()).collect(),
            rated: rpm(rated.unwrap_or(1.0)),
            starts_s: machine
                .terms
                .iter()
                .flat_map(|term| term.effect.on_board())
                .filter_map(|form| match form {
                    OnBoard::Time { start_s, .. } => Some(start_s),
                    _ => None,
                })
                .collect(),
            heat: Heat::default(),
            clock: None,
            last_s: f64::NAN,
        }
    }

    fn step(&mut self, situation: &Situation<'_>) -> Values {
        self.heat_up(situation);
        let calibration = &self.calibration;
        let reading = self.bridge.input.map(|it| it.reading_from_counts(situation.sensor_counts));
        let by_sensor = calibration.spindle.sensor.elongation(reading.unwrap_or_default());
        let source = calibration.spindle.chain[0];
        let plain = tip::elongation_by(source, by_sensor, &self.heat).fine();
        let operating = OperatingPoint {
            speed: situation.spindle_rpm.map(rpm),
            // A cast from f64 saturates.
            load: (situation.load_n.unwrap_or(0.0) * PARTS_OF_N).round() as i32,
        };
        let terms = &calibration.terms;
        let elongation = term::elongation(terms, plain, self.heat.terms(), operating).rounded();
        let mut place = BoardPlace::default();
        for (n, axis) in calibration.axes.iter().enumerate() {
            // A cast from f64 saturates and takes NaN to 0; what depends on it is not shown.
            place.position[n] = Position((situation.position_mm[n] * UNITS_PER_MM).round() as i32);
            place.travel[n] = Travel::new();
            let direction = if situation.direction[n] < 0.0 { -1 } else { 1 };
            place.travel[n].update(&axis.travel, place.position[n], direction);
        }
        let angle = |n: usize| {
            let degrees = self.head_axes.get(n).map_or(0.0, |&axis| situation.angle_deg[axis]);
            MicroDegrees((degrees * f64::from(MicroDegrees::PER_DEGREE)).round() as i32)
        };
        let direction = calibration.kinematics.direction([angle(0), angle(1)]);
        // Without limits: what the tick would clamp is shown as it is.
        let axes = calibration.errors(&self.heat, &place).sums(UNLIMITED).sums;
        let (error, _) = tip::error_at_tip(elongation, direction, axes, UNLIMITED);
        let um = |length: Nanometres| f64::from(length.0) / NM_PER_UM;
        Values { elongation_um: um(elongation), error_um: error.map(|error| um(error.rounded())) }
    }

    /// Steps the heat up to the row, as often as the board would; a row that lacks something leaves
    /// it to the next.
    fn heat_up(&mut self, situation: &Situation<'_>) {
        /// More steps than that (eleven days) leave no lag unsettled that the board can follow.
        const MOST_STEPS: u64 = 10_000_000;
        let temperatures: [Option<Temperature>; CHANNELS] = std::array::from_fn(|channel| {
            let name = self.bridge.channels[channel].as_ref()?;
            let units = situation.temperature_c(name) * f64::from(Temperature::PER_KELVIN);
            (!units.is_nan()).then_some(Temperature(units.round() as i32))
        });
        let speed = match situation.spindle_rpm {
            None => Some(self.rated),
            Some(speed) if speed.is_nan() => return,
            Some(speed) => Some(rpm(speed)),
        };
        if situation.time_s.is_some_and(f64::is_nan) {
            return;
        }
        let time_s = situation.time_s.unwrap_or(0.0);
        if time_s < self.last_s {
            (self.heat, self.clock) = (Heat::default(), None);
        }
        self.last_s = time_s;
        let is_first = self.clock.is_none();
        if is_first {
            self.run_ahead(time_s);
        }
        let (start_s, done) = self.clock.get_or_insert((time_s, 0));
        let due = ((time_s - *start_s) * 1_000.0 / f64::from(STEP_MS)).round() as u64;
        let steps = due.saturating_sub(*done).min(MOST_STEPS);
        *done = due;
        for _ in 0..steps {
            self.heat.step(&self.calibration, &temperatures, speed);
        }
        // Lags start settled; and what has none is not bound to the board's steps.
        let follows = |smoothing: SmoothingFactor| is_first || smoothing == SmoothingFactor::NO_LAG;
        let axes = self.calibration.axes.iter().map(|axis| axis.thermal.map(|it| it.smoothing));
        let spindle = self.calibration.spindle.temperature.map(|it| it.smoothing);
        let terms = self.calibration.terms.iter().map(|term| match term.as_ref()?.effect {
            term::Effect::Heat { smoothing, .. } => Some(smoothing),
            _ => None,
        });
        let factors = (0..).zip(axes.chain([spindle])).chain((FIRST_TERM..).zip(terms));
        for (item, smoothing) in factors {
            if smoothing.is_some_and(follows) {
                self.heat.step_item(&self.calibration, item, &temperatures, speed);
            }
        }
    }

    /// Terms over time go on from where they are at the first row.
    fn run_ahead(&mut self, time_s: f64) {
        let is_timed = |term: &&Option<term::Term<'_>>| {
            term.is_some_and(|term| matches!(term.effect, term::Effect::Time { .. }))
        };
        let terms = self.calibration.terms.iter().enumerate();
        let timed = terms.filter(|(_, term)| is_timed(term)).map(|(index, _)| index);
        for (index, start_s) in timed.zip(&self.starts_s) {
            let steps = (time_s - start_s) * 1_000.0 / f64::from(STEP_MS);
            // A cast from f64 saturates at both ends; ten million steps settle every lag.
            let steps = (steps.round() as u32).min(10_000_000);
            self.heat.run_ahead(&self.calibration, index, steps);
        }
    }
}

/// A speed as the board knows it.
fn rpm(speed: f64) -> Rpm {
    // Slower than half a turn a minute is still a spindle that runs.
    let rounded = if speed == 0.0 { 0.0 } else { speed.abs().round().max(1.0) };
    Rpm(rounded.min(f64::from(u16::MAX)) as u16)
}

/// A column's name, in quotes where it would otherwise be read as something else.
fn write_name(out: &mut impl Write, name: &str) -> io::Result<()> {
    if name.contains([',', ';', '"']) {
        write!(out, "\"{}\"", name.replace('"', "\"\""))
    } else {
        out.write_all(name.as_bytes())
    }
}

/// The cells of [`COLUMNS`], to 1 pm, and the end of the line.
fn write_prediction(out: &mut impl Write, prediction: &Prediction) -> io::Result<()> {
    let bridge = prediction.bridge.map_or([f64::NAN; 4], Values::all);
    let pairs = prediction.model.all().into_iter().zip(bridge);
    for (number, value) in pairs.flat_map(|(model, bridge)| [model, bridge]).enumerate() {
        if number > 0 {
            out.write_all(b",")?;
        }
        if !value.is_nan() {
            // + 0.0 turns −0 into 0.
            write!(out, "{:.6}", value + 0.0)?;
        }
    }
    out.write_all(b"\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MachineFile;
    use std::path::Path;

    const PAPER: &str = include_str!("../../../data/paper_spindle.toml");
    const INPUT: &str =
        "sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }";

    fn machine(text: &str) -> Machine {
        MachineFile::parse(text, Path::new("m.toml")).expect("the test's own machine file")
    }

    fn run(text: &str) -> RunFile {
        RunFile::from_reader(text.as_bytes(), Path::new("r.csv")).expect("the test's own run")
    }

    /// What is written, and the account of it.
    fn written(machine_text: &str, run_text: &str) -> (String, Written) {
        let (machine, run) = (machine(machine_text), run(run_text));
        let predictor = Predictor::new(&machine, &run).expect("can be predicted");
        let (mut out, mut rows) = (Vec::new(), 0);
        let account = predictor.write(&mut out, || rows += 1).expect("a Vec can be written");
        assert_eq!(rows, account.rows);
        (String::from_utf8(out).expect("CSV is text"), account)
    }

    #[test]
    fn both_sides_stand_beside_what_was_read() {
        let (csv, account) = written(PAPER, "sensor_counts,mystery\n9164,-1e-3\n5048,\n");
        let header = format!("sensor_counts,mystery,{}\n", COLUMNS.join(","));
        // 62.80517578125 µm: the board rounds it to a nanometre, and the error once more.
        let grown = "9164,-0.001,62.805176,62.805000,0.000000,0.000000,0.000000,0.000000,\
                     -62.805176,-62.805000\n";
        let cold = format!("5048,{}\n", ",0.000000".repeat(8));
        assert_eq!(csv, [header.as_str(), grown, &cold].concat());
        assert_eq!((account.rows, account.rows_without_counts), (2, 0));
        let difference_nm = account.largest_difference_nm.expect("there is a bridge");
        assert!((difference_nm - 0.175_781_25).abs() < 1e-9);
    }

    #[test]
    fn a_row_without_counts_has_empty_cells() {
        let (csv, account) = written(PAPER, "x_mm;sensor_counts\n1;\n2;5048\n3;nan\n");
        // X and Y do not depend on a tool that points down.
        let rest = format!(",,,,{},,\n", ["0.000000"; 4].join(","));
        assert!(
            csv.contains(&format!("\n1{rest}")) && csv.contains(&format!("\n3{rest}")),
            "{csv}"
        );
        assert_eq!((account.rows, account.rows_without_counts), (3, 2));
    }

    #[test]
    fn without_inputs_the_model_predicts_alone() {
        let (csv, account) = written(&PAPER.replace(INPUT, ""), "sensor_counts\n9164\n");
        assert!(csv.ends_with("\n9164,62.805176,,0.000000,,0.000000,,-62.805176,\n"), "{csv}");
        assert_eq!(account.largest_difference_nm, None);
    }

    #[test]
    fn without_a_source_both_sides_are_zero_and_no_counts_are_needed() {
        let text = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
        let (csv, account) = written(text, "x_mm\n1\n");
        assert!(csv.ends_with(&format!("\n1{}\n", ",0.000000".repeat(8))), "{csv}");
        assert_eq!(account.largest_difference_nm, Some(0.0));
    }

    #[test]
    fn an_inclined_tool_shares_its_growth_between_the_axes() {
        let text = PAPER
            .replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.0, 0.6, -0.8]");
        let (csv, account) = written(&text, "sensor_counts\n9164\n");
        let cells = "62.805176,62.805000,0.000000,0.000000,37.683105,37.683000,\
                     -50.244141,-50.244000\n";
        assert!(csv.ends_with(cells), "{csv}");
        assert!(account.largest_difference_nm.expect("there is a bridge") < 1.0);
    }

    #[test]
    fn the_bridge_is_within_2_nm_of_the_model_at_every_count() {
        let text = PAPER
            .replace("kind = \"3-axis\"", "kind = \"3-axis\"\ntool_direction = [0.1, -0.7, -0.8]");
        let counts: String = (0..=32_768).map(|count| format!("{count}\n")).collect();
        let (_, account) = written(&text, &format!("sensor_counts\n{counts}"));
        let difference_nm = account.largest_difference_nm.expect("there is a bridge");
        assert!((0.5..1.1).contains(&difference_nm), "{difference_nm} nm");
    }

    #[test]
    fn what_was_written_is_a_run_file_with_the_same_values() {
        let text = "\"load; \"\"z\"\", n\",sensor_counts,time_s\n1e-7,5048.5,\n-2e300,0.1,3\n";
        let (csv, _) = written(PAPER, text);
        let (before, after) = (run(text), run(&csv));
        assert_eq!(after.columns().len(), 3 + COLUMNS.len());
        for (before, after) in before.columns().iter().zip(after.columns()) {
            assert_eq!(before.name, after.name);
            for (before, after) in before.values.iter().zip(&after.values) {
                assert!(before == after || before.is_nan() && after.is_nan());
            }
        }
    }

    #[test]
    fn counts_that_the_sensor_cannot_give_are_told() {
        let (_, account) = written(PAPER, "sensor_counts\n0\n32768\n40000\n-1\n\n");
        assert_eq!(account.rows_out_of_range, 2);
        assert_eq!(account.first_out_of_range.expect("two").line, 4);
    }

    #[test]
    fn what_the_board_could_not_run_is_predicted_all_the_same() {
        let steep = machine(&PAPER.replace("0.0152587890625", "2.0"));
        let run = run("sensor_counts\n5049\n");
        let predictor = Predictor::new(&steep, &run).expect("the model needs no board");
        let why = predictor.why_no_bridge().expect("the board cannot");
        assert!(why.starts_with("m.toml:16:16: spindle.sensor.um_per_count 2 is"), "{why}");
        assert_eq!(predictor.rows().next().map(|row| row.model.elongation_um), Some(2.0));
    }

    #[test]
    fn what_cannot_be_predicted_is_refused_with_its_place() {
        for (run_text, complaint) in [
            ("x_mm\n1\n", "r.csv:1:1: column sensor_counts is missing"),
            (
                "sensor_counts,bridge_dx_um\n1,2\n",
                "r.csv:1:1: column bridge_dx_um is already there",
            ),
        ] {
            let (machine, run) = (machine(PAPER), run(run_text));
            let error = Predictor::new(&machine, &run).expect_err(complaint).to_string();
            assert!(error.starts_with(complaint), "{error}");
        }
    }
}
