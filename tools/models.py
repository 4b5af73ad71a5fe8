# SPDX-License-Identifier: Apache-2.0
"""Has SPIN check every model in models/: what is true holds in every state, and every broken twin is refuted.

A model says in its own text what is to be run:
    //: model -DWRITES=8                       the true one, with these constants; may be given several times
    //: twin THREE_SLOTS  disturbed  reason    with -DTWIN_THREE_SLOTS, where the claim `disturbed` must fail
    //: code FILE Class::function inline       the inline has the loads, stores and memory orders of this function

An inline that stands for code gives each acquire and release as ORDER(order, flag): with -Dflag it is relaxed. The flag
is TWIN_..., of a twin, or SPARE_..., of a //: model line (the claims hold without that order, too).
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from cpp_text import named_functions

ROOT = Path(__file__).parent.parent
LEAST_TWINS = 2
MEMORY_MB = 2000  # of one run
DEPTH = 1_000_000
TIMEOUT_S = 300
ORDER = re.compile(r"^//: (model|twin|code)\b *(.*)$", re.M)
INCLUDE = re.compile(r'^#include "([\w.]+)"', re.M)
CODE_FILE = re.compile(r"\b(?:spine|supervisor|lawd)/[\w/]+\.[ch]pp\b")
FLAG = re.compile(r"\b(?:TWIN|SPARE)_\w+")
# An access to an atomic object, and its memory order, in C++ and in a model.
ACCESS = r"\b(?:atomic_(?:thread_)?)?(load|store|fence|exchange|compare_exchange)(?:_\w+)?\s*\("
IN_CPP = re.compile(rf"{ACCESS}|\bmemory_order(?:_|::)(\w+)")
IN_MODEL = re.compile(rf"{ACCESS}|\b(relaxed|acquire|release|acq_rel|seq_cst)\b")
INLINE = re.compile(r"^inline (\w+)\([^)]*\) *\{\n(.*?)^\}", re.M | re.S)
# What a thread reads of its own stores has no order to weaken.
HAS_A_FLAG = re.compile(r"\bORDER\(\w+, (?:TWIN|SPARE)_\w+\)|\bload_own\([^;]*|/\*.*?\*/", re.S)
# Whatever else SPIN says, one of these means that it has not seen every state.
INCOMPLETE = ("max search depth too small", "Search not completed", "out of memory", "interrupted", "Bit statespace")


@dataclass(frozen=True)
class Run:
    """One search by SPIN: of the true model when `claim` is empty, else of a twin that must break that claim."""

    model: Path
    name: str
    defines: tuple[str, ...]
    claim: str = ""


@dataclass(frozen=True)
class Outcome:
    """What a search came to; `problem` is empty when it came to what it should."""

    run: Run
    problem: str
    states: int
    depth: int
    seconds: float
    said: str


class ModelError(Exception):
    """A model that cannot be run as it stands."""


def text_of(model: Path) -> str:
    """The text of a model and of what it includes."""
    text = model.read_text()
    return text + "".join((model.parent / name).read_text() for name in INCLUDE.findall(text))


def runs_of(model: Path) -> Iterator[Run]:
    """All runs that a model asks for. Its flags in these lines and those in its code must be the same."""
    own, text = model.read_text(), text_of(model)
    twins: list[str] = []
    true_ones = 0
    for kind, rest in ORDER.findall(own):
        words = shlex.split(rest) if kind == "model" else rest.split()
        if kind == "model":
            true_ones += 1
            yield Run(model, " ".join(["model", *words]), tuple(words))
        elif kind == "twin" and len(words) < 3:
            raise ModelError(f"{model.name}: a twin needs NAME, claim and what is broken, but has '{rest}'")
        elif kind == "twin":
            twins.append(words[0])
            yield Run(model, words[0], (f"-DTWIN_{words[0]}",), words[1])
    if true_ones == 0:
        raise ModelError(f"{model.name}: no line '//: model': nothing would be proved")
    if len(twins) < LEAST_TWINS:
        raise ModelError(
            f"{model.name}: {len(twins)} twins, {LEAST_TWINS} at least: a model that cannot fail says nothing"
        )
    if gone := [name for name in CODE_FILE.findall(text) if not (ROOT / name).is_file()]:
        raise ModelError(f"{model.name}: stands for files that are gone: {', '.join(gone)}")
    asked = asked_flags(own)
    if odd := (flags_of(own) - asked) | (asked - flags_of(text)):
        raise ModelError(f"{model.name}: in the code or in the table only: {', '.join(sorted(odd))}")
    if problems := list(out_of_step(model)):
        raise ModelError("\n".join(f"{model.name}: {problem}" for problem in problems))


def flags_of(text: str) -> set[str]:
    """What can be broken or weakened in this text."""
    return set(FLAG.findall(ORDER.sub("", text)))


def asked_flags(text: str) -> set[str]:
    """What the lines of a model break or weaken."""
    table = ORDER.findall(text)
    named = {f"TWIN_{rest.split()[0]}" for kind, rest in table if kind == "twin"}
    return named | {flag for kind, rest in table if kind == "model" for flag in FLAG.findall(rest.replace("-D", " "))}


def accesses(pattern: re.Pattern[str], text: str) -> list[str]:
    """The accesses to atomic objects in this text, and their orders."""
    return [access or order for access, order in pattern.findall(text)]


def out_of_step(model: Path) -> Iterator[str]:
    """Where a model's inlines differ from the C++ functions they stand for; and orders without a flag."""
    raw = text_of(model)
    stands_for = [rest.split() for kind, rest in ORDER.findall(raw) if kind == "code"]
    if not stands_for:
        return
    code, without_twins = say(["cc", "-E", "-P", "-x", "c", str(model.resolve())], ".")
    if code != 0:
        yield f"cc cannot read it: {without_twins}"
    inlines, unweakened = dict(INLINE.findall(without_twins)), dict(INLINE.findall(raw))
    for file in sorted({file for file, _, _ in stands_for}):
        functions: dict[str, str] = {}
        for name, body in named_functions((ROOT / file).read_text()):
            functions[name] = functions.get(name, "") + body
        pairs = {function: inline for where, function, inline in stands_for if where == file}
        for function, inline in pairs.items():
            there, here = accesses(IN_CPP, functions.get(function, "")), accesses(IN_MODEL, inlines.get(inline, ""))
            if there != here or not there:
                yield f"{inline} is '{' '.join(here)}', but {function} in {file} is '{' '.join(there)}'"
            if re.search(r"\b(acquire|release)\b", HAS_A_FLAG.sub("", unweakened.get(inline, ""))):
                yield f"{inline}: an order that nothing weakens; write ORDER(order, TWIN_...) or SPARE_..."
        for function in sorted(functions.keys() - pairs.keys()):
            if "memory_order_" in functions[function]:
                yield f"{function} in {file} has memory orders, but no line '//: code'"


