//! The benchmark: how many instructions the board's work takes, in the image of the board's own
//! compiler settings.
//!
//! It runs in QEMU with `-icount shift=0`, where TIM2 runs at 1 GHz of emulated time and counts
//! one for each executed instruction. Its working directory has `calibration.bin`, `by_tool.bin` (the same
//! machine with four terms by tool and condition), `curves.bin` and `vectors`; it writes `numbers`, one name and its values a line.
//!
//! Each piece of work is called through a pointer that the compiler cannot see through, so that
//! nothing moves across the two readings of the clock. The same call of a function that only
//! returns is subtracted: what is left is the work itself.
#![no_std]
#![no_main]

use core::{fmt::Write as _, hint::black_box};

use cortex_m_rt::entry;
use defmt as _;
use heapless::String;
use semihosting::{
    fs::File,
    io::{Read as _, Write as _},
    process,
};
use stm32f4xx_hal as _;
use trueup_core::{
    axis_errors::CachedErrors,
    calibration::Calibration,
    cnc::{LinearAxis, OffsetFlags, OffsetQuality, Output},
    curve::Curve,
    design_parameters::CODES_PER_TICK,
    gradient::Gradient,
    kinematics::RotaryAxis,
    limits::AppliedOffset,
    machine_position::MachinePosition,
    reversal::Fraction,
    revolution_window::RevolutionWindow,
    run_out_filter::RunOutFilter,
    sensor_health::SensorHealthMonitor,
    thermal_state::MachineThermalState,
    units::{AdcCode, FineNanometres, MicroDegrees, Nanometres, Position, Rpm, SensorReading},
    volumetric_error::{
        AngularErrorCurve, AngularErrors, KinematicChain, RotaryAxisLocation, VolumetricErrorModel,
    },
};
use trueup_link::frames;
use trueup_node::test_vectors::{self, TestVectorRunner, XorShift32};
use trueup_store::calibration::{MAX_BLOB_SIZE, decode};

const TICK_COUNT: usize = 3_000;
const SAMPLES_PER_PART: usize = 2_000;
const POSITION_COUNT: usize = 10_000;
/// Ticks until the filter is full and everything is engaged.
const WARM_UP_TICKS: u32 = 1_000;
/// Segments of the longest curve, and intervals of the linear table.
const MAX_SEGMENTS: usize = 512;
const TABLE_INTERVALS: usize = 1_024;

#[entry]
fn main() -> ! {
    static mut CALIBRATION_BUFFER: [u8; MAX_BLOB_SIZE] = [0; MAX_BLOB_SIZE];
    static mut BY_TOOL: [u8; MAX_BLOB_SIZE] = [0; MAX_BLOB_SIZE];
    static mut CURVES: [u8; MAX_BLOB_SIZE] = [0; MAX_BLOB_SIZE];
    static mut COSTS: [u16; POSITION_COUNT] = [0; POSITION_COUNT];
    start_instruction_counter();
    let calibration =
        decode(read_file(c"calibration.bin", CALIBRATION_BUFFER)).expect("calibration.bin");
    let by_tool = decode(read_file(c"by_tool.bin", BY_TOOL)).expect("by_tool.bin");
    let curves = decode(read_file(c"curves.bin", CURVES)).expect("curves.bin");
    let mut number = [0; 4];
    read_file(c"vectors", &mut number);

    let mut text = String::<4096>::new();
    measure_tick(&calibration, ["tick", "receive", "millisecond", "live"], COSTS, &mut text);
    let names = ["tick_by_tool", "receive_by_tool", "millisecond_by_tool", "live_by_tool"];
    measure_tick(&by_tool, names, COSTS, &mut text);
    let names = ["tick_volume", "receive_volume", "millisecond_volume", "live_volume"];
    measure_tick(&with_volumetric_errors(&calibration), names, COSTS, &mut text);
    measure_parts(&calibration, COSTS, &mut text);
    for curve in curves.straightness.iter().filter(|curve| !curve.is_empty()) {
        measure_spline(curve, COSTS, &mut text);
    }
    let checksum = test_vectors::compute_checksum(calibration, u32::from_le_bytes(number));
    writeln!(text, "checksum {checksum}").expect("space");
    let checksum = test_vectors::compute_checksum(by_tool, u32::from_le_bytes(number));
    writeln!(text, "checksum_by_tool {checksum}").expect("space");
    let mut file = File::create(c"numbers").expect("numbers");
    file.write_all(text.as_bytes()).expect("numbers");
    process::exit(0)
}

