"""The documents: pages match the code, links lead somewhere, commands parse."""

import dataclasses
import re
import runpy
import shlex
import sys
import unicodedata
from pathlib import Path

import pytest

import musebot
from musebot.controller import Parameters
from musebot.models import Kinematics
from musebot.protocols.cli.parser import parsed
from musebot.protocols.cli.run import Run
from musebot.protocols.cli.verbs import BENCHMARK, VERBS, verb_class
from musebot.protocols.errors import InputError
from musebot.protocols.runs.config import named_brain, read_config, read_life, values_of
from musebot.protocols.runs.experiment import Experiment, changed
from musebot.tasks.lives import CHANGING

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"

sys.path.append(str(DOCS / "generator"))
import check_site  # noqa: E402
import tutorial_notebook  # noqa: E402

SITE = sorted(DOCS.rglob("*.md"))
PAGES = {path: path.read_text() for path in (*ROOT.glob("*.md"), *SITE)}


# Pages and links


@pytest.mark.slow
def test_the_committed_reference_is_what_the_generator_makes():
    pytest.importorskip("gymnasium", reason="needs the extra `gym`")
    pages = runpy.run_path(str(DOCS / "generator"))["reference_pages"]()
    made = {path.as_posix(): text for path, text in pages.items()}
    folder = DOCS / "reference"
    found = {p.relative_to(folder).as_posix(): PAGES[p] for p in SITE if folder in p.parents}
    assert found == made, "run: python docs/generator"


def test_the_menu_and_the_list_of_studies_name_every_page_once():
    menu = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    names = re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", menu, re.MULTILINE)
    names = [name for name in names if name != "studies/index.md"]
    rows = re.findall(r"^\| \[[^]]+\]\(([\w-]+\.md)\)", PAGES[DOCS / "studies/index.md"], re.M)
    names += [f"studies/{row}" for row in [*rows, "index.md"]]
    pages = [path.relative_to(DOCS).as_posix() for path in SITE]  # runs.md has those of results
    pages = [name for name in pages if not name.startswith("results/")]
    assert sorted(names) == sorted(pages)


def anchors(text):
    """Returns the anchors of a page's headings, as the site makes them."""
    found = set()
    for title in re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.M):
        plain = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", title)
        plain = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
        found.add(re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain).strip().lower()))
    return found


def test_every_link_leads_to_a_file_or_heading_and_stays_within_the_site():
    wrong = []
    for path, text in PAGES.items():
        text = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
        for name, anchor in re.findall(r"\]\(([^)\s#:]*)#?([^)\s:]*)\)", text):
            target = (path.parent / name).resolve() if name else path
            outside = DOCS in path.parents and DOCS not in target.parents
            outside |= path.name == "CHANGELOG.md"  # the site shows it in another folder
            lost = anchor and target in PAGES and anchor not in anchors(PAGES[target])
            if outside or lost or not target.exists():
                wrong.append(f"{path.relative_to(ROOT)}: {name}#{anchor}")
    assert not wrong, "\n".join(wrong)


def test_every_path_in_the_documents_exists():
    paths = re.compile(r"`((?:\.ci|controller|docs|models|protocols|tasks|tests)/[\w./-]*\w)`")
    wrong = {
        path
        for page, text in PAGES.items()
        if page.name != "CHANGELOG.md"
        for paragraph in text.split("\n\n")  # behind "commit" stand the paths of that commit
        for path in paths.findall(paragraph.partition("commit")[0])
        if not (ROOT / path).exists()
    }
    assert wrong == set()


def test_a_site_with_a_broken_link_or_a_foreign_script_is_refused(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "index.html").write_text('<h1 id="top">A</h1>')
    (tmp_path / "index.html").write_text(
        '<a href="a/#top">1</a> <a href="a/#low">2</a> <img src="b.png"> <a href="https://x.org">'
        '<script src="https://x.org/y.js"></script>'
    )
    assert check_site.faults(tmp_path) == [
        "index.html: loads https://x.org/y.js",
        "index.html: a/#low does not exist",
        "index.html: b.png does not exist",
    ]


# Commands

PARTS = {"": Experiment, "brain.": Parameters, "kinematics.": Kinematics}
NAMES = [part + field.name for part, cls in PARTS.items() for field in dataclasses.fields(cls)]
WORLD = ("body", "time_scale", "device", "seed")  # options of `run` that are fields
RAY = re.compile("--[a-z-]*port$|--node-ip-address")
PLACEHOLDER = re.compile(r"(\w+\.)?NAME=|\.\.$|agent\.")  # an agent's settings are its own


