"""Samples automatic mutants of the twin's device code; the black-box suite alone judges each.

A family of the suite judges the code of its own face: `mac_serial` with it that of the axis and of
motion, which the faces share; `mac_can` the CAN face and the module below it; `msc` and `mn400` all
of the controller.

A mutant is one small change of the source: a comparison or an operator replaced, a constant one
more or less, a condition negated, a statement left out.  Drawn are changes of code that the suite
has the default twins execute; the seed decides which, in an order that stays when code elsewhere
changes.  Outcomes:

- killed: a check has failed a requirement, by its own judgement.
- quirk: nothing failed, but the run names a reading of the manual that the default twin does not
  have.  The change makes that reading and the suite has told the difference: as good as killed.
- refused: the suite has said that this is no device of that model, and why, and judged no more.
- equivalent: nothing was seen, and somebody has read the change and written down why nothing of it
  can be seen (survivors.toml).
- survived: nothing was seen, and nobody knows why; also what was left inconclusive.
- crash, time-out: the twin raised an exception, or would not end.  That is no judgement, whatever
  was judged after it; these are counted apart, and others are drawn instead.

A run that was cut goes on where it was: what is known stands in build/mutants, one line each.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import copy
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "emulators" / "axistwin"
SUITE = ROOT / "conformance" / "axistwin_conformance"
JUDGE = ROOT / "scripts" / "mutate_judge.py"
KNOWN = ROOT / "build" / "mutants"
# What judges, one after the other, until something is said: model, behind a colon the address if
# it is not the model's own, level, and checks, if not all.
Stages = Sequence[tuple[str, str, Sequence[str]]]
FEW = 40  # checks: where more execute a line, the whole run is not much dearer
NICENESS = 10  # others may want to work on this machine
WAIT_S = 600  # of real time, however busy the machine is


@dataclass(frozen=True, slots=True)
class Family:
    """What is mutated for a family of the suite, and what judges it.

    `sources`: files of the twins, as patterns; `left_out`: how paths begin that are none of it;
    `survivors`: the table of what is not seen; `known`: how the files of what is known begin.
    """

    sources: tuple[str, ...]
    left_out: tuple[str, ...]
    stages: Stages
    survivors: Path
    known: str

    def paths(self, package: Path) -> list[str]:
        """The files to be mutated, relative to the package of the twins."""
        found = {
            str(path.relative_to(package))
            for pattern in self.sources
            for path in package.glob(pattern)
        }
        return sorted(path for path in found if not path.startswith(self.left_out))


TESTS = ROOT / "conformance" / "tests"
FAMILIES: Mapping[str, Family] = {
    "mac_serial": Family(
        (
            "devices/mac/axis/*.py",
            "devices/mac/serial/*.py",
            "devices/switches.py",
            "motion/*.py",
        ),
        # Words for people, of which nothing reaches the wire.
        ("devices/mac/serial/decode.py", "devices/mac/axis/command_words.py"),
        (("mac23", "quick", ()), ("mac23", "full", ()), ("mac34-1", "quick", ())),
        TESTS / "zoo" / "survivors.toml",
        "",
    ),
    "mac_can": Family(
        ("devices/mac/can/*.py", "devices/mac/axis/module.py"),
        ("devices/mac/can/decode.py",),
        (("mac23-can", "quick", ()), ("mac23-can", "full", ())),
        TESTS / "zoo_can" / "survivors.toml",
        "mac_can-",
    ),
    "msc": Family(
        ("devices/msc/*.py",),
        ("devices/msc/decode.py",),
        # A unit that is not number 1 is on RS-485.
        (("msc-250", "quick", ()), ("msc-250", "full", ()), ("msc-generic:6", "full", ())),
        TESTS / "zoo_msc" / "survivors.toml",
        "msc-",
    ),
    "mn400": Family(
        ("devices/mn400/*.py", "devices/mn400/link/*.py", "devices/mn400/motion/*.py"),
        ("devices/mn400/link/decode.py", "devices/mn400/controls.py", "devices/mn400/family.py"),
        (("mn400", "full", ()),),  # the quick run is nearly as dear and sees nothing beside
        TESTS / "zoo_mn400" / "survivors.toml",
        "mn400-",
    ),
}

UNJUDGED = ("crash", "time-out")
SEEN = ("killed", "quirk", "refused", "equivalent")

COMPARISONS: Mapping[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: Mapping[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Add,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.Pow: ast.Mult,
}
DROPPED = (ast.Assign, ast.AugAssign, ast.Expr, ast.Return)


@dataclass(frozen=True, slots=True)
class Mutation:
    """One change: the file, the line it begins on, both texts of the statement."""

    path: str
    line: int
    before: str
    after: str
    source: str = field(repr=False)  # the whole mutated file
    number: int = 1  # of the changes of this file that read alike
    checks: tuple[str, ...] = ()  # what executes the line

    @property
    def name(self) -> str:
        """What stays the same while lines above move."""
        often = f" ({self.number})" if self.number > 1 else ""
        return f"{self.path}: {self.before}  =>  {self.after}{often}"


# --- changes -------------------------------------------------------------------------------------


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """Every changed copy of one node, itself alone."""
    if isinstance(node, ast.Compare):
        for number, op in enumerate(node.ops):
            for other in COMPARISONS.get(type(op), ()):
                yield _with(node, ops=[*node.ops[:number], other(), *node.ops[number + 1 :]])
    elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
        yield _with(node, op=OPERATORS[type(node.op)]())
    elif isinstance(node, ast.Constant) and type(node.value) is int:
        for step in (1, -1):
            yield ast.Constant(node.value + step)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.BoolOp):
        yield _with(node, op=ast.And() if isinstance(node.op, ast.Or) else ast.Or())
    elif isinstance(node, ast.If | ast.While | ast.IfExp):
        yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    if isinstance(node, DROPPED) and not _says_nothing(node):
        yield ast.Return(ast.Constant(None)) if isinstance(node, ast.Return) else ast.Pass()


def _with(node: ast.AST, **fields: object) -> ast.AST:
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return other


def _says_nothing(node: ast.AST) -> bool:
    """A docstring, or a `return` of nothing: without it all is as it was."""
    value = getattr(node, "value", None)
    if isinstance(node, ast.Return):
        return value is None or (isinstance(value, ast.Constant) and value.value is None)
    return isinstance(node, ast.Expr) and isinstance(value, ast.Constant)


def mutations(package: Path, path: str) -> list[Mutation]:
    """Every mutation of the functions and tables of one file of a package."""
    text = (package / path).read_text(encoding="utf-8")
    tree = ast.parse(text)
    found: list[Mutation] = []
    alike = Counter[str]()
    for statement in _statements(tree):
        for site in _sites(statement):
            for instead in changed(site):
                for one in _applied(path, text, statement, site, instead):
                    alike[one.name] += 1
                    found.append(replace(one, number=alike[one.name]))
    return found


def _statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements; of compound ones the children follow by themselves."""
    for node in ast.walk(tree):
        is_plain = isinstance(node, ast.stmt) and not isinstance(
            node, ast.FunctionDef | ast.ClassDef | ast.Import | ast.ImportFrom | ast.Assert
        )
        if is_plain and not _says_nothing(node):
            assert isinstance(node, ast.stmt)
            yield node


