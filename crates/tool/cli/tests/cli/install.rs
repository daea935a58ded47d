//! Files that an installed tool brings along: examples, completions, the manual's pages, the firmware.

use crate::desk::Desk;

#[test]
fn the_examples_are_written_and_work_and_nothing_of_the_users_is_lost() {
    let desk = Desk::new(&[]);
    let (out, _) = desk.run_expecting("examples try", 0);
    assert!(out.lines().any(|line| line == "try/linuxcnc/trueup_sim.ini"), "{out}");
    for machine in ["paper_spindle", "gantry", "linuxcnc/trueup_gantry"] {
        desk.run_expecting(&format!("compile try/{machine}.toml -o cal.bin"), 0);
    }
    // Again: they are there, and the same.
    desk.run_expecting("examples try", 0);
    desk.write("try/paper_spindle.toml", "# mine\n");
    std::fs::remove_file(desk.path("try/gantry.toml")).expect("written above");
    let (_, err) = desk.run_expecting("examples try", 2);
    assert!(err.contains("try/paper_spindle.toml: it is there already"), "{err}");
    assert_eq!(desk.text("try/paper_spindle.toml"), "# mine\n");
    assert!(!desk.path("try/gantry.toml").exists(), "all or nothing");
}

#[test]
fn every_shell_gets_completions_and_every_command_a_page() {
    let desk = Desk::new(&[]);
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let (out, _) = desk.run_expecting(&format!("completions {shell}"), 0);
        assert!(out.contains("diagnose") && out.contains("holdout"), "{shell}");
    }
    desk.run_expecting("man pages", 0);
    let pages = desk.files("pages");
    for page in ["trueup.1", "trueup-diagnose.1", "trueup-bridge-load.1", "trueup-virtual.1"] {
        assert!(pages.iter().any(|other| other == page), "{pages:?}");
        assert!(desk.text(&format!("pages/{page}")).contains(".TH trueup"), "{page}");
    }
    assert!(desk.text("pages/trueup-diagnose.1").contains("holdout"));
}

#[test]
fn a_build_for_tests_carries_no_firmware_and_says_how_to_have_it() {
    let desk = Desk::new(&[]);
    let output = desk.trueup("firmware images");
    match output.status.code() {
        // A build that has them finds them.
        Some(0) => assert!(desk.read("images/trueup-stm32f405.bin").len() > 50_000),
        code => {
            let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(code, Some(2), "{stderr}");
            assert!(stderr.contains("cargo xtask images"), "{stderr}");
        }
    }
}
