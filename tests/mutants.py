"""Plants small faults in a copy of the package, one at a time, and reports which no test sees.

    .venv/bin/python tests/mutants.py [AREA ..] [--share N] [--seed SEED]

A mutant is the package with one changed node: an operator, a comparison, a constant, a condition, a
dropped statement, or a returned argument. It is killed if a test fails, raises or takes four times
the processor's time that it takes without the mutant. Its module's own tests run first, then those
that import the module, those of its folder, golden runs, and slow tests of all these. Each run is a
process that is forked from one that has imported the libraries, so that it costs the time of its
tests. Not part of the suite.
"""

import argparse
import ast
import contextlib
import copy
import importlib
import itertools
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARIES = (
    "torch numpy scipy.stats mujoco dm_control.rl.control hypothesis pytest matplotlib.figure "
    "rich.progress safetensors.numpy"
).split()

# The modules of each area.
AREAS = {
    "controller": "controller/*.py fields.py compiled_equations.py",
    "tasks": "models/*.py tasks/*.py tasks/*/*.py",
    "runs": "protocols/*.py protocols/examples/*.py protocols/runs/*.py",
    "agents": "protocols/agents/*.py protocols/agents/learners/*.py",
    "analysis": "protocols/analysis/*.py",
    "pages": "protocols/pages/*.py",
    "compare": "protocols/compare/*.py",
    "cli": "protocols/cli/*.py",
}
MARKS = "not slow and not night", "slow and not night"  # tests that are tried first, and then
# Folders of tests of a folder's modules, where it is not the one of its name; "" is the root of the
# package and of `protocols`.
FOLDERS = {"": ("controller", "cli", "faults"), "models": ("models", "tasks")}

SWAPS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or, ast.Or: ast.And,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "argmax": "argmin",
         "argmin": "argmax", "minimum": "maximum", "maximum": "minimum"}  # fmt: skip


def mutations(node: ast.AST, arguments: list[str]) -> Iterator[ast.AST]:
    """Yields the changed copies of one node of a syntax tree."""

    def changed(**fields: object) -> ast.AST:
        other = copy.copy(node)
        vars(other).update(fields)
        return other

    operator = type(getattr(node, "op", None))
    if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and operator in SWAPS:
        yield changed(op=SWAPS[operator]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    if isinstance(node, ast.Compare):
        for index, sign in enumerate(node.ops):
            yield changed(ops=[SWAPS[type(sign)]() if i == index else s
                               for i, s in enumerate(node.ops)])  # fmt: skip
    if isinstance(node, ast.Name) and node.id in NAMES:
        yield changed(id=NAMES[node.id])
    if isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield changed(attr=NAMES[node.attr])
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield changed(value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield changed(value=node.value + 1)
        yield changed(value=node.value * 1.5 if isinstance(node.value, float) else -node.value - 1)
    if isinstance(node, ast.If | ast.IfExp):
        yield changed(test=ast.UnaryOp(ast.Not(), node.test))
    if isinstance(node, ast.Raise | ast.AugAssign | ast.Delete) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call | ast.Await)
    ):
        yield ast.Pass()
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute | ast.Subscript):
        yield ast.Pass()
    if isinstance(node, ast.Return) and node.value is not None and arguments:
        if not (isinstance(node.value, ast.Name) and node.value.id == arguments[0]):
            yield changed(value=ast.Name(arguments[0], ast.Load()))


def sites(source: str) -> list[tuple[str, str]]:
    """Returns what each mutant of a module changes, and the module's text with that change."""
    found: list[tuple[str, str]] = []
    tree = ast.parse(source)

    def visit(parent: ast.AST, arguments: list[str]) -> None:
        for field, value in ast.iter_fields(parent):
            if field in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            for index, node in enumerate(value if isinstance(value, list) else [value]):
                if not isinstance(node, ast.AST) or isinstance(node, ast.JoinedStr):
                    continue  # the texts of messages are not results
                if isinstance(node, ast.Import | ast.ImportFrom):
                    continue
                for other in mutations(node, arguments):
                    _put(parent, field, index, other)
                    text = ast.unparse(ast.fix_missing_locations(tree))
                    before = ast.unparse(node).splitlines()[0]
                    after = ast.unparse(other).splitlines()[0]
                    found.append((f"{getattr(node, 'lineno', 0)}: {before}  ->  {after}", text))
                    _put(parent, field, index, node)
                inner = arguments
                if isinstance(node, ast.FunctionDef):
                    inner = [a.arg for a in node.args.args if a.arg not in ("self", "cls")]
                visit(node, inner)

    visit(tree, [])
    return found


def _put(parent: ast.AST, field: str, index: int, node: ast.AST) -> None:
    value = getattr(parent, field)
    if isinstance(value, list):
        value[index] = node
    else:
        setattr(parent, field, node)


