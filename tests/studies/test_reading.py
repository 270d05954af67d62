"""The study of readings of the paper."""

import dataclasses
import shutil

import numpy as np
import pytest

from musebot.protocols.analysis.scores import main_effect
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.experiment.experiment import differing
from musebot.protocols.experiment.overrides import READINGS
from musebot.protocols.results.run_files import BRAINS_FILE, CURVES_FILE
from musebot.protocols.storage import save_arrays
from musebot.protocols.studies.reading import study
from musebot.protocols.studies.reading.choices import CHOICES, DESIGN, FINALISTS, PLAIN
from musebot.protocols.studies.reading.page import standard_error
from musebot.protocols.studies.reading.study import Reading
from musebot.protocols.studies.study import conduct

TINY = Reading(robots=6, newborns=4, screened=6, finalists=6, time_scale=0.001)


def test_the_design_is_balanced_and_its_columns_are_orthogonal():
    assert np.array_equal(DESIGN.T @ DESIGN, 12 * np.eye(11))
    assert (DESIGN.sum(axis=0) == 0).all()
    assert len(CHOICES) == 8


def test_every_choice_has_the_plain_readings_value_first():
    plain = TINY.plans()[PLAIN].experiment
    for name, value in (pair for choice in CHOICES for pair in choice.values[0].items()):
        part, _, inner = name.partition(".")
        own = getattr(plain, part)
        own = getattr(own, inner) if inner else own
        assert own == value or (name == "motor_speed" and own is None)  # the model's is 0.2


def test_the_first_stage_is_the_reading_plain():
    experiment = TINY.plans()[PLAIN].experiment
    assert {name: getattr(experiment, name) for name in READINGS[PLAIN]} == READINGS[PLAIN]
    assert set(differing(experiment, TINY.screen()["screen-12"].experiment)) >= {
        "nose", "nose_place", "turned_start", "kinematics.wall", "brain.bootstrap",
    }  # fmt: skip


def test_newborns_differ_from_the_plain_reading_in_what_their_name_says():
    cells = TINY.cells()
    assert len(cells) == 48
    own, _ = cells["spot-refuses-200mm-centre"]
    other, task = cells["spot-holds-300mm-front"]
    assert task == "spot_finding"
    assert set(differing(own, other)) == {"motor_speed", "nose_place", "kinematics.wall"}
    assert other.motor_speed == 0.3


@pytest.fixture(scope="module")
def finished(tmp_path_factory, in_process):
    out = tmp_path_factory.mktemp("reading") / "out"
    first = conduct(dataclasses.replace(TINY, stage=0), out, in_process())
    return out, first, conduct(TINY, out, in_process())


def test_a_study_that_was_stopped_after_a_stage_continues(finished):
    out, first, page = finished
    assert "Stage 0" in first.markdown
    assert "Stage 1" not in first.markdown
    assert first.markdown in page.markdown
    assert {f"screen-{k:02}" for k in range(1, 13)} < {path.name for path in out.iterdir()}


def test_a_finalist_differs_from_the_plain_reading_in_what_it_says():
    plans = TINY.finals()
    plain = plans["final-plain"].experiment
    assert plain.seed not in {one.experiment.seed for one in TINY.screen().values()}
    for name, finalist in FINALISTS.items():
        assert set(differing(plain, plans[name].experiment)) == set(finalist.fields)
        assert {c.task for c in plans[name].robots} == set(finalist.tasks)
        assert {c.proposer for c in plans[name].robots} == set(finalist.proposers)


def test_the_page_has_a_row_of_each_finalist(finished):
    *_, page = finished
    table = page.markdown.partition("### Stage 3")[2]
    for finalist in FINALISTS.values():
        (row,) = (line for line in table.splitlines() if line.startswith(f"| {finalist.says} |"))
        cells = [cell.strip() for cell in row.strip("|").split("|")][1:]
        assert [bool(cell) for cell in cells[:6]] == [
            task in finalist.tasks and proposer in finalist.proposers
            for task in ("wall_avoidance", "spot_finding")
            for proposer in ("fixed", "random", "creative")
        ]
        tables = [word.split()[0] for word in cells[8].split(", ") if word]
        names = {"wall_avoidance": "wall", "spot_finding": "spot"}
        wanted = [names[task] for task in finalist.tasks] if finalist.fields else []
        assert tables == wanted


def test_a_study_made_before_the_last_stage_was_known_is_continued(
    finished, tmp_path, monkeypatch, in_process
):
    """As docs/results/reading: its study.json names no finalist."""
    monkeypatch.setattr(study, "FINALISTS", {})
    conduct(dataclasses.replace(TINY, stage=0), tmp_path, in_process())
    monkeypatch.undo()
    conduct(dataclasses.replace(TINY, stage=0), tmp_path, in_process())
    monkeypatch.setattr(study, "FINALISTS", {})
    with pytest.raises(InputError, match="holds a study of .*final-plain.*, not of "):
        conduct(dataclasses.replace(TINY, stage=0), tmp_path, in_process())


def test_a_finished_study_gives_a_verdict_on_each_choice(finished):
    *_, page = finished
    for choice in CHOICES:
        assert f"| {choice.says} |" in page.markdown
    for row in ("holds for refuses", "300mm for 200mm", "near for pushed", "front for centre"):
        assert f"| {row} |" in page.markdown


@pytest.mark.parametrize("content", ["other", "short"])
def test_a_newborns_file_of_another_cell_is_named_and_refused(content, finished, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(finished[0], out)
    job = next(job for job in TINY.newborn_jobs(out) if job.done())
    steps = np.zeros(TINY.newborns if content == "other" else 3, dtype=np.int32)
    save_arrays(job.path, {"steps": steps}, cell="another", proposer=job.condition.proposer)
    with pytest.raises(DamagedFileError, match=job.path.name):
        TINY.check(out)


def test_the_error_of_an_effect_is_that_of_columns_whose_effect_is_known_to_be_zero():
    random = np.random.default_rng(0)
    scores = random.normal(size=(2000, len(DESIGN)))
    own = [[main_effect(list(row), column) for column in DESIGN.T] for row in scores]
    errors = [standard_error(row) for row in own]
    found = np.sqrt(np.mean(np.square(errors)))
    assert found == pytest.approx(np.std(np.array(own)[:, 0]), rel=0.05)


def test_the_page_shows_what_is_finished(finished, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(finished[0], out)
    missing = out / "newborns" / "walls-slides-300mm-near-fixed.safetensors"
    moved = missing.rename(tmp_path / "moved")
    text = TINY.page(out).markdown
    moved.rename(missing)
    assert "slides-300mm-pushed" in text
    assert "slides-300mm-near" not in text
    assert TINY.page(out).markdown == finished[2].markdown


def test_runs_that_are_kept_as_rows_alone_are_neither_simulated_again_nor_missed(
    finished, tmp_path, in_process
):
    kept = tmp_path / "kept"
    shutil.copytree(finished[0], kept)
    for path in kept.rglob("*"):
        if path.name in (CURVES_FILE, BRAINS_FILE) and path.parent.name != "plain":
            path.unlink()
    before = {path: path.read_bytes() for path in kept.rglob("*.csv")}
    assert conduct(TINY, kept, in_process()).markdown == finished[2].markdown
    assert {path: path.read_bytes() for path in kept.rglob("*.csv")} == before
    assert not (kept / "screen-01" / CURVES_FILE).exists()
