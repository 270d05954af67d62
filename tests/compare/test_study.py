"""Conducting a study: what is done once for all of them, shown with a small one."""

import dataclasses
import functools
import json
from typing import ClassVar

import numpy as np
import pytest
from helpers import files_below
from matplotlib.figure import Figure

from musebot.fields import whole
from musebot.protocols.compare import jobs, study
from musebot.protocols.compare.jobs import ArrayJob, simulate_cohort
from musebot.protocols.compare.study import (
    STUDY_FILE,
    Page,
    Study,
    conduct,
    simulate_runs,
)
from musebot.protocols.errors import DamagedFileError, InputError, Interrupted
from musebot.protocols.runs import jobs as runs_jobs
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.protocols.storage import locked, write_json

WALLS = [Condition("wall_avoidance", proposer) for proposer in ("fixed", "random")]


def square(number, progress):
    progress(0.5)
    return {"square": np.array([number**2])}


@dataclasses.dataclass
class Squares(Study):
    """Square numbers, add the squares, and simulate two runs."""

    name: ClassVar[str] = "squares"
    folders: ClassVar[tuple[str, ...]] = ("numbers",)

    numbers: tuple[int, ...] = (1, 2, 3)
    robots: int = 0
    seed: int = whole(1, 1, 99)
    drawn: bool = False

    def identity(self):
        return {"numbers": self.numbers}

    def plans(self):
        if not self.robots:
            return {}
        own = Experiment(body="kinematic", cohort_size=2, time_scale=0.001, seed=self.seed)
        slow = dataclasses.replace(own, motor_speed=0.1)
        plans = {"own": (own, WALLS), "slow": (slow, WALLS[:1])}
        return {name: Plan.of(*plan, self.robots) for name, plan in plans.items()}

    def jobs(self, out):
        return [
            ArrayJob(out / "numbers" / f"{n}.safetensors", functools.partial(square, n), 1.0,
                     {"number": n})
            for n in self.numbers
        ]  # fmt: skip

    def work(self, out, run_jobs):
        simulate_runs(out, self.plans(), run_jobs, self.jobs(out))

    def page(self, out):
        total = sum(int(job.read()["square"][0]) for job in self.jobs(out))
        return Page(f"The sum is {total}.\n", {"squares": Figure()} if self.drawn else {})


class Cubes(Squares):
    name: ClassVar[str] = "cubes"


class OtherPhysics(Squares):
    def experiment(self):
        return Experiment(body="kinematic")


def test_a_study_leaves_its_files_its_page_and_what_identifies_it(tmp_path, in_process):
    out, executor = tmp_path / "new" / "out", in_process()
    page = conduct(Squares(robots=2, drawn=True), out, executor)
    assert page.markdown == "The sum is 14.\n" == (out / "squares.md").read_text()
    names = {"numbers", "own", "slow", "squares.md", "squares.svg", "squares.png", STUDY_FILE}
    assert {path.name for path in out.iterdir()} == names
    costs = [job.cost for job in executor.jobs]
    assert len(costs) == 3 + 2 + 1 and costs == sorted(costs, reverse=True)
    known = json.loads((out / STUDY_FILE).read_text())
    assert (known["study"], known["identity"]) == ("squares", {"numbers": [1, 2, 3]})
    assert [one["musebot"] for one in known["made_with"]]


def test_a_study_that_stops_after_any_job_continues_to_the_same_bytes(tmp_path, in_process):
    conduct(Squares(robots=2), tmp_path / "whole", in_process())
    whole = files_below(tmp_path / "whole")
    for most in range(6):
        out, executor = tmp_path / str(most), in_process()
        with pytest.raises(Interrupted):
            conduct(Squares(robots=2), out, in_process(most=most))
        assert not (out / "squares.md").exists()
        (out / "numbers" / "1.checkpoint").touch()  # of a process that was killed
        (out / ".x.0123456789abcdef.musebot").touch()
        conduct(Squares(robots=2), out, executor)
        assert len(executor.jobs) == 6 - most
        assert files_below(out) == whole


def test_a_study_does_again_what_is_lost_and_nothing_else(tmp_path, in_process):
    conduct(Squares(drawn=True), tmp_path, in_process())
    before = files_below(tmp_path)
    for lost in ("numbers/2.safetensors", "squares.md", "squares.svg"):
        (tmp_path / lost).unlink()
        conduct(Squares(drawn=True), tmp_path, executor := in_process())
        assert files_below(tmp_path) == before
        assert len(executor.jobs) == lost.startswith("numbers")


def test_runs_are_enlarged(tmp_path, in_process):
    executor = in_process()
    for robots in (2, 4, 2):
        conduct(Squares(robots=robots), tmp_path, executor)
    assert len(executor.jobs) == 3 + 2 * (2 + 1)


