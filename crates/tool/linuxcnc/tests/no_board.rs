//! Setup for a bridge without a board: the lines that it writes, and the inputs that it misses.

use std::{fs, path::Path};

use trueup_linuxcnc::configuration::{
    OffsetEntryPoint,
    boardless_config::BoardlessConfig,
    check::check,
    finding::{OffsetRequirements, Severity},
    hal_files::HalFiles,
    ini_file::IniFile,
    installed_setup::{BridgeSettings, InstalledSetup},
    setup::{self, FileChange},
};
use trueup_machine::{Machine, MachineFile};

const INI: &str = include_str!("machine.ini");
const HAL: &str = "\
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net analogue drive.ain => my.display
net trueup-sensor-v drive.ain-0
net trueup-temp-02 drive.pt100
";
const MACHINE: &str = "\
[machine]
name = \"m\"
kind = \"3-axis\"
[inputs]
sensor = { volts_full_scale = 10.0, counts_full_scale = 32768, divider = 0.33 }
temp_front_c = { channel = 2, kind = \"pt100\" }
temp_bed_c = { channel = 5, kind = \"pt100\" }
[spindle]
source = \"sensor\"
[spindle.sensor]
k0_um = 0.0
zero_counts = 5048.0
um_per_count = 0.0152587890625
[axis.y.backlash]
width_um = -6.0
[limits]
slew_um_per_s = 1000.0
";

fn ini() -> String {
    // Two drives on Y, and A first: the number of a joint is not that of its axis.
    let mut text =
        INI.replace("coordinates=XYZ", "coordinates=AXYZY").replace("JOINTS = 3", "JOINTS = 5");
    for (joint, axis) in ["A", "X", "Y", "Z", "Y"].iter().enumerate() {
        if joint < 4 {
            text += &format!("[AXIS_{axis}]\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 1000\n");
        }
        text += &format!(
            "[JOINT_{joint}]\nMIN_LIMIT = -10{joint}\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 1000\n\
             STEPGEN_MAXVEL = 60\nSTEPGEN_MAXACCEL = 1200\n"
        );
    }
    text
}

fn hal() -> String {
    let drives = (0..5).map(|joint| {
        format!("net j{joint} joint.{joint}.motor-pos-cmd => joint.{joint}.motor-pos-fb\n")
    });
    HAL.to_string() + &drives.collect::<String>()
}

fn machine() -> Machine {
    MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file")
}

fn demand(entry: OffsetEntryPoint) -> OffsetRequirements {
    let no_board = Some(BoardlessConfig::from_machine(&machine()).expect("compiles"));
    OffsetRequirements { no_board, ..OffsetRequirements::from_machine(entry, Some(&machine())) }
}

#[test]
fn a_machine_file_with_heat_says_how_the_first_start_is_confirmed() {
    const WARM_UP: &str = "[machine]\nname = \"m\"\nkind = \"3-axis\"\n[spindle]\nsource = \"warmup\"\n\
        [spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n";
    let facts = |text: &str, more: &str| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("machine.ini");
        fs::write(&path, ini()).expect("writes");
        fs::write(folder.path().join("machine.hal"), hal() + more).expect("writes");
        let ini = IniFile::read(&path).expect("reads");
        let machine = MachineFile::parse(text, Path::new("m.toml")).expect("a machine file");
        let no_board = Some(BoardlessConfig::from_machine(&machine).expect("compiles"));
        let demand = OffsetRequirements {
            no_board,
            ..OffsetRequirements::from_machine(OffsetEntryPoint::Joint, Some(&machine))
        };
        let facts = check(&ini, &HalFiles::read(&ini).expect("reads"), &demand).facts;
        facts.iter().any(|fact| fact.contains("halcmd setp trueup.0.confirm 1"))
    };
    assert!(facts(WARM_UP, "") && !facts(WARM_UP, "net trueup-confirm panel.cold\n"));
    assert!(!facts(MACHINE, ""), "without heat there is nothing to confirm");
}

/// Returns the report's warnings and what setup writes into a file.
fn written(ini_text: &str, entry: OffsetEntryPoint, file: &str) -> (Vec<String>, Vec<u8>) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("machine.ini");
    fs::write(&path, ini_text).expect("writes");
    fs::write(folder.path().join("machine.hal"), hal()).expect("writes");
    let read = || IniFile::read(&path).expect("reads");
    let hal = HalFiles::read(&read()).expect("reads");
    let bridge =
        BridgeSettings { port: None, machine: Some("m.toml".into()), position_period_ms: 0 };
    let (report, changes) =
        setup::prepare_setup(&read(), &hal, &demand(entry), &bridge).expect("reads");
    let findings = report
        .findings
        .iter()
        .map(|finding| format!("{} {}", finding.what, finding.help))
        .collect();
    let of = |change: &&FileChange| change.path.ends_with(file);
    let content =
        changes.iter().find(of).and_then(|change| change.content.clone()).unwrap_or_default();
    if report.is_usable() {
        for change in &changes {
            fs::write(&change.path, change.content.as_ref().expect("new")).expect("writes");
        }
        let installed = InstalledSetup::from_ini(&read()).expect("set up");
        assert_eq!((installed.entry, installed.bridge), (entry, bridge.clone()));
        let again = setup::prepare_setup(&read(), &hal, &demand(entry), &bridge).expect("reads").1;
        assert!(again.is_empty(), "{again:?}");
    }
    (findings, content)
}

