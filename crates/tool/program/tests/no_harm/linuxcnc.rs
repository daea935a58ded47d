//! Reads what LinuxCNC would run, as far as these programs go.

use crate::event::{Event, Sort, To, axis, is_legal, of_axes, plane, words};

/// Ends the program where the work coordinates are rotated.
const ROTATED: [&str; 4] = [
    "o99 if [#[5210 + 20 * #5220] NE 0]",
    "(MSG, Not run: the work coordinates are rotated. G10 L2 P0 R0 cancels it)",
    "M2",
    "o99 endif",
];

/// What a probe in machine coordinates needs before anything moves.
const SHIFTS: [&str; 8] = [
    "o98 if [EXISTS[#<_abs_x>] EQ 0]",
    "(MSG, Not run: this needs LinuxCNC 2.9)",
    "M2",
    "o98 endif",
    "M66 E0 L0",
    "#<shift_x> = [#<_abs_x> - #<_x>]",
    "#<shift_y> = [#<_abs_y> - #<_y>]",
    "#<shift_z> = [#<_abs_z> - #<_z>]",
];

/// Reads the lines of a probe; each sort has one form.
#[derive(Default)]
struct Probe {
    has_shifts: bool,
    columns: Option<Vec<String>>,
    /// What the next line must be.
    next: Vec<String>,
}

impl Probe {
    /// Returns the event of a line; an inner `None` of a line that is right and causes none; `None` where it is of no probe.
    fn read(&mut self, line: &str, has_modes: bool) -> Result<Option<Option<Event>>, String> {
        if let Some(expected) = self.next.pop() {
            return match line == expected {
                true => Ok(Some(None)),
                false => Err(format!("{line} is not {expected}")),
            };
        }
        if line == SHIFTS[0] {
            self.next = SHIFTS[1..].iter().rev().map(ToString::to_string).collect();
            self.has_shifts = true;
            return Ok(Some(None));
        }
        if line.starts_with("(LOGOPEN,") || line == "(LOGCLOSE)" {
            return Ok(Some(None));
        }
        if let Some(row) = line.strip_prefix("(LOG,").and_then(|rest| rest.strip_suffix(')')) {
            let cells: Vec<String> = row.split(',').map(Into::into).collect();
            return Ok(Some(match &self.columns {
                None => {
                    self.columns = Some(cells);
                    None
                }
                Some(columns) => Some(Event::Row(columns.iter().cloned().zip(cells).collect())),
            }));
        }
        if line.starts_with("#<touch_") || line.starts_with("#<cell_") {
            return Ok(Some(None));
        }
        let Some((code, rest)) = line.strip_prefix("G38.").and_then(|rest| rest.split_once(' '))
        else {
            return Ok(None);
        };
        let sort = match code {
            "2" => Sort::Touch,
            "3" => Sort::Guarded,
            "5" => Sort::Away,
            _ => return Err(format!("no probe of this sort: {line}")),
        };
        let (place, feed) = rest.split_once("] F").ok_or(format!("no feed: {line}"))?;
        let (place, shift) = place.split_once("-#<shift_").ok_or(format!("no shift: {line}"))?;
        let (letter, mm) = place.split_once('[').ok_or(format!("no place: {line}"))?;
        let axis = letter.chars().next().and_then(axis).ok_or(format!("no axis: {line}"))?;
        if shift != format!("{}>", letter.to_lowercase()) {
            return Err(format!("the shift of another axis: {line}"));
        }
        let number = |text: &str| text.parse::<f64>().map_err(|_| format!("no number: {line}"));
        let (mm, feed) = (number(mm)?, number(feed)?);
        self.next = match sort {
            Sort::Guarded => {
                ["endif", "M2", "(MSG, Stopped: contact on the way", "if [#5070 AND #<_task>]"]
                    .map(String::from)
                    .to_vec()
            }
            _ => Vec::new(),
        };
        let has_modes = has_modes && self.has_shifts;
        Ok(Some(Some(Event::Probe { axis, mm, feed, sort, has_modes })))
    }
}

/// Modes of an arc: increments, centres by their ways, no rotation.
#[derive(Default)]
struct Modes {
    plane: Option<[usize; 2]>,
    is_incremental: bool,
    has_centre_by_way: bool,
    is_not_rotated: bool,
}

impl Modes {
    /// Reads the rest of what ends the program in rotated coordinates.
    fn reject_rotation<'t>(
        &mut self,
        lines: &mut impl Iterator<Item = &'t str>,
    ) -> Result<(), String> {
        for known in &ROTATED[1..] {
            let next = lines.next().map(str::trim);
            (next == Some(known)).then_some(()).ok_or(format!("{next:?} is not {known}"))?;
        }
        self.is_not_rotated = true;
        Ok(())
    }

    /// Returns the event of the words of an arc; `None` of other words.
    fn around(&self, found: &[(char, f64)], modes: &[f64]) -> Result<Option<Event>, String> {
        let [('G', turn @ (2.0 | 3.0)), .., ('F', feed)] = *found else { return Ok(None) };
        let axes = self.plane.ok_or("an arc in no plane")?;
        let has_modes = self.is_incremental
            && self.has_centre_by_way
            && self.is_not_rotated
            && [21.0, 40.0, 94.0].iter().all(|mode| modes.contains(mode));
        let (end, centre) = (of_axes(found, "XYZ", axes)?, of_axes(found, "IJK", axes)?);
        let (is_ccw, feed) = (turn == 3.0, Some(feed));
        Ok(Some(Event::Around { axes, is_ccw, end, centre, feed, has_modes }))
    }
}