#[panic_handler]
fn panic(_info: &core::panic::PanicInfo) -> ! {
    process::exit(1)
}

fn read_file<'b>(name: &core::ffi::CStr, buffer: &'b mut [u8]) -> &'b [u8] {
    let mut file = File::open(name).expect("a file of the host");
    let mut length = 0;
    while let Ok(more @ 1..) = file.read(&mut buffer[length..]) {
        length += more;
    }
    &buffer[..length]
}

const TIM2_BASE: usize = 0x4000_0000;

#[allow(unsafe_code, reason = "a register of the timer")]
fn start_instruction_counter() {
    // SAFETY: CR1 of TIM2, of which this program is the only user; 1 enables it.
    unsafe { (TIM2_BASE as *mut u32).write_volatile(1) }
}

#[inline(always)]
#[allow(unsafe_code, reason = "a register of the timer")]
fn read_instruction_counter() -> u32 {
    // SAFETY: CNT of TIM2; reading it changes nothing.
    unsafe { ((TIM2_BASE + 0x24) as *const u32).read_volatile() }
}

/// Instructions from one reading of the clock to the next, around one call.
#[inline(never)]
fn measure_raw_call_cost(work: &mut dyn FnMut()) -> u16 {
    let work = black_box(work);
    let start = read_instruction_counter();
    work();
    let end = read_instruction_counter();
    end.wrapping_sub(start).try_into().unwrap_or(u16::MAX)
}

/// Returns the cost of `work` beyond that of nothing.
fn measure_net_call_cost(work: &mut dyn FnMut()) -> u16 {
    measure_raw_call_cost(work).saturating_sub(measure_raw_call_cost(&mut || ()))
}

/// Smallest, median and largest.
fn min_median_max(costs: &mut [u16]) -> [u16; 3] {
    costs.sort_unstable();
    [costs[0], costs[costs.len() / 2], costs[costs.len() - 1]]
}

fn write_costs(text: &mut String<4096>, name: &str, costs: &mut [u16]) {
    let [min, median, max] = min_median_max(costs);
    writeln!(text, "{name} {min} {median} {max}").expect("space");
}

/// A millisecond of the board: the frames of the CNC, as often as it sends them, then the tick.
fn measure_tick(
    calibration: &Calibration<'_>,
    names: [&str; 4],
    costs: &mut [u16],
    text: &mut String<4096>,
) {
    let (ticks, costs) = costs.split_at_mut(TICK_COUNT);
    let (received, costs) = costs.split_at_mut(TICK_COUNT);
    let both = &mut costs[..TICK_COUNT];
    let mut run = TestVectorRunner::new(*calibration, 1, false);
    for _ in 0..WARM_UP_TICKS {
        run.draw_vector();
        run.receive();
        run.tick();
    }
    let mut live = 0;
    for ((tick, receive), both) in ticks.iter_mut().zip(received.iter_mut()).zip(both.iter_mut()) {
        run.draw_vector();
        *receive = measure_net_call_cost(&mut || run.receive());
        *tick = measure_net_call_cost(&mut || {
            black_box(&run.tick());
        });
        *both = *receive + *tick;
        live += u32::from(run.node().last_output().quality == OffsetQuality::Live);
    }
    let [of_tick, of_receive, of_both, of_live] = names;
    write_costs(text, of_tick, ticks);
    write_costs(text, of_receive, received);
    write_costs(text, of_both, both);
    writeln!(text, "{of_live} {live} {TICK_COUNT}").expect("space");
}

/// Measures a part of the tick: its name, and one turn of it.
type PartMeasurer<'p> = dyn FnMut(&str, &mut dyn FnMut(&mut XorShift32) -> u16) + 'p;

fn random_position(random: &mut XorShift32) -> [Position; 3] {
    [1_430_000_000, 300_000_000, 250_000_000].map(|reach| Position(random.next_below(reach) as i32))
}

