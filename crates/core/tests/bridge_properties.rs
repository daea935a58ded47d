//! What holds for the bridge whatever is fed to it: any codes, temperatures, commands and steps of
//! time, any calibration, also one that no machine file gives.
//!
//! The steps run with overflow checks, so that a sum that wraps unintended fails here as well.

use proptest::{prelude::*, sample::select, strategy::ValueTree as _, test_runner::TestRunner};
use trueup_core::{
    bridge::{Bridge, Input, State},
    calibration::{
        AxisModel, AxisThermal, Calibration, Dual, ElongationSource, SpindleModel,
        SpindleTemperature, SpindleWarmup,
    },
    cnc::{
        AxisPosition, Command, Control, Flags, Heading, LinearAxis, Output, Quality, Rotary,
        Spindle,
    },
    curve::{Curve, Segment},
    dimensions::CHANNELS,
    dimensions::CODES_PER_TICK,
    dimensions::MAX_TERMS,
    fixed::Scaled,
    geometry::CachedErrors,
    gradient::Gradient,
    heat::Heat,
    kinematics::{self, Kinematics},
    lag::SmoothingFactor,
    limits::Limits,
    pitch::{Beam, Pitch},
    place::Place,
    sensor::{SensorLaw, Slope},
    term::{Effect, Target, Term},
    thermal::{Law, Piece},
    thermometer::{Raw, Thermometer},
    tool::Direction,
    travel::{Config, Interval},
    units::{Code, Fine, MicroDegrees, Millis, Nanometres, Position, Reading, Rpm, Temperature},
    warmup,
};

/// Any number, and often one at an end or near 0.
fn number() -> BoxedStrategy<i32> {
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

/// The same from 0.
fn size() -> BoxedStrategy<u32> {
    prop_oneof![Just(0), Just(u32::MAX), 1..3_000_u32, 1..10_000_000_u32, any::<u32>()].boxed()
}

fn numbers<const N: usize>() -> impl Strategy<Value = [i32; N]> {
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
        let segment = (numbers::<5>(), 0..32_u8)
            .prop_map(|([end, c @ ..], shift)| Segment::new(Position(end), shift, c).to_bytes());
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

    fn pitch(&self) -> Pitch<'_> {
        Pitch {
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
        Piece {
            start: Temperature(start),
            constant: Fine(constant),
            constant_slope: slope,
            gradient: Gradient(gradient),
            gradient_slope,
        }
        .to_bytes()
    });
    prop::collection::vec(piece, 0..3).boxed()
}

/// What belongs to one axis: its law with channel and smoothing, both tables, numbers for the rest.
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
            thermal: self.thermal.as_ref().map(|(channel, smoothing, pieces)| AxisThermal {
                channel: *channel,
                smoothing: SmoothingFactor(*smoothing),
                smoothing_falling: SmoothingFactor(smoothing.rotate_left(7)),
                origin: Position(origin),
                law: Law { pieces },
            }),
            pitch: self.pitch.as_ref().map(OwnedPitch::pitch),
            dual: self.dual.as_ref().map(|(across, pitch)| Dual {
                across: *across,
                beam: Beam::new(Position(first), Position(second)),
                pitch: pitch.pitch(),
            }),
            backlash: Fine(backlash),
            travel: Config { hysteresis: self.sizes[0], ramp: Interval::new(self.sizes[1]) },
        }
    }
}

/// Mostly a channel of the board.
fn channel() -> impl Strategy<Value = u8> {
    prop_oneof![20 => 0..4_u8, 1 => any::<u8>()]
}

/// A calibration that owns its tables.
#[derive(Clone, Debug)]
struct Machine {
    thermometers: [Option<Thermometer>; CHANNELS],
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
    limits: Limits,
}

