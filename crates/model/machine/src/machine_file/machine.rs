//! `[machine]`: which machine it is, and where its tool points.

use super::Term;
use crate::{
    inputs::BoardInputs,
    keys::{
        reader::Section,
        section::NewSection,
        table::{Table, choice, table},
    },
    location::{InputFileError, KeyLocations, truncate_text},
    sections::{
        AngleProfile, AxisChain, AxisModel, Limits, LinearAxis, PitchErrorTable, RotaryAxis,
        Spindle, Squareness, Straightness, VolumetricModel,
    },
};

/// The user's model of the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// The user's name for it.
    pub name: String,
    /// Its serial number, which distinguishes it from another one of that name.
    pub serial: Option<String>,
    /// The number of the board's chip, 96 bits, the lowest word first, where the calibration is for that board alone.
    pub board: Option<[u32; 3]>,
    /// Which axes turn the tool or the table.
    pub kind: MachineKind,
    /// The rotary axes that carry the spindle, from the frame to the tool; as many as
    /// `MachineKind::head_axis_count` says, and no axis twice.
    pub head_axes: Vec<RotaryAxis>,
    /// From the spindle nose to the tool tip with all angles at zero, of length 1.
    pub tool_direction: [f64; 3],
    /// The inputs connected to the board; absent where the machine is only used to predict.
    pub inputs: Option<BoardInputs>,
    /// How the spindle grows.
    pub spindle: Spindle,
    /// The models of X, Y and Z, by [`LinearAxis::index`](crate::sections::LinearAxis::index).
    pub axes: [AxisModel; 3],
    /// The straightness curves; no pair of axes twice.
    pub straightness: Vec<Straightness>,
    /// The angles between the axes as they are written; no pair of axes twice.
    pub squareness: Vec<Squareness>,
    /// The chain of the axes, their angular and location errors, and where the tool tip is.
    pub volume: VolumetricModel,
    /// How far and how fast an offset may go, and how long silence is tolerated.
    pub limits: Limits,
    /// Thermometers that agree within this in °C belong to a machine that has no heat of its own; 0…5.
    pub cold_within_c: f64,
    /// The expanded uncertainty of one reading of the measuring instrument in µm (95 %, above
    /// 0), where it is known. The board has no use for it.
    pub instrument_um: Option<f64>,
    /// The terms that a diagnosis has added, in the order in which they apply.
    pub terms: Vec<Term>,
    /// Where in the file each key stands, for rules that are found broken later.
    pub places: KeyLocations,
}

choice! {
    /// Which axes turn the tool or the table.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum MachineKind {
        /// X, Y and Z only: the tool direction never changes.
        ThreeAxis = "3-axis",
        /// Two rotary axes carry the spindle.
        HeadHead = "head-head",
        /// Two rotary axes carry the workpiece: the spindle does not turn in machine coordinates.
        TableTable = "table-table",
        /// One rotary axis carries the spindle, the other the workpiece.
        HeadTable = "head-table",
        /// A lathe: the spindle carries the workpiece, the turret moves in X (a radius) and Z. Its tool direction is
        /// the way in which the turret reaches for the chuck.
        Lathe = "lathe",
    }
}

impl MachineKind {
    /// Returns how many rotary axes carry the spindle.
    #[must_use]
    pub(crate) fn head_axis_count(self) -> usize {
        match self {
            Self::ThreeAxis | Self::TableTable | Self::Lathe => 0,
            Self::HeadTable => 1,
            Self::HeadHead => 2,
        }
    }
}

table! {
    /// The keys of `[machine]` as they are written.
    pub(super) struct MachineKeys {
        name: String = key(Text, "", "the machine's name; a board requires confirmation before it runs the calibration of a machine with another name").required().with_example_value("\"mill\"");
        serial: Option<String> = key(Text, "", "its serial number, which identifies it among machines of that name").with_example_value("\"4711\"");
        board: Option<String> = key(Text, "", "the board that the calibration is for: the 24 hexadecimal digits of its chip's number, as `trueup bridge info` prints them").with_example_value("\"003b00213032470e39363634\"");
        kind: MachineKind = key(Choice(MachineKind::NAMES), "", "which rotary axes carry the tool (head) and which the workpiece (table); of a lathe the spindle carries the workpiece, and X is a radius").required().with_example_value("\"3-axis\"");
        head_axes: Vec<String> = key(Choices(RotaryAxis::NAMES), "", "the rotary axes that carry the spindle, from the frame to the tool: two for head-head, one for head-table").with_default("[]").omit_default();
        tool_direction: [f64; 3] = key(Vector, "", "from the spindle nose to the tip with all angles at zero, of a lathe from the turret to the chuck. Any length but 0").with_default("[0.0, 0.0, -1.0]").with_range(range([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], "a direction, at length 1"));
        chain: Option<String> = key(Text, "", "which axis carries what, in the letters of ISO 10791-6. The order is from the workpiece (w) over the bed (b) to the tool (t), with ' what moves the workpiece. X, Y and Z once each, next to the bed. The rotary axes of `head_axes` before t. Needed by `[angular]` and `[rotary]`").with_example_value("\"w X' b Y Z t\"");
    }
}

