//! Reads what a HEIDENHAIN control would run, as far as these programs go: block by block, with the labels that it
//! goes back to.

use std::collections::HashMap;

use crate::event::{Event, To, axis, is_legal, words};

/// More blocks than any of these programs runs.
const MAX_BLOCKS: usize = 2_000_000;

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let mut blocks = Vec::new();
    for (n, line) in text.lines().enumerate() {
        let block = line.strip_prefix(&format!("{n} ")).ok_or(format!("not block {n}: {line}"))?;
        blocks.push(block);
    }
    let label = |name: &str| blocks.iter().position(|block| *block == format!("LBL {name}"));
    let (mut events, mut message_text) = (Vec::new(), String::new());
    let mut left: HashMap<usize, usize> = HashMap::new();
    let (mut at, mut run) = (0, 0);
    while let Some(block) = blocks.get(at) {
        run += 1;
        if run > MAX_BLOCKS {
            return Err("it does not end".into());
        }
        at += 1;
        if let Some(comment) = block.strip_prefix("; ") {
            is_legal(comment, 80, ":;<>'_?()")?;
            message_text = message_text + comment + " ";
            continue;
        }
        let is_read = events.len();
        if *block == "STOP" {
            events.push(Event::Stop(std::mem::take(&mut message_text)));
        } else if let Some(path) = block.strip_prefix("L ") {
            events.push(line(path).map_err(|why| format!("{why}: {block}"))?);
        } else if let Some(call) = block.strip_prefix("CALL LBL ") {
            let (name, times) = call.split_once(" REP ").ok_or((*block).to_string())?;
            let times: usize = times.parse().map_err(|_| (*block).to_string())?;
            let turns = left.entry(at).or_insert(times);
            if *turns > 0 {
                *turns -= 1;
                at = label(name).ok_or(format!("no label: {block}"))?;
            } else {
                // A loop within a loop begins anew.
                left.remove(&at);
            }
        } else if let Some(s) = block.strip_prefix("CYCL DEF 9.1 DWELL ") {
            events.push(Event::Dwell(s.parse().map_err(|_| (*block).to_string())?));
        } else if let Some(speed) = block.strip_prefix("TOOL CALL Z S") {
            events.push(Event::Spindle(speed.parse().map_err(|_| (*block).to_string())?));
        } else if *block == "M5" {
            events.push(Event::Spindle(0.0));
        } else if *block == "M30" {
            events.push(Event::End(true));
        } else if block.starts_with("BEGIN PGM ") && !block.ends_with(" MM") {
            return Err(format!("not in mm: {block}"));
        } else {
            let known = ["BEGIN PGM ", "END PGM ", "LBL ", "CYCL DEF 9.0 DWELL TIME"];
            let is_known = *block == "M3" || known.iter().any(|prefix| block.starts_with(prefix));
            is_known.then_some(()).ok_or(format!("a block that no reader knows: {block}"))?;
        }
        if events.len() > is_read {
            message_text.clear();
        }
    }
    Ok(events)
}

fn line(path: &str) -> Result<Event, String> {
    let path = path.strip_suffix(" M91").ok_or("a datum has a part in it")?;
    let (mut to, mut feed, mut is_bare) = ([None; 3], None, false);
    for word in path.split(' ') {
        if word == "FMAX" {
            continue;
        }
        for (letter, number) in words(&word.replace('+', ""))? {
            match letter {
                'R' => is_bare = number == 0.0,
                'F' => feed = Some(number),
                letter => {
                    let axis = axis(letter).ok_or(format!("{letter} is no axis"))?;
                    to[axis] = Some(To::Machine(number));
                }
            }
        }
    }
    Ok(Event::Go { to, feed, has_modes: is_bare })
}
