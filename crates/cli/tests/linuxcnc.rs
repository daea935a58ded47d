//! `trueup linuxcnc` tells what is wrong before it touches LinuxCNC. That it works, the tests with the
//! real LinuxCNC show (`host-tests`): here it never gets as far, so that none has to be installed.

use std::{
    fs,
    process::{Command, Output},
};

fn trueup(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trueup"))
        .arg("linuxcnc")
        .args(arguments)
        .env_remove("INI_FILE_NAME")
        .output()
        .expect("it starts")
}

fn refused(arguments: &[&str], phrase: &str) {
    let output = trueup(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains(phrase), "{said}");
}

#[test]
fn a_port_that_is_none_is_refused_by_name() {
    refused(&["--port", "localhost:3333"], "a port is tcp:HOST:PORT");
    refused(&[], "--port");
}

/// Before LinuxCNC hears of a component that could never get ready.
#[cfg(not(feature = "socketcan"))]
#[test]
fn a_can_interface_needs_the_feature_and_says_how() {
    refused(&["--port", "can0"], "--port can0: this tool was built without SocketCAN");
    refused(&["--port", "can0"], "--features socketcan");
}

#[test]
fn a_bad_ini_or_machine_file_is_refused_with_its_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("written");
        path.to_str().expect("a plain name").to_owned()
    };
    let port = ["--port", "tcp:127.0.0.1:1"];
    let ini = file("bad.ini", "[AXIS_X]\nMAX_VELOCITY = fast\n");
    let rule = "bad.ini:2:16: [AXIS_X]MAX_VELOCITY = fast is no number";
    refused(&[&port[..], &["--ini", &ini]].concat(), rule);
    let missing = folder.path().join("missing.ini");
    let missing = missing.to_str().expect("a plain name");
    refused(&[&port[..], &["--ini", missing]].concat(), "missing.ini: ");
    let machine = file("bad.toml", "[machine]\nname = 7\n");
    refused(&[&port[..], &["--machine", &machine]].concat(), "bad.toml:2:8");
}

#[test]
fn limits_that_make_no_sense_are_refused() {
    let port = ["--port", "tcp:127.0.0.1:1"];
    for (option, value) in [
        ("--slew-um-per-s", "0"),
        ("--slew-um-per-s", "fast"),
        ("--max-um", "0"),
        // A counter comes round after 256 ms.
        ("--stale-ms", "300"),
        ("--position-period-ms", "0"),
        ("--temperatures", "9"),
    ] {
        refused(&[&port[..], &[option, value]].concat(), option);
    }
}
