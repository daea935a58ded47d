//! Machines drawn at random: any calibration, also one that no machine file gives.

use proptest::{prelude::*, sample::select};
use trueup_core::{
    calibration::{
        AxisModel, AxisThermalModel, Calibration, DualDrive, ElongationSource, MachineIdentity,
        SpindleModel, SpindleTemperatureModel, SpindleWarmupModel,
    },
    cnc::LinearAxis,
    curve::{Curve, CurveSegment},
    design_parameters::{MAX_TERMS, TEMPERATURE_CHANNEL_COUNT},
    displacement_sensor::{SensorLaw, SensorSlope},
    fixed_point::ScaledCoefficient,
    gradient::Gradient,
    kinematics::{self, Kinematics},
    lag::SmoothingFactor,
    limits::CompensationLimits,
    pitch_table::{GantryBeam, PitchErrorTable},
    reversal::{Interval, ReversalConfig},
    term::{Effect, SpeedExponent, Target, Term},
    thermal::{ThermalExpansionLaw, ThermalLawSegment},
    thermometer::Thermometer,
    tool_direction::ToolDirection,
    units::{FineNanometres, Nanometres, Position, SensorReading, Temperature},
    warmup,
};

/// Any number, and often one at an end or near 0.
pub fn number() -> BoxedStrategy<i32> {
    prop_oneof![
        Just(i32::MIN),
        Just(i32::MAX),
        Just(0),
        -1_000..1_000_i32,
        -10_000_000..10_000_000_i32,
        any::<i32>()
    ]
    .boxed()
}

/// Returns the same from 0.
pub fn size() -> BoxedStrategy<u32> {
    prop_oneof![Just(0), Just(u32::MAX), 1..3_000_u32, 1..10_000_000_u32, any::<u32>()].boxed()
}

pub fn numbers<const N: usize>() -> impl Strategy<Value = [i32; N]> {
    prop::array::uniform(number())
}

/// A curve's first knot, segments and index; nothing of it need fit together.
#[derive(Clone, Debug)]
struct OwnedCurve {
    first: i32,
    segments: Vec<[u8; 20]>,
    index: Vec<[u8; 2]>,
    bucket_shift: u8,
}

impl OwnedCurve {
    fn any() -> BoxedStrategy<Self> {
        let segment = (numbers::<5>(), 0..32_u8).prop_map(|([end, c @ ..], shift)| {
            CurveSegment::new(Position(end), shift, c).to_bytes()
        });
        let index = (0..5_u16).prop_map(u16::to_le_bytes);
        let parts = (
            number(),
            prop::collection::vec(segment, 0..4),
            prop::collection::vec(index, 0..4),
            0..40_u8,
        );
        parts
            .prop_map(|(first, segments, index, bucket_shift)| Self {
                first,
                segments,
                index,
                bucket_shift,
            })
            .boxed()
    }

    fn curve(&self) -> Curve<'_> {
        Curve::new(Position(self.first), &self.segments, &self.index, self.bucket_shift)
    }
}

#[derive(Clone, Debug)]
struct OwnedPitch {
    start: i32,
    step: u32,
    forward: Vec<[u8; 4]>,
    reverse: Option<Vec<[u8; 4]>>,
}

impl OwnedPitch {
    fn any() -> BoxedStrategy<Self> {
        let points = || prop::collection::vec(number().prop_map(i32::to_le_bytes), 0..4);
        (number(), size(), points(), prop::option::of(points()))
            .prop_map(|(start, step, forward, reverse)| Self { start, step, forward, reverse })
            .boxed()
    }

    fn pitch(&self) -> PitchErrorTable<'_> {
        PitchErrorTable {
            start: Position(self.start),
            step: Interval::new(self.step),
            forward: &self.forward,
            reverse: self.reverse.as_deref(),
        }
    }
}

type OwnedLaw = Vec<[u8; 20]>;

fn law() -> BoxedStrategy<OwnedLaw> {
    let piece = numbers::<5>().prop_map(|[start, constant, slope, gradient, gradient_slope]| {
        ThermalLawSegment {
            start: Temperature(start),
            constant: FineNanometres(constant),
            constant_slope: slope,
            gradient: Gradient(gradient),
            gradient_slope,
        }
        .to_bytes()
    });
    prop::collection::vec(piece, 0..3).boxed()
}

/// The parts of one axis: its law with channel and smoothing, both tables, numbers for the rest.
#[derive(Clone, Debug)]
struct OwnedAxis {
    thermal: Option<(u8, u32, OwnedLaw)>,
    pitch: Option<OwnedPitch>,
    dual: Option<(LinearAxis, OwnedPitch)>,
    numbers: [i32; 4],
    sizes: [u32; 2],
}

