//! The fixed part of a blob as records, and what core makes of them.

use trueup_core::{
    calibration::{
        AxisModel, AxisThermalModel, Calibration, DualDrive, ElongationSource, InputSettings,
        MachineIdentity, SpindleModel, SpindleTemperatureModel, SpindleWarmupModel,
    },
    cnc::LinearAxis,
    curve::Curve,
    design_parameters::TEMPERATURE_CHANNEL_COUNT,
    displacement_sensor::SensorLaw,
    gradient::Gradient,
    kinematics::Kinematics,
    lag::SmoothingFactor,
    learned_changes::LearnedLimits,
    limits::CompensationLimits,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal::{self, Interval},
    thermal::ThermalExpansionLaw,
    tool_direction::ToolDirection,
    units::{FineNanometres, Position},
    warmup::WarmupModel,
};

use super::{
    blob_codec::{Field, record},
    blob_fields::{
        BoundedU32, ColdTolerance, HeadAxesAndLearnedLimits, MaxOffset, OptionalChannel,
        RejoinAndSwitches, SourceChainAndLearnedLimit, Text, ThermometerAndRateLimit,
    },
    blob_format::{
        FIXED_PART_SIZE, HEADER_SIZE, MAX_HOLD_MS, MAX_LINK_TIMEOUT_MS, MAX_SLEW_NM_PER_S,
    },
    terms::TermsAndVolumetricErrors,
};

record! {
    /// All that follows the mark, the schema and the length.
    FixedPart<'b> {
        max_offsets: [MaxOffset; 3],
        slew_nm_per_s: BoundedU32<MAX_SLEW_NM_PER_S>,
        link_timeout_ms: BoundedU32<MAX_LINK_TIMEOUT_MS>,
        hold_ms: BoundedU32<MAX_HOLD_MS>,
        tool_direction: ToolDirection,
        head_axes: HeadAxesAndLearnedLimits,
        chain: SourceChainAndLearnedLimit,
        sensor: SensorLaw,
        spindle_channel: OptionalChannel,
        spindle_smoothing: SmoothingFactor,
        spindle_law: ThermalExpansionLaw<'b>,
        warmup: WarmupModel,
        power: Curve<'b>,
        thermometers: [ThermometerAndRateLimit; TEMPERATURE_CHANNEL_COUNT],
        axes: [AxisRecord<'b>; 3],
        straightness: [Curve<'b>; 6],
        squareness: [Gradient; 6],
        spindle_smoothing_falling: SmoothingFactor,
        terms: TermsAndVolumetricErrors<'b>,
        rejoin: RejoinAndSwitches,
        cold_within: ColdTolerance,
        board: [u32; 3],
        machine_name: Text<'b>,
        machine_serial: Text<'b>,
    }
}
const _: () = assert!(FixedPart::SIZE + HEADER_SIZE == FIXED_PART_SIZE);

record! {
    /// A linear axis.
    AxisRecord<'b> {
        channel: OptionalChannel,
        smoothing: SmoothingFactor,
        origin: Position,
        law: ThermalExpansionLaw<'b>,
        pitch: Option<PitchErrorTable<'b>>,
        /// Without it the axis has one drive.
        across: Option<LinearAxis>,
        drives: [Position; 2],
        second_pitch: Option<PitchErrorTable<'b>>,
        backlash: FineNanometres,
        hysteresis: u32,
        ramp: Interval,
        smoothing_falling: SmoothingFactor,
        /// 0 in a blob from before it was known: not judged.
        rapid: u32,
    }
}
const _: () = assert!(AxisRecord::SIZE == 80);

impl<'b> FixedPart<'b> {
    pub(crate) fn from_calibration(calibration: &Calibration<'b>) -> Self {
        let Calibration {
            thermometers,
            spindle: SpindleModel { chain, sensor, temperature, warmup },
            kinematics: Kinematics { zero, axes: head_axes },
            axes,
            straightness,
            squareness,
            volume,
            terms,
            limits:
                CompensationLimits {
                    max,
                    slew_nm_per_s,
                    link_timeout_ms,
                    hold_ms,
                    rejoin_nm_per_s,
                    learned,
                },
            cold_within,
            guards: InputSettings { max_rates, service_switch, mains },
            names: MachineIdentity { machine, serial, board },
        } = *calibration;
        let none = SmoothingFactor(0);
        let never = WarmupModel {
            lag_ms: 0,
            max: FineNanometres::ZERO,
            smoothing_heating: none,
            smoothing_cooling: none,
            full: 0,
        };
        Self {
            max_offsets: max.map(MaxOffset),
            slew_nm_per_s: BoundedU32(slew_nm_per_s),
            link_timeout_ms: BoundedU32(link_timeout_ms),
            hold_ms: BoundedU32(hold_ms),
            tool_direction: zero,
            head_axes: HeadAxesAndLearnedLimits(head_axes, [learned.growth, learned.axes]),
            chain: SourceChainAndLearnedLimit(chain, learned.zero),
            sensor,
            spindle_channel: OptionalChannel(temperature.map(|temperature| temperature.channel)),
            spindle_smoothing: temperature.map_or(none, |temperature| temperature.smoothing),
            spindle_law: temperature.map(|temperature| temperature.law).unwrap_or_default(),
            warmup: warmup.map_or(never, |warmup| warmup.law),
            power: warmup.map(|warmup| warmup.power).unwrap_or_default(),
            thermometers: core::array::from_fn(|channel| {
                let connected = thermometers.get(channel).copied().flatten();
                ThermometerAndRateLimit(
                    connected,
                    max_rates.get(channel).copied().unwrap_or_default(),
                )
            }),
            axes: axes.map(AxisRecord::from_axis_model),
            straightness,
            squareness,
            spindle_smoothing_falling: temperature
                .map_or(none, |temperature| temperature.smoothing_falling),
            terms: TermsAndVolumetricErrors(terms, volume),
            rejoin: RejoinAndSwitches(rejoin_nm_per_s, service_switch, mains),
            cold_within: ColdTolerance(cold_within),
            board,
            machine_name: Text(machine),
            machine_serial: Text(serial),
        }
    }

