"""What moving each threshold of the finder by a fifth changes on the measured sets.

    TRUEUP_DATA=… python3 host-tests/python/thresholds.py [NAME…]

A copy of the project is made below target/thresholds in which each number that docs/thresholds.md names with its
file is asked of the environment; it is built once. The tests of measured sets then run with each number moved down
and up, and a line of a table is printed for each: which tests are red, and how much of the error on data that were not
fitted an answer leaves at the worst. Nothing of this is in a usual build.

A share near 1 is moved by a fifth of what it lacks of 1 (0.95: 0.94 to 0.96), a factor near 1 by a fifth of its
excess (1.05: 1.04 to 1.06), a whole number to the nearest one, by 1 at least, all numbers of a list at once. A whole
number that is the length of an array, or part of another constant, is told and not moved.
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
# An answer is harmful where what it hands out leaves more than 5 % more than the machine file alone.
HARM = 1.05
CRATES = ("diagnose", "machine", "numerics")
DEFINED = r"^([ \t]*)(pub(?:\([a-z]+\))? )?const {name}: (f64|usize|\[f64; \d+\]) = ([^;]+);"
NUMBER = r"[0-9_.e+-]+"
HOOK = """
/// `value`, or by how much TRUEUP_THRESHOLD (name=number in its place,number…) says.
#[must_use]
pub fn moved<const N: usize>(name: &str, value: [f64; N]) -> [f64; N] {
    let asked = std::env::var("TRUEUP_THRESHOLD").unwrap_or_default();
    let Some((_, asked)) = asked.split_once('=').filter(|(there, _)| *there == name) else { return value };
    let mut asked = asked.split(',').filter_map(|number| number.parse().ok());
    value.map(|value| asked.next().unwrap_or(value))
}
"""


class Threshold:
    """A number, or a list, of the table that has a name."""

    def __init__(self, name, path, kind, value):
        self.name, self.path, self.kind = name, path, kind
        self.values = [float(number.replace("_", "")) for number in re.findall(NUMBER, value)]
        self.key = f"{path.stem}::{name}"

    def moved(self, share):
        values = [moved_by(value, share) for value in self.values]
        if self.kind == "usize":
            step = 1 if share > 0 else -1
            values = [max(round(new), old + 1) if step > 0 else min(round(new), old - 1)
                      for new, old in zip(values, self.values)]
        return values

    def body(self):
        """The function that stands in the place of the constant."""
        hook = f'crate::moved("{self.key}", {self.values!r})'
        kind, found = {"f64": ("f64", f"{hook}[0]"), "usize": ("usize", f"{hook}[0] as usize")}.get(
            self.kind, (self.kind, hook))
        return (
            r"\1#[allow(non_snake_case, missing_docs, clippy::must_use_candidate)]" + "\n"
            r"\1\2fn " + self.name + f"() -> {kind} {{\n"
            rf"\1    static VALUE: std::sync::LazyLock<{kind}> = std::sync::LazyLock::new(|| {found});" + "\n"
            r"\1    *VALUE" + "\n" + r"\1}"
        )


def listed():
    """Those of the table that are a number or a list of their own."""
    for row in (ROOT / "docs" / "thresholds.md").read_text().splitlines():
        where = row.split("|")[3] if row.count("|") > 4 else ""
        words = re.findall(r"`([^`]+)`", where)
        files = [word for word in words if word.endswith(".rs")]
        for name in (word for word in words if re.fullmatch(r"[A-Z][A-Z0-9_]+", word)):
            for file in files[:1]:
                path = next((it.relative_to(ROOT) for it in ROOT.glob(f"crates/*/{file}")), Path("crates/none/none") / file)
                if file.startswith("robust/"):
                    path = Path("crates/base/numerics/src") / file
                text = (ROOT / path).read_text() if (ROOT / path).is_file() else ""
                there = re.search(DEFINED.format(name=name), text, re.M)
                is_number = there and re.fullmatch(rf"\[?({NUMBER}(, )?)+\]?", there[4])
                of_the_finder = path.parts[2] in CRATES and (path.parts[2] != "machine" or "effect" in path.parts)
                if is_number and of_the_finder:
                    if is_part_of_a_type(name, path):
                        print(f"not moved: {name} of {path}", file=sys.stderr)
                    else:
                        yield Threshold(name, path, there[3], there[4])


def is_part_of_a_type(name, path):
    """Whether the compiler has to know this number: the length of an array, part of a constant or of a text."""
    word = rf"(?<![\w`]){name}(?![\w`(])"
    of_type = re.compile(rf"; [^\]]*{word}[^\]]*\]|const (?!{name}\b).*{word}|{{{name}}}")
    for file in (ROOT / Path(*path.parts[:3]) / "src").rglob("*.rs"):
        text = file.read_text()
        is_here = file == ROOT / path or re.search(rf"use [^;]*\b{path.stem}\b[^;]*{word}", text)
        if is_here and any(of_type.search(re.sub(r"vec!\[[^\]]*\]", "", line)) for line in text.splitlines()):
            return True
    return False


def ask_the_environment(threshold, is_alone):
    """The constant of this name is a function in the copy, and is called wherever it was read; `is_alone`: no
    other has its name."""
    name, path = threshold.name, threshold.path
    word = re.compile(rf"(?<![\w`]){name}(?![\w`(])")
    for file in sorted((COPY / Path(*path.parts[:3]) / "src").rglob("*.rs")):
        text = file.read_text()
        is_own = file == COPY / path
        imports = re.findall(r"^\s*(?:pub(?:\([a-z]+\))? )?use [^;]+;", text, re.M)
        if not is_own and not any((is_alone or path.stem in it) and word.search(it) for it in imports):
            continue
        text = re.sub(DEFINED.format(name=name), threshold.body(), text, flags=re.M) if is_own else text
        used, in_use = [], False
        for line in text.splitlines(keepends=True):
            in_use = in_use or bool(re.match(r"\s*(pub(\([a-z]+\))? )?use ", line))
            is_code = not in_use and not re.match(r"\s*//|.*fn " + name + r"\(\)", line)
            # In a text no name can be called.
            is_code = is_code and f'::{name}"' not in line and f"{{{name}}}" not in line
            used.append(word.sub(name + "()", line) if is_code else line)
            in_use = in_use and ";" not in line
        file.write_text("".join(used))


def build(thresholds):
    """The copy's test programs; nothing that was built for it before is built again."""
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True)
    for file in files.stdout.splitlines():
        there = COPY / file
        there.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / file).is_file():
            shutil.copy2(ROOT / file, there)
    names = [it.name for it in thresholds]
    for it in thresholds:
        ask_the_environment(it, names.count(it.name) == 1)
    for crate in CRATES:
        hook = next(COPY.glob(f"crates/*/{crate}/src/lib.rs"))
        hook.write_text(hook.read_text() + HOOK)
    command = ["cargo", "test", "--release", "--no-run", "--message-format=json-render-diagnostics", "-p", "trueup-diagnose"]
    for test in TESTS:
        command += ["--test", test]
    built = subprocess.run(command, cwd=COPY, check=True, stdout=subprocess.PIPE, text=True)
    lines = [json.loads(line) for line in built.stdout.splitlines()]
    programs = [line["executable"] for line in lines if line.get("executable") and line["target"]["kind"] == ["test"]]
    return programs


