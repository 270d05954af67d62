"""The site: its pages match the code, its links lead somewhere, its notebooks run."""

import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from musebot.controller import PROPOSERS
from musebot.protocols.lives.run_files import read_so_far

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
LEARNERS = [*(DOCS / "results" / "benchmark-kinematic").glob("paper-*-raw")]  # with raw signals
BUILT = "reference/notebooks/"  # pages that are made for each site, and not committed
# What the notebooks need beyond the package itself.
EXTRAS = {"ppo": "stable_baselines3", "first-robot": "matplotlib", "creative-life": "torch"}


@pytest.fixture
def generator(monkeypatch):
    """A function that imports a module of docs/generator."""
    monkeypatch.syspath_prepend(DOCS / "generator")
    before = set(sys.modules)

    def module(name):
        spec = importlib.util.spec_from_file_location(
            f"generator_{name}", DOCS / "generator" / f"{name}.py"
        )
        made = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(made)
        return made

    yield module
    for name in set(sys.modules) - before:
        if str(DOCS) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def listed(entries):
    """Yields the files that a part of `nav` names."""
    for entry in entries:
        if isinstance(entry, dict):
            (entry,) = entry.values()
        yield from [entry] if isinstance(entry, str) else listed(entry)


@pytest.mark.slow
def test_the_committed_pages_are_those_of_the_code(generator):
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    pages = generator("__main__").reference_pages()
    found = {
        path.relative_to(DOCS / "reference"): path.read_text()
        for path in (DOCS / "reference").rglob("*.md")
        if BUILT not in f"{path.relative_to(DOCS)}"
    }
    assert found.keys() == pages.keys(), "run: python docs/generator"
    stale = [str(path) for path, text in pages.items() if found[path] != text]
    assert not stale, f"run: python docs/generator ({', '.join(stale)} are stale)"


def test_an_option_whose_meaning_is_in_the_next_line_is_read(generator):
    text = "│ OUT         folder of the run  │\n╰────╯\n│ --to {a,b}  │\n│             where to  │"
    found = [*generator("command_pages")._options(text)]
    assert found == [("OUT", "", "folder of the run"), ("--to", "{a,b}", "where to")]


def test_the_menu_names_every_page_and_no_other():
    names = [*listed(CONFIG["nav"])]
    assert len(names) == len(set(names))
    kept = {name for name in names if not name.startswith(BUILT)}
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    results = {name for name in pages if name.startswith(("results/", BUILT))}  # runs.md links them
    assert kept == pages - results
    assert set(names) - kept == {f"{BUILT}{path.stem}.md" for path in NOTEBOOKS}


def test_links_between_documents_lead_to_files_and_stay_within_the_site():
    wrong = []
    for path in (*DOCS.rglob("*.md"), *ROOT.glob("*.md")):
        if BUILT in path.as_posix():
            continue
        text = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            if ":" in link:
                continue
            target = (path.parent / link).resolve()
            outside = DOCS in path.parents and DOCS not in target.parents
            if outside or not target.exists():
                wrong.append(f"{path.relative_to(ROOT)}: {link}")
    assert not wrong, "\n".join(wrong)


def test_a_site_with_a_broken_link_or_a_foreign_script_is_refused(generator, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "index.html").write_text('<h1 id="top">A</h1>')
    (tmp_path / "index.html").write_text(
        '<a href="a/#top">1</a> <a href="a/#low">2</a> <img src="b.png"> <a href="https://x.org">'
        '<script src="https://x.org/y.js"></script>'
    )
    assert generator("check_site").faults(tmp_path) == [
        "index.html: loads https://x.org/y.js",
        "index.html: a/#low does not exist",
        "index.html: b.png does not exist",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=[path.stem for path in NOTEBOOKS])
