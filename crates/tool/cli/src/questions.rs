//! The questions of `trueup new`, for what its flags have not said. `<` goes back to the question before.

use anyhow::{Error, Result};
use dialoguer::{Input, Select};
use trueup_machine::{
    file::{Feedback, Kind, LinearAxis, RotaryAxis},
    inputs::LAST_CHANNEL,
    template::{Control, Sheet, Template},
};

/// As many channels has the board.
const MAX_THERMOMETERS: usize = LAST_CHANNEL as usize + 1;

/// Questions that the flags have answered: they are not asked.
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

/// Returns a number of a user's.
pub fn finite(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| "must be a number, with a point for decimals".into())
}

/// Returns a number of a user's that must be above 0.
pub fn above_zero(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value > 0.0 { Ok(value) } else { Err("must be above 0".into()) }
}

/// Returns a number of a user's that must not be 0.
pub fn not_zero(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    if value != 0.0 { Ok(value) } else { Err("must not be 0".into()) }
}

/// Returns the ends of a travel, `0:600`.
pub fn ends(text: &str) -> Result<[f64; 2], String> {
    let (from, to) = text.split_once(':').ok_or("must be the two ends in mm: 0:600")?;
    let (from, to) = (finite(from.trim())?, finite(to.trim())?);
    if from < to { Ok([from, to]) } else { Err("the lower end stands first: 0:600".into()) }
}

/// Returns a word that a column may be named by.
pub fn word(text: &str) -> Result<String, String> {
    let text = text.trim().to_lowercase();
    let is_word = !text.is_empty() && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if is_word { Ok(text) } else { Err("must be a word of letters and digits: screw".into()) }
}

/// Returns the rotary axes of a head, `c,a`: as many as the kind has.
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

/// Returns the axes of the head of the usual machine of its kind.
pub fn usual_head(kind: Kind) -> Vec<RotaryAxis> {
    match kind {
        Kind::HeadHead => vec![RotaryAxis::C, RotaryAxis::A],
        Kind::HeadTable => vec![RotaryAxis::A],
        Kind::ThreeAxis | Kind::TableTable | Kind::Lathe => Vec::new(),
    }
}

/// The questions, in their order.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Question {
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
enum Answer<T> {
    Given(T),
    Back,
}

/// The text to type, or to choose, to go back.
const BACK: &str = "<";

