//! Reads the variables of an INI file back, and looks tables up as the control does.

use std::collections::BTreeMap;

use crate::{report::ApproachDirection, table_points::interpolate_linear};

/// The assignments of an INI file, by the name with its indices: `$AN_CEC_STEP[0]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct IniVariables(BTreeMap<String, String>);

impl IniVariables {
    /// Reads a file from its name line to `M17`.
    ///
    /// # Errors
    /// The frame is not `%_N_…_INI`, `CHANDATA(1)`, …, `M17`, or a line is not an assignment, or a
    /// variable is assigned twice.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut lines = text.lines();
        let head = lines.next().unwrap_or_default();
        if !(head.starts_with("%_N_") && head.ends_with("_INI")) {
            return Err(format!("{head:?} is not the name of an INI file"));
        }
        if lines.next() != Some("CHANDATA(1)") {
            return Err("the second line is not CHANDATA(1)".to_string());
        }
        let mut variables = BTreeMap::new();
        for line in lines {
            if line == "M17" {
                return Ok(Self(variables));
            }
            let (name, value) = line
                .strip_prefix('$')
                .and_then(|assignment| assignment.split_once('='))
                .ok_or_else(|| format!("{line:?} assigns no variable"))?;
            let name = format!("${}", name.trim());
            if variables.insert(name.clone(), value.trim().to_string()).is_some() {
                return Err(format!("{name} is assigned twice"));
            }
        }
        Err("M17 is missing".to_string())
    }

    /// Returns the text that is assigned to `name`.
    ///
    /// # Errors
    /// It is not assigned.
    pub fn text(&self, name: &str) -> Result<&str, String> {
        self.0.get(name).map(String::as_str).ok_or_else(|| format!("{name} is missing"))
    }

    /// Returns the number that is assigned to `name`.
    ///
    /// # Errors
    /// It is not assigned, or not a number.
    pub fn number(&self, name: &str) -> Result<f64, String> {
        let text = self.text(name)?;
        text.parse().map_err(|_| format!("{name} is {text:?}, not a number"))
    }
}

/// A table as the control looks it up, in its own unit.
#[derive(Clone, Debug, PartialEq)]
pub struct LookupTable {
    /// Position and value.
    points: Vec<(f64, f64)>,
    /// 0: for both directions of the input axis; else 1 or −1.
    pub direction: f64,
    /// The axis whose position chooses the value.
    pub input: String,
    /// The axis that is moved, against the sign of the value.
    pub output: String,
}

impl LookupTable {
    /// Returns the encoder table of `axis`.
    ///
    /// # Errors
    /// A variable of it is missing.
    pub fn from_eec_variables(variables: &IniVariables, axis: &str) -> Result<Self, String> {
        let points = read_points(
            variables,
            |what| format!("$AA_ENC_COMP_{what}[0,{axis}]"),
            |index| format!("$AA_ENC_COMP[0,{index},{axis}]"),
        )?;
        Ok(Self { points, direction: 0.0, input: axis.to_string(), output: axis.to_string() })
    }

    /// Returns the cross-axis table `t`.
    ///
    /// # Errors
    /// A variable of it is missing, or no value that the control takes.
    pub fn from_cec_variables(variables: &IniVariables, t: usize) -> Result<Self, String> {
        let points = read_points(
            variables,
            |what| format!("$AN_CEC_{what}[{t}]"),
            |index| format!("$AN_CEC[{t},{index}]"),
        )?;
        let axis = |what: &str| {
            let name = format!("$AN_CEC_{what}_AXIS[{t}]");
            let text = variables.text(&name)?;
            text.strip_prefix('(')
                .and_then(|text| text.strip_suffix(')'))
                .map(str::to_string)
                .ok_or_else(|| format!("{name} is {text:?}, not an axis in brackets"))
        };
        let direction = variables.number(&format!("$AN_CEC_DIRECTION[{t}]"))?;
        if ![-1.0, 0.0, 1.0].contains(&direction) {
            return Err(format!("$AN_CEC_DIRECTION[{t}] is {direction}"));
        }
        if variables.number(&format!("$AN_CEC_MULT_BY_TABLE[{t}]"))? != 0.0 {
            return Err(format!("$AN_CEC_MULT_BY_TABLE[{t}] is not 0"));
        }
        Ok(Self { points, direction, input: axis("INPUT")?, output: axis("OUTPUT")? })
    }

