//! The inputs of a machine file that come in by signals of the user's own HAL files.
//!
//! Pins of drives, buttons and analogue inputs belong to the user. The user brings them in by a name that is agreed on, and
//! setup connects those signals that it finds (`input_signals.rs`):
//!
//! | signal | pin | what |
//! |---|---|---|
//! | `trueup-condition-NN` | `condition-NN` | the condition of bit NN |
//! | `trueup-tool` | `tool` | number of the tool |
//! | `trueup-load` | `load-n` | axial cutting force in N |
//! | `trueup-angle-1`, `-2` | `angle-1`, `-2` | angles of the rotary axes in degrees, in the order of the machine file |
//! | `trueup-zero`, `trueup-confirm` | `zero`, `confirm` | buttons |
//! | `trueup-service` | `service` | a switch, with a board: `trueup bridge load` and masters may write |

use trueup_machine::{Machine, model::required_columns};

/// An input that the machine file names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedInput {
    /// Signal of the user's HAL files.
    pub(super) signal: String,
    /// Pin of the component.
    pub(super) pin: String,
    /// The name of the machine file.
    pub(super) name: String,
    /// A pin that may give it.
    pub(super) example: String,
}

impl NamedInput {
    /// Returns an input whose signal is called as its pin.
    fn from_pin(pin: &str, name: &str, example: &str) -> Self {
        let [pin, name, example] = [pin, name, example].map(String::from);
        Self { signal: format!("trueup-{}", pin.trim_end_matches("-n")), pin, name, example }
    }
}

/// Returns what the machine file needs from LinuxCNC next to positions and speed.
pub(super) fn required_inputs(machine: &Machine) -> Vec<NamedInput> {
    let mut inputs = Vec::new();
    let conditions = machine.inputs.iter().flat_map(|input| &input.conditions);
    for (name, input) in conditions {
        let pin = format!("condition-{:02}", input.bit);
        inputs.push(NamedInput::from_pin(&pin, name, "iocontrol.0.coolant-flood"));
    }
    // Tool and conditions come together: with one of them the bridge waits for both.
    if machine.spindle.tools.is_some() || !inputs.is_empty() {
        inputs.push(NamedInput::from_pin("tool", "tool", "iocontrol.0.tool-number"));
    }
    let columns = required_columns(machine);
    if columns.iter().any(|column| column == "load_n") {
        inputs.push(NamedInput::from_pin("load-n", "load_n", "motion.analog-out-00"));
    }
    for (number, axis) in machine.angle_axes().iter().enumerate() {
        let (name, pin) = (axis.name(), format!("angle-{}", number + 1));
        if columns.contains(&format!("{name}_deg")) {
            let example = format!("axis.{name}.pos-cmd");
            inputs.push(NamedInput::from_pin(&pin, &format!("{name}_deg"), &example));
        }
    }
    inputs
}
