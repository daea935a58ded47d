//! The closed loop on a lathe: LinuxCNC's own lathe configuration, X and Z, diameters (G7) and radii (G8).

use anyhow::{Result, ensure};
use trueup_emulator::setup;
use trueup_machine::MachineFile;

use super::linuxcnc_rig::{CLOSE_UM, bridge::RigBridge, control};

/// How far the work has grown out of the chuck, in µm.
const GROWN_UM: f64 = 40.0;
/// Error of X by its table in µm for one mm of radius.
const UM_PER_MM: f64 = 0.1;

/// The growth lifts the turret off the face whatever X is written in, and X is corrected by its radius: 80 in G7 is a
/// radius of 40 mm, 80 in G8 one of 80 mm.
#[test]
#[ignore = "long: the real LinuxCNC"]
fn a_lathe_is_corrected_by_its_radius_in_g7_and_g8() -> Result<()> {
    let Some(linuxcnc) = setup::install_and_lock_linuxcnc()? else {
        println!("skipped: this distribution has no package of LinuxCNC");
        return Ok(());
    };
    let machine =
        MachineFile::read(&setup::project_root().join("integrations/linuxcnc/trueup_lathe.toml"))?;
    let bridge = RigBridge::start(&machine)?;
    bridge.grow_to(GROWN_UM);
    let mut cnc = control::start_with(linuxcnc, "trueup_lathe.ini", &bridge.address(), &[])?;
    cnc.power_on_and_home()?;
    for (words, radius_mm) in [
        ("G7 G53 G0 X80 Z-50", 40.0),
        ("G8 G53 G0 X80 Z-50", 80.0),
        ("G7 G53 G0 X240 Z-300", 120.0),
    ] {
        cnc.send_request_with_argument("mdi", "text", words)?;
        let names = ["joint.0.motor-pos-cmd", "axis.x.eoffset", "axis.z.eoffset"];
        cnc.wait_for_pins(words, 30, &names, |seen| {
            let [x_um, z_um] = [seen[1] * 1e3, seen[2] * 1e3];
            (seen[0] - radius_mm - seen[1]).abs() < 1e-6
                && (x_um + radius_mm * UM_PER_MM).abs() < CLOSE_UM
                && (z_um - GROWN_UM).abs() < CLOSE_UM
        })?;
        let seen = cnc.read_pins(&names)?;
        println!("{words}: X {:.2} um, Z {:.2} um", seen[1] * 1e3, seen[2] * 1e3);
    }
    ensure!(
        !cnc.recent_log().contains("AXIS_Y"),
        "a lathe has a message about Y: {}",
        cnc.recent_log()
    );
    Ok(())
}
