//! What `check` finds in configurations, and what setup changes in them: each case is a whole configuration with one
//! line that differs, so that a finding belongs to that line.

use std::{fs, path::Path};

use tempfile::TempDir;
use trueup_linuxcnc::configuration::{
    OffsetEntryPoint,
    check::{CheckReport, check},
    finding::{OffsetRequirements, Severity},
    hal_files::HalFiles,
    ini_file::IniFile,
    installed_setup::{BridgeSettings, InstalledSetup},
    setup::{self, FileChange},
};
use trueup_machine::{InputFileError, MachineFile};

const INI: &str = include_str!("machine.ini");
const HAL: &str = "\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
addf read servo-thread
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf write servo-thread
net x-pos joint.0.motor-pos-cmd => drive.0.cmd
net x-fb drive.0.fb => joint.0.motor-pos-fb
net y-pos joint.1.motor-pos-cmd => joint.1.motor-pos-fb
linkps joint.2.motor-pos-cmd z-pos
linksp z-pos joint.2.motor-pos-fb
";
const DEMAND: OffsetRequirements = OffsetRequirements {
    entry: OffsetEntryPoint::Joint,
    max_um: [200.0; 3],
    slew_um_per_s: 1_200.0,
    corrects_screw: Some([true; 3]),
    inputs: Vec::new(),
    angles: 0,
    no_board: None,
};

/// Returns an INI file of three axes that has all that is needed.
fn whole() -> String {
    let mut text = INI.to_string();
    for (joint, axis) in ["X", "Y", "Z"].iter().enumerate() {
        text += &format!(
            "[AXIS_{axis}]\nMIN_LIMIT = -100\nMAX_LIMIT = 100\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 1000\n\
             [JOINT_{joint}]\nMIN_LIMIT = -101\nMAX_LIMIT = 101\nMAX_VELOCITY = 50\nMAX_ACCELERATION = 1000\n\
             STEPGEN_MAXVEL = 60\nSTEPGEN_MAXACCEL = 1200\n"
        );
    }
    text
}

/// A configuration in a folder.
struct Case {
    folder: TempDir,
}

impl Case {
    fn new(ini: &str, hal: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        fs::write(folder.path().join("machine.ini"), ini).expect("writes");
        fs::write(folder.path().join("machine.hal"), hal).expect("writes");
        Self { folder }
    }

    fn read(&self) -> (IniFile, HalFiles) {
        let ini = IniFile::read(&self.folder.path().join("machine.ini")).expect("reads");
        let hal = HalFiles::read(&ini).expect("reads");
        (ini, hal)
    }

    fn check(&self, demand: &OffsetRequirements) -> CheckReport {
        let (ini, hal) = self.read();
        check(&ini, &hal, demand)
    }

    fn set_up(
        &self,
        demand: &OffsetRequirements,
    ) -> Result<(CheckReport, Vec<FileChange>), InputFileError> {
        self.set_up_with(demand, "/dev/ttyUSB0", "m.toml")
    }

    fn set_up_with(
        &self,
        demand: &OffsetRequirements,
        port: &str,
        machine: &str,
    ) -> Result<(CheckReport, Vec<FileChange>), InputFileError> {
        let (ini, hal) = self.read();
        let bridge = BridgeSettings {
            port: Some(port.into()),
            machine: Some(machine.into()),
            position_period_ms: 2,
        };
        setup::prepare_setup(&ini, &hal, demand, &bridge)
    }

    fn write(changes: &[FileChange]) {
        for FileChange { path, content } in changes {
            match content {
                Some(content) => fs::write(path, content).expect("writes"),
                None => fs::remove_file(path).expect("removes"),
            }
        }
    }

    /// Returns every file but the copies.
    fn files(&self) -> Vec<(String, String)> {
        let mut all: Vec<(String, String)> = fs::read_dir(self.folder.path())
            .expect("a folder")
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.extension().is_none_or(|extension| extension != "trueup-backup"))
            .map(|path| (name(&path), fs::read_to_string(&path).expect("reads")))
            .collect();
        all.sort();
        all
    }
}

fn name(path: &Path) -> String {
    path.file_name().expect("a name").to_string_lossy().into_owned()
}

