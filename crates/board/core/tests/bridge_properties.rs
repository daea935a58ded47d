//! Properties of the bridge that hold whatever is fed to it: any codes, temperatures, commands and steps of
//! time, any calibration, also one that no machine file gives.
//!
//! The steps run with overflow checks, so that a sum that wraps unintended fails here as well.

mod drawn;

use proptest::{prelude::*, sample::select, strategy::ValueTree as _, test_runner::TestRunner};
use trueup_core::{
    axis_errors::CachedErrors,
    bridge::{Bridge, BridgeState, TickInput},
    cnc::{
        AxisPosition, CncMessage, Control, LinearAxis, OffsetFlags, OffsetQuality, Output,
        RotaryAxisAngles, SpindleState, TravelDirection,
    },
    design_parameters::{CODES_PER_TICK, TEMPERATURE_CHANNEL_COUNT},
    index_set::IndexSet,
    limits::CompensationLimits,
    machine_position::MachinePosition,
    thermal_state::MachineThermalState,
    thermometer::RawTemperatureReading,
    units::{AdcCode, MicroDegrees, Position, Rpm, Temperature, TimestampMs},
};

use self::drawn::{Machine, number, numbers, size};

fn command() -> impl Strategy<Value = CncMessage> {
    let heading =
        select(&[TravelDirection::Negative, TravelDirection::Standing, TravelDirection::Positive]);
    let often = || prop::bool::weighted(0.95);
    prop_oneof![
        3 => (often(), often(), prop::bool::weighted(0.1)).prop_map(|(engage, referenced, zero)| {
            CncMessage::Control(Control { engage, referenced, zero, ..Control::default() })
        }),
        1 => (any::<u16>(), any::<i16>()).prop_map(|(speed, load_n)| {
            CncMessage::Spindle(SpindleState { speed: Rpm(speed), load_n })
        }),
        1 => numbers().prop_map(|angles| {
            CncMessage::Rotary(RotaryAxisAngles { angles: angles.map(MicroDegrees) })
        }),
        3 => (select(&LinearAxis::ALL), number(), heading).prop_map(|(axis, to, direction)| {
            CncMessage::Position(AxisPosition { axis, position: Position(to), direction })
        }),
    ]
}

/// Returns all that a calibration can ask of a CNC.
fn greeting() -> impl Strategy<Value = Vec<CncMessage>> {
    (numbers::<3>(), numbers()).prop_map(|(positions, angles)| {
        let positions = LinearAxis::ALL.into_iter().zip(positions).map(|(axis, to)| {
            let position = Position(to);
            CncMessage::Position(AxisPosition {
                axis,
                position,
                direction: TravelDirection::Positive,
            })
        });
        let control = Control::ENGAGED;
        let others = [
            CncMessage::Rotary(RotaryAxisAngles { angles: angles.map(MicroDegrees) }),
            CncMessage::Control(control),
        ];
        positions.chain(others).collect()
    })
}

/// A while in which everything stays alike: what is received before each tick and what each brings.
#[derive(Clone, Debug)]
struct Phase {
    ticks: u32,
    elapsed_ms: u32,
    received: Vec<CncMessage>,
    codes: Option<[u16; CODES_PER_TICK]>,
    speed: Option<u16>,
    temperatures: Option<[i32; TEMPERATURE_CHANNEL_COUNT]>,
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
    parts.prop_map(|(ticks, elapsed_ms, received, codes, speed, temperatures)| Phase {
        ticks,
        elapsed_ms,
        received,
        codes,
        speed,
        temperatures,
    })
}

/// Lives through the phases; `watch` sees each output with the step of time before it.
fn live(machine: &Machine, phases: &[Phase], watch: impl FnMut(Output, u32, bool)) {
    live_with(machine, phases, |_, _| {}, watch);
}