def tried(programs, moved=""):
    """Names of the tests that fail with this number moved, and the most that what an answer hands out leaves of data
    that were not fitted, over what the machine file alone leaves."""
    failed, worst = [], 0.0
    for program in programs:
        env = {**os.environ, "TRUEUP_THRESHOLD": moved}
        command = [program, "--show-output"]
        told = subprocess.run(command, cwd=COPY / "crates/analysis/diagnose", env=env, capture_output=True, text=True)
        if SKIPPED.search(told.stdout):
            sys.exit("the measured sets are missing: see docs/measured-data.md")
        failed += re.findall(r"^test (\S+) \.\.\. FAILED", told.stdout, re.M)
        left = re.findall(r"not fitted to ([\d.]+) -> [\d.]+ µm, handed out ([\d.]+)", told.stdout)
        worst = max([worst, *(float(after) / float(before) for before, after in left)])
    return failed, worst


def moved_by(value, share):
    if 0.5 < value < 1.0:
        return 1.0 - (1.0 - value) * (1.0 - share)
    if 1.0 < value < 1.5:
        return 1.0 + (value - 1.0) * (1.0 + share)
    return value * (1.0 + share)


def written(values):
    return ", ".join(f"{value:.4g}" for value in values)


def main():
    named = {it.key: it for it in listed() if len(sys.argv) == 1 or it.name in sys.argv}
    thresholds = list(named.values())
    programs = build(thresholds)
    before, worst = tried(programs)
    print(f"{len(thresholds)} thresholds; red as they are: {', '.join(before) or 'none'}; at the worst {worst:.3f} of the error before\n")
    print("| threshold | −20 % | +20 % |\n|---|---|---|")
    for it in thresholds:
        told = []
        for share in (-0.2, 0.2):
            values = it.moved(share)
            asked = f"{it.key}={','.join(repr(float(value)) for value in values)}"
            failed, worst = tried(programs, asked)
            changed = sorted(set(failed) ^ set(before))
            told.append(f"{written(values)}: {', '.join(changed) or 'nothing'}; {worst:.3f}{' HARM' if worst > HARM else ''}")
        print(f"| `{it.key}` {written(it.values)} | {told[0]} | {told[1]} |", flush=True)


if __name__ == "__main__":
    main()
