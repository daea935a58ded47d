//! Writes a challenge to a folder, to be looked at or tried by hand:
//! `cargo run -p trueup-twin --example challenge -- thermal-lag 3 7 target/challenge`
//! (cause, effect over noise, seed, folder). The answer is printed, and written to no file of the
//! challenge; `effect.csv` has it row by row.

use std::{env, error::Error, fs, path::Path};

use trueup_twin::{
    hidden::{Hidden, draw},
    table::RunTable,
};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [cause, ratio, seed, folder] = &arguments[..] else {
        return Err("give a cause, the effect over the noise, a seed, and a folder".into());
    };
    let names = || Hidden::ALL.iter().map(|cause| cause.name()).collect::<Vec<_>>().join(", ");
    let cause = Hidden::ALL.iter().find(|there| there.name() == cause).ok_or_else(names)?;
    let challenge = draw(*cause, ratio.parse()?, seed.parse()?);
    let folder = Path::new(folder);
    fs::create_dir_all(folder)?;
    for (number, run) in challenge.runs.iter().enumerate() {
        fs::write(folder.join(format!("run{}.csv", number + 1)), run)?;
    }
    fs::write(folder.join("holdout.csv"), &challenge.holdout)?;
    fs::write(folder.join("machine.toml"), &challenge.machine)?;
    let truth = &challenge.truth;
    let mut rows = RunTable::new();
    rows.set("believed_um", 6, truth.believed_um.iter().copied());
    rows.set("effect_um", 6, truth.effect_um.iter().copied());
    fs::write(folder.join("effect.csv"), rows.to_csv())?;
    println!("measured: {}; expected: {:?}", challenge.quantity, truth.expected);
    println!("noise: {:.4} µm RMS, correlation {:.2}", truth.noise_rms_um, truth.noise_rho);
    for effect in &truth.effects {
        println!("{}: {:.4} µm RMS", effect.cause.name(), effect.rms_um);
        for (name, value) in &effect.parameters {
            println!("  {name} = {value}");
        }
        for (name, values) in &effect.tables {
            println!("  {name} = {values:.3?}");
        }
    }
    println!("largest reduction on the hold-out: {:.3}", truth.possible_reduction());
    Ok(())
}
