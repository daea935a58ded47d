//! The bounds of time of the flashable image, next to what its model has seen.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::{Context as _, Result, bail};
use trueup_bounds::{
    clock,
    firmware::FIRMWARE,
    image::Image,
    path,
    report::{self, Bounds},
    source::Source,
    table::Sizes,
};
use trueup_emulator::{
    busy::{self, CLOCKS},
    chip, firmware, setup,
};

/// Returns the bounds of an image, for calibrations without terms: the paper's is one.
///
/// # Errors
/// The image or the table of tasks cannot be read.
pub fn of(image: &Path) -> Result<Bounds> {
    for_sizes(image, Sizes::NONE)
}

fn for_sizes(image: &Path, sizes: Sizes) -> Result<Bounds> {
    let root = setup::root();
    let app = fs::read_to_string(root.join("src/main.rs"))?;
    report::of(&Image::read(image)?, &app, &FIRMWARE, &Source::new(root), sizes)
}

/// Builds the image with the paper's machine and returns the longest path of a task as a table; `is_largest`: with the largest
/// calibration.
///
/// # Errors
/// There is no such task or clock, or the image does not build.
pub fn path(task: &str, mhz: u32, is_largest: bool) -> Result<String> {
    let clock = clock::CLOCKS.into_iter().find(|clock| clock.mhz == mhz);
    let clock = clock.with_context(|| format!("{mhz} MHz is no clock of the board"))?;
    let root = setup::root();
    let app = fs::read_to_string(root.join("src/main.rs"))?;
    let image = Image::read(&firmware::build_for(&root.join("data/paper_spindle.toml"))?)?;
    let sizes = if is_largest { Sizes::LARGEST } else { Sizes::NONE };
    path::of_task(&image, &app, &FIRMWARE, &Source::new(root), sizes, clock, task)
}

/// Builds the image with the paper's machine, bounds its tasks on every clock, and returns them as a table, next to the
/// longest turns that the model of the chip sees with all lines busy.
///
/// # Errors
/// A loop has no bound or a call no target; what is named. The image does not build, or cannot be run.
pub fn print() -> Result<String> {
    let image = firmware::build_for(&setup::root().join("data/paper_spindle.toml"))?;
    let bounds = of(&image)?;
    if !bounds.problems.is_empty() {
        bail!("{}", bounds.problems.join("\n"));
    }
    let mut seen = BTreeMap::new();
    if let Some(model) = chip::build()? {
        for clock in &CLOCKS {
            let report = busy::run(&model, &image, clock, 0)?;
            seen.insert(clock.0, busy::turns(&report));
        }
    }
    let mut text = bounds.table(|bound| {
        seen.get(bound.clock).and_then(|turns| turns.get(&bound.exception)).copied()
    });
    for unused in &bounds.unused {
        text += &format!("declared, but not needed: {unused}\n");
    }
    let largest = for_sizes(&image, Sizes::LARGEST)?;
    text += "\nWith the largest calibration, 16 terms and 32 tools:\n";
    text += &largest.table(|_| None);
    Ok(text)
}
