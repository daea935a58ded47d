//! Events that a program causes on a machine, in no control's words.

/// Where a word sends an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum To {
    /// A machine coordinate in mm.
    Machine(f64),
    /// A way in mm from where the control stands.
    By(f64),
}

/// What a contact does to a move of a probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sort {
    /// It ends the program.
    Guarded,
    /// It is looked for, and ends the move.
    Touch,
    /// It is left.
    Away,
}

/// An event; repeats are written out.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The control waits, with these words in front of the operator.
    Stop(String),
    /// Axes go in a straight line; a feed of `None` is rapid.
    Go {
        to: [Option<To>; 3],
        feed: Option<f64>,
        /// True if the move depends on no mode of an earlier program.
        has_modes: bool,
    },
    /// A probe goes to a place, or touches what is on the way to it.
    Probe {
        axis: usize,
        mm: f64,
        feed: f64,
        sort: Sort,
        /// True if neither a mode nor a rotation of an earlier program has a part in it.
        has_modes: bool,
    },
    /// A row of the run file, by its columns.
    Row(Vec<(String, String)>),
    /// Two axes go around a centre.
    Around {
        /// The axes of the plane, in the order in which G3 turns the first to the second.
        axes: [usize; 2],
        is_ccw: bool,
        /// The way to the end and the way to the centre in mm.
        end: [f64; 2],
        centre: [f64; 2],
        feed: Option<f64>,
        /// True if neither a mode nor a rotation of an earlier program has a part in it.
        has_modes: bool,
    },
    /// In r/min.
    Spindle(f64),
    /// It stands, and a reading may be taken.
    Dwell(f64),
    /// The program ends; true: no increments are left for the next one.
    End(bool),
}

/// Returns the words of a block: letter and number, in their order.
pub fn words(block: &str) -> Result<Vec<(char, f64)>, String> {
    let mut found = Vec::new();
    for word in block.split_whitespace() {
        let mut letters = word.chars();
        let letter = letters.next().filter(char::is_ascii_uppercase);
        let number = letters.as_str().parse::<f64>().ok().filter(|number| number.is_finite());
        match (letter, number) {
            (Some(letter), Some(number)) => found.push((letter, number)),
            _ => return Err(format!("a word that no reader knows: {word} in {block}")),
        }
    }
    Ok(found)
}

/// X, Y, Z: 0, 1, 2.
pub fn axis(letter: char) -> Option<usize> {
    "XYZ".find(letter)
}

/// Returns the axes of a plane in the order in which G3 turns the first to the second.
pub fn plane(code: f64) -> Option<[usize; 2]> {
    match code {
        17.0 => Some([0, 1]),
        18.0 => Some([2, 0]),
        19.0 => Some([1, 2]),
        _ => None,
    }
}

/// Returns the numbers of the words with the letters of two axes; none other may be there.
pub fn of_axes(found: &[(char, f64)], letters: &str, axes: [usize; 2]) -> Result<[f64; 2], String> {
    let own: Vec<(usize, f64)> = found
        .iter()
        .filter_map(|(letter, number)| Some((letters.find(*letter)?, *number)))
        .collect();
    let of = |axis: usize| own.iter().find(|word| word.0 == axis).map(|word| word.1);
    match (own.len(), of(axes[0]), of(axes[1])) {
        (2, Some(u), Some(v)) => Ok([u, v]),
        _ => Err(format!("not the axes of the plane: {found:?}")),
    }
}

/// No line of a comment or message is longer, and none has a character that a control does not take.
pub fn is_legal(text: &str, longest: usize, also: &str) -> Result<(), String> {
    let is_known =
        |c: char| c.is_ascii_alphanumeric() || " .,+-/=#*".contains(c) || also.contains(c);
    match text.chars().find(|c| !is_known(*c)) {
        Some(c) => Err(format!("{c:?} in a comment: {text}")),
        None if text.len() > longest => Err(format!("a comment of {}: {text}", text.len())),
        None => Ok(()),
    }
}
