//! A virtual machine with a touch probe that runs a program for LinuxCNC: it reads the lines of the file, moves where they say,
//! closes the probe where the tip meets an artefact, and writes the run file that the program logs. The truth is that of the
//! virtual machine tool: whole transforms, which share no line with the fit.

use std::collections::BTreeMap;

use trueup_twin::{
    axes::{AxesConfig, SimulatedAxes},
    rigid_bodies::{Body, error_um},
};

/// How far apart a move is looked at, in mm; less than any stylus or ball.
const STEP_MM: f64 = 0.5;

/// The machine as it is.
pub struct Truth {
    pub axes: AxesConfig,
    pub bodies: Vec<Body>,
}

/// Where it stands, by its scales, and what it has.
pub struct State {
    pub mm: [f64; 3],
    pub deg: [f64; 3],
    pub tool_mm: f64,
    axes: SimulatedAxes,
}

impl State {
    /// Returns the tip as it is, from where it would be with 0 of X, Y and Z and without a tool.
    pub fn tip_mm(&mut self, truth: &Truth) -> [f64; 3] {
        self.axes.step(1.0, self.mm, 20.0);
        let own = self.axes.error_um();
        let tip = [0.0, 0.0, -self.tool_mm];
        let bodies = error_um(&truth.bodies, tip, self.mm, self.deg);
        [0, 1, 2].map(|n| self.mm[n] + tip[n] + (own[n] + bodies[n]) / 1000.0)
    }
}

/// Runs a program. `is_closed` says whether the tip touches; the operator does what a stop says.
///
/// # Panics
/// A contact where none may be, none where one must be, or a line that no reader knows.
pub fn run(
    program: &str,
    truth: &Truth,
    tool_mm: f64,
    mut is_closed: impl FnMut([f64; 3], [f64; 3]) -> bool,
) -> String {
    let mut state = State {
        mm: [0.0; 3],
        deg: [0.0; 3],
        tool_mm,
        axes: SimulatedAxes::new(&truth.axes, [0.0; 3], 20.0),
    };
    let (mut log, mut text, mut met_mm) = (String::new(), String::new(), f64::NAN);
    let mut values: BTreeMap<String, f64> = BTreeMap::new();
    for line in program.lines().map(str::trim) {
        if let Some(row) = line.strip_prefix("(LOG,").and_then(|rest| rest.strip_suffix(')')) {
            let cells = row.split(',').map(|cell| match values.get(cell) {
                Some(value) => format!("{value:.6}"),
                None => cell.to_string(),
            });
            log += &(cells.collect::<Vec<_>>().join(",") + "\n");
        } else if let Some(message) = line.strip_prefix("(MSG, ") {
            text += message;
        } else if line == "M0" {
            obey(&mut state, &text);
            text.clear();
        } else if let Some(place) = line.strip_prefix("G53 G1 ") {
            let (axis, mm) = place_of(place);
            state.mm[axis] = mm;
        } else if let Some((code, place)) =
            line.strip_prefix("G38.").and_then(|rest| rest.split_once(' '))
        {
            let (axis, to_mm) = place_of(place);
            match (code, contact(&mut state, truth, axis, to_mm, &mut is_closed)) {
                ("2", Some(mm)) => met_mm = mm,
                ("2", None) => panic!("no contact: {line}, from {:?}", state.mm),
                ("3", Some(mm)) => panic!("contact at {mm}: {line}, from {:?}", state.mm),
                _ => state.mm[axis] = to_mm,
            }
        } else if let Some((name, _)) = line.split_once(" = [#506") {
            values.insert(name.into(), met_mm);
        } else if let Some((name, sum)) = line.split_once(" = [[") {
            // [[5 - [#<touch_1> + #<touch_2>] / 2] * 1000]
            let (expected, touches) = sum.split_once(" - [").expect("a mean");
            let (touches, rest) = touches.split_once(']').expect("a mean");
            assert_eq!(rest, " / 2] * 1000]", "{line}");
            let found: f64 = touches.split(" + ").map(|touch| values[touch]).sum();
            let expected: f64 = expected.parse().expect("a number");
            values.insert(name.into(), (expected - found / 2.0) * 1000.0);
        }
    }
    log
}

/// `X5 F500`, `X[5-#<shift_x>] F500`.
fn place_of(place: &str) -> (usize, f64) {
    let axis = "XYZ".find(&place[..1]).expect("an axis");
    let number: String = place[1..]
        .trim_start_matches('[')
        .chars()
        .enumerate()
        .take_while(|(n, c)| c.is_ascii_digit() || *c == '.' || (*n == 0 && *c == '-'))
        .map(|(_, c)| c)
        .collect();
    (axis, number.parse().expect("a number"))
}

/// The operator changes the stylus, or turns the table.
fn obey(state: &mut State, message: &str) {
    let number = |text: &str| -> f64 {
        text.split_whitespace().next().and_then(|word| word.parse().ok()).expect("a number")
    };
    if let Some((_, length)) = message.split_once("Put in the stylus of ") {
        state.tool_mm = number(length);
    }
    for (n, name) in ["A", "B", "C"].into_iter().enumerate() {
        if let Some((_, deg)) = message.split_once(&format!("{name} stands at ")) {
            state.deg[n] = number(deg);
        }
    }
}

/// Returns where the probe closes on the way, by the scale of the axis; the machine is then there.
fn contact(
    state: &mut State,
    truth: &Truth,
    axis: usize,
    to_mm: f64,
    is_closed: &mut impl FnMut([f64; 3], [f64; 3]) -> bool,
) -> Option<f64> {
    let from_mm = state.mm[axis];
    let mut at = |state: &mut State, mm: f64| {
        state.mm[axis] = mm;
        let tip_mm = state.tip_mm(truth);
        is_closed(tip_mm, state.deg)
    };
    let steps = ((to_mm - from_mm).abs() / STEP_MM).ceil().max(1.0);
    let place = |n: f64| from_mm + (to_mm - from_mm) * n / steps;
    let mut n = 0.0;
    while n < steps && !at(state, place(n + 1.0)) {
        n += 1.0;
    }
    if n == steps {
        return None;
    }
    let (mut open, mut closed) = (place(n), place(n + 1.0));
    while (closed - open).abs() > 1e-7 {
        let middle = 0.5 * (open + closed);
        match at(state, middle) {
            true => closed = middle,
            false => open = middle,
        }
    }
    state.mm[axis] = closed;
    Some(closed)
}
