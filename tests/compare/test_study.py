"""Conducting a study: what is done once for all of them, shown with a small one."""

import dataclasses
import importlib
import json
from pathlib import Path
from typing import ClassVar

import pytest
from matplotlib.figure import Figure

from musebot.protocols.cli import parser as cli
from musebot.protocols.compare import STUDIES, study, study_class
from musebot.protocols.compare.jobs import MinuteTick, StoppedError
from musebot.protocols.compare.study import Page, Study, conduct
from musebot.protocols.errors import InputError, Interrupted
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.storage import locked, write_json


@dataclasses.dataclass
class Squares(Study):
    """Square numbers, and add the squares."""

    name: ClassVar[str] = "squares"

    numbers: tuple[int, ...] = (1, 2, 3)
    seed: int = 1

    def experiments(self):
        study.check_positive(numbers=len(self.numbers))
        return {"robots": Experiment(body="kinematic", seed=self.seed)}

    def details(self):
        return {"numbers": self.numbers}

    def folders(self, out):
        return [out / "squares"]

    def stages(self, out):
        yield [Square(out / "squares" / f"{number}", number) for number in self.numbers]
        yield [Sum(out / "sum", out / "squares")]

    def page(self, out):
        if not (out / "sum").exists():
            raise InputError(f"{out} lacks the sum")
        return Page(f"The sum is {(out / 'sum').read_text()}.\n", {"squares": Figure()})


@dataclasses.dataclass
class Cubes(Squares):
    """Another study with the same options."""

    name: ClassVar[str] = "cubes"


class Nothing(Squares):
    """A study without experiments."""

    def experiments(self):
        return {}


@dataclasses.dataclass
class Square:
    path: Path
    number: int
    cost: float = 60.0

    def done(self):
        return self.path.exists()

    def run(self, stop, report):
        self.path.write_text(str(self.number**2))
        return True


@dataclasses.dataclass
class Sum(Square):
    number: Path

    def run(self, stop, report):
        numbers = [int(path.read_text()) for path in self.number.iterdir()]
        self.path.write_text(str(sum(numbers)))
        return True


def paths(jobs):
    return [job.path.name for job in jobs]


def test_a_study_leaves_its_files_its_page_its_figures_and_what_identifies_it(tmp_path, here):
    out = tmp_path / "new" / "out"
    page = conduct(Squares(), out, here)
    assert page.markdown == "The sum is 14.\n" == (out / "squares.md").read_text()
    names = {"squares", "sum", "squares.md", "squares.svg", "squares.png", "study.json"}
    assert {path.name for path in out.iterdir()} == names
    assert paths(here.jobs) == ["1", "2", "3", "sum"]
    known = json.loads((out / "study.json").read_text())
    assert known["study"] == "squares"
    assert known["experiments"]["robots"]["body"] == "kinematic"
    assert known["details"] == {"numbers": [1, 2, 3]}
    assert len(known["physics"]["robots"]) > 1
    assert [one["musebot"] for one in known["made_with"]]


@pytest.mark.parametrize("lost", ["squares/2", "sum", "squares.md", "squares.svg"])
def test_a_study_does_again_what_is_lost_and_nothing_else(tmp_path, here, listing, lost):
    conduct(Squares(), tmp_path, here)
    before = listing(tmp_path)
    here.jobs.clear()
    (tmp_path / lost).unlink()
    for folder in (tmp_path, tmp_path / "squares"):
        (folder / ".x.0123456789abcdef.musebot").write_text("half")  # of a process that was killed
    conduct(Squares(), tmp_path, here)
    assert listing(tmp_path) == before
    assert paths(here.jobs) == ([Path(lost).name] if lost in ("squares/2", "sum") else [])


def test_an_interrupted_study_continues(tmp_path, here):
    def interrupted(jobs, progress):
        yield from here(jobs[:2], progress)
        raise Interrupted

    with pytest.raises(Interrupted):
        conduct(Squares(), tmp_path, interrupted)
    assert not (tmp_path / "squares.md").exists()
    here.jobs.clear()
    conduct(Squares(), tmp_path, here)
    assert paths(here.jobs) == ["3", "sum"]