#[test]
fn a_configuration_that_has_all_has_no_findings_and_says_how_fast_offsets_are() {
    let report = Case::new(&whole(), HAL).check(&DEMAND);
    assert_eq!(report.findings, []);
    // 2·√(0.006 mm / 200 mm/s²).
    assert!(
        report.facts[1].contains("20 % of acceleration; a reversal of 6 um takes 11.0 ms"),
        "{:?}",
        report.facts
    );
    let eoffset = OffsetRequirements { entry: OffsetEntryPoint::Eoffset, ..DEMAND };
    let report = Case::new(&whole(), HAL).check(&eoffset);
    assert_eq!(report.findings, []);
    // 1.2/50 of 1000 mm/s² are 24 mm/s².
    assert!(
        report.facts[1].contains("0.024000 (setup adds it): programs lose 2.400 %"),
        "{:?}",
        report.facts
    );
}

#[test]
fn each_obstacle_is_found_at_its_line() {
    use Severity::{Error, Warning};
    let joint_0 = "MAX_ACCELERATION = 1000\nSTEPGEN_MAXVEL = 60\nSTEPGEN_MAXACCEL = 1200\n";
    for (old, new, severity, phrase, line) in [
        ("SERVO_PERIOD = 1000000", "SERVO_PERIOD = 400000", Error, "0.5 to 4 ms", 2),
        ("SERVO_PERIOD = 1000000", "SERVO_PERIOD = 4100000", Error, "0.5 to 4 ms", 2),
        ("[HAL]\n", "[HAL]\nTWOPASS = ON\n", Error, "TWOPASS", 4),
        ("HALFILE = machine.hal\n", "HALFILE = machine.hal\nHALFILE = more.tcl\n", Error, "Tcl", 5),
        ("trivkins coordinates=XYZ", "corexykins", Error, "corexykins", 9),
        (
            "STEPGEN_MAXVEL = 60\n",
            "BACKLASH = 0.01\nSTEPGEN_MAXVEL = 60\n",
            Error,
            "both correct X",
            21,
        ),
        (
            "STEPGEN_MAXVEL = 60\n",
            "COMP_FILE = x.comp\nSTEPGEN_MAXVEL = 60\n",
            Error,
            "both correct X",
            21,
        ),
        (joint_0, &joint_0.replace("1200", "1040"), Warning, "4.0 % of acceleration", 22),
        (joint_0, &joint_0.replace("1200", "1000"), Error, "leaves nothing above", 22),
        (joint_0, &joint_0.replace("1200", "900"), Error, "leaves nothing above", 22),
        (joint_0, &joint_0.replace("= 60", "= 50.5"), Warning, "500.0 um/s of speed", 22),
        ("MIN_LIMIT = -101", "MIN_LIMIT = -100.1", Warning, "beyond [JOINT_0]MIN_LIMIT", 12),
        ("MAX_LIMIT = 100\n", "MAX_LIMIT = -99.7\n", Error, "no room", 12),
        ("[KINS]\n", "[HAL]\nHALFILE = lost.hal\n[KINS]\n", Warning, "a second [HAL]", 8),
        ("JOINTS = 3", "JOINTS = 4", Error, "does not fit", 10),
    ] {
        let text = whole();
        let text = text.replacen(old, new, 1);
        assert_ne!(text, whole(), "{old}");
        let report = Case::new(&text, HAL).check(&DEMAND);
        let found: Vec<_> = report
            .findings
            .iter()
            .map(|finding| (finding.severity, finding.place.line, finding.what.as_str()))
            .collect();
        assert_eq!(found.len(), 1, "{new}: {found:#?}");
        assert_eq!((found[0].0, found[0].1), (severity, line), "{new}: {found:?}");
        assert!(found[0].2.contains(phrase), "{new}: {found:?}");
        assert!(severity == Warning || !report.is_usable());
    }
}

#[test]
fn a_headroom_that_is_not_stated_is_assumed_with_the_line_to_add() {
    for text in ["", "STEPGEN_MAXACCEL = 0\n"] {
        let report =
            Case::new(&whole().replace("STEPGEN_MAXACCEL = 1200\n", text), HAL).check(&DEMAND);
        assert_eq!(report.findings, []);
        assert!(
            report.facts[3].contains("20 %")
                && report.facts[3]
                    .contains("assumed: state it by [JOINT_2]STEPGEN_MAXACCEL = 1200")
        );
    }
}

