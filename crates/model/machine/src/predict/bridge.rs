//! The board's side: its own code on its own integers, over the rows of a run.

use trueup_core::{
    calibration::Calibration,
    cnc::MachineConditions,
    design_parameters::{TEMPERATURE_CHANNEL_COUNT, THERMAL_STEP_MS},
    lag::SmoothingFactor,
    machine_position::MachinePosition,
    reversal::ReversalTracker,
    term::{self, OperatingPoint},
    thermal_state::{FIRST_TERM_ITEM, MachineThermalState},
    tip_error::{self, UNLIMITED},
    units::{MicroDegrees, Nanometres, Position, Rpm, Temperature},
};

use crate::{
    compile::{
        CompiledCalibration, board_condition_columns, compile, first_free_condition_bit,
        term::LOAD_UNITS_PER_NEWTON,
    },
    effect::BoardTerm,
    inputs::{
        BoardInputs, ConditionInput, MAX_TEMPERATURE_CHANNEL, SensorInput, TemperatureInput,
        TemperatureInputKind,
    },
    machine_file::Machine,
    model::{ErrorValues, RowInputs},
    sections::{ElongationSource, ToolGrowthList},
    tool_column::TOOL_COLUMN,
    unit_conversion::{NM_PER_UM, POSITION_UNITS_PER_MM},
};

/// The board's side.
#[derive(Clone, Debug)]
pub(super) struct SimulatedBridge {
    /// `None` if no law needs a reading.
    pub(super) input: Option<SensorInput>,
    /// The temperature column of each channel.
    channels: [Option<String>; TEMPERATURE_CHANNEL_COUNT],
    /// The column of each condition, with its bit.
    conditions: Vec<(String, u8)>,
    pub(super) compiled: CompiledCalibration,
}

impl SimulatedBridge {
    /// Returns the bridge of a machine. The error says why there is none; a prediction needs none.
    pub(super) fn from_machine(machine: &Machine) -> Result<Self, String> {
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor);
        if machine.spindle.source == Some(ElongationSource::Sensor) && input.is_none() {
            return Err("without [inputs] sensor".into());
        }
        let wired = with_assigned_inputs(machine);
        let compiled = match compile(&wired) {
            Ok(compiled) => compiled,
            Err(error) => return Err(error.to_string()),
        };
        let mut channels = [const { None }; TEMPERATURE_CHANNEL_COUNT];
        for (name, temperature) in wired.inputs.iter().flat_map(|inputs| &inputs.temperatures) {
            if let Some(channel) = channels.get_mut(usize::from(temperature.channel)) {
                *channel = Some(name.clone());
            }
        }
        let conditions = wired.inputs.iter().flat_map(|inputs| &inputs.conditions);
        let conditions =
            conditions.map(|(name, condition)| (name.clone(), condition.bit)).collect();
        Ok(Self { input, channels, conditions, compiled })
    }
}

/// Returns the machine with a channel for every temperature that its model uses: a prediction does not
/// need to know how they are connected.
fn with_assigned_inputs(machine: &Machine) -> Machine {
    let mut wired = machine.clone();
    let axes = machine.axes.iter().filter_map(|axis| axis.thermal.as_ref());
    let spindle = machine.spindle.temperature.iter().map(|model| &model.sensor);
    let of_terms = machine.terms.iter().filter_map(|term| term.effect.temperature_column());
    let used: Vec<String> =
        axes.map(|thermal| &thermal.sensor).chain(spindle).cloned().chain(of_terms).collect();
    let of_conditions = board_condition_columns(&wired);
    let inputs = wired.inputs.get_or_insert_with(BoardInputs::default);
    for name in of_conditions {
        if !inputs.conditions.contains_key(&name)
            && let Some(bit) = first_free_condition_bit(inputs)
        {
            inputs.conditions.insert(name, ConditionInput { bit, default: false });
        }
    }
    for name in used {
        let taken = |channel: &u8| {
            inputs.temperatures.values().any(|temperature| temperature.channel == *channel)
        };
        if !inputs.temperatures.contains_key(&name)
            && let Some(channel) = (0..=MAX_TEMPERATURE_CHANNEL).find(|channel| !taken(channel))
        {
            let input = TemperatureInput {
                channel,
                kind: TemperatureInputKind::Pt100,
                max_c_per_min: None,
            };
            inputs.temperatures.insert(name, input);
        }
    }
    wired
}

