//! Events that a program causes on a machine, in no control's words.

/// Where a word sends an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum To {
    /// A machine coordinate in mm.
    Machine(f64),
    /// A way in mm from where the control stands.
    By(f64),
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
