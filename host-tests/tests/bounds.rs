//! The time of every task is bounded, from the linked image: every loop has a bound, and every response is below its deadline
//! or named here.
#![allow(clippy::print_stdout, reason = "a test prints its figures")]

use std::{collections::BTreeMap, path::PathBuf, process::Command, sync::OnceLock};

use trueup_bounds::{
    decode::{self, ControlFlow},
    flow_facts::{FIRMWARE_DECLARATIONS, LOG_STRING_FUNCTION},
    image::FirmwareImage,
    report::TimingBounds,
};
use trueup_checks::timing_bounds;
use trueup_emulator::{firmware_images, setup};
use trueup_modbus::{rtu::FrameTiming, server::MIN_REQUEST_BYTES};
use trueup_store::{rate_limit::MIN_STORE_INTERVAL_MS, write_log::WriteKind};

fn image() -> &'static PathBuf {
    static IMAGE: OnceLock<PathBuf> = OnceLock::new();
    IMAGE.get_or_init(|| {
        firmware_images::build_standalone_image(
            &setup::project_root().join("data/paper_spindle.toml"),
        )
        .unwrap()
    })
}

fn bounded() -> &'static TimingBounds {
    static BOUNDS: OnceLock<TimingBounds> = OnceLock::new();
    BOUNDS.get_or_init(|| timing_bounds::compute_bounds(image()).unwrap())
}

/// Tasks that are bounded below their deadline without the accelerator of the flash, by clock. Of all others it is not shown
/// (docs/robustness.md has the reasons), and their responses are measured on the model instead (`chip`, `waits`).
const SHOWN: &[&str] = &[
    "168 MHz sample",
    "168 MHz can_receive_0",
    "168 MHz can_receive_1",
    "168 MHz serial_receive",
    "168 MHz serial_dma_progress",
    "168 MHz listen",
    "168 MHz modbus_line",
    "168 MHz service",
    "168 MHz transmit",
    "144 MHz sample",
    "144 MHz serial_receive",
    "144 MHz serial_dma_progress",
    "144 MHz listen",
    "144 MHz modbus_line",
    "144 MHz service",
    "144 MHz transmit",
    "16 MHz serial_receive",
    "16 MHz serial_dma_progress",
    "16 MHz modbus_line",
];

#[test]
fn every_loop_of_every_task_has_a_bound() {
    let bounds = bounded();
    let [code, table] = bounds.loops;
    println!("{code} loops are bounded by the code, {table} by the table");
    assert_eq!(bounds.problems, [""; 0]);
    assert_eq!(bounds.unused, [""; 0], "declared, but not needed");
    // A program that sees nothing would pass.
    assert!(code > 30 && table > 60 && bounds.all.len() > 30);
}

#[test]
fn responses_are_below_their_deadlines_where_it_is_shown() {
    let bounds = bounded();
    println!("{}", bounds.format_table(|_| None));
    let late = bounds.unschedulable_tasks();
    let in_time = bounds.all.iter().map(|bound| format!("{} {}", bound.clock, bound.task));
    let in_time: Vec<String> = in_time.filter(|task| !late.contains(task)).collect();
    assert_eq!(in_time, SHOWN);
}

#[test]
fn the_functions_of_a_path_take_the_time_of_its_task() {
    let path = timing_bounds::build_longest_path_report("sample", 168, false).unwrap();
    println!("{path}");
    let whole = path.split_once("168 MHz: ").and_then(|(_, rest)| rest.split_once(" µs"));
    let whole: f64 = whole.unwrap().0.parse().unwrap();
    let rows = path.lines().skip(2).take_while(|line| !line.is_empty());
    let own: Vec<f64> =
        rows.map(|row| row.split_whitespace().nth(1).unwrap().parse().unwrap()).collect();
    // Each is rounded to 0.1 µs.
    let sum: f64 = own.iter().sum();
    assert!((sum - whole).abs() <= 0.05 * (own.len() + 1) as f64, "{sum} {whole}");
    assert!(own.len() > 20 && own[0] < whole / 2.0);
}

#[test]
fn a_function_with_a_rate_within_another_one_is_counted_and_each_task_has_a_path() {
    let bounds = bounded();
    for it in bounds.all.iter().filter(|bound| bound.clock.starts_with("168")) {
        let path = timing_bounds::build_longest_path_report(&it.task, 168, false).unwrap();
        let apart = path.lines().filter(|line| line.starts_with("apart: ")).count();
        // A piece of the serial line is taken from the port, and a full one leaves bytes in it.
        assert!(it.task != "transmit" || apart == 2, "{path}");
    }
}

fn period_us(function: &str) -> f64 {
    let mut once = FIRMWARE_DECLARATIONS.once.iter();
    once.find(|once| once.function == function).expect(function).period_us
}

#[test]
fn rates_are_those_that_the_code_keeps() {
    // 11 bits a character, at the two speeds of the switch (`src/board/stm32f405/rs485.rs`).
    for baud in [19_200, 115_200] {
        let silence_us = f64::from(FrameTiming::from_baud(baud).behind_us);
        let request_us = MIN_REQUEST_BYTES as f64 * 11e6 / f64::from(baud) + silence_us;
        assert!(period_us("server::handle_request") <= silence_us);
        assert!(period_us("server::execute_request") <= request_us);
    }
    let records = period_us("trueup_store::reference::ReferenceStore<F>::append");
    assert_eq!(records, 1_000.0 * f64::from(MIN_STORE_INTERVAL_MS));
}

