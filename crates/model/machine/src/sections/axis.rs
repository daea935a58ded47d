//! `[axis.x]`, `[axis.y]`, `[axis.z]`: what is known of one linear axis along its own direction.

use crate::{
    keys::{
        key::{Key, section},
        reader::Section,
        section::{NewSection, Value},
        table::{KeyValue, Table, choice, table},
    },
    location::InputFileError,
};

choice! {
    /// A linear axis.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum LinearAxis {
        /// X; positions in mm, positive as the CNC counts them.
        X = "x",
        /// Y; positions in mm, positive as the CNC counts them.
        Y = "y",
        /// Z; positions in mm, positive as the CNC counts them.
        Z = "z",
    }
}

impl LinearAxis {
    /// 0, 1 or 2: its place in an array of X, Y and Z.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// Returns the column of a run that has its position.
    #[must_use]
    pub fn column_name(self) -> String {
        format!("{}_mm", self.name())
    }
}

choice! {
    /// A rotary axis: it turns about X, Y or Z, by the right hand.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum RotaryAxis {
        /// About X; angles in degrees, positive by the right hand.
        A = "a",
        /// About Y; angles in degrees, positive by the right hand.
        B = "b",
        /// About Z; angles in degrees, positive by the right hand.
        C = "c",
    }
}

impl RotaryAxis {
    /// 0, 1 or 2: its place in an array of A, B and C.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }
}

table! {
    /// The model of one linear axis.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct AxisModel {
        feedback: Feedback = key(Choice(Feedback::NAMES), "", "where the position is measured; backlash belongs to a screw").with_default("\"screw\"").omit_default();
        /// In mm of machine coordinates.
        travel_mm: Option<[f64; 2]> = key(Numbers, "mm", "the two ends of the travel, the lower one first; for `trueup program` and `check`, no correction depends on it").with_example_value("[0.0, 1000.0]");
        rapid_mm_per_min: Option<f64> = key(Positive, "mm/min", "the rapid traverse: `trueup check` compares the slew limit with 1 % of it; the board rejects positions that the axis cannot reach at this speed").with_example_value("15000.0").with_range(range([0.0, 1e7], [100.0, 3e5], [5000.0, 1e5], MACHINE_DATA_SOURCE).with_hint_below("probably in m/min instead of mm/min"));
        thermal: Option<ThermalLaw> = key(Table(ThermalLaw::KEYS), "", "how the axis grows with a temperature");
        pitch: Option<PitchErrorTable> = key(Table(PitchErrorTable::KEYS), "", "position errors at points of equal distance, linear between them; of the first of two drives where there is `dual`");
        backlash: Option<Backlash> = key(Table(Backlash::KEYS), "", "what a reversal leaves behind; not together with `reverse_um`");
        dual: Option<SecondDrive> = key(Table(SecondDrive::KEYS), "", "a gantry driven at both ends: the second drive");
    }
}

choice! {
    /// Where an axis's position is measured.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum Feedback {
        /// On the screw: what is behind it (backlash) is not seen.
        #[default]
        Screw = "screw",
        /// By a scale on the axis.
        Scale = "scale",
    }
}

table! {
    /// How an axis grows with a temperature: ΔK(T) = K₀(T) + tanβ(T)·(P − P₀).
    #[derive(Clone, Debug, PartialEq)]
    pub struct ThermalLaw {
        mode: ThermalMode = key(Choice(ThermalMode::NAMES), "", "which part there is: the same everywhere, in proportion to the position, both").required().with_example_value("\"position\"");
        /// The run-file column of T, `temp_<name>_c`.
        sensor: String = key(Column, "", "the column of the temperature").required().with_example_value("\"temp_screw_c\"");
        /// T₀. Not used, and 0 where it is not written, next to a table.
        reference_c: f64 = key(Number, "°C", "where the axis is right; needed without a `table`").with_example_value("20.0");
        /// K₀ = this · (T − T₀). Not used next to a table.
        constant_um_per_c: f64 = key(Number, "µm/K", "the same at every position").with_default("0.0").with_range(range([-500.0, 500.0], [-150.0, 150.0], [-20.0, 20.0], EXPANSION_SOURCE).with_hint_above(NANOMETRES_HINT));
        /// tanβ = this · (T − T₀). Not used next to a table.
        slope_um_per_m_per_c: f64 = key(Number, "µm/(m·K)", "in proportion to the distance from `origin_mm`; steel 11.5").with_default("0.0").with_range(range([-500.0, 500.0], [0.0, 100.0], [8.0, 25.0], EXPANSION_SOURCE).with_hint_below(AXIS_SIGN_HINT).with_hint_above(EXPANSION_UNIT_HINT));
        /// P₀.
        origin_mm: f64 = key(Number, "mm", "where the proportional part is 0").with_default("0.0");
        /// 0: no lag.
        lag_s: f64 = key(NotNegative, "s", "time constant by which the axis follows the temperature; the board adds 1 s").with_default("0.0").with_range(range([0.0, 5e5], [0.0, 2e5], [0.0, 4e4], TIME_CONSTANT_SOURCE).with_hint_above(MILLISECONDS_HINT));
        /// K₀ and tanβ over T; at least one row.
        table: Option<Vec<ThermalRow>> = key(Rows, "°C, µm, µm/m", "rows of temperature, constant and slope in the place of the two constants; linear between, temperatures rising").with_example_value("[[20.0, 0.0, 0.0], [40.0, 21.0, 230.0]]").with_range(range([-1e6, 1e6], [-1e5, 1e5], [-1e3, 1e3], ERROR_RANGE_SOURCE));
    }
    checked by require_reference_temperature
}

