//! `trueup diagnose --next`: the run that comes next, as a program and a run file.

use std::path::Path;

use anyhow::Result;
use trueup_diagnose::{Diagnosis, NoNext};
use trueup_program::{Stretch, control, speeds, template};

use crate::{output, program::For, report};

/// Writes it into the folder `out`, or says why there is none.
pub fn write(diagnosis: &Diagnosis, control: For, out: &Path, as_json: bool) -> Result<()> {
    let next = match diagnosis.next() {
        Ok(next) => next,
        Err(why @ NoNext::NothingOpen) => {
            return if as_json { Ok(()) } else { output::print(format_args!("next run: {why}")) };
        }
        Err(why) => {
            report::warn(format_args!("no next run: {why}"));
            return Ok(());
        }
    };
    let stretches: Vec<Stretch> = next
        .stretches
        .iter()
        .map(|it| Stretch { rpm: it.rpm, minutes: it.minutes, load_n: it.load_n })
        .collect();
    let told = &next.told[0];
    let why = format!("To tell {} from {}.", told.causes[0], told.causes[1]);
    let plan = speeds(&stretches, next.every_s, &next.inputs, &why);
    let (name, text) = control::program(&plan, control.control());
    let mut texts = vec![
        (name.clone(), text),
        ("next.json".into(), serde_json::to_string_pretty(&next)? + "\n"),
    ];
    texts.extend(template::templates(&plan));
    for (file, text) in texts {
        output::write_measurement(&out.join(file), &[], &text)?;
    }
    if as_json {
        return Ok(());
    }
    output::print(format_args!(
        "next run, {:.0} minutes: {}\n{}, {}",
        next.minutes,
        next.sentence(),
        out.join(name).display(),
        out.join("next.csv").display()
    ))
}
