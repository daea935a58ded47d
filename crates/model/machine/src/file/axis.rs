//! `[axis.x]`, `[axis.y]`, `[axis.z]`: what is known of one linear axis along its own direction.

use super::{inputs::read_temperature_column, read::Section, write::section::NewSection};
use crate::location::BadInput;

/// A linear axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LinearAxis {
    /// X; positions in mm, positive as the CNC counts them.
    X,
    /// Y; positions in mm, positive as the CNC counts them.
    Y,
    /// Z; positions in mm, positive as the CNC counts them.
    Z,
}

impl LinearAxis {
    /// X, Y and Z.
    pub const ALL: [Self; 3] = [Self::X, Self::Y, Self::Z];

    /// 0, 1 or 2: its place in an array of X, Y and Z.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["x", "y", "z"][self.index()]
    }
}

/// A rotary axis: it turns about X, Y or Z, by the right hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RotaryAxis {
    /// About X; angles in degrees, positive by the right hand.
    A,
    /// About Y; angles in degrees, positive by the right hand.
    B,
    /// About Z; angles in degrees, positive by the right hand.
    C,
}

impl RotaryAxis {
    /// A, B and C.
    pub const ALL: [Self; 3] = [Self::A, Self::B, Self::C];

    /// 0, 1 or 2: its place in an array of A, B and C.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["a", "b", "c"][self.index()]
    }
}

/// The model of one linear axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AxisModel {
    /// Where its position is measured.
    pub feedback: Feedback,
    /// How far it may be sent, in mm of machine coordinates, the lower end first; `None`: not
    /// known. For programs that measure; no correction depends on it.
    pub travel_mm: Option<[f64; 2]>,
    /// Its rapid traverse in mm a minute, above 0; `None`: not known. The slew limit and the CNC's positions
    /// are held against it; no correction depends on it.
    pub rapid_mm_per_min: Option<f64>,
    /// How it grows with a temperature.
    pub thermal: Option<Thermal>,
    /// Its position errors; of the first of two drives where there is a `dual`.
    pub pitch: Option<Pitch>,
    /// Its backlash; only with feedback on the screw, and not next to a reverse table.
    pub backlash: Option<Backlash>,
    /// The second drive; only next to a `pitch`.
    pub dual: Option<Dual>,
}

/// Where an axis's position is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Feedback {
    /// On the screw: what is behind it (backlash) is not seen.
    #[default]
    Screw,
    /// By a scale on the axis.
    Scale,
}

/// How an axis grows with a temperature: ΔK(T) = K₀(T) + tanβ(T)·(P − P₀).
#[derive(Clone, Debug, PartialEq)]
pub struct Thermal {
    /// Which of the two terms there are.
    pub mode: ThermalMode,
    /// The run-file column of T, `temp_<name>_c`.
    pub sensor: String,
    /// T₀: where ΔK is 0, in °C. Not used (and 0 if it is not written) where there is a table.
    pub reference_c: f64,
    /// K₀ = this · (T − T₀), in µm for one °C. Not used where there is a table.
    pub constant_um_per_c: f64,
    /// tanβ = this · (T − T₀), in µm/m for one °C. Not used where there is a table.
    pub slope_um_per_m_per_c: f64,
    /// P₀: where the second term is 0, in mm.
    pub origin_mm: f64,
    /// The time constant of the first-order lag behind the sensor, in s; 0: none.
    pub lag_s: f64,
    /// K₀ and tanβ over T instead of the two constants; at least one row, T rising.
    pub table: Option<Vec<ThermalRow>>,
}

impl Thermal {
    /// The same law at a temperature that is higher by `shift_c`: ΔK(T) becomes ΔK(T − shift). A
    /// table moves as a whole.
    ///
    /// ```
    /// use trueup_machine::file::{Thermal, ThermalMode, ThermalRow};
    /// use trueup_machine::model::thermal_law;
    /// let row = |temperature_c, slope_um_per_m| {
    ///     ThermalRow { temperature_c, constant_um: 0.0, slope_um_per_m }
    /// };
    /// let mut axis = Thermal {
    ///     mode: ThermalMode::Position, sensor: "temp_screw_c".into(), reference_c: 20.0,
    ///     constant_um_per_c: 0.0, slope_um_per_m_per_c: 0.0, origin_mm: 0.0, lag_s: 0.0,
    ///     table: Some(vec![row(20.0, 0.0), row(30.0, 100.0)]),
    /// };
    /// axis.shift_reference(2.0);
    /// assert_eq!(thermal_law(&axis, 27.0), (0.0, 50.0)); // as at 25 °C before
    /// ```
    pub fn shift_reference(&mut self, shift_c: f64) {
        self.reference_c += shift_c;
        for row in self.table.iter_mut().flatten() {
            row.temperature_c += shift_c;
        }
    }
}

