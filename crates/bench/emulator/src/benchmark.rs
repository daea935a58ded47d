//! The benchmark on the emulated board: how many instructions its work takes, and whether it sends
//! the same frames as the host.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    path::Path,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail, ensure};
use rand::{Rng as _, SeedableRng as _};
use serde_json::{Value, json};
use trueup_core::curve::CURVE_SEGMENT_SIZE;
use trueup_machine::{MachineFile, compile, compile::CompiledCalibration};
use trueup_node::test_vectors;

use crate::{
    firmware_images::{self, Board},
    memory_usage,
    qemu::QemuProcess,
    setup,
};

/// Vectors over which board and host are compared.
pub const TEST_VECTOR_COUNT: u32 = 1_000_000;
/// Longer than the slowest machine needs for [`TEST_VECTOR_COUNT`].
const BENCHMARK_TIMEOUT: Duration = Duration::from_secs(1_200);

/// The measured figures, in the form of `measure.json` and as a table.
pub struct BenchmarkReport {
    /// The figures of `measure.json`.
    pub json: Value,
    /// Them, and the other messages of the board, for people.
    pub table: String,
    /// Whether the checksums agree.
    pub identical: bool,
}

impl BenchmarkReport {
    /// Prints the table and writes `target/measure/measure.json`.
    ///
    /// # Errors
    /// Board and host disagree, or the file cannot be written.
    pub fn print_and_write_json(&self) -> Result<()> {
        let folder = setup::project_root().join("target/measure");
        fs::create_dir_all(&folder)?;
        let text = serde_json::to_string_pretty(&self.json)? + "\n";
        fs::write(folder.join("measure.json"), text)?;
        trueup_output::write_line_best_effort(&self.table);
        trueup_output::write_line_best_effort("The figures: target/measure/measure.json");
        ensure!(self.identical, "the board does not send what the host sends");
        Ok(())
    }
}

/// Builds the image, runs it over this many vectors, and compares.
///
/// # Errors
/// Something does not build, or the board does not come to its end.
pub fn run_benchmark(vectors: u32) -> Result<BenchmarkReport> {
    let gantry = setup::project_root().join("data/gantry.toml");
    let machine = compile(&MachineFile::read(&gantry)?)?;
    let by_tool = fs::read_to_string(&gantry)? + &build_tool_terms_toml();
    let by_tool = compile(&MachineFile::parse(&by_tool, Path::new("by_tool.toml"))?)?;
    let curves = MachineFile::parse(&build_curve_machine_toml(), Path::new("curves.toml"))?;
    let curves = compile(&curves)?;
    let image = firmware_images::build_benchmark_image()?;
    let blobs = [machine.blob(), by_tool.blob(), curves.blob()];
    let numbers = run_in_qemu(&image, blobs, vectors)?;
    let is_same = |name: &str, compiled: &CompiledCalibration| -> Result<bool> {
        Ok(table_value(&numbers, name, 0)?
            == test_vectors::compute_checksum(compiled.calibration(), vectors))
    };
    let identical = is_same("checksum", &machine)? && is_same("checksum_by_tool", &by_tool)?;
    let size =
        memory_usage::measure_memory_usage(&firmware_images::build_board_image(Board::Stm32f405)?)?;

    let (mut segments, mut bytes) = (0, 0);
    for curve in machine.calibration().straightness {
        segments += curve.segments().len();
        bytes += curve.segments().len() * CURVE_SEGMENT_SIZE + curve.index().len() * 2;
    }
    let at = |name: &str, place| table_value(&numbers, name, place);
    let spread = |name: &str| {
        let [min, median, max] = [at(name, 0)?, at(name, 1)?, at(name, 2)?];
        Ok::<_, anyhow::Error>(json!({"min": min, "median": median, "max": max}))
    };
    let worst =
        |name: &str, place| Ok::<_, anyhow::Error>(at(name, place)?.max(at(name, place + 4)?));
    let per_segment = (bytes as f64 / segments as f64 * 100.0).round() / 100.0;
    let per_sample = at("filter", 1)? as f64 / 20.0;
    let json = json!({
        "tick_instructions": spread("tick")?,
        "tick_by_tool_instructions": spread("tick_by_tool")?,
        "receive_instructions": spread("receive")?,
        "millisecond_instructions": spread("millisecond")?,
        "millisecond_volume_instructions": spread("millisecond_volume")?,
        "parts": {
            "filter_per_sample": per_sample,
            "health": at("health", 1)?,
            "window": at("window", 1)?,
            "moved": at("moved", 1)?,
            "moved_volume": at("moved_volume", 1)?,
            "turned_volume": at("turned_volume", 1)?,
            "added_up": at("added_up", 1)?,
            "added_up_volume": at("added_up_volume", 1)?,
            "elongation": at("elongation", 1)?,
            "thermal": at("thermal", 1)?,
            "straightness6": at("straightness6", 1)?,
            "pitch3": at("pitch3", 1)?,
            "tool_direction": at("tool_direction", 1)?,
            "limits": at("limits", 1)?,
            "frames": at("frames", 1)?,
        },
        "spline_eval": {
            "ours": worst("curve", 1)?,
            "ours_max": worst("curve", 2)?,
            "de_boor_f32": worst("de_boor", 1)?,
            "linear_table_f32": worst("linear", 1)?,
        },
        "flash_bytes": size.flash,
        "ram_bytes": size.ram,
        "calibration_bytes_per_segment": per_segment,
        "host_vectors_identical": if identical { vectors } else { 0 },
    });

    let mut table = String::from("instructions      min  median     max\n");
    for (name, values) in &numbers {
        if let [min, median, max] = values[..] {
            writeln!(table, "{name:<14} {min:>6}  {median:>6}  {max:>6}")?;
        }
    }
    for name in ["curve", "de_boor", "linear"] {
        for part in numbers.get(name).context("curves")?.chunks(4) {
            if let [min, median, max, segments] = part {
                let name = format!("{name} {segments}");
                writeln!(table, "{name:<14} {min:>6}  {median:>6}  {max:>6}")?;
            }
        }
    }
    let live = numbers.get("live").context("live")?;
    let same = if identical { "the same" } else { "NOT THE SAME" };
    writeln!(
        table,
        "live in {live:?} ticks; de Boor, table apart by {:?}/256 nm",
        numbers["apart"]
    )?;
    writeln!(table, "flash {} B, RAM {} B, {per_segment} B a segment", size.flash, size.ram)?;
    write!(table, "frames of {vectors} vectors: {same} as on the host")?;
    Ok(BenchmarkReport { json, table, identical })
}