#[test]
fn a_screw_that_the_machine_file_leaves_alone_may_be_corrected_by_linuxcnc() {
    let text = whole().replacen("STEPGEN_MAXVEL", "BACKLASH = 0.01\nSTEPGEN_MAXVEL", 1);
    let of = |corrects_screw| {
        let report = Case::new(&text, HAL).check(&OffsetRequirements { corrects_screw, ..DEMAND });
        (report.findings[0].severity, report.findings[0].what.clone())
    };
    let (severity, what) = of(Some([false, true, true]));
    assert!(severity == Severity::Warning && what.contains("150 %"), "{what}");
    assert_eq!(of(None).0, Severity::Error);
    let none = whole().replacen("STEPGEN_MAXVEL", "BACKLASH = 0.000\nSTEPGEN_MAXVEL", 1);
    assert_eq!(Case::new(&none, HAL).check(&DEMAND).findings, []);
}

#[test]
fn hal_files_that_leave_no_place_are_refused_at_their_line() {
    for (more, phrase) in [
        ("loadrt moveoff names=mv\n", "share their variables"),
        ("loadrt offset count=2\n", "loads a module once"),
        ("loadrt oneshot names=a,b\n", "loads a module once"),
        ("loadrt limit2 names=a\n", "loads a module once"),
        ("net held motion.feed-inhibit\n", "motion.feed-inhibit is on the signal held"),
        ("addf late servo-thread 99\n", "cannot be followed"),
        ("unlinkp joint.1.motor-pos-fb\n", "joint.1.motor-pos-fb is on no signal"),
    ] {
        let case = Case::new(&whole(), &format!("{HAL}{more}"));
        let report = case.check(&DEMAND);
        assert!(
            report
                .findings
                .iter()
                .any(|finding| finding.what.contains(phrase) && !finding.help.is_empty()),
            "{more}: {report:#?}"
        );
        let (_, changes) = case.set_up(&DEMAND).expect("reads");
        assert_eq!(changes, [], "{more}: nothing is touched");
    }
    // The user's own lines make room.
    let more = "loadrt offset names=trueup-j0,trueup-j1,trueup-j2,mine\nloadrt oneshot names=mine,trueup-alive,trueup-went\n";
    assert_eq!(Case::new(&whole(), &format!("{HAL}{more}")).check(&DEMAND).findings, []);
}

#[test]
fn setup_puts_the_offset_between_command_and_drive_in_the_order_of_the_thread() {
    let case = Case::new(&whole(), HAL);
    let (_, changes) = case.set_up(&DEMAND).expect("reads");
    Case::write(&changes);
    let files = case.files();
    let realtime = &files.iter().find(|file| file.0 == "trueup_realtime.hal").expect("written").1;
    for line in [
        "loadrt moveoff names=trueup-mv personality=3",
        // read, motion-command-handler, and then the feedback before motion-controller.
        "addf trueup-j0.update-feedback servo-thread 3",
        "addf trueup-j2.update-feedback servo-thread 5",
        // What stops the offsets while the component is gone, before the limiter.
        "addf trueup-j0-go servo-thread 7",
        "addf trueup-j0-speed servo-thread 10",
        "addf trueup-mv.read-inputs servo-thread 13",
        "addf trueup-mv.write-outputs servo-thread 14",
        "addf trueup-j0.update-output servo-thread 15",
        "net trueup-lives => trueup-j1-go.sel0",
        "setp trueup-j1-go.in0 0",
        "net trueup-j1-go trueup-j1-go.out => trueup-j1-speed.in",
        "net trueup-j1-speed trueup-j1-speed.out => trueup-mv.offset-vel-1",
        "net trueup-lives trueup-alive.out => trueup-went.in",
        "unlinkp joint.0.motor-pos-cmd",
        "net trueup-j0-cmd joint.0.motor-pos-cmd => trueup-j0.in",
        "net x-pos trueup-j0.out",
        "net x-fb => trueup-j0.fb-in",
        "net z-pos trueup-j2.out",
        "net z-pos => trueup-j2.fb-in",
        "setp trueup-mv.waypoint-sample-secs 1e9",
        "setp trueup-mv.power-on 1",
    ] {
        assert!(realtime.lines().any(|other| other == line), "{line}\n{realtime}");
    }
    let ini = &files.iter().find(|file| file.0 == "machine.ini").expect("there").1;
    let halfiles: Vec<&str> = ini.lines().filter(|line| line.starts_with("HALFILE")).collect();
    assert_eq!(
        halfiles,
        ["HALFILE = machine.hal", "HALFILE = trueup_realtime.hal", "HALFILE = trueup.hal"]
    );
    assert_eq!(
        InstalledSetup::from_ini(&case.read().0).map(|setup| setup.entry),
        Some(OffsetEntryPoint::Joint)
    );
}

