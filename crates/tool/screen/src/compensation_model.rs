//! The machine's laws applied to what is received: the sensor's voltage, and which cause has which share in
//! the offset. The laws are those of a machine file, or of the calibration that the board itself gives.

use std::{borrow::Cow, collections::BTreeMap, path::Path};

use trueup_client::cnc::CncState;
use trueup_machine::{
    InputFileError, Machine, MachineFile,
    compile::{compile, decompile},
    model::{
        ErrorComponents, ReferenceModel, RowInputs, apply_constant_terms, required_columns,
        sensor_counts_from_elongation,
    },
    tool_column::TOOL_COLUMN,
};
use trueup_store::calibration::{calibration_crc, decode};

/// The laws of a machine, on their way through what is received.
pub(crate) struct CompensationModel {
    machine: Machine,
    model: ReferenceModel<'static>,
    crc: Option<u32>,
    /// The counts are the machine file's own; a calibration knows ADC codes alone.
    has_counts: bool,
}

/// A reading of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SensorReading {
    /// At the sensor, before the divider, in V.
    pub volts: f64,
    /// Of the ADC, 0…4095, with fractions, because the board averages.
    pub codes: f64,
    /// In the unit of the machine file; `None` where only the board is known.
    pub counts: Option<f64>,
}

/// The share of one cause in the offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OffsetContribution {
    /// The cause, in the user's words.
    pub name: &'static str,
    /// On X, Y and Z in µm, what the CNC has to add; NaN where something is not known that it depends on.
    pub offset_um: [f64; 3],
}

/// The received values at a moment.
pub(crate) struct LiveValues<'a> {
    /// Since the screen began, in s.
    pub time_s: f64,
    /// By the sensor, in µm.
    pub growth_um: Option<f64>,
    /// By channel, in 0.01 °C.
    pub centi_c: &'a [Option<i16>],
    /// The CNC, where it can be received.
    pub cnc: &'a CncState,
}

impl CompensationModel {
    /// Those of the machine file at `path`.
    ///
    /// # Errors
    /// The file cannot be read, or is wrong at a place that the error names.
    pub fn read(path: &Path) -> Result<Self, InputFileError> {
        Ok(Self::from_machine(MachineFile::read(path)?))
    }

    /// Those of a machine.
    #[must_use]
    pub fn from_machine(machine: Machine) -> Self {
        let crc = compile(&machine).ok().map(|compiled| compiled.crc());
        let machine = machine.with_only_compensated_terms().into_owned();
        let model = ReferenceModel::from_owned(machine.clone());
        let machine = apply_constant_terms(Cow::Owned(machine)).0.into_owned();
        Self { machine, model, crc, has_counts: true }
    }

    /// Those of the calibration that a board has given; `None`: it is none.
    #[must_use]
    pub(crate) fn from_board_blob(blob: &[u8]) -> Option<Self> {
        let machine = decompile(&decode(blob).ok()?);
        Some(Self {
            crc: Some(calibration_crc(blob)),
            has_counts: false,
            ..Self::from_machine(machine)
        })
    }

    /// Returns what the machine is called.
    #[must_use]
    pub fn machine_name(&self) -> &str {
        &self.machine.name
    }

    /// CRC of the calibration of these laws; `None` where they cannot be compiled.
    #[must_use]
    pub fn crc(&self) -> Option<u32> {
        self.crc
    }

    /// Returns what the sensor gives at this growth in µm; `None` where the board runs no law of a sensor.
    #[must_use]
    pub(crate) fn sensor_reading_from_elongation(&self, growth_um: f64) -> Option<SensorReading> {
        let input = self.machine.inputs.as_ref()?.sensor?;
        let counts = sensor_counts_from_elongation(self.machine.board_sensor_model()?, growth_um);
        Some(SensorReading {
            volts: input.volts_from_counts(counts),
            codes: input.codes_from_counts(counts),
            counts: self.has_counts.then_some(counts),
        })
    }

