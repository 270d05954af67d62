"""The benchmark: equal work on both sides, complete figures, errors. No speed is asserted."""

import json
import math
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.protocols.bench import bench, lives, models, population
from musebot.protocols.bench.lives import BrainCost, PairedTiming, Setting, TimedCohort
from musebot.protocols.bench.models import StepCost
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import RunError
from musebot.protocols.lives import runs


def numbers(value):
    """Yields the numbers in nested content; nothing else may be in it, and nothing may be empty."""
    if isinstance(value, (dict, list)):
        assert value
        for part in value.values() if isinstance(value, dict) else value:
            yield from numbers(part)
    else:
        assert isinstance(value, (int, float)) and not isinstance(value, bool)
        yield value


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    files = ["--json", str(folder / "bench.json"), "--figure", str(folder / "cost.svg")]
    command = [sys.executable, "-m", "musebot", "bench", "--quick", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if "measuring" in line]
    assert f", {len(lines)} of {len(lines)}, " in lines[-1] and lines[-1].endswith(" left")
    return folder, done.stdout


def test_json_has_every_figure_finite_and_positive(quick):
    text = (quick[0] / "bench.json").read_text()
    assert "NaN" not in text and "Infinity" not in text
    content = json.loads(text)
    assert content["throughput_ratio"].keys() == {"fixed", "random", "creative"}
    assert all(ratio.keys() == {"50", "250"} for ratio in content["throughput_ratio"].values())
    assert content["peak_memory_mb"].keys() == {"50", "250", "1000"}
    conditions = {
        f"{task}/{proposer}/250" for task in bench.PAPER_TASKS for proposer in bench.PROPOSERS
    }
    small = {f"wall_avoidance/{proposer}/50" for proposer in bench.PROPOSERS}
    assert conditions | small == content["robot_step_us"].keys()  # docs/scaling.md uses them
    assert content["brain_cost_ratio"].keys() == set(bench.PAPER_TASKS)
    assert all(content["brain_us"][t].keys() == {"paper", "steady"} for t in bench.PAPER_TASKS)
    assert content["cost_us"].keys() == {str(robots) for robots in bench.SIZES}
    for name in (
        "throughput_ratio",
        "robot_step_us",
        "brain_us",
        "brain_cost_ratio",
        "process_scaling",
        "process_scaling_bare",
        "step_cost_ratio_car",
        "tables_hours_2_cores",
        "peak_memory_mb",
        "realtime_factor",
    ):
        assert all(0 < x < math.inf for x in numbers(content[name])), name
    # Differences of two times, in a run as short as this, can have any sign.
    for name in ("env_step_overhead_us", "point_mass_overhead_us"):
        assert math.isfinite(content[name])
    assert content["machine"]["quick"] is True
    assert content["machine"]["mujoco"] == mujoco.__version__


def test_json_has_the_seconds_of_every_block(quick):
    raw = json.loads((quick[0] / "bench.json").read_text())["raw"]
    assert [life["setting"]["robots"] for life in raw["sizes"]] == list(bench.SIZES)
    assert len(raw["lives"]) == 9
    for life in raw["lives"]:
        for part in ("life", "brain", "physics", "bare"):
            assert len(life[part]) == 1 and life[part][0] > 0


def test_markdown_has_every_section_and_warns_that_a_quick_run_is_too_short(quick):
    text = quick[1]
    titles = [line for line in text.splitlines() if line.startswith("### ")]
    assert len(titles) == len(set(titles)) == 11
    assert "too short to be quoted" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.endswith("|") for line in tables)
    assert "nan" not in text


def test_figure_is_drawn(quick):
    assert "<svg" in (quick[0] / "cost.svg").read_text()


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
@pytest.mark.parametrize("proposer", ["fixed", "creative"])
def test_bare_replay_ends_in_bit_exact_states_of_the_cohort(task, proposer):
    cohort = TimedCohort(Setting(task, proposer, robots=3, steps=40))
    for _ in range(2):
        before = cohort.state.copy()
        cohort.simulate()
        assert not np.array_equal(before, cohort.state)
        cohort.replay()
        assert np.array_equal(cohort.bare.state, cohort.state)


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_timing_does_not_change_the_cohort(task):
    setting = Setting(task, "creative", robots=3, steps=40)
    timed, plain = TimedCohort(setting), lives.new_cohort(setting)
    lives.begin_training(plain, task)
    timed.simulate()
    plain.advance(setting.steps)
    for name, array in plain.batch.arrays().items():
        np.testing.assert_array_equal(timed.batch.arrays()[name], array)
    for name, array in plain.agent.state().items():
        np.testing.assert_array_equal(timed.agent.state()[name], array)


