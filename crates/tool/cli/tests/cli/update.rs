//! `bridge update` and the slots in `bridge info`, against a board with two firmware slots that runs in this process.

use std::{
    process::{Command, Stdio},
    sync::Mutex,
    thread,
    time::Duration,
};

use serde_json::Value;
use trueup_boot::flash_layout::{SLOT_SIZE, Slot};
use trueup_signature::PrivateKey;

use crate::{
    desk::Desk,
    slots_board::{BODY, PART, Seen, Setup, board, both, maker, part},
};

/// Returns a folder with the files of an update to 1.3.0.
fn desk() -> Desk {
    let desk = Desk::new(&[]);
    desk.write("new.update", both(3));
    desk
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

fn slot_b(seen: &Mutex<Seen>) -> Vec<u8> {
    let start = SLOT_SIZE as usize;
    seen.lock().expect("no holder panics").flash[start..start + PART].to_vec()
}

fn written(seen: &Mutex<Seen>) -> usize {
    seen.lock().expect("no holder panics").written
}

#[test]
fn a_board_that_is_silent_while_it_erases_gets_it_all_and_starts_it_on_trial() {
    let desk = desk();
    let (port, seen) = board(Setup { erase: Duration::from_millis(5_300), ..Setup::default() });
    let info = format!("bridge info --port {port}");
    let (out, _) = desk.run_expecting(&info, 0);
    for line in [
        "\nfirmware     slot A runs: 1.1.0, confirmed\n",
        "\nfirmware     slot B: empty\n",
        "\nfirmware     slot A was chosen: it is confirmed, and the only one\n",
        "\nfirmware     oldest version that may start: 1.0.0\n",
    ] {
        assert!(out.contains(line), "{line}: {out}");
    }
    let (out, err) =
        desk.run_expecting(&format!("bridge update new.update --yes --port {port}"), 0);
    assert!(err.contains("slot A: 1.1.0, confirmed (runs)\nslot B: empty\n"), "{err}");
    assert!(err.contains("1.3.0 (2612 bytes) goes to slot B"), "{err}");
    for line in [
        "2612 bytes in slot B; the board has verified CRC, SHA-256 and signature\n",
        "the bridge has restarted, and runs from slot B: 1.3.0, on trial, start 1 of 5\n",
        "engage, and let it give offsets for a minute: that confirms it.",
        "goes back to slot A: 1.1.0, confirmed\n",
    ] {
        assert!(out.contains(line), "{line}: {out}");
    }
    assert_eq!(slot_b(&seen), part(Slot::B, 3, &maker()));
    assert_eq!((written(&seen), seen.lock().expect("no holder panics").erases), (BODY, 1));
    let (out, _) = desk.run_expecting(&format!("--json {info}"), 0);
    let slots = &json(&out)["firmware_slots"];
    assert_eq!((&slots["running"], &slots["b"]["status"]), (&"B".into(), &"trial".into()));
    assert_eq!((&slots["b"]["starts"], &slots["a"]["version"]), (&1.into(), &"1.1.0".into()));
}

#[test]
fn after_a_line_that_was_cut_the_same_command_goes_on_behind_what_has_come() {
    let desk = desk();
    let (port, seen) = board(Setup { cut_at: Some(1_500), ..Setup::default() });
    let line = format!("--json bridge update new.update --yes --port {port}");
    let (out, err) = desk.run_expecting(&line, 1);
    assert_eq!(out, "", "{err}");
    let from = err.split("near byte ").nth(1).and_then(|part| part.split(' ').next());
    let from: usize = from.and_then(|text| text.parse().ok()).expect("it says near which byte");
    let first = written(&seen);
    assert!((900..BODY).contains(&first), "{first}");
    let (out, _) = desk.run_expecting(&line, 0);
    let done = json(&out);
    let resumed = done["resumed_from"].as_u64().expect("a number") as usize;
    // The board has a block of 31 segments that it could not acknowledge.
    assert!((from..=from + 31 * 7).contains(&resumed), "{from} {resumed}");
    assert_eq!((resumed - 512, written(&seen)), (first, BODY), "only the rest is sent");
    assert_eq!(seen.lock().expect("no holder panics").erases, 1, "erased once");
    assert_eq!(slot_b(&seen), part(Slot::B, 3, &maker()));
    assert_eq!((&done["runs"], &done["slot"]), (&true.into(), &"B".into()));
}

#[test]
fn another_file_than_the_one_that_was_begun_begins_anew() {
    let desk = desk();
    desk.write("newer.update", both(4));
    let (port, seen) = board(Setup { cut_at: Some(1_500), ..Setup::default() });
    desk.run_expecting(&format!("bridge update new.update --yes --port {port}"), 1);
    let (out, _) =
        desk.run_expecting(&format!("--json bridge update newer.update --yes --port {port}"), 0);
    assert_eq!(json(&out)["resumed_from"], 0);
    assert_eq!(seen.lock().expect("no holder panics").erases, 2);
    assert_eq!(slot_b(&seen), part(Slot::B, 4, &maker()));
}

#[test]
fn an_answer_that_is_lost_costs_a_look_and_no_byte_twice() {
    // In the middle; of the last segment, which is answered after the verification.
    for lost in [1_300, PART as u32] {
        let desk = desk();
        let (port, seen) = board(Setup { lost_answer_at: Some(lost), ..Setup::default() });
        let (out, _) =
            desk.run_expecting(&format!("--json bridge update new.update --yes --port {port}"), 0);
        assert_eq!((&json(&out)["runs"], &json(&out)["resumed_from"]), (&true.into(), &0.into()));
        assert_eq!(slot_b(&seen), part(Slot::B, 3, &maker()));
        assert_eq!(seen.lock().expect("no holder panics").erases, 1);
        assert_eq!(written(&seen), BODY, "{lost}");
    }
}

#[test]
fn a_firmware_that_waits_for_the_next_start_is_not_sent_twice() {
    let desk = desk();
    let (port, seen) = board(Setup::default());
    let line = format!("bridge update new.update --yes --port {port}");
    let (out, _) = desk.run_expecting(&format!("{line} --keep-running"), 0);
    assert!(out.contains("1.3.0 is used from the next start"), "{out}");
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(
        out.contains("firmware     slot B: 1.3.0, verified: it waits for the next start"),
        "{out}"
    );
    assert!(out.contains("the newer one waits for the next start\n"), "{out}");
    let (out, _) = desk.run_expecting(&line, 0);
    assert!(out.contains("the first 2612 of them by an earlier command"), "{out}");
    assert_eq!(written(&seen), BODY);
}

#[test]
fn a_firmware_that_crashes_leaves_the_old_one_and_ends_with_3() {
    let desk = desk();
    let (port, _) = board(Setup { crashes: true, ..Setup::default() });
    let (out, _) = desk.run_expecting(&format!("bridge update new.update --yes --port {port}"), 3);
    assert!(out.contains("runs from slot A as before: 1.1.0, confirmed\n"), "{out}");
    assert!(out.contains("slot B: 1.3.0, rejected: it failed its trial; it crashed"), "{out}");
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(
        out.contains("slot A was chosen: it is confirmed; the newer one failed its trial\n"),
        "{out}"
    );
}

#[test]
fn a_file_that_is_not_for_this_board_is_refused_before_anything_is_erased() {
    let desk = desk();
    desk.write("same.update", both(1));
    desk.write("old.update", both(0));
    desk.write("a.update", part(Slot::A, 3, &maker()));
    for (setup, file, phrase) in [
        (
            Setup::default(),
            "same.update",
            "nothing is erased: the file has version 1.1.0, which is not newer than 1.1.0, which runs",
        ),
        (
            Setup::default(),
            "old.update",
            "the file has version 1.0.0, which is not newer than 1.1.0",
        ),
        (
            Setup::default(),
            "a.update",
            "so slot B is to be written, and the file has no part for it",
        ),
        (
            Setup { is_on_trial: true, ..Setup::default() },
            "new.update",
            "nothing is erased: the firmware that runs is on trial",
        ),
        (
            Setup { has_no_slots: true, ..Setup::default() },
            "new.update",
            "nothing is erased: this firmware has no slots: write the new one with a probe or the ROM loader",
        ),
    ] {
        let (port, seen) = board(setup);
        let (out, err) =
            desk.run_expecting(&format!("bridge update {file} --yes --port {port}"), 2);
        assert_eq!(out, "", "{err}");
        assert!(err.contains(phrase), "{phrase}: {err}");
        let seen = seen.lock().expect("no holder panics");
        assert_eq!((seen.written, seen.erases), (0, 0), "{phrase}");
    }
    let (port, _) = board(Setup { has_no_slots: true, ..Setup::default() });
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(!out.contains("firmware     "), "{out}");
}

#[test]
fn a_foreign_signature_is_refused_by_the_board_in_words() {
    let desk = Desk::new(&[]);
    desk.write("foreign.update", part(Slot::B, 3, &PrivateKey::generate().expect("random bytes")));
    let (port, _) = board(Setup::default());
    let (out, err) =
        desk.run_expecting(&format!("bridge update foreign.update --yes --port {port}"), 2);
    assert_eq!(out, "", "{err}");
    assert!(
        err.contains("the board refuses it: the file is not signed with this board's key. Take"),
        "{err}"
    );
    let (out, _) = desk.run_expecting(&format!("bridge info --port {port}"), 0);
    assert!(out.contains("firmware     slot A runs: 1.1.0, confirmed\n"), "{out}");
    assert!(out.contains("loading: it has not come whole\n"), "{out}");
}

#[test]
fn a_cnc_without_service_is_asked_for_it_and_no_user_without_a_terminal() {
    let desk = desk();
    let (port, seen) = board(Setup { has_cnc: true, ..Setup::default() });
    let (_, err) = desk.run_expecting(&format!("bridge update new.update --yes --port {port}"), 1);
    assert!(
        err.contains("set Service there") && err.contains("with Engage off, and try again"),
        "{err}"
    );
    assert_eq!(seen.lock().expect("no holder panics").erases, 0);
    let (_, err) = desk.run_expecting(&format!("bridge update new.update --port {port}"), 2);
    assert!(err.contains("--yes"), "{err}");
}

#[test]
fn a_damaged_file_says_its_byte_and_its_rule_and_no_port_is_opened() {
    let desk = Desk::new(&[]);
    let (a, b) = (part(Slot::A, 3, &maker()), part(Slot::B, 3, &maker()));
    let mut damaged = both(3);
    damaged[PART + 700] ^= 1;
    for (file, bytes, phrase) in [
        ("damaged", damaged, "byte 2612: is damaged: its CRC does not hold"),
        (
            "short",
            both(3)[..PART + 900].to_vec(),
            "byte 2612: the part that begins here has 2612 bytes",
        ),
        (
            "swapped",
            [b, a].concat(),
            "byte 2612: the parts are in the wrong order: slot A comes first",
        ),
        ("image.elf", vec![0x7F; 4_000], "byte 0: is no firmware for a slot"),
        ("empty", Vec::new(), "byte 0: ends within the header"),
        ("large", vec![0; 500_000], "large: "),
    ] {
        desk.write(file, bytes);
        let (out, err) =
            desk.run_expecting(&format!("bridge update {file} --yes --port tcp:127.0.0.1:9"), 2);
        assert_eq!(out, "", "{err}");
        assert!(err.contains(&format!("{file}: ")) && err.contains(phrase), "{phrase}: {err}");
    }
}

#[test]
fn ctrl_c_says_near_which_byte_the_same_command_goes_on() {
    let desk = desk();
    let (port, seen) = board(Setup::default());
    let tool = Command::new(env!("CARGO_BIN_EXE_trueup"))
        .args(["bridge", "update", "new.update", "--yes", "--port", &port])
        .current_dir(desk.path("."))
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the tool was built for this test");
    while seen.lock().expect("no holder panics").received < 800 {
        thread::sleep(Duration::from_millis(1));
    }
    let killed = Command::new("kill").args(["-INT", &tool.id().to_string()]).status();
    assert!(killed.expect("a command of every Unix").success());
    let ended = tool.wait_with_output().expect("it ends");
    let err = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{err}");
    assert!(
        err.contains("The same command goes on there") && err.contains("you have stopped it"),
        "{err}"
    );
    let (out, _) =
        desk.run_expecting(&format!("--json bridge update new.update --yes --port {port}"), 0);
    assert!(json(&out)["resumed_from"].as_u64() >= Some(800), "{out}");
}
