//! Small programs, assembled by hand (`llvm-mc -triple=thumbv7em-none-eabihf -show-encoding`): a loop without a bound, a
//! call that leads nowhere and a circle of calls are named; what has a bound costs what the manual says.

use trueup_bounds::{
    clock_configuration::{CLOCK_CONFIGURATIONS, ClockConfiguration},
    critical_sections::CriticalSectionAnalysis,
    declarations::{
        CalibrationSizes, CallTargets, DeclarationTable, IterationBound, LoopBound, SourcePattern,
    },
    function_entry::FunctionEntry,
    image::FirmwareImage,
    program::Program,
    source_code::SourceCode,
    wcet::WcetAnalysis,
};

const FLASH: u32 = 0x0800_0000;
/// `1: ldr r1, [r0]; cmp r1, #0; beq 1b; bx lr`.
const POLLS: &[u16] = &[0x6801, 0x2900, 0xD0FC, 0x4770];
/// `movs r2, #20; 1: subs r2, #1; bne 1b; bx lr`.
const COUNTS: &[u16] = &[0x2214, 0x3A01, 0xD1FD, 0x4770];
/// `movs r1, #3; 2: movs r2, #5; 1: subs r2, #1; bne 1b; subs r1, #1; bne 2b; bx lr`.
const NESTED: &[u16] = &[0x2103, 0x2205, 0x3A01, 0xD1FD, 0x3901, 0xD1FA, 0x4770];
/// `add.w r2, r0, #40; 1: ldr r3, [r0], #4; cmp r0, r2; bne 1b; bx lr`.
const POINTER: &[u16] = &[0xF100, 0x0228, 0xF850, 0x3B04, 0x4290, 0xD1FB, 0x4770];
/// `push {r4, lr}; blx r3; pop {r4, pc}`.
const BY_REGISTER: &[u16] = &[0xB510, 0x4798, 0xBD10];
/// `push {r4, lr}; bl .-2; pop {r4, pc}`: calls itself.
const CIRCLE: &[u16] = &[0xB510, 0xF7FF, 0xFFFD, 0xBD10];
/// `movs r0, #0xC0; msr basepri_max, r0; ldr r1, [r2]; adds r1, #1; str r1, [r2]; movs r0, #0; msr basepri, r0; bx lr`.
const LOCKED: &[u16] =
    &[0x20C0, 0xF380, 0x8812, 0x6811, 0x3101, 0x6011, 0x2000, 0xF380, 0x8811, 0x4770];
/// `cpsid i; ldr r1, [r2]; cpsie i; bx lr`.
const MASKED: &[u16] = &[0xB672, 0x6811, 0xB662, 0x4770];

/// `push {r4, r5, lr}; sub sp, #8; str r0, [sp]; str r1, [sp, #4]; 1: ldr r3, [sp, #4]; ldr r4, [sp]; ldr r5, [r3]; str r5, [r4];
/// ldr r5, [r3, #4]; str r5, [r4, #4]; adds r3, #8; adds r4, #8; str r3, [sp, #4]; str r4, [sp]; cmp r4, r2; blo 1b; add sp, #8;
/// pop {r4, r5, pc}`: two words in a round, their addresses on the stack.
const COPIES: &[u16] = &[
    0xB530, 0xB082, 0x9000, 0x9101, 0x9B01, 0x9C00, 0x681D, 0x6025, 0x685D, 0x6065, 0x3308, 0x3408,
    0x9301, 0x9400, 0x4294, 0xD3F3, 0xB002, 0xBD30,
];
/// `1: lsrs r1, r1, #4; orrs r2, r1; cmp r2, r0; blo 1b; bx lr`.
const HALVES: &[u16] = &[0x0909, 0x430A, 0x4282, 0xD3FB, 0x4770];
/// `2: ldr r1, [r0]; 1: ldr r2, [r0, #4]; cmp r2, #1; beq 1b; cmp r2, #2; beq 2b; bx lr`: one loop of the source with two headers.
const THREADED: &[u16] = &[0x6801, 0x6842, 0x2A01, 0xD0FC, 0x2A02, 0xD0F9, 0x4770];

const SLOW: ClockConfiguration = CLOCK_CONFIGURATIONS[2];
const FAST: ClockConfiguration = CLOCK_CONFIGURATIONS[0];

/// Returns the worst case of the first function, and what is missing.
fn worst(
    code: &[&[u16]],
    table: &DeclarationTable,
    clock: ClockConfiguration,
) -> (u64, Vec<String>) {
    worst_of(code, [None; 4], table, clock)
}

/// As [`worst`], called with these arguments.
fn worst_of(
    code: &[&[u16]],
    arguments: [Option<u32>; 4],
    table: &DeclarationTable,
    clock: ClockConfiguration,
) -> (u64, Vec<String>) {
    let names = ["first", "second"];
    let functions: Vec<_> =
        (0..).zip(code).map(|(n, code)| (names[n], FLASH + 0x100 * n as u32, *code)).collect();
    let (image, source) = (FirmwareImage::from_code(&functions), SourceCode::new(".".into()));
    let program = Program::new(&image, table, &source, CalibrationSizes::EMPTY);
    let entry = FunctionEntry { arguments, ..FunctionEntry::new(FLASH) };
    let cycles = WcetAnalysis::new(&program, clock, None).function_cycles(entry);
    (cycles, program.missing_flow_facts())
}