/// Returns a line of a guard without its number and its place; any other line as it is.
fn without_number(line: &str) -> &str {
    const STOPPED: &str = "(MSG, Stopped: contact on the way";
    match line.strip_prefix("o1").and_then(|rest| rest.split_once(' ')) {
        Some((number, rest)) if number.len() == 3 => rest,
        _ if line.starts_with(STOPPED) => STOPPED,
        _ => line,
    }
}

/// A repeat that is open: its number, its turns, and the events before it.
type Open = (String, usize, Vec<Event>);

/// Begins a repeat, or ends one and writes it out.
fn repeat(
    number: &str,
    word: &str,
    events: &mut Vec<Event>,
    open: &mut Vec<Open>,
) -> Result<(), String> {
    if let Some(turns) = word.strip_prefix("repeat [").and_then(|rest| rest.strip_suffix(']')) {
        let turns = turns.parse().map_err(|_| format!("turns: {word}"))?;
        open.push((number.into(), turns, std::mem::take(events)));
        return Ok(());
    }
    let (of, turns, before) = open.pop().ok_or("an end without a beginning")?;
    if of != number || word != "endrepeat" {
        return Err(format!("o{number} {word} ends {of}"));
    }
    let once = std::mem::replace(events, before);
    (0..turns).for_each(|_| events.extend(once.iter().cloned()));
    Ok(())
}

pub fn read(text: &str) -> Result<Vec<Event>, String> {
    let (mut events, mut open): (Vec<Event>, Vec<Open>) = (Vec::new(), Vec::new());
    let (mut modes, mut message_text) = (Vec::new(), String::new());
    let mut feed = None;
    let mut of_arc = Modes::default();
    let mut probe = Probe::default();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if line == ROTATED[0] {
            of_arc.reject_rotation(&mut lines)?;
            continue;
        }
        if line.len() > 250 {
            return Err(format!("a line of {} characters: {line}", line.len()));
        }
        let line = line.trim();
        let has_modes = of_arc.is_not_rotated
            && !of_arc.is_incremental
            && [21.0, 40.0, 49.0, 90.0, 94.0].iter().all(|mode| modes.contains(mode));
        if let Some(event) = probe.read(without_number(line), has_modes)? {
            events.extend(event);
            continue;
        }
        if let Some(inside) = line.strip_prefix('(') {
            let inside = inside.strip_suffix(')').ok_or(format!("an open comment: {line}"))?;
            is_legal(inside, 240, ":;<>'_?")?;
            if let Some(message) = inside.strip_prefix("MSG, ") {
                message_text = message_text + message + " ";
            }
            continue;
        }
        let block = line.strip_suffix(" (read)").unwrap_or(line);
        if let Some((number, word)) = block.strip_prefix('o').and_then(|rest| rest.split_once(' '))
        {
            repeat(number, word, &mut events, &mut open)?;
            continue;
        }
        let (mut to, mut rapid, mut is_machine, mut dwell, mut speed) =
            ([None; 3], None, false, None, None);
        let mut is_dwell = false;
        let mut event = None;
        let found = words(block)?;
        if let Some(event) = of_arc.around(&found, &modes)? {
            events.push(event);
            continue;
        }
        for (letter, number) in found {
            match (letter, number) {
                ('G', 0.0 | 1.0) => rapid = Some(number == 0.0),
                ('G', 53.0) => is_machine = true,
                ('G', 4.0) => is_dwell = true,
                ('G', 17.0..=19.0) => {
                    modes.push(number);
                    of_arc.plane = plane(number);
                }
                ('G', 90.0 | 91.0) => {
                    modes.push(number);
                    of_arc.is_incremental = number == 91.0;
                }
                ('G', 91.1) => of_arc.has_centre_by_way = true,
                ('G', 21.0 | 40.0 | 49.0 | 61.0 | 64.0 | 80.0 | 94.0 | 97.0) => {
                    modes.push(number);
                }
                ('P', _) if is_dwell => dwell = Some(number),
                ('F', _) => feed = Some(number),
                ('S', _) => speed = Some(number),
                ('M', 0.0) => event = Some(Event::Stop(std::mem::take(&mut message_text))),
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
            let has_modes = [21.0, 40.0, 90.0, 94.0].iter().all(|mode| modes.contains(mode))
                && !of_arc.is_incremental;
            let feed = if rapid { None } else { feed };
            event = Some(Event::Go { to, feed, has_modes });
        }
        events.extend(dwell.map(Event::Dwell));
        events.extend(event);
    }
    if open.is_empty() { Ok(events) } else { Err("a repeat without an end".into()) }
}