/// The board's side on its way through a run.
pub(super) struct SimulatedBridgeRun<'b> {
    bridge: &'b SimulatedBridge,
    calibration: Calibration<'b>,
    /// In the order in which the CNC sends them, each the place of its angle among A, B and C.
    angle_axes: Vec<usize>,
    rated: Rpm,
    /// The labels of tools as a run has them, with their numbers.
    codes: Vec<(f64, u16)>,
    /// When each of the terms over time starts, in the run's time.
    starts_s: Vec<f64>,
    heat: MachineThermalState,
    /// The time of the first row, and the steps taken since.
    clock: Option<(f64, u64)>,
    last_s: f64,
}

impl<'b> SimulatedBridgeRun<'b> {
    pub(super) fn new(machine: &Machine, bridge: &'b SimulatedBridge) -> Self {
        let rated = machine.spindle.warmup.as_ref().and_then(|warmup| warmup.rated_rpm);
        Self {
            bridge,
            calibration: bridge.compiled.calibration(),
            angle_axes: machine.angle_axes().iter().map(|axis| axis.index()).collect(),
            rated: to_board_rpm(rated.unwrap_or(1.0)),
            codes: machine
                .spindle
                .tools
                .iter()
                .flat_map(ToolGrowthList::numbered_label_codes)
                .collect(),
            starts_s: machine
                .terms
                .iter()
                .flat_map(|term| term.effect.board_terms())
                .filter_map(|form| match form {
                    BoardTerm::Time { start_s, .. } => Some(start_s),
                    _ => None,
                })
                .collect(),
            heat: MachineThermalState::default(),
            clock: None,
            last_s: f64::NAN,
        }
    }

    pub(super) fn step(&mut self, situation: &RowInputs<'_>) -> ErrorValues {
        self.apply_conditions(situation);
        self.step_thermal(situation);
        self.apply_conditions(situation);
        let calibration = &self.calibration;
        let reading =
            self.bridge.input.map(|input| input.reading_from_counts(situation.sensor_counts));
        let by_sensor = calibration.spindle.sensor.elongation(reading.unwrap_or_default());
        let source = calibration.spindle.chain[0];
        let plain = tip_error::source_elongation(source, by_sensor, &self.heat).to_fine();
        let operating = OperatingPoint {
            speed: situation.spindle_rpm.map(to_board_rpm),
            // A cast from f64 saturates.
            load: (situation.load_n.unwrap_or(0.0) * LOAD_UNITS_PER_NEWTON).round() as i32,
        };
        let terms = &calibration.terms;
        let elongation =
            term::apply_elongation_terms(terms, plain, self.heat.terms(), operating).rounded();
        let mut place = MachinePosition::default();
        for (n, axis) in calibration.axes.iter().enumerate() {
            // A cast from f64 saturates and takes NaN to 0; what depends on it is not shown.
            place.position[n] =
                Position((situation.position_mm[n] * POSITION_UNITS_PER_MM).round() as i32);
            place.travel[n] = ReversalTracker::new();
            let direction = if situation.direction[n] < 0.0 { -1 } else { 1 };
            place.travel[n].update(&axis.travel, place.position[n], direction);
        }
        let angle = |n: usize| {
            let degrees = self.angle_axes.get(n).map_or(0.0, |&axis| situation.angle_deg[axis]);
            MicroDegrees((degrees * f64::from(MicroDegrees::PER_DEGREE)).round() as i32)
        };
        place.angles = [angle(0), angle(1)];
        let direction = calibration.kinematics.tool_direction(place.angles);
        // Without limits: what the tick would clamp is shown unclamped.
        let axes = calibration.compute_axis_errors(&self.heat, &place).clamped_sums(UNLIMITED).sums;
        let (error, _) = tip_error::compute_tip_error(elongation, direction, axes, UNLIMITED);
        let um = |length: Nanometres| f64::from(length.0) / NM_PER_UM;
        ErrorValues {
            elongation_um: um(elongation),
            error_um: error.map(|error| um(error.rounded())),
        }
    }

    /// Takes tool, conditions and speed of the row. One that is missing counts as off; what depends on it is not shown.
    fn apply_conditions(&mut self, situation: &RowInputs<'_>) {
        let holds = |(name, _): &&(String, u8)| situation.other_column_value(name) == 1.0;
        let on = self.bridge.conditions.iter().filter(holds);
        let bits = on.fold(0, |bits, (_, bit)| bits | 1_u16.wrapping_shl((*bit).into()));
        let value = situation.other_column_value(TOOL_COLUMN);
        let of_label = self.codes.iter().find(|(code, _)| *code == value).map(|(_, code)| *code);
        // A cast from f64 saturates: a label that is not known is tool 0.
        let tool = of_label.unwrap_or(value as u16);
        self.heat.set_conditions(&self.calibration, Some(MachineConditions { tool, bits }));
        let speed = situation.spindle_rpm.map_or(self.rated, to_board_rpm);
        self.heat.update_speed(&self.calibration, speed);
    }