/// Which terms ΔK(T) has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThermalMode {
    /// K₀(T) alone: the same at every position.
    Constant,
    /// tanβ(T)·(P − P₀) alone.
    Position,
    /// K₀(T) + tanβ(T)·(P − P₀).
    Both,
}

impl ThermalMode {
    /// Its name in the machine file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Position => "position",
            Self::Both => "both",
        }
    }

    /// Returns whether K₀(T) counts.
    #[must_use]
    pub fn has_constant(self) -> bool {
        self != Self::Position
    }

    /// Returns whether tanβ(T)·(P − P₀) counts, and so the position.
    #[must_use]
    pub fn has_position(self) -> bool {
        self != Self::Constant
    }
}

/// One row of a thermal table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalRow {
    /// T in °C.
    pub temperature_c: f64,
    /// K₀(T) in µm.
    pub constant_um: f64,
    /// tanβ(T) in µm/m.
    pub slope_um_per_m: f64,
}

/// Position errors at points of equal distance: actual minus commanded, linear between the points,
/// the end values held outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Pitch {
    /// The first point, in mm.
    pub start_mm: f64,
    /// From point to point, in mm; above 0.
    pub step_mm: f64,
    /// The error at each point, in µm, approached in the positive direction; at least one.
    pub forward_um: Vec<f64>,
    /// The same in the negative direction, as many; `None`: the forward table serves both.
    pub reverse_um: Option<Vec<f64>>,
}

/// How far the table is left behind where an axis is approached in the negative direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Backlash {
    /// The error of an approach in the negative direction, in µm; negative for a CNC that
    /// over-compensates.
    pub width_um: f64,
    /// On the board it comes in over this much travel after a reversal, in mm; at least 0.
    pub ramp_mm: f64,
    /// On the board a reversal counts once the axis has moved so far, in µm; at least 0.
    pub hysteresis_um: f64,
}

/// The second drive of a gantry that is driven at both ends.
#[derive(Clone, Debug, PartialEq)]
pub struct Dual {
    /// The axis along the beam from drive to drive; not the driven axis itself.
    pub across: LinearAxis,
    /// Where on it the first drive is, in mm: the axis's own `pitch` is true there.
    pub first_mm: f64,
    /// Where the second one is, in mm; not `first_mm`.
    pub second_mm: f64,
    /// The second drive's position errors.
    pub pitch: Pitch,
}

pub(super) fn read(section: &Section<'_>) -> Result<[AxisModel; 3], BadInput> {
    let mut axes = <[AxisModel; 3]>::default();
    for (axis, of) in axes.iter_mut().zip(LinearAxis::ALL) {
        if let Some(section) = section.section(of.name())? {
            *axis = read_axis(&section, of)?;
        }
    }
    Ok(axes)
}

