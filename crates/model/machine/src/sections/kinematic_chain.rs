//! The kinematic chain: which axis carries what, in the letters of ISO 10791-6.
//!
//! ```text
//! w C' A' X' b Y Z t       workpiece on C on A on X on the bed; the bed carries Y, Y carries Z, Z the tool
//! ```
//!
//! From the workpiece (w) over the bed (b) to the tool (t); an axis with ' moves the workpiece. A spindle in
//! brackets, `(C1)`, says nothing that is needed here and is passed over. Blanks make no difference.

use std::fmt;

use super::{LinearAxis, RotaryAxis};

/// The axes between the workpiece and the tool.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AxisChain {
    /// The linear axes from the workpiece to the tool, each once.
    pub linear: [LinearAxis; 3],
    /// How many of them, the first, move the workpiece.
    pub on_workpiece: usize,
    /// The rotary axes that turn the tool, from the frame to the tool.
    pub head: Vec<RotaryAxis>,
    /// The rotary axes that turn the workpiece, from the bed to the workpiece.
    pub table: Vec<RotaryAxis>,
}

impl AxisChain {
    /// Returns the rotary axes in the order of the CNC's angles: those of the tool, then those of the workpiece.
    #[must_use]
    pub fn rotary_axes(&self) -> Vec<RotaryAxis> {
        self.head.iter().chain(&self.table).copied().collect()
    }

    /// Returns whether a linear axis moves the workpiece.
    #[must_use]
    pub fn moves_workpiece(&self, axis: LinearAxis) -> bool {
        self.linear.iter().take(self.on_workpiece).any(|candidate| *candidate == axis)
    }

    /// Returns the axes whose positions are part of the lever of `axis`: those between it and the tool, and its own
    /// where it moves the workpiece.
    #[must_use]
    pub fn lever_axes(&self, axis: LinearAxis) -> &[LinearAxis] {
        let own = self.linear.iter().position(|candidate| *candidate == axis).unwrap_or(0);
        let first = if self.moves_workpiece(axis) { own } else { own + 1 };
        self.linear.get(first..).unwrap_or_default()
    }

    /// Reads a chain.
    ///
    /// # Errors
    /// The rule that is broken; it goes on after the key.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let links = parse_chain_links(text)?;
        let at = |letter: char| links.iter().position(|link| link.letter == letter);
        let (Some(0), Some(bed), Some(last)) = (at('w'), at('b'), at('t')) else {
            return Err("must begin with w (workpiece), pass b (bed) and end with t (tool)".into());
        };
        if last + 1 != links.len() {
            return Err("must end with t, the tool".into());
        }
        for (number, link) in links.iter().enumerate() {
            if links.iter().skip(number + 1).any(|other| other.letter == link.letter) {
                return Err(format!("has {} twice", link.letter));
            }
        }
        let (workpiece, tool) = (&links[1..bed], &links[bed + 1..last]);
        if let Some(link) = workpiece.iter().find(|link| !link.is_primed) {
            let letter = link.letter;
            return Err(format!(
                "has {letter} between w and b without ': it moves the workpiece, {letter}'"
            ));
        }
        if let Some(link) = tool.iter().find(|link| link.is_primed) {
            let letter = link.letter;
            return Err(format!("has {letter}' between b and t: it moves the tool, {letter}"));
        }
        let linear: Vec<LinearAxis> = links.iter().filter_map(ChainLink::linear_axis).collect();
        let linear = <[LinearAxis; 3]>::try_from(linear).map_err(|found| {
            let missing = LinearAxis::ALL.into_iter().find(|axis| !found.contains(axis));
            format!("lacks {}", missing.map_or("an axis", LinearAxis::name).to_uppercase())
        })?;
        let table: Vec<RotaryAxis> =
            workpiece.iter().rev().filter_map(ChainLink::rotary_axis).collect();
        let head: Vec<RotaryAxis> = tool.iter().filter_map(ChainLink::rotary_axis).collect();
        // Where no rotary axis carries them, positions are along the machine's own axes.
        let is_turned = |from_bed: Vec<&ChainLink>| {
            let mut pairs = from_bed.windows(2);
            pairs.any(|pair| pair[0].rotary_axis().is_some() && pair[1].linear_axis().is_some())
        };
        if is_turned(workpiece.iter().rev().collect()) || is_turned(tool.iter().collect()) {
            return Err("has a linear axis on a rotary one: X, Y and Z must be next to the bed, where they keep \
                        their directions"
                .into());
        }
        let on_workpiece = workpiece.iter().filter_map(ChainLink::linear_axis).count();
        Ok(Self { linear, on_workpiece, head, table })
    }
}

impl fmt::Display for AxisChain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("w")?;
        for axis in self.table.iter().rev() {
            write!(f, " {}'", axis.name().to_uppercase())?;
        }
        for (number, axis) in self.linear.iter().enumerate() {
            if number == self.on_workpiece {
                f.write_str(" b")?;
            }
            let prime = if number < self.on_workpiece { "'" } else { "" };
            write!(f, " {}{prime}", axis.name().to_uppercase())?;
        }
        if self.on_workpiece == self.linear.len() {
            f.write_str(" b")?;
        }
        for axis in &self.head {
            write!(f, " {}", axis.name().to_uppercase())?;
        }
        f.write_str(" t")
    }
}

/// A letter, and whether it has a '.
struct ChainLink {
    letter: char,
    is_primed: bool,
}

impl ChainLink {
    fn linear_axis(&self) -> Option<LinearAxis> {
        let name = self.letter.to_ascii_lowercase().to_string();
        LinearAxis::ALL.into_iter().find(|axis| self.letter.is_uppercase() && axis.name() == name)
    }

    fn rotary_axis(&self) -> Option<RotaryAxis> {
        let name = self.letter.to_ascii_lowercase().to_string();
        RotaryAxis::ALL.into_iter().find(|axis| self.letter.is_uppercase() && axis.name() == name)
    }
}

fn parse_chain_links(text: &str) -> Result<Vec<ChainLink>, String> {
    let mut links: Vec<ChainLink> = Vec::new();
    let mut letters = text.chars();
    while let Some(letter) = letters.next() {
        match letter {
            ' ' | '-' => {}
            // The spindle.
            '(' => {
                if !letters.any(|letter| letter == ')') {
                    return Err("has ( without )".into());
                }
            }
            '\'' | '′' | '’' => match links.last_mut() {
                Some(link) if link.letter.is_ascii_uppercase() && !link.is_primed => {
                    link.is_primed = true
                }
                _ => return Err("has ' without an axis before it".into()),
            },
            'w' | 'b' | 't' | 'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' => {
                links.push(ChainLink { letter, is_primed: false });
            }
            other => {
                return Err(format!(
                    "has {}, which is none of w, b, t, X, Y, Z, A, B, C, each with ' where it moves the workpiece",
                    other.escape_debug()
                ));
            }
        }
    }
    Ok(links)
}