/// Returns the template with the answers in it; an empty answer keeps what is offered. A wrong answer is asked for
/// again at once, and `<` goes back: no answer is typed twice. `check_name` refuses a name.
pub fn ask(
    mut template: Template,
    said: &Said,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<Template> {
    use Question as Q;
    let all = [
        (Q::Name, said.name),
        (Q::Kind, said.kind),
        (Q::Head, said.head_axes),
        (Q::Travel(LinearAxis::X), said.axes),
        (Q::Travel(LinearAxis::Y), said.axes),
        (Q::Travel(LinearAxis::Z), said.axes),
        (Q::Feedback, said.feedback),
        (Q::Rapid, said.rapid),
        (Q::Sensor, said.sensor),
        (Q::Thermometers, said.thermometers),
        (Q::Control, said.control),
    ];
    let open: Vec<Question> =
        all.into_iter().filter(|(_, is_said)| !is_said).map(|(question, _)| question).collect();
    trueup_output::diagnostic("(< goes back to the question before)");
    let mut asked = Vec::new();
    let mut next = 0;
    while let Some(question) = open.get(next) {
        if !applies(*question, &template) {
            next += 1;
        } else if one(*question, &mut template, check_name)? {
            asked.push(next);
            next += 1;
        } else {
            next = asked.pop().unwrap_or(next);
        }
    }
    Ok(template)
}

/// Returns whether a question makes sense after the answers so far.
fn applies(question: Question, template: &Template) -> bool {
    match question {
        Question::Head => !usual_head(template.kind).is_empty(),
        Question::Travel(axis) => template.kind != Kind::Lathe || axis != LinearAxis::Y,
        _ => true,
    }
}

/// Asks one question; false: back to the one before.
fn one(
    question: Question,
    template: &mut Template,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<bool> {
    match question {
        Question::Name => {
            let Answer::Given(name) = ask_name(&template.name, check_name)? else {
                return Ok(false);
            };
            template.name = name;
        }
        Question::Kind => {
            let kinds = [
                ("a mill with X, Y and Z only", Kind::ThreeAxis),
                ("two rotary axes carry the spindle", Kind::HeadHead),
                ("one rotary axis carries the spindle, one the workpiece", Kind::HeadTable),
                ("two rotary axes carry the workpiece", Kind::TableTable),
                ("a lathe: the spindle carries the workpiece", Kind::Lathe),
            ];
            let Answer::Given(kind) = choose("Kind of machine", &kinds)? else { return Ok(false) };
            template.kind = kind;
            template.head_axes = Vec::new();
            template.axes.retain(|(axis, _)| kind != Kind::Lathe || *axis != LinearAxis::Y);
        }
        Question::Head => {
            let kind = template.kind;
            let usual: Vec<&str> = usual_head(kind).iter().map(|axis| axis.name()).collect();
            let prompt = match usual.len() {
                1 => "Which one carries the spindle",
                _ => "Which ones carry the spindle, from the frame to the tool",
            };
            let Answer::Given(axes) = needed(prompt, &usual.join(","), |text| head(text, kind))?
            else {
                return Ok(false);
            };
            template.head_axes = axes;
        }
        Question::Travel(axis) => {
            let is_radius = template.kind == Kind::Lathe && axis == LinearAxis::X;
            let radius = if is_radius { " (radius)" } else { "" };
            let prompt =
                format!("Travel of {}{radius} in mm, as 0:600", axis.name().to_uppercase());
            let Answer::Given(travel) = wanted(&prompt, "leave it out", ends)? else {
                return Ok(false);
            };
            template.axes.retain(|(other, _)| *other != axis);
            template.axes.extend(travel.map(|travel| (axis, travel)));
        }
        Question::Feedback => {
            let places = [
                ("on the motor or screw", Feedback::Screw),
                ("by a scale on the axis", Feedback::Scale),
            ];
            let Answer::Given(feedback) = choose("Where are positions measured?", &places)? else {
                return Ok(false);
            };
            template.feedback = feedback;
        }
        Question::Rapid => {
            let Answer::Given(rapid) = wanted("Rapid traverse in mm/min", "not known", above_zero)?
            else {
                return Ok(false);
            };
            template.rapid_mm_per_min = rapid;
        }
        Question::Sensor => {
            let yes_or_no = |text: &str| match text.to_lowercase().as_str() {
                "y" | "yes" => Ok(true),
                "n" | "no" => Ok(false),
                _ => Err("must be y or n".into()),
            };
            template.sensor = None;
            loop {
                let prompt = "Is there a displacement sensor at the spindle? y or n";
                match needed(prompt, &"y", yes_or_no)? {
                    Answer::Back => return Ok(false),
                    Answer::Given(false) => break,
                    Answer::Given(true) => {}
                }
                if let Answer::Given(sheet) = sensor()? {
                    template.sensor = Some(sheet);
                    break;
                }
            }
        }
        Question::Thermometers => return thermometers(template),
        Question::Control => {
            let controls = [
                ("LinuxCNC", Control::LinuxCnc),
                ("Siemens 840D", Control::Siemens),
                ("FANUC", Control::Fanuc),
                ("Heidenhain", Control::Heidenhain),
            ];
            let Answer::Given(control) = choose("Control", &controls)? else { return Ok(false) };
            template.control = control;
        }
    }
    Ok(true)
}

/// Asks for the name of the machine.
fn ask_name(
    usual: &str,
    check_name: &dyn Fn(&str) -> Result<(), String>,
) -> Result<Answer<String>> {
    needed("Name of the machine", &usual, |text| check_name(text).map(|()| text.to_string()))
}

/// Asks for one thermometer after the other; `<` takes back the last one, and then the question.
fn thermometers(template: &mut Template) -> Result<bool> {
    while template.thermometers.len() < MAX_THERMOMETERS {
        let before = template.thermometers.clone();
        let new = |text: &str| {
            word(text).and_then(|word| match before.contains(&word) {
                true => Err(format!("there is a {word} already")),
                false => Ok(word),
            })
        };
        match wanted("A PT100 and where it is, as screw", "no more", new)? {
            Answer::Given(Some(word)) => template.thermometers.push(word),
            Answer::Given(None) => break,
            Answer::Back if template.thermometers.pop().is_none() => return Ok(false),
            Answer::Back => {}
        }
    }
    Ok(true)
}

/// Asks for the three numbers of a sensor; `<` goes back to the one before, from the first to the question whether there
/// is one.
fn sensor() -> Result<Answer<Sheet>> {
    let mut sheet = Sheet { volts_full_scale: 10.0, um_per_v: 50.0, zero_v: 5.0 };
    let mut step = 0_u8;
    loop {
        let given = match step {
            0 => {
                let prompt = "Its output at the end of its range, in V";
                needed(prompt, &sheet.volts_full_scale, above_zero)?
            }
            1 => {
                let prompt = "µm for one volt (data sheet: range in µm / volts)";
                needed(prompt, &sheet.um_per_v, not_zero)?
            }
            _ => {
                let volts_full_scale = sheet.volts_full_scale;
                let within = |text: &str| match finite(text)? {
                    volts if (0.0..=volts_full_scale).contains(&volts) => Ok(volts),
                    _ => Err(format!("must be from 0 to {volts_full_scale} V")),
                };
                let prompt = "What a voltmeter shows when the machine is cold, in V";
                needed(prompt, &(volts_full_scale / 2.0), within)?
            }
        };
        match (given, step) {
            (Answer::Back, 0) => return Ok(Answer::Back),
            (Answer::Back, _) => step -= 1,
            (Answer::Given(volts), 0) => (sheet.volts_full_scale, step) = (volts, 1),
            (Answer::Given(um), 1) => (sheet.um_per_v, step) = (um, 2),
            (Answer::Given(zero_v), _) => return Ok(Answer::Given(Sheet { zero_v, ..sheet })),
        }
    }
}

/// Returns an answer that is read by `read`; nothing is `usual`.
fn needed<T>(
    prompt: &str,
    usual: &impl ToString,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<Answer<T>> {
    let read = |text: &str| match text.trim() {
        BACK => Ok(Answer::Back),
        text => read(text).map(Answer::Given),
    };
    let text: String = Input::new()
        .with_prompt(prompt)
        .default(usual.to_string())
        .validate_with(|text: &String| read(text).map(drop))
        .interact_text()?;
    read(&text).map_err(Error::msg)
}

/// Returns an answer that is read by `read`; nothing is `None`, which means `what`.
fn wanted<T>(
    prompt: &str,
    what: &str,
    read: impl Fn(&str) -> Result<T, String>,
) -> Result<Answer<Option<T>>> {
    let read = |text: &str| match text.trim() {
        "" => Ok(Answer::Given(None)),
        BACK => Ok(Answer::Back),
        text => read(text).map(|it| Answer::Given(Some(it))),
    };
    let text: String = Input::new()
        .with_prompt(format!("{prompt} (empty: {what})"))
        .allow_empty(true)
        .validate_with(|text: &String| read(text).map(drop))
        .interact_text()?;
    read(&text).map_err(Error::msg)
}

fn choose<T: Copy>(prompt: &str, choices: &[(&str, T)]) -> Result<Answer<T>> {
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).chain(["< back"]).collect();
    let chosen = Select::new().with_prompt(prompt).items(&names).default(0).interact()?;
    Ok(choices.get(chosen).map_or(Answer::Back, |(_, choice)| Answer::Given(*choice)))
}