    /// Returns the names of the temperatures by channel, without `temp_` and `_c`.
    #[must_use]
    pub(crate) fn temperature_names(&self) -> BTreeMap<u8, &str> {
        let inputs = self.machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
        let name = |name: &'_ str| -> Option<(usize, usize)> {
            name.starts_with("temp_").then_some(("temp_".len(), name.len() - "_c".len()))
        };
        inputs
            .map(|(column, input)| {
                let shown = name(column).and_then(|(from, to)| column.get(from..to));
                (input.channel, shown.unwrap_or(column))
            })
            .collect()
    }

    /// Returns the tool and the conditions that these laws depend on, by their names, as the CNC says them now; NaN: it
    /// does not say.
    #[must_use]
    pub fn conditions(&self, cnc: &CncState, now_ms: u64) -> Vec<(String, f64)> {
        let sent_conditions = cnc.conditions(now_ms);
        let inputs = self.machine.inputs.iter().flat_map(|inputs| &inputs.conditions);
        let value = |value: Option<u16>| value.map_or(f64::NAN, f64::from);
        let tool =
            (TOOL_COLUMN.to_string(), value(sent_conditions.map(|conditions| conditions.tool)));
        let conditions = inputs.map(|(name, condition)| {
            (name.clone(), value(sent_conditions.map(|all| all.is_set(condition.bit).into())))
        });
        let needed = required_columns(&self.machine);
        std::iter::once(tool).chain(conditions).filter(|(name, _)| needed.contains(name)).collect()
    }

    /// Returns the share of each cause that the machine has.
    pub(crate) fn offset_contributions(
        &mut self,
        moment: &LiveValues<'_>,
    ) -> Vec<OffsetContribution> {
        let channels = self.machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
        let temperatures_c: Vec<(String, f64)> = channels
            .map(|(name, input)| {
                let centi_c = moment.centi_c.get(usize::from(input.channel)).copied().flatten();
                (name.clone(), centi_c.map_or(f64::NAN, |centi_c| f64::from(centi_c) / 100.0))
            })
            .collect();
        let temperatures_c: Vec<(&str, f64)> = temperatures_c
            .iter()
            .map(|(name, temperature)| (name.as_str(), *temperature))
            .collect();
        // The CNC's frames are stamped with the same clock.
        let now_ms = (moment.time_s * 1_000.0) as u64;
        let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let mut angle_deg = [f64::NAN; 3];
        for (axis, angle) in
            self.machine.angle_axes().into_iter().zip(moment.cnc.rotary_angles_deg(now_ms))
        {
            angle_deg[axis.index()] = known(angle);
        }
        let sensor = self.machine.board_sensor_model();
        let conditions = self.conditions(moment.cnc, now_ms);
        let others: Vec<(&str, f64)> =
            conditions.iter().map(|(name, condition)| (name.as_str(), *condition)).collect();
        let parts = self.model.step(&RowInputs {
            time_s: Some(moment.time_s),
            sensor_counts: match (sensor, moment.growth_um) {
                (Some(sensor), Some(um)) => sensor_counts_from_elongation(sensor, um),
                _ => f64::NAN,
            },
            spindle_rpm: moment.cnc.spindle_rpm(now_ms).or(Some(f64::NAN)),
            load_n: moment.cnc.load_n(now_ms).or(Some(f64::NAN)),
            temperatures_c: &temperatures_c,
            position_mm: moment.cnc.position_mm(now_ms).map(known),
            direction: moment.cnc.direction(now_ms).map(known),
            others: &others,
            angle_deg,
            ..RowInputs::UNKNOWN
        });
        self.label_contributions(&parts)
    }

    fn label_contributions(&self, parts: &ErrorComponents) -> Vec<OffsetContribution> {
        let machine = &self.machine;
        let any_axis = |has: fn(&trueup_machine::machine_file::AxisModel) -> bool| {
            machine.axes.iter().any(has)
        };
        [
            ("spindle growth", machine.has_elongation(), parts.tool_um),
            ("axis heat", any_axis(|axis| axis.thermal.is_some()), parts.thermal_um),
            ("pitch", any_axis(|axis| axis.pitch.is_some()), parts.pitch_um),
            ("backlash", any_axis(|axis| axis.backlash.is_some()), parts.backlash_um),
            ("straightness", !machine.straightness.is_empty(), parts.straightness_um),
            ("squareness", !machine.squareness.is_empty(), parts.squareness_um),
            (
                "angular and rotary errors",
                machine.volume.has_geometric_errors(),
                parts.volumetric_error_um,
            ),
            ("found causes", !machine.terms.is_empty(), parts.terms_um),
        ]
        .into_iter()
        .filter(|(_, has, _)| *has)
        .map(|(name, _, error_um)| OffsetContribution {
            name,
            offset_um: error_um.map(|um| 0.0 - um),
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAPER: &str = include_str!("../../../../data/paper_spindle.toml");
    const GANTRY: &str = include_str!("../../../../data/gantry.toml");

    fn laws(text: &str) -> CompensationModel {
        CompensationModel::from_machine(
            MachineFile::parse(text, Path::new("m.toml")).expect("the project's own file"),
        )
    }

    fn moment(growth_um: Option<f64>, cnc: &CncState) -> LiveValues<'_> {
        LiveValues { time_s: 1.0, growth_um, centi_c: &[None; 8], cnc }
    }

    #[test]
    fn the_papers_zero_is_5048_counts_627_codes_and_1_54_volts() {
        let reading = laws(PAPER).sensor_reading_from_elongation(0.0).expect("it has a sensor");
        // 5048 of 32768 counts of 4096 codes, of which 10 V behind the divider are 3.28 of 3.3.
        let codes = 631.0 * 3.28 / 3.3;
        assert_eq!(reading.counts, Some(5048.0));
        assert!((reading.codes - codes).abs() < 1e-9, "{reading:?}");
        assert!((reading.volts - 5048.0 / 3276.8).abs() < 1e-12);
        // The board's own calibration knows the codes and not the counts.
        let blob = compile(&laws(PAPER).machine).expect("it fits").blob().to_vec();
        let board = CompensationModel::from_board_blob(&blob).expect("a calibration");
        let same = board.sensor_reading_from_elongation(0.0).expect("it has a sensor");
        assert!((same.codes - codes).abs() < 0.01 && same.counts.is_none(), "{same:?}");
        assert_eq!((board.crc(), board.machine_name()), (laws(PAPER).crc(), "paper"));
        assert!(CompensationModel::from_board_blob(&blob[1..]).is_none());
    }

    #[test]
    fn a_tool_that_grows_is_lifted() {
        let cnc = CncState::default();
        let shares = laws(PAPER).offset_contributions(&moment(Some(12.5), &cnc));
        let [growth] = &shares[..] else { panic!("{shares:?}") };
        assert_eq!(growth.name, "spindle growth");
        assert_eq!(growth.offset_um.map(|um| (um * 1e6).round() / 1e6), [0.0, 0.0, 12.5]);
        // Without a reading nothing is known of it, and nothing is shown.
        let shares = laws(PAPER).offset_contributions(&moment(None, &cnc));
        assert!(shares[0].offset_um[2].is_nan());
    }

    /// Tool 7 grows by 0.02 µm for (1000 r/min)², and X moves by 3 µm while the coolant is on.
    #[test]
    fn what_depends_on_tool_and_conditions_is_by_what_the_cnc_says_of_them() {
        use trueup_core::{
            cnc::{MachineConditions, SpindleState},
            units::Rpm,
        };
        use trueup_link::frames;
        let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
             [inputs]\ncoolant_on = { kind = \"condition\", bit = 9 }\ndoor = { kind = \"condition\", bit = 1 }\n\
             [spindle.tools]\n7 = { um_per_krpm2 = 0.02 }\ndefault = { um_per_krpm2 = 0.0 }\n\
             [[term]]\ncause = \"dependence\"\nquantity = \"dx\"\ncolumn = \"coolant_on\"\nform = \"level\"\n\
             levels = [0.0, 1.0]\nlevel_um = [0.0, 3.0]\n";
        let (mut laws, mut cnc) = (laws(text), CncState::default());
        let names = |laws: &CompensationModel, cnc: &CncState| laws.conditions(cnc, 1_000);
        assert!(names(&laws, &cnc).iter().all(|(_, value)| value.is_nan()), "they were never sent");
        let sum = |laws: &mut CompensationModel, cnc: &CncState| -> [f64; 3] {
            let shares = laws.offset_contributions(&moment(None, cnc));
            let sum = |axis: usize| shares.iter().map(|share| share.offset_um[axis]).sum::<f64>();
            [0, 1, 2].map(|axis| (sum(axis) * 1e6).round() / 1e6)
        };
        let unknown = sum(&mut laws, &cnc);
        assert!(unknown[0].is_nan() && unknown[2].is_nan(), "{unknown:?}");
        cnc.receive(
            &frames::encode_spindle(SpindleState { speed: Rpm(20_000), load_n: 0 }, 0),
            1_000,
        );
        cnc.receive(
            &frames::encode_conditions(MachineConditions { tool: 7, bits: 1 << 9 }, 0),
            1_000,
        );
        assert_eq!(names(&laws, &cnc), [("tool".into(), 7.0), ("coolant_on".into(), 1.0)]);
        assert_eq!(sum(&mut laws, &cnc), [-3.0, 0.0, 8.0]);
    }

    #[test]
    fn what_needs_a_position_that_is_not_received_is_not_known() {
        let cnc = CncState::default();
        let shares = laws(GANTRY).offset_contributions(&moment(None, &cnc));
        let straight =
            shares.iter().find(|share| share.name == "straightness").expect("it has curves");
        assert!(straight.offset_um.iter().any(|um| um.is_nan()), "{straight:?}");
    }
}
