//! A machine file to begin with: what is known of a machine before anything is measured, with a comment at
//! each key and, where a measurement is still to come, the section as a comment with the command that fills
//! it in. It compiles as it is, and `check` is silent about it.

use std::fmt::Write as _;

use trueup_output::escape::shell_quote;

use crate::{
    inputs::ADC_REFERENCE_VOLTS,
    machine_file::MachineKind,
    sections::{Feedback, LinearAxis, RotaryAxis},
};

/// The properties of a machine that are known before anything is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineTemplate {
    /// Its name, not empty.
    pub name: String,
    /// Which axes turn the tool or the table.
    pub kind: MachineKind,
    /// The rotary axes that carry the spindle, from the frame to the tool; as many as the kind has.
    pub head_axes: Vec<RotaryAxis>,
    /// The linear axes with the two ends of their travel in mm, the lower first.
    pub axes: Vec<(LinearAxis, [f64; 2])>,
    /// Where their positions are measured.
    pub feedback: Feedback,
    /// Their rapid traverse in mm/min, above 0, where it is known.
    pub rapid_mm_per_min: Option<f64>,
    /// The displacement sensor, where there is one.
    pub sensor: Option<SensorDataSheet>,
    /// The words in the names of the thermometers: `screw` is `temp_screw_c`. PT100s; at most eight.
    pub thermometers: Vec<String>,
    /// The control that gets the offsets.
    pub control: CncControl,
}

/// The data sheet of a displacement sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorDataSheet {
    /// Its output at the end of its range, in V, above 0.
    pub volts_full_scale: f64,
    /// µm for one volt, not 0.
    pub um_per_v: f64,
    /// The sensor's output when the machine is cold, by a voltmeter, in V.
    pub zero_v: f64,
}

/// The control that gets the offsets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CncControl {
    /// LinuxCNC.
    LinuxCnc,
    /// Siemens 840D.
    Siemens,
    /// FANUC.
    Fanuc,
    /// Heidenhain.
    Heidenhain,
}

impl CncControl {
    /// Its name for `trueup program` and for `trueup export`.
    fn cli_names(self) -> (&'static str, &'static str) {
        match self {
            Self::LinuxCnc => ("linuxcnc", "linuxcnc"),
            Self::Siemens => ("siemens", "siemens-840d"),
            Self::Fanuc => ("fanuc", "fanuc"),
            Self::Heidenhain => ("heidenhain", "heidenhain"),
        }
    }

    /// Returns the counts of the sensor in its run files: an S7 input ends at 27648.
    fn counts_full_scale(self) -> u32 {
        if self == Self::Siemens { 27_648 } else { 32_768 }
    }
}

/// A sensor of 10 V and the divider of its wiring: 20.0 kΩ over 9.76 kΩ.
const DEFAULT_SENSOR_WIRING: (f64, f64) = (10.0, 0.328);

/// Returns the divider for a sensor of this many volts: the wiring's, else what leaves 20 mV below the converter's
/// reference, as that does.
fn default_divider(volts: f64) -> f64 {
    const ADC_HEADROOM_VOLTS: f64 = 0.02;
    if volts == DEFAULT_SENSOR_WIRING.0 {
        return DEFAULT_SENSOR_WIRING.1;
    }
    (((ADC_REFERENCE_VOLTS - ADC_HEADROOM_VOLTS) / volts).min(1.0) * 1000.0).floor() / 1000.0
}

impl MachineTemplate {
    /// Returns the machine file; `file` is its name in the commands that it contains.
    #[must_use]
    pub fn to_toml(&self, file: &str) -> String {
        let mut text = String::new();
        // Nothing of this fails: a String takes everything.
        _ = self.write(&mut text, file);
        text
    }

