//! The real LinuxCNC with the image that is flashed as its bridge, on the model of the chip: the same path,
//! the same warm-up, the same reductions as with the board in QEMU, by the same code.

use anyhow::{Context as _, Result, ensure};
use trueup_emulator::linuxcnc::{self, On, figures::Figures};

/// A reduction may differ by so many points. The instruments' noise, and how far an offset is behind
/// when a busy computer wakes its sender late, differ from run to run.
const MARGIN_POINTS: f64 = 1.5;

/// A run in which all is reached. Without a real-time kernel LinuxCNC starves on a busy computer, and the run
/// is worth nothing: then a second one.
fn reached(on: On) -> Result<Option<Figures>> {
    let run = || -> Result<Option<Figures>> {
        let figures = linuxcnc::run(on)?;
        if let Some(figures) = &figures {
            println!("{on:?}\n{}", figures.table());
            figures.check()?;
        }
        Ok(figures)
    };
    run().or_else(|error| {
        println!("{error:#}; trying again");
        run()
    })
}

#[test]
#[ignore = "campaign: LinuxCNC cuts twice, once as slowly as the model of the chip is"]
fn campaign_the_image_that_is_flashed_corrects_linuxcnc_as_the_board_in_qemu_does() -> Result<()> {
    let Some(chip) = reached(On::Chip)? else {
        println!("skipped: there is no LinuxCNC here, or the compiler is too old for the chip");
        return Ok(());
    };
    let qemu = reached(On::Qemu)?.context("it has just been there")?;
    for (on_chip, in_qemu) in chip.checks.iter().zip(&qemu.checks) {
        let (name, apart) = (on_chip.name, on_chip.value - in_qemu.value);
        ensure!(name == in_qemu.name, "{name} is not {}", in_qemu.name);
        ensure!(
            on_chip.unit != "%" || apart.abs() <= MARGIN_POINTS,
            "{name}: {:.2} % on the chip, {:.2} % in QEMU",
            on_chip.value,
            in_qemu.value
        );
    }
    Ok(())
}