impl ThermalLaw {
    /// The same law at a temperature that is higher by `shift_c`: ΔK(T) becomes ΔK(T − shift). A
    /// table moves as a whole.
    ///
    /// ```
    /// use trueup_machine::machine_file::{ThermalLaw, ThermalMode, ThermalRow};
    /// use trueup_machine::model::thermal_constant_and_slope;
    /// let row = |temperature_c, slope_um_per_m| {
    ///     ThermalRow { temperature_c, constant_um: 0.0, slope_um_per_m }
    /// };
    /// let mut axis = ThermalLaw {
    ///     mode: ThermalMode::Position, sensor: "temp_screw_c".into(), reference_c: 20.0,
    ///     constant_um_per_c: 0.0, slope_um_per_m_per_c: 0.0, origin_mm: 0.0, lag_s: 0.0,
    ///     table: Some(vec![row(20.0, 0.0), row(30.0, 100.0)]),
    /// };
    /// axis.shift_reference_temperature(2.0);
    /// assert_eq!(thermal_constant_and_slope(&axis, 27.0), (0.0, 50.0)); // as at 25 °C before
    /// ```
    pub fn shift_reference_temperature(&mut self, shift_c: f64) {
        self.reference_c += shift_c;
        for row in self.table.iter_mut().flatten() {
            row.temperature_c += shift_c;
        }
    }
}

choice! {
    /// Which terms ΔK(T) has.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum ThermalMode {
        /// K₀(T) alone: the same at every position.
        Constant = "constant",
        /// tanβ(T)·(P − P₀) alone.
        Position = "position",
        /// K₀(T) + tanβ(T)·(P − P₀).
        Both = "both",
    }
}

impl ThermalMode {
    /// Returns whether K₀(T) counts.
    #[must_use]
    pub fn has_constant_term(self) -> bool {
        self != Self::Position
    }

