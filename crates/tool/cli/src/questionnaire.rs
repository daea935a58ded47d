//! The questions of `trueup new`, for what its flags do not state. `<` goes back to the question before.

use anyhow::{Error, Result};
use dialoguer::{Input, Select};
use trueup_machine::{
    inputs::MAX_TEMPERATURE_CHANNEL,
    machine_file::{Feedback, LinearAxis, MachineKind, RotaryAxis},
    template::{CncControl, MachineTemplate, SensorDataSheet},
};

/// As many channels has the board.
const MAX_THERMOMETERS: usize = MAX_TEMPERATURE_CHANNEL as usize + 1;

/// Questions that the flags have answered: they are not asked.
pub struct AnsweredQuestions {
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

/// Returns a number of a user's.
pub fn parse_finite(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| "must be a number, with a point for decimals".into())
}

/// Returns a number of a user's that must be above 0.
pub fn parse_positive(text: &str) -> Result<f64, String> {
    let value = parse_finite(text)?;
    if value > 0.0 { Ok(value) } else { Err("must be above 0".into()) }
}

/// Returns a number of a user's that must not be 0.
pub fn parse_nonzero(text: &str) -> Result<f64, String> {
    let value = parse_finite(text)?;
    if value != 0.0 { Ok(value) } else { Err("must not be 0".into()) }
}

/// Returns the ends of a travel, `0:600`.
pub fn parse_travel(text: &str) -> Result<[f64; 2], String> {
    let (from, to) = text.split_once(':').ok_or("must be the two ends in mm: 0:600")?;
    let (from, to) = (parse_finite(from.trim())?, parse_finite(to.trim())?);
    if from < to { Ok([from, to]) } else { Err("the lower end stands first: 0:600".into()) }
}

/// Returns a word that a column may be named by.
pub fn parse_column_word(text: &str) -> Result<String, String> {
    let text = text.trim().to_lowercase();
    let is_word = !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if is_word { Ok(text) } else { Err("must be a word of letters and digits: screw".into()) }
}