/// The contents of `[machine]`.
pub(super) struct MachineSection {
    pub name: String,
    pub serial: Option<String>,
    pub board: Option<[u32; 3]>,
    pub kind: MachineKind,
    pub head_axes: Vec<RotaryAxis>,
    pub tool_direction: [f64; 3],
    pub chain: Option<AxisChain>,
}

pub(super) fn read(section: &Section<'_>) -> Result<MachineSection, InputFileError> {
    let MachineKeys { name, serial, board, kind, head_axes, tool_direction, chain } =
        MachineKeys::read(section)?;
    for (key, text) in [("name", Some(&name)), ("serial", serial.as_ref())] {
        if text.is_some_and(|text| text.trim().is_empty()) {
            return Err(section.key_error(key, "must not be empty"));
        }
    }
    let chip = |written: String| {
        let rule =
            "must be the 24 hexadecimal digits of the board's chip, as `bridge info` prints them";
        parse_board_id(&written).ok_or_else(|| section.key_error("board", rule))
    };
    let board = board.map(chip).transpose()?;
    let head_axes = parse_head_axes(section, kind, &head_axes)?;
    let tool_direction = normalise(tool_direction).ok_or_else(|| {
        section.key_error("tool_direction", "has no length: it must point from the nose to the tip")
    })?;
    let chain = chain.map(|written| {
        let chain = AxisChain::parse(&written)?;
        check_chain(&chain, kind, &head_axes).map(|()| chain)
    });
    let chain =
        chain.transpose().map_err(|rule| section.key_error("chain", rule).with_help(CHAIN_HELP))?;
    Ok(MachineSection { name, serial, board, kind, head_axes, tool_direction, chain })
}

const CHAIN_HELP: &str = "the axes from the workpiece (w) over the bed (b) to the tool (t). \
    Mark those that move the workpiece with ', as in chain = \"w C' A' X' b Y Z t\"";

/// Returns the number of a chip, the lowest word first; never 0, which is no chip's.
fn parse_board_id(written: &str) -> Option<[u32; 3]> {
    let is_hex = written.len() == 24 && written.bytes().all(|digit| digit.is_ascii_hexdigit());
    let number = u128::from_str_radix(written, 16).ok().filter(|number| is_hex && *number != 0)?;
    Some([0, 32, 64].map(|bits| (number >> bits & u128::from(u32::MAX)) as u32))
}

/// Returns a chip's number as it is written: 24 hexadecimal digits, the highest first.
#[must_use]
fn format_board_id([low, middle, high]: [u32; 3]) -> String {
    format!("{high:08x}{middle:08x}{low:08x}")
}

fn parse_head_axes(
    section: &Section<'_>,
    kind: MachineKind,
    names: &[String],
) -> Result<Vec<RotaryAxis>, InputFileError> {
    let mut axes = Vec::new();
    for (index, name) in names.iter().enumerate() {
        let axis =
            RotaryAxis::ALL.into_iter().find(|axis| axis.name() == name).ok_or_else(|| {
                let rule =
                    format!("must be \"a\" or \"b\" or \"c\", not \"{}\"", truncate_text(name));
                section.key_error(&format!("head_axes[{index}]"), rule)
            })?;
        axes.push(axis);
    }
    let requested = match kind {
        MachineKind::ThreeAxis => "must be [], because no rotary axis carries the spindle",
        MachineKind::Lathe => "must be [], because the spindle carries the workpiece",
        MachineKind::TableTable => "must be [], because both rotary axes carry the workpiece",
        MachineKind::HeadTable => "must name exactly one axis, the one that carries the spindle",
        MachineKind::HeadHead => "must name exactly two different axes, from the frame to the tool",
    };
    let repeated = axes.len() == 2 && axes.first() == axes.last();
    if axes.len() != kind.head_axis_count() || repeated {
        // At most four of what may be a very long list.
        let there = axes.iter().take(4).map(|axis| format!("\"{}\"", axis.name()));
        let there = there.collect::<Vec<_>>().join(", ");
        let rule = format!("{requested} (kind = \"{}\"), not [{there}]", kind.name());
        return Err(section.key_error("head_axes", rule));
    }
    Ok(axes)
}