fn read_axis(section: &Section<'_>, of: LinearAxis) -> Result<AxisModel, BadInput> {
    let feedbacks = [("screw", Feedback::Screw), ("scale", Feedback::Scale)];
    let axis = AxisModel {
        feedback: section.choice("feedback", &feedbacks)?.unwrap_or_default(),
        travel_mm: read_travel(section)?,
        rapid_mm_per_min: section.positive("rapid_mm_per_min")?,
        thermal: section.section("thermal")?.map(|thermal| read_thermal(&thermal)).transpose()?,
        pitch: section.section("pitch")?.map(|pitch| read_pitch(&pitch)).transpose()?,
        backlash: section.section("backlash")?.map(|lash| read_backlash(&lash)).transpose()?,
        dual: section.section("dual")?.map(|dual| read_dual(&dual, of)).transpose()?,
    };
    if axis.dual.is_some() && axis.pitch.is_none() {
        let rule = format!(
            "needs [axis.{}.pitch], the first drive's table: the error is shared between the two",
            of.name()
        );
        return Err(section.bad("dual", rule));
    }
    if axis.backlash.is_some() {
        if axis.feedback == Feedback::Scale {
            let rule = "belongs to feedback = \"screw\": a scale on the axis sees the backlash, \
                        and the CNC's own loop takes it out";
            return Err(section.bad("backlash", rule));
        }
        let second = axis.dual.as_ref().map(|dual| &dual.pitch);
        if axis.pitch.iter().chain(second).any(|pitch| pitch.reverse_um.is_some()) {
            let rule = "cannot stand beside a reverse_um table on the same axis, which contains \
                        the backlash already";
            return Err(section.bad("backlash", rule));
        }
    }
    Ok(axis)
}

fn read_travel(section: &Section<'_>) -> Result<Option<[f64; 2]>, BadInput> {
    let Some(ends) = section.numbers("travel_mm")? else { return Ok(None) };
    match ends[..] {
        [low, high] if low < high => Ok(Some([low, high])),
        _ => {
            let rule = "must be the two ends of the travel, the lower one first: [0.0, 1000.0]";
            Err(section.bad("travel_mm", rule))
        }
    }
}

fn read_thermal(section: &Section<'_>) -> Result<Thermal, BadInput> {
    let modes = [ThermalMode::Constant, ThermalMode::Position, ThermalMode::Both]
        .map(|mode| (mode.name(), mode));
    let number = |key| section.number(key).map(Option::unwrap_or_default);
    let mode = section.required("mode", section.choice("mode", &modes)?)?;
    let sensor = section.required("sensor", read_temperature_column(section, "sensor")?)?;
    let table = section.rows("table")?.map(|rows| read_thermal_rows(section, rows)).transpose()?;
    let reference_c = match section.number("reference_c")? {
        None if table.is_some() => 0.0,
        reference_c => section.required("reference_c", reference_c)?,
    };
    Ok(Thermal {
        mode,
        sensor,
        reference_c,
        constant_um_per_c: number("constant_um_per_c")?,
        slope_um_per_m_per_c: number("slope_um_per_m_per_c")?,
        origin_mm: number("origin_mm")?,
        lag_s: section.not_negative("lag_s")?.unwrap_or(0.0),
        table,
    })
}

fn read_thermal_rows(
    section: &Section<'_>,
    rows: Vec<[f64; 3]>,
) -> Result<Vec<ThermalRow>, BadInput> {
    for (row, pair) in rows.windows(2).enumerate() {
        if let [[before, ..], [after, ..]] = pair
            && after <= before
        {
            let rule =
                format!("{after} is not above {before}: T must rise from each row to the next");
            return Err(section.bad(&format!("table[{}][0]", row + 1), rule));
        }
    }
    let row = |[temperature_c, constant_um, slope_um_per_m]: [f64; 3]| ThermalRow {
        temperature_c,
        constant_um,
        slope_um_per_m,
    };
    Ok(rows.into_iter().map(row).collect())
}

/// Returns a position table among the keys of `section`, which may have others.
pub(crate) fn read_pitch(section: &Section<'_>) -> Result<Pitch, BadInput> {
    let start_mm = section.required("start_mm", section.number("start_mm")?)?;
    let step_mm = section.required("step_mm", section.positive("step_mm")?)?;
    let forward_um = section.required("forward_um", section.numbers("forward_um")?)?;
    let reverse_um = section.numbers("reverse_um")?;
    if let Some(reverse_um) = &reverse_um
        && reverse_um.len() != forward_um.len()
    {
        let rule = format!(
            "has {} elements, but forward_um has {}: both are measured at the same points",
            reverse_um.len(),
            forward_um.len()
        );
        return Err(section.bad("reverse_um", rule));
    }
    Ok(Pitch { start_mm, step_mm, forward_um, reverse_um })
}

fn read_backlash(section: &Section<'_>) -> Result<Backlash, BadInput> {
    Ok(Backlash {
        width_um: section.required("width_um", section.number("width_um")?)?,
        ramp_mm: section.not_negative("ramp_mm")?.unwrap_or(0.0),
        hysteresis_um: section.not_negative("hysteresis_um")?.unwrap_or(0.0),
    })
}

