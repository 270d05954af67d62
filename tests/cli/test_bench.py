"""The measurement of speed: ratios, complete numbers. No speed is asserted."""

import json
import math
import re
import weakref
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from musebot.protocols.cli import parser as cli
from musebot.protocols.cli import speed
from musebot.protocols.errors import RunError
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment

TIMES = st.lists(st.tuples(*[st.floats(1e-6, 1e3)] * 2), min_size=1, max_size=9)


@given(TIMES, st.integers(1, 10**6))
def test_a_ratio_is_the_rate_of_the_work_relative_to_the_reference(times, robot_steps):
    pairs = [(1e6, 1e-6), *times]  # the first one warms up
    clock = [now for a, b in pairs for now in (0.0, a, a + b)]
    with patch.object(speed.time, "thread_time", side_effect=clock):
        found = speed.paired(robot_steps, len(times), lambda: None, lambda: None)
    work, reference = zip(*times, strict=True)
    assert found["rate"] == pytest.approx(robot_steps / np.median(work))
    assert found["rate_alone"] == pytest.approx(robot_steps / np.median(reference))
    ratios = sorted(b / a for a, b in times)
    assert (found["lowest"], found["highest"]) == pytest.approx((ratios[0], ratios[-1]))
    assert found["ratio"] == pytest.approx(np.median(ratios))


@pytest.mark.parametrize("body", ["mujoco", "kinematic"])
def test_the_timed_robots_learn(body):
    experiment = Experiment(body=body, cohort_size=3)
    timed = speed.cohort_in_training(experiment, Condition("spot_finding", "creative"))
    before = {name: array.copy() for name, array in timed.agent.weights().items()}
    speed.life(timed, 10, repetitions=2)
    after = timed.agent.weights()
    assert all(not np.array_equal(before[name], after[name]) for name in before)


def test_the_physics_alone_repeats_a_life_and_another_one_is_refused():
    experiment = Experiment(cohort_size=3)
    timed, plain = (
        speed.cohort_in_training(experiment, Condition("wall_avoidance", "creative"))
        for _ in range(2)
    )
    recorded = timed.recorded()
    timed.recorded = lambda: recorded
    live, replay = speed.against_mujoco(timed, 5)
    live(), replay()
    plain.advance(5)
    for name, array in timed.batch.arrays().items():
        np.testing.assert_array_equal(array, plain.batch.arrays()[name])
    live()
    recorded[3] *= -1
    with pytest.raises(RunError, match="did not end in the states of the life"):
        replay()


ROWS = {"lives": 16, "interfaces": 4, "backends": 1}


@pytest.mark.parametrize(("words", "rows"), [([], ROWS), (["--device", "cpu"], {"populations": 4})])
def test_a_quick_run_keeps_every_number_that_it_prints(words, rows, tmp_path, capsys):
    pytest.importorskip("mujoco_warp" if words else "gymnasium")
    assert cli.main(["bench", "--quick", "--json", str(tmp_path / "b.json"), *words]) == 0
    text = capsys.readouterr().out
    found = json.loads((tmp_path / "b.json").read_text())
    assert "too short to be quoted" in text and found["machine"]["quick"] is True
    assert {name: len(own) for name, own in found.items() if name != "machine"} == rows
    kept = []
    for name in rows:
        for row in found[name]:
            kept += [value for value in row.values() if not isinstance(value, str)]
            assert row["lowest"] <= row["ratio"] <= row["highest"]
    printed = re.findall(r"(?<=\| )[\d,.]+(?= \|)", text[text.index(next(iter(rows)).title()) :])
    assert len(printed) == len(kept)
    for cell, value in zip(printed, kept, strict=True):
        assert 0 < value < math.inf
        assert float(cell.replace(",", "")) == pytest.approx(value, abs=0.51 if value > 9 else 6e-4)


def test_a_population_without_memory_has_no_numbers_and_is_gone_for_the_next_one(monkeypatch):
    made, make = [], speed.cohort_in_training

    def cohort(*arguments):
        assert all(reference() is None for reference in made)
        made.append(weakref.ref(new := make(*arguments)))
        return new

    def life(cohort, *_):
        raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB.")

    monkeypatch.setattr(speed, "cohort_in_training", cohort)
    monkeypatch.setattr(speed, "life", life)
    monkeypatch.setattr(speed, "SIMULATORS", {"kinematic": {"body": "kinematic"}})
    rows = [*speed.populations(speed.QUICK, "cpu")]
    assert [row.keys() for row in rows] == [{"simulator", "robots"}] * len(made)
    assert len(made) == 2


def test_what_cannot_be_measured_is_refused_in_one_sentence(tmp_path, capsys):
    for option, value, sentence in (
        ("--json", str(tmp_path), "is a folder"),
        ("--device", "gpu", "device must be cpu, cuda or cuda:N, got 'gpu'"),
        ("--device", "cuda:42", "there is no device cuda:42"),
    ):
        assert cli.main(["bench", "--quick", option, value]) == 2
        out, message = capsys.readouterr()
        assert out == "" and sentence in message and message.count("\n") == 1
