//! Runs a flashable image for the STM32F405 on a strict model of the chip, and says what it did.

mod options;

use options::{CommandLineOptions, exit_with_usage, parse_options};
use std::{
    collections::BTreeMap,
    fs,
    fs::File,
    io::{Write as _, stdin},
    net::TcpListener,
    process::ExitCode,
    time::Instant,
};
use trueup_chip::{
    board::{Board, TraceOptions},
    chip::Chip,
    elf::SymbolTable,
    processor::{FLASH_SIZE, MONITORED_EXCEPTIONS, Memories},
    report::Severity,
    script::StimulusScript,
    simulation_time::{ms_to_ticks, ticks_to_seconds, ticks_to_us},
    summary,
    world::World,
};

/// FLASH_OPTCR, nWRP of sectors 8 to 11: 0 protects them against writes.
const OPTCR_NWRP_8_TO_11_MASK: u32 = 0xf00 << 16;
/// FLASH_OPTCR, BOR_LEV: 0 is brown-out level 3.
const OPTCR_BOR_LEV_MASK: u32 = 0xc;

/// Time of the board between two writes of its log to the file.
const LOG_PERIOD_TICKS: u64 = ms_to_ticks(20);

fn main() -> ExitCode {
    let options = parse_options();
    let image = fs::read(&options.image)
        .unwrap_or_else(|error| exit_with_usage(&format!("{}: {error}", options.image)));
    let symbols = SymbolTable::parse(&image);
    let mut board = build_board(&options, &image);
    let start = Instant::now();
    let mut log = options.rtt.as_ref().map(|file| File::create(file).expect("writable"));
    let mut live_until = |board: &mut Board, end: u64| {
        while board.now() < end {
            board.run_until((board.now() + LOG_PERIOD_TICKS).min(end));
            let output = std::mem::take(&mut board.log);
            if let Some(file) = &mut log {
                file.write_all(&output).expect("writable");
            }
        }
    };
    if options.live {
        play_script_from_stdin(&mut board, &mut live_until);
    } else {
        live_until(&mut board, options.run);
    }
    let wall = start.elapsed().as_secs_f64();
    write_output_files(&options, &board);
    let now = ticks_to_seconds(board.now());
    let up = board.first_sleep.unwrap_or(0);
    println!(
        "== run: {now:.3} s of the board in {wall:.2} s: {:.1} × slower; {} steps, {:.1} M/s; \
         busy {:.1} % since it first slept at {:.1} ms, {} sleeps",
        wall / now,
        board.steps,
        board.steps as f64 / wall / 1e6,
        100.0 - 100.0 * board.asleep as f64 / (board.now() - up).max(1) as f64,
        ticks_to_seconds(up) * 1e3,
        board.sleeps
    );
    let violations = board.with_chip(|chip| {
        summary::print_summary(chip, options.quiet);
        print_report(chip, &symbols);
        chip.report.count(Severity::Violation)
    });
    print_interrupt_timing(&mut board, &symbols);
    if options.trace > 0 {
        print_pc_histogram(&board.places, &symbols, options.trace as usize);
    }
    ExitCode::from(u8::from(violations > 0))
}

/// Lets another program play the world as it goes: the lines of a script, in the order of their times, and between
/// them a time alone. The board then lives until that millisecond, and says so.
fn play_script_from_stdin(board: &mut Board, live_until: &mut impl FnMut(&mut Board, u64)) {
    for line in stdin().lines().map_while(Result::ok) {
        if let Ok(at) = line.trim().parse() {
            live_until(board, ms_to_ticks(at));
            println!("{at}");
        } else {
            board.with_chip(|chip| {
                chip.world.script.as_mut().expect("it is played").add_line(&line);
            });
        }
    }
}