fn measure_parts(calibration: &Calibration<'_>, costs: &mut [u16], text: &mut String<4096>) {
    let costs = &mut costs[..SAMPLES_PER_PART];
    let mut random = XorShift32::new(2);
    let mut part = |name: &str, once: &mut dyn FnMut(&mut XorShift32) -> u16| {
        for place in costs.iter_mut() {
            *place = once(&mut random);
        }
        write_costs(text, name, costs);
    };

    measure_sensor_parts(calibration, &mut part);
    measure_axis_parts(calibration, &mut part);
    let kinematics = calibration.kinematics;
    part("tool_direction", &mut |random| {
        let angles =
            [180_000_000, 110_000_000].map(|most| MicroDegrees(random.next_signed_within(most)));
        let elongation = Nanometres(random.next_signed_within(200_000));
        measure_net_call_cost(&mut || {
            black_box(&kinematics.tool_direction(angles).project_elongation_fine(elongation));
        })
    });
    let mut applied = AppliedOffset::default();
    let limits = calibration.limits;
    part("limits", &mut |random| {
        let target = [(); 3].map(|()| Nanometres(random.next_signed_within(400_000)));
        measure_net_call_cost(&mut || {
            black_box(applied.step(&limits, target, 1));
        })
    });
    part("frames", &mut |random| {
        let offset = Some([(); 3].map(|()| Nanometres(random.next_signed_within(400_000))));
        let output =
            Output { offset, quality: OffsetQuality::Live, flags: OffsetFlags::NONE, age_ms: 1 };
        let counter = random.next_u32() as u8;
        measure_net_call_cost(&mut || {
            black_box(&[
                frames::encode_offset_xy(&output, counter),
                frames::encode_offset_z(&output, counter),
            ]);
        })
    });
}

/// Measures from the samples to the elongation.
fn measure_sensor_parts(calibration: &Calibration<'_>, part: &mut PartMeasurer<'_>) {
    let mut health = SensorHealthMonitor::default();
    part("health", &mut |random| {
        let codes: [AdcCode; CODES_PER_TICK] =
            core::array::from_fn(|_| AdcCode(700 + (random.next_u32() & 7) as u16));
        measure_net_call_cost(&mut || {
            black_box(&health.check_and_clean_codes(&codes, true));
        })
    });
    part("window", &mut |random| {
        let speed = Some(Rpm(random.next_u32() as u16));
        measure_net_call_cost(&mut || {
            black_box(&RevolutionWindow::for_speed(speed));
        })
    });
    let mut filter = RunOutFilter::new();
    for _ in 0..WARM_UP_TICKS {
        filter.tick(&[AdcCode(700); CODES_PER_TICK], Some(Rpm(18_000)));
    }
    part("filter", &mut |random| {
        let codes: [AdcCode; CODES_PER_TICK] =
            core::array::from_fn(|_| AdcCode(700 + (random.next_u32() & 7) as u16));
        measure_net_call_cost(&mut || {
            black_box(filter.tick(&codes, Some(Rpm(18_000))));
        })
    });
    let sensor = calibration.spindle.sensor;
    part("elongation", &mut |random| {
        let reading = SensorReading(random.next_below(4_095 << 10).cast_signed());
        measure_net_call_cost(&mut || {
            black_box(sensor.elongation(reading));
        })
    });
}

/// Measures the errors of the axes.
fn measure_axis_parts(calibration: &Calibration<'_>, part: &mut PartMeasurer<'_>) {
    part("thermal", &mut |random| {
        let places = random_position(random);
        let gradients = [(); 3].map(|()| Gradient(random.next_signed_within(20_000_000)));
        measure_net_call_cost(&mut || {
            let mut sums = [FineNanometres::ZERO; 3];
            for ((sum, gradient), at) in sums.iter_mut().zip(&gradients).zip(&places) {
                *sum = gradient.error_over_travel(Position(250_000_000), *at);
            }
            black_box(&sums);
        })
    });
    let curves = calibration.straightness;
    part("straightness6", &mut |random| {
        let [x, y, z] = random_position(random);
        let places = [y, z, x, z, x, y];
        measure_net_call_cost(&mut || {
            let mut sum = FineNanometres::ZERO;
            for (curve, at) in curves.iter().zip(&places) {
                sum = sum.saturating_add(curve.evaluate(*at).0);
            }
            black_box(sum);
        })
    });
    // The three tables that the gantry has: X, its second drive, and Y in both directions.
    let axes = &calibration.axes;
    let tables = [axes[0].pitch, axes[0].dual.map(|dual| dual.pitch), axes[1].pitch];
    let tables = tables.map(|table| table.expect("the gantry has three tables"));
    part("pitch3", &mut |random| {
        let [x, y, _] = random_position(random);
        let places = [x, x, y];
        let blend = Fraction(random.next_u32() >> 1);
        measure_net_call_cost(&mut || {
            let mut sum = FineNanometres::ZERO;
            for (table, at) in tables.iter().zip(&places) {
                sum = sum.saturating_add(table.error_at(*at, blend).0);
            }
            black_box(sum);
        })
    });
    let heat = MachineThermalState::default();
    let mut at = MachinePosition::default();
    let mut cached = CachedErrors::from_position(calibration, &heat, &at);
    part("moved", &mut |random| {
        at.position = random_position(random);
        let axis = LinearAxis::ALL[random.next_below(3) as usize];
        measure_net_call_cost(&mut || cached.update_axis_position(calibration, &heat, &at, axis))
    });
    part("added_up", &mut |_| {
        measure_net_call_cost(&mut || cached.sum_guideway_errors(calibration, &at))
    });
    black_box(cached.errors());
    measure_volumetric_parts(calibration, part);
}