    /// Returns the value at `position`; 0 where the table is for the other direction. The axis moves by the
    /// opposite of it.
    #[must_use]
    pub fn value(&self, position: f64, approach: ApproachDirection) -> f64 {
        if self.direction != 0.0 && self.direction != approach.sign() {
            return 0.0;
        }
        interpolate_linear(&self.points, position)
    }
}

fn read_points(
    variables: &IniVariables,
    parameter: impl Fn(&str) -> String,
    value: impl Fn(usize) -> String,
) -> Result<Vec<(f64, f64)>, String> {
    let [min, step, max] = ["MIN", "STEP", "MAX"].map(|what| variables.number(&parameter(what)));
    let (min, step, max) = (min?, step?, max?);
    if variables.number(&parameter("IS_MODULO"))? != 0.0 {
        return Err(format!("{} is not 0", parameter("IS_MODULO")));
    }
    if !(step > 0.0 && max > min) {
        return Err(format!("from {min} to {max} by {step} is not a table"));
    }
    // The last point is the one nearest to MAX.
    let last = ((max - min) / step).round() as usize;
    (0..=last)
        .map(|index| Ok((min + step * index as f64, variables.number(&value(index))?)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ini(body: &str) -> String {
        format!("%_N_NC_CEC_INI\nCHANDATA(1)\n{body}M17\n")
    }

    #[test]
    fn a_file_that_breaks_off_is_refused() {
        assert!(IniVariables::parse(&ini("$MA_BACKLASH[0,AX1]=0.004\n")).is_ok());
        let text = ini("$A[0]=1\n");
        for wrong in [
            text.replace("M17\n", ""),
            text.replace("CHANDATA(1)\n", ""),
            text.replace("%_N", "%N"),
            text.replace("$A[0]=1", "A[0]=1"),
            text.replace("$A[0]=1\n", "$A[0]=1\n$A[0]=2\n"),
        ] {
            assert!(IniVariables::parse(&wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_gap_in_a_table_is_refused_and_a_direction_is_accepted() {
        let table = "$AN_CEC[0,0]=0\n$AN_CEC[0,1]=0.01\n$AN_CEC_INPUT_AXIS[0]=(AX1)\n\
                     $AN_CEC_OUTPUT_AXIS[0]=(AX3)\n$AN_CEC_STEP[0]=10\n$AN_CEC_MIN[0]=-5\n\
                     $AN_CEC_MAX[0]=5\n$AN_CEC_DIRECTION[0]=-1\n$AN_CEC_MULT_BY_TABLE[0]=0\n\
                     $AN_CEC_IS_MODULO[0]=0\n";
        let lookup =
            LookupTable::from_cec_variables(&IniVariables::parse(&ini(table)).unwrap(), 0).unwrap();
        assert_eq!((lookup.input.as_str(), lookup.output.as_str()), ("AX1", "AX3"));
        for (position, value) in [(-90.0, 0.0), (0.0, 0.005), (2.5, 0.0075), (90.0, 0.01)] {
            assert!((lookup.value(position, ApproachDirection::Negative) - value).abs() < 1e-15);
            assert_eq!(lookup.value(position, ApproachDirection::Positive), 0.0);
        }
        let gap = ini(&table.replace("$AN_CEC[0,1]=0.01\n", ""));
        let missing = LookupTable::from_cec_variables(&IniVariables::parse(&gap).unwrap(), 0);
        assert_eq!(missing, Err("$AN_CEC[0,1] is missing".to_string()));
    }
}