impl OwnedAxis {
    fn any() -> BoxedStrategy<Self> {
        let parts = (
            prop::option::of((channel(), any::<u32>(), law())),
            prop::option::of(OwnedPitch::any()),
            prop::option::of((select(&LinearAxis::ALL), OwnedPitch::any())),
            numbers(),
            prop::array::uniform(size()),
        );
        parts
            .prop_map(|(thermal, pitch, dual, numbers, sizes)| Self {
                thermal,
                pitch,
                dual,
                numbers,
                sizes,
            })
            .boxed()
    }

    fn axis(&self) -> AxisModel<'_> {
        let [origin, backlash, first, second] = self.numbers;
        AxisModel {
            thermal: self.thermal.as_ref().map(|(channel, smoothing, pieces)| AxisThermalModel {
                channel: *channel,
                smoothing: SmoothingFactor(*smoothing),
                smoothing_falling: SmoothingFactor(smoothing.rotate_left(7)),
                origin: Position(origin),
                law: ThermalExpansionLaw { pieces },
            }),
            pitch: self.pitch.as_ref().map(OwnedPitch::pitch),
            dual: self.dual.as_ref().map(|(across, pitch)| DualDrive {
                across: *across,
                beam: GantryBeam::new(Position(first), Position(second)),
                pitch: pitch.pitch(),
            }),
            backlash: FineNanometres(backlash),
            travel: ReversalConfig {
                hysteresis: self.sizes[0],
                ramp: Interval::new(self.sizes[1]),
            },
            // From none to any.
            rapid: self.sizes[0].rotate_left(16),
        }
    }
}

/// Mostly a channel of the board.
fn channel() -> impl Strategy<Value = u8> {
    prop_oneof![20 => 0..4_u8, 1 => any::<u8>()]
}

/// A calibration that owns its tables.
#[derive(Clone, Debug)]
pub struct Machine {
    thermometers: [Option<Thermometer>; TEMPERATURE_CHANNEL_COUNT],
    chain: [Option<ElongationSource>; 3],
    sensor: [i32; 3],
    temperature: Option<(u8, u32, OwnedLaw)>,
    warmup: Option<(u32, [i32; 2], [u32; 2], OwnedCurve)>,
    zero: [i32; 3],
    rotary: [Option<kinematics::RotaryAxis>; 2],
    axes: [OwnedAxis; 3],
    straightness: [OwnedCurve; 6],
    squareness: [i32; 6],
    terms: Vec<Term<'static>>,
    pub limits: CompensationLimits,
}

/// Returns a term of a diagnosis, of every kind that needs no table.
fn term() -> BoxedStrategy<Term<'static>> {
    let target =
        prop_oneof![Just(Target::Elongation), select(&LinearAxis::ALL).prop_map(Target::Axis)];
    let scaled =
        (number(), 0..70_u8).prop_map(|(mantissa, shift)| ScaledCoefficient { mantissa, shift });
    let parts = (scaled, numbers::<2>(), channel(), any::<u32>(), select(&LinearAxis::ALL), 0..14);
    let effect = parts.prop_map(|(m, [a, b], channel, smoothing, axis, kind)| match kind {
        0 => Effect::Offset,
        1 => Effect::Gain(m),
        2 => Effect::Curvature(m),
        3 => Effect::Saturation(FineNanometres(a)),
        4 => Effect::Heat {
            channel,
            smoothing: SmoothingFactor(smoothing),
            reference: Temperature(a),
            per_temperature: m,
        },
        5 => Effect::Time { smoothing: SmoothingFactor(smoothing), amplitude: m },
        6 => Effect::Speed(m),
        7 => Effect::Load(m),
        8 => Effect::Position { axis, gradient: Gradient(a) },
        9 => Effect::Reversed { width: FineNanometres(a), gradient: Gradient(b) },
        12 => Effect::HeatSlope {
            channel,
            smoothing: SmoothingFactor(smoothing),
            reference: Temperature(a),
            per_temperature: m,
        },
        10 | 11 => Effect::SpeedHeat {
            power: if kind == 10 { SpeedExponent::First } else { SpeedExponent::Second },
            smoothing: SmoothingFactor(smoothing),
            per_unit: m,
        },
        _ => {
            Effect::Wave { turns: smoothing.into(), phase: smoothing, amplitude: FineNanometres(a) }
        }
    });
    (target, number(), effect)
        .prop_map(|(target, constant, effect)| Term {
            target,
            constant: FineNanometres(constant),
            effect,
        })
        .boxed()
}

