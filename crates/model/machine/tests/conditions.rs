//! The tool and the conditions of the machine: declared, read, predicted, compiled and shown.

use std::path::Path;

use trueup_core::term::Effect;
use trueup_machine::{
    InputFileError, Machine, MachineFile, RunFile, check, compile, compile::missing_input_lines,
    decompile, predict::RunPredictor,
};

const HEAD: &str = "[machine]\nname = \"mill\"\nkind = \"3-axis\"\n";
const TOOLS: &str = "[spindle.tools]\n7 = { um_per_krpm2 = 0.021 }\ndrill = { number = 3, um_per_krpm2 = 0.03 }\n\
                     12 = { label = \"face mill\", um_per_krpm2 = -0.004 }\ndefault = { um_per_krpm2 = 0.012 }\n";
const COOLANT: &str = "[[term]]\ncause = \"dependence\"\nquantity = \"dx\"\ncolumn = \"coolant_on\"\n\
                       form = \"level\"\nlevels = [0.0, 1.0]\nlevel_um = [0.0, 5.25]\n";
const DECLARED: &str = "[inputs]\ncoolant_on = { kind = \"condition\", bit = 4, default = 1 }\n";

fn parsed(text: &str) -> Result<Machine, InputFileError> {
    MachineFile::parse(&format!("{HEAD}{text}"), Path::new("m.toml"))
}