/// The same with `change` made before each tick.
fn live_with(
    machine: &Machine,
    phases: &[Phase],
    change: impl Fn(&Bridge<'_>, &mut BridgeState),
    mut watch: impl FnMut(Output, u32, bool),
) {
    let bridge = Bridge::new(machine.calibration());
    let mut state = bridge.initial_state();
    // The clock wraps on the way; the first tick comes a long time after the start, at 0.
    let (mut now, mut before) = (TimestampMs(u32::MAX - 50), TimestampMs(0));
    for phase in phases {
        let codes = phase.codes.map(|codes| codes.map(AdcCode));
        let temperatures = phase.temperatures.map(|raw| raw.map(RawTemperatureReading));
        for tick in 0..phase.ticks {
            // As a CNC does: now and then, not in every millisecond.
            if tick % 16 == 0 {
                phase.received.iter().for_each(|command| bridge.receive(&mut state, *command));
            }
            now = now.wrapping_add_ms(phase.elapsed_ms);
            change(&bridge, &mut state);
            let output = bridge.tick(
                &mut state,
                now,
                TickInput {
                    codes: codes.as_ref(),
                    speed: phase.speed.map(Rpm),
                    temperatures: temperatures.as_ref(),
                },
            );
            let is_doubted = bridge.lost_inputs(&state).too_fast != IndexSet::default();
            watch(output, now.duration_ms_since(before), is_doubted);
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
        live(&machine, &phases, |output, _, _| seen[output.quality as usize] += 1);
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
        let CompensationLimits { max, slew_nm_per_s, .. } = machine.limits;
        let mut before = [0; 3];
        live(&machine, &phases, |output, elapsed_ms, _| {
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
        live(&machine, &phases, |output, _, is_doubted| {
            let offset = nanometres(&output);
            let Output { quality, flags, .. } = output;
            assert_eq!(output.offset.is_none(), quality == OffsetQuality::Fault);
            match quality {
                OffsetQuality::Off => assert_eq!(offset, [0; 3]),
                // A temperature that changed too fast is held; positions are followed.
                OffsetQuality::Hold if is_doubted => {}
                OffsetQuality::Hold => {
                    assert_eq!(offset, before);
                    assert!(!flags.contains(OffsetFlags::SLEWING) && !flags.contains(OffsetFlags::CLAMPED));
                }
                OffsetQuality::Live | OffsetQuality::TemperatureModel | OffsetQuality::WarmUpModel => {
                    assert!(!flags.contains(OffsetFlags::CNC_LOST));
                }
                OffsetQuality::RampingOut | OffsetQuality::Fault => {
                    assert!(!flags.contains(OffsetFlags::OUTSIDE_TABLE));
                }
            }
            assert!(!flags.contains(OffsetFlags::BOARD_DEGRADED), "that is for the board to say");
            before = offset;
        });
    }

    #[test]
    fn the_same_life_gives_the_same_outputs((machine, phases) in lives()) {
        let mut first = Vec::new();
        live(&machine, &phases, |output, _, _| first.push(output));
        let mut again = first.into_iter();
        live(&machine, &phases, |output, _, _| assert_eq!(Some(output), again.next()));
    }

    #[test]
    fn errors_that_are_computed_anew_before_a_tick_are_those_that_were_kept(
        (machine, phases) in lives(),
    ) {
        let mut retained = Vec::new();
        live(&machine, &phases, |output, _, _| retained.push(output));
        let mut retained = retained.into_iter();
        let anew = |bridge: &Bridge<'_>, state: &mut BridgeState| bridge.compute_errors(state);
        live_with(&machine, &phases, anew, |output, _, _| assert_eq!(Some(output), retained.next()));
    }

    #[test]
    fn errors_that_are_kept_are_those_of_the_place(
        machine in Machine::any(),
        moves in prop::collection::vec((select(&LinearAxis::ALL), number(), -1..2_i8), 1..20),
    ) {
        let calibration = machine.calibration();
        let mut heat = MachineThermalState::default();
        let mut place = MachinePosition::default();
        let mut cached = CachedErrors::from_position(&calibration, &heat, &place);
        for (number, (axis, position, direction)) in moves.into_iter().enumerate() {
            let position = Position(position);
            place.position[axis as usize] = position;
            let config = calibration.axes[axis as usize].travel;
            place.travel[axis as usize].update(&config, position, direction);
            cached.update_axis_position(&calibration, &heat, &place, axis);
            cached.sum_guideway_errors(&calibration, &place);
            assert_eq!(*cached.errors(), calibration.compute_axis_errors(&heat, &place));
            let item = number % 3;
            heat.step_item(&calibration, item, &[Some(Temperature(position.0)); TEMPERATURE_CHANNEL_COUNT], None);
            cached.update_axis_thermal_error(&calibration, &heat, &place, LinearAxis::ALL[item]);
            cached.sum_guideway_errors(&calibration, &place);
            assert_eq!(*cached.errors(), calibration.compute_axis_errors(&heat, &place));
        }
    }
}
