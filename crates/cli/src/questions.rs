//! The questions of `trueup new`, for what its flags have not said.

use anyhow::Result;
use dialoguer::{Confirm, Input, Select};
use trueup_machine::{
    file::{Feedback, Kind, LinearAxis, RotaryAxis},
    template::{Control, Sheet, Template},
};

/// What the flags have said: it is not asked for.
pub struct Said {
    pub name: bool,
    pub kind: bool,
    pub axes: bool,
    pub feedback: bool,
    pub rapid: bool,
    pub sensor: bool,
    pub thermometers: bool,
    pub control: bool,
}

/// A number of a user's.
pub fn finite(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| "must be a number, with a point for decimals".into())
}

/// The ends of a travel, `0:600`.
pub fn ends(text: &str) -> Result<[f64; 2], String> {
    let (from, to) = text.split_once(':').ok_or("must be the two ends in mm: 0:600")?;
    let (from, to) = (finite(from.trim())?, finite(to.trim())?);
    if from < to { Ok([from, to]) } else { Err("the lower end stands first: 0:600".into()) }
}

/// A word that a column may be named by.
pub fn word(text: &str) -> Result<String, String> {
    let text = text.trim().to_lowercase();
    let is_word = !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if is_word { Ok(text) } else { Err("must be a word of letters and digits: screw".into()) }
}

/// The axes of the head of the usual machine of its kind.
pub fn usual_head(kind: Kind) -> Vec<RotaryAxis> {
    match kind {
        Kind::HeadHead => vec![RotaryAxis::C, RotaryAxis::A],
        Kind::HeadTable => vec![RotaryAxis::A],
        Kind::ThreeAxis | Kind::TableTable => Vec::new(),
    }
}

/// The template with the answers in it; an empty answer keeps what is offered.
pub fn ask(mut template: Template, said: &Said) -> Result<Template> {
    if !said.name {
        template.name = Input::new()
            .with_prompt("Name of the machine")
            .default(template.name)
            .interact_text()?;
    }
    if !said.kind {
        template.kind = choose(
            "Rotary axes",
            &[
                ("none: X, Y and Z only", Kind::ThreeAxis),
                ("two carry the spindle", Kind::HeadHead),
                ("one carries the spindle, one the workpiece", Kind::HeadTable),
                ("two carry the workpiece", Kind::TableTable),
            ],
        )?;
        template.head_axes = usual_head(template.kind);
    }
    if !said.axes {
        for axis in LinearAxis::ALL {
            let text: String = Input::new()
                .with_prompt(format!(
                    "Travel of {} in mm, as 0:600 (empty: leave it out)",
                    axis.name().to_uppercase()
                ))
                .allow_empty(true)
                .validate_with(
                    |text: &String| if text.is_empty() { Ok(()) } else { ends(text).map(drop) },
                )
                .interact_text()?;
            template.axes.extend(ends(&text).ok().map(|ends| (axis, ends)));
        }
    }
    if !said.feedback {
        let places = [
            ("on the motor or screw", Feedback::Screw),
            ("by a scale on the axis", Feedback::Scale),
        ];
        template.feedback = choose("Where are positions measured?", &places)?;
    }
    if !said.rapid {
        template.rapid_mm_per_min =
            number("Rapid traverse in mm/min (empty: not known)")?.filter(|it| *it > 0.0);
    }
    let prompt = "Is there a displacement sensor at the spindle?";
    if !said.sensor && Confirm::new().with_prompt(prompt).default(true).interact()? {
        template.sensor = Some(sensor()?);
    }
    while !said.thermometers && template.thermometers.len() < 8 {
        let text: String = Input::new()
            .with_prompt("A PT100 and where it is, as screw (empty: no more)")
            .allow_empty(true)
            .validate_with(
                |text: &String| if text.is_empty() { Ok(()) } else { word(text).map(drop) },
            )
            .interact_text()?;
        match word(&text) {
            Ok(word) => template.thermometers.push(word),
            Err(_) => break,
        }
    }
    if !said.control {
        let controls = [
            ("LinuxCNC", Control::LinuxCnc),
            ("Siemens 840D", Control::Siemens),
            ("FANUC", Control::Fanuc),
            ("Heidenhain", Control::Heidenhain),
        ];
        template.control = choose("Control", &controls)?;
    }
    Ok(template)
}

fn sensor() -> Result<Sheet> {
    let number = |prompt: &str, default: f64| -> Result<f64> {
        Ok(Input::new().with_prompt(prompt).default(default).interact_text()?)
    };
    let volts_full_scale = number("Its output at the end of its range, in V", 10.0)?;
    let um_per_v = number("µm for one volt (data sheet: range in µm / volts)", 50.0)?;
    let zero_v =
        number("What a voltmeter shows when the machine is cold, in V", volts_full_scale / 2.0)?;
    Ok(Sheet { volts_full_scale, um_per_v, zero_v })
}

fn number(prompt: &str) -> Result<Option<f64>> {
    let text: String = Input::new()
        .with_prompt(prompt)
        .allow_empty(true)
        .validate_with(
            |text: &String| if text.is_empty() { Ok(()) } else { finite(text).map(drop) },
        )
        .interact_text()?;
    Ok(finite(&text).ok())
}

fn choose<T: Copy>(prompt: &str, choices: &[(&str, T)]) -> Result<T> {
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
    let chosen = Select::new().with_prompt(prompt).items(&names).default(0).interact()?;
    Ok(choices[chosen].1)
}