fn machine(text: &str) -> Machine {
    parsed(text).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

fn run(csv: &str) -> RunFile {
    RunFile::from_reader(csv.as_bytes(), Path::new("r.csv"))
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Returns the model's elongations, each within a nanometre of the board's.
fn elongations_um(machine: &Machine, run: &RunFile) -> Vec<f64> {
    let predictor = RunPredictor::new(machine, run).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(predictor.bridge_error(), None);
    let rows = predictor.predictions().map(|row| {
        assert!(row.arithmetic_error_nm().expect("a bridge") < 1.0, "{row:?}");
        row.model.elongation_um
    });
    rows.collect()
}

#[test]
fn tools_and_conditions_are_written_back_as_they_were_read() {
    let read = machine(&format!("{DECLARED}{TOOLS}{COOLANT}"));
    let again = MachineFile::parse(&read.to_toml(), Path::new("m.toml")).expect("its own file");
    assert_eq!((&again.spindle, &again.inputs), (&read.spindle, &read.inputs));
    assert_eq!(again.terms, read.terms);
}

#[test]
fn each_tool_grows_by_its_own_number_or_label_and_every_other_by_the_default() {
    let machine = machine(TOOLS);
    let csv = "spindle_rpm,tool\n20000,7\n20000,drill\n20000,3\n20000,face mill\n20000,12\n20000,99\n20000,0\n0,7\n";
    let read = run(csv).with_tool_numbers(&machine).expect("all are listed");
    assert_eq!(read.column("tool").expect("there")[..5], [7.0, 3.0, 3.0, 12.0, 12.0]);
    let grown = elongations_um(&machine, &read);
    let expected = [8.4, 12.0, 12.0, -1.6, -1.6, 4.8, 4.8, 0.0];
    for (grown, expected) in grown.iter().zip(expected) {
        assert!((grown - expected).abs() < 1e-9, "{grown} {expected}");
    }
    // Labels as they are read say the same.
    assert_eq!(elongations_um(&machine, &run(csv)), grown);
}

#[test]
fn a_label_that_no_tool_has_is_refused_where_it_stands_with_the_line_to_add() {
    for (file, list) in [(TOOLS, false), ("", true)] {
        let machine = machine(file);
        let error = run("time_s,tool\n0,\n1,reamer\n").with_tool_numbers(&machine).expect_err("it");
        assert_eq!((error.place.line, error.place.column), (3, 3), "{error}");
        assert!(error.rule.contains("\"reamer\"") && error.rule.contains("[spindle.tools]"));
        let help = error.help.expect("the line to add");
        assert!(
            help.contains("\"reamer\" = { number = 1") && help.contains("default") == list,
            "{help}"
        );
    }
    for cell in ["1.5", "-1", "65536", "\"\u{7}a\""] {
        let csv = format!("time_s,tool\n0,{cell}\n");
        let read = RunFile::from_reader(csv.as_bytes(), Path::new("r.csv"));
        assert!(read.is_err(), "{cell} is no tool");
    }
}

#[test]
fn compile_refuses_a_label_without_a_number_and_says_what_to_add() {
    let file = TOOLS.replace("number = 3, ", "");
    let machine = machine(&file);
    let grown = elongations_or_none(&machine, &run("spindle_rpm,tool\n20000,drill\n"));
    assert!((grown - 12.0).abs() < 1e-9, "to predict, the label is enough: {grown}");
    let error = compile(&machine).expect_err("the CNC sends numbers");
    assert!(error.rule.starts_with("spindle.tools.drill has no number"), "{error}");
    assert_eq!(error.place.line, 6, "{error}");
    assert!(error.help.expect("what to do").contains("number = N"));
}

fn elongations_or_none(machine: &Machine, run: &RunFile) -> f64 {
    let predictor = RunPredictor::new(machine, run).unwrap_or_else(|error| panic!("{error}"));
    assert!(predictor.bridge_error().is_some(), "no board runs it");
    let row = predictor.predictions().next().expect("a row");
    row.model.elongation_um
}

/// A term that was found before its label had a number holds for that tool once it has one, and runs on the board.
#[test]
fn a_level_of_a_label_is_that_of_its_number_once_it_has_one() {
    use trueup_machine::tool_column::label_code;
    let text = |tool: &str| {
        format!(
            "[spindle.tools]\nprobe = {{ {tool}um_per_krpm2 = 0.0 }}\ndefault = {{ um_per_krpm2 = 0.0 }}\n\
             [[term]]\ncause = \"dependence\"\nquantity = \"elongation\"\ncolumn = \"tool\"\nform = \"level\"\n\
             times = \"speed2\"\nlevels = [{:?}, 2.0]\nlevel_um_per_krpm2 = [0.02, 0.01]\n",
            label_code("probe")
        )
    };
    let read = run("spindle_rpm,tool\n20000,probe\n20000,2\n20000,9\n");
    let without = machine(&text(""));
    let grown: Vec<f64> = RunPredictor::new(&without, &read)
        .expect("to predict, the label is enough")
        .predictions()
        .map(|row| row.model.elongation_um)
        .collect();
    assert!((grown[0] - 8.0).abs() < 1e-9 && (grown[1] - 4.0).abs() < 1e-9, "{grown:?}");
    let with = machine(&text("number = 7, "));
    let read = read.with_tool_numbers(&with).expect("all are listed");
    assert_eq!(elongations_um(&with, &read), grown);
}

#[test]
fn a_condition_that_is_not_declared_is_asked_for_by_its_line() {
    let undeclared =
        machine(&format!("[inputs]\ndoor = {{ kind = \"condition\", bit = 0 }}\n{COOLANT}"));
    let line = "coolant_on = { kind = \"condition\", bit = 1 }";
    assert_eq!(missing_input_lines(&undeclared), [line]);
    let error = compile(&undeclared).expect_err("no bit");
    assert!(error.rule.contains(line), "{error}");
    let compiled = compile(&machine(&format!("{DECLARED}{COOLANT}"))).expect("declared");
    let Some(Effect::Condition(it)) = compiled.calibration().terms[0].map(|term| term.effect)
    else {
        panic!("no condition");
    };
    assert_eq!((it.bit, it.default, it.off), (4, true, 0));
    let shown = decompile::decompile_to_toml(&compiled.calibration());
    assert_eq!(shown.largest_difference_nm, Ok(0.0), "{}", shown.toml);
    assert!(shown.toml.contains("condition_4 = { kind = \"condition\", bit = 4, default = 1 }"));
}

#[test]
fn a_calibration_with_tools_is_shown_as_the_list_and_compiles_back() {
    let compiled = compile(&machine(TOOLS)).expect("it fits");
    assert!(compiled.largest_difference_nm < 0.01);
    let shown = decompile::decompile_to_toml(&compiled.calibration());
    assert!(shown.toml.starts_with("# Compiles back to the same calibration"), "{}", shown.toml);
    let list = "[spindle.tools]\n3 = { um_per_krpm2 = 0.03 }\n7 = { um_per_krpm2 = 0.021 }\n\
                12 = { um_per_krpm2 = -0.004 }\ndefault = { um_per_krpm2 = 0.012 }\n";
    assert!(shown.toml.contains(list), "{}", shown.toml);
}

#[test]
fn a_declaration_alone_changes_no_byte_of_a_calibration() {
    let law = "[axis.x.backlash]\nwidth_um = 4.0\n";
    let bytes = |text: &str| compile(&machine(text)).expect("it fits").blob().to_vec();
    assert_eq!(bytes(&format!("{DECLARED}{law}")), bytes(law));
}

#[test]
fn what_contradicts_itself_is_refused_with_its_key() {
    let more = (0..33).map(|n| format!("{n} = {{ um_per_krpm2 = 0.01 }}\n")).collect::<String>();
    for (text, rule) in [
        ("[inputs]\na = { kind = \"condition\", bit = 1 }\nb = { kind = \"condition\", bit = 1 }\n".into(), "inputs.b.bit"),
        ("[inputs]\na = { kind = \"condition\", bit = 16 }\n".into(), "inputs.a.bit"),
        ("[inputs]\nx_mm = { kind = \"condition\", bit = 1 }\n".into(), "inputs.x_mm.kind"),
        ("[inputs]\na = { kind = \"pt100\", channel = 1 }\n".into(), "unknown key inputs.a"),
        ("[spindle.tools]\n7 = { um_per_krpm2 = 0.02 }\n".into(), "spindle.tools.default is missing"),
        ("[spindle.tools]\n7 = { um_per_krpm2 = 0.02 }\na = { number = 7, um_per_krpm2 = 0.1 }\ndefault = { um_per_krpm2 = 0.0 }\n".into(), "spindle.tools.a is the tool of 7"),
        ("[spindle.tools]\n70000 = { um_per_krpm2 = 0.02 }\ndefault = { um_per_krpm2 = 0.0 }\n".into(), "spindle.tools.70000"),
        (format!("[spindle.tools]\n{more}default = {{ um_per_krpm2 = 0.0 }}\n"), "a board knows 32 tools"),
        (format!("{}lag_s = 5.0\n", COOLANT.replace("coolant_on", "tool").replace("[0.0, 1.0]", "[0.0, 2.0]")), "lag_s"),
    ] {
        let text: String = text;
        let error = parsed(&text).expect_err(&text);
        assert!(error.rule.contains(rule), "{error}\n{text}");
    }
}

#[test]
fn a_column_of_few_values_is_suggested_once_as_a_condition() {
    let rows = |n: usize| format!("{},{},{},{}\n", n / 10 % 2, n / 20 % 3, n, n % 2);
    let csv: String = (0..120).map(rows).collect();
    let run = run(&format!("coolant_on,pallet,flow,door\n{csv}"));
    let alone = check::suggest_condition_columns(&run, None);
    assert_eq!(alone.len(), 3, "{alone:?}");
    assert!(alone[0].contains("`coolant_on = { kind = \"condition\", bit = 0 }` in [inputs]"));
    assert!(alone[1].starts_with("pallet has 3 values") && alone[2].contains("bit = 1 }"));
    let machine = machine(DECLARED);
    let adjacent = check::suggest_condition_columns(&run, Some(&machine));
    assert!(adjacent.len() == 2 && adjacent[1].starts_with("door is 0 or 1"), "{adjacent:?}");
}