    fn write(&self, out: &mut String, file: &str) -> std::fmt::Result {
        writeln!(out, "# What is known of this machine. What is missing here is not corrected.")?;
        writeln!(
            out,
            "# Every key: docs/reference.md, or `trueup schema`. After each change: trueup check {file}"
        )?;
        writeln!(out, "\n[machine]")?;
        writeln!(out, "name = {}", toml_edit::Value::from(self.name.as_str()))?;
        writeln!(out, "kind = \"{}\"", self.kind.name())?;
        if !self.head_axes.is_empty() {
            let names: Vec<String> =
                self.head_axes.iter().map(|axis| format!("\"{}\"", axis.name())).collect();
            writeln!(
                out,
                "head_axes = [{}] # they carry the spindle, from the frame to the tool",
                names.join(", ")
            )?;
        }
        let direction = match self.kind {
            MachineKind::Lathe => {
                "from the turret to the chuck, Z+ leads away from it: work that grows by s is dz = -s, offset +s"
            }
            _ => "from the spindle nose to the tip: it hangs down",
        };
        writeln!(out, "tool_direction = [0.0, 0.0, -1.0] # {direction}")?;
        if self.kind == MachineKind::Lathe {
            writeln!(
                out,
                "# Every X of this file and of run files is a radius (a column x_dia_mm is halved)."
            )?;
        }
        self.write_inputs(out)?;
        self.write_spindle(out, file)?;
        for (axis, [low, high]) in &self.axes {
            writeln!(out, "\n[axis.{}]", axis.name())?;
            let scale = self.feedback == Feedback::Scale;
            writeln!(out, "feedback = \"{}\"", if scale { "scale" } else { "screw" })?;
            writeln!(out, "travel_mm = [{low:?}, {high:?}]")?;
            if let Some(rapid) = self.rapid_mm_per_min {
                writeln!(out, "rapid_mm_per_min = {rapid:?}")?;
            }
        }
        self.write_thermal(out)?;
        writeln!(
            out,
            "\n# How far and how fast an offset may go; beyond it the offset stands still, and says so."
        )?;
        writeln!(out, "[limits]")?;
        writeln!(out, "max_um = {{ x = 200.0, y = 200.0, z = 500.0 }}")?;
        writeln!(out, "slew_um_per_s = 20.0 # heat is slow; at most 1 % of the rapid traverse")?;
        writeln!(out, "link_timeout_ms = 500 # without a word of the control it is lost")?;
        writeln!(out, "hold_ms = 2000 # then the last offset is held for so long, and taken back")?;
        writeln!(
            out,
            "\n# What you measure with, 95 %: then `trueup diagnose` knows when nothing is left to find."
        )?;
        writeln!(out, "# [instrument]\n# uncertainty_um = 1.0")?;
        self.write_next_steps(out, file)
    }

    /// Writes the commands that come next, each as it can be typed.
    fn write_next_steps(&self, out: &mut String, file: &str) -> std::fmt::Result {
        let (program, export) = self.control.cli_names();
        // An ending of its own for each step: no command overwrites what it reads.
        let stem = file.strip_suffix(".toml").unwrap_or(file);
        let word = |text: &str| shell_quote(text);
        let mut now = word(file);
        writeln!(
            out,
            "\n# Next, fill in the run files that a program comes with before you fit them:"
        )?;
        if let (Feedback::Screw, Some((axis, _))) = (self.feedback, self.axes.first()) {
            let axis = axis.name();
            let range = self.first_axis_range_option();
            let with = format!("{stem}-backlash.toml");
            writeln!(
                out,
                "#   trueup program backlash --machine {now} --for {program} --axis {axis}{range} -o measure"
            )?;
            if !range.is_empty() {
                writeln!(
                    out,
                    "#   (the half of the travel away from the chuck; an axis towards the work moves only in --range)"
                )?;
            }
            let with = word(&with);
            writeln!(
                out,
                "#   trueup fit backlash --run measure/backlash-{axis}.csv --machine {now} -o {with}"
            )?;
            now = with;
        }
        let rpm = if self.kind == MachineKind::Lathe { 1000 } else { 3000 };
        writeln!(
            out,
            "#   trueup program warmup --machine {now} --for {program} --rpm {rpm} -o measure"
        )?;
        let fit = if self.sensor.is_some() { "elongation" } else { "warmup" };
        let fitted = word(&format!("{stem}-fitted.toml"));
        writeln!(
            out,
            "#   trueup fit {fit} --run measure/warmup-off.csv --machine {now} -o {fitted}"
        )?;
        writeln!(
            out,
            "#   trueup diagnose --machine {fitted} --run measure/warmup-off.csv --out diagnosis"
        )?;
        let blob = word(&format!("{stem}.bin"));
        writeln!(out, "#   trueup compile {fitted} -o {blob}      the calibration of a board")?;
        if self.feedback == Feedback::Screw && !self.axes.is_empty() {
            writeln!(
                out,
                "#   trueup export {fitted} --format {export} -o tables      the control's own tables"
            )?;
        }
        Ok(())
    }