#[test]
fn inputs_of_the_machine_file_come_in_by_their_names_with_a_board_too() {
    const MACHINE: &str = "\
        [machine]\nname = \"m\"\nkind = \"head-head\"\nhead_axes = [\"c\", \"a\"]\n\
        [inputs]\ncoolant = { kind = \"condition\", bit = 3 }\n\
        [spindle]\nsource = \"warmup\"\n[spindle.warmup]\nlag_s = 60.0\nwarm_s = 5400.0\nmax_um = 80.0\nexponent = 4.0\n";
    let machine = MachineFile::parse(MACHINE, Path::new("m.toml")).expect("a machine file");
    let demand = |entry| OffsetRequirements::from_machine(entry, Some(&machine));
    // Nothing brings them: each is named, with a pin that may give it.
    let report = Case::new(&whole(), HAL).check(&demand(OffsetEntryPoint::Joint));
    let texts: Vec<String> = report
        .findings
        .iter()
        .map(|finding| format!("{} {}", finding.what, finding.help))
        .collect();
    for (signal, pin) in [
        ("trueup-condition-03", "iocontrol.0.coolant-flood"),
        ("trueup-tool", "iocontrol.0.tool-number"),
        ("trueup-angle-1", "axis.c.pos-cmd"),
        ("trueup-angle-2", "axis.a.pos-cmd"),
    ] {
        assert!(
            texts.iter().any(|sentence| sentence.contains(signal) && sentence.contains(pin)),
            "{signal}: {texts:?}"
        );
    }
    assert!(texts.len() == 4 && report.is_usable(), "{texts:?}");
    // An angle that nothing drives would be 0: none is sent.
    let one = "net trueup-angle-1 axis.c.pos-cmd\n";
    for own in ["", one] {
        let case = Case::new(&whole(), &format!("{HAL}{own}"));
        Case::write(&case.set_up(&demand(OffsetEntryPoint::Joint)).expect("reads").1);
        let files = case.files();
        let text = &files.iter().find(|file| file.0 == "trueup.hal").expect("written").1;
        assert!(!text.contains("--rotary"), "{text}");
    }
    let own = "net trueup-condition-03 drive.flood\nnet trueup-tool iocontrol.0.tool-number\n\
        net trueup-angle-1 axis.c.pos-cmd\nnet trueup-angle-2 axis.a.pos-cmd\nnet trueup-service drive.key\n";
    for entry in [OffsetEntryPoint::Joint, OffsetEntryPoint::Eoffset] {
        let case = Case::new(&whole(), &format!("{HAL}{own}"));
        assert_eq!(case.check(&demand(entry)).findings, []);
        Case::write(&case.set_up(&demand(entry)).expect("reads").1);
        let files = case.files();
        let text = &files.iter().find(|file| file.0 == "trueup.hal").expect("written").1;
        for line in [
            "net trueup-condition-03 => trueup.0.condition-03\n",
            "net trueup-tool => trueup.0.tool\n",
            "net trueup-angle-1 => trueup.0.angle-1\n",
            "net trueup-service => trueup.0.service\n",
            " --position-period-ms [TRUEUP](POSITION_PERIOD_MS) --rotary --machine ",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
    }
}

/// Returns the text of a file that setup writes.
fn written(demand: &OffsetRequirements, file: &str) -> String {
    let (_, changes) = Case::new(&whole(), HAL).set_up(demand).expect("reads");
    let change = changes.into_iter().find(|change| name(&change.path) == file);
    String::from_utf8(change.and_then(|change| change.content).expect("written")).expect("a text")
}

#[test]
fn a_record_to_learn_from_is_kept_only_where_a_probed_point_contains_the_offset() {
    for (entry, is_retained) in
        [(OffsetEntryPoint::Joint, false), (OffsetEntryPoint::Eoffset, true)]
    {
        let text = written(&OffsetRequirements { entry, ..DEMAND }, "trueup.hal");
        assert!(text.contains("--machine [TRUEUP](MACHINE)"), "{text}");
        assert_eq!(text.contains("--record"), is_retained, "{text}");
    }
}

#[test]
fn watchdog_and_messages_are_those_of_the_sample() {
    let commands = |text: &str| {
        let lines = text.lines().map(str::trim);
        let mut all: Vec<String> = lines
            .filter(|line| !line.is_empty() && !line.starts_with('#'))
            .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        all.sort();
        all
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../integrations/linuxcnc");
    let sample: String = ["trueup_watchdog.hal", "trueup_message.hal"]
        .map(|name| fs::read_to_string(folder.join(name)).expect("reads"))
        .concat();
    let ours = written(
        &OffsetRequirements { entry: OffsetEntryPoint::Eoffset, ..DEMAND },
        "trueup_realtime.hal",
    );
    assert_eq!(commands(&ours), commands(&sample));
}

#[test]
fn a_name_with_a_blank_is_refused_with_the_reason() {
    for (port, machine, phrase) in [
        ("/dev/my port", "m.toml", "the port \"/dev/my port\" has a blank"),
        ("can0", "/home/a b/m.toml", "the path \"/home/a b/m.toml\" has a blank"),
    ] {
        let case = Case::new(&whole(), HAL);
        let (report, changes) = case.set_up_with(&DEMAND, port, machine).expect("reads");
        assert!(report.findings.iter().any(|finding| finding.what.contains(phrase)), "{report:#?}");
        assert_eq!(changes, []);
    }
}

#[test]
fn a_halcmd_line_that_connects_a_joint_comes_too_late() {
    let text = whole().replace("[HAL]\n", "[HAL]\nHALCMD = net x-pos => joint.0.motor-pos-cmd\n");
    let report = Case::new(&text, HAL).check(&DEMAND);
    let found = report.findings.iter().find(|finding| finding.what.contains("after the HAL files"));
    assert_eq!(found.map(|finding| finding.place.line), Some(4), "{report:#?}");
}

#[test]
fn setup_twice_is_setup_once_and_the_files_are_equal_to_the_byte_afterwards() {
    let no_end = whole().trim_end().to_owned();
    let dos = whole().replace('\n', "\r\n");
    for text in [whole(), no_end, dos] {
        for entry in [OffsetEntryPoint::Joint, OffsetEntryPoint::Eoffset] {
            let case = Case::new(&text, HAL);
            let before = case.files();
            let demand = OffsetRequirements { entry, ..DEMAND };
            Case::write(&case.set_up(&demand).expect("reads").1);
            let once = case.files();
            assert_eq!(case.set_up(&demand).expect("reads").1, []);
            // The other way, and back again.
            let other = if entry == OffsetEntryPoint::Joint {
                OffsetEntryPoint::Eoffset
            } else {
                OffsetEntryPoint::Joint
            };
            Case::write(
                &case
                    .set_up(&OffsetRequirements { entry: other, ..demand.clone() })
                    .expect("reads")
                    .1,
            );
            assert_ne!(case.files(), once);
            Case::write(&case.set_up(&demand).expect("reads").1);
            assert_eq!(case.files(), once);
            Case::write(&setup::prepare_removal(&case.read().0).expect("reads"));
            assert_eq!(case.files(), before);
            let copy = fs::read_to_string(case.folder.path().join("machine.ini.trueup-backup"));
            assert_eq!(copy.expect("kept"), text);
        }
    }
}

#[test]
fn setup_leaves_what_the_user_has_connected_or_written() {
    let by_hand = format!("{HAL}loadusr -W trueup linuxcnc --port x\n");
    let case = Case::new(&whole(), &by_hand);
    let (report, changes) = case.set_up(&DEMAND).expect("reads");
    assert!(
        report.findings.iter().any(|finding| finding.what.contains("by hand"))
            && changes.is_empty()
    );
    assert_eq!(case.check(&DEMAND).findings, [], "check looks at it all the same");
    let case = Case::new(&whole(), HAL);
    fs::write(case.folder.path().join("trueup.hal"), "# mine\n").expect("writes");
    let (report, changes) = case.set_up(&DEMAND).expect("reads");
    assert!(
        report.findings.iter().any(|finding| finding.what.contains("not written by setup"))
            && changes.is_empty()
    );
    Case::write(&setup::prepare_removal(&case.read().0).expect("reads"));
    assert_eq!(
        fs::read_to_string(case.folder.path().join("trueup.hal")).expect("there"),
        "# mine\n"
    );
}