impl Machine {
    pub fn any() -> BoxedStrategy<Self> {
        let linear = (number(), number(), any::<u8>())
            .prop_map(|(zero, slope, shift)| Thermometer::Linear { zero, slope, shift });
        let thermometer =
            prop::option::weighted(0.95, prop_oneof![9 => Just(Thermometer::Pt100), 1 => linear]);
        let source = select(&[
            ElongationSource::Sensor,
            ElongationSource::Temperature,
            ElongationSource::Warmup,
        ]);
        let rotary = select(&[
            kinematics::RotaryAxis::A,
            kinematics::RotaryAxis::B,
            kinematics::RotaryAxis::C,
        ]);
        let wild = (numbers::<3>(), size(), size(), size()).prop_map(|(max, slew, link, hold)| {
            CompensationLimits {
                max: max.map(Nanometres),
                slew_nm_per_s: slew,
                link_timeout_ms: link,
                hold_ms: hold,
                rejoin_nm_per_s: hold.rotate_left(9),
                learned: Default::default(),
            }
        });
        let usual = (1..1_000_000_u32).prop_map(|slew_nm_per_s| CompensationLimits {
            max: [200_000, 300_000, 500_000].map(Nanometres),
            slew_nm_per_s,
            link_timeout_ms: 500,
            hold_ms: 2_000,
            rejoin_nm_per_s: 10,
            learned: Default::default(),
        });
        let spindle = (
            prop::array::uniform(prop::option::of(source)),
            numbers(),
            prop::option::of((channel(), any::<u32>(), law())),
            prop::option::of((size(), numbers(), any::<[u32; 2]>(), OwnedCurve::any())),
        );
        let rest = (
            prop::array::uniform(thermometer),
            prop_oneof![Just([0, 0, -ToolDirection::ONE]), numbers()],
            prop::array::uniform(prop::option::of(rotary)),
            prop::array::uniform(OwnedAxis::any()).boxed(),
            prop::array::uniform(OwnedCurve::any()).boxed(),
            prop::array::uniform(prop_oneof![Just(0), number()]),
            prop::collection::vec(term(), 0..=MAX_TERMS),
            prop_oneof![wild, usual],
        );
        (spindle, rest)
            .prop_map(|((chain, sensor, temperature, warmup), rest)| {
                let (thermometers, zero, rotary, axes, straightness, squareness, terms, limits) =
                    rest;
                Self {
                    thermometers,
                    chain,
                    sensor,
                    temperature,
                    warmup,
                    zero,
                    rotary,
                    axes,
                    straightness,
                    squareness,
                    terms,
                    limits,
                }
            })
            .boxed()
    }

    pub fn calibration(&self) -> Calibration<'_> {
        let [k0, zero, slope] = self.sensor;
        Calibration {
            thermometers: self.thermometers,
            spindle: SpindleModel {
                chain: self.chain,
                sensor: SensorLaw {
                    k0: Nanometres(k0),
                    zero: SensorReading(zero),
                    slope: SensorSlope(slope),
                },
                temperature: self.temperature.as_ref().map(|(channel, smoothing, pieces)| {
                    SpindleTemperatureModel {
                        channel: *channel,
                        smoothing: SmoothingFactor(*smoothing),
                        smoothing_falling: SmoothingFactor(smoothing.rotate_left(7)),
                        law: ThermalExpansionLaw { pieces },
                    }
                }),
                warmup: self.warmup.as_ref().map(|(lag_ms, [max, full], shares, power)| {
                    SpindleWarmupModel {
                        law: warmup::WarmupModel {
                            lag_ms: *lag_ms,
                            max: FineNanometres(*max),
                            smoothing_heating: SmoothingFactor(shares[0]),
                            smoothing_cooling: SmoothingFactor(shares[1]),
                            full: *full,
                        },
                        power: power.curve(),
                    }
                }),
            },
            kinematics: Kinematics { zero: ToolDirection(self.zero), axes: self.rotary },
            axes: self.axes.each_ref().map(OwnedAxis::axis),
            straightness: self.straightness.each_ref().map(OwnedCurve::curve),
            squareness: self.squareness.map(Gradient),
            volume: None,
            terms: std::array::from_fn(|index| self.terms.get(index).copied()),
            limits: self.limits,
            cold_within: Temperature(Temperature::PER_KELVIN / 2),
            guards: Default::default(),
            names: MachineIdentity::default(),
        }
    }
}
