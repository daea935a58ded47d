//! `trueup linuxcnc` tells what is wrong before it touches LinuxCNC. That it works, the tests with the
//! real LinuxCNC show (`host-tests`): here it never gets as far, so that none has to be installed.

use crate::desk::Desk;

/// A bridge that nobody asks.
const PORT: &str = "--port tcp:127.0.0.1:1";

fn refused(desk: &Desk, line: &str, phrase: &str) {
    let (_, said) = desk.said(line, 2);
    assert!(said.contains(phrase), "{said}");
}

#[test]
fn a_port_that_is_none_is_refused_by_name() {
    let desk = Desk::new(&[]);
    refused(&desk, "linuxcnc --port localhost:3333", "a port is tcp:HOST:PORT");
    refused(&desk, "linuxcnc", "--port");
}

/// Before LinuxCNC hears of a component that could never get ready.
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
