//! The board's own code next to the model, at one moment after the other.

use trueup_core::{
    calibration::Calibration,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    machine_position::MachinePosition,
    reversal::ReversalTracker,
    thermal_state::MachineThermalState,
    units::{FineNanometres, MicroDegrees, Nanometres, Position, Rpm, SensorReading, Temperature},
};
use trueup_machine::{
    CompiledCalibration, Machine,
    machine_file::ElongationSource,
    model::{ReferenceModel, RowInputs},
};

use crate::gantry::*;

/// The bound on the sum of all parts.
pub const BOUND_NM: f64 = 10.0;

/// The inputs that do not depend on the position: one moment of temperatures, sensor and angles.
pub struct Moment {
    time_s: f64,
    reading: SensorReading,
    rpm: u16,
    temperatures: [Option<Temperature>; TEMPERATURE_CHANNEL_COUNT],
    angles: [MicroDegrees; 2],
}

impl Moment {
    pub fn random(random: &mut Random, time_s: f64) -> Self {
        let mut temperatures = [None; TEMPERATURE_CHANNEL_COUNT];
        for temperature in temperatures.iter_mut().take(COLUMNS.len()) {
            let celsius = random.uniform(5.0, 50.0);
            *temperature = Some(Temperature((celsius * UNITS_PER_C).round() as i32));
        }
        let angle =
            |random: &mut Random| MicroDegrees(random.below(720_000_001) as i32 - 360_000_000);
        Self {
            time_s,
            reading: SensorReading(random.below(4_096 << 10) as i32),
            rpm: [0, 24_000, random.below(30_001) as u16][random.below(3) as usize],
            temperatures,
            angles: [angle(random), angle(random)],
        }
    }
}

/// Both sides of the comparison.
pub struct Bench<'m> {
    pub machine: &'m Machine,
    pub calibration: Calibration<'m>,
    pub reference: ReferenceModel<'m>,
    pub heat: MachineThermalState,
    pub worst: Worst,
}

/// The largest difference with its inputs.
#[derive(Clone, Debug, Default)]
pub struct Worst {
    pub nm: f64,
    pub inputs: String,
}

impl Worst {
    pub fn or(self, other: Self) -> Self {
        if other.nm > self.nm { other } else { self }
    }
}

impl<'m> Bench<'m> {
    pub fn new(machine: &'m Machine, compiled: &'m CompiledCalibration) -> Self {
        let calibration = compiled.calibration();
        let (reference, heat) = (ReferenceModel::new(machine), MachineThermalState::default());
        Self { machine, calibration, reference, heat, worst: Worst::default() }
    }

    pub fn warms_up(&self) -> bool {
        self.machine.spindle.source == Some(ElongationSource::Warmup)
    }

    /// Goes on to another moment: lags settle there, the warm-up takes its `steps` of 100 ms.
    pub fn go_to(&mut self, moment: &Moment, steps: u32) {
        if !self.warms_up() {
            self.heat = MachineThermalState::default();
            self.reference = ReferenceModel::new(self.machine);
        }
        for _ in 0..steps {
            self.heat.step(&self.calibration, &moment.temperatures, Some(Rpm(moment.rpm)));
        }
    }

    pub fn board_nm(&self, moment: &Moment, position: [i32; 3], reverse: [bool; 3]) -> [i32; 3] {
        let mut place = MachinePosition::default();
        for axis in 0..3 {
            place.position[axis] = Position(position[axis]);
            let direction = if reverse[axis] { -1 } else { 1 };
            let config = &self.calibration.axes[axis].travel;
            place.travel[axis] = ReversalTracker::new();
            place.travel[axis].update(config, Position(position[axis]), direction);
        }
        let elongation = match self.machine.spindle.source {
            Some(ElongationSource::Sensor) => {
                self.calibration.spindle.sensor.elongation(moment.reading)
            }
            Some(ElongationSource::Temperature) => self.heat.temperature_elongation(),
            Some(ElongationSource::Warmup) => self.heat.warmup_elongation(),
            None => Nanometres::ZERO,
        };
        let tool = self
            .calibration
            .kinematics
            .tool_direction(moment.angles)
            .project_elongation_fine(elongation);
        let errors = self.calibration.compute_axis_errors(&self.heat, &place);
        std::array::from_fn(|axis| {
            let parts = errors.axes[axis];
            let sum = parts
                .thermal
                .saturating_add(parts.positioning)
                .saturating_add(parts.guides)
                .saturating_add(tool[axis]);
            assert!(
                sum != FineNanometres(i32::MAX) && sum != FineNanometres(i32::MIN),
                "the test leaves the range"
            );
            sum.rounded().0
        })
    }

