//! Reads what LinuxCNC would run, as far as these programs go.

use crate::event::{Event, To, axis, is_legal, words};

/// A repeat that is open: its number, its turns, and the events before it.
type Open = (String, usize, Vec<Event>);

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let (mut events, mut open): (Vec<Event>, Vec<Open>) = (Vec::new(), Vec::new());
    let (mut modes, mut said) = (Vec::new(), String::new());
    let mut feed = None;
    for line in text.lines() {
        if line.len() > 250 {
            return Err(format!("a line of {} characters: {line}", line.len()));
        }
        let line = line.trim();
        if let Some(inside) = line.strip_prefix('(') {
            let inside = inside.strip_suffix(')').ok_or(format!("an open comment: {line}"))?;
            is_legal(inside, 240, ":;<>'_?")?;
            if let Some(message) = inside.strip_prefix("MSG, ") {
                said = said + message + " ";
            }
            continue;
        }
        let block = line.strip_suffix(" (read)").unwrap_or(line);
        if let Some((number, word)) = block.strip_prefix('o').and_then(|it| it.split_once(' ')) {
            if let Some(turns) = word.strip_prefix("repeat [").and_then(|it| it.strip_suffix(']')) {
                let turns = turns.parse().map_err(|_| format!("turns: {block}"))?;
                open.push((number.into(), turns, std::mem::take(&mut events)));
            } else {
                let (of, turns, before) = open.pop().ok_or("an end without a beginning")?;
                if of != number || word != "endrepeat" {
                    return Err(format!("{block} ends {of}"));
                }
                let once = std::mem::replace(&mut events, before);
                (0..turns).for_each(|_| events.extend(once.iter().cloned()));
            }
            continue;
        }
        let (mut to, mut rapid, mut is_machine, mut dwell, mut speed) =
            ([None; 3], None, false, None, None);
        let mut is_dwell = false;
        let mut event = None;
        for (letter, number) in words(block)? {
            match (letter, number) {
                ('G', 0.0 | 1.0) => rapid = Some(number == 0.0),
                ('G', 53.0) => is_machine = true,
                ('G', 4.0) => is_dwell = true,
                ('G', 17.0 | 21.0 | 40.0 | 49.0 | 80.0 | 90.0 | 94.0 | 97.0 | 61.0) => {
                    modes.push(number);
                }
                ('P', _) if is_dwell => dwell = Some(number),
                ('F', _) => feed = Some(number),
                ('S', _) => speed = Some(number),
                ('M', 0.0) => event = Some(Event::Stop(std::mem::take(&mut said))),
                ('M', 2.0) => event = Some(Event::End(true)),
                ('M', 5.0) => event = Some(Event::Spindle(0.0)),
                ('M', 3.0) => event = Some(Event::Spindle(f64::NAN)),
                (letter, _) if axis(letter).is_some() => {
                    to[axis(letter).unwrap_or(0)] = Some(To::Machine(number));
                }
                _ => return Err(format!("{letter}{number} in {block}")),
            }
        }
        if let (Some(Event::Spindle(rpm)), Some(speed)) = (&mut event, speed) {
            *rpm = speed;
        }
        if to != [None; 3] {
            let rapid = rapid.ok_or(format!("the mode of an earlier program: {block}"))?;
            if !is_machine {
                return Err(format!("a work offset has a part in {block}"));
            }
            let has_modes = [21.0, 40.0, 90.0, 94.0].iter().all(|mode| modes.contains(mode));
            let feed = if rapid { None } else { feed };
            event = Some(Event::Go { to, feed, has_modes });
        }
        events.extend(dwell.map(Event::Dwell));
        events.extend(event);
    }
    if open.is_empty() { Ok(events) } else { Err("a repeat without an end".into()) }
}
