"""The measured sets cut otherwise than their README does: is an answer ever harmful on what was left out?

    TRUEUP_DATA=… python3 host-tests/python/other_splits.py TRUEUP [PART OF A NAME]

TRUEUP is the tool's program. Every choice of cycles of the sets by ISO 230-2, one direction alone, every second target;
beginnings of the rods, the spindle and the gantry machine; each of its runs against each other one, with four machine
files. An answer is harmful where it ends with 0 and what the board would correct leaves the hold-out more than 5 %
worse than the machine file alone. And is what `held_out` promises kept, where the inputs of the hold-out lie within
`ranges`? Of the sets by ISO 230-2 that is asked once more without the readings that the tool excludes as outliers where it
has all cycles: no promise is for a reading that is none. A line for each, tab-separated; then the counts. Ends with 1 if
one was harmful.
"""

import collections
import csv
import itertools
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("TRUEUP_DATA", ROOT.parent / "shared" / "data"))
HEAD = '[machine]\nname = "m"\nkind = "3-axis"\n'
FRAME = '[axis.z.thermal]\nmode = "constant"\nsensor = "temp_frame_c"\nreference_c = 21.905\nconstant_um_per_c = -16.5\n'
HARM = 1.05
TOO_GOOD = 0.10


def write(path, head, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])