    pub fn model_nm(
        &mut self,
        moment: &Moment,
        position: [i32; 3],
        reverse: [bool; 3],
    ) -> [f64; 3] {
        let celsius = |channel: usize| {
            f64::from(moment.temperatures[channel].expect("all of them are there").0) / UNITS_PER_C
        };
        let temperatures: [(&str, f64); 4] =
            std::array::from_fn(|channel| (COLUMNS[channel], celsius(channel)));
        let [c, a] = moment.angles.map(|angle| f64::from(angle.0) / 1e6);
        let situation = RowInputs {
            time_s: Some(moment.time_s),
            run: None,
            // A count of the paper's chain is an eighth of a code, 128 reading units.
            sensor_counts: f64::from(moment.reading.0) / 128.0,
            spindle_rpm: Some(moment.rpm.into()),
            load_n: None,
            feed_mm_per_min: f64::NAN,
            temperatures_c: &temperatures,
            others: &[],
            position_mm: position.map(|units| f64::from(units) / UNITS_PER_MM),
            angle_deg: [a, f64::NAN, c],
            direction: reverse.map(|reverse| if reverse { -1.0 } else { 1.0 }),
            tool_length_mm: None,
        };
        self.reference.step(&situation).error_um().map(|um| um * 1_000.0)
    }

    pub fn compare(&mut self, moment: &Moment, position: [i32; 3], reverse: [bool; 3]) {
        let board = self.board_nm(moment, position, reverse);
        let model = self.model_nm(moment, position, reverse);
        for axis in 0..3 {
            let nm = (f64::from(board[axis]) - model[axis]).abs();
            if nm.is_nan() || nm > self.worst.nm {
                assert!(nm <= BOUND_NM, "{nm} nm at {position:?} {reverse:?}");
                let name = ["X", "Y", "Z"][axis];
                let inputs = format!(
                    "error of {name}: board {} nm, model {:.3} nm at {position:?} ·10 nm, reverse \
                     {reverse:?}, {:?}, {:?}, {} r/min, angles C A {:?}, {:?}, {:.1} s",
                    board[axis],
                    model[axis],
                    &moment.temperatures[..4],
                    moment.reading,
                    moment.rpm,
                    moment.angles,
                    self.machine.spindle.source,
                    moment.time_s
                );
                self.worst = Worst { nm, inputs };
            }
        }
    }

    /// Both sides at random, a new moment after every `stay` points.
    pub fn sweep(&mut self, random: &mut Random, count: u32, stay: u32) {
        // The model's first row is where its time starts; the board's first step follows.
        self.model_nm(&Moment::random(random, 0.0), [0; 3], [false; 3]);
        let mut moment = Moment::random(random, 0.1);
        self.go_to(&moment, 1);
        for n in 0..count {
            if n % stay == 0 && n > 0 {
                let steps = if self.warms_up() { 1 + random.below(3_000) } else { 1 };
                moment = Moment::random(random, moment.time_s + f64::from(steps) * 0.1);
                self.go_to(&moment, steps);
            }
            let (position, reverse) = anywhere(random);
            self.compare(&moment, position, reverse);
        }
    }
}

/// Positions to 4 % outside of the travel, and directions.
pub fn anywhere(random: &mut Random) -> ([i32; 3], [bool; 3]) {
    let position = TRAVEL_MM
        .map(|travel| (random.uniform(-0.04, 1.04) * travel * UNITS_PER_MM).round() as i32);
    (position, [(); 3].map(|()| random.below(2) == 1))
}