def _sites(statement: ast.stmt) -> Iterator[ast.AST]:
    """The nodes of a statement that belong to no statement inside it, annotations left out."""
    yield statement
    waiting = [
        child
        for name, child in _children(statement)
        if not isinstance(child, ast.stmt) and name != "annotation"
    ]
    while waiting:
        node = waiting.pop(0)
        yield node
        waiting += [child for _, child in _children(node) if not isinstance(child, ast.stmt)]


def _children(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield name, child


class _Replace(ast.NodeTransformer):
    def __init__(self, site: ast.AST, instead: ast.AST) -> None:
        self._site, self._instead = site, instead

    def visit(self, node: ast.AST) -> ast.AST:
        """Put the other node in the place of the one site."""
        return self._instead if node is self._site else self.generic_visit(node)


def _applied(
    path: str, text: str, statement: ast.stmt, site: ast.AST, instead: ast.AST
) -> list[Mutation]:
    """The mutation as text: only the lines of the innermost piece are written anew."""
    where = site if isinstance(site, ast.stmt | ast.expr) else statement
    if isinstance(where, ast.If | ast.While):
        where = where.test
        instead = getattr(instead, "test", instead)
    lines = text.splitlines(keepends=True)
    first, last = where.lineno - 1, (where.end_lineno or where.lineno) - 1
    start = _column(lines[first], where.col_offset)
    end = _column(lines[last], where.end_col_offset or 0)
    piece = ast.unparse(ast.fix_missing_locations(instead))
    if isinstance(instead, ast.expr):
        piece = f"({piece})"
    before = "".join(lines[first : last + 1])
    after = lines[first][:start] + piece + lines[last][end:]
    source = "".join([*lines[:first], after, *lines[last + 1 :]])
    try:
        compile(source, path, "exec")
    except (SyntaxError, ValueError):
        return []
    told = " ".join(before.split()), " ".join(after.split())
    return [Mutation(path, first + 1, *told, source)]


def _column(line: str, offset: int) -> int:
    """A column of `ast`, which counts bytes, in characters."""
    return len(line.encode()[:offset].decode())


# --- the sample ----------------------------------------------------------------------------------


def reached_lines(folder: Path, family: Family) -> dict[str, dict[int, list[str]]]:
    """The lines that the suite has the default twins execute, each with the checks that do; the
    other lines are code of other readings of the manual, of other plants, or for panels, and no
    judgement of these twins can see them."""
    sources = [JUDGE, *sorted(folder.rglob("*.py"))]
    state = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
    kept = KNOWN / f"{family.known}reached-{state}.json"
    if not kept.is_file():
        package = folder / PACKAGE.name
        words = [json.dumps(family.stages), str(package), json.dumps(family.paths(package))]
        command = [sys.executable, str(JUDGE), "reach", *words]
        environment = {**os.environ, "PYTHONPATH": str(folder)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(done.stdout.splitlines()[-1], encoding="utf-8")
    table = json.loads(kept.read_text(encoding="utf-8"))
    return {
        name: {int(line): checks for line, checks in lines.items()} for name, lines in table.items()
    }


def sample(folder: Path, family: Family, seed: int) -> list[Mutation]:
    """All mutations of the code that the default twins execute, in the order of the seed."""
    package = folder / PACKAGE.name
    reached = reached_lines(folder, family)
    paths = family.paths(package)
    found = [one for path in paths for one in mutations(package, path)]
    seen = [
        replace(one, checks=tuple(reached[one.path][one.line]))
        for one in found
        if one.line in reached.get(one.path, ())
    ]
    print(f"{len(found)} mutations of {len(paths)} files, {len(seen)} of them reached", flush=True)
    return sorted(seen, key=lambda one: hashlib.sha256(f"{seed} {one.name}".encode()).digest())


# --- judging -------------------------------------------------------------------------------------


class Bench:
    """A copy of twins and suite, in which one mutation after the other is planted and judged."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def judge(self, mutation: Mutation | None, stages: Stages) -> dict[str, Any]:
        """Return what the stages say about a mutation, or about the healthy twins."""
        if mutation is None:
            return self._run(stages)
        path = self._folder / PACKAGE.name / mutation.path
        healthy = path.read_bytes()
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            compiled.unlink()  # it is told from a stale one by the second and the size only
        path.write_text(mutation.source, encoding="utf-8")
        try:
            return self._run([*_first(mutation, stages), *stages]) | {"stages": len(stages)}
        finally:
            path.write_bytes(healthy)

    def _run(self, stages: Stages) -> dict[str, Any]:
        command = [sys.executable, str(JUDGE), "judge"]
        environment = {
            **os.environ, "PYTHONPATH": str(self._folder), "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        try:
            done = subprocess.run(
                [*command, json.dumps(stages)], cwd=self._folder, env=environment,
                capture_output=True, text=True, timeout=WAIT_S, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return {"outcome": "time-out"}
        if done.stdout:
            said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
            return said
        if done.returncode < 0:
            return {"outcome": "time-out"}
        return {"outcome": "crash", "text": done.stderr.strip().splitlines()[-1]}


def _first(mutation: Mutation, stages: Stages) -> Stages:
    """The checks that execute the line of a mutation, if they are few: one of them kills it as a
    rule, at a small part of the price of a whole run."""
    is_worth_it = stages and 0 < len(mutation.checks) <= FEW
    return [(stages[0][0], "full", mutation.checks)] if is_worth_it else []


def copy_sources(folder: Path) -> Path:
    """Copy twins and suite, as they are now: a run must not see them change."""
    for package in (PACKAGE, SUITE):
        pattern = shutil.ignore_patterns("__pycache__")
        shutil.copytree(package, folder / package.name, ignore=pattern)
    compileall.compile_dir(folder, quiet=2)
    return folder


def outcome_of(said: Mapping[str, Any], reason: str) -> str:
    """What an opinion counts as (see the top)."""
    outcome = str(said["outcome"])
    if outcome in ("killed", "refused", *UNJUDGED):
        return outcome
    if said.get("readings"):
        return "quirk"
    return "equivalent" if reason else "survived"


class Sampler:
    """Judges the sample, mutation after mutation, and remembers what came of each."""

    def __init__(self, family: Family, seed: int, reasons: Mapping[str, str]) -> None:
        self._path = KNOWN / f"{family.known}seed-{seed}.jsonl"
        self._stages = family.stages
        self._reasons = reasons
        self._lock = Lock()
        self.said: dict[str, dict[str, Any]] = {}
        if self._path.is_file():
            for line in self._path.read_text(encoding="utf-8").splitlines():
                one = json.loads(line)
                self.said[one["mutation"]] = one

    def outcome(self, mutation: Mutation) -> str:
        """What came of it; empty if it has not been judged."""
        said = self.said.get(mutation.name)
        return outcome_of(said, self._reasons.get(mutation.name, "")) if said else ""

    def needs(self, mutation: Mutation, stages: Stages) -> Stages:
        """What it still has to be judged by: what passes the first stage, and is not explained,
        by the others as well; nothing if all is known."""
        outcome = self.outcome(mutation)
        if not outcome:
            return self._stages[:1] if mutation.name in self._reasons else stages
        done = self.said[mutation.name].get("stages", len(self._stages))
        return stages if outcome == "survived" and done < len(stages) else ()

    def forget(self, outcomes: Sequence[str], chosen: Sequence[Mutation]) -> None:
        """Let all that came out like this be judged again."""
        for one in chosen:
            if self.outcome(one) in outcomes:
                del self.said[one.name]

    def keep(self, mutation: Mutation, said: Mapping[str, Any]) -> None:
        """Remember, and tell."""
        at = f"{mutation.path}:{mutation.line}"
        entry = {"mutation": mutation.name, "at": at, **said}
        by = said.get("check") or "; ".join(said.get("readings", ())) or said.get("text", "")
        with self._lock:
            self.said[mutation.name] = entry
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as out:
                out.write(json.dumps(entry, ensure_ascii=False) + "\n")
            print(f"{self.outcome(mutation):10} {at} {mutation.after}  [{by}]", flush=True)

    def judged(self, ordered: Sequence[Mutation], count: int) -> list[Mutation]:
        """The first of the sample, up to so many that were really judged; the others between them
        belong to it as well.  It ends where something is not known yet."""
        taken: list[Mutation] = []
        for one in ordered:
            outcome = self.outcome(one)
            if not count or not outcome:
                break
            taken.append(one)
            count -= outcome not in UNJUDGED
        return taken


# --- the table of survivors ----------------------------------------------------------------------


def known_reasons(family: Family) -> dict[str, str]:
    """Mutations that somebody has read, and why they cannot be seen."""
    if not family.survivors.is_file():
        return {}
    table = tomllib.loads(family.survivors.read_text(encoding="utf-8"))
    return {one["mutation"]: one["reason"] for one in table.get("survivor", []) if one["reason"]}


def write(
    family: Family,
    ordered: Sequence[Mutation],
    taken: Sequence[Mutation],
    sampler: Sampler,
    reasons: Mapping[str, str],
) -> None:
    """Write survivors.toml: one entry for each of the sample, with the reason if there is one, and
    for each that has one from another sample, unless its line has changed."""
    outcomes = {one.name: sampler.outcome(one) for one in taken}
    rows = ["# Written by scripts/mutate; only the reasons are written by hand.\n"]
    rows += ["# What the black-box suite does not see; without a reason: a hole of the suite.\n"]
    for one in sorted(ordered, key=lambda one: (one.path, one.line, one.name)):
        outcome = outcomes.get(one.name, "equivalent" if one.name in reasons else "")
        if outcome in ("equivalent", "survived"):
            rows.append(
                "\n[[survivor]]\n"
                f"mutation = {json.dumps(one.name, ensure_ascii=False)}\n"
                f'at = "{one.path}:{one.line}"\noutcome = "{outcome}"\n'
                f"reason = {json.dumps(reasons.get(one.name, ''), ensure_ascii=False)}\n"
            )
    family.survivors.write_text("".join(rows), encoding="utf-8")


def summary(outcomes: Counter[str]) -> str:
    """The counts in one line, and the share of what was judged that was seen or cannot be."""
    judged = sum(number for name, number in outcomes.items() if name not in UNJUDGED)
    seen = sum(outcomes[name] for name in SEEN)
    told = ", ".join(f"{outcomes[name]} {name}" for name in (*SEEN, "survived"))
    apart = ", ".join(f"{outcomes[name]} {name}" for name in UNJUDGED)
    share = f"{100 * seen / judged:.1f} %" if judged else "nothing"
    return f"{judged} judged: {told}: {share} seen or shown equivalent; apart from these {apart}"


# --- the command ---------------------------------------------------------------------------------


def main() -> int:
    """Sample, judge, tell, write; 1 if something survives that nobody has explained."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--family", choices=FAMILIES, default="mac_serial", help="whose code (default mac_serial)"
    )
    parser.add_argument("--count", type=int, default=200, help="how many to judge (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default 1)")
    parser.add_argument("--minutes", type=float, default=0, help="end early after so many")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time (default 1)")
    parser.add_argument("--quick", action="store_true", help="for now by the first stage only")
    parser.add_argument("--again", default="", help="judge again: outcomes, such as survived,crash")
    options = parser.parse_args()
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
    family = FAMILIES[options.family]
    reasons = known_reasons(family)
    sampler = Sampler(family, options.seed, reasons)
    until = time.monotonic() + 60 * options.minutes if options.minutes else float("inf")
    with tempfile.TemporaryDirectory() as name:
        folder = copy_sources(Path(name) / "sources")
        ordered = sample(folder, family, options.seed)
        if options.again:
            sampler.forget(options.again.split(","), ordered)
        copies = [folder, *(Path(name) / str(number) for number in range(1, options.jobs))]
        for other in copies[1:]:
            shutil.copytree(folder, other)
        stages = family.stages[:1] if options.quick else family.stages
        if problem := run(sampler, ordered, options.count, copies, until, stages):
            print(problem, file=sys.stderr)
            return 2
    taken = sampler.judged(ordered, options.count)
    outcomes = Counter(sampler.outcome(one) for one in taken)
    write(family, ordered, taken, sampler, reasons)
    print(f"seed {options.seed}: {summary(outcomes)}")
    return int(outcomes["survived"] > 0)


def run(
    sampler: Sampler,
    ordered: Sequence[Mutation],
    count: int,
    copies: Sequence[Path],
    until: float,
    stages: Stages,
) -> str | None:
    """Judge until so many of the sample are judged or the time is over, as many at a time as there
    are copies of the sources; return a problem in one line."""
    benches: SimpleQueue[Bench] = SimpleQueue()
    for folder in copies:
        benches.put(Bench(folder))

    def judge(mutation: Mutation) -> None:
        if time.monotonic() < until:
            bench = benches.get()
            sampler.keep(mutation, bench.judge(mutation, sampler.needs(mutation, stages)))
            benches.put(bench)

    healthy = Bench(copies[0]).judge(None, stages)
    if healthy["outcome"] != "passed" or healthy["readings"]:
        return f"the healthy twins do not pass: {healthy}"
    with ThreadPoolExecutor(len(copies)) as pool:
        while time.monotonic() < until:
            missing = [
                one for one in ordered_until(sampler, ordered, count) if sampler.needs(one, stages)
            ]
            if not missing:
                break
            for _ in pool.map(judge, missing):
                pass  # but let an exception through
    return None


def ordered_until(sampler: Sampler, ordered: Sequence[Mutation], count: int) -> Iterator[Mutation]:
    """The sample as far as it reaches if nothing that is not known yet crashes."""
    for one in ordered:
        if not count:
            return
        yield one
        count -= sampler.outcome(one) not in UNJUDGED


if __name__ == "__main__":
    raise SystemExit(main())