/// The tasks of `src/main.rs`, each with its text.
fn tasks(app: &str) -> impl Iterator<Item = (&str, &str)> {
    app.split("#[task(").skip(1).map(|text| {
        let text = text.split_once("\n    }\n").expect("a task ends").0;
        let name = text.split_once("fn ").and_then(|(_, rest)| rest.split_once('('));
        (name.expect("a task has a name").0, text)
    })
}

#[test]
fn tasks_raise_each_other_as_often_as_their_table_says() {
    let app = std::fs::read_to_string(setup::project_root().join("src/main.rs")).unwrap();
    let raise = |what: &[&str]| {
        let raise = tasks(&app).filter(|(_, text)| what.iter().any(|what| text.contains(what)));
        raise.map(|(name, _)| name).collect::<Vec<_>>()
    };
    // `transmit` 1.6 times in a millisecond: no task that bytes or frames start is among these.
    let transmit = raise(&["pend(TRANSMIT_INTERRUPT)", "send_frames("]);
    assert_eq!(transmit, ["sample", "supervise", "service"]);
    // `modbus` by 16 bytes, of which there is room for 48 more.
    assert_eq!(raise(&["pend(Interrupt::TIM5)"]), ["modbus_line"]);
    let modbus_line = tasks(&app).find(|(name, _)| *name == "modbus_line").unwrap().1;
    assert!(modbus_line.contains("if cx.local.to_modbus.len() >= PLC_BATCH_LENGTH {"));
    assert!(app.contains("const PLC_BATCH_LENGTH: usize = 16;"));
    assert!(
        app.contains("const PLC_RX_QUEUE_LENGTH: usize = 64;") && app.contains("4.5 ms, 48 bytes")
    );
}

#[test]
fn words_in_the_log_are_as_long_as_their_bound() {
    let declared =
        FIRMWARE_DECLARATIONS.copies.iter().find(|copy| copy.at.function == LOG_STRING_FUNCTION);
    let longest = WriteKind::ALL.map(|what| what.as_str().len()).into_iter().max();
    assert_eq!(declared.map(|declared| declared.bytes as usize), longest);
}

#[test]
fn a_task_whose_load_is_the_whole_time_has_no_response() {
    let bounds = bounded();
    for it in &bounds.all {
        let place = format!("{} {}: {:.2}", it.clock, it.task, it.share);
        assert!(it.share > 0.0 && (it.share < 1.0 || it.response_us.is_none()), "{place}");
    }
    // CAN stays silent without its crystal.
    assert_eq!(bounds.all.len(), 13 + 11 + 11);
}

/// The disassembler of LLVM says: address, and the target of a branch.
fn disassembled() -> Option<BTreeMap<u32, (String, Option<u32>)>> {
    let mut command = Command::new("llvm-objdump");
    let output = command.args(["-d", "--no-show-raw-insn"]).arg(image()).output().ok()?;
    let mut all = BTreeMap::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Some((at, text)) = line.split_once(":\t").or(line.split_once(": ")) else { continue };
        let Ok(at) = u32::from_str_radix(at.trim(), 16) else { continue };
        let text = text.trim();
        if text.starts_with('.') {
            continue;
        }
        let mnemonic = text.split_whitespace().next().unwrap_or_default().to_owned();
        let is_branch =
            mnemonic.starts_with('b') && !mnemonic.starts_with("bi") && !mnemonic.starts_with("bf")
                || mnemonic.starts_with("cb");
        let target = text.split_once("0x").filter(|_| is_branch);
        let target = target.and_then(|(_, hex)| {
            let end =
                hex.find(|character: char| !character.is_ascii_hexdigit()).unwrap_or(hex.len());
            u32::from_str_radix(&hex[..end], 16).ok()
        });
        all.insert(at, (mnemonic, target));
    }
    Some(all)
}

#[test]
#[ignore = "long: disassembles the whole image"]
fn lengths_and_targets_are_those_of_the_disassembler() {
    let Some(expected) = disassembled() else {
        println!("skipped: llvm-objdump is not here");
        return;
    };
    let image = FirmwareImage::read(image()).unwrap();
    let (mut count, mut branches) = (0, 0);
    for function in image.functions() {
        let mut at = function.start;
        while at < function.end {
            let end = image.region_end(at).min(function.end);
            let code = image.bytes(at, end).filter(|_| !image.is_data(at));
            for one in code.iter().flat_map(|code| decode::decode(code, at)) {
                let place = format!("{:#x} in {}", one.at, function.name);
                let (mnemonic, target) = expected.get(&one.at).expect(&place);
                let own = match one.flow {
                    ControlFlow::Jump(target)
                    | ControlFlow::Call(target)
                    | ControlFlow::CompareAndBranch { target, .. } => Some(target),
                    _ => None,
                };
                assert_eq!(own, *target, "{mnemonic} at {place}");
                count += 1;
                branches += u32::from(own.is_some());
            }
            at = end;
        }
    }
    println!("{count} instructions, {branches} of them branch to an address");
    assert!(count > 20_000 && branches > 4_000);
}
