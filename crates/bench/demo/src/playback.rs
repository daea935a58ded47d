//! A run, row by row, through a board; and the offsets that a CNC reads from its frames.
//!
//! Each row is held for a time of its own. The CNC's part is played too: it is silent about offsets
//! until the board is up, then engages, and says where axes, angles, speed and load are.

use anyhow::{Context as _, Result, bail};
use trueup_core::{
    cnc::{Control, OffsetQuality, Output, SpindleState},
    temperature_channels::RawTemperatures,
    thermometer::RawTemperatureReading,
    units::Rpm,
};
use trueup_emulator::{
    analogue_front_end::AnalogueFrontEnd,
    board::MAX_BATCH_BLOCKS,
    cnc_emulator::{CncEmulator, ReceivedFrames},
    replay::{MachineSnapshot, RunReplay},
};
use trueup_link::{frames, receiver::OffsetReceiver};
use trueup_machine::{
    Machine, RunFile,
    machine_file::{Quantity, is_temperature_column},
};
use trueup_pipe::Block;

use crate::stepped_board::SteppedBoard;

/// How long a row of a run without time is held: filter and slew have come to rest by then.
pub(crate) const STATIC_ROW_HOLD_S: f64 = 0.5;
/// How long the first row of a run with time is held, for which what has a memory is at rest; filters have
/// settled before it.
const FIRST_ROW_HOLD_S: f64 = 0.02;
/// From the start until the CNC engages, and until the first row begins.
const ENGAGE_TIME_MS: u32 = 200;
const FIRST_ROW_TIME_MS: u32 = 500;
/// The last offsets of a row are averaged, but not over more than this.
const MAX_AVERAGING_WINDOW_MS: u32 = 100;
/// Temperatures go from row to row nearly as fast as a board believes: 600 K/min.
const TEMPERATURE_SLEW_C_PER_S: f64 = 9.0;
/// Run-out of ±5 µm with 20 % second and 10 % third harmonic.
const RUNOUT_HARMONICS_UM: [f64; 3] = [5.0, 1.0, 0.5];

/// How a run is played.
#[derive(Clone, Debug)]
pub struct PlaybackParameters {
    /// How long the board sees each row, in s.
    pub hold_s: Vec<f64>,
    /// Whether the sensor sees the run-out of a turning spindle.
    pub has_run_out: bool,
    /// Seed of the front end's noise.
    pub seed: u64,
    /// The number of the CNC's first frame: it goes on where another part of the CNC has ended.
    pub counter: u8,
}

impl PlaybackParameters {
    /// Returns each row until the filters have come to rest.
    #[must_use]
    pub(crate) fn with_static_hold(rows: usize) -> Self {
        Self { hold_s: vec![STATIC_ROW_HOLD_S; rows], has_run_out: true, seed: 2009, counter: 0 }
    }

    /// As the run's own clock says, `faster` times as fast: a row is what holds until its time.
    ///
    /// # Errors
    /// There is no time, or it runs back.
    pub fn from_timestamps(run: &RunFile, faster: f64) -> Result<Self> {
        let times = run.require_column("time_s")?;
        let mut hold_s = vec![FIRST_ROW_HOLD_S];
        for pair in times.windows(2) {
            let step_s = pair[1] - pair[0];
            if !(step_s >= 0.0 && step_s.is_finite()) {
                bail!("time_s runs back or is missing: this run cannot be played as one");
            }
            hold_s.push(step_s / faster);
        }
        Ok(Self { hold_s, has_run_out: false, seed: 2009, counter: 0 })
    }
}

/// A CNC's record of a run.
#[derive(Clone, Debug, Default)]
pub struct PlaybackRecord {
    /// Offsets on X, Y and Z at the end of each row, in µm; missing where the row was not played
    /// or no offset was available.
    pub offset_um: Vec<Option<[f64; 3]>>,
    /// How good that was, 0…6.
    pub quality: Vec<u8>,
    /// Frames with offsets that were received.
    pub frames: u32,
    /// Frames that were damaged, repeated, out of order or lost.
    pub errors: u32,
    /// Board time, in s.
    pub board_s: f64,
}

