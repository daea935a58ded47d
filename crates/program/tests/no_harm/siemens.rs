//! Reads what a SINUMERIK would run, as far as these programs go.

use crate::event::{Event, To, axis, is_legal, words};

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let mut events = Vec::new();
    let mut open: Vec<(usize, Vec<Event>)> = Vec::new();
    let (mut modes, mut said, mut comments) = (Vec::new(), String::new(), String::new());
    for (n, line) in text.lines().enumerate() {
        let line = line.trim();
        if n < 2 {
            let is_head = line.starts_with("%_N_") || line.starts_with(";$PATH=");
            is_head.then_some(()).ok_or(format!("no head: {line}"))?;
            continue;
        }
        if let Some(comment) = line.strip_prefix("; ") {
            is_legal(comment, 120, ":;<>'_?()")?;
            comments = comments + comment + " ";
            continue;
        }
        let block = line.strip_suffix(" ; read").unwrap_or(line);
        if let Some(message) = block.strip_prefix("MSG(") {
            let message = message.strip_suffix(')').ok_or(format!("an open message: {line}"))?;
            if !message.is_empty() {
                let inside = message.strip_prefix('"').and_then(|it| it.strip_suffix('"'));
                is_legal(inside.ok_or(format!("no text: {line}"))?, 124, ":;<>'_?")?;
            }
            said = message.into();
            continue;
        }
        if let Some(turns) = block.strip_prefix("FOR R") {
            let turns = turns.rsplit(' ').next().and_then(|it| it.parse().ok());
            open.push((turns.ok_or(format!("turns: {line}"))?, std::mem::take(&mut events)));
            continue;
        }
        match block {
            "ENDFOR" => {
                let (turns, before) = open.pop().ok_or("an end without a beginning")?;
                let once = std::mem::replace(&mut events, before);
                (0..turns).for_each(|_| events.extend(once.iter().cloned()));
                continue;
            }
            "M0" => {
                if said.is_empty() {
                    return Err("a stop without a message".into());
                }
                events.push(Event::Stop(format!("{comments}{said}")));
                comments.clear();
                continue;
            }
            "TRAFOOF" => continue,
            _ => {}
        }
        let machine = block.strip_prefix("SUPA ");
        let (mut to, mut rapid, mut feed, mut is_dwell, mut speed) =
            ([None; 3], None, None, false, None);
        let mut event = None;
        for (letter, number) in words(machine.unwrap_or(block))? {
            match (letter, number) {
                ('G', 0.0 | 1.0) => rapid = Some(number == 0.0),
                ('G', 4.0) => is_dwell = true,
                ('G', 17.0 | 710.0 | 40.0 | 90.0 | 94.0 | 97.0 | 60.0 | 500.0) | ('D', 0.0) => {
                    modes.push(number);
                }
                ('F', _) if is_dwell => event = Some(Event::Dwell(number)),
                ('F', _) => feed = Some(number),
                ('S', _) => speed = Some(number),
                ('M', 30.0) => event = Some(Event::End(true)),
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
            machine.ok_or(format!("a frame has a part in {block}"))?;
            let has_modes = [710.0, 40.0, 90.0, 94.0].iter().all(|mode| modes.contains(mode));
            event = Some(Event::Go { to, feed: if rapid { None } else { feed }, has_modes });
        }
        events.extend(event);
    }
    if open.is_empty() { Ok(events) } else { Err("a loop without an end".into()) }
}