def tests_of(module: str) -> list[str]:
    """Returns test files of a module: its own, then those that import it, small ones first."""
    name = ".".join(["musebot", *Path(module.removesuffix("/__init__.py")).with_suffix("").parts])
    parent, _, last = name.rpartition(".")
    imported = re.compile(rf"^(from {name} |from {parent} import .*\b{last}\b)", re.MULTILINE)
    folder = ROOT / "tests"
    path = Path(module.removeprefix("protocols/"))
    own = folder / path.with_name(f"test_{path.name}")
    others = [path for path in folder.rglob("test_*.py") if imported.search(path.read_text())]
    top = path.parts[0] if len(path.parts) > 1 else ""
    near = [path for top in FOLDERS.get(top, (top,)) for path in (folder / top).rglob("test_*.py")]
    files = [*filter(Path.exists, [own])]
    for group in (others, near):
        files += sorted(group, key=lambda path: path.stat().st_size)
    return [*dict.fromkeys(str(path.relative_to(folder)) for path in files), "test_golden.py"]


def run_tests(copied: Path, test: str, marks: str, limit: int, log: Path) -> tuple[int, float]:
    """Runs a test file in a fork, for at most `limit` s of processor time.

    Returns:
      Exit status of pytest, 0 if there was no test, negative if the run was ended at the limit, and
      its processor time.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        os.chdir(copied)
        sys.path.insert(0, str(copied.parent))
        os.environ["PYTHONPATH"] = str(copied.parent)
        import pytest

        arguments = ["-x", "-q", "-m", marks, "-p", "no:cacheprovider"]
        arguments += ["--rootdir", "tests", "--import-mode=importlib", f"tests/{test}"]
        status = int(pytest.main(arguments))
        os._exit(0 if status == pytest.ExitCode.NO_TESTS_COLLECTED else status)
    deadline = time.monotonic() + 20 * limit
    found, status = 0, 0
    while not found and time.monotonic() < deadline:
        found, status = os.waitpid(child, os.WNOHANG)
        time.sleep(0.05)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # also what the tests have started
    if not found:
        _, status = os.waitpid(child, 0)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    return os.waitstatus_to_exitcode(status), seconds


def main() -> None:
    """Plants the mutants and prints each survivor, then killed of planted by area."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("areas", nargs="*", metavar="AREA", help="default: all")
    parser.add_argument("--share", type=int, default=40, help="mutants of each area (40)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample (1)")
    parser.add_argument("--only", default="", help="modules whose path contains this text")
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # threads of small tensors wait for each other
    for name in LIBRARIES:
        importlib.import_module(name)
    os.environ.update(MUJOCO_GL="off", PYTHONDONTWRITEBYTECODE="1")
    sys.dont_write_bytecode = True
    totals = {}
    with tempfile.TemporaryDirectory() as temporary:
        copied = Path(temporary) / "musebot"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "docs")
        shutil.copytree(ROOT, copied, ignore=ignored)
        (copied / "docs").symlink_to(ROOT / "docs")
        for area in options.areas or AREAS:
            totals[area] = _area(area, copied, options)
    for area, (killed, planted) in totals.items():
        print(f"{area}: {killed} of {planted} killed")


def _area(area: str, copied: Path, options: argparse.Namespace) -> tuple[int, int]:
    paths = sorted(path for pattern in AREAS[area].split() for path in ROOT.glob(pattern))
    modules = [str(path.relative_to(ROOT)) for path in paths if options.only in str(path)]
    planted = [(m, *site) for m in modules for site in sites((ROOT / m).read_text())]
    count = min(options.share, len(planted))
    chosen = random.Random(f"{options.seed} {area}").sample(planted, count)
    print(f"{area}: {len(chosen)} of {len(planted)} mutants of {len(modules)} modules", flush=True)
    log, limits, killed = copied.parent / "log", {}, 0
    for module, what, text in sorted(chosen):
        status, spent = 0, 0.0
        for marks, test in itertools.product(MARKS, tests_of(module)):
            if (marks, test) not in limits:
                status, seconds = run_tests(copied, test, marks, 600, log)
                limits[marks, test] = 0 if status else round(4 * seconds + 10)
                if status:
                    print(f"left out, it fails without a mutant: {test}\n{log.read_text()[-600:]}")
            if not limits[marks, test]:
                status = 0
                continue
            original = (copied / module).read_text()
            (copied / module).write_text(text)
            status, seconds = run_tests(copied, test, marks, limits[marks, test], log)
            (copied / module).write_text(original)
            spent += seconds
            if status:
                break
        killed += status != 0
        verdict = "SURVIVED" if not status else "killed" if status > 0 else "timed out"
        print(f"{verdict:9} {spent:4.0f} s  {module}:{what}", flush=True)
    return killed, len(chosen)


if __name__ == "__main__":
    main()
