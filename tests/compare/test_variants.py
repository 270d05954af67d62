"""Studies of several runs: which runs they keep, continue and refuse."""

import dataclasses
from typing import ClassVar

import pytest

from musebot.protocols.compare.study import Page, conduct
from musebot.protocols.compare.variants import VariantStudy
from musebot.protocols.errors import InputError
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import MANIFEST, write_manifest
from musebot.protocols.lives.plan import Plan, Variant
from musebot.protocols.lives.run_files import read_run
from musebot.protocols.storage import locked, read_json, write_json

WALLS = ("wall_avoidance",)
SLOW = Variant("slow", {"motor_speed": 0.1}, WALLS, ("fixed",))


@dataclasses.dataclass
class TwoRuns(VariantStudy):
    """Simulate two runs."""

    name: ClassVar[str] = "two-runs"

    robots: int = 4
    seed: int = 1

    def baseline(self):
        return Experiment(body="kinematic", cohort_size=2, time_scale=0.001, seed=self.seed)

    def variants(self):
        return [Variant("own", {}, WALLS, ("fixed", "random")), SLOW]

    def page(self, out):
        runs = self.read(out)
        return Page("".join(f"{name}: {len(run.conditions())}\n" for name, run in runs.items()))


def test_a_variant_differs_from_the_baseline_in_its_fields_and_has_its_conditions():
    baseline = Experiment(seed=7)
    assert SLOW.experiment(baseline) == Experiment(seed=7, motor_speed=0.1)
    assert [str(condition) for condition in SLOW.conditions] == ["wall_avoidance/fixed"]
    everywhere = Variant("own", {}).conditions
    assert [str(condition) for condition in everywhere[2:4]] == [
        "wall_avoidance/creative",
        "spot_finding/fixed",
    ]


def test_a_study_keeps_every_run_and_continues(tmp_path, here, listing):
    page = conduct(TwoRuns(), tmp_path, here)
    assert page.markdown == "own: 2\nslow: 1\n"
    assert len(here.jobs) == 2 * (2 + 1)  # all runs together
    names = {path.name for path in (tmp_path / "own").iterdir()}
    assert names == {"experiment.json", "robots.csv", "results.safetensors"}
    assert read_run(tmp_path / "slow").experiment.motor_speed == 0.1

    before = listing(tmp_path)
    for name in ("slow/robots.csv", "two-runs.md"):
        (tmp_path / name).unlink()
    conduct(TwoRuns(), tmp_path, here)
    assert listing(tmp_path) == before


def test_a_study_is_enlarged_but_not_reduced(tmp_path, here, listing):
    conduct(TwoRuns(robots=2), tmp_path, here)
    conduct(TwoRuns(robots=4), tmp_path, here)
    assert len(here.jobs) == 2 * (2 + 1)
    before = listing(tmp_path)
    with pytest.raises(InputError, match="holds 4 robots of wall_avoidance/fixed, more than 2"):
        conduct(TwoRuns(robots=2), tmp_path, here)
    assert listing(tmp_path) == before


def test_a_foreign_run_in_the_place_of_one_is_refused(tmp_path, here, listing):
    conduct(TwoRuns(), tmp_path, here)
    other = dataclasses.replace(SLOW.experiment(TwoRuns().baseline()), seed=2)
    (tmp_path / "slow" / MANIFEST).unlink()
    write_manifest(tmp_path / "slow", Plan.of(other, SLOW.conditions, 4))
    before = listing(tmp_path)
    with pytest.raises(InputError, match="slow holds an experiment with seed 2, not 1"):
        conduct(TwoRuns(), tmp_path, here)
    assert listing(tmp_path) == before


def test_a_run_of_another_physics_is_refused(tmp_path, here, listing):
    conduct(TwoRuns(), tmp_path, here)
    path = tmp_path / "own" / MANIFEST
    content = read_json(path)
    write_json(path, content | {"physics": [0.1234, *content["physics"][1:]]})
    before = listing(tmp_path)
    with pytest.raises(InputError, match="own was simulated in another physics"):
        conduct(TwoRuns(), tmp_path, here)
    assert listing(tmp_path) == before


def test_a_run_that_another_process_simulates_is_refused(tmp_path, here):
    conduct(TwoRuns(), tmp_path, here)
    (tmp_path / "own" / "robots.csv").unlink()
    here.jobs.clear()
    with locked(tmp_path / "own"), pytest.raises(InputError, match="running in .*own"):
        conduct(TwoRuns(), tmp_path, here)
    assert here.jobs == []


def test_a_missing_run_is_named(tmp_path, here):
    conduct(TwoRuns(), tmp_path, here)
    (tmp_path / "slow" / MANIFEST).unlink()
    with pytest.raises(InputError, match="lacks the run slow"):
        TwoRuns().page(tmp_path)


def test_robots_must_be_a_multiple_of_the_cohort_size(tmp_path, here):
    for robots, words in ((3, "multiple of the cohort size, 2, got 3"), (0, "at least 1, got 0")):
        with pytest.raises(InputError, match=words):
            conduct(TwoRuns(robots=robots), tmp_path / "out", here)
    assert list(tmp_path.iterdir()) == []
