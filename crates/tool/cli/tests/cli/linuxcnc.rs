//! `trueup linuxcnc` reports what is wrong before it touches LinuxCNC. That it works, the tests with the
//! real LinuxCNC show (`host-tests`): here it never gets as far, so that none has to be installed.

use crate::desk::Desk;

/// A bridge that is never asked.
const PORT: &str = "--port tcp:127.0.0.1:1";

fn refused(desk: &Desk, line: &str, phrase: &str) {
    let (_, stderr) = desk.run_expecting(line, 2);
    assert!(stderr.contains(phrase), "{stderr}");
}

#[test]
fn a_port_that_is_none_is_refused_by_name() {
    let desk = Desk::new(&[]);
    refused(&desk, "linuxcnc --port localhost:3333", "a port is tcp:HOST:PORT");
    refused(&desk, "linuxcnc", "--port");
}

/// Before LinuxCNC learns of a component that could never get ready.
#[cfg(not(all(feature = "socketcan", target_os = "linux")))]
#[test]
fn a_can_interface_needs_the_feature_and_says_how() {
    let desk = Desk::new(&[]);
    let line = "linuxcnc --port can0";
    refused(&desk, line, "--port can0: this tool was built without SocketCAN");
    refused(&desk, line, "without --no-default-features");
}

#[test]
fn a_bad_ini_or_machine_file_is_refused_with_its_place() {
    let desk = Desk::new(&[
        ("bad.ini", "[AXIS_X]\nMAX_VELOCITY = fast\n"),
        ("bad.toml", "[machine]\nname = 7\n"),
    ]);
    let rule = "bad.ini:2:16: [AXIS_X]MAX_VELOCITY = fast is not a number";
    refused(&desk, &format!("linuxcnc {PORT} --ini bad.ini"), rule);
    refused(&desk, &format!("linuxcnc {PORT} --ini missing.ini"), "missing.ini:1:1: ");
    refused(&desk, &format!("linuxcnc {PORT} --machine bad.toml"), "bad.toml:2:8");
}

#[test]
fn limits_that_make_no_sense_are_refused() {
    let desk = Desk::new(&[]);
    for (option, value) in [
        ("--slew-um-per-s", "0"),
        ("--slew-um-per-s", "fast"),
        ("--max-um", "0"),
        // A counter comes round after 256 ms.
        ("--stale-ms", "300"),
        ("--position-period-ms", "0"),
        ("--temperatures", "9"),
    ] {
        refused(&desk, &format!("linuxcnc {PORT} {option} {value}"), option);
    }
}

pub const INI: &str = "[EMCMOT]\nSERVO_PERIOD = 1000000\n[HAL]\nHALFILE = own.hal\n[TRAJ]\nCOORDINATES = X\n\
    LINEAR_UNITS = mm\n[KINS]\nKINEMATICS = trivkins coordinates=X\nJOINTS = 1\n[AXIS_X]\nMAX_VELOCITY = 50\n\
    [JOINT_0]\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 800\n";
pub const HAL: &str = "addf motion-command-handler servo-thread\naddf motion-controller servo-thread\n\
    net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb\n";

#[test]
fn a_configuration_is_checked_set_up_and_left_as_it_was() {
    let desk = Desk::new(&[("own.ini", INI), ("own.hal", HAL)]);
    let (printed, _) = desk.run_expecting("linuxcnc check own.ini", 0);
    assert!(
        printed.contains("STEPGEN_MAXACCEL = 960") && printed.contains("nothing stands in the way"),
        "{printed}"
    );
    refused(&desk, "linuxcnc setup own.ini", "--port is missing");
    let (printed, _) = desk.run_expecting("linuxcnc setup own.ini --port /dev/ttyUSB0", 0);
    assert!(
        printed.contains("written: ./trueup_realtime.hal")
            || printed.contains("written: trueup_realtime.hal"),
        "{printed}"
    );
    // What it was set up with is kept.
    let (printed, _) = desk.run_expecting("linuxcnc setup own.ini", 0);
    assert!(printed.contains("nothing was changed"), "{printed}");
    let (printed, _) = desk.run_expecting("linuxcnc setup own.ini --remove", 0);
    assert!(printed.contains("removed: "), "{printed}");
    let (printed, _) = desk.run_expecting("linuxcnc setup own.ini --remove", 0);
    assert!(printed.contains("nothing of setup"), "{printed}");
    assert_eq!(std::fs::read_to_string(desk.path("own.ini")).expect("there"), INI);
}

#[test]
fn a_configuration_that_cannot_be_set_up_is_left_alone_with_the_lines_to_add() {
    let text = INI.replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n");
    let desk = Desk::new(&[("own.ini", &text), ("own.hal", HAL)]);
    for (line, code) in [("linuxcnc check own.ini", 3), ("linuxcnc setup own.ini --port can0", 2)] {
        let line = line.replace("can0", "tcp:127.0.0.1:1");
        let (printed, stderr) = desk.run_expecting(&line, code);
        assert!(stderr.contains("own.ini:4:11") && stderr.contains("TWOPASS"), "{stderr}");
        assert!(
            printed.contains("net x trueup-j0.out") && printed.contains("HALFILE = trueup.hal"),
            "{printed}"
        );
    }
    assert_eq!(std::fs::read_to_string(desk.path("own.ini")).expect("there"), text);
    let desk = Desk::new(&[("own.ini", INI)]);
    refused(&desk, "linuxcnc check own.ini", "HALFILE = own.hal: there is no such file");
    refused(&desk, "linuxcnc check missing.ini", "missing.ini");
}