/// Returns the calibration with all nine angles as curves and two rotary axes under the workpiece, the most there can be.
fn with_volumetric_errors<'c>(calibration: &Calibration<'c>) -> Calibration<'c> {
    let [a, b, c, d, e, f] = calibration.straightness;
    let line = |axis, tilt| RotaryAxisLocation {
        axis,
        moves_workpiece: true,
        point: [Position(30_000_000); 3],
        shift: [FineNanometres(2_000); 3],
        tilt: [FineNanometres(tilt); 3],
    };
    let guides = [[a, b, c], [d, e, f], [f, c, a]].map(|curves| AngularErrors {
        point: [Position(1_000); 3],
        about: curves.map(|curve| AngularErrorCurve { slope: Gradient::ZERO, curve }),
    });
    let volume = VolumetricErrorModel {
        chain: KinematicChain::default(),
        guides,
        tool: [Position(-10_000_000); 3],
        rotary: [Some(line(RotaryAxis::A, 500)), Some(line(RotaryAxis::C, -700))],
    };
    Calibration { volume: Some(volume), ..*calibration }
}

/// Measures the same with a volume.
fn measure_volumetric_parts(calibration: &Calibration<'_>, part: &mut PartMeasurer<'_>) {
    let calibration = with_volumetric_errors(calibration);
    let heat = MachineThermalState::default();
    let mut at = MachinePosition::default();
    let mut cached = CachedErrors::from_position(&calibration, &heat, &at);
    part("moved_volume", &mut |random| {
        at.position = random_position(random);
        let axis = LinearAxis::ALL[random.next_below(3) as usize];
        measure_net_call_cost(&mut || cached.update_axis_position(&calibration, &heat, &at, axis))
    });
    part("turned_volume", &mut |random| {
        at.angles = [180_000_000; 2].map(|most| MicroDegrees(random.next_signed_within(most)));
        measure_net_call_cost(&mut || cached.update_rotary_angles(&calibration, &at))
    });
    part("added_up_volume", &mut |_| {
        measure_net_call_cost(&mut || cached.sum_guideway_errors(&calibration, &at))
    });
    black_box(cached.errors());
}

/// A function of a position and what it is looked up in.
type LookupFn<T> = fn(Position, &T) -> i32;

#[inline(never)]
fn measure_lookup_cost<T>(lookup: LookupFn<T>, at: Position, of: &T) -> u16 {
    let lookup = black_box(lookup);
    let start = read_instruction_counter();
    let value = lookup(at, of);
    let end = read_instruction_counter();
    black_box(value);
    end.wrapping_sub(start).try_into().unwrap_or(u16::MAX)
}

#[inline(never)]
fn baseline_lookup<T>(at: Position, _: &T) -> i32 {
    at.0
}

#[inline(never)]
fn evaluate_curve(at: Position, curve: &Curve<'_>) -> i32 {
    curve.evaluate(at).0.0
}

/// A cubic B-spline as text books have it: f32, knots repeated at the ends.
struct BSpline {
    knots: [f32; MAX_SEGMENTS + 8],
    control: [f32; MAX_SEGMENTS + 4],
    segments: usize,
}

