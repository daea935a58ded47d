//! Machine files that must be refused, each with its place and the rule it breaks.

mod axes;
mod volume;

use std::path::Path;

use trueup_machine::{InputFileError, MachineFile};

/// Lines 1 to 3 of most files below.
const MACHINE: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";

fn error_of(text: &str) -> InputFileError {
    match MachineFile::parse(text, Path::new("bad.toml")) {
        Ok(_) => panic!("{text:?} was accepted"),
        Err(error) => error,
    }
}

/// Asserts each (source text, place `line:column`, phrase of the rule), the text after `before`: one of the
/// errors is that; a text that is cut short has others.
fn assert_refused(before: &str, cases: &[(&str, &str, &str)]) {
    for (text, place, phrase) in cases {
        let errors = error_of(&format!("{before}{text}")).into_single_errors();
        let lines: Vec<String> = errors.map(|error| error.to_string()).collect();
        let place = format!("bad.toml:{place}: ");
        let is_it = |line: &&String| line.starts_with(&place) && line.contains(phrase);
        let reported = lines.iter().find(is_it);
        let line = reported.unwrap_or_else(|| panic!("{text:?}: {place}{phrase} in {lines:#?}"));
        assert!(!line.contains('\n'), "{text:?}: {line}");
    }
}

#[test]
fn broken_toml_is_refused() {
    assert_refused(
        "",
        &[
            ("[machine\nname = 1\n", "1:9", "not valid TOML"),
            ("[machine]\nname = \n", "2:8", "not valid TOML"),
            ("[machine]\nname = \"a\"\nname = \"b\"\n", "3:1", "duplicate key"),
            ("[machine]\n[machine]\n", "2:2", "duplicate key"),
            ("[machine]\nname = 1,5\n", "2:9", "not valid TOML"),
            ("\u{feff}machine\n", "1:8", "not valid TOML"),
        ],
    );
}

#[test]
fn the_machine_section_is_checked() {
    assert_refused(
        "",
        &[
            ("", "1:1", "machine is missing"),
            ("machine = 3\n", "1:11", "machine must be a table, not an integer"),
            ("[machine]\nkind = \"3-axis\"\n", "1:2", "machine.name is missing"),
            ("[machine]\nname = \"a\"\n", "1:2", "machine.kind is missing"),
            ("[machine]\nname = 3\n", "2:8", "machine.name must be a string, not an integer"),
            ("[machine]\nname = \" \"\nkind = \"3-axis\"\n", "2:8", "must not be empty"),
            (
                "[machine]\nname = \"a\"\nkind = \"3axis\"\n",
                "3:8",
                "\"lathe\", not \"3axis\"; did you mean 3-axis?",
            ),
            ("[machines]\n", "1:2", "unknown key machines; did you mean machine?"),
            ("[machine]\nnaem = \"a\"\n", "2:1", "unknown key machine.naem; did you mean name?"),
            ("[machine]\n\"\\n\" = 1\n", "2:1", "unknown key machine.\\n"),
            ("[colour]\n", "1:2", "unknown key colour"),
        ],
    );
}

#[test]
fn the_tool_direction_is_checked() {
    let key = "machine.tool_direction";
    assert_refused(
        MACHINE,
        &[
            ("tool_direction = [0, 0, 0]\n", "4:18", &format!("{key} has no length")),
            ("tool_direction = [0, 1]\n", "4:18", &format!("{key} must have 3 elements, not 2")),
            ("tool_direction = [0, \"1\", 0]\n", "4:22", &format!("{key}[1] must be a number")),
            (
                "tool_direction = [0, 0, nan]\n",
                "4:25",
                &format!("{key}[2] must be a finite number"),
            ),
            ("tool_direction = 1.0\n", "4:18", "an array of three numbers, not a float"),
        ],
    );
}