def refused(asked, out, words, in_process):
    before = files_below(out) if out.is_dir() else None
    with pytest.raises(InputError, match=words) as refusal:
        conduct(asked, out, in_process(most=0))
    assert "\n" not in str(refusal.value)
    assert (files_below(out) if out.is_dir() else None) == before


def test_a_foreign_folder_and_an_invalid_option_are_refused(tmp_path, in_process):
    with pytest.raises(InputError, match="seed must be a whole number from 1 to 99, got 0"):
        Squares(seed=0)
    (tmp_path / "thesis.tex").write_text("precious")
    refused(Squares(), tmp_path, "is not empty and holds no study", in_process)
    refused(Squares(), tmp_path / "thesis.tex", "is not a folder", in_process)


def test_another_study_identity_run_or_physics_is_refused(tmp_path, in_process):
    conduct(Squares(robots=2), tmp_path, in_process())
    for other, words in (
        (Cubes(), "holds the study squares, not cubes"),
        (Squares((1, 2)), r"with numbers \[1, 2, 3\], not \[1, 2\]"),
        (Squares(robots=2, seed=2), "own holds an experiment with seed 1, not 2"),
        (OtherPhysics(), "was simulated in another physics than this"),
    ):
        refused(other, tmp_path, words, in_process)
    with locked(tmp_path):
        refused(Squares(), tmp_path, "another musebot .*is running", in_process)
    with locked(tmp_path / "own"):
        with pytest.raises(InputError, match="running in .*own"):
            conduct(Squares(robots=2), tmp_path, in_process())


def test_a_damaged_or_edited_manifest_or_another_jobs_file_is_refused(tmp_path, in_process):
    conduct(Squares(), tmp_path, in_process())
    path, numbers = tmp_path / STUDY_FILE, tmp_path / "numbers"
    text = path.read_text()
    for content in ("{}", "[]", "nonsense", "[" * 100_000):
        path.write_text(content)
        refused(Squares(), tmp_path, "is no study of musebot's|damaged|nested", in_process)
    path.write_text(text.replace('"python": "', '"python": "1'))
    refused(Squares(), tmp_path, "was changed after musebot had written it", in_process)
    for wrong in ({"identity": ["numbers"]}, {"physics": None}, {"made_with": 3}):
        write_json(path, json.loads(text) | wrong)
        refused(Squares(), tmp_path, "is no study of musebot's", in_process)
    path.write_text(text)
    (numbers / "2.safetensors").write_bytes((numbers / "1.safetensors").read_bytes())
    refused(Squares(), tmp_path, "holds a job with number 1, not 2", in_process)


def test_every_set_of_versions_and_machine_is_recorded_once(tmp_path, in_process, monkeypatch):
    for versions in ("old", "old", "new"):
        monkeypatch.setattr(study, "made_with", lambda versions=versions: {"musebot": versions})
        conduct(Squares(), tmp_path, in_process())
    known = json.loads((tmp_path / STUDY_FILE).read_text())
    assert known["made_with"] == [{"musebot": "old"}, {"musebot": "new"}]


# ---- Jobs ----

EXPERIMENT = Experiment(body="kinematic", backend="numba", cohort_size=2, time_scale=0.0065)  # 62 s
STEPS = sum(EXPERIMENT.life_of("wall_avoidance").steps())


def cohort_job(path):
    path.mkdir()
    work = functools.partial(simulate_cohort, EXPERIMENT, WALLS[0])
    return ArrayJob(path / "a.safetensors", work, EXPERIMENT.robot_seconds(STEPS), {})


def test_a_job_that_is_killed_continues_to_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(runs_jobs, "_CHUNK", 600)  # a minute
    monkeypatch.setattr(jobs, "SAVE_EVERY", 0.0)
    whole, cut = cohort_job(tmp_path / "whole"), cohort_job(tmp_path / "cut")
    assert whole.run(lambda: False, lambda *_: None)
    looks, reported = iter(range(100)), []

    def stop():
        if next(looks) == 1:
            raise KeyboardInterrupt
        return False

    with pytest.raises(KeyboardInterrupt):
        cut.run(stop, lambda *_: None)
    assert not cut.done()
    assert cut.run(lambda: False, lambda seconds, _: reported.append(seconds))
    assert reported[0] == 60 * 2 and reported[-1] == cut.cost
    assert cut.path.read_bytes() == whole.path.read_bytes()
    assert [*cut.path.parent.iterdir()] == [cut.path]
    cut.path.write_bytes(cut.path.read_bytes()[:-1] + b"?")
    with pytest.raises(DamagedFileError):
        cut.read()