impl PlaybackRecord {
    /// Returns what the offsets say of `quantity` in each row, in µm: they are its opposite. NaN where missing.
    #[must_use]
    pub fn estimated_error_um(&self, quantity: Quantity, machine: &Machine) -> Vec<f64> {
        let of = |offset: &Option<[f64; 3]>| {
            offset.map_or(f64::NAN, |um| match quantity.axis() {
                Some(axis) => -um[axis.index()],
                // s = −offset·V
                None => um.iter().zip(machine.tool_direction).map(|(um, v)| -um * v).sum(),
            })
        };
        self.offset_um.iter().map(of).collect()
    }
}

/// Plays the rows of `run` for which `is_selected` holds; `machine` says how its inputs are connected.
///
/// # Errors
/// The run cannot be played on this machine, or the board ends.
pub fn play(
    bridge: &mut dyn SteppedBoard,
    machine: &Machine,
    run: &RunFile,
    pace: &PlaybackParameters,
    is_selected: &dyn Fn(usize) -> bool,
    progress: &mut dyn FnMut(f64),
) -> Result<PlaybackRecord> {
    // A second for each row: only the order matters here.
    let replay = RunReplay::new(&with_row_index_timestamps(run)?, machine, 1.0)?;
    let mut cnc = CncPlayer::new(machine, pace);
    let loads = run.column("load_n");
    let load_n = |row: usize| {
        let newton = loads.map_or(0.0, |loads| loads[row]);
        if newton.is_nan() { 0.0 } else { newton.clamp(-32_000.0, 32_000.0).round() }
    };
    let mut first = replay.snapshot_at(0.0);
    first.speed = Some(Rpm(0));
    cnc.hold_snapshot(bridge, &first, 0.0, FIRST_ROW_TIME_MS, &|_| first.temperatures)?;
    let mut played = PlaybackRecord {
        offset_um: vec![None; run.row_count()],
        quality: vec![OffsetQuality::Off as u8; run.row_count()],
        ..PlaybackRecord::default()
    };
    let mut passed_s = 0.0;
    let mut done_ms = 0;
    let changes_c = max_temperature_changes_c(run);
    let mut before = None;
    for row in (0..run.row_count()).filter(|row| is_selected(*row)) {
        // Rounded as a sum, so that no time is lost.
        passed_s += pace.hold_s[row];
        let until_ms = (passed_s * 1000.0).round() as u32;
        let now = replay.snapshot_at(row as f64);
        let from = before.replace(now.temperatures).unwrap_or(now.temperatures);
        let swept_ms = 1000.0 * changes_c.get(row).map_or(0.0, |c| c / TEMPERATURE_SLEW_C_PER_S);
        let swept =
            |ms: f64| interpolate_temperatures(from, now.temperatures, ms / swept_ms.max(1.0));
        let mean = cnc.hold_snapshot(bridge, &now, load_n(row), until_ms - done_ms, &swept)?;
        done_ms = until_ms;
        if let Some((offset_um, quality)) = mean {
            played.quality[row] = quality as u8;
            played.offset_um[row] = offset_um;
        }
        progress((row + 1) as f64 / run.row_count() as f64);
    }
    let counters = cnc.offsets.counters();
    played.frames = counters.accepted;
    played.errors = counters.crc_errors + counters.sequence_errors + counters.lost;
    played.errors += cnc.offsets.unpaired_frame_count();
    played.board_s = f64::from(cnc.ms) / 1000.0;
    Ok(played)
}

/// Returns the run without its clock.
fn with_row_index_timestamps(run: &RunFile) -> Result<RunFile> {
    let columns = run.columns().iter().filter(|column| column.name == "time_s");
    if columns.count() == 0 {
        return Ok(run.clone());
    }
    let count = (0..run.row_count()).map(|row| row as f64).collect();
    trueup_campaigns::run_file::with_columns(run, &[("time_s".into(), count)])
}