#[test]
fn a_loop_without_a_bound_is_named_unless_the_table_has_it() {
    let (_, problems) = worst(&[POLLS], &DeclarationTable::default(), SLOW);
    assert_eq!(problems.len(), 1, "{problems:?}");
    assert!(problems[0].starts_with("loop without a bound in first, at 0x8000000"), "{problems:?}");
    const DECLARED: &[LoopBound] = &[LoopBound {
        at: SourcePattern { function: "first", line: "" },
        rounds: IterationBound::AtMost(10),
        reason: "the unit answers within ten polls",
    }];
    let table = DeclarationTable { loops: DECLARED, ..DeclarationTable::default() };
    // Left behind its body alone, it goes back nine times: ten loads of 2 and a wait of 1, ten comparisons, ten branches, nine
    // refills of 3, and the way back.
    assert_eq!(worst(&[POLLS], &table, SLOW), (10 * (3 + 1 + 1) + 9 * 3 + 1, Vec::new()));
}

#[test]
fn loops_that_count_are_bounded_by_their_code() {
    let none = DeclarationTable::default();
    // 20 subtractions and branches, 19 of them taken.
    assert_eq!(worst(&[COUNTS], &none, SLOW), (1 + 20 * 2 + 19 * 3 + 1, vec![]));
    // The loop fits the cache: its line is read once, and one that was asked for ahead is waited for.
    assert_eq!(worst(&[COUNTS], &none, FAST), (1 + 2 * 5 + 20 * 2 + 19 * 3 + 1, vec![]));
    let inner = 1 + 5 * 2 + 4 * 3;
    assert_eq!(worst(&[NESTED], &none, SLOW), (1 + 3 * (inner + 2) + 2 * 3 + 1, vec![]));
    // Ten words up to an address that is 40 bytes behind an unknown one.
    assert_eq!(worst(&[POINTER], &none, SLOW), (1 + 10 * (3 + 1 + 1) + 9 * 3 + 1, vec![]));
}

/// Returns the worst case of a function whose loops are declared, with the length 40 as its third argument.
fn declared(code: &[u16], rounds: IterationBound) -> u64 {
    let at = SourcePattern { function: "first", line: "" };
    let loops = Box::leak(Box::new([LoopBound { at, rounds, reason: "of a test" }]));
    let table = DeclarationTable { loops, ..DeclarationTable::default() };
    let (cycles, problems) = worst_of(&[code], [None, None, Some(40), None], &table, SLOW);
    assert_eq!(problems, [""; 0]);
    cycles
}

#[test]
fn an_unrolled_loop_has_as_many_rounds_fewer() {
    let copied = IterationBound::PerStoredBytes { argument: 2, per: 4 };
    assert_eq!(
        declared(COPIES, copied),
        declared(COPIES, IterationBound::AtMost(5)),
        "two words a round"
    );
    assert_eq!(
        declared(POLLS, copied),
        declared(POLLS, IterationBound::AtMost(10)),
        "no store to count"
    );
    let length = IterationBound::Length { argument: 2, per: 4, more: 0 };
    assert_eq!(declared(COPIES, length), declared(COPIES, IterationBound::AtMost(10)));
    assert_eq!(
        declared(HALVES, IterationBound::Mask(32)),
        declared(HALVES, IterationBound::AtMost(8))
    );
    assert_eq!(
        declared(POLLS, IterationBound::Mask(32)),
        declared(POLLS, IterationBound::AtMost(32))
    );
}

#[test]
fn a_loop_with_two_headers_that_is_one_has_its_rounds_once() {
    // From the outer header a load of 2 and a wait of 1, the same once more and four instructions, the refill of 3; at the end the
    // same without it, and the way back.
    let round = 3 + 3 + 4 + 3;
    assert_eq!(declared(THREADED, IterationBound::Together(20)), 20 * round + (round - 3) + 1);
    let nested = declared(THREADED, IterationBound::AtMost(20));
    assert!(nested > 10 * 20 * round, "{nested}: one within the other");
}

#[test]
fn calls_that_lead_nowhere_and_circles_are_named() {
    let (_, problems) = worst(&[BY_REGISTER, COUNTS], &DeclarationTable::default(), SLOW);
    assert!(problems[0].starts_with("call by register in first, at 0x8000002"), "{problems:?}");
    const DECLARED: &[CallTargets] = &[CallTargets {
        at: SourcePattern { function: "first", line: "" },
        functions: &["second"],
        reason: "its only caller says so",
    }];
    let table = DeclarationTable { calls: DECLARED, ..DeclarationTable::default() };
    // push 3, blx 1 and 3, what is called, back 3, pop 3.
    let counts = worst(&[COUNTS], &table, SLOW).0;
    assert_eq!(worst(&[BY_REGISTER, COUNTS], &table, SLOW), (3 + 1 + 3 + counts + 3 + 3, vec![]));
    let (_, problems) = worst(&[CIRCLE], &DeclarationTable::default(), SLOW);
    assert_eq!(problems, ["first never comes back"]);
}

#[test]
fn a_section_lasts_from_the_raised_mask_to_the_restored_one() {
    let of = |code| {
        let (image, source) =
            (FirmwareImage::from_code(&[("first", FLASH, code)]), SourceCode::new(".".into()));
        let table = DeclarationTable::default();
        let program = Program::new(&image, &table, &source, CalibrationSizes::EMPTY);
        let worst = WcetAnalysis::new(&program, SLOW, None);
        let entry = FunctionEntry::new(FLASH);
        let sections = CriticalSectionAnalysis::new(&program, &worst)
            .find_critical_sections_in_call_tree(entry);
        assert!(program.missing_flow_facts().is_empty(), "{:?}", program.missing_flow_facts());
        sections.iter().map(|section| (section.ceiling, section.cycles)).collect::<Vec<_>>()
    };
    // The write of the mask, the load, the sum, the store, the number, the write back; 0xC0 is the priority 4.
    assert_eq!(of(LOCKED), [(Some(4), 2 + 3 + 1 + 3 + 1 + 2)]);
    assert_eq!(of(MASKED), [(None, 2 + 3 + 2)]);
}
