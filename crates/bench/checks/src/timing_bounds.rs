//! The bounds of time of the flashable image, next to what its model has seen.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::{Context as _, Result, bail};
use trueup_bounds::{
    clock_configuration,
    declarations::CalibrationSizes,
    flow_facts::FIRMWARE_DECLARATIONS,
    image::FirmwareImage,
    path_report,
    report::{self, TimingBounds},
    source_code::SourceCode,
};
use trueup_emulator::{
    chip, firmware_images,
    full_load::{self, CLOCK_SCENARIOS},
    setup,
};

/// Returns the bounds of an image, for calibrations without terms: the paper's is one.
///
/// # Errors
/// The image or the table of tasks cannot be read.
pub fn compute_bounds(image: &Path) -> Result<TimingBounds> {
    compute_task_timing_bounds(image, CalibrationSizes::EMPTY)
}

fn compute_task_timing_bounds(image: &Path, sizes: CalibrationSizes) -> Result<TimingBounds> {
    let root = setup::project_root();
    let app = fs::read_to_string(root.join("src/main.rs"))?;
    report::compute_timing_bounds(
        &FirmwareImage::read(image)?,
        &app,
        &FIRMWARE_DECLARATIONS,
        &SourceCode::new(root),
        sizes,
    )
}

/// Builds the image with the paper's machine and returns the longest path of a task as a table; `is_largest`: with the largest
/// calibration.
///
/// # Errors
/// There is no such task or clock, or the image does not build.
pub fn build_longest_path_report(task: &str, mhz: u32, is_largest: bool) -> Result<String> {
    let clock =
        clock_configuration::CLOCK_CONFIGURATIONS.into_iter().find(|clock| clock.mhz == mhz);
    let clock = clock.with_context(|| format!("{mhz} MHz is no clock of the board"))?;
    let root = setup::project_root();
    let app = fs::read_to_string(root.join("src/main.rs"))?;
    let image = FirmwareImage::read(&firmware_images::build_standalone_image(
        &root.join("data/paper_spindle.toml"),
    )?)?;
    let sizes = if is_largest { CalibrationSizes::MAX } else { CalibrationSizes::EMPTY };
    path_report::format_longest_path_of_task(
        &image,
        &app,
        &FIRMWARE_DECLARATIONS,
        &SourceCode::new(root),
        sizes,
        clock,
        task,
    )
}

/// Builds the image with the paper's machine, bounds its tasks on every clock, and returns them as a table, next to the
/// longest turns that the model of the chip sees with all lines busy.
///
/// # Errors
/// A loop has no bound or a call no target; what is named. The image does not build, or cannot be run.
pub fn build_timing_report() -> Result<String> {
    let image = firmware_images::build_standalone_image(
        &setup::project_root().join("data/paper_spindle.toml"),
    )?;
    let bounds = compute_bounds(&image)?;
    if !bounds.problems.is_empty() {
        bail!("{}", bounds.problems.join("\n"));
    }
    let mut seen = BTreeMap::new();
    if let Some(model) = chip::build_model()? {
        for clock in &CLOCK_SCENARIOS {
            let report = full_load::run(&model, &image, clock, 0)?;
            seen.insert(clock.0, full_load::parse_max_handler_times_us(&report));
        }
    }
    let mut text = bounds.format_table(|bound| {
        seen.get(bound.clock).and_then(|turns| turns.get(&bound.exception)).copied()
    });
    for unused in &bounds.unused {
        text += &format!("declared, but not needed: {unused}\n");
    }
    let largest = compute_task_timing_bounds(&image, CalibrationSizes::MAX)?;
    text += "\nWith the largest calibration, 16 terms and 32 tools:\n";
    text += &largest.format_table(|_| None);
    Ok(text)
}
