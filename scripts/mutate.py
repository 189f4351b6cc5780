"""Samples automatic mutants of the twin's device code; the black-box suite alone judges each.

A mutant is one small change of the source: a comparison or an operator replaced, a constant one
more or less, a condition negated, a statement left out.  It is killed by a failed judgement.
Counted apart are a crash or a time-out, and a quirk: a change that makes another admissible
reading of the manual, which the suite has named.  What survives is written down with its line and
its change; a reason, written beside one that reading has shown to be equivalent, is kept when that
mutation comes again.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "emulators" / "axistwin"
SOURCES = ("devices/mac", "motion")
LEFT_OUT = ("devices/mac/decode.py",)  # words for people: nothing of it reaches the wire
SURVIVORS = ROOT / "conformance" / "tests" / "zoo" / "survivors.toml"
LIMIT_S = 120.0
# What judges, one after the other, until something fails: model and level.
STAGES = (("mac23", "quick"), ("mac23", "full"), ("mac34-1", "quick"))

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
    source: str  # the whole mutated file

    @property
    def name(self) -> str:
        """What stays the same while lines above move."""
        return f"{self.path}: {self.before}  =>  {self.after}"


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
    if isinstance(node, DROPPED) and not _is_docstring(node):
        yield ast.Return(ast.Constant(None)) if isinstance(node, ast.Return) else ast.Pass()


def _with(node: ast.AST, **fields: object) -> ast.AST:
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return other


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def mutations(path: Path) -> list[Mutation]:
    """Every mutation of the functions and tables of one file."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    found: list[Mutation] = []
    for statement in _statements(tree):
        for site in _sites(statement):
            for instead in changed(site):
                found += _applied(path, text, statement, site, instead)
    return found


def _statements(tree: ast.Module) -> Iterator[ast.stmt]:
    """All statements; of compound ones the children follow by themselves."""
    for node in ast.walk(tree):
        is_plain = isinstance(node, ast.stmt) and not isinstance(
            node, ast.FunctionDef | ast.ClassDef | ast.Import | ast.ImportFrom | ast.Assert
        )
        if is_plain and not _is_docstring(node):
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
    path: Path, text: str, statement: ast.stmt, site: ast.AST, instead: ast.AST
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
        compile(source, str(path), "exec")
    except (SyntaxError, ValueError):
        return []
    told = " ".join(before.split()), " ".join(after.split())
    return [Mutation(str(path.relative_to(PACKAGE)), first + 1, *told, source)]


def _column(line: str, offset: int) -> int:
    """A column of `ast`, which counts bytes, in characters."""
    return len(line.encode()[:offset].decode())


# --- judging -------------------------------------------------------------------------------------


