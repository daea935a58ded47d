//! Time and memory of a diagnosis by the number of rows, 20 columns wide.
//!
//! ```text
//! cargo run --release -p trueup-diagnose --example speed
//! cargo run --release -p trueup-diagnose --example speed -- against OTHER
//! ```
//!
//! A spindle whose growth lags behind its thermometer; the same with a gain, the speed, the load and another part's
//! heat besides; and an axis with a wrong slope, a screw's wave and a backlash; each in a process of its own, from
//! reading the file to the answer. Times are those of this computer: the ratio from line to line is what counts; or
//! `against` this example of another version, built before, on the same files, in turn, the least of five times each, of
//! the longest once.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example prints its result")]

use std::{
    env, fs,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    process::{Command, ExitCode},
    time::Instant,
};

use trueup_diagnose::diagnose;
use trueup_machine::{MachineFile, RunFile};

const ROW_COUNTS: [usize; 3] = [10_000, 100_000, 1_000_000];
/// Times that each version is timed next to another one; once of the longest run.
const TIMING_REPETITIONS: usize = 5;
/// Thermometers that have nothing to do with anything.
const UNRELATED_SENSOR_COUNT: usize = 13;
const MACHINE_TOML: &str = "[machine]\nname = \"speed\"\nkind = \"3-axis\"\n";
const SPINDLE_TOML: &str = "[spindle]\nsource = \"temperature\"\n[spindle.temperature]\nsensor = \
                       \"temp_own_c\"\nreference_c = 20.0\nk_um_per_c = 2.0\n";
const AXIS_TOML: &str = "[axis.x.thermal]\nmode = \"position\"\nsensor = \"temp_own_c\"\nreference_c = \
                    20.0\nslope_um_per_m_per_c = 8.0\n";

/// Numbers that look drawn, −1…1 (splitmix64).
struct SplitMix64(u64);

impl SplitMix64 {
    fn next_uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Returns a run of this many rows, the same record whether it was taken often or seldom.
fn write_run_file(path: &Path, kind: &str, rows: usize) -> std::io::Result<()> {
    let (is_axis, has_more) = (kind == "axis", kind == "five-causes");
    let mut out = BufWriter::new(fs::File::create(path)?);
    let idle: String = (0..UNRELATED_SENSOR_COUNT).map(|n| format!(",temp_idle{n}_c")).collect();
    if is_axis {
        writeln!(out, "time_s,x_mm,dir_x,temp_own_c{idle},humidity,pressure,measured_dx_um")?;
    } else {
        writeln!(
            out,
            "time_s,spindle_rpm,load_n,temp_own_c{idle},humidity,pressure,measured_elongation_um"
        )?;
    }
    let mut drawn = SplitMix64(rows as u64);
    let record_s = 36_000.0;
    let step_s = record_s / rows as f64;
    let (mut warmth, mut lagged) = (0.0, 0.0);
    let mut walks = [0.0_f64; UNRELATED_SENSOR_COUNT];
    for row in 0..rows {
        let time_s = row as f64 * step_s;
        // Eight working conditions.
        let rpm = [0.0, 9000.0, 3000.0, 12000.0, 0.0, 6000.0, 12000.0, 1500.0][row * 8 / rows];
        let share = |lag_s: f64| -(-step_s / lag_s).exp_m1();
        warmth += (rpm / 1000.0 - warmth) * share(1500.0);
        lagged += (warmth - lagged) * share(800.0);
        walks
            .iter_mut()
            .for_each(|walk| *walk += 0.5 * step_s.sqrt() / 60.0 * drawn.next_uniform());
        let idle: String = walks.iter().map(|walk| format!(",{:.2}", 20.0 + walk)).collect();
        let own_c = 20.0 + warmth + 0.02 * drawn.next_uniform();
        let noise = 0.5 * (drawn.next_uniform() + drawn.next_uniform());
        let [humidity, pressure] = [45.0 + drawn.next_uniform(), 1013.0 + drawn.next_uniform()];
        if is_axis {
            // Fifty travels there and back, at speeds that do not repeat.
            let phase = (row as f64 / rows as f64 * 50.0).fract() * 2.0;
            let (mm, dir) = if phase < 1.0 { (phase, 1) } else { (2.0 - phase, -1) };
            let mm = 500.0 * mm;
            let error = 10.0 * warmth * mm / 1000.0
                + 3.0 * (std::f64::consts::TAU * mm / 10.0).sin()
                + if dir < 0 { 4.0 } else { 0.0 };
            let y = error + noise;
            writeln!(
                out,
                "{time_s:.4},{mm:.4},{dir},{own_c:.2}{idle},{humidity:.1},{pressure:.1},{y:.2}"
            )?;
        } else {
            let cuts = !has_more || (time_s / 300.0) as u32 % 2 == 1;
            let load = if rpm > 0.0 && cuts { 200.0 + 100.0 * drawn.next_uniform() } else { 0.0 };
            let krpm: f64 = rpm / 1000.0;
            let more = 0.3 * lagged + 0.03 * krpm * krpm - 0.008 * load + 0.8 * walks[3];
            let y = 2.0 * lagged + noise + if has_more { more } else { 0.0 };
            writeln!(
                out,
                "{time_s:.4},{rpm},{load:.0},{own_c:.2}{idle},{humidity:.1},{pressure:.1},{y:.2}"
            )?;
        }
    }
    out.flush()
}

/// Returns the most memory that this process has held, in MB, where the system says.
fn peak_memory_mb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.map_or(f64::NAN, |kilobytes| kilobytes / 1000.0)
}