class Progress(Squares):
    """A study whose page shows what is finished."""

    shows_finished = True

    def page(self, out):
        done = sum(path.exists() for path in (out / "squares" / f"{n}" for n in self.numbers))
        if done == 1:
            raise InputError("one square is too few")
        return Page(f"{done} squares are finished.\n", {"squares": Figure()})


@pytest.mark.parametrize(("most", "text"), [(2, "2 squares are finished.\n"), (1, None)])
def test_a_stopped_study_writes_a_page_of_what_is_finished(tmp_path, in_process, most, text):
    out = tmp_path / "out"
    with pytest.raises(Interrupted):
        conduct(Progress(), out, in_process(most=most))
    page = out / "squares.md"
    unfinished = "*Unfinished: only what is done so far.*\n\n"
    assert (page.read_text() if page.exists() else None) == (text and unfinished + text)
    assert conduct(Progress(), out, in_process()).markdown == "3 squares are finished.\n"
    assert page.read_text() == "3 squares are finished.\n"
    # A finished page is kept, if the study goes on.
    (out / "sum").unlink()
    with pytest.raises(Interrupted):
        conduct(Progress(), out, in_process(most=0))
    assert page.read_text() == "3 squares are finished.\n"


def test_a_page_that_cannot_be_written_does_not_hide_why_a_study_stopped(
    tmp_path, in_process, monkeypatch
):
    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr(study, "_write_unfinished_page", full)
    with pytest.raises(Interrupted):
        conduct(Progress(), tmp_path / "out", in_process(most=2))


@pytest.mark.parametrize("name", ["wear", "proposers", "reading", "evolve"])
def test_studies_that_show_what_is_finished_have_a_page_before_their_first_job(name, tmp_path):
    if name == "evolve":
        pytest.importorskip("cmaes", reason="needs the extra `evolve`")
    found = study_class(name)()
    assert found.shows_finished
    assert isinstance(found.page(tmp_path).markdown, str)


def test_each_finished_job_is_handed_to_the_study(tmp_path, here):
    finished = []

    class Told(Squares):
        def finished(self, job):
            finished.append(job.path.name)

    conduct(Told(), tmp_path, here)
    assert finished == ["1", "2", "3", "sum"]


def refused(asked, out, words, here, listing):
    before = listing(out) if out.is_dir() else None
    here.jobs.clear()
    with pytest.raises(InputError, match=words) as refusal:
        conduct(asked, out, here)
    assert "\n" not in str(refusal.value)
    assert here.jobs == []
    assert (listing(out) if out.is_dir() else None) == before


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path, here, listing):
    (tmp_path / "thesis.tex").write_text("precious")
    refused(Squares(), tmp_path, "is not empty and holds no study of musebot's", here, listing)
    refused(Squares(), tmp_path / "thesis.tex", "is not a folder", here, listing)
    refused(Squares(), tmp_path / "thesis.tex" / "below", "is not a folder", here, listing)


def test_an_invalid_option_is_refused_and_nothing_is_made(tmp_path, here, listing):
    words = "numbers must be at least 1, got 0"
    refused(Squares(()), tmp_path / "out", words, here, listing)
    assert list(tmp_path.iterdir()) == []


def test_another_study_option_or_physics_is_refused(tmp_path, here, listing):
    conduct(Squares(), tmp_path, here)
    for other, words in (
        (Cubes(), "holds the study squares, not cubes"),
        (Squares(seed=2), "holds a study of robots with seed 1, not 2"),
        (Squares((1, 2)), r"with numbers \[1, 2, 3\], not \[1, 2\]"),
        (Nothing(), "holds a study of robots, not of "),
    ):
        refused(other, tmp_path, words, here, listing)
    path = tmp_path / study.STUDY_FILE
    known = json.loads(path.read_text())
    known["physics"]["robots"][0] += 0.001
    write_json(path, known)
    refused(Squares(), tmp_path, "was simulated in another physics than this", here, listing)