    /// Returns whether tanβ(T)·(P − P₀) counts, and so the position.
    #[must_use]
    pub fn has_position_term(self) -> bool {
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

table! {
    /// Position errors at points of equal distance: actual minus commanded, linear between the points,
    /// the end values held outside.
    #[derive(Clone, Debug, PartialEq)]
    pub struct PitchErrorTable {
        start_mm: f64 = key(Number, "mm", "the first point").required().with_example_value("0.0");
        step_mm: f64 = key(Positive, "mm", "from point to point").required().with_example_value("100.0").with_range(range([0.0, 1e6], [1e-3, 1e4], [1.0, 500.0], LENGTH_SOURCE).with_hint_above(MICROMETRES_HINT));
        forward_um: Vec<f64> = key(Numbers, "µm", "errors at the points, actual minus commanded; of an approach in the positive direction where there is `reverse_um`").required().with_example_value("[0.0, 1.5, 2.0]");
        /// `None`: the forward table serves both directions.
        reverse_um: Option<Vec<f64>> = key(Numbers, "µm", "the same of an approach in the negative direction, as many; it contains the backlash").with_example_value("[0.5, 2.0, 2.5]");
    }
    checked by check_table_lengths
}

table! {
    /// How far the table is left behind where an axis is approached in the negative direction.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Backlash {
        /// Negative for a CNC that over-compensates.
        width_um: f64 = key(Number, "µm", "error after a move in the negative direction").required().with_example_value("4.0").with_range(range([-5000.0, 5000.0], [-0.5, 300.0], [0.0, 30.0], BACKLASH_SOURCE).with_hint_below(REVERSED_SIGN_HINT).with_hint_above(NANOMETRES_HINT));
        ramp_mm: f64 = key(NotNegative, "mm", "on the board: a ramp over this travel instead of a step").with_default("0.0").with_range(range([0.0, 1e4], [0.0, 50.0], [0.0, 1.0], BACKLASH_SOURCE).with_hint_above(MICROMETRES_HINT));
        hysteresis_um: f64 = key(NotNegative, "µm", "on the board: how far a reversal must go to count").with_default("0.0").with_range(range([0.0, 1e4], [0.0, 300.0], [0.0, 10.0], BACKLASH_SOURCE).with_hint_above(NANOMETRES_HINT));
    }
}

table! {
    /// The second drive of a gantry that is driven at both ends.
    #[derive(Clone, Debug, PartialEq)]
    pub struct SecondDrive {
        /// Not the driven axis itself.
        across: LinearAxis = key(Choice(LinearAxis::NAMES), "", "the axis along the beam, from drive to drive").required().with_example_value("\"y\"");
        /// The axis's own `pitch` is true there.
        first_mm: f64 = key(Number, "mm", "where on it the first drive is").required().with_example_value("0.0");
        /// Not `first_mm`.
        second_mm: f64 = key(Number, "mm", "where on it the second drive is").required().with_example_value("3000.0");
        pitch: PitchErrorTable = key(Table(PitchErrorTable::KEYS), "", "the second drive's table").required();
    }
}

impl PitchErrorTable {
    /// Returns the section of this table of `axis`.
    #[must_use]
    pub fn to_section(&self, axis: LinearAxis) -> NewSection {
        self.write(NewSection::new(format!("axis.{}.pitch", axis.name())))
    }

    /// Returns where the table begins and ends, in mm.
    pub(crate) fn range_mm(&self) -> [f64; 2] {
        let steps = self.forward_um.len().saturating_sub(1) as f64;
        [self.start_mm, self.start_mm + self.step_mm * steps]
    }
}

impl Backlash {
    /// Returns the section of a backlash of `axis` whose width alone is known: all else stays as the user has it.
    #[must_use]
    pub fn width_section(axis: LinearAxis, width_um: f64) -> NewSection {
        const BACKLASH_SHAPE_KEYS: [&str; 2] = [Backlash::KEYS[1].name, Backlash::KEYS[2].name];
        NewSection::new(format!("axis.{}.backlash", axis.name()))
            .with_number(Self::KEYS[0].name, width_um)
            .with_preserved_keys(&BACKLASH_SHAPE_KEYS)
    }
}

pub(crate) const AXIS_KEYS: &[Key] = &[
    section("x", AxisModel::KEYS, "the X axis"),
    section("y", AxisModel::KEYS, "the Y axis"),
    section("z", AxisModel::KEYS, "the Z axis"),
];

pub(crate) fn read(section: &Section<'_>) -> Result<[AxisModel; 3], InputFileError> {
    let mut axes = <[AxisModel; 3]>::default();
    for (axis, of) in axes.iter_mut().zip(LinearAxis::ALL) {
        if let Some(section) = section.section(of.name())? {
            *axis = AxisModel::read(&section)?;
            check_axis(&section, axis, of)?;
        }
    }
    Ok(axes)
}

fn check_axis(
    section: &Section<'_>,
    axis: &AxisModel,
    of: LinearAxis,
) -> Result<(), InputFileError> {
    if let (Some(dual), Some(section)) = (&axis.dual, section.section("dual")?) {
        check_second_drive(&section, dual, of)?;
    }
    if axis.dual.is_some() && axis.pitch.is_none() {
        let rule = format!(
            "needs [axis.{}.pitch], the first drive's table: the error is shared between the two",
            of.name()
        );
        return Err(section.key_error("dual", rule));
    }
    if axis.backlash.is_some() {
        if axis.feedback == Feedback::Scale {
            let rule = "belongs to feedback = \"screw\": a scale on the axis sees the backlash, \
                        and the CNC's own loop takes it out";
            return Err(section.key_error("backlash", rule));
        }
        let second = axis.dual.as_ref().map(|dual| &dual.pitch);
        if axis.pitch.iter().chain(second).any(|pitch| pitch.reverse_um.is_some()) {
            let rule = "cannot be combined with a reverse_um table on the same axis, which contains the backlash already";
            return Err(section.key_error("backlash", rule));
        }
    }
    Ok(())
}

fn check_second_drive(
    section: &Section<'_>,
    dual: &SecondDrive,
    driven: LinearAxis,
) -> Result<(), InputFileError> {
    if dual.across == driven {
        let rule = format!(
            "must be another axis than \"{}\": the drives stand apart across the driven axis",
            driven.name()
        );
        return Err(section.key_error("across", rule));
    }
    if dual.first_mm == dual.second_mm {
        let rule = format!("must not be first_mm = {}: the drives stand apart", dual.first_mm);
        return Err(section.key_error("second_mm", rule));
    }
    Ok(())
}

/// The two ends of a travel.
impl KeyValue for [f64; 2] {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let Some(ends) = section.numbers(key.name)? else { return Ok(None) };
        match ends[..] {
            [low, high] if low < high => Ok(Some([low, high])),
            _ => {
                let rule = "must be the two ends of the travel, the lower one first: [0.0, 1000.0]";
                Err(section.key_error(key.name, rule))
            }
        }
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        Some(Value::Numbers(self.to_vec()))
    }
}