def test_replay_of_other_motor_commands_is_an_error():
    cohort = TimedCohort(Setting("wall_avoidance", "random", robots=2, steps=5))
    cohort.simulate()
    cohort.batch.motors[3] = -cohort.batch.motors[3]
    with pytest.raises(RunError, match="did not end in the states of the cohort"):
        cohort.replay()


def test_timed_robots_learn():
    cohort = TimedCohort(Setting("wall_avoidance", "creative", robots=2, steps=30))
    before = {name: array.copy() for name, array in cohort.agent.weights().items()}
    cohort.simulate()
    after = cohort.agent.weights()
    assert all(not np.array_equal(before[name], after[name]) for name in before)
    assert cohort.brain_seconds > 0
    assert cohort.physics_seconds > 0


def test_ratios_are_medians_of_blocks():
    setting = Setting("wall_avoidance", "fixed", robots=10, steps=100)
    timing = PairedTiming(
        setting,
        life=(2.0, 4.0, 9.0),
        brain=(0.2,) * 3,
        physics=(1.5, 2.5, 3.5),
        bare=(1.0, 3.0, 3.0),
    )
    assert timing.ratio == 0.5
    us = timing.microseconds
    assert us == pytest.approx(
        {"total": 4e3, "physics": 2.5e3, "brain": 200, "rest": 1300, "bare": 3e3}
    )
    ours = StepCost("ours", 0.01, 8, 10, 6, 4, 10, seconds=(1.0, 2.0, 9.0))
    car = StepCost("car", 0.01, 8, 5, 2, 4, 14, seconds=(2.0, 2.0, 3.0))
    assert ours.ratio(car) == 1.0


def test_brains_are_compared_block_by_block():
    setting = Setting("wall_avoidance", "creative", robots=10, steps=100)
    paper = BrainCost(setting, life=(10.0, 10.0, 10.0), brain=(1.0, 1.0, 2.0))
    ours = BrainCost(setting, life=(12.0, 20.0, 10.0), brain=(3.0, 4.0, 2.0))
    assert ours.ratio(paper) == 3.0
    assert ours.share == 0.2
    assert ours.microseconds == pytest.approx(3000)


def test_brains_are_timed_in_alternation_without_the_first_block():
    order = []

    class FakeCohort:
        def __init__(self, brain):
            self.setting = Setting("spot_finding", "creative", robots=2, steps=5, brain=brain)
            self.brain_seconds = 0.0

        def simulate(self):
            order.append(self.setting.brain)
            self.brain_seconds = float(len(order))
            return 100.0 + len(order)

    costs = lives.brain_costs([FakeCohort("paper"), FakeCohort("steady")], blocks=3)
    assert order == ["paper", "steady"] * 4
    assert list(costs) == ["paper", "steady"]
    assert costs["paper"].brain == (3.0, 5.0, 7.0)
    assert costs["steady"].life == (104.0, 106.0, 108.0)


def test_cohort_has_the_brain_of_its_setting():
    sizes = {}
    for name in ("paper", "steady"):
        cohort = TimedCohort(Setting("spot_finding", "creative", robots=2, steps=5, brain=name))
        assert cohort.setting.experiment.brain == BRAINS[name]
        assert 0 < cohort.simulate() and 0 < cohort.brain_seconds
        sizes[name] = sum(array.size for array in cohort.agent.weights().values())
    assert sizes["paper"] < sizes["steady"]


def test_brain_cost_ratio_is_relative_to_the_papers_brain(quick):
    content = json.loads((quick[0] / "bench.json").read_text())
    for task in bench.PAPER_TASKS:
        ratio = content["brain_cost_ratio"][task]
        paper, steady = (content["raw"]["brains"][task][n]["brain"] for n in ("paper", "steady"))
        assert ratio == pytest.approx(steady[0] / paper[0])  # of one block


def test_blocks_have_similar_lengths_and_end_before_robots_are_placed_again():
    for robots in bench.SIZES:
        setting = bench.FULL.setting("wall_avoidance", "creative", robots)
        blocks = bench.FULL.blocks if robots in (50, 250) else bench.FULL.fewer_blocks
        assert setting.steps * (blocks + 1) < 3000
        assert setting.steps == 500 or 0.9 < setting.robot_steps / 12_500 <= 1


def test_car_has_the_structure_of_mujocos_and_stays_upright():
    model = mujoco.MjModel.from_xml_string(models.CAR)
    counts = (model.nv, model.nu, model.ntendon, model.nsensor, model.ngeom, model.nlight)
    assert counts == (8, 2, 2, 2, 5, 2)
    assert model.opt.timestep == 0.002
    assert model.opt.disableflags == 0
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    for _ in range(300):
        data.ctrl[:] = random.uniform(-1, 1, 2)
        mujoco.mj_step(model, data, 50)
        assert data.body("chassis").xmat[8] > 0.9
    assert np.hypot(*data.qpos[:2]) > 0.05
    assert data.qpos[2] < 0.05


