//! Reads parameters and pitch data back, and adds them up as the control does.

use std::collections::BTreeMap;

use super::MAX_COMPENSATION_VALUE;
use crate::report::ApproachDirection;

/// The control's compensation data after both files are loaded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CompensationData {
    /// By number and axis; axis 0 where the parameter has no axis.
    parameters: BTreeMap<(u32, usize), i64>,
    /// By point number.
    points: BTreeMap<i64, i64>,
}

impl CompensationData {
    /// Reads the parameter file and the pitch data file.
    ///
    /// # Errors
    /// The frame of `%`, a line, or a value outside −7 … +7 is not as it must be.
    pub fn parse(parameters: &str, pitch: &str) -> Result<Self, String> {
        let mut control = Self::default();
        for line in strip_percent_frame(parameters)? {
            let wrong = || format!("{line:?} is not a parameter");
            let (number, values) = split_parameter_number(line).ok_or_else(wrong)?;
            if let Some(value) = values.strip_prefix('P') {
                control.parameters.insert((number, 0), value.parse().map_err(|_| wrong())?);
                continue;
            }
            for value in values.split('A').skip(1) {
                let (axis, value) = value.split_once('P').ok_or_else(wrong)?;
                let axis: usize = axis.parse().map_err(|_| wrong())?;
                control.parameters.insert((number, axis), value.parse().map_err(|_| wrong())?);
            }
        }
        for line in strip_percent_frame(pitch)? {
            let wrong = || format!("{line:?} is not a point");
            let (number, value) = split_parameter_number(line).ok_or_else(wrong)?;
            let value: i64 =
                value.strip_prefix('P').and_then(|value| value.parse().ok()).ok_or_else(wrong)?;
            if value.abs() > MAX_COMPENSATION_VALUE {
                return Err(format!("{line}: a value is from -7 to 7"));
            }
            let point = i64::from(number) - 10_000;
            if point < 0 || control.points.insert(point, value).is_some() {
                return Err(format!("{line}: no such point, or it was there before"));
            }
        }
        Ok(control)
    }

    /// Returns a parameter; `axis` 0 where it has none.
    ///
    /// # Errors
    /// It is not in the file.
    pub fn parameter(&self, number: u32, axis: usize) -> Result<i64, String> {
        let found = self.parameters.get(&(number, axis));
        found.copied().ok_or_else(|| format!("parameter {number} of axis {axis} is missing"))
    }

    /// Returns the tables of an axis.
    ///
    /// # Errors
    /// A parameter or a point of it is missing, or the magnification is none.
    pub fn axis_tables(&self, axis: usize) -> Result<AxisTables, String> {
        let of = |number| self.parameter(number, axis);
        let (reference, first, last) = (of(3620)?, of(3621)?, of(3622)?);
        let magnification = of(3623)?;
        if ![1, 2, 4, 8].contains(&magnification) {
            return Err(format!("the magnification of axis {axis} is {magnification}"));
        }
        let values = |first: i64| {
            (first..=first + last - of(3621)?)
                .map(|point| {
                    let value = self.points.get(&point).copied();
                    value
                        .map(|value| value * magnification)
                        .ok_or_else(|| format!("point {point} is missing"))
                })
                .collect::<Result<Vec<i64>, String>>()
        };
        let mut tables = vec![values(first)?];
        let mut at_reference = 0;
        if let Ok(second) = of(3626) {
            tables.push(values(second)?);
            at_reference = of(3627)?;
        }
        Ok(AxisTables {
            first,
            last,
            negative: usize::try_from(reference - first + 1).map_err(|_| "3621 is above 3620")?,
            spacing_mm: of(3624)? as f64 / 1000.0,
            tables,
            at_reference,
            backlash: of(1851).unwrap_or(0),
        })
    }
}

/// Returns the lines between the two `%`.
fn strip_percent_frame(text: &str) -> Result<Vec<&str>, String> {
    let lines: Vec<&str> = text.lines().collect();
    match &lines[..] {
        ["%", inner @ .., "%"] => Ok(inner.to_vec()),
        _ => Err("a file begins and ends with %".to_string()),
    }
}

fn split_parameter_number(line: &str) -> Option<(u32, &str)> {
    let line = line.strip_prefix('N')?;
    let end = line.find(|c: char| !c.is_ascii_digit())?;
    let (number, rest) = line.split_at(end);
    (number.len() == 5).then(|| Some((number.parse().ok()?, rest)))?
}