def broken_claim(said: str) -> str:
    """The claim that a search found broken; empty when it found no error."""
    if "invalid end state" in said.split("(Spin Version")[0]:
        return "endstate"
    if match := re.search(r"assertion violated \(*(\w+)\|\|", said):
        return match[1]
    return "" if re.search(r"errors: 0\b", said) else "unknown"


def judge(run: Run, said: str) -> str:
    """What is wrong with what SPIN said about this run; empty when nothing is."""
    broken = broken_claim(said)
    if run.claim:
        if broken == run.claim:
            return ""
        return f"is broken in '{broken}', not in '{run.claim}'" if broken else "is not refuted"
    if broken:
        return f"the claim '{broken}' does not hold"
    if cut := next((words for words in INCOMPLETE if words in said), None):
        return f"not every state was seen: {cut}"
    if "Full statespace search" not in said:
        return "SPIN did not finish"
    # What is never reached proves nothing. A process that runs for ever does not reach its end, and not every model
    # needs all that a shared file offers.
    lines = re.findall(rf"^\t(.*\b{re.escape(run.model.name)}:.*, state \d+, .*)$", said, re.M)
    if idle := [line.strip() for line in lines if '"-end-"' not in line]:
        return "never reached: " + "; ".join(idle)
    return ""


def number(pattern: str, said: str) -> int:
    """The number that SPIN printed there, 0 when it did not."""
    match = re.search(pattern, said)
    return int(float(match[1])) if match else 0