fn text(entry: OffsetEntryPoint, file: &str) -> String {
    String::from_utf8(written(&ini(), entry, file).1).expect("a text")
}

#[test]
fn at_the_joint_the_node_runs_between_the_motion_controller_and_the_limiter() {
    let text = text(OffsetEntryPoint::Joint, "trueup_realtime.hal");
    assert!(
        text.contains(
            "loadrt trueup_node file=[TRUEUP](CALIBRATION) heat=[TRUEUP](HEAT) joints=.XYZY\n"
        ),
        "{text}"
    );
    let at = |line: &str| text.find(line).unwrap_or_else(|| panic!("{line} is in\n{text}"));
    assert!(text.contains("the feed is held") && !text.contains("trueup.log"), "{text}");
    // Feedback before the controller, then the controller (6), then the node and the limiter.
    assert!(
        at("addf trueup-j4.update-feedback servo-thread 5") < at("addf trueup.0 servo-thread 7")
    );
    assert!(at("addf trueup.0 servo-thread 7") < at("addf trueup-mv.read-inputs servo-thread 16"));
    for line in [
        "setp trueup.0.mm-per-unit 1\n",
        "setp trueup.0.joint-3-min-limit -103\n",
        "setp trueup.0.y-against-um 6\n",
        "setp trueup-j1-go.in1 1\n",
        "setp trueup-j1-speed.maxv 200\n",
        "setp trueup-mv.offset-accel-3 200\n",
    ] {
        at(line);
    }
    let codes =
        text.lines().find_map(|line| line.strip_prefix("setp trueup.0.sensor-codes-per-v "));
    let codes: f64 = codes.expect("set").parse().expect("a number");
    assert!((codes - 409.6).abs() < 1e-9, "{codes}");
}

#[test]
fn inputs_are_connected_by_their_names_and_those_that_are_missing_are_named() {
    let (findings, content) = written(&ini(), OffsetEntryPoint::Joint, "trueup.hal");
    let text = String::from_utf8(content).expect("a text");
    for line in [
        "net trueup-sensor-v => trueup.0.sensor-v\n",
        "net trueup-temp-02 => trueup.0.temp-02-in\n",
    ] {
        assert!(text.contains(line), "{text}");
    }
    // What nothing drives would be 0 degrees.
    assert!(
        !text.contains("temp-05")
            && text.contains("loadusr trueup linuxcnc keep --file [TRUEUP](HEAT)")
            && !text.contains("joint-3-vel")
    );
    assert!(
        findings
            .iter()
            .any(|sentence| sentence.contains("trueup-temp-05") && sentence.contains("temp_bed_c")),
        "{findings:?}"
    );
    assert!(!findings.iter().any(|sentence| sentence.contains("trueup-temp-02")), "{findings:?}");
}

#[test]
fn by_eoffset_the_node_knows_the_planners_share() {
    let text = text(OffsetEntryPoint::Eoffset, "trueup_realtime.hal");
    // 1 mm/s of 50 mm/s, and as much of 1000 mm/s2.
    for line in [
        "setp trueup.0.x-accel 20\n",
        "setp trueup.0.x-keeps-slew 1\n",
        "addf trueup.0 servo-thread\n",
    ] {
        assert!(text.contains(line), "{text}");
    }
    assert!(!text.contains("moveoff") && !text.contains("joints="), "{text}");
}

#[test]
fn the_calibration_is_that_of_compile_and_an_odd_servo_period_is_refused() {
    let (_, blob) = written(&ini(), OffsetEntryPoint::Joint, "trueup_calibration.bin");
    assert_eq!(blob, trueup_machine::compile(&machine()).expect("compiles").blob());
    let odd = ini().replace("= 1000000", "= 1500000");
    let (reported, blob) = written(&odd, OffsetEntryPoint::Joint, "trueup_calibration.bin");
    assert!(
        blob.is_empty()
            && reported.iter().any(|sentence| sentence.contains("without a board it is 0.5")),
        "{reported:?}"
    );
    for (thread, is_reported) in [("30000", true), ("25000", false), ("0", false)] {
        let with = ini().replace("= 1000000", &format!("= 1000000\nBASE_PERIOD = {thread}"));
        let (reported, _) = written(&with, OffsetEntryPoint::Joint, "trueup_calibration.bin");
        assert_eq!(
            reported.iter().any(|sentence| sentence.contains("990000 ns")),
            is_reported,
            "{reported:?}"
        );
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("machine.ini");
    fs::write(&path, odd).expect("writes");
    fs::write(folder.path().join("machine.hal"), hal()).expect("writes");
    let read = IniFile::read(&path).expect("reads");
    let with_board = OffsetRequirements { no_board: None, ..demand(OffsetEntryPoint::Joint) };
    let report = check(&read, &HalFiles::read(&read).expect("reads"), &with_board);
    let errors = report.findings.iter().filter(|finding| finding.severity == Severity::Error);
    assert_eq!(errors.count(), 0, "a board may: {:?}", report.findings);
}