/// The tables of one axis, in detection units.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisTables {
    /// The number of the first point.
    pub first: i64,
    /// The number of the last point.
    pub last: i64,
    /// This many sections are on the negative side of the reference.
    negative: usize,
    spacing_mm: f64,
    /// For positive, and where there are two for negative, directions.
    tables: Vec<Vec<i64>>,
    at_reference: i64,
    backlash: i64,
}

impl AxisTables {
    /// Returns one table, its first value at point 1, this many sections of it before the reference point. `values`
    /// and `backlash` are in detection units.
    pub(super) fn from_single_table(
        negative: usize,
        spacing_mm: f64,
        values: Vec<i64>,
        backlash: i64,
    ) -> Self {
        Self {
            first: 1,
            last: values.len() as i64,
            negative,
            spacing_mm,
            tables: vec![values],
            at_reference: 0,
            backlash,
        }
    }

    /// Returns what the control adds, in detection units, so far from the reference point. A section's value
    /// comes at once in its middle, or evenly over it.
    #[must_use]
    pub fn correction_in_detection_units(
        &self,
        from_reference_mm: f64,
        approach: ApproachDirection,
        is_interpolated: bool,
    ) -> f64 {
        let is_negative = approach == ApproachDirection::Negative;
        let (table, start) = match &self.tables[..] {
            [_, second] if is_negative => (second, self.at_reference),
            [first, ..] => (first, if is_negative { -self.backlash } else { 0 }),
            [] => return f64::NAN,
        };
        let sections = from_reference_mm / self.spacing_mm;
        let mut sum = start as f64;
        for (index, &value) in table.iter().enumerate() {
            // The section goes from `begin` to `begin` + 1; those before the reference count back.
            let begin = index as f64 - self.negative as f64;
            let passed = if is_interpolated {
                (sections - begin).clamp(0.0, 1.0)
            } else {
                f64::from(u8::from(sections >= begin + 0.5))
            };
            let at_reference = if begin < 0.0 { 1.0 } else { 0.0 };
            sum += value as f64 * (passed - at_reference);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMETERS: &str = "%\nN01851A1P5\nN03620A1P1\nN03621A1P1\nN03622A1P3\nN03623A1P2\n\
                              N03624A1P100000\n%\n";

    #[test]
    fn values_add_up_from_the_reference_in_both_directions() {
        let control =
            CompensationData::parse(PARAMETERS, "%\nN10001P3\nN10002P1\nN10003P-4\n%\n").unwrap();
        let axis = control.axis_tables(1).unwrap();
        // Sections −100…0, 0…100, 100…200 mm, values 6, 2 and −8 units.
        for (mm, stepped, even) in [
            (-500.0, -6.0, -6.0),
            (-60.0, -6.0, -3.6),
            (-40.0, 0.0, -2.4),
            (0.0, 0.0, 0.0),
            (100.0, 2.0, 2.0),
            (149.0, 2.0, -1.92),
            (151.0, -6.0, -2.08),
            (900.0, -6.0, -6.0),
        ] {
            let of = |is_even| {
                axis.correction_in_detection_units(mm, ApproachDirection::Positive, is_even)
            };
            assert!((of(false) - stepped).abs() < 1e-12 && (of(true) - even).abs() < 1e-12, "{mm}");
            assert!(
                (axis.correction_in_detection_units(mm, ApproachDirection::Negative, false)
                    - stepped
                    + 5.0)
                    .abs()
                    < 1e-12
            );
        }
    }

    #[test]
    fn what_is_no_punch_tape_is_refused() {
        let pitch = "%\nN10001P3\nN10002P1\nN10003P-4\n%\n";
        assert!(CompensationData::parse(PARAMETERS, pitch).is_ok());
        for wrong in [
            pitch.replace("P-4\n%", "P-4"),
            pitch.replace("P3", "P8"),
            pitch.replace("N10002", "N10001"),
            pitch.replace("N10002", "N1002"),
            pitch.replace("P1", ""),
        ] {
            assert!(CompensationData::parse(PARAMETERS, &wrong).is_err(), "{wrong:?}");
        }
        let gap = CompensationData::parse(PARAMETERS, &pitch.replace("N10002P1\n", "")).unwrap();
        assert_eq!(gap.axis_tables(1), Err("point 2 is missing".to_string()));
    }
}