def commands(text):
    """Yields the commands of a document: lines of blocks, and code within paragraphs.

    Behind the word "commit" in a paragraph stand the commands of that commit.
    """
    blocks = re.compile(r"^```\w*\n.*?^```|(?:^    .*\n)+", re.DOTALL | re.MULTILINE)
    for block in blocks.findall(text):
        yield from re.findall(r"^ *(musebot .*)", block, re.MULTILINE)
    for paragraph in blocks.sub("\n", text).split("\n\n"):
        yield from re.findall(r"`(musebot [^`]+|--[a-z][^`]*)`", paragraph.partition("commit")[0])


def check_command(line, options):
    """Parses a command, and makes the experiment that it sets; options alone are of any verb."""
    first, *words = shlex.split(line, comments=True)
    if first.startswith("--"):
        if first not in options and not RAY.match(first):
            raise InputError(f"there is no option {first}")
        words = ["run", "OUT", first, *words] if "--set" in line and words else ["run"]
    verb, *rest = words
    if verb == "benchmark" and rest:
        verb, *rest = f"benchmark {rest[0]}", *rest[1:]
    if verb not in {"VERB", "--version", *VERBS, *BENCHMARK}:
        raise InputError(f"there is no verb {verb}")
    if verb == "VERB" or not rest:
        return
    command = parsed(verb_class(verb), f"musebot {verb}", rest)
    if isinstance(command, Run):
        named_brain((command.brain or "paper").replace("-NAME", "-adam"))
        values = {name: value for name in WORLD if (value := getattr(command, name)) is not None}
        own = [word for word in command.set if not PLACEHOLDER.match(word)]
        changed(Experiment(), values | values_of(own, NAMES))


def test_every_command_in_the_documents_parses():
    verbs = ({*VERBS} - {"benchmark"}) | {*BENCHMARK}
    fields = [field.name for verb in verbs for field in dataclasses.fields(verb_class(verb))]
    options = {f"--{name.replace('_', '-')}" for name in fields}
    kept = DOCS / "results", DOCS / "reference" / "command.md"  # pages of runs; help texts
    living = {p: text for p, text in PAGES.items() if not {*kept} & {p, *p.parents}}
    makefile = (ROOT / "Makefile").read_text().replace("\t$(VENV)/bin/musebot", "    musebot")
    wrong, checked = [], 0
    for path, text in {**living, ROOT / "Makefile": makefile}.items():
        for line in commands(text):
            checked += 1
            try:
                check_command(line, options)
            except InputError as error:
                wrong.append(f"{path.relative_to(ROOT)}: {line}: {error}")
    assert not wrong, "\n".join(wrong)
    assert checked > 75


# Examples


def test_the_configuration_file_is_read(tmp_path):
    text = PAGES[DOCS / "command.md"]
    (tmp_path / "run.toml").write_text(*re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    config = read_config(tmp_path / "run.toml")
    assert config.values["brain"] == dataclasses.replace(named_brain("steady"), ideas=9)
    assert [*config.robots.values()] == [2, 2]


def test_the_life_of_the_guide_is_read_and_changes(tmp_path):
    text, file = PAGES[DOCS / "lives.md"], tmp_path / "life.toml"
    file.write_text(*re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    assert [leg.changes_world for leg in read_life(file).legs()] == [False, True] + [False] * 11
    rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| [^|]+ \|$", text, re.MULTILINE)
    assert rows == [life.name for life in CHANGING]
    gymnasium = pytest.importorskip("gymnasium")
    from musebot.tasks.gymnasium_env.common import LIFE_INFO

    assert re.findall(r"^\| `(\w+)` \| [^|]+ \|$", text, re.MULTILINE) == [*LIFE_INFO]
    environment = gymnasium.make("musebot/Life-v0", life=str(file))
    assert environment.reset()[1]["learning"] is False  # the first phase is a test
    environment.close()
    file.write_text("name = 'none'")
    with pytest.raises(ValueError, match="a life must have a list of phases"):
        musebot.load("life", str(file))


def test_the_notebook_is_the_tutorial():
    made = tutorial_notebook.notebook(DOCS)
    kept = (DOCS / "notebooks" / "tutorial.ipynb").read_text()
    assert kept == made, "run: python docs/generator"