def test_env_step_is_compared_with_its_physics_steps():
    costs = {cost.name: cost for cost in models.environment_costs(rounds=1, steps=5)}
    assert costs["wall_avoidance"].substeps == costs["spot_finding"].substeps == 14
    assert costs["point_mass"].substeps == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--json", "{}"], "is a folder"),
        (["--json", "{}/nowhere/bench.json"], "there is no folder"),
        (["--figure", "{}/cost.txt"], "must be one of .svg, .png, .pdf"),
        (["--figure", "{}/nowhere/cost.svg"], "there is no folder"),
        (["--car-xml", "{}/car.xml"], "is not a model that MuJoCo can read"),
    ],
)
def test_wrong_option_ends_in_one_sentence_before_any_work(arguments, words, tmp_path, capsys):
    assert cli.main(["bench", "--quick", *(part.format(tmp_path) for part in arguments)]) == 2
    out, message = capsys.readouterr()
    assert out == ""  # the machine's section is printed before the first measurement
    assert words in message
    assert message.count("\n") == 1


def test_car_that_is_not_mjcf_is_refused_in_one_sentence(tmp_path, capsys):
    (tmp_path / "car.xml").write_text("<mujoco>\n<wheels/>\n</mujoco>")
    assert cli.main(["bench", "--car-xml", str(tmp_path / "car.xml")]) == 2
    out, message = capsys.readouterr()
    assert out == ""
    assert "car.xml is not a model that MuJoCo can read" in message
    assert message.count("\n") == 1


def test_folder_without_write_permission_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anywhere
    assert cli.main(["bench", "--json", str(tmp_path / "bench.json")]) == 2
    assert "cannot be written" in capsys.readouterr().err


# ---- Populations ----


def test_a_population_is_timed_in_both_worlds(capsys):
    pytest.importorskip("mujoco_warp")
    assert cli.main(["bench", "--device", "cpu", "--quick"]) == 0
    text, said = capsys.readouterr()
    lines = [line for line in said.splitlines() if "measuring" in line]
    assert f", {len(lines)} of {len(lines)}, " in lines[-1]
    assert "### Populations on cpu" in text
    row = next(line for line in text.splitlines() if line.startswith("| 4 |"))
    cells = [cell.strip().replace(",", "") for cell in row.strip("|").split("|")]
    assert all(0 < float(cells[number]) < math.inf for number in range(1, 7))


def test_a_rate_counts_the_steps_of_all_robots_in_each_world(monkeypatch):
    speeds = iter([3.0, 5.0, 7.0, 11.0])  # life and physics of each world

    def once(simulate, block, device, seconds):
        simulate(block)
        return next(speeds)

    monkeypatch.setattr(population, "_steps_a_second", once)
    monkeypatch.setattr(population, "worlds", lambda device: ["kinematic", "C MuJoCo"])
    rate = population.measure("cpu", 2, 0.0)
    assert rate.life == {"kinematic": 6, "C MuJoCo": 14}
    assert rate.physics == {"kinematic": 10, "C MuJoCo": 22}


def test_numbers_are_neither_missing_nor_empty():
    assert [*numbers({"a": [1, 2.5], "b": {"c": 3}})] == [1, 2.5, 3]
    for wrong in ({}, [], None, "1", True, {"a": None}):
        with pytest.raises(AssertionError):
            [*numbers(wrong)]


def test_a_population_that_does_not_fit_is_said_so():
    warp, kinematic = "MuJoCo Warp", "kinematic"
    rate = population.Rate(9, {kinematic: 2e6, warp: None}, {kinematic: 1e6, warp: None},
                           {kinematic: 80.5}, {kinematic: 0.0}, {kinematic: ["sin"]})  # fmt: skip
    text = population.section("cuda", [rate])
    assert (
        "| 9 | 2,000,000 | 1,000,000 | 80.5 | 0.0 | out of memory | out of memory |  |  |" in text
    )
    assert "Longest kernels with the most robots: kinematic: sin." in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--device", "gpu"], "the device must be cpu, cuda or cuda:N, got 'gpu'"),
        (["--device", "cuda:42"], "there is no device cuda:42"),
        (["--device", "cpu", "--interfaces"], "--interfaces cannot be combined with --device"),
        (["--device", "cpu", "--figure", "a.svg"], "--device cannot be combined with --figure"),
    ],
)
def test_a_device_that_cannot_be_measured_is_refused(words, sentence, capsys):
    assert cli.main(["bench", "--quick", *words]) == 2
    assert sentence in capsys.readouterr().err


def test_without_mujoco_warp_a_sentence_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(runs.importlib.util, "find_spec", lambda name: None)
    for words in (["bench", "--device", "cpu"], ["run", str(tmp_path / "x"), "--physics", "warp"]):
        assert cli.main(words) == 2
        assert "pip install 'musebot[warp]' gets it" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