class Splits:
    """The cases, whose parts of files are written into `folder`, and of each set the readings that are none."""

    def __init__(self, trueup, folder):
        self.trueup = trueup
        self.folder = Path(folder)
        self.cases = []
        self.outliers = {}

    def read(self, path):
        with open(DATA / path, newline="") as file:
            head, *rows = csv.reader(file)
        return head, rows

    def machine(self, name, text):
        path = self.folder / f"{name}.toml"
        path.write_text(text)
        return path

    def cut(self, name, machine, head, rows, is_fitted):
        """A case: of the rows, which are numbered, those that are fitted, and the rest."""
        paths = []
        for wanted, end in ((True, ""), (False, "-holdout")):
            path = self.folder / f"{name}{end}.csv"
            write(path, head, [row for n, row in enumerate(rows) if is_fitted(n, row) == wanted])
            paths.append(path)
        self.cases.append((name, machine, *paths))

    def outliers_of(self, name, machine, head, rows):
        """The rows that the tool excludes where it has all of them."""
        path = self.folder / f"{name}-whole.csv"
        write(path, head, rows)
        out = self.folder / f"{name}-whole"
        command = [self.trueup, "diagnose", "--machine", machine, "--run", path, "--out", out]
        subprocess.run(command, capture_output=True, timeout=1800)
        found = json.loads((out / "diagnosis.json").read_text())["findings"]
        evidence = " ".join(text for it in found if it["cause"] == "outliers" for text in it["evidence"])
        numbers = re.search(r"Excluded as outliers: rows? ([\d, ]+)\.", evidence)
        return [rows[int(number) - 1] for number in numbers[1].split(", ")] if numbers else []

    def cycles(self, name, head, rows):
        """Cycles, directions and targets of a set by ISO 230-2."""
        machine = self.machine("nothing", HEAD)
        self.outliers[name] = self.outliers_of(name, machine, head, rows)
        run = head.index("run")
        cycles = sorted({row[run] for row in rows}, key=float)
        for size in (3, 2):
            for some in itertools.combinations(cycles, size):
                tag = "".join(cycle.split(".")[0] for cycle in some)
                self.cut(f"{name}-{tag}", machine, head, rows, lambda n, row, some=some: row[run] in some)
        way = next(n for n, column in enumerate(head) if column.startswith("dir_"))
        for sign in (1, -1):
            one_way = [row for row in rows if float(row[way]) == sign]
            for some in (cycles[:3], cycles[2:]):
                name_of = f"{name}-way{sign:+}-{some[0]}"
                self.cut(name_of, machine, head, one_way, lambda n, row, some=some: row[run] in some)
        at = next(n for n, column in enumerate(head) if column[1:] == "_mm")
        places = sorted({float(row[at]) for row in rows})
        for odd in (0, 1):
            some = set(places[odd::2])
            self.cut(f"{name}-targets{odd}", machine, head, rows, lambda n, row, some=some: float(row[at]) in some)

    def beginnings(self, name, machine, head, rows, shares):
        for share in shares:
            count = int(len(rows) * share)
            self.cut(f"{name}-{share}", machine, head, rows, lambda n, row, count=count: n < count)

    def all(self):
        for name in ("mcu1025", "muts_z", "b02_x"):
            head, rows = self.read(f"strangers/{name}/train.csv")
            self.cycles(name, head, rows + self.read(f"strangers/{name}/test.csv")[1])
        for name in ("x", "z", "muts_x"):
            self.cycles(f"iso-{name}", *self.read(f"ess_iso230/{name}.csv"))
        nothing = self.machine("nothing", HEAD)
        head, rows = self.read("strangers/b02_x/continuous.csv")
        self.cut("b02_x-there", nothing, head, rows, lambda n, row: n < 80)
        self.cut("b02_x-back", nothing, head, rows, lambda n, row: n >= 80)
        for name in ("aluminium", "brass", "copper"):
            head, rows = self.read(f"strangers/rods/{name}_1s.csv")
            machine = DATA / f"strangers/rods/{name}.toml"
            self.beginnings(f"rod-{name}", machine, head, rows, (0.4, 0.5, 0.6, 0.75))
            self.cut(f"rod-{name}-even", machine, head, rows, lambda n, row: n % 2 == 0)
        runs = {"heat": "strangers/voron_run2/run2_heat.csv", "cool": "strangers/voron_run2/run2_cool.csv"}
        runs |= {n: f"voron_frame_expansion/run{n}.csv" for n in "134"}
        files = {m: DATA / f"strangers/voron_run2/{m}.toml" for m in ("m0", "m1", "m2")}
        files["frame"] = self.machine("frame", HEAD + FRAME)
        for one, other in itertools.permutations(runs, 2):
            for believed, machine in files.items():
                self.cases.append((f"gantry-{one}-{other}-{believed}", machine, DATA / runs[one], DATA / runs[other]))
        for run in "134":
            for believed in ("m0", "frame"):
                head, rows = self.read(runs[run])
                self.beginnings(f"gantry-{run}-{believed}", files[believed], head, rows, (0.3, 0.5, 0.7))
        head, rows = self.read("spindle_sjtu/run.csv")
        for sensor, k in (("t0", 1.33), ("t12", 1.3), ("t5", 1.0)):
            source = f'sensor = "temp_{sensor}_c"\nreference_c = {rows[0][head.index(f"temp_{sensor}_c")]}\n'
            text = f'{HEAD}[spindle]\nsource = "temperature"\n[spindle.temperature]\n{source}k_um_per_c = {k}\n'
            machine = self.machine(sensor, text)
            for count in (1000, 1500, 2000, 3000, 4000):
                self.cut(f"spindle-{sensor}-{count}", machine, head, rows, lambda n, row, c=count: n < c)
            self.cut(f"spindle-{sensor}-end", machine, head, rows, lambda n, row: n >= 2000)
        return self.cases


def answer(trueup, folder, case):
    """Name, how the tool ended, verdict, hold-out before and after in µm, the promise, and what was found."""
    name, machine, run, holdout = case
    out = Path(folder) / name
    files = ["--machine", machine, "--run", run, "--holdout", holdout, "--out", out]
    ended = subprocess.run([trueup, "diagnose", *files], capture_output=True, text=True, timeout=1800)
    if ended.returncode not in (0, 3):
        return name, ended.returncode, "error", 0.0, 0.0, None, ended.stderr.strip().splitlines()[0]
    told = json.loads((out / "diagnosis.json").read_text())
    before, after = told["before"]["holdout_rms_um"], told["after"]["compensated_holdout_rms_um"]
    claim = {True: "{}", False: "({})"}
    found = " ".join(claim[it["claimed"]].format(it["cause"]) for it in told["findings"])
    promise = told.get("held_out")
    if promise:
        promise["inside"] = is_inside(promise["ranges"], holdout)
    return name, ended.returncode, told["verdict"], before, after, promise, found