fn read_dual(section: &Section<'_>, driven: LinearAxis) -> Result<Dual, BadInput> {
    let names = LinearAxis::ALL.map(|axis| (axis.name(), axis));
    let across = section.required("across", section.choice("across", &names)?)?;
    if across == driven {
        let rule = format!(
            "must be another axis than \"{}\": the drives stand apart across the driven axis",
            driven.name()
        );
        return Err(section.bad("across", rule));
    }
    let first_mm = section.required("first_mm", section.number("first_mm")?)?;
    let second_mm = section.required("second_mm", section.number("second_mm")?)?;
    if first_mm == second_mm {
        let rule = format!("must not be first_mm = {first_mm}: the drives stand apart");
        return Err(section.bad("second_mm", rule));
    }
    let pitch = section.required("pitch", section.section("pitch")?)?;
    Ok(Dual { across, first_mm, second_mm, pitch: read_pitch(&pitch)? })
}

/// Returns the sections of the axis `of`.
pub(super) fn write(axis: &AxisModel, of: LinearAxis) -> Vec<NewSection> {
    let name = format!("axis.{}", of.name());
    let mut sections = Vec::new();
    let is_scale = axis.feedback == Feedback::Scale;
    if is_scale || axis.travel_mm.is_some() || axis.rapid_mm_per_min.is_some() {
        let mut own = NewSection::new(&name);
        if is_scale {
            own = own.text("feedback", "scale");
        }
        if let Some(ends) = axis.travel_mm {
            own = own.numbers("travel_mm", &ends[..]);
        }
        if let Some(rapid) = axis.rapid_mm_per_min {
            own = own.number("rapid_mm_per_min", rapid);
        }
        sections.push(own);
    }
    sections.extend(axis.thermal.as_ref().map(|thermal| write_thermal(&name, thermal)));
    sections.extend(
        axis.pitch
            .as_ref()
            .map(|pitch| write_pitch(NewSection::new(format!("{name}.pitch")), pitch)),
    );
    if let Some(Dual { across, first_mm, second_mm, pitch }) = &axis.dual {
        let dual = NewSection::new(format!("{name}.dual")).text("across", across.name());
        sections.push(dual.number("first_mm", *first_mm).number("second_mm", *second_mm));
        sections.push(write_pitch(NewSection::new(format!("{name}.dual.pitch")), pitch));
    }
    if let Some(Backlash { width_um, ramp_mm, hysteresis_um }) = axis.backlash {
        let backlash = NewSection::new(format!("{name}.backlash")).number("width_um", width_um);
        sections.push(backlash.number("ramp_mm", ramp_mm).number("hysteresis_um", hysteresis_um));
    }
    sections
}

fn write_thermal(axis: &str, thermal: &Thermal) -> NewSection {
    let section = NewSection::new(format!("{axis}.thermal"))
        .text("mode", thermal.mode.name())
        .text("sensor", &thermal.sensor);
    let section = match &thermal.table {
        Some(table) => {
            let row = |row: &ThermalRow| [row.temperature_c, row.constant_um, row.slope_um_per_m];
            section
                .rows("table", table.iter().map(row).collect::<Vec<_>>())
                .note("table", "T in °C, K0 in µm, slope in µm/m")
        }
        None => section
            .number("reference_c", thermal.reference_c)
            .number("constant_um_per_c", thermal.constant_um_per_c)
            .number("slope_um_per_m_per_c", thermal.slope_um_per_m_per_c),
    };
    section.number("origin_mm", thermal.origin_mm).number("lag_s", thermal.lag_s)
}

/// Returns the keys of a position table, after those that `section` has.
pub(super) fn write_pitch(section: NewSection, pitch: &Pitch) -> NewSection {
    let section = section
        .number("start_mm", pitch.start_mm)
        .number("step_mm", pitch.step_mm)
        .numbers("forward_um", &pitch.forward_um[..]);
    match &pitch.reverse_um {
        Some(reverse_um) => section.numbers("reverse_um", &reverse_um[..]),
        None => section,
    }
}