/// Returns the board that the options ask for, before its first instruction.
fn build_board(options: &CommandLineOptions, image: &[u8]) -> Board {
    let memories = Memories::new();
    if let Some(flash) = options.flash.as_ref().and_then(|file| fs::read(file).ok()) {
        memories.flash.write_at(0, &flash).expect("a megabyte of flash");
    }
    let mut world = World::new(options.plan.clone());
    let script = options.script.as_ref().map(|file| fs::read_to_string(file).expect("a script"));
    if let Some(text) = script.or(options.live.then(String::new)) {
        world.script = Some(StimulusScript::from_text(&text));
        world.rtds.iter_mut().for_each(|rtd| rtd.celsius = Some(20.0));
    }
    world.lsi_hz = options.lsi;
    world.battery = options.battery;
    world.crystal_hz = options.crystal;
    world.slow_flash = options.slow_flash;
    world.supply = options.supply;
    world.inputs = options.inputs;
    world.populated = (1u32 << options.rtds) - 1;
    for (number, rtd) in world.rtds.iter_mut().enumerate() {
        if options.broken >> number & 1 != 0 {
            rtd.celsius = None;
        }
    }
    let named = ["serial", "modbus"].into_iter().zip(options.ports).zip(&mut world.wires);
    for ((name, port), wire) in named {
        let Some(port) = port else { continue };
        let listener = TcpListener::bind(("127.0.0.1", port)).expect("a free port");
        listener.set_nonblocking(true).expect("a socket");
        // Port 0 asks for any free one: who waits for the line reads it here.
        println!("{name}: 127.0.0.1:{}", listener.local_addr().expect("a socket").port());
        wire.port = Some(listener);
    }
    world.low = options.low.clone();
    let plc = &mut world.wires[1];
    (plc.baud, plc.parity, plc.stop_bits) = options.plc;
    let watch = TraceOptions {
        masked: options.masked,
        places: options.trace > 0,
        log: options.rtt.is_some(),
        awake: options.awake,
    };
    let mut board = Board::new(image, memories, world, options.faults, watch);
    if options.from_loader {
        board.set_bootloader_state();
    }
    if options.ram_stuck != 0 {
        board.inject_stuck_bit(options.ram_stuck);
    }
    if options.write_protected {
        board.with_chip(|chip| chip.flash.optcr &= !OPTCR_NWRP_8_TO_11_MASK);
    }
    if options.bor {
        // As after the image has run once: brown-out level 3.
        board.with_chip(|chip| chip.flash.optcr &= !OPTCR_BOR_LEV_MASK);
    }
    board
}

/// Writes the files that the options ask for.
fn write_output_files(options: &CommandLineOptions, board: &Board) {
    if let Some(file) = &options.flash {
        let mut all = vec![0; FLASH_SIZE as usize];
        board.memories().flash.read_at(0, &mut all).expect("all of it");
        fs::write(file, &all).expect("writable");
    }
    let now = board.now();
    board.with_chip(|chip| {
        if let Some(file) = &options.log {
            fs::write(file, summary::format_event_log(chip, now)).expect("writable");
        }
        if let Some(file) = &options.serial_out {
            let bytes: Vec<u8> = chip.world.wires[0].heard.iter().map(|(_, byte)| *byte).collect();
            fs::write(file, bytes).expect("writable");
        }
    });
}

fn print_report(chip: &Chip, symbols: &SymbolTable) {
    if chip.flash.stale != 0 {
        println!(
            "== a cache was on during an erase and has not been reset since (RM0090 on \
             FLASH_ACR.DCRST): {}",
            chip.flash.stale
        );
    }
    for grade in [Severity::Fact, Severity::Unmodelled, Severity::Remark, Severity::Violation] {
        println!("== {grade:?}: {}", chip.report.count(grade));
        for ((of, text), item) in &chip.report.items {
            if *of == grade {
                println!(
                    "   {text}  [{} ×, first at {:.3} ms, {}]",
                    item.count,
                    ticks_to_seconds(item.first) * 1e3,
                    symbols.describe_address(item.pc)
                );
            }
        }
    }
}

fn print_interrupt_timing(board: &mut Board, symbols: &SymbolTable) {
    board.masks.sort_by_key(|masked| std::cmp::Reverse(masked.length));
    for masked in board.masks.iter().take(12) {
        println!(
            "   PRIMASK set for {:.2} µs at {:.3} ms from {}",
            ticks_to_us(masked.length),
            ticks_to_seconds(masked.since) * 1e3,
            symbols.describe_address(masked.pc)
        );
    }
    let waits =
        MONITORED_EXCEPTIONS.iter().zip(board.pended_longest).filter(|(_, longest)| *longest > 0);
    let waits: Vec<String> = waits
        .map(|((name, _), longest)| format!("{name}: {:.1} µs", ticks_to_us(longest)))
        .collect();
    if !waits.is_empty() {
        println!("   pending at the longest: {}", waits.join(", "));
    }
    let turns = board.turns.longest.iter().map(|(number, longest)| {
        format!("{number}: {:.1} of {:.1} µs", ticks_to_us(longest.own), ticks_to_us(longest.whole))
    });
    let turns: Vec<String> = turns.collect();
    if !turns.is_empty() {
        println!("   turns at the longest, by exception: {}", turns.join(", "));
    }
}

fn print_pc_histogram(places: &BTreeMap<u32, u64>, symbols: &SymbolTable, most: usize) {
    let mut by: BTreeMap<String, u64> = BTreeMap::new();
    for (pc, count) in places {
        let name = symbols.describe_address(*pc);
        *by.entry(name.split(" + ").next().unwrap_or_default().to_owned()).or_default() += count;
    }
    let mut by: Vec<_> = by.into_iter().collect();
    by.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    println!("== where it is, sampled");
    for (name, count) in by.into_iter().take(most) {
        println!("   {count:8} {name}");
    }
}