    /// Steps the heat up to the row, as often as the board would; a row that lacks something leaves
    /// it to the next.
    fn step_thermal(&mut self, situation: &RowInputs<'_>) {
        /// More steps than that (eleven days) leave no lag unsettled that the board can follow.
        const MAX_THERMAL_STEPS: u64 = 10_000_000;
        let temperatures: [Option<Temperature>; TEMPERATURE_CHANNEL_COUNT] =
            std::array::from_fn(|channel| {
                let name = self.bridge.channels[channel].as_ref()?;
                let units = situation.temperature_c(name) * f64::from(Temperature::PER_KELVIN);
                (!units.is_nan()).then_some(Temperature(units.round() as i32))
            });
        let speed = match situation.spindle_rpm {
            None => Some(self.rated),
            Some(speed) if speed.is_nan() => return,
            Some(speed) => Some(to_board_rpm(speed)),
        };
        if situation.time_s.is_some_and(f64::is_nan) {
            return;
        }
        let time_s = situation.time_s.unwrap_or(0.0);
        if time_s < self.last_s {
            (self.heat, self.clock) = (MachineThermalState::default(), None);
        }
        self.last_s = time_s;
        let is_first = self.clock.is_none();
        if is_first {
            self.advance_time_terms(time_s);
        }
        let (start_s, done) = self.clock.get_or_insert((time_s, 0));
        let due = ((time_s - *start_s) * 1_000.0 / f64::from(THERMAL_STEP_MS)).round() as u64;
        let steps = due.saturating_sub(*done).min(MAX_THERMAL_STEPS);
        *done = due;
        for _ in 0..steps {
            self.heat.step(&self.calibration, &temperatures, speed);
        }
        // Lags start settled; and what has none is not bound to the board's steps.
        let follows = |smoothing: SmoothingFactor| is_first || smoothing == SmoothingFactor::NO_LAG;
        let axes =
            self.calibration.axes.iter().map(|axis| axis.thermal.map(|thermal| thermal.smoothing));
        let spindle = self.calibration.spindle.temperature.map(|temperature| temperature.smoothing);
        let terms = self.calibration.terms.iter().map(|term| match term.as_ref()?.effect {
            term::Effect::Heat { smoothing, .. } | term::Effect::HeatSlope { smoothing, .. } => {
                Some(smoothing)
            }
            // It starts cold, not settled.
            term::Effect::SpeedHeat { smoothing: SmoothingFactor::NO_LAG, .. } => {
                Some(SmoothingFactor::NO_LAG)
            }
            term::Effect::Condition(it) => Some(it.smoothing),
            _ => None,
        });
        let factors = (0..).zip(axes.chain([spindle])).chain((FIRST_TERM_ITEM..).zip(terms));
        for (item, smoothing) in factors {
            if smoothing.is_some_and(follows) {
                self.heat.step_item(&self.calibration, item, &temperatures, speed);
            }
        }
    }

    /// Terms over time go on from where they are at the first row.
    fn advance_time_terms(&mut self, time_s: f64) {
        let is_timed = |term: &&Option<term::Term<'_>>| {
            term.is_some_and(|term| matches!(term.effect, term::Effect::Time { .. }))
        };
        let terms = self.calibration.terms.iter().enumerate();
        let timed = terms.filter(|(_, term)| is_timed(term)).map(|(index, _)| index);
        for (index, start_s) in timed.zip(&self.starts_s) {
            let steps = (time_s - start_s) * 1_000.0 / f64::from(THERMAL_STEP_MS);
            // A cast from f64 saturates at both ends; ten million steps settle every lag.
            let steps = (steps.round() as u32).min(10_000_000);
            self.heat.advance_time_terms(&self.calibration, index, steps);
        }
    }
}

/// Returns a speed as the board knows it.
fn to_board_rpm(speed: f64) -> Rpm {
    // Slower than half a turn a minute is still a spindle that runs.
    let rounded = if speed == 0.0 { 0.0 } else { speed.abs().round().max(1.0) };
    Rpm(rounded.min(f64::from(u16::MAX)) as u16)
}