/// Returns the rotary axes of a head, `c,a`: as many as the kind has.
fn parse_head_axes(text: &str, kind: MachineKind) -> Result<Vec<RotaryAxis>, String> {
    let axis = |name: &str| {
        let name = name.trim().to_lowercase();
        RotaryAxis::ALL.into_iter().find(|axis| axis.name() == name)
    };
    let axes: Option<Vec<RotaryAxis>> = text.split(',').map(axis).collect();
    let usual = default_head_axes(kind);
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

/// Returns the axes of the head of the usual machine of its kind.
pub fn default_head_axes(kind: MachineKind) -> Vec<RotaryAxis> {
    match kind {
        MachineKind::HeadHead => vec![RotaryAxis::C, RotaryAxis::A],
        MachineKind::HeadTable => vec![RotaryAxis::A],
        MachineKind::ThreeAxis | MachineKind::TableTable | MachineKind::Lathe => Vec::new(),
    }
}

/// The questions, in their order.
#[derive(Clone, Copy, PartialEq, Eq)]
enum MachineQuestion {
    Name,
    Kind,
    Head,
    Travel(LinearAxis),
    Feedback,
    Rapid,
    Sensor,
    Thermometers,
    Control,
}

/// An answer, or the wish to go back.
enum PromptAnswer<T> {
    Given(T),
    Back,
}

/// The text to type, or to choose, to go back.
const BACK_INPUT: &str = "<";

/// Returns the template with the answers in it; an empty answer keeps what is offered. After a wrong answer the question comes
/// again at once, and `<` goes back: no answer is typed twice. `check_name` refuses a name.
pub fn run_questionnaire(
    mut template: MachineTemplate,
    answers: &AnsweredQuestions,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<MachineTemplate> {
    use MachineQuestion as Q;
    let all = [
        (Q::Name, answers.name),
        (Q::Kind, answers.kind),
        (Q::Head, answers.head_axes),
        (Q::Travel(LinearAxis::X), answers.axes),
        (Q::Travel(LinearAxis::Y), answers.axes),
        (Q::Travel(LinearAxis::Z), answers.axes),
        (Q::Feedback, answers.feedback),
        (Q::Rapid, answers.rapid),
        (Q::Sensor, answers.sensor),
        (Q::Thermometers, answers.thermometers),
        (Q::Control, answers.control),
    ];
    let open: Vec<MachineQuestion> = all
        .into_iter()
        .filter(|(_, is_reported)| !is_reported)
        .map(|(question, _)| question)
        .collect();
    trueup_output::write_diagnostic("(< goes back to the question before)");
    let mut requested = Vec::new();
    let mut next = 0;
    while let Some(question) = open.get(next) {
        if !is_applicable(*question, &template) {
            next += 1;
        } else if prompt_question(*question, &mut template, check_name)? {
            requested.push(next);
            next += 1;
        } else {
            next = requested.pop().unwrap_or(next);
        }
    }
    Ok(template)
}

/// Returns whether a question makes sense after the answers so far.
fn is_applicable(question: MachineQuestion, template: &MachineTemplate) -> bool {
    match question {
        MachineQuestion::Head => !default_head_axes(template.kind).is_empty(),
        MachineQuestion::Travel(axis) => {
            template.kind != MachineKind::Lathe || axis != LinearAxis::Y
        }
        _ => true,
    }
}

fn parse_yes_no(text: &str) -> Result<bool, String> {
    match text.to_lowercase().as_str() {
        "y" | "yes" => Ok(true),
        "n" | "no" => Ok(false),
        _ => Err("must be y or n".into()),
    }
}

/// Asks one question; false: back to the one before.
fn prompt_question(
    question: MachineQuestion,
    template: &mut MachineTemplate,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<bool> {
    use PromptAnswer::Given;
    match question {
        MachineQuestion::Name => {
            let Given(name) = prompt_name(&template.name, check_name)? else {
                return Ok(false);
            };
            template.name = name;
        }
        MachineQuestion::Kind => {
            let kinds = [
                ("a mill with X, Y and Z only", MachineKind::ThreeAxis),
                ("two rotary axes carry the spindle", MachineKind::HeadHead),
                ("one rotary axis carries the spindle, one the workpiece", MachineKind::HeadTable),
                ("two rotary axes carry the workpiece", MachineKind::TableTable),
                ("a lathe: the spindle carries the workpiece", MachineKind::Lathe),
            ];
            let Given(kind) = prompt_choice("Kind of machine", &kinds)? else {
                return Ok(false);
            };
            template.kind = kind;
            template.head_axes = Vec::new();
            template.axes.retain(|(axis, _)| kind != MachineKind::Lathe || *axis != LinearAxis::Y);
        }
        MachineQuestion::Head => {
            let kind = template.kind;
            let usual: Vec<&str> = default_head_axes(kind).iter().map(|axis| axis.name()).collect();
            let prompt = match usual.len() {
                1 => "Which one carries the spindle",
                _ => "Which ones carry the spindle, from the frame to the tool",
            };
            let parse = |text: &str| parse_head_axes(text, kind);
            let Given(axes) = prompt_with_default(prompt, &usual.join(","), parse)? else {
                return Ok(false);
            };
            template.head_axes = axes;
        }
        MachineQuestion::Travel(axis) => {
            let is_radius = template.kind == MachineKind::Lathe && axis == LinearAxis::X;
            let radius = if is_radius { " (radius)" } else { "" };
            let prompt =
                format!("Travel of {}{radius} in mm, as 0:600", axis.name().to_uppercase());
            let Given(travel) = prompt_optional(&prompt, "leave it out", parse_travel)? else {
                return Ok(false);
            };
            template.axes.retain(|(other, _)| *other != axis);
            template.axes.extend(travel.map(|travel| (axis, travel)));
        }
        MachineQuestion::Feedback => {
            let places = [
                ("on the motor or screw", Feedback::Screw),
                ("by a scale on the axis", Feedback::Scale),
            ];
            let Given(feedback) = prompt_choice("Where are positions measured?", &places)? else {
                return Ok(false);
            };
            template.feedback = feedback;
        }
        MachineQuestion::Rapid => {
            let Given(rapid) =
                prompt_optional("Rapid traverse in mm/min", "not known", parse_positive)?
            else {
                return Ok(false);
            };
            template.rapid_mm_per_min = rapid;
        }
        MachineQuestion::Sensor => return prompt_optional_sensor(template),
        MachineQuestion::Thermometers => return prompt_thermometers(template),
        MachineQuestion::Control => {
            let controls = [
                ("LinuxCNC", CncControl::LinuxCnc),
                ("Siemens 840D", CncControl::Siemens),
                ("FANUC", CncControl::Fanuc),
                ("Heidenhain", CncControl::Heidenhain),
            ];
            let Given(control) = prompt_choice("Control", &controls)? else {
                return Ok(false);
            };
            template.control = control;
        }
    }
    Ok(true)
}

/// Asks for the name of the machine.
fn prompt_name(
    usual: &str,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<PromptAnswer<String>> {
    prompt_with_default("Name of the machine", &usual, |text| {
        check_name(text).map(|()| text.to_string())
    })
}

/// Asks whether there is a sensor, and for its numbers; `<` takes them back, and then the question.
fn prompt_optional_sensor(template: &mut MachineTemplate) -> Result<bool> {
    use PromptAnswer::{Back, Given};
    template.sensor = None;
    loop {
        let prompt = "Is there a displacement sensor at the spindle? y or n";
        match prompt_with_default(prompt, &"y", parse_yes_no)? {
            Back => return Ok(false),
            Given(false) => break,
            Given(true) => {}
        }
        if let Given(sheet) = prompt_sensor()? {
            template.sensor = Some(sheet);
            break;
        }
    }
    Ok(true)
}

/// Asks for one thermometer after the other; `<` takes back the last one, and then the question.
fn prompt_thermometers(template: &mut MachineTemplate) -> Result<bool> {
    while template.thermometers.len() < MAX_THERMOMETERS {
        let before = template.thermometers.clone();
        let new = |text: &str| {
            parse_column_word(text).and_then(|word| match before.contains(&word) {
                true => Err(format!("there is a {word} already")),
                false => Ok(word),
            })
        };
        match prompt_optional("A PT100 and where it is, as screw", "no more", new)? {
            PromptAnswer::Given(Some(word)) => template.thermometers.push(word),
            PromptAnswer::Given(None) => break,
            PromptAnswer::Back if template.thermometers.pop().is_none() => return Ok(false),
            PromptAnswer::Back => {}
        }
    }
    Ok(true)
}

/// Asks for the three numbers of a sensor; `<` goes back to the one before, from the first to the question whether there
/// is one.
fn prompt_sensor() -> Result<PromptAnswer<SensorDataSheet>> {
    let mut sheet = SensorDataSheet { volts_full_scale: 10.0, um_per_v: 50.0, zero_v: 5.0 };
    let mut step = 0_u8;
    loop {
        let given = match step {
            0 => {
                let prompt = "Its output at the end of its range, in V";
                prompt_with_default(prompt, &sheet.volts_full_scale, parse_positive)?
            }
            1 => {
                let prompt = "µm for one volt (data sheet: range in µm / volts)";
                prompt_with_default(prompt, &sheet.um_per_v, parse_nonzero)?
            }
            _ => {
                let volts_full_scale = sheet.volts_full_scale;
                let within = |text: &str| match parse_finite(text)? {
                    volts if (0.0..=volts_full_scale).contains(&volts) => Ok(volts),
                    _ => Err(format!("must be from 0 to {volts_full_scale} V")),
                };
                let prompt = "What a voltmeter shows when the machine is cold, in V";
                prompt_with_default(prompt, &(volts_full_scale / 2.0), within)?
            }
        };
        match (given, step) {
            (PromptAnswer::Back, 0) => return Ok(PromptAnswer::Back),
            (PromptAnswer::Back, _) => step -= 1,
            (PromptAnswer::Given(volts), 0) => (sheet.volts_full_scale, step) = (volts, 1),
            (PromptAnswer::Given(um), 1) => (sheet.um_per_v, step) = (um, 2),
            (PromptAnswer::Given(zero_v), _) => {
                return Ok(PromptAnswer::Given(SensorDataSheet { zero_v, ..sheet }));
            }
        }
    }
}

/// Returns an answer that is read by `read`; nothing is `usual`.
fn prompt_with_default<T>(
    prompt: &str,
    usual: &impl ToString,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<PromptAnswer<T>> {
    let read = |text: &str| match text.trim() {
        BACK_INPUT => Ok(PromptAnswer::Back),
        text => read(text).map(PromptAnswer::Given),
    };
    let text: String = Input::new()
        .with_prompt(prompt)
        .default(usual.to_string())
        .validate_with(|text: &String| read(text).map(drop))
        .interact_text()?;
    read(&text).map_err(Error::msg)
}

/// Returns an answer that is read by `read`; nothing is `None`, which means `what`.
fn prompt_optional<T>(
    prompt: &str,
    what: &str,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<PromptAnswer<Option<T>>> {
    let read = |text: &str| match text.trim() {
        "" => Ok(PromptAnswer::Given(None)),
        BACK_INPUT => Ok(PromptAnswer::Back),
        text => read(text).map(|answer| PromptAnswer::Given(Some(answer))),
    };
    let text: String = Input::new()
        .with_prompt(format!("{prompt} (empty: {what})"))
        .allow_empty(true)
        .validate_with(|text: &String| read(text).map(drop))
        .interact_text()?;
    read(&text).map_err(Error::msg)
}

fn prompt_choice<T: Copy>(prompt: &str, choices: &[(&str, T)]) -> Result<PromptAnswer<T>> {
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).chain(["< back"]).collect();
    let chosen = Select::new().with_prompt(prompt).items(&names).default(0).interact()?;
    Ok(choices.get(chosen).map_or(PromptAnswer::Back, |(_, choice)| PromptAnswer::Given(*choice)))
}
