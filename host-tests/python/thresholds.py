"""What moving each threshold of the finder by a fifth changes on the measured sets.

    TRUEUP_DATA=… python3 host-tests/python/thresholds.py [NAME…]

A copy of the project is made below target/thresholds in which each number that docs/thresholds.md names with its
file is asked of the environment; it is built once. The tests of measured sets then run with each number moved down
and up, and a line of a table is printed for each: which tests are red. Nothing of this is in a usual build.

A share near 1 is moved by a fifth of what it lacks of 1 (0.95: 0.94 to 0.96), a factor near 1 by a fifth of its
excess (1.05: 1.04 to 1.06). What is no number of its own (a whole number, a rule) is not moved.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COPY = ROOT / "target" / "thresholds"
TESTS = ["measured", "tables", "hold_out", "claims"]
SKIPPED = re.compile(r"^skipped: ", re.M)
DEFINED = r"^([ \t]*)(pub(?:\([a-z]+\))? )?const {name}: f64 = ([^;]+);"
HOOK = """
/// `value`, or what TRUEUP_THRESHOLD (name=value) says in its place.
#[must_use]
pub fn moved(name: &str, value: f64) -> f64 {
    let asked = std::env::var("TRUEUP_THRESHOLD").unwrap_or_default();
    let asked = asked.split_once('=').filter(|(there, _)| *there == name);
    asked.and_then(|(_, value)| value.parse().ok()).unwrap_or(value)
}
"""


def listed():
    """Names and files of the table, those that are a number of their own."""
    for row in (ROOT / "docs" / "thresholds.md").read_text().splitlines():
        where = row.split("|")[3] if row.count("|") > 4 else ""
        words = re.findall(r"`([^`]+)`", where)
        files = [word for word in words if word.endswith(".rs")]
        for name in (word for word in words if re.fullmatch(r"[A-Z][A-Z0-9_]+", word)):
            for file in files[:1]:
                path = Path("crates") / file
                if file.startswith("robust/"):
                    path = Path("crates/numerics/src") / file
                text = (ROOT / path).read_text() if (ROOT / path).is_file() else ""
                there = re.search(DEFINED.format(name=name), text, re.M)
                is_number = there and re.fullmatch(r"[0-9_.e+-]+", there[3])
                if is_number and path.parts[1:3] in (("diagnose", "src"), ("numerics", "src")):
                    yield name, path, float(there[3].replace("_", ""))


def ask_the_environment(name, path, is_alone):
    """The constant of this name is a function in the copy, and is called wherever it was read; `is_alone`: no
    other has its name."""
    crate = "crate" if path.parts[1] == "numerics" else "trueup_numerics"
    key = f"{path.stem}::{name}"
    body = (
        r"\1#[allow(non_snake_case, missing_docs, clippy::must_use_candidate)]" + "\n"
        r"\1\2fn " + name + "() -> f64 {\n"
        r"\1    static VALUE: std::sync::LazyLock<f64> =" + "\n"
        r"\1        std::sync::LazyLock::new(|| " + crate + f'::moved("{key}", ' + r"\3));" + "\n"
        r"\1    *VALUE" + "\n" + r"\1}"
    )
    word = re.compile(rf"(?<![\w`]){name}(?![\w`(])")
    for file in sorted((COPY / "crates" / path.parts[1] / "src").rglob("*.rs")):
        text = file.read_text()
        is_own = file == COPY / path
        imports = re.findall(r"^\s*(?:pub(?:\([a-z]+\))? )?use [^;]+;", text, re.M)
        if not is_own and not any((is_alone or path.stem in it) and word.search(it) for it in imports):
            continue
        text = re.sub(DEFINED.format(name=name), body, text, flags=re.M) if is_own else text
        used, in_use = [], False
        for line in text.splitlines(keepends=True):
            in_use = in_use or bool(re.match(r"\s*(pub(\([a-z]+\))? )?use ", line))
            is_code = not in_use and not re.match(r"\s*//|.*fn " + name + r"\(\)", line)
            used.append(word.sub(name + "()", line) if is_code and f'::{name}"' not in line else line)
            in_use = in_use and ";" not in line
        file.write_text("".join(used))
    return key


def build(thresholds):
    """The copy's test programs; nothing that was built for it before is built again."""
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True)
    for file in files.stdout.splitlines():
        there = COPY / file
        there.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / file).is_file():
            shutil.copy2(ROOT / file, there)
    names = [name for name, _, _ in thresholds]
    keys = [ask_the_environment(name, path, names.count(name) == 1) for name, path, _ in thresholds]
    hook = COPY / "crates/numerics/src/lib.rs"
    hook.write_text(hook.read_text() + HOOK)
    command = ["cargo", "test", "--release", "--no-run", "--message-format=json-render-diagnostics", "-p", "trueup-diagnose"]
    for test in TESTS:
        command += ["--test", test]
    built = subprocess.run(command, cwd=COPY, check=True, stdout=subprocess.PIPE, text=True)
    lines = [json.loads(line) for line in built.stdout.splitlines()]
    programs = [line["executable"] for line in lines if line.get("executable") and line["target"]["kind"] == ["test"]]
    return keys, programs


def red(programs, moved=""):
    """Names of the tests that fail with this number moved."""
    failed = []
    for program in programs:
        env = {**os.environ, "TRUEUP_THRESHOLD": moved}
        command = [program, "--show-output"]
        told = subprocess.run(command, cwd=COPY / "crates/diagnose", env=env, capture_output=True, text=True)
        if SKIPPED.search(told.stdout):
            sys.exit("the measured sets are missing: see docs/measured-data.md")
        failed += re.findall(r"^test (\S+) \.\.\. FAILED", told.stdout, re.M)
    return failed


def moved_by(value, share):
    if 0.5 < value < 1.0:
        return 1.0 - (1.0 - value) * (1.0 - share)
    if 1.0 < value < 1.5:
        return 1.0 + (value - 1.0) * (1.0 + share)
    return value * (1.0 + share)


def main():
    thresholds = list(dict.fromkeys(it for it in listed() if len(sys.argv) == 1 or it[0] in sys.argv))
    keys, programs = build(thresholds)
    before = red(programs)
    print(f"{len(thresholds)} thresholds; red as they are: {', '.join(before) or 'none'}\n")
    print("| threshold | −20 % | +20 % |\n|---|---|---|")
    for key, (_, _, value) in zip(keys, thresholds):
        told = []
        for share in (-0.2, 0.2):
            number = moved_by(value, share)
            changed = sorted(set(red(programs, f"{key}={number!r}")) ^ set(before))
            told.append(f"{number:.4g}: {', '.join(changed) or 'nothing'}")
        print(f"| `{key}` {value:.4g} | {told[0]} | {told[1]} |", flush=True)


if __name__ == "__main__":
    main()