#[inline(never)]
fn evaluate_de_boor(at: Position, spline: &BSpline) -> i32 {
    let x = at.0 as f32 * 1e-5;
    let knots = &spline.knots[..spline.segments + 7];
    let inner = &knots[4..spline.segments + 3];
    let span = 3 + inner.partition_point(|knot| *knot <= x);
    let mut d: [f32; 4] = core::array::from_fn(|n| spline.control[span - 3 + n]);
    for degree in 1..4 {
        for n in (degree..4).rev() {
            let (low, high) = (knots[span - 3 + n], knots[span + 1 + n - degree]);
            let share = (x - low) / (high - low);
            d[n] = (1.0 - share) * d[n - 1] + share * d[n];
        }
    }
    d[3] as i32
}

/// Values at equal distances, straight lines between.
struct LinearTable {
    first: f32,
    per_step: f32,
    values: [f32; TABLE_INTERVALS + 1],
}

#[inline(never)]
fn interpolate_linear(at: Position, table: &LinearTable) -> i32 {
    let x = (at.0 as f32 - table.first) * table.per_step;
    let number = (x as usize).min(TABLE_INTERVALS - 1);
    let (low, high) = (table.values[number], table.values[number + 1]);
    (low + (high - low) * (x - number as f32)) as i32
}

fn measure_spline(curve: &Curve<'_>, costs: &mut [u16], text: &mut String<4096>) {
    let ends = curve
        .segments()
        .iter()
        .map(|bytes| i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let (first, last) = (curve.first_knot().0, ends.clone().next_back().unwrap_or(0));
    let span = (last - first).unsigned_abs();
    let segments = curve.segments().len().min(MAX_SEGMENTS);

    let mut deboor =
        BSpline { knots: [0.0; MAX_SEGMENTS + 8], control: [0.0; MAX_SEGMENTS + 4], segments };
    deboor.knots[..4].fill(first as f32 * 1e-5);
    for (knot, end) in deboor.knots[4..].iter_mut().zip(ends.take(segments)) {
        *knot = end as f32 * 1e-5;
    }
    deboor.knots[segments + 3..].fill(last as f32 * 1e-5);
    for n in 0..segments + 3 {
        // Near the curve itself: the value at the mean of three knots.
        let mean = deboor.knots[n + 1..n + 4].iter().sum::<f32>() / 3.0;
        deboor.control[n] = curve.evaluate(Position((mean * 1e5) as i32)).0.0 as f32;
    }
    let mut table = LinearTable {
        first: first as f32,
        per_step: TABLE_INTERVALS as f32 / span as f32,
        values: [0.0; TABLE_INTERVALS + 1],
    };
    for (n, value) in table.values.iter_mut().enumerate() {
        let at = u64::from(span) * n as u64 / TABLE_INTERVALS as u64;
        *value = curve.evaluate(Position(first + at as i32)).0.0 as f32;
    }

    let segments = curve.segments().len();
    let mut measure = |name: &str, once: &dyn Fn(Position) -> u16| {
        let mut random = XorShift32::new(3);
        for place in costs.iter_mut() {
            *place = once(Position(first + random.next_below(span + 1) as i32));
        }
        let [min, median, max] = min_median_max(costs);
        writeln!(text, "{name} {min} {median} {max} {segments}").expect("space");
    };
    let empty = |at: Position| measure_lookup_cost(baseline_lookup, at, &());
    measure("curve", &|at| {
        measure_lookup_cost(evaluate_curve, at, curve).saturating_sub(empty(at))
    });
    measure("de_boor", &|at| {
        measure_lookup_cost(evaluate_de_boor, at, &deboor).saturating_sub(empty(at))
    });
    measure("linear", &|at| {
        measure_lookup_cost(interpolate_linear, at, &table).saturating_sub(empty(at))
    });
    // How far the three are apart, so that none of them computes something else, in 1/256 nm.
    let mut random = XorShift32::new(4);
    let mut apart = [0; 2];
    for _ in 0..1_000 {
        let at = Position(first + random.next_below(span + 1) as i32);
        let right = evaluate_curve(at, curve);
        for (worst, other) in
            apart.iter_mut().zip([evaluate_de_boor(at, &deboor), interpolate_linear(at, &table)])
        {
            *worst = right.abs_diff(other).max(*worst);
        }
    }
    writeln!(text, "apart {} {}", apart[0], apart[1]).expect("space");
}
