//! Runs a flashable image for the STM32F405 on a strict model of the chip, and says what it did.

mod options;

use options::{Options, options, usage};
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
    chip::Chip,
    elf::Symbols,
    processor::{FLASH_SIZE, Memories, PENDED},
    report::Grade,
    run::{Board, Watch},
    script::Script,
    summary,
    time::{micros, ms, seconds},
    world::World,
};

/// Time of the board between two writes of its log to the file.
const LOG_PERIOD: u64 = ms(20);

fn main() -> ExitCode {
    let options = options();
    let image = fs::read(&options.image)
        .unwrap_or_else(|error| usage(&format!("{}: {error}", options.image)));
    let symbols = Symbols::read(&image);
    let mut board = board(&options, &image);
    let start = Instant::now();
    let mut log = options.rtt.as_ref().map(|file| File::create(file).expect("writable"));
    let mut live_until = |board: &mut Board, end: u64| {
        while board.now() < end {
            board.run_until((board.now() + LOG_PERIOD).min(end));
            let said = std::mem::take(&mut board.log);
            if let Some(file) = &mut log {
                file.write_all(&said).expect("writable");
            }
        }
    };
    if options.live {
        play(&mut board, &mut live_until);
    } else {
        live_until(&mut board, options.run);
    }
    let wall = start.elapsed().as_secs_f64();
    save(&options, &board);
    let now = seconds(board.now());
    let up = board.first_sleep.unwrap_or(0);
    println!(
        "== run: {now:.3} s of the board in {wall:.2} s: {:.1} × slower; {} steps, {:.1} M/s; \
         busy {:.1} % since it first slept at {:.1} ms, {} sleeps",
        wall / now,
        board.steps,
        board.steps as f64 / wall / 1e6,
        100.0 - 100.0 * board.asleep as f64 / (board.now() - up).max(1) as f64,
        seconds(up) * 1e3,
        board.sleeps
    );
    let violations = board.with_chip(|chip| {
        summary::summary(chip, options.quiet);
        say_report(chip, &symbols);
        chip.report.count(Grade::Violation)
    });
    say_masks(&mut board, &symbols);
    if options.trace > 0 {
        say_places(&board.places, &symbols, options.trace as usize);
    }
    ExitCode::from(u8::from(violations > 0))
}

/// Lets another program play the world as it goes: the lines of a script, in the order of their times, and between
/// them a time alone. The board then lives until that millisecond, and says so.
fn play(board: &mut Board, live_until: &mut impl FnMut(&mut Board, u64)) {
    for line in stdin().lines().map_while(Result::ok) {
        if let Ok(at) = line.trim().parse() {
            live_until(board, ms(at));
            println!("{at}");
        } else {
            board.with_chip(|chip| {
                chip.world.script.as_mut().expect("it is played").add(&line);
            });
        }
    }
}

/// Returns the board that the options ask for, before its first instruction.
fn board(options: &Options, image: &[u8]) -> Board {
    let memories = Memories::new();
    if let Some(flash) = options.flash.as_ref().and_then(|file| fs::read(file).ok()) {
        memories.flash.write_at(0, &flash).expect("a megabyte of flash");
    }
    let mut world = World::new(options.plan.clone());
    let script = options.script.as_ref().map(|file| fs::read_to_string(file).expect("a script"));
    if let Some(text) = script.or(options.live.then(String::new)) {
        world.script = Some(Script::read(&text));
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
    let watch = Watch {
        masked: options.masked,
        places: options.trace > 0,
        log: options.rtt.is_some(),
        awake: options.awake,
    };
    let mut board = Board::new(image, memories, world, options.faults, watch);
    if options.from_loader {
        board.start_from_loader();
    }
    if options.ram_stuck != 0 {
        board.stick_ram(options.ram_stuck);
    }
    if options.write_protected {
        board.with_chip(|chip| chip.flash.optcr &= !(0xf00 << 16));
    }
    if options.bor {
        // As after the image has run once: brown-out level 3.
        board.with_chip(|chip| chip.flash.optcr &= !0xc);
    }
    board
}

/// Writes the files that the options ask for.
fn save(options: &Options, board: &Board) {
    if let Some(file) = &options.flash {
        let mut all = vec![0; FLASH_SIZE as usize];
        board.memories().flash.read_at(0, &mut all).expect("all of it");
        fs::write(file, &all).expect("writable");
    }
    let now = board.now();
    board.with_chip(|chip| {
        if let Some(file) = &options.log {
            fs::write(file, summary::log(chip, now)).expect("writable");
        }
        if let Some(file) = &options.serial_out {
            let bytes: Vec<u8> = chip.world.wires[0].heard.iter().map(|(_, byte)| *byte).collect();
            fs::write(file, bytes).expect("writable");
        }
    });
}

fn say_report(chip: &Chip, symbols: &Symbols) {
    if chip.flash.stale != 0 {
        println!(
            "== a cache was on during an erase and has not been reset since (RM0090 on \
             FLASH_ACR.DCRST): {}",
            chip.flash.stale
        );
    }
    for grade in [Grade::Fact, Grade::Unmodelled, Grade::Remark, Grade::Violation] {
        println!("== {grade:?}: {}", chip.report.count(grade));
        for ((of, text), item) in &chip.report.items {
            if *of == grade {
                println!(
                    "   {text}  [{} ×, first at {:.3} ms, {}]",
                    item.count,
                    seconds(item.first) * 1e3,
                    symbols.at(item.pc)
                );
            }
        }
    }
}

fn say_masks(board: &mut Board, symbols: &Symbols) {
    board.masks.sort_by_key(|masked| std::cmp::Reverse(masked.length));
    for masked in board.masks.iter().take(12) {
        println!(
            "   PRIMASK set for {:.2} µs at {:.3} ms from {}",
            micros(masked.length),
            seconds(masked.since) * 1e3,
            symbols.at(masked.pc)
        );
    }
    let waits = PENDED.iter().zip(board.pended_longest).filter(|(_, longest)| *longest > 0);
    let waits: Vec<String> =
        waits.map(|((name, _), longest)| format!("{name}: {:.1} µs", micros(longest))).collect();
    if !waits.is_empty() {
        println!("   pending at the longest: {}", waits.join(", "));
    }
    let turns = board.turns.longest.iter().map(|(number, longest)| {
        format!("{number}: {:.1} of {:.1} µs", micros(longest.own), micros(longest.whole))
    });
    let turns: Vec<String> = turns.collect();
    if !turns.is_empty() {
        println!("   turns at the longest, by exception: {}", turns.join(", "));
    }
}

fn say_places(places: &BTreeMap<u32, u64>, symbols: &Symbols, most: usize) {
    let mut by: BTreeMap<String, u64> = BTreeMap::new();
    for (pc, count) in places {
        let name = symbols.at(*pc);
        *by.entry(name.split(" + ").next().unwrap_or_default().to_owned()).or_default() += count;
    }
    let mut by: Vec<_> = by.into_iter().collect();
    by.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    println!("== where it is, sampled");
    for (name, count) in by.into_iter().take(most) {
        println!("   {count:8} {name}");
    }
}