fn require_reference_temperature(
    section: &Section<'_>,
    thermal: ThermalLaw,
) -> Result<ThermalLaw, InputFileError> {
    if thermal.table.is_none() {
        section.required("reference_c", section.number("reference_c")?)?;
    }
    Ok(thermal)
}

impl KeyValue for Vec<ThermalRow> {
    fn read_value(section: &Section<'_>, key: &Key) -> Result<Option<Self>, InputFileError> {
        let Some(rows) = section.rows(key.name)? else { return Ok(None) };
        for (row, pair) in rows.windows(2).enumerate() {
            if let [[before, ..], [after, ..]] = pair
                && after <= before
            {
                let rule =
                    format!("{after} is not above {before}: T must rise from each row to the next");
                return Err(section.key_error(&format!("{}[{}][0]", key.name, row + 1), rule));
            }
        }
        let row = |[temperature_c, constant_um, slope_um_per_m]: [f64; 3]| ThermalRow {
            temperature_c,
            constant_um,
            slope_um_per_m,
        };
        Ok(Some(rows.into_iter().map(row).collect()))
    }

    fn to_value(&self, _: &Key) -> Option<Value> {
        let row = |row: &ThermalRow| [row.temperature_c, row.constant_um, row.slope_um_per_m];
        Some(Value::Rows(self.iter().map(row).collect()))
    }
}

fn check_table_lengths(
    section: &Section<'_>,
    pitch: PitchErrorTable,
) -> Result<PitchErrorTable, InputFileError> {
    match &pitch.reverse_um {
        Some(reverse_um) if reverse_um.len() != pitch.forward_um.len() => {
            let rule = format!(
                "has {} elements, but forward_um has {}: both are measured at the same points",
                reverse_um.len(),
                pitch.forward_um.len()
            );
            Err(section.key_error("reverse_um", rule))
        }
        _ => Ok(pitch),
    }
}

/// Returns the sections of the axis `of`.
pub(crate) fn write(axis: &AxisModel, of: LinearAxis) -> Vec<NewSection> {
    let name = format!("axis.{}", of.name());
    let inner = |key: &str| NewSection::new(format!("{name}.{key}"));
    let mut sections = Vec::new();
    sections.push(axis.write(NewSection::new(&name)));
    sections
        .extend(axis.thermal.as_ref().map(|thermal| add_thermal_keys(inner("thermal"), thermal)));
    sections.extend(axis.pitch.as_ref().map(|pitch| pitch.write(inner("pitch"))));
    if let Some(dual) = &axis.dual {
        sections.extend([dual.write(inner("dual")), dual.pitch.write(inner("dual.pitch"))]);
    }
    sections.extend(axis.backlash.as_ref().map(|backlash| backlash.write(inner("backlash"))));
    sections.retain(|section| !section.is_empty());
    sections
}

fn add_thermal_keys(section: NewSection, thermal: &ThermalLaw) -> NewSection {
    let section = thermal.write(section);
    let section = match thermal.table {
        Some(_) => section
            .without_keys(&["reference_c", "constant_um_per_c", "slope_um_per_m_per_c"])
            .with_key_comment("table", "T in °C, K0 in µm, slope in µm/m"),
        None => section,
    };
    section.with_key_last("origin_mm").with_key_last("lag_s")
}

/// Returns whether an approach is in the negative direction. A direction that is missing (NaN) is positive.
#[must_use]
pub fn is_negative_direction(direction: f64) -> bool {
    direction < 0.0
}