#[test]
fn the_inputs_are_checked() {
    assert_refused(
        &format!("{MACHINE}[inputs]\n"),
        &[
            ("sensr = {}\n", "5:1", "unknown key inputs.sensr; did you mean sensor?"),
            (
                "temp__c = {}\n",
                "5:1",
                "unknown key inputs.temp__c; the inputs are sensor, temp_<name>_c, and any name with kind = \"condition\"",
            ),
            ("sensor = 1\n", "5:10", "inputs.sensor must be a table, not an integer"),
            ("sensor = {}\n", "5:1", "inputs.sensor.volts_full_scale is missing"),
            ("sensor = { volts = 10 }\n", "5:12", "unknown key inputs.sensor.volts"),
            (
                "sensor = { volts_full_scale = 10, counts_full_scale = 32768, divider = 0 }\n",
                "5:72",
                "inputs.sensor.divider must be above 0, not 0",
            ),
            (
                "sensor = { volts_full_scale = 10, counts_full_scale = -1, divider = 0.33 }\n",
                "5:55",
                "inputs.sensor.counts_full_scale must be above 0, not -1",
            ),
            (
                "sensor = { volts_full_scale = 10, counts_full_scale = 1, divider = 0.331 }\n",
                "5:68",
                "divider 0.331 takes 10 V to 3.3100 V at the ADC, above its reference of 3.3 V",
            ),
            (
                "sensor.volts_full_scale = inf\nsensor.counts_full_scale = 1\nsensor.divider = 1\n",
                "5:27",
                "inputs.sensor.volts_full_scale must be a finite number",
            ),
        ],
    );
}

#[test]
fn the_thermometers_are_checked() {
    assert_refused(
        &format!("{MACHINE}[inputs]\n"),
        &[
            ("temp_a_c = { kind = \"pt100\" }\n", "5:1", "inputs.temp_a_c.channel is missing"),
            ("temp_a_c = { channel = 0 }\n", "5:1", "inputs.temp_a_c.kind is missing"),
            (
                "temp_a_c = { channel = 8, kind = \"pt100\" }\n",
                "5:24",
                "channel must be from 0 to 7, not 8",
            ),
            (
                "temp_a_c = { channel = -1, kind = \"pt100\" }\n",
                "5:24",
                "channel must be from 0 to 7, not -1",
            ),
            (
                "temp_a_c = { channel = 0.0, kind = \"pt100\" }\n",
                "5:24",
                "channel must be a whole number, not a float",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"pt1000\" }\n",
                "5:34",
                "must be \"pt100\" or \"linear\", not \"pt1000\"; did you mean pt100?",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_counts = 1 }\n",
                "5:1",
                "inputs.temp_a_c.counts_per_c is missing",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\" }\n",
                "5:1",
                "inputs.temp_a_c.zero_v is missing: a linear input needs zero_v and c_per_v, or",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_v = 1, counts_per_c = 16 }\n",
                "5:53",
                "zero_v stands together with counts_per_c",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_v = 0, c_per_v = 0 }\n",
                "5:66",
                "c_per_v must not be 0",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_v = 0, c_per_v = 4, full_scale_v = 24 }\n",
                "5:84",
                "full_scale_v 24 is too high: the divider 0.328 takes 24 V to 7.8720 V",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_counts = 1, counts_per_c = 1, divider = 0.3 }\n",
                "5:89",
                "divider needs counts_full_scale: without it a count is a code of the board",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"linear\", zero_counts = 1, counts_per_c = 0 }\n",
                "5:76",
                "counts_per_c must not be 0",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"pt100\", zero_counts = 1 }\n",
                "5:57",
                "zero_counts belongs to kind = \"linear\"",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"pt100\", max_c_per_min = 0.09 }\n",
                "5:59",
                "max_c_per_min must be from 0.1 to 600 K/min: the fastest change that the \
                 thermometer's mass can make, not 0.09",
            ),
            (
                "temp_a_c = { channel = 0, kind = \"pt100\", max_c_per_min = 601 }\n",
                "5:59",
                "max_c_per_min must be from 0.1 to 600 K/min: the fastest change that the \
                 thermometer's mass can make, not 601",
            ),
            (
                "temp_b_c = { channel = 1, kind = \"pt100\" }\n\
                 temp_a_c = { channel = 1, kind = \"pt100\" }\n",
                "6:24",
                "inputs.temp_a_c.channel 1 is already that of temp_b_c",
            ),
        ],
    );
}

#[test]
fn the_spindle_is_checked() {
    assert_refused(
        MACHINE,
        &[
            (
                "[spindle]\nsource = \"sensor\"\n",
                "5:10",
                "spindle.source is \"sensor\", but [spindle.sensor] is missing",
            ),
            ("[spindle]\nsource = \"sensors\"\n", "5:10", "did you mean sensor?"),
            ("[spindle]\nsuorce = \"sensor\"\n", "5:1", "did you mean source?"),
            ("[spindle.sensr]\n", "4:10", "unknown key spindle.sensr; did you mean sensor?"),
            ("[spindle.sensor]\n", "4:10", "spindle.sensor.k0_um is missing"),
            (
                "[spindle.sensor]\nk0_um = 0\nzero_count = 5048\num_per_count = 1\n",
                "6:1",
                "unknown key spindle.sensor.zero_count; did you mean zero_counts?",
            ),
            (
                "[spindle.sensor]\nk0_um = \"0\"\n",
                "5:9",
                "spindle.sensor.k0_um must be a number, not a string",
            ),
            (
                "[spindle.sensor]\nk0_um = 1e400\n",
                "5:9",
                "spindle.sensor.k0_um must be a finite number",
            ),
            (
                "[spindle.sensor]\nk0_um = 0\nzero_counts = 0\num_per_count = 0.0\n",
                "7:16",
                "spindle.sensor.um_per_count must not be 0",
            ),
            (
                "[spindle.sensor]\nk0_um = 0\nzero_counts = 0\num_per_count = 1\n\
                 temperature = \"coil\"\n",
                "8:15",
                "must name a column temp_<name>_c",
            ),
        ],
    );
}

