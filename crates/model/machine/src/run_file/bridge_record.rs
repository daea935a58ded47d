//! A record of a bridge that was made without its machine file: its temperatures are named by their channels, and what
//! the sensor read stands there as an elongation. With the machine file of the calibration that the board ran, both get
//! their own names and counts. That the record is of that calibration is checked elsewhere, by its CRC.

use super::RunFile;
use crate::{machine_file::Machine, model::sensor_counts_from_elongation};

/// The column that a record of a bridge has.
const CALIBRATION_CRC_COLUMN: &str = "calibration_crc";
/// The column of the elongation that the bridge has made of the sensor's reading, in µm.
const ELONGATION_COLUMN: &str = "elongation_um";
const SENSOR_COUNTS_COLUMN: &str = "sensor_counts";

impl RunFile {
    /// Returns the record with the columns that `trueup bridge monitor --record … --machine` gives it. Any other run
    /// stays unchanged.
    #[must_use]
    pub fn with_machine_columns(mut self, machine: &Machine) -> Self {
        if self.column(CALIBRATION_CRC_COLUMN).is_none() {
            return self;
        }
        if let (Some(um), Some(sensor), None) = (
            self.column(ELONGATION_COLUMN),
            machine.board_sensor_model(),
            self.column(SENSOR_COUNTS_COLUMN),
        ) {
            let counts: Vec<f64> =
                um.iter().map(|um| sensor_counts_from_elongation(sensor, *um)).collect();
            self.add_column(SENSOR_COUNTS_COLUMN, ELONGATION_COLUMN, counts);
            self.remove_columns(|name| name == ELONGATION_COLUMN);
        }
        for channel in 0..=crate::inputs::MAX_TEMPERATURE_CHANNEL {
            let unnamed = format!("temp_channel{channel}_c");
            let Some(values) = self.column(&unnamed) else { continue };
            let is_empty = values.iter().all(|value| value.is_nan());
            let inputs = machine.inputs.iter().flat_map(|inputs| &inputs.temperatures);
            let name = inputs
                .into_iter()
                .find(|(_, input)| input.channel == channel)
                .map(|(name, _)| name);
            match name {
                Some(name) if self.column(name).is_none() => {
                    let values = values.to_vec();
                    self.add_column(name, &unnamed, values);
                    self.remove_columns(|name| name == unnamed);
                }
                // Nothing is connected there.
                None if is_empty => self.remove_columns(|name| name == unnamed),
                _ => {}
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::MachineFile;

    #[test]
    fn a_record_without_a_machine_file_gets_its_names_and_counts() {
        let text = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n\
            [inputs]\nsensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }\n\
            temp_coil_c = { channel = 2, kind = \"pt100\" }\n[spindle]\nsource = \"sensor\"\n\
            [spindle.sensor]\nk0_um = 1.0\nzero_counts = 5000.0\num_per_count = 0.02\n";
        let machine = MachineFile::parse(text, Path::new("m.toml")).expect("right");
        let read = |text: &str| {
            RunFile::from_reader(text.as_bytes(), Path::new("bridge.csv")).expect("a run file")
        };
        let record = "time_s,calibration_crc,elongation_um,temp_channel1_c,temp_channel2_c,temp_channel3_c\n\
                      0,7,3,,21.5,19\n1,7,5,,22,19\n";
        let run = read(record).with_machine_columns(&machine);
        // (3 − 1)/0.02 and (5 − 1)/0.02 above the zero.
        assert_eq!(run.column("sensor_counts"), Some(&[5_100.0, 5_200.0][..]));
        assert_eq!(run.column("temp_coil_c"), Some(&[21.5, 22.0][..]));
        // A thermometer that the file does not name stays; a channel without one goes.
        let names: Vec<_> = run.columns().iter().map(|column| column.name.as_str()).collect();
        assert!(names.contains(&"temp_channel3_c"), "{names:?}");
        for gone in ["elongation_um", "temp_channel1_c", "temp_channel2_c"] {
            assert!(!names.contains(&gone), "{names:?}");
        }
        // A run that is no record of a bridge keeps what it has.
        let run = read(&record.replace("calibration_crc", "batch")).with_machine_columns(&machine);
        assert!(run.column("elongation_um").is_some() && run.column("sensor_counts").is_none());
    }
}