    /// Returns the range of the first axis in a program of a lathe: the half that is away from the work.
    fn first_axis_range_option(&self) -> String {
        match self.axes.first() {
            Some((axis, [low, high]))
                if self.kind == MachineKind::Lathe || *axis == LinearAxis::Z =>
            {
                format!(" --range {}={}:{high}", axis.name(), (low + high) / 2.0)
            }
            _ => String::new(),
        }
    }

    fn write_inputs(&self, out: &mut String) -> std::fmt::Result {
        if self.sensor.is_none() && self.thermometers.is_empty() {
            return Ok(());
        }
        writeln!(out, "\n# What is connected to the board.\n[inputs]")?;
        if let Some(SensorDataSheet { volts_full_scale, .. }) = self.sensor {
            let counts = self.control.counts_full_scale();
            let divider = default_divider(volts_full_scale);
            writeln!(
                out,
                "sensor = {{ volts_full_scale = {volts_full_scale:?}, counts_full_scale = {counts}, divider = {divider:?} }}"
            )?;
        }
        for (channel, name) in self.thermometers.iter().enumerate() {
            writeln!(out, "temp_{name}_c = {{ channel = {channel}, kind = \"pt100\" }}")?;
        }
        Ok(())
    }

    fn write_spindle(&self, out: &mut String, file: &str) -> std::fmt::Result {
        match self.sensor {
            Some(SensorDataSheet { um_per_v, zero_v, .. }) => {
                writeln!(out, "\n[spindle]\nsource = \"sensor\"")?;
                writeln!(out, "\n[spindle.sensor]")?;
                writeln!(out, "k0_um = 0.0 # the growth at the zero reading")?;
                writeln!(
                    out,
                    "zero_v = {zero_v:?} # what a voltmeter shows when the machine is cold"
                )?;
                writeln!(
                    out,
                    "um_per_v = {um_per_v:?} # the data sheet's; `trueup fit elongation` finds what it is here"
                )?;
            }
            None => {
                writeln!(out, "\n# How the spindle grows, from one run from cold:")?;
                writeln!(
                    out,
                    "#   trueup fit warmup --run measure/warmup-off.csv --machine {} -o {}-fitted.toml",
                    shell_quote(file),
                    file.strip_suffix(".toml").unwrap_or(file)
                )?;
                writeln!(out, "# [spindle]\n# source = \"warmup\"")?;
                writeln!(
                    out,
                    "# [spindle.warmup]\n# lag_s = 60.0\n# warm_s = 5400.0\n# max_um = 40.0\n# exponent = 4.0"
                )?;
            }
        }
        Ok(())
    }