/// Holds a chain against the other keys of `[machine]`.
///
/// # Errors
/// The rule that is broken; it goes on after the key.
fn check_chain(
    chain: &AxisChain,
    kind: MachineKind,
    head_axes: &[RotaryAxis],
) -> Result<(), String> {
    if kind == MachineKind::Lathe {
        return Err(
            "is not known for kind = \"lathe\": its workpiece turns with the spindle".into()
        );
    }
    let names = |axes: &[RotaryAxis]| {
        let names = axes.iter().map(|axis| format!("\"{}\"", axis.name()));
        names.collect::<Vec<_>>().join(", ")
    };
    if chain.head != head_axes {
        return Err(format!(
            "turns the tool by [{}], and head_axes is [{}]: they must be the same, in the same order",
            names(&chain.head),
            names(head_axes)
        ));
    }
    let of_kind = match kind {
        MachineKind::HeadTable => 0..=1,
        MachineKind::TableTable => 1..=2,
        MachineKind::ThreeAxis | MachineKind::HeadHead | MachineKind::Lathe => 0..=0,
    };
    if !of_kind.contains(&chain.table.len()) {
        return Err(format!(
            "turns the workpiece by [{}], which is not kind = \"{}\"",
            names(&chain.table),
            kind.name()
        ));
    }
    Ok(())
}

/// `vector` at length 1, or `None` if it has no direction.
fn normalise(vector: [f64; 3]) -> Option<[f64; 3]> {
    // By the largest component first: the squares of very long or short ones leave the range.
    let largest = vector.iter().fold(0.0_f64, |largest, component| largest.max(component.abs()));
    if largest == 0.0 {
        return None;
    }
    let scaled = vector.map(|component| component / largest);
    let length = scaled.iter().map(|component| component * component).sum::<f64>().sqrt();
    Some(scaled.map(|component| component / length))
}

pub(super) fn write(machine: &Machine) -> NewSection {
    let keys = MachineKeys {
        name: machine.name.clone(),
        serial: machine.serial.clone(),
        board: machine.board.map(format_board_id),
        kind: machine.kind,
        head_axes: machine.head_axes.iter().map(|axis| axis.name().to_string()).collect(),
        tool_direction: machine.tool_direction,
        chain: machine.volume.chain.as_ref().map(AxisChain::to_string),
    };
    keys.write(NewSection::new("machine")).with_key_last("tool_direction")
}

impl Machine {
    /// Returns the rotary axes whose angles the CNC sends, in their order: those that turn the tool, then those that
    /// turn the workpiece, as far as the chain says them.
    #[must_use]
    pub fn angle_axes(&self) -> Vec<RotaryAxis> {
        match &self.volume.chain {
            Some(chain) => chain.rotary_axes(),
            None => self.head_axes.clone(),
        }
    }

    /// Returns both ends of an axis in mm: its travel, else where its tables and curves reach.
    pub(crate) fn axis_range_mm(&self, axis: LinearAxis) -> Option<[f64; 2]> {
        let model = &self.axes[axis.index()];
        if model.travel_mm.is_some() {
            return model.travel_mm;
        }
        let tables = [model.pitch.as_ref(), model.dual.as_ref().map(|dual| &dual.pitch)];
        let tables = tables.into_iter().flatten().map(PitchErrorTable::range_mm);
        let curves = self.straightness.iter().filter(|curve| curve.along == axis);
        let curves = curves.filter_map(|curve| curve.spline.range_mm());
        let angles = self.volume.angular.iter().filter(|angular| angular.along == axis);
        let angles = angles.filter_map(|angular| match &angular.angle {
            AngleProfile::Curve(spline) => spline.range_mm(),
            AngleProfile::Line(_) => None,
        });
        tables.chain(curves).chain(angles).reduce(|[a, b], [c, d]| [a.min(c), b.max(d)])
    }
}
