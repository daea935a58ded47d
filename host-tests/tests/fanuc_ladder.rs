//! The ladder of `integrations/fanuc`, run by an interpreter of its mnemonics against a stub of the control's external
//! data input. The proof ends at those signals: LADDER-III has not compiled it, and no control has seen it.

use std::process::Command;

use anyhow::{Result, ensure};
use serde_json::{Value, json};
use trueup_core::{
    cnc::{AxisPosition, Control, LinearAxis, MachineConditions, SpindleState, TravelDirection},
    units::{Position, Rpm},
};
use trueup_emulator::setup;
use trueup_modbus::holding_block::{CncData, HoldingBlockChecker};

/// As in the example's data table.
const SLEW_UM_PER_S: f64 = 20.0;

#[test]
fn the_ladder_shifts_by_the_offset_itself_holds_takes_back_and_steps_within_the_slew_limit()
-> Result<()> {
    let output = Command::new(setup::ensure_python()?)
        .arg(setup::project_root().join("host-tests/python/fanuc_pmc.py"))
        .output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let saw: Value = serde_json::from_slice(&output.stdout)?;
    // An offset of 30.1 µm on Z and −7.53 µm on Y, to the nearest micrometre and with its own sign.
    let followed = json!({ "fault": false, "engaged": true, "state": 1, "shift_um": [0, -8, 30] });
    for when in ["there", "again", "engaged anew"] {
        assert_eq!(saw[when], followed, "{when}");
    }
    assert_eq!(
        [&saw["released"]["engaged"], &saw["engages"]["engaged"]],
        [&json!(false), &json!(true)]
    );
    // A block that is not whole is not used; then nothing comes: held for two seconds, taken back, reported.
    for when in ["damaged", "held"] {
        assert_eq!(
            (&saw[when]["state"], &saw[when]["shift_um"]),
            (&json!(4), &followed["shift_um"]),
            "{when}"
        );
    }
    let back = json!({ "fault": true, "engaged": true, "state": 6, "shift_um": [0, 0, 0] });
    assert_eq!(saw["back"], back);
    // A control that does not answer is reported, and nothing is lost or doubled by it; ±MAX holds.
    assert_eq!(
        (&saw["dead"]["fault"], &saw["dead"]["shift_um"]),
        (&json!(true), &followed["shift_um"])
    );
    assert_eq!(saw["limited"]["shift_um"], json!([0, 50, -50]));
    let number = |name: &str| saw[name].as_f64().unwrap_or(f64::NAN);
    assert!(number("largest_step_um") <= (0.1 * SLEW_UM_PER_S).max(1.0), "{saw}");
    assert!(number("most_in_a_second_um") <= 1.1 * SLEW_UM_PER_S, "{saw}");
    // The holding block is one that the bridge takes, with tool and conditions.
    let hex = saw["holding"].as_str().unwrap_or_default();
    let mut registers = [0; 20];
    for (n, register) in registers.iter_mut().enumerate() {
        *register = u16::from_str_radix(&hex[4 * n..4 * n + 4], 16)?;
    }
    let position = Position(-123_456);
    let x = AxisPosition { axis: LinearAxis::X, position, direction: TravelDirection::Standing };
    let expected = CncData {
        control: Control::ENGAGED,
        positions: [Some(x), None, None],
        spindle: Some(SpindleState { speed: Rpm(0), load_n: 0 }),
        conditions: Some(MachineConditions { tool: 7, bits: 0x101 }),
        ..CncData::default()
    };
    assert_eq!(HoldingBlockChecker::default().accept(&registers)?, expected);
    Ok(())
}