    fn write_thermal(&self, out: &mut String) -> std::fmt::Result {
        let (Some((axis, _)), Some(name)) = (self.axes.first(), self.thermometers.first()) else {
            return Ok(());
        };
        writeln!(
            out,
            "\n# How an axis grows with a thermometer; `trueup fit thermal` finds the numbers."
        )?;
        writeln!(
            out,
            "# [axis.{}.thermal]\n# mode = \"position\"\n# sensor = \"temp_{name}_c\"",
            axis.name()
        )?;
        writeln!(out, "# reference_c = 20.0\n# slope_um_per_m_per_c = 11.5 # steel")
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::{MachineFile, check, compile};

    fn template(
        kind: MachineKind,
        head_axes: &[RotaryAxis],
        sensor: Option<SensorDataSheet>,
        control: CncControl,
    ) -> MachineTemplate {
        MachineTemplate {
            name: "a \"big\" mill".into(),
            kind,
            head_axes: head_axes.to_vec(),
            axes: vec![(LinearAxis::X, [-500.0, 500.0]), (LinearAxis::Z, [0.0, 300.5])],
            feedback: Feedback::Screw,
            rapid_mm_per_min: Some(15_000.0),
            sensor,
            thermometers: vec!["screw".into(), "front".into()],
            control,
        }
    }

    #[test]
    fn what_is_written_can_be_read_compiled_and_exported_and_nothing_in_it_is_doubted() {
        let sheets = [
            None,
            Some(SensorDataSheet { volts_full_scale: 10.0, um_per_v: 50.0, zero_v: 1.54 }),
            Some(SensorDataSheet { volts_full_scale: 5.0, um_per_v: 100.0, zero_v: 0.5 }),
            Some(SensorDataSheet { volts_full_scale: 3.0, um_per_v: 100.0, zero_v: 0.5 }),
            Some(SensorDataSheet { volts_full_scale: 10.0, um_per_v: 50.0, zero_v: 1.54 }),
        ];
        let heads: [(MachineKind, &[RotaryAxis]); 5] = [
            (MachineKind::ThreeAxis, &[]),
            (MachineKind::HeadHead, &[RotaryAxis::C, RotaryAxis::A]),
            (MachineKind::HeadTable, &[RotaryAxis::B]),
            (MachineKind::TableTable, &[]),
            (MachineKind::Lathe, &[]),
        ];
        let controls = [
            CncControl::LinuxCnc,
            CncControl::Siemens,
            CncControl::Fanuc,
            CncControl::Heidenhain,
            CncControl::LinuxCnc,
        ];
        for ((sheet, (kind, head_axes)), control) in sheets.into_iter().zip(heads).zip(controls) {
            let template = template(kind, head_axes, sheet, control);
            let text = template.to_toml("m.toml");
            let machine = MachineFile::parse(&text, Path::new("m.toml"))
                .unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!(check::machine_warnings(&machine), [], "{text}");
            compile(&machine).unwrap_or_else(|error| panic!("{error}\n{text}"));
            assert_eq!((&machine.name, machine.kind), (&template.name, kind));
            assert_eq!(machine.axes[0].travel_mm, Some([-500.0, 500.0]));
            assert_eq!(machine.inputs.expect("they are there").temperatures.len(), 2);
            // What is a comment can be made a section: the marks away, it is read as well.
            let whole: Vec<&str> = text
                .lines()
                .filter(|line| !(line.starts_with('#') && line.contains("trueup")))
                .map(|line| match line.strip_prefix("# ") {
                    Some(rest) if rest.starts_with('[') || rest.contains(" = ") => rest,
                    _ => line,
                })
                .collect();
            MachineFile::parse(&whole.join("\n"), Path::new("m.toml"))
                .unwrap_or_else(|error| panic!("{error}\n{}", whole.join("\n")));
        }
    }

    #[test]
    fn the_divider_is_the_one_of_the_wiring_and_never_beyond_the_converter() {
        assert_eq!(default_divider(10.0), 0.328);
        for volts in [0.5, 1.0, 3.0, 3.3, 5.0, 12.0, 24.0] {
            assert!(default_divider(volts) * volts <= ADC_REFERENCE_VOLTS, "{volts}");
        }
        assert_eq!(default_divider(1.0), 1.0);
    }
}