def without(outliers, case):
    """The same case, its hold-out without some readings; none where it has none of them."""
    name, machine, run, holdout = case
    with open(holdout, newline="") as file:
        head, *rows = csv.reader(file)
    of_set = next((rows for of, rows in outliers.items() if name.startswith(f"{of}-")), [])
    kept = [row for row in rows if row not in of_set]
    path = holdout.with_name(f"{name}-holdout-kept.csv")
    write(path, head, kept)
    return (f"{name}-kept", machine, run, path) if len(kept) < len(rows) else None


def is_inside(ranges, path):
    """Whether the inputs of a hold-out lie within the ranges."""
    with open(path, newline="") as file:
        head, *rows = csv.reader(file)
    for column, (low, high) in ranges.items():
        if column in head:
            at = head.index(column)
            values = [float(row[at]) for row in rows if row[at] not in ("", "nan")]
            if values and (min(values) < low or max(values) > high):
                return False
    return True


def report(what, promised):
    """Prints how often the promises were kept."""
    of_all = collections.Counter(name.split("-")[0] for name in promised)
    kept = collections.Counter(name.split("-")[0] for name, (floor, _, came) in promised.items() if came >= floor)
    below = statistics.median(came - max(floor, 0) for floor, _, came in promised.values())
    too_good = sum(expected > came + TOO_GOOD for _, expected, came in promised.values())
    print(f"{what}: {len(promised)}; the floor kept in {kept.total()} ({kept.total() / len(promised):.1%}), at the median "
          f"{below:.2f} below what came; expected more than {TOO_GOOD:.2f} too good in {too_good} ({too_good / len(promised):.1%})")
    print("kept by set: " + ", ".join(f"{of} {kept[of]} of {count}" for of, count in of_all.items()))


def main():
    trueup, *part = sys.argv[1:]
    counts, harmful, helped, promised, kept = collections.Counter(), [], 0, {}, {}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as threads:
        splits = Splits(trueup, folder)
        cases = [case for case in splits.all() if not part or part[0] in case[0]]
        for it in threads.map(lambda case: answer(trueup, folder, case), cases):
            name, code, verdict, before, after, promise, found = it
            said = "nothing written"
            if promise:
                came, place = 1 - after / before, "inside" if promise["inside"] else "outside"
                floor, expected = promise["reduction_floor95"], promise["reduction"]
                said = f"floor {floor:.2f}, expected {expected:.2f}, came {came:.2f}, {place}"
                if promise["inside"]:
                    promised[name] = (floor, expected, came)
            print(f"{name}\t{code}\t{verdict}\t{before:.2f}\t{after:.2f}\t{said}\t{found}", flush=True)
            counts[verdict] += 1
            helped += verdict != "error" and after < 0.9 * before
            if code == 0 and after > HARM * before:
                harmful.append(name)
        fewer = {case[0]: without(splits.outliers, case) for case in cases if case[0] in promised}
        fewer = {name: case for name, case in fewer.items() if case}
        for name, it in zip(fewer, threads.map(lambda case: answer(trueup, folder, case), fewer.values())):
            kept[name] = (*promised[name][:2], 1 - it[4] / it[3])
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()))
    print(f"{sum(counts.values())} answers, {helped} leave at least a tenth less, {len(harmful)} harmful {harmful or ''}")
    if promised:
        report("promised inside the ranges", promised)
        report(f"the same, {len(kept)} hold-outs without readings that are none", promised | kept)
    return int(bool(harmful))


if __name__ == "__main__":
    sys.exit(main())