    pub(crate) fn into_calibration(self) -> Calibration<'b> {
        let Self { chain: SourceChainAndLearnedLimit(chain, zero), warmup: law, power, .. } = self;
        let HeadAxesAndLearnedLimits(head_axes, [growth, axes]) = self.head_axes;
        let has_warmup =
            law.max != FineNanometres::ZERO || chain.contains(&Some(ElongationSource::Warmup));
        let temperature = self.spindle_channel.0.map(|channel| SpindleTemperatureModel {
            channel,
            smoothing: self.spindle_smoothing,
            smoothing_falling: self.spindle_smoothing_falling,
            law: self.spindle_law,
        });
        Calibration {
            thermometers: self.thermometers.each_ref().map(|thermometer| thermometer.0),
            spindle: SpindleModel {
                chain,
                sensor: self.sensor,
                temperature,
                warmup: has_warmup.then_some(SpindleWarmupModel { law, power }),
            },
            kinematics: Kinematics { zero: self.tool_direction, axes: head_axes },
            axes: self.axes.map(AxisRecord::into_axis_model),
            straightness: self.straightness,
            squareness: self.squareness,
            terms: self.terms.0,
            volume: self.terms.1,
            limits: CompensationLimits {
                max: self.max_offsets.map(|max| max.0),
                slew_nm_per_s: self.slew_nm_per_s.0,
                link_timeout_ms: self.link_timeout_ms.0,
                hold_ms: self.hold_ms.0,
                rejoin_nm_per_s: self.rejoin.0,
                learned: LearnedLimits { growth, axes, zero },
            },
            cold_within: self.cold_within.0,
            guards: InputSettings {
                max_rates: self.thermometers.map(|thermometer| thermometer.1),
                service_switch: self.rejoin.1,
                mains: self.rejoin.2,
            },
            names: MachineIdentity {
                machine: self.machine_name.0,
                serial: self.machine_serial.0,
                board: self.board,
            },
        }
    }
}

impl<'b> AxisRecord<'b> {
    fn from_axis_model(axis: AxisModel<'b>) -> Self {
        let AxisModel { thermal, pitch, dual, backlash, travel, rapid } = axis;
        let none = SmoothingFactor(0);
        Self {
            channel: OptionalChannel(thermal.map(|thermal| thermal.channel)),
            smoothing: thermal.map_or(none, |thermal| thermal.smoothing),
            origin: thermal.map(|thermal| thermal.origin).unwrap_or_default(),
            law: thermal.map(|thermal| thermal.law).unwrap_or_default(),
            pitch,
            across: dual.map(|dual| dual.across),
            drives: dual.map(|dual| dual.beam.drive_positions()).unwrap_or_default(),
            second_pitch: dual.map(|dual| dual.pitch),
            backlash,
            hysteresis: travel.hysteresis,
            ramp: travel.ramp,
            smoothing_falling: thermal.map_or(none, |thermal| thermal.smoothing_falling),
            rapid,
        }
    }

    fn into_axis_model(self) -> AxisModel<'b> {
        let [first, second] = self.drives;
        AxisModel {
            thermal: self.channel.0.map(|channel| AxisThermalModel {
                channel,
                smoothing: self.smoothing,
                smoothing_falling: self.smoothing_falling,
                origin: self.origin,
                law: self.law,
            }),
            pitch: self.pitch,
            dual: self.across.zip(self.second_pitch).map(|(across, pitch)| DualDrive {
                across,
                beam: GantryBeam::new(first, second),
                pitch,
            }),
            backlash: self.backlash,
            travel: reversal::ReversalConfig { hysteresis: self.hysteresis, ramp: self.ramp },
            rapid: self.rapid,
        }
    }
}
