//! The questions of `trueup new`, for what its flags have not said.

use anyhow::{Error, Result};
use dialoguer::{Confirm, Input, Select};
use trueup_machine::{
    file::{Feedback, Kind, LinearAxis, RotaryAxis},
    inputs::LAST_CHANNEL,
    template::{Control, Sheet, Template},
};

/// As many channels has the board.
const MOST_THERMOMETERS: usize = LAST_CHANNEL as usize + 1;

/// What the flags have said: it is not asked for.
pub struct Said {
    pub name: bool,
    pub kind: bool,
    pub head_axes: bool,
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

/// A number of a user's that must be above 0.
pub fn above_zero(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value > 0.0 { Ok(value) } else { Err("must be above 0".into()) }
}

/// A number of a user's that must not be 0.
pub fn not_zero(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value != 0.0 { Ok(value) } else { Err("must not be 0".into()) }
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

/// The rotary axes of a head, `c,a`: as many as the kind has.
fn head(text: &str, kind: Kind) -> Result<Vec<RotaryAxis>, String> {
    let axis = |name: &str| {
        let name = name.trim().to_lowercase();
        RotaryAxis::ALL.into_iter().find(|axis| axis.name() == name)
    };
    let axes: Option<Vec<RotaryAxis>> = text.split(',').map(axis).collect();
    let usual = usual_head(kind);
    let is_whole = |axes: &Vec<RotaryAxis>| {
        axes.len() == usual.len()
            && axes.iter().enumerate().all(|(at, axis)| !axes[..at].contains(axis))
    };
    let rule = if usual.len() == 2 {
        "must be two of a, b and c, from the frame to the tool: c,a"
    } else {
        "must be a, b or c"
    };
    axes.filter(is_whole).ok_or_else(|| rule.into())
}

/// The axes of the head of the usual machine of its kind.
pub fn usual_head(kind: Kind) -> Vec<RotaryAxis> {
    match kind {
        Kind::HeadHead => vec![RotaryAxis::C, RotaryAxis::A],
        Kind::HeadTable => vec![RotaryAxis::A],
        Kind::ThreeAxis | Kind::TableTable => Vec::new(),
    }
}

/// The template with the answers in it; an empty answer keeps what is offered. What cannot be is asked for
/// again at once: nobody is to answer ten questions twice.
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
    }
    if !said.head_axes {
        let kind = template.kind;
        let usual: Vec<&str> = usual_head(kind).iter().map(|axis| axis.name()).collect();
        template.head_axes = match usual.len() {
            0 => Vec::new(),
            1 => needed("Which one carries the spindle", &usual[0], |text| head(text, kind))?,
            _ => needed(
                "Which ones carry the spindle, from the frame to the tool",
                &usual.join(","),
                |text| head(text, kind),
            )?,
        };
    }
    if !said.axes {
        for axis in LinearAxis::ALL {
            let prompt = format!("Travel of {} in mm, as 0:600", axis.name().to_uppercase());
            template.axes.extend(wanted(&prompt, "leave it out", ends)?.map(|ends| (axis, ends)));
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
        template.rapid_mm_per_min = wanted("Rapid traverse in mm/min", "not known", above_zero)?;
    }
    let prompt = "Is there a displacement sensor at the spindle?";
    if !said.sensor && Confirm::new().with_prompt(prompt).default(true).interact()? {
        template.sensor = Some(sensor()?);
    }
    while !said.thermometers && template.thermometers.len() < MOST_THERMOMETERS {
        let before = template.thermometers.clone();
        let new = |text: &str| {
            word(text).and_then(|word| match before.contains(&word) {
                true => Err(format!("there is a {word} already")),
                false => Ok(word),
            })
        };
        match wanted("A PT100 and where it is, as screw", "no more", new)? {
            Some(word) => template.thermometers.push(word),
            None => break,
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
    let volts_full_scale = needed("Its output at the end of its range, in V", &"10", above_zero)?;
    let um_per_v = needed("µm for one volt (data sheet: range in µm / volts)", &"50", not_zero)?;
    let within = |text: &str| match finite(text)? {
        volts if (0.0..=volts_full_scale).contains(&volts) => Ok(volts),
        _ => Err(format!("must be from 0 to {volts_full_scale} V")),
    };
    let half = volts_full_scale / 2.0;
    let zero_v = needed("What a voltmeter shows when the machine is cold, in V", &half, within)?;
    Ok(Sheet { volts_full_scale, um_per_v, zero_v })
}

/// An answer that is read by `read`; nothing is `usual`.
fn needed<T>(
    prompt: &str,
    usual: &impl ToString,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<T> {
    let text: String = Input::new()
        .with_prompt(prompt)
        .default(usual.to_string())
        .validate_with(|text: &String| read(text.trim()).map(drop))
        .interact_text()?;
    read(text.trim()).map_err(Error::msg)
}

/// An answer that is read by `read`; nothing is `None`, which means `what`.
fn wanted<T>(
    prompt: &str,
    what: &str,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<Option<T>> {
    let read = |text: &str| match text.trim() {
        "" => Ok(None),
        text => read(text).map(Some),
    };
    let text: String = Input::new()
        .with_prompt(format!("{prompt} (empty: {what})"))
        .allow_empty(true)
        .validate_with(|text: &String| read(text).map(drop))
        .interact_text()?;
    read(&text).map_err(Error::msg)
}

fn choose<T: Copy>(prompt: &str, choices: &[(&str, T)]) -> Result<T> {
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
    let chosen = Select::new().with_prompt(prompt).items(&names).default(0).interact()?;
    Ok(choices[chosen].1)
}