def test_a_notebook_runs(path, tmp_path, request):
    pytest.importorskip(EXTRAS[path.stem], reason="needs an extra")
    if path.stem != "ppo":
        request.getfixturevalue("egl")
    cells = json.loads(path.read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert code
    # One process for all cells. Jupyter shows the value of the last line; here it is only made.
    shown = "\nif 'Film' in globals():\n    assert 'image/gif' in Film('film.gif')._repr_html_()\n"
    script = "\n".join(code) + shown
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment | {"MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    # The same lines as those that are kept; their numbers may differ from machine to machine.
    kept = [
        "".join(output["text"])
        for cell in cells
        for output in cell.get("outputs", [])
        if output["output_type"] == "stream"
    ]
    number = re.compile(r"-?\d+(\.\d+)?")
    assert number.sub("0", "".join(kept)).split() == number.sub("0", done.stdout).split()


def test_notebooks_are_small_and_name_no_folder_of_a_machine():
    for path in NOTEBOOKS:
        assert path.stat().st_size < 300_000
        assert not re.search(r"/(home|root|tmp|work)/", path.read_text())


def test_the_page_of_a_notebook_has_its_results(generator):
    files = generator("notebook_pages").files(DOCS)
    page = files[DOCS / "reference" / "notebooks" / "creative-life.md"].decode()
    pictures = re.findall(r"\]\((creative-life-[\w-]+\.(?:png|gif))\)", page)
    assert [name.rpartition(".")[2] for name in pictures] == ["png", "png", "gif"]
    assert all(files[DOCS / "reference" / "notebooks" / name] for name in pictures)


def test_the_changelog_has_no_links_into_docs():
    """The site shows it in another folder, where they would lead nowhere."""
    assert "](docs/" not in (ROOT / "CHANGELOG.md").read_text()


def test_the_scores_of_the_leaderboard_are_those_of_the_benchmark(generator):
    page = DOCS / "leaderboard.md"
    scores = generator("leaderboard_page").updated(DOCS)
    assert page.read_text() == scores, "run: python docs/generator"
    assert "| sarsa_lambda | **0.744 [0.601, 0.880]** |" in scores


def test_the_numbers_of_the_leaderboard_are_those_of_its_example(monkeypatch, capsys):
    text = (DOCS / "leaderboard.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(example, {})
    found = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) \|$", text, re.M)
    assert len(rows) == len(found) == len(LEARNERS)
    for name, *numbers in rows:
        assert found[f"paper-{name}-raw"] == numbers


def test_what_agents_gain_from_learning_on_is_that_of_its_study():
    text = (DOCS / "leaderboard.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| (0\..*\] \| 0\..*\] \| 0\..*\]) \|$", text, re.M)
    page = (DOCS / "results" / "continued-learning" / "continued-learning.md").read_text()
    _, _, page = page.partition("### Spot finding")
    assert len(rows) == len(LEARNERS)
    for name, cells in rows:
        (row,) = [line for line in page.splitlines() if f"`paper-{name}-raw`)" in line]
        assert row.startswith(f"| {row.split('|')[1].strip()} | 60 of 60 | {cells} | ")


def test_what_agents_gain_with_the_papers_signals_is_that_of_its_study():
    text = (DOCS / "leaderboard.md").read_text()
    page = (DOCS / "results" / "continued-learning-paper" / "continued-learning.md").read_text()
    _, _, page = page.partition("### Spot finding")
    rows = [line.split(" | ") for line in page.splitlines() if "(`paper-" in line]
    assert len(rows) == 6
    for row in rows:
        assert f"{row[2].split()[0]} and {row[4].split()[0]}" in text, row[0]


def test_the_films_of_the_leaderboard_show_each_learners_median_robot():
    page = (DOCS / "leaderboard.md").read_text()
    row = r"\| `(\w+)`(?:, )?(\w*) \| (\d+), ([\d.]+) s of 3600 s \| .*\((images/.*)\) \|"
    rows = re.findall(row, page)
    folder = DOCS / "results" / "benchmark-kinematic"
    learners = {(path.name.split("-")[1], "") for path in folder.glob("paper-*-raw")}
    assert {row[:2] for row in rows} == learners | {("paper", name) for name in PROPOSERS}
    for name, proposer, robot, seconds, film in rows:
        run = read_so_far(folder / f"paper-{name}-{'paper' if proposer else 'raw'}", "rows")
        spot = [c for c in run.conditions() if c.task == "spot_finding"]
        (condition,) = [c for c in spot if not proposer or c.proposer == proposer]
        found = sorted((one.t_post_s, one.robot) for one in run.valid(condition))
        time, middle = found[(len(found) - 1) // 2]
        assert (middle, f"{time:.1f}") == (int(robot), seconds)
        stem = f"{name}_{proposer}" if proposer else name
        assert (DOCS / film).name == f"{stem}.gif" and (DOCS / film).exists()


@pytest.mark.parametrize(
    ("board", "count"),
    [("larger-raw", 6), ("larger-paper", 6), ("continual-raw", 7), ("continual-paper", 7)],
)
def test_the_scores_of_further_boards_are_those_of_their_pages(board, count):
    text = (DOCS / "results" / f"benchmark-{board}" / "benchmark.md").read_text()
    rows = [line.split(" | ") for line in text.splitlines() if " | 60 | " in line]
    assert len(rows) == count
    page = (DOCS / "leaderboard.md").read_text()
    for learner, _, *numbers in rows:
        assert " | ".join([learner, *numbers[:3]]) in page, learner


def test_the_shares_of_the_leaderboard_are_those_of_the_benchmark():
    page = " ".join((DOCS / "leaderboard.md").read_text().split())
    text = (DOCS / "results" / "benchmark-kinematic" / "benchmark.md").read_text()
    boards = text.split("### Spot finding, protocol paper, ")
    both = {board.split(" ")[0]: board.split("### ")[0].splitlines() for board in boards[1:]}

    def cell(track, name, column):
        (row,) = [row for row in both[track] if row.startswith(f"| {name} | 60 | ")]
        return row.split("|")[column].split()[0]

    score, test, training = 3, 4, 5
    steady, creative, sarsa = "steady, creative", "paper, creative", "sarsa_lambda"
    for sentence, *cells in (
        (
            "{} against {} in the kinematic simulator (p = 1)",
            ("raw", steady, score), ("raw", sarsa, score),
        ),
        (
            "`steady` is in the spot for {} of the test after training, more than any other",
            ("raw", steady, test),
        ),
        (
            "`sarsa_lambda` for {}, but for {} of training, where `steady` has {}.",
            ("raw", sarsa, test), ("raw", sarsa, training), ("raw", steady, training),
        ),
        (
            "`sarsa_lambda` has the highest score ({}), `amortised_q` is not significantly below "
            "it ({}, p",
            ("paper", sarsa, score), ("paper", "amortised_q", score),
        ),
        (
            "`steady` fails: it is in the spot for {} of the test after training and for {} of "
            "training (newborns {} and {}; `steady` with raw signals {} and {})",
            ("paper", steady, test), ("paper", steady, training),
            ("paper", "*newborn*", test), ("paper", "*newborn*", training),
            ("raw", steady, test), ("raw", steady, training),
        ),
        (
            "The paper's creative robots have {} and {}.",
            ("paper", creative, test), ("paper", creative, training),
        ),
        (
            "After training `sarsa_lambda` ({}; in training {}) and `amortised_q` ({}) are in the "
            "spot about as long as with raw signals ({} and {})",
            ("paper", sarsa, test), ("paper", sarsa, training), ("paper", "amortised_q", test),
            ("raw", sarsa, test), ("raw", "amortised_q", test),
        ),
        (
            "`dqn` is in the spot for {} of training, but for {} of the test with frozen weights.",
            ("paper", "dqn", training), ("paper", "dqn", test),
        ),
        (
            "met after training ({} and {}), not in training ({} and {})",
            ("paper", "stream_ac", test), ("paper", "avg", test),
            ("paper", "stream_ac", training), ("paper", "avg", training),
        ),
        (
            "raw signals: not met (after training {} and {}; MuJoCo",
            ("raw", "stream_ac", test), ("raw", "avg", test),
        ),
        ("`steady` falls to {} (MuJoCo", ("paper", steady, test)),
    ):  # fmt: skip
        assert sentence.format(*(cell(*one) for one in cells)) in page, sentence


def test_the_shares_in_mujoco_are_those_of_its_board():
    page = (DOCS / "leaderboard.md").read_text()
    _, _, prose = page.partition("## What came out with raw signals")
    text = (DOCS / "results" / "benchmark-mujoco" / "benchmark.md").read_text()
    rows = [line.split("|") for line in text.splitlines() if "| 30 | " in line][:10]
    by_name = {row[1].strip(): [cell.split(" ")[1] for cell in row[3:6]] for row in rows}
    (p,) = [row[9].strip() for row in rows if row[1].strip() == "steady, creative"]
    first, ours = by_name["sarsa_lambda"], by_name["steady, creative"]
    assert f"{ours[0]} against {first[0]} in MuJoCo (p = {float(p):.2f}; 30 robots each)" in prose
    for name, numbers, failed in (("sarsa_lambda", first, "27%"), ("steady", ours, "0%")):
        fails = round(float(failed[:-1]) * 30 / 100)
        assert f"| `{name}` | {numbers[1]} | {numbers[2]} | {fails} of 30 |" in prose
        assert [failed] == [row[7].strip() for row in rows if row[1].strip().startswith(name)]
    for name in ("dqn", "avg", "stream_q", "amortised_q", "stream_ac", "q_learner"):
        assert f"`{name}` ({by_name[name][0]})" in prose


def test_the_shares_with_the_papers_signals_in_mujoco_are_those_of_its_board():
    page = (DOCS / "leaderboard.md").read_text()
    text = (DOCS / "results" / "benchmark-mujoco-paper" / "benchmark.md").read_text()
    rows = [line.split("|") for line in text.splitlines() if "| 30 | " in line][:13]
    by_name = {row[1].strip(): row for row in rows}
    for name in (
        "sarsa_lambda",
        "amortised_q",
        "avg",
        "dqn",
        "paper, creative",
        "steady, creative",
    ):
        row = by_name[name]
        numbers = " | ".join(cell.split()[0] for cell in row[3:6])
        fails = row[7].strip().replace("%", " %")
        assert f"| `{name}` | {numbers} | {fails} |" in page
    assert float(by_name["dqn"][9]) == pytest.approx(0.28, abs=0.005)
    said = next(line for line in text.splitlines() if line.startswith("- steady, creative: "))
    above = "significantly above it: sarsa_lambda; amortised_q; avg; dqn, below it: none."
    assert said.endswith(above)


def test_the_scores_with_sensed_walls_in_mujoco_are_those_of_their_boards():
    page = " ".join((DOCS / "leaderboard.md").read_text().split())
    rows = {}
    for track in ("raw", "paper"):
        text = (DOCS / "results" / f"benchmark-walls-{track}" / "benchmark.md").read_text()
        found = [line.split("|") for line in text.splitlines() if "| 30 | " in line]
        rows[track] = {row[1].strip(): row for row in found}

    def first(track, name, column):
        return rows[track][name][column].split()[0]

    raw = [f"`{name}` ({first('raw', name, 3)}" for name in ("stream_ac", "dqn", "stream_q")]
    p = [f"{float(rows['raw'][name][9]):.2f}" for name in ("dqn", "stream_q")]
    assert f"`steady` has the highest score ({first('raw', 'steady, creative', 3)}); " in page
    assert (
        f"{raw[0]}), {raw[1]}, p = {p[0]}) and {raw[2]}, p = {p[1]}) are not significantly" in page
    )
    steady, sarsa = (
        [first("raw", name, c) for c in (4, 5)] for name in ("steady, creative", "sarsa_lambda")
    )
    both = f"for {steady[0]} of the time, `sarsa_lambda` for {sarsa[0]}"
    assert f"{both} (in training {steady[1]} and {sarsa[1]})" in page
    near = [name for name, row in rows["raw"].items() if row[9].strip() and float(row[9]) >= 0.05]
    assert near == ["stream_ac", "dqn", "stream_q"]
    far = {name for name, row in rows["paper"].items() if row[9].strip() and float(row[9]) < 0.05}
    assert far == {"dqn", "sarsa_lambda", "paper, random", "paper, fixed"}
    assert f"`stream_ac` has the highest score ({first('paper', 'stream_ac', 3)}); only" in page
    ours = [first("paper", f"{name}, creative", 3) for name in ("steady", "paper")]
    assert f"`steady` ({ours[0]}) and the paper's creative robots ({ours[1]}) are not" in page
    learners = [row for name, row in rows["paper"].items() if not name.startswith("*")]
    best = max(float(row[4].split()[0]) for row in learners)
    least = min(int(row[7].strip()[:-1]) for row in learners)
    assert (
        f"after training is above {best:.3f} (`steady`); of each learner at least {least} %" in page
    )


def test_the_example_of_a_brain_alone_runs():
    (example,) = re.findall(r"```python\n(.*?)```", (DOCS / "faq.md").read_text(), re.DOTALL)
    found: dict[str, float] = {}
    exec(example, found)
    assert abs(found["left"]) <= 0.5 and abs(found["right"]) <= 0.5


@pytest.mark.slow
def test_the_pictures_of_the_installation_page_are_drawn_without_a_display(egl, tmp_path):
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    (example,) = re.findall(r"```python\n(.*?)```", (DOCS / "install.md").read_text(), re.DOTALL)
    example = example.replace(
        "picture = env", "assert picture.shape == (240, 360, 3)\npicture = env"
    )
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-c", example + "assert picture.shape == (320, 480, 3)\n"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_what_the_site_needs_is_pinned():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    pins = re.findall(r"^([\w.-]+)==", (ROOT / "constraints-docs.txt").read_text(), re.MULTILINE)
    needed = {name for name in extras["docs"] if not name.startswith("musebot")}
    assert needed <= set(pins)
    assert len(pins) == len({name.lower().replace("_", "-") for name in pins})
    others = re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    assert not {name.lower() for name in pins} & {name.lower() for name in others}


def test_the_workflows_call_targets_of_the_makefile():
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    called = {
        step["run"]
        for path in WORKFLOWS
        for job in yaml.safe_load(path.read_text())["jobs"].values()
        for step in job["steps"]
        if step.get("run", "").startswith("make ")
    }
    assert called == {"make lint", "make test", "make docs"}
    assert {line.removeprefix("make ") for line in called} <= set(targets)