/// The CNC's part, and the front end's.
struct CncPlayer {
    front_end: AnalogueFrontEnd,
    stand_in: CncEmulator,
    heard: ReceivedFrames,
    offsets: OffsetReceiver,
    last: Output,
    /// µm of run-out as volts of the sensor; none without a sensor or run-out.
    volts_per_um: f64,
    has_sensor: bool,
    ms: u32,
    counter: u8,
}

impl CncPlayer {
    fn new(machine: &Machine, pace: &PlaybackParameters) -> Self {
        let input = machine.inputs.as_ref().and_then(|inputs| inputs.sensor.as_ref());
        let model = machine.spindle.sensor.as_ref();
        let volts_per_um = input.zip(model).map_or(0.0, |(input, model)| {
            input.volts_full_scale / (input.counts_full_scale * model.um_per_count.abs())
        });
        Self {
            front_end: AnalogueFrontEnd::new(input.map_or(0.0, |input| input.divider), pace.seed),
            stand_in: CncEmulator::default(),
            heard: ReceivedFrames::default(),
            offsets: OffsetReceiver::new(),
            last: Output::default(),
            volts_per_um: if pace.has_run_out { volts_per_um } else { 0.0 },
            has_sensor: input.is_some() && model.is_some(),
            ms: 0,
            counter: pace.counter,
        }
    }

    /// Holds a situation for a time, of which each millisecond has its own temperatures. Returns the mean of the last
    /// offsets in µm and their worst quality; none where nothing was sent.
    fn hold_snapshot(
        &mut self,
        bridge: &mut dyn SteppedBoard,
        now: &MachineSnapshot,
        load_n: f64,
        ms: u32,
        temperatures: &dyn Fn(f64) -> RawTemperatures,
    ) -> Result<Option<(Option<[f64; 3]>, OffsetQuality)>> {
        let mean_from = ms - (ms / 5).clamp(1.min(ms), MAX_AVERAGING_WINDOW_MS);
        let (mut outputs, mut passed) = (Vec::new(), 0);
        while passed < ms {
            let batch = (ms - passed).min(MAX_BATCH_BLOCKS);
            let at =
                |ms| MachineSnapshot { temperatures: temperatures(f64::from(passed + ms)), ..*now };
            let blocks: Vec<Block> =
                (0..batch).map(|ms| self.next_block(&at(ms + 1), load_n)).collect();
            for frame in bridge.step(&blocks)? {
                if let Some(output) = self.offsets.accept(&frame).ok().flatten() {
                    self.last = output;
                    outputs.push(output);
                }
            }
            passed += batch;
        }
        if outputs.is_empty() {
            outputs.push(self.last);
        }
        let from = outputs.len().saturating_sub((ms - mean_from) as usize);
        Ok(mean_offset_and_worst_quality(&outputs[from.min(outputs.len() - 1)..]))
    }

    fn next_block(&mut self, now: &MachineSnapshot, load_n: f64) -> Block {
        let mut frames = self.stand_in.next_frames(now, &self.heard);
        let engage = self.ms >= ENGAGE_TIME_MS;
        if self.ms.is_multiple_of(20) {
            let control = Control { engage, referenced: true, ..Control::default() };
            frames[4] = Some(frames::encode_control(control, self.counter));
        } else if self.ms % 20 == 10 {
            let spindle =
                SpindleState { speed: now.speed.unwrap_or_default(), load_n: load_n as i16 };
            frames[4] = Some(frames::encode_spindle(spindle, self.counter));
            self.counter = self.counter.wrapping_add(1);
        }
        self.ms += 1;
        let turn_hz = f64::from(now.speed.unwrap_or_default().0) / 60.0;
        let (level, volts_per_um) = (now.sensor_volts, self.volts_per_um);
        let volts = move |time_s: f64| {
            if volts_per_um == 0.0 || turn_hz == 0.0 {
                return level;
            }
            let angle = std::f64::consts::TAU * turn_hz * time_s;
            let harmonics = RUNOUT_HARMONICS_UM.iter().zip(1..);
            let um: f64 = harmonics.map(|(um, n)| um * (f64::from(n) * angle).sin()).sum();
            level + um * volts_per_um
        };
        let codes = if self.has_sensor {
            self.front_end.convert_block(volts)
        } else {
            Block::default().codes
        };
        Block { codes, speed: None, temperatures: now.temperatures, frames, ..Block::default() }
    }
}