#[test]
fn the_limits_are_checked() {
    assert_refused(
        &format!("{MACHINE}[limits]\n"),
        &[
            ("max_um = { x = -1.0 }\n", "5:16", "limits.max_um.x must not be negative, but is -1"),
            ("max_um = { a = 1.0 }\n", "5:12", "unknown key limits.max_um.a"),
            ("max_um = [1, 1, 1]\n", "5:10", "limits.max_um must be a table, not an array"),
            ("max_um.z = nan\n", "5:12", "limits.max_um.z must be a finite number"),
            ("slew_um_per_s = 0\n", "5:17", "limits.slew_um_per_s must be above 0, not 0"),
            ("slew_um_per_s = true\n", "5:17", "must be a number, not a boolean"),
            ("slew_um_s = 1\n", "5:1", "did you mean slew_um_per_s?"),
            ("link_timeout_ms = 0\n", "5:19", "must be from 1 to 4294967295, not 0"),
            ("link_timeout_ms = 0.5\n", "5:19", "must be a whole number, not a float"),
            ("hold_ms = -1\n", "5:11", "must be from 0 to 4294967295, not -1"),
            ("hold_ms = 4294967296\n", "5:11", "must be from 0 to 4294967295"),
            ("hold_ms = 1979-05-27\n", "5:11", "must be a whole number, not a date"),
        ],
    );
}

#[test]
fn the_head_axes_fit_the_kind() {
    for (kind, head_axes, place, phrase) in [
        (
            "3-axis",
            "head_axes = [\"c\"]",
            "4:13",
            "machine.head_axes must be [], because no rotary axis carries the spindle \
             (kind = \"3-axis\"), not [\"c\"]",
        ),
        (
            "table-table",
            "head_axes = [\"a\"]",
            "4:13",
            "because both rotary axes carry the workpiece",
        ),
        ("head-table", "", "1:2", "must name exactly one axis"),
        ("head-table", "head_axes = []", "4:13", "must name exactly one axis"),
        (
            "head-table",
            "head_axes = [\"a\", \"c\"]",
            "4:13",
            "exactly one axis, the one that carries",
        ),
        (
            "head-head",
            "",
            "1:2",
            "must name exactly two different axes, from the frame to the tool",
        ),
        ("head-head", "head_axes = [\"c\"]", "4:13", "(kind = \"head-head\"), not [\"c\"]"),
        ("head-head", "head_axes = [\"c\", \"c\"]", "4:13", "exactly two different axes"),
        ("head-head", "head_axes = [\"c\", \"a\", \"b\"]", "4:13", "exactly two different axes"),
        (
            "head-head",
            "head_axes = [\"c\", \"A\"]",
            "4:19",
            "head_axes[1] must be \"a\" or \"b\" or \"c\", not \"A\"",
        ),
        ("head-head", "head_axes = \"ca\"", "4:13", "must be an array of strings, not a string"),
        ("head-head", "head_axes = [3, 1]", "4:14", "head_axes[0] must be a string"),
    ] {
        let text = format!("[machine]\nname = \"a\"\nkind = \"{kind}\"\n{head_axes}\n");
        assert_refused("", &[(&text, place, phrase)]);
    }
}