/// A term of a diagnosis, of every kind that needs no table.
fn term() -> BoxedStrategy<Term<'static>> {
    let target =
        prop_oneof![Just(Target::Elongation), select(&LinearAxis::ALL).prop_map(Target::Axis)];
    let scaled = (number(), 0..70_u8).prop_map(|(mantissa, shift)| Scaled { mantissa, shift });
    let parts = (scaled, numbers::<2>(), channel(), any::<u32>(), select(&LinearAxis::ALL), 0..11);
    let effect = parts.prop_map(|(m, [a, b], channel, smoothing, axis, kind)| match kind {
        0 => Effect::Offset,
        1 => Effect::Gain(m),
        2 => Effect::Curvature(m),
        3 => Effect::Saturation(Fine(a)),
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
        9 => Effect::Reversed { width: Fine(a), gradient: Gradient(b) },
        _ => Effect::Wave { turns: smoothing.into(), phase: smoothing, amplitude: Fine(a) },
    });
    (target, number(), effect)
        .prop_map(|(target, constant, effect)| Term { target, constant: Fine(constant), effect })
        .boxed()
}

impl Machine {
    fn any() -> BoxedStrategy<Self> {
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
        let wild =
            (numbers::<3>(), size(), size(), size()).prop_map(|(max, slew, link, hold)| Limits {
                max: max.map(Nanometres),
                slew_nm_per_s: slew,
                link_timeout_ms: link,
                hold_ms: hold,
            });
        let usual = (1..1_000_000_u32).prop_map(|slew_nm_per_s| Limits {
            max: [200_000, 300_000, 500_000].map(Nanometres),
            slew_nm_per_s,
            link_timeout_ms: 500,
            hold_ms: 2_000,
        });
        let spindle = (
            prop::array::uniform(prop::option::of(source)),
            numbers(),
            prop::option::of((channel(), any::<u32>(), law())),
            prop::option::of((size(), numbers(), any::<[u32; 2]>(), OwnedCurve::any())),
        );
        let rest = (
            prop::array::uniform(thermometer),
            prop_oneof![Just([0, 0, -Direction::ONE]), numbers()],
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

    fn calibration(&self) -> Calibration<'_> {
        let [k0, zero, slope] = self.sensor;
        Calibration {
            thermometers: self.thermometers,
            spindle: SpindleModel {
                chain: self.chain,
                sensor: SensorLaw { k0: Nanometres(k0), zero: Reading(zero), slope: Slope(slope) },
                temperature: self.temperature.as_ref().map(|(channel, smoothing, pieces)| {
                    SpindleTemperature {
                        channel: *channel,
                        smoothing: SmoothingFactor(*smoothing),
                        smoothing_falling: SmoothingFactor(smoothing.rotate_left(7)),
                        law: Law { pieces },
                    }
                }),
                warmup: self.warmup.as_ref().map(|(lag_ms, [max, full], shares, power)| {
                    SpindleWarmup {
                        law: warmup::Warmup {
                            lag_ms: *lag_ms,
                            max: Fine(*max),
                            smoothing_heating: SmoothingFactor(shares[0]),
                            smoothing_cooling: SmoothingFactor(shares[1]),
                            full: *full,
                        },
                        power: power.curve(),
                    }
                }),
            },
            kinematics: Kinematics { zero: Direction(self.zero), axes: self.rotary },
            axes: self.axes.each_ref().map(OwnedAxis::axis),
            straightness: self.straightness.each_ref().map(OwnedCurve::curve),
            squareness: self.squareness.map(Gradient),
            terms: std::array::from_fn(|index| self.terms.get(index).copied()),
            limits: self.limits,
        }
    }
}

fn command() -> impl Strategy<Value = Command> {
    let heading = select(&[Heading::Negative, Heading::Standing, Heading::Positive]);
    let often = || prop::bool::weighted(0.95);
    prop_oneof![
        3 => (often(), often(), prop::bool::weighted(0.1)).prop_map(|(engage, referenced, zero)| {
            Command::Control(Control { engage, referenced, zero })
        }),
        1 => (any::<u16>(), any::<i16>()).prop_map(|(speed, load_n)| {
            Command::Spindle(Spindle { speed: Rpm(speed), load_n })
        }),
        1 => numbers().prop_map(|angles| {
            Command::Rotary(Rotary { angles: angles.map(MicroDegrees) })
        }),
        3 => (select(&LinearAxis::ALL), number(), heading).prop_map(|(axis, to, direction)| {
            Command::Position(AxisPosition { axis, position: Position(to), direction })
        }),
    ]
}

/// All that a calibration can ask of a CNC.
fn greeting() -> impl Strategy<Value = Vec<Command>> {
    (numbers::<3>(), numbers()).prop_map(|(positions, angles)| {
        let positions = LinearAxis::ALL.into_iter().zip(positions).map(|(axis, to)| {
            let position = Position(to);
            Command::Position(AxisPosition { axis, position, direction: Heading::Positive })
        });
        let control = Control { engage: true, referenced: true, zero: false };
        let others = [
            Command::Rotary(Rotary { angles: angles.map(MicroDegrees) }),
            Command::Control(control),
        ];
        positions.chain(others).collect()
    })
}

/// A while in which everything stays alike: what is heard before each tick and what each brings.
#[derive(Clone, Debug)]
struct Phase {
    ticks: u32,
    elapsed_ms: u32,
    heard: Vec<Command>,
    codes: Option<[u16; CODES_PER_TICK]>,
    speed: Option<u16>,
    temperatures: Option<[i32; CHANNELS]>,
}

fn phase() -> impl Strategy<Value = Phase> {
    const RIPPLE: [u16; 5] = [0, 2, 4, 1, 3];
    let alive = (10..4_000_u16)
        .prop_map(|level| std::array::from_fn(|n| level.saturating_add(RIPPLE[n % 5])));
    let spikes = (10..4_000_u16, any::<[bool; CODES_PER_TICK]>())
        .prop_map(|(level, good)| good.map(|good| if good { level } else { 4_095 }));
    let codes = prop_oneof![4 => alive, 1 => spikes, 1 => Just([0; 20]), 1 => any::<[u16; 20]>()];
    let warm = prop_oneof![40 => 100_000_000..120_000_000, 1 => number(), 1 => Just(i32::MIN)];
    let parts = (
        prop_oneof![1..5_u32, 20..30_u32, 100..200_u32],
        prop_oneof![8 => Just(1), 1 => 0..300_u32, 1 => size()],
        prop_oneof![3 => greeting(), 2 => prop::collection::vec(command(), 0..6)],
        prop::option::weighted(0.9, codes),
        prop::option::weighted(0.8, any::<u16>()),
        prop::option::weighted(0.8, prop::array::uniform(warm)),
    );
    parts.prop_map(|(ticks, elapsed_ms, heard, codes, speed, temperatures)| Phase {
        ticks,
        elapsed_ms,
        heard,
        codes,
        speed,
        temperatures,
    })
}

/// Lives through the phases; `watch` sees each output with the step of time before it.
fn live(machine: &Machine, phases: &[Phase], mut watch: impl FnMut(Output, u32)) {
    let bridge = Bridge::new(machine.calibration());
    let mut state = State::default();
    // The clock wraps on the way; the first tick comes a long time after the start, at 0.
    let (mut now, mut before) = (Millis(u32::MAX - 50), Millis(0));
    for phase in phases {
        let codes = phase.codes.map(|codes| codes.map(Code));
        let temperatures = phase.temperatures.map(|raw| raw.map(Raw));
        for tick in 0..phase.ticks {
            // As a CNC does: now and then, not in every millisecond.
            if tick % 16 == 0 {
                phase.heard.iter().for_each(|command| bridge.hear(&mut state, *command));
            }
            now = now.after(phase.elapsed_ms);
            let output = bridge.tick(
                &mut state,
                now,
                Input {
                    codes: codes.as_ref(),
                    speed: phase.speed.map(Rpm),
                    temperatures: temperatures.as_ref(),
                },
            );
            watch(output, now.since(before));
            before = now;
        }
    }
}

fn lives() -> impl Strategy<Value = (Machine, Vec<Phase>)> {
    (Machine::any(), prop::collection::vec(phase(), 1..8))
}

fn nanometres(output: &Output) -> [i64; 3] {
    output.offset.map_or([0; 3], |offset| offset.map(|axis| axis.0.into()))
}

#[test]
fn the_lives_that_are_drawn_lead_through_every_quality() {
    let mut runner = TestRunner::deterministic();
    let mut seen = [0_u32; 7];
    for _ in 0..500 {
        let (machine, phases) =
            lives().new_tree(&mut runner).expect("nothing is filtered").current();
        live(&machine, &phases, |output, _| seen[output.quality as usize] += 1);
    }
    println!("ticks of each quality: {seen:?}");
    assert!(!seen.contains(&0));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 1_000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn an_offset_stays_within_its_limit_and_never_outruns_the_slew_rate(
        (machine, phases) in lives()
    ) {
        let Limits { max, slew_nm_per_s, .. } = machine.limits;
        let mut before = [0; 3];
        live(&machine, &phases, |output, elapsed_ms| {
            let offset = nanometres(&output);
            // nm/s times ms is pm.
            let way = u64::from(slew_nm_per_s).saturating_mul(elapsed_ms.into()).div_ceil(1_000);
            for ((now, was), max) in offset.into_iter().zip(before).zip(max) {
                assert!(now.abs() <= max.0.max(0).into(), "{now} nm is beyond {max:?}");
                assert!(now.abs_diff(was) <= way, "from {was} to {now} nm in {elapsed_ms} ms");
            }
            before = offset;
        });
    }

    #[test]
    fn quality_offset_and_flags_agree((machine, phases) in lives()) {
        let mut before = [0; 3];
        live(&machine, &phases, |output, _| {
            let offset = nanometres(&output);
            let Output { quality, flags, .. } = output;
            assert_eq!(output.offset.is_none(), quality == Quality::Fault);
            match quality {
                Quality::Off => assert_eq!(offset, [0; 3]),
                Quality::Hold => {
                    assert_eq!(offset, before);
                    assert!(!flags.contains(Flags::SLEWING) && !flags.contains(Flags::CLAMPED));
                }
                Quality::Live | Quality::TemperatureModel | Quality::WarmUpModel => {
                    assert!(!flags.contains(Flags::CNC_LOST));
                }
                Quality::RampingOut | Quality::Fault => {
                    assert!(!flags.contains(Flags::OUTSIDE_TABLE));
                }
            }
            assert!(!flags.contains(Flags::BOARD_DEGRADED), "that is for the board to say");
            before = offset;
        });
    }

    #[test]
    fn the_same_life_gives_the_same_outputs((machine, phases) in lives()) {
        let mut first = Vec::new();
        live(&machine, &phases, |output, _| first.push(output));
        let mut again = first.into_iter();
        live(&machine, &phases, |output, _| assert_eq!(Some(output), again.next()));
    }

    #[test]
    fn errors_that_are_kept_are_those_of_the_place(
        machine in Machine::any(),
        moves in prop::collection::vec((select(&LinearAxis::ALL), number(), -1..2_i8), 1..20),
    ) {
        let calibration = machine.calibration();
        let mut heat = Heat::default();
        let mut place = Place::default();
        let mut cached = CachedErrors::at(&calibration, &heat, &place);
        for (number, (axis, position, direction)) in moves.into_iter().enumerate() {
            let position = Position(position);
            place.position[axis as usize] = position;
            let config = calibration.axes[axis as usize].travel;
            place.travel[axis as usize].update(&config, position, direction);
            cached.moved(&calibration, &heat, &place, axis);
            assert_eq!(*cached.errors(), calibration.errors(&heat, &place));
            let item = number % 3;
            heat.step_item(&calibration, item, &[Some(Temperature(position.0)); CHANNELS], None);
            cached.warmed(&calibration, &heat, &place, LinearAxis::ALL[item]);
            assert_eq!(*cached.errors(), calibration.errors(&heat, &place));
        }
    }
}
