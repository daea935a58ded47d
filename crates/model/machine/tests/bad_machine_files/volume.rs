//! Faults in `chain`, `[angular]`, `[rotary]` and `[tool]` that are refused.

use crate::{MACHINE, assert_refused};

#[test]
fn a_chain_is_checked() {
    let chain = |text: &str| format!("chain = \"{text}\"\n");
    let with_head =
        |text: &str| format!("kind = \"head-table\"\nhead_axes = [\"b\"]\nchain = \"{text}\"\n");
    assert_refused(
        MACHINE,
        &[
            (&chain("w X' b Y t"), "4:9", "machine.chain lacks Z"),
            (&chain("w X' b X Y Z t"), "4:9", "machine.chain has X twice"),
            (
                &chain("w b X Y Z"),
                "4:9",
                "must begin with w (workpiece), pass b (bed) and end with t",
            ),
            (&chain("t Z Y X b w"), "4:9", "must begin with w"),
            (&chain("w b X Y t Z"), "4:9", "must end with t, the tool"),
            (&chain(""), "4:9", "must begin with w"),
            (
                &chain("w X b Y Z t"),
                "4:9",
                "has X between w and b without ': it moves the workpiece, X'",
            ),
            (&chain("w b X' Y Z t"), "4:9", "has X' between b and t: it moves the tool, X"),
            (&chain("w X'' b Y Z t"), "4:9", "has ' without an axis before it"),
            (&chain("w b X Y U t"), "4:9", "has U, which is none of w, b, t, X, Y, Z, A, B, C"),
            (&chain("w b x Y Z t"), "4:9", "has x, which is none of"),
            (&chain("w b X Y Z (C t"), "4:9", "has ( without )"),
            (&chain("w b X Y Z A t"), "4:9", "turns the tool by [\"a\"], and head_axes is []"),
            (
                &chain("w C' b X Y Z t"),
                "4:9",
                "turns the workpiece by [\"c\"], which is not kind = \"3-axis\"",
            ),
            (&chain("w X' C' b Y Z t"), "4:9", "has a linear axis on a rotary one"),
        ],
    );
    assert_refused(
        "[machine]\nname = \"a\"\n",
        &[
            (&with_head("w A' C' b X Y Z B t"), "5:9", "turns the workpiece by [\"c\", \"a\"]"),
            (&with_head("w C' b X Y Z A t"), "5:9", "head_axes is [\"b\"]: they must be the same"),
            (
                "kind = \"lathe\"\nchain = \"w b X Y Z t\"\n",
                "4:9",
                "is not known for kind = \"lathe\"",
            ),
        ],
    );
}

#[test]
fn angles_and_lines_are_checked() {
    let chain = format!("{MACHINE}chain = \"w X' b Y Z t\"\n");
    assert_refused(
        &chain,
        &[
            (
                "[angular.eax]\n",
                "5:10",
                "an angle is urad_per_m, or order, knots_mm and control_urad",
            ),
            ("[angular.eax]\norder = 4\n", "5:10", "angular.eax.knots_mm is missing"),
            (
                "[angular.eax]\nurad_per_m = 1\norder = 4\n",
                "7:9",
                "must not stand next to urad_per_m",
            ),
            (
                "[angular.ecz]\norder = 2\nknots_mm = [0, 0, 1, 1]\ncontrol_urad = [1]\n",
                "8:16",
                "angular.ecz.control_urad has 1 elements",
            ),
            ("[angular.exx]\n", "5:10", "unknown key angular.exx; did you mean e"),
            ("[angular]\npoint_x_mm = [1, 2]\n", "6:14", "must have 3 elements, not 2"),
            (
                "[rotary.c]\nexoc_um = 1\n",
                "5:9",
                "rotary.c is not in machine.chain, \"w X' b Y Z t\"",
            ),
            ("[rotary.c]\nezoc_um = 1\n", "6:1", "unknown key rotary.c.ezoc_um"),
            ("[tool]\nlength_mm = -1\n", "6:13", "must not be negative"),
        ],
    );
    assert_refused(
        MACHINE,
        &[
            ("[angular.eax]\nurad_per_m = 1\n", "4:2", "angular needs machine.chain"),
            ("[rotary.c]\nexoc_um = 1\n", "4:2", "rotary needs machine.chain"),
        ],
    );
}