/// Runs the image to its end and gives what it has written.
fn run_in_qemu(image: &Path, blobs: [&[u8]; 3], vectors: u32) -> Result<BenchmarkTable> {
    setup::ensure_qemu()?;
    let arguments = ["-icount", "shift=0", "-semihosting-config", "enable=on,target=native"];
    let mut qemu = QemuProcess::start(image, &arguments, |folder| {
        for (name, blob) in ["calibration.bin", "by_tool.bin", "curves.bin"].iter().zip(blobs) {
            fs::write(folder.join(name), blob)?;
        }
        Ok(fs::write(folder.join("vectors"), vectors.to_le_bytes())?)
    })?;
    let end = Instant::now() + BENCHMARK_TIMEOUT;
    let ended = loop {
        match qemu.check_running() {
            Err(ended) => break ended,
            Ok(()) if Instant::now() > end => bail!("the board does not come to its end"),
            Ok(()) => thread::sleep(Duration::from_millis(50)),
        }
    };
    let Ok(text) = fs::read_to_string(qemu.path("numbers")) else { return Err(ended) };
    let mut numbers = BenchmarkTable::new();
    for line in text.lines() {
        let mut words = line.split_whitespace();
        let name = words.next().unwrap_or_default();
        let values = numbers.entry(name.to_owned()).or_default();
        for word in words {
            values.push(word.parse().with_context(|| format!("the board wrote `{line}`"))?);
        }
    }
    Ok(numbers)
}

type BenchmarkTable = BTreeMap<String, Vec<u64>>;

fn table_value(numbers: &BenchmarkTable, name: &str, place: usize) -> Result<u64> {
    let values = numbers.get(name).with_context(|| format!("the board does not say {name}"))?;
    values.get(place).copied().with_context(|| format!("the board says too little of {name}"))
}

/// Four terms for the gantry: the growth of 32 tools, a condition, one behind a lag, and one that is a factor on the
/// growth.
fn build_tool_terms_toml() -> String {
    let mut text = String::from(
        "\n[inputs.coolant_on]\nkind = \"condition\"\nbit = 0\n[inputs.door_open]\nkind = \"condition\"\nbit = 9\n\
         [inputs.clamp]\nkind = \"condition\"\nbit = 15\n[spindle.tools]\ndefault = { um_per_krpm2 = 0.01 }\n",
    );
    for tool in 1..=32 {
        text += &format!("{tool} = {{ um_per_krpm2 = {} }}\n", 0.001 * f64::from(tool - 16));
    }
    for (quantity, column, more) in [
        ("elongation", "coolant_on", "level_um = [0.0, 3.0]\nlag_s = 60.0"),
        ("dx", "door_open", "level_um = [0.0, -2.0]"),
        ("elongation", "clamp", "times = \"growth\"\nlevel_factor = [0.0, 0.05]"),
    ] {
        text += &format!(
            "[[term]]\ncause = \"dependence\"\nquantity = \"{quantity}\"\ncolumn = \"{column}\"\nform = \"level\"\n\
             levels = [0.0, 1.0]\n{more}\n"
        );
    }
    text
}

/// Returns a machine with a curve of 8 segments and one of 512, knots 0.5 to 1.5 of their mean apart.
fn build_curve_machine_toml() -> String {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let mut text = String::from("[machine]\nname = \"curves\"\nkind = \"3-axis\"\n");
    for (name, segments, mean_mm) in [("y_of_x", 512, 25.0), ("z_of_x", 8, 1_600.0)] {
        let mut at = 0.0;
        let mut knots = vec![0.0; 4];
        for _ in 0..segments {
            at += mean_mm * random.random_range(0.5..1.5);
            at = f64::round(at * 1e4) / 1e4;
            knots.push(at);
        }
        knots.extend([at; 3]);
        let control: Vec<f64> =
            (0..segments + 3).map(|_| random.random_range(-20.0..20.0)).collect();
        text += &format!(
            "\n[straightness.{name}]\norder = 4\nknots_mm = {knots:?}\ncontrol_um = {control:?}\n"
        );
    }
    text
}
