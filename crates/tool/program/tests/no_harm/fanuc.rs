//! Reads what a FANUC control would run, as far as these programs go: a main program, its subprograms, and the
//! one form of a variable that they use.

use std::collections::HashMap;

use crate::event::{Event, To, axis, is_legal, of_axes, plane, words};

#[derive(Default)]
struct State {
    events: Vec<Event>,
    message_text: String,
    modes: Vec<f64>,
    alarms: Vec<String>,
    /// 90 or 91, 0 or 1; of an earlier program: none.
    distance: Option<f64>,
    motion: Option<f64>,
    feed: Option<f64>,
    plane: Option<[usize; 2]>,
}

/// Variables that must raise an alarm: that of each mode that turns or scales an increment.
const ALARMS: [&str; 5] = ["#4007", "#4011", "#4016", "#4017", "#4022"];

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let inside = text.strip_prefix("%\n").and_then(|text| text.strip_suffix("%\n"));
    let mut programs: HashMap<u32, Vec<&str>> = HashMap::new();
    let (mut main, mut here) = (None, None);
    for line in inside.ok_or("no % at both ends")?.lines() {
        if let Some(name) = line.strip_prefix('O') {
            let (number, comment) = name.split_once('(').ok_or("no name")?;
            is_legal(comment.strip_suffix(')').ok_or("an open comment")?, 40, "")?;
            here = number.parse().ok();
            main = main.or(here);
        } else {
            let number = here.ok_or("a block before any program")?;
            programs.entry(number).or_default().push(line);
        }
    }
    let mut state = State::default();
    run(main.ok_or("no program")?, &programs, &mut state)?;
    Ok(state.events)
}

fn run(number: u32, programs: &HashMap<u32, Vec<&str>>, state: &mut State) -> Result<(), String> {
    for line in programs.get(&number).ok_or(format!("no program {number}"))? {
        if let Some(comment) = line.strip_prefix('(') {
            let comment = comment.strip_suffix(')').ok_or(format!("an open comment: {line}"))?;
            if comment.chars().any(|c| c.is_ascii_lowercase()) {
                return Err(format!("small letters: {line}"));
            }
            is_legal(comment, 64, "?")?;
            state.message_text = std::mem::take(&mut state.message_text) + comment + " ";
            continue;
        }
        let (_, block) = line.split_once(' ').ok_or(format!("no block number: {line}"))?;
        if let Some((test, alarm)) = block.split_once(" THEN #3000=") {
            let message = alarm.split_once('(').and_then(|parts| parts.1.strip_suffix(')'));
            is_legal(message.ok_or(format!("no message: {line}"))?, 26, "")?;
            state.alarms.push(test.into());
            continue;
        }
        one(block, programs, state).map_err(|why| format!("{why}: {line}"))?;
    }
    Ok(())
}

/// Returns whether no mode of an earlier program has a part in an increment.
fn has_modes(state: &State) -> bool {
    let has_alarms =
        ALARMS.iter().all(|alarm| state.alarms.iter().any(|test| test.contains(alarm)));
    has_alarms && [21.0, 40.0, 94.0].iter().all(|mode| state.modes.contains(mode))
}

/// Reads a block of an arc, all of whose words are ways.
fn around(block: &str, state: &mut State) -> Result<(), String> {
    let found = words(block)?;
    let [('G', 91.0), ('G', turn), ..] = found[..] else { return Err("no increments".into()) };
    if block.split(' ').any(|word| "XYZIJK".contains(&word[..1]) && !word.contains('.')) {
        return Err("micrometres without a point".into());
    }
    let axes = state.plane.ok_or("no plane")?;
    let (end, centre) = (of_axes(&found, "XYZ", axes)?, of_axes(&found, "IJK", axes)?);
    let feed = found.iter().find(|word| word.0 == 'F').map(|word| word.1);
    (state.distance, state.motion, state.feed) = (Some(91.0), Some(turn), feed);
    let has_modes = has_modes(state);
    state.events.push(Event::Around { axes, is_ccw: turn == 3.0, end, centre, feed, has_modes });
    Ok(())
}

fn one(block: &str, programs: &HashMap<u32, Vec<&str>>, state: &mut State) -> Result<(), String> {
    if block.split(' ').any(|word| word == "G02" || word == "G03") {
        return around(block, state);
    }
    let (mut to, mut is_machine) = ([None; 3], false);
    let (mut event, mut called, mut turns, mut speed, mut is_dwell) = (None, None, 1, None, false);
    for word in block.split(' ') {
        // X[2.-#5021]: the way from where the machine stands.
        if let Some((letter, inside)) = word.split_once('[') {
            let axis = letter.chars().next().and_then(axis).ok_or("no axis")?;
            let (mm, variable) = inside.split_once("-#").ok_or("no variable")?;
            if variable != format!("{}]", 5021 + axis) || state.distance != Some(91.0) {
                return Err("not the way of this axis".into());
            }
            to[axis] = Some(To::Machine(mm.parse().map_err(|_| "no number")?));
            continue;
        }
        let (letter, number) = words(word)?[0];
        match (letter, number) {
            ('G', 90.0 | 91.0) => state.distance = Some(number),
            ('G', 0.0 | 1.0) => state.motion = Some(number),
            ('G', 53.0) => is_machine = true,
            ('G', 4.0) => is_dwell = true,
            ('G', 17.0..=19.0) => state.plane = plane(number),
            ('G', 21.0 | 40.0 | 64.0 | 80.0 | 94.0) => state.modes.push(number),
            ('X', _) if is_dwell => event = Some(Event::Dwell(number)),
            ('F', _) => state.feed = Some(number),
            ('S', _) => speed = Some(number),
            ('P', _) => called = Some(number as u32),
            ('L', _) => turns = number as usize,
            ('M', 0.0) => {
                event = Some(Event::Stop(std::mem::take(&mut state.message_text)));
            }
            ('M', 30.0) => event = Some(Event::End(state.distance != Some(91.0))),
            ('M', 5.0) => event = Some(Event::Spindle(0.0)),
            ('M', 3.0) => event = Some(Event::Spindle(f64::NAN)),
            ('M', 98.0 | 99.0) => {}
            (letter, _) => {
                let axis = axis(letter).ok_or("a word that no reader knows")?;
                if !word.contains('.') {
                    return Err("micrometres without a point".into());
                }
                to[axis] = Some(if is_machine {
                    To::Machine(number)
                } else if state.distance == Some(91.0) {
                    To::By(number)
                } else {
                    return Err("a work offset has a part in it".into());
                });
            }
        }
    }
    if let (Some(Event::Spindle(rpm)), Some(speed)) = (&mut event, speed) {
        *rpm = speed;
    }
    if to != [None; 3] {
        let feed = match (state.motion.ok_or("the mode of an earlier program")?, is_machine) {
            (1.0, false) => state.feed,
            // G53 moves at rapid, whatever holds.
            _ => None,
        };
        event = Some(Event::Go { to, feed, has_modes: has_modes(state) });
    }
    state.events.extend(event);
    if let Some(called) = called {
        (0..turns).try_for_each(|_| run(called, programs, state))?;
    }
    Ok(())
}