/// Returns the largest change of a temperature to each row, in K; 0 to the first.
fn max_temperature_changes_c(run: &RunFile) -> Vec<f64> {
    let mut changes = vec![0.0_f64; run.row_count()];
    for column in run.columns().iter().filter(|column| is_temperature_column(&column.name)) {
        for (change, pair) in changes[1..].iter_mut().zip(column.values.windows(2)) {
            *change = change.max((pair[1] - pair[0]).abs());
        }
    }
    changes
}

/// Returns how many times as fast as its clock a run may be played, so that no thermometer is doubted.
///
/// # Errors
/// There is no time.
pub(crate) fn max_playback_speedup(run: &RunFile) -> Result<f64> {
    /// Change that a board takes at once, in K.
    const MAX_TEMPERATURE_STEP_C: f64 = 0.5;
    let times = run.require_column("time_s")?;
    let changes = max_temperature_changes_c(run);
    let rows = times.windows(2).zip(&changes[1..]).filter(|(_, c)| **c > MAX_TEMPERATURE_STEP_C);
    let most = rows.map(|(pair, c)| {
        TEMPERATURE_SLEW_C_PER_S * (pair[1] - pair[0]) / (c - MAX_TEMPERATURE_STEP_C)
    });
    Ok(most.fold(f64::INFINITY, f64::min))
}

/// Returns temperatures on the way from one row to the next: a mass does not jump, and a board doubts one that does.
#[allow(clippy::cast_possible_truncation, reason = "between two integers")]
fn interpolate_temperatures(
    from: RawTemperatures,
    to: RawTemperatures,
    share: f64,
) -> RawTemperatures {
    let share = share.min(1.0);
    std::array::from_fn(|channel| {
        let (RawTemperatureReading(from), RawTemperatureReading(to)) = (from[channel], to[channel]);
        RawTemperatureReading(
            (f64::from(from) + share * (f64::from(to) - f64::from(from))).round() as i32
        )
    })
}

fn mean_offset_and_worst_quality(outputs: &[Output]) -> Option<(Option<[f64; 3]>, OffsetQuality)> {
    let quality =
        outputs.iter().map(|output| output.quality).max_by_key(|quality| *quality as u8)?;
    let mut sum_nm = [0.0; 3];
    for output in outputs {
        let Some(offset) = output.offset else { return Some((None, quality)) };
        sum_nm.iter_mut().zip(offset).for_each(|(sum, nm)| *sum += f64::from(nm.0));
    }
    let count = outputs.len() as f64;
    Some((Some(sum_nm.map(|nm| nm / count / 1000.0)), quality))
}

/// That every required row has an offset that follows the error.
///
/// # Errors
/// A row has none, with its number and the message of the board.
pub fn check_offsets(played: &PlaybackRecord, is_selected: impl Fn(usize) -> bool) -> Result<()> {
    let bad = |row: &usize| !(1..=3).contains(&played.quality[*row]);
    match (0..played.quality.len()).filter(|row| is_selected(*row)).find(bad) {
        None => Ok(()),
        Some(row) => Err(anyhow::anyhow!("quality {} in row {}", played.quality[row], row + 1))
            .context("the board gives no offset"),
    }
}
