"""Plants small faults in a copy of the package, one at a time, and reports which no test sees.

    .venv/bin/python tests/mutants.py [AREA ..] [--share N] [--seed SEED]

A mutant is the package with one changed node: an operator, a comparison, a constant, a condition, a
dropped statement, or a returned argument. It is killed if a test fails, raises or takes four times
the processor's time that it takes without the mutant. Its module's own tests run first, then those
in `MORE_TESTS`. Each run is a process that is forked from one that has imported the libraries, so
that it costs the time of its tests. Not part of the suite.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import importlib
import os
import random
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
    "tyro rich.progress safetensors.numpy"
).split()

# The modules of each area, and the tests of a module that run if its own find nothing.
AREAS = {
    "equations": (
        "controller/brains.py controller/creative_memory.py controller/evaluation_network.py "
        "controller/exploration.py controller/networks.py controller/neurocontroller.py "
        "controller/context.py "
        "controller/parameters.py controller/proposers.py "
        "controller/senses.py controller/step.py protocols/results/learn_ability.py"
    ),
    "schedules": "protocols/experiment/schedules.py protocols/simulation/placement.py",
    "statistics": (
        "protocols/analysis/behaviour.py protocols/analysis/claims.py "
        "protocols/analysis/comparison.py protocols/analysis/hypothesis_tests.py "
        "protocols/analysis/intervals.py protocols/analysis/paper_claims.py "
        "protocols/analysis/paper_tables.py"
    ),
    "resume": (
        "protocols/simulation/checkpoints.py protocols/simulation/cohort.py "
        "protocols/simulation/jobs.py protocols/simulation/runs.py protocols/results/results.py"
    ),
    "readers": (
        "protocols/results/checks.py protocols/results/run_files.py protocols/storage.py "
        "protocols/results/run.py"
    ),
    "tasks": (
        "tasks/episode.py tasks/rules.py tasks/sensors.py tasks/spot_finding.py tasks/starts.py "
        "tasks/wall_avoidance.py models/edits.py models/kinematic.py "
        "tasks/arena.py tasks/batch.py tasks/kinematic.py tasks/tensors/*.py "
        "tasks/gymnasium_env/*.py models/physics.py"
    ),
    "agents": (
        "protocols/agents/learners/*.py protocols/agents/bounds.py protocols/agents/ppo.py "
        "protocols/agents/raw_signals.py"
    ),
    "playback": (
        "protocols/playback/episode.py protocols/playback/film.py protocols/playback/panel.py "
        "protocols/playback/rollout.py protocols/playback/scene.py"
    ),
    "reporting": "protocols/reporting/*.py",
    "bench": "protocols/cli/bench.py protocols/cli/speed.py",
    "commands": "protocols/commands/*.py protocols/cli.py protocols/config.py protocols/doctor.py",
    "studies": "protocols/studies/*.py protocols/studies/*/*.py",
}
MORE_TESTS = {
    "controller/brains.py": (
        "controller/test_brains.py controller/test_neurocontroller.py experiment/test_overrides.py"
    ),
    "controller/*": (
        "controller/test_neurocontroller.py controller/test_brains.py "
        "controller/test_creative_memory.py experiment/test_overrides.py"
    ),
    "protocols/analysis/paper_claims.py": "analysis/test_claims.py",
    "protocols/simulation/checkpoints.py": (
        "simulation/test_cohort.py simulation/test_tensorboard_log.py"
    ),
    "protocols/simulation/cohort.py": "simulation/test_checkpoints.py",
    "protocols/simulation/placement.py": "simulation/test_cohort.py",
    "protocols/experiment/schedules.py": "simulation/test_placement.py simulation/test_cohort.py",
    "protocols/results/results.py": "results/test_run_files.py",
    "protocols/results/checks.py": "simulation/test_checkpoints.py results/test_run_files.py",
    "protocols/results/run_files.py": "results/test_checks.py",
    "protocols/simulation/jobs.py": "simulation/test_runs.py",
    "protocols/simulation/runs.py": "simulation/test_tensorboard_log.py simulation/test_jobs.py",
    "protocols/playback/*": "playback/test_film.py playback/test_panel.py playback/test_scene.py",
    "tasks/tensors/*": "tasks/test_robots.py simulation/test_device.py",
    "tasks/gymnasium_env/*": "tasks/test_gymnasium_env.py tasks/test_environments.py",
    "tasks/*": (
        "tasks/test_tasks.py tasks/test_robots.py tasks/test_kinematic.py "
        "tasks/test_environments.py"
    ),
    "models/*": (
        "models/test_edits.py tasks/test_kinematic.py tasks/test_robots.py tasks/test_tasks.py"
    ),
    "protocols/agents/learners/*": (
        "agents/learners/test_published.py agents/learners/test_learners.py "
        "agents/learners/test_q_learning.py"
    ),
    "protocols/reporting/comparison_tables.py": "reporting/test_tables.py",
    "protocols/reporting/example_robots.py": "reporting/test_robot_figures.py",
    "protocols/reporting/tables.py": "reporting/test_html_page.py test_cli.py",
    "protocols/reporting/style.py": "reporting/test_figures.py",
    "protocols/reporting/*": "reporting/test_html_page.py reporting/test_report.py",
    "protocols/cli/bench.py": "cli/test_bench.py",
    "protocols/cli/speed.py": "cli/test_bench.py",
    "protocols/commands/run.py": "test_cli.py",
    "protocols/commands/check_agent.py": "agents/test_agent_check.py test_cli.py",
    "protocols/commands/demo.py": "studies/test_demonstration.py test_cli.py",
    "protocols/commands/doctor.py": "test_doctor.py",
    "protocols/commands/explore.py": "playback/test_viewer.py test_cli.py",
    "protocols/commands/film.py": "playback/test_film.py test_cli.py",
    "protocols/commands/report.py": "reporting/test_report.py test_cli.py",
    "protocols/commands/study.py": "test_cli.py studies/test_study.py",
    "protocols/commands/*": "test_cli.py",
    "protocols/config.py": "test_cli.py",
    "protocols/studies/learners/benchmark.py": "studies/test_benchmark.py",
    "protocols/studies/learners/continued.py": "studies/test_continued.py",
    "protocols/studies/learners/*": "studies/test_leaderboard.py studies/test_benchmark.py",
    "protocols/studies/learning_progress/*": (
        "studies/test_learning_progress.py studies/test_frozen_brains.py"
    ),
    "protocols/studies/proposers/*": "studies/test_proposers.py",
    "protocols/studies/reading/*": "studies/test_reading.py",
    "protocols/studies/search/tune.py": "studies/test_tune.py",
    "protocols/studies/search/*": "studies/test_evolve.py studies/test_tune.py",
    "protocols/studies/wear/*": "studies/test_wear.py",
    "protocols/studies/*": "studies/test_study.py",
}

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
        for name, value in fields.items():
            setattr(other, name, value)
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
    """Returns the test files of a module, as paths below `tests`, its own first."""
    path = Path(module.removeprefix("protocols/"))
    names = [str(path.with_name(f"test_{path.name}"))]
    for pattern, more in MORE_TESTS.items():
        if Path(module).match(pattern):
            names += more.split()
            break
    return [name for name in dict.fromkeys(names) if (ROOT / "tests" / name).exists()]


def run_tests(copied: Path, test: str, limit: int, log: Path) -> tuple[int, float]:
    """Runs a test file in a fork.

    Args:
      copied: Root of the copy of the package.
      test: Path of the test file below `tests`.
      limit: Most seconds of the processor's time.
      log: File that takes what pytest prints.

    Returns:
      Exit status of pytest, negative if the run was ended at the limit, and its processor's time.
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

        arguments = ["-x", "-q", "-m", "not slow and not night", "-p", "no:cacheprovider"]
        arguments += ["--rootdir", "tests", "--import-mode=importlib", f"tests/{test}"]
        os._exit(int(pytest.main(arguments)))
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
    parser.add_argument("--again", type=Path, help="a log; only its surviving mutants")
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
    if not options.again:
        count = min(options.share, len(planted))
        chosen = random.Random(f"{options.seed} {area}").sample(planted, count)
    else:
        lines = options.again.read_text().splitlines(keepends=True)
        survivors = "".join(line for line in lines if line.startswith("SURVIVED"))
        chosen = [one for one in planted if f" s  {one[0]}:{one[1]}\n" in survivors]
    print(f"{area}: {len(chosen)} of {len(planted)} mutants of {len(modules)} modules", flush=True)
    log, limits, killed = copied.parent / "log", {}, 0
    for module, what, text in sorted(chosen):
        status, spent = 0, 0.0
        for test in tests_of(module):
            if test not in limits:
                status, seconds = run_tests(copied, test, 600, log)
                if status:
                    sys.exit(f"{test} fails without a mutant:\n{log.read_text()}")
                limits[test] = round(4 * seconds + 10)
            original = (copied / module).read_text()
            (copied / module).write_text(text)
            status, seconds = run_tests(copied, test, limits[test], log)
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