#[test]
fn the_warm_up_is_checked() {
    let right = "lag_s = 60\nwarm_s = 5400\nmax_um = 80\n";
    assert_refused(
        &format!("{MACHINE}[spindle]\nsource = \"warmup\"\n"),
        &[
            ("", "5:10", "spindle.source is \"warmup\", but [spindle.warmup] is missing"),
            ("[spindle.warmup]\n", "6:10", "spindle.warmup.lag_s is missing"),
            (&format!("[spindle.warmup]\n{right}"), "6:10", "spindle.warmup.exponent is missing"),
            (
                &format!("[spindle.warmup]\n{right}exponent = 0\n"),
                "10:12",
                "must be above 0, not 0",
            ),
            ("[spindle.warmup]\nlag_s = -1\n", "7:9", "lag_s must not be negative, but is -1"),
            (
                "[spindle.warmup]\nlag_s = 60\nwarm_s = 60\nmax_um = 80\nexponent = 4\n",
                "8:10",
                "spindle.warmup.warm_s must be above lag_s = 60, not 60",
            ),
            (
                &format!("[spindle.warmup]\n{right}exponent = 4\ncool_s = 0\n"),
                "11:10",
                "cool_s must be above 0, not 0",
            ),
            (
                &format!("[spindle.warmup]\n{right}exponent = 4\nrated_rpm = -1\n"),
                "11:13",
                "rated_rpm must be above 0, not -1",
            ),
            (
                &format!("[spindle.warmup]\n{right}exponent = 4\nspeed_exponent = 1.5\n"),
                "11:18",
                "spindle.warmup.speed_exponent needs rated_rpm",
            ),
            ("[spindle.warmup]\nlags = 1\n", "7:1", "did you mean lag_s?"),
        ],
    );
}

#[test]
fn the_spindles_temperature_is_checked() {
    assert_refused(
        &format!("{MACHINE}[spindle]\nsource = \"temperature\"\n"),
        &[
            ("", "5:10", "is \"temperature\", but [spindle.temperature] is missing"),
            ("[spindle.temperature]\n", "6:10", "spindle.temperature.sensor is missing"),
            (
                "[spindle.temperature]\nsensor = \"front\"\n",
                "7:10",
                "sensor must name a column temp_<name>_c, not \"front\"",
            ),
            (
                "[spindle.temperature]\nsensor = \"temp_a_c\"\nreference_c = 20\n",
                "6:10",
                "spindle.temperature.k_um_per_c is missing",
            ),
            (
                "[spindle.temperature]\nk_um_c = 2\n",
                "7:1",
                "unknown key spindle.temperature.k_um_c; did you mean k_um_per_c?",
            ),
        ],
    );
}

#[test]
fn a_file_that_cannot_be_read_or_is_not_utf_8_is_refused() {
    let missing = MachineFile::read(Path::new("no/such/m.toml")).expect_err("is not there");
    assert!(missing.to_string().starts_with("no/such/m.toml:1:1: cannot be read: "));

    let path = std::env::temp_dir().join(format!("trueup-latin1-{}.toml", std::process::id()));
    std::fs::write(&path, b"[machine]\nname = \"\xc2\xb5\xb5\"\n").expect("a writable folder");
    let latin_1 = MachineFile::read(&path).expect_err("is not UTF-8");
    std::fs::remove_file(&path).expect("written above");
    assert_eq!((latin_1.place.line, latin_1.place.column), (2, 10));
    assert_eq!(latin_1.rule, "is not UTF-8 text");
}

#[test]
fn each_term_reports_all_its_errors() {
    let terms = "[[term]]\ncause = \"step\"\nquantity = \"dx\"\nat_s = \"soon\"\nsize_um = true\n\
                 [[term]]\ncause = \"straightness\"\n\
                 [[term]]\ncause = \"backlsh\"\nquantity = \"dq\"\ncolour = 1\n\
                 [[term]]\ncause = \"pitch-error\"\nquantity = \"dx\"\nstart_mm = 0\nstep_mm = 0\n";
    let error = error_of(&format!("{MACHINE}{terms}"));
    let messages: Vec<String> = error.into_single_errors().map(|fault| fault.to_string()).collect();
    let expected = [
        "7:8: term[0].at_s must be a number",
        "8:11: term[0].size_um must be a number",
        "9:1: term[1].quantity is missing",
        "9:1: term[1].along is missing",
        "9:1: term[1].order is missing",
        "9:1: term[1].knots_mm is missing",
        "9:1: term[1].control_um is missing",
        "12:9: term[2].cause \"backlsh\" is not known; did you mean backlash?",
        "13:12: term[2].quantity must be",
        "14:1: unknown key term[2].colour",
        "19:11: term[3].step_mm must be above 0",
    ];
    for phrase in expected {
        let phrase = format!("bad.toml:{phrase}");
        assert!(messages.iter().any(|line| line.starts_with(&phrase)), "{phrase}: {messages:#?}");
    }
    // The keys of the table that is wrong besides are not asked for.
    assert!(messages.iter().all(|line| !line.contains("forward_um")), "{messages:#?}");
    assert_eq!(messages.len(), expected.len(), "{messages:#?}");
}