/// Diagnoses one file, and prints seconds, megabytes and what was found.
fn benchmark_file(path: &Path, is_axis: bool) -> Result<(), Box<dyn std::error::Error>> {
    let text = format!("{MACHINE_TOML}{}", if is_axis { AXIS_TOML } else { SPINDLE_TOML });
    let machine = MachineFile::parse(&text, Path::new("speed.toml"))?;
    let start = Instant::now();
    let run = RunFile::read(path)?;
    let diagnosis = diagnose(&machine, &[run], &[], None, &mut |_, _| {})?;
    let seconds = start.elapsed().as_secs_f64();
    let causes: Vec<&str> =
        diagnosis.report.findings.iter().map(|finding| finding.cause.as_str()).collect();
    println!("{seconds} {} {}", peak_memory_mb(), causes.join(", "));
    Ok(())
}

/// Seconds, megabytes and causes, of a process of its own of `program`.
fn benchmark_in_process(
    program: &Path,
    name: &str,
    path: &Path,
) -> Result<(f64, f64, String), Box<dyn std::error::Error>> {
    let child = Command::new(program).arg(name).arg(path).output()?;
    if !child.status.success() {
        return Err(String::from_utf8_lossy(&child.stderr).into_owned().into());
    }
    let text = String::from_utf8(child.stdout)?;
    let mut words = text.trim().splitn(3, ' ');
    let mut next = || words.next().unwrap_or_default();
    Ok((next().parse()?, next().parse()?, next().into()))
}

/// Times next to those of the same example of another version.
fn compare_with_program(other: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let path = scratch_path();
    let here = env::current_exe()?;
    println!("                rows   seconds   other s   ratio");
    for name in ["elongation", "five-causes", "axis"] {
        for rows in ROW_COUNTS {
            write_run_file(&path, name, rows)?;
            let mut least = [f64::INFINITY; 2];
            for _ in 0..if rows == ROW_COUNTS[2] { 1 } else { TIMING_REPETITIONS } {
                for (least, program) in least.iter_mut().zip([&*here, other]) {
                    *least = least.min(benchmark_in_process(program, name, &path)?.0);
                }
            }
            let [own, other] = least;
            println!("{name:<11} {rows:>8} {own:>7.2} {other:>9.2} {:>7.2}", own / other);
        }
    }
    fs::remove_file(&path)?;
    Ok(())
}

/// Returns a file that no other process writes.
fn scratch_path() -> PathBuf {
    env::temp_dir().join(format!("trueup-speed-{}.csv", std::process::id()))
}

fn benchmark_all() -> Result<(), Box<dyn std::error::Error>> {
    let (path, here) = (scratch_path(), env::current_exe()?);
    println!("                rows   seconds   ratio   memory MB   found");
    for name in ["elongation", "five-causes", "axis"] {
        let mut before = f64::NAN;
        for rows in ROW_COUNTS {
            write_run_file(&path, name, rows)?;
            let (seconds, memory, found) = benchmark_in_process(&here, name, &path)?;
            let ratio = seconds / before;
            println!("{name:<11} {rows:>8} {seconds:>7.2} {ratio:>7.1} {memory:>9.0}   {found}");
            before = seconds;
        }
    }
    fs::remove_file(&path)?;
    Ok(())
}

fn main() -> ExitCode {
    let words: Vec<String> = env::args().skip(1).collect();
    let done = match &words[..] {
        [] => benchmark_all(),
        [word, other] if word == "against" => compare_with_program(Path::new(other)),
        [kind, path] => benchmark_file(Path::new(path), kind == "axis"),
        _ => Err("speed takes nothing, or `against` and this example of another version".into()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