def commands(run: Run, *options: str) -> list[list[str]]:
    """The commands of one search: model to C, C to checker, checker."""
    # A true model is searched to its end: there the optimiser earns back its time.
    level = "-O0" if run.claim else "-O2"
    return [
        ["spin", *run.defines, "-a", str(run.model.resolve())],
        ["cc", level, "-w", "-DSAFETY", f"-DMEMLIM={MEMORY_MB}", *options, "-o", "pan", "pan.c"],
        ["./pan", f"-m{DEPTH}", "-w22"],
    ]


def say(command: list[str], folder: str) -> tuple[int, str]:
    """Exit code and words of a command; a command that takes too long has failed."""
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return 1, f"{command[0]}: took over {TIMEOUT_S} s\n"
    return done.returncode, done.stdout + done.stderr


def search(run: Run) -> Outcome:
    """Build the checker for one run, let it search, judge what it says."""
    started = time.monotonic()
    *builds, checker = commands(run)
    with tempfile.TemporaryDirectory(prefix="lithe-model-") as folder:
        for build in builds:
            code, said = say(build, folder)
            if code != 0:
                return Outcome(run, f"{build[0]} failed", 0, 0, time.monotonic() - started, said)
        _, said = say(checker, folder)
    return Outcome(
        run,
        judge(run, said),
        number(r"([\d.e+]+) states, stored", said),
        number(r"depth reached (\d+)", said),
        time.monotonic() - started,
        said,
    )


def trace(run: Run) -> str:
    """The shortest way to what is wrong in this run, statement by statement."""
    with tempfile.TemporaryDirectory(prefix="lithe-model-") as folder:
        for command in commands(run, "-DBFS"):
            _, said = say(command, folder)
        trail = next(Path(folder).glob("*.trail"), None)
        if trail is None:
            return f"{run.name}: nothing is wrong, or nothing was found\n{said}"
        return say(["spin", *run.defines, "-p", "-g", "-k", str(trail), str(run.model.resolve())], folder)[1]


def check(models: list[Path], jobs: int) -> int:
    """Run everything, print a line each, and say whether all came out as it should."""
    try:
        runs = [run for model in models for run in runs_of(model)]
    except ModelError as error:
        print(error)
        return 1
    started = time.monotonic()
    runs.sort(key=lambda run: run.claim != "")  # the true ones first: they take longest
    outcomes: list[Outcome] = []
    with ThreadPoolExecutor(jobs) as pool:
        for outcome in pool.map(search, runs):
            outcomes.append(outcome)
            verdict = "FAIL" if outcome.problem else "ok  "
            finding = outcome.problem or (f"refuted: {outcome.run.claim}" if outcome.run.claim else "holds")
            print(
                f"{verdict} {outcome.run.model.stem:<9} {outcome.run.name:<28} {outcome.states:>9} states"
                f" {outcome.depth:>7} deep {outcome.seconds:6.1f} s  {finding}",
                flush=True,
            )
            if outcome.problem:
                print(outcome.said[-4000:], end="")
    failed = sum(1 for outcome in outcomes if outcome.problem)
    twins = sum(1 for run in runs if run.claim)
    print(
        f"models: {len(runs) - twins} searches and {twins} twins of {len(models)} models,"
        f" {sum(outcome.states for outcome in outcomes)} states, {time.monotonic() - started:.1f} s, {failed} failed"
    )
    return 1 if failed or not runs else 0


def main() -> int:
    """Check the named models, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", type=Path, metavar="FILE", help="default: models/*.pml")
    parser.add_argument("--trace", metavar="RUN", help="a twin, or 'model': show how its claim is broken")
    parser.add_argument("-j", "--jobs", type=int, default=len(os.sched_getaffinity(0)))
    args = parser.parse_args()
    models = args.models or sorted(ROOT.glob("models/*.pml"))
    if args.trace:
        for run in [run for model in models for run in runs_of(model) if run.name.split()[0] == args.trace]:
            print(trace(run))
        return 0
    return check(models, args.jobs)


if __name__ == "__main__":
    sys.exit(main())