def test_a_study_without_experiments_is_refused_in_another_physics(tmp_path, here, listing):
    conduct(Nothing(), tmp_path, here)
    conduct(Nothing(), tmp_path, here)
    path = tmp_path / study.STUDY_FILE
    known = json.loads(path.read_text())
    known["physics"]["default"][0] += 0.001
    write_json(path, known)
    refused(Nothing(), tmp_path, "was simulated in another physics than this", here, listing)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "is no study of musebot's"),
        ("[]", "is no study of musebot's"),
        ('{"study": "squares"}', "is no study of musebot's"),
        ("nonsense", "is damaged"),
        ("[" * 100_000, "is nested too deeply"),
    ],
    ids=["empty", "list", "part", "nonsense", "deep"],
)
def test_a_damaged_or_foreign_manifest_is_refused(tmp_path, here, listing, content, words):
    (tmp_path / study.STUDY_FILE).write_text(content)
    refused(Squares(), tmp_path, words, here, listing)


def test_details_of_a_study_that_are_no_object_are_refused(tmp_path, here, listing):
    conduct(Squares(), tmp_path, here)
    path = tmp_path / study.STUDY_FILE
    write_json(path, json.loads(path.read_text()) | {"details": ["numbers"]})
    refused(Squares(), tmp_path, "its details are no object", here, listing)


def test_an_edited_manifest_is_refused(tmp_path, here, listing):
    conduct(Squares(), tmp_path, here)
    path = tmp_path / study.STUDY_FILE
    path.write_text(path.read_text().replace('"python": "', '"python": "1'))
    refused(Squares(), tmp_path, "was changed after musebot had written it", here, listing)


def test_two_processes_cannot_conduct_a_study_in_one_folder(tmp_path, here, listing):
    with locked(tmp_path):
        refused(Squares(), tmp_path, "another musebot .*is running", here, listing)


def test_every_set_of_versions_and_machine_is_recorded_once(tmp_path, here, monkeypatch):
    for versions in ("old", "old", "new"):
        monkeypatch.setattr(study, "machine", lambda versions=versions: {"musebot": versions})
        conduct(Squares(), tmp_path, here)
    known = json.loads((tmp_path / study.STUDY_FILE).read_text())
    assert known["made_with"] == [{"musebot": "old"}, {"musebot": "new"}]


def test_a_job_counts_its_minutes_and_stops_when_asked():
    reports, asked = [], []
    job = Square(Path("unused"), 1, cost=150.0)
    tick = MinuteTick(job, 1, lambda: bool(asked), lambda *report: reports.append(report))
    for _ in range(3):
        tick()
    asked.append("stop")
    with pytest.raises(StoppedError):
        tick()
    assert reports == [(60.0, ""), (120.0, ""), (150.0, ""), (150.0, "")]


# ---- The command ----


@pytest.mark.parametrize("name", STUDIES)
def test_the_list_has_each_study_and_the_first_line_of_its_docstring(name, capsys):
    module, cls, says = STUDIES[name]
    found = study_class(name)
    assert found.name == name
    assert (found.__module__, found.__name__) == (f"musebot.protocols.studies.{module}", cls)
    assert importlib.import_module(found.__module__).__doc__
    assert (found.__doc__ or "").splitlines()[0] == says
    assert cli.main(["study"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(STUDIES)
    assert any(line.split(maxsplit=1) == [name, says] for line in lines)


@pytest.mark.parametrize("name", STUDIES)
def test_each_study_explains_its_options(name, capsys):
    assert cli.main(["study", name, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert STUDIES[name][2].split(",")[0] in text
    for field in dataclasses.fields(study_class(name)):
        assert f"--{field.name.replace('_', '-')}" in text
    assert "--processes" in text and "OUT" in text


def test_a_study_that_does_not_exist_is_refused(tmp_path, capsys):
    assert cli.main(["study", "astrology", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    sentence = "there is no study 'astrology'; there are sensitivity, reading, ablation"
    assert sentence in message and message.count("\n") == 1
    assert cli.main(["study", "benchmrk", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.endswith("did you mean benchmark?\n")
    assert list(tmp_path.iterdir()) == []


def test_the_command_conducts_a_study_and_prints_its_page(tmp_path, capsys):
    out, options = tmp_path / "out", ["--minutes", "0.05", "--robots", "1", "--processes", "1"]
    assert cli.main(["study", "timestep", str(out), *options]) == 0
    assert capsys.readouterr().out.strip() == (out / "timestep.md").read_text().strip()
    assert cli.main(["study", "timestep", str(out), *options[:2], "--processes", "0"]) == 2
    assert "processes must be at least 1, got 0" in capsys.readouterr().err