def judge(mutation: Mutation | None, folder: Path, model: str, level: str) -> str:
    """Judge a mutated copy of the twins in `folder`: killed, quirk, crash, time-out, survived."""
    copied = folder / "axistwin"
    shutil.rmtree(copied, ignore_errors=True)
    shutil.copytree(PACKAGE, copied, ignore=shutil.ignore_patterns("__pycache__"))
    if mutation is not None:
        (copied / mutation.path).write_text(mutation.source, encoding="utf-8")
    command = [sys.executable, "-m", "axistwin_conformance", model, "--level", level, "--json"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True,
            timeout=LIMIT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "time-out"
    fails = [
        finding["requirement"]
        for event in map(json.loads, done.stdout.splitlines())
        if event["event"] == "check_finished"
        for finding in event["findings"]
        if finding["verdict"] == "fail"
    ]
    if fails:
        return "killed"
    if done.returncode:
        return f"crash ({done.returncode})"
    told = '"verdict": "quirk"' in done.stdout or '"verdict":"quirk"' in done.stdout
    return "quirk" if told else "survived"


def verdict(mutation: Mutation, folder: Path) -> str:
    """The cheapest first; the others only if that saw nothing."""
    outcome = "survived"
    for stage in STAGES:
        if outcome == "survived":
            outcome = judge(mutation, folder, *stage)
    return outcome


# Runs the stages in one process and prints the lines of the twins that were executed.
TRACER = """
import json, sys
root, stages = sys.argv[1], json.loads(sys.argv[2])
reached = {}

def trace(frame, event, arg):
    name = frame.f_code.co_filename
    if not name.startswith(root):
        return None
    lines = reached.setdefault(name[len(root) + 1:], set())
    def follow(frame, event, arg):
        lines.add(frame.f_lineno)
        return follow
    return follow(frame, event, arg)

sys.settrace(trace)
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import Engine
for model, level in stages:
    Engine(make_options(model=model, level=level)).run(lambda event: None)
sys.settrace(None)
print(json.dumps({name: sorted(lines) for name, lines in reached.items()}))
"""


def reached_lines() -> dict[str, set[int]]:
    """The lines that the suite has the default twins execute; the others are code of other readings
    of the manual, of other plants, or for panels, and no judgement of these twins can see them."""
    stages = json.dumps([stage for stage in STAGES if stage[1] != "full"])
    command = [sys.executable, "-c", TRACER, str(PACKAGE), stages]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    table = json.loads(done.stdout.splitlines()[-1])
    return {name: set(lines) for name, lines in table.items()}


def sample(seed: int, count: int) -> list[Mutation]:
    """So many mutations of the code that the default twins execute, drawn by the seed."""
    reached = reached_lines()
    files = sorted(path for name in SOURCES for path in (PACKAGE / name).glob("*.py"))
    found = [
        one
        for path in files
        if str(path.relative_to(PACKAGE)) not in LEFT_OUT
        for one in mutations(path)
    ]
    seen = [one for one in found if one.line in reached.get(one.path, ())]
    print(f"{len(found)} mutations of {len(files)} files, {len(seen)} of them reached", flush=True)
    return random.Random(seed).sample(seen, min(count, len(seen)))


def known_reasons() -> dict[str, str]:
    """Mutations that somebody has read, and why they cannot be seen."""
    if not SURVIVORS.is_file():
        return {}
    table = tomllib.loads(SURVIVORS.read_text(encoding="utf-8"))
    return {one["mutation"]: one["reason"] for one in table.get("survivor", []) if one["reason"]}


def write(survivors: Sequence[tuple[Mutation, str]], reasons: Mapping[str, str], head: str) -> None:
    """Write survivors.toml: one entry each, with the reason if there is one."""
    rows = [f"# Written by scripts/mutate; only the reasons are written by hand.\n# {head}\n"]
    for one, outcome in survivors:
        rows.append(
            "\n[[survivor]]\n"
            f"mutation = {json.dumps(one.name, ensure_ascii=False)}\n"
            f'at = "{one.path}:{one.line}"\noutcome = "{outcome}"\n'
            f"reason = {json.dumps(reasons.get(one.name, ''), ensure_ascii=False)}\n"
        )
    SURVIVORS.write_text("".join(rows), encoding="utf-8")


def main() -> int:
    """Sample, judge, tell, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="how many (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the sample (default 1)")
    parser.add_argument("--skip", type=int, default=0, help="leave out so many of the sample")
    parser.add_argument("--minutes", type=float, default=0, help="end early after so many")
    options = parser.parse_args()
    return run(options.seed, options.count, options.skip, options.minutes * 60)


def run(seed: int, count: int, skip: int, limit_s: float) -> int:
    """Judge the sample; 1 if something survives that nobody has explained."""
    import time

    reasons, outcomes = known_reasons(), Counter[str]()
    left: list[tuple[Mutation, str]] = []
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for model, level in STAGES:
            if (healthy := judge(None, folder, model, level)) != "survived":
                print(f"the healthy {model} does not pass {level}: {healthy}", file=sys.stderr)
                return 2
        chosen = sample(seed, count)[skip:]
        for number, one in enumerate(chosen, 1 + skip):
            if limit_s and time.monotonic() - started > limit_s:
                break
            outcome = verdict(one, folder)
            if outcome == "survived" and one.name in reasons:
                outcome = "equivalent"
            outcomes[outcome.partition(" ")[0]] += 1
            if outcome != "killed":
                left.append((one, outcome))
            print(f"{number:4} {outcome:11} {one.path}:{one.line} {one.after}", flush=True)
    head = f"seed {seed}: " + ", ".join(f"{n} {word}" for word, n in sorted(outcomes.items()))
    print(head)
    write(left, reasons, head)
    return int(outcomes["survived"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
