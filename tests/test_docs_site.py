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

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
CONFIG = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
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
    # runs.md links the pages of results, studies/index.md those of studies.
    linked = {name for name in pages if name.startswith(("results/", "studies/", BUILT))}
    assert kept == pages - linked | {"studies/index.md"}
    index = (DOCS / "studies" / "index.md").read_text()
    studies = {path.name for path in (DOCS / "studies").glob("*.md")} - {"index.md"}
    assert studies == {*re.findall(r"^\| \[[^]]+\]\(([\w-]+\.md)\)", index, re.M)}
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
