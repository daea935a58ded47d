//! Reads what a SINUMERIK would run, as far as these programs go.

use crate::event::{Event, To, axis, is_legal, of_axes, plane, words};

/// Parts of a frame that turn or scale a way, with the value that does not.
const PARTS: [(&str, &str); 3] = [("RT", "0"), ("SC", "1"), ("MI", "0")];

/// Returns the parts whose test ends the program, and the text without the tests.
fn without_tests(text: &str) -> Result<(Vec<&str>, String), String> {
    let (mut tested, mut rest) = (Vec::new(), String::new());
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(test) = line.strip_prefix("IF ") else {
            rest += &format!("{line}\n");
            continue;
        };
        let found = PARTS.iter().find(|(part, right)| {
            let each = ["X", "Y", "Z"].map(|axis| format!("($P_ACTFRAME[{axis},{part}]<>{right})"));
            test == each.join(" OR ")
        });
        tested.push(found.ok_or(format!("no reader knows {line}"))?.0);
        let message = lines.next().unwrap_or_default().trim();
        if !message.starts_with("MSG(\"Not run: ") {
            return Err(format!("no reason behind {line}"));
        }
        for known in ["M0", "M30", "ENDIF"] {
            if lines.next().map(str::trim) != Some(known) {
                return Err(format!("no {known} behind {line}"));
            }
        }
    }
    Ok((tested, rest))
}

/// Reads the words of an arc: X=IC(5) is a way whatever mode holds, and I and J are ways by themselves.
fn around(ways: &str, axes: [usize; 2], is_ccw: bool, is_safe: bool) -> Result<Event, String> {
    let ends = ways.split(' ').filter(|word| word.contains('='));
    if ends.clone().any(|word| !word.contains("=IC(") || !word.ends_with(')')) {
        return Err(format!("an end that is no way: {ways}"));
    }
    let plain = ways.replace("=IC(", "").replace(')', "");
    let found = words(&plain)?;
    let (end, centre) = (of_axes(&found, "XYZ", axes)?, of_axes(&found, "IJK", axes)?);
    let feed = found.iter().find(|word| word.0 == 'F').map(|word| word.1);
    let has_modes = is_safe && ends.count() == 2;
    Ok(Event::Around { axes, is_ccw, end, centre, feed, has_modes })
}

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let (tested, text) = without_tests(text)?;
    let mut of_plane = None;
    let mut events = Vec::new();
    let mut open: Vec<(usize, Vec<Event>)> = Vec::new();
    let (mut modes, mut message_text, mut comments) = (Vec::new(), String::new(), String::new());
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
                let inside = message.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
                is_legal(inside.ok_or(format!("no text: {line}"))?, 124, ":;<>'_?")?;
            }
            message_text = message.into();
            continue;
        }
        if let Some(turns) = block.strip_prefix("FOR R") {
            let turns = turns.rsplit(' ').next().and_then(|part| part.parse().ok());
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
                if message_text.is_empty() {
                    return Err("a stop without a message".into());
                }
                events.push(Event::Stop(format!("{comments}{message_text}")));
                comments.clear();
                continue;
            }
            "TRAFOOF" => continue,
            _ => {}
        }
        if let Some((turn @ ("G2" | "G3"), ways)) = block.split_once(' ') {
            let axes = of_plane.ok_or(format!("no plane: {block}"))?;
            let is_safe = PARTS.iter().all(|(part, _)| tested.contains(part))
                && [710.0, 40.0, 94.0].iter().all(|mode| modes.contains(mode));
            events.push(around(ways, axes, turn == "G3", is_safe)?);
            continue;
        }
        let machine = block.strip_prefix("SUPA ");
        let (mut to, mut rapid, mut feed, mut is_dwell, mut speed) =
            ([None; 3], None, None, false, None);
        let mut event = None;
        for (letter, number) in words(machine.unwrap_or(block))? {
            match (letter, number) {
                ('G', 0.0 | 1.0) => rapid = Some(number == 0.0),
                ('G', 4.0) => is_dwell = true,
                ('G', 17.0..=19.0) => of_plane = plane(number),
                ('G', 710.0 | 40.0 | 90.0 | 94.0 | 97.0 | 60.0 | 64.0 | 500.0) | ('D', 0.0) => {
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
