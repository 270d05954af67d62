"""Derived numbers, sections and targets of the benchmark, from invented measurements."""

import pytest

from musebot.protocols.bench import sections
from musebot.protocols.bench.lives import BrainCost, PairedTiming, Setting
from musebot.protocols.bench.measurements import Measurements, as_json, draw, life_steps
from musebot.protocols.bench.models import LIKE_CAR, OURS, EnvironmentCost, StepCost
from musebot.protocols.bench.targets import targets_section
from musebot.protocols.bench.workers import Scaling
from musebot.protocols.pages import style

WA, SF = "wall_avoidance", "spot_finding"
COHORTS = [(WA, p, n) for p in ("fixed", "random", "creative") for n in (50, 250)]
COHORTS += [(SF, p, 250) for p in ("fixed", "random", "creative")]
BLOCK = Setting(WA, "creative", 250, steps=100)  # 25,000 robot-steps


def measurements(total=40, bare=30, steady=(0.45, 0.9), one=2.0, car=4e-6, point=20e-6, peak=1600):
    """Invented measurements.

    A robot-step of the cohort of index i takes `total` + i us in all, 25 of physics and 9 of the
    brain, and `bare` us alone.
    """
    lives = []
    for index, (task, proposer, robots) in enumerate(COHORTS):
        setting = Setting(task, proposer, robots, steps=100)
        us = 1e-6 * setting.robot_steps
        parts = (total + index, 9, 25, bare)
        lives.append(PairedTiming(setting, *((part * us,) for part in parts)))
    brains = {
        task: {"paper": BrainCost(BLOCK, (1.0,), (0.3,)), "steady": BrainCost(BLOCK, (1.5,), (t,))}
        for task, t in zip((WA, SF), steady, strict=True)
    }
    live = Scaling(BLOCK, 4, one=(one,), two=(2.5,), all=(4.0,))
    replay = Scaling(BLOCK, 4, one=(1.0,), two=(1.0,), all=(2.0,))
    steps = {
        OURS: StepCost(OURS, 0.007, 8, 10, 6, 4.0, 12.0, (2e-6,)),
        LIKE_CAR: StepCost(LIKE_CAR, 0.002, 7, 5, 2, 3.0, 14.0, (car,)),
    }
    environments = {
        WA: EnvironmentCost(WA, 14, (300e-6,), (200e-6,)),
        SF: EnvironmentCost(SF, 15, (290e-6,), (200e-6,)),
        "point_mass": EnvironmentCost("point_mass", 1, (80e-6,), (point,)),
    }
    memory = {50: 400.0, 250: 600.0, 1000: float(peak)}
    scaling = {"live": live, "replay": replay}
    timers = (0.9, 0.6)
    return Measurements(
        tuple(lives), tuple(lives[4:6]), brains, timers, scaling, steps, environments, memory
    )


MEASURED = measurements()
# 500 robots, two processes that are 1.6 times as fast as one; sums of us a robot-step.
HOURS = (
    500 * 1e-6 / 1.6 / 3600 * (life_steps(WA) * (41 + 43 + 45) + life_steps(SF) * (46 + 47 + 48))
)


def rows(section):
    """Returns the cells of a section's table by the first cell of each row, without the header."""
    lines = [line for line in section.splitlines() if line.startswith("|")][2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {first: rest for first, *rest in cells}


def test_a_life_has_as_many_steps_as_its_hours():
    assert life_steps(WA) == 160 * 600


def test_json_holds_the_derived_numbers():
    content = as_json(MEASURED)
    raw = content.pop("raw")
    assert raw["memory"] == content["peak_memory_mb"] == {"50": 400, "250": 600, "1000": 1600}
    assert len(raw["lives"]) == len(COHORTS)
    names = ["/".join(map(str, cohort)) for cohort in COHORTS]
    wanted = {
        "throughput_ratio": {
            "fixed": {"50": 30 / 40, "250": 30 / 41},
            "random": {"50": 30 / 42, "250": 30 / 43},
            "creative": {"50": 30 / 44, "250": 30 / 45},
        },
        "throughput_ratio_spot_finding": {
            "fixed": {"250": 30 / 46}, "random": {"250": 30 / 47}, "creative": {"250": 30 / 48}
        },
        "robot_step_us": {name: 40 + index for index, name in enumerate(names)},
        "not_physics_us": {name: 15 + index for index, name in enumerate(names)},
        "cost_us": {
            "50": {"total": 44, "physics": 25, "brain": 9, "rest": 10, "bare": 30},
            "250": {"total": 45, "physics": 25, "brain": 9, "rest": 11, "bare": 30},
        },
        "brain_us": {WA: {"paper": 12, "steady": 18}, SF: {"paper": 12, "steady": 36}},
        "brain_cost_ratio": {WA: 1.5, SF: 3},
        "timers_on_cost_ratio": 1.5,
        "process_scaling": 1.6,
        "process_scaling_bare": 2,
        "step_cost_ratio_car": 0.5,
        "step_cost_us": {OURS: 2, LIKE_CAR: 4},
        "step_cost_ratios": {OURS: 0.5, LIKE_CAR: 1},
        "env_step_overhead_us": 100,
        "point_mass_overhead_us": 60,
        "tables_hours_2_cores": HOURS,
        "peak_memory_mb": {"50": 400, "250": 600, "1000": 1600},
        "realtime_factor": 2500,
    }  # fmt: skip
    assert content.keys() == wanted.keys()
    for name, value in wanted.items():
        assert flat(content[name]) == pytest.approx(flat(value)), name


def flat(value, name=""):
    """Returns the numbers of nested content by their path."""
    if not isinstance(value, dict):
        return {name: value}
    return {k: v for key, part in value.items() for k, v in flat(part, f"{name}/{key}").items()}


def test_lives_are_printed_as_steps_a_second_beside_bare_physics():
    found = rows(sections.lives_section(MEASURED.lives[5:7]))
    assert found == {
        "wall avoidance, creative":
            ["250", "22,222", "33,333", "**0.667**", "0.667 to 0.667", "20.0"],
        "spot finding, fixed":
            ["250", "21,739", "33,333", "**0.652**", "0.652 to 0.652", "21.0"],
    }  # fmt: skip


def test_cost_is_printed_part_by_part():
    assert rows(sections.sizes_section(MEASURED.sizes)) == {
        "50": ["44.0", "25.0", "9.0", "10.0", "30.0", "0.682"],
        "250": ["45.0", "25.0", "9.0", "11.0", "30.0", "0.667"],
    }


def test_brains_are_printed_relative_to_the_papers():
    assert rows(sections.brains_section(MEASURED.brains)) == {
        "wall avoidance, paper": ["12.0", "1.00", "0.300"],
        "wall avoidance, steady": ["18.0", "1.50", "0.300"],
        "spot finding, paper": ["12.0", "1.00", "0.300"],
        "spot finding, steady": ["36.0", "3.00", "0.600"],
    }


def test_timers_that_are_on_come_first():
    assert rows(sections.timers_section(MEASURED.timers, BLOCK)) == {
        "on": ["27,778", "36.0"], "off": ["41,667", "24.0"]
    }  # fmt: skip


def test_processes_are_printed_as_robot_steps_a_second():
    section = sections.scaling_section(MEASURED.scaling)
    assert "| all 4 |" in section
    assert rows(section) == {
        "lives": ["12,500", "20,000", "**1.600**", "25,000"],
        "bare rollout": ["25,000", "50,000", "**2.000**", "50,000"],
    }


def test_physics_steps_are_printed_with_the_size_of_their_model():
    assert rows(sections.steps_section(MEASURED.steps)) == {
        OURS: ["8", "10", "6", "4.0", "12.0", "7.00", "2.00", "**0.500**"],
        LIKE_CAR: ["7", "5", "2", "3.0", "14.0", "2.00", "4.00", "**1.000**"],
    }


def test_steps_of_environments_are_printed_beside_their_physics():
    assert rows(sections.environments_section(MEASURED.environments.values())) == {
        "wall avoidance": ["14", "300.0", "200.0", "**100.0**"],
        "spot finding": ["15", "290.0", "200.0", "**90.0**"],
        "point_mass": ["1", "80.0", "20.0", "**60.0**"],
    }


def test_memory_is_printed_by_the_number_of_robots():
    found = rows(sections.memory_section(MEASURED.memory))
    assert found == {"50": ["400"], "250": ["600"], "1000": ["1600"]}


def test_hours_are_those_of_500_robots_on_two_processes():
    section = sections.hours_section(MEASURED)
    assert "simulate 2,500 robot-seconds a second" in section
    found = rows(section)
    assert len(found) == 7
    hours = 500 * 96_000 * 45e-6 / 1.6 / 3600
    assert found["wall avoidance, creative"] == ["96,000", "45.0", f"{hours:.2f}"]
    assert found["both tables"] == ["", "", f"**{HOURS:.2f}**"]


def test_targets_are_judged_by_the_measurements():
    found = rows(targets_section(MEASURED))
    assert {name: (value, met.strip("*")) for name, (value, _, met) in found.items()} == {
        "creative, 250 robots, over bare": ("0.667", "no"),
        "creative, 50 robots, over bare": ("0.682", "no"),
        "fixed, 250 robots, over bare": ("0.732", "no"),
        "random, 250 robots, over bare": ("0.698", "no"),
        "acting and learning of steady over the paper brain, wall avoidance": ("1.50", "yes"),
        "acting and learning of steady over the paper brain, spot finding": ("3.00", "no"),
        "two processes over one": ("1.600, bare 2.000", "no"),
        "a physics step over car-like": ("0.500", "yes"),
        "env.step outside physics, us": ("100.0, point_mass 60.0", "no"),
        "both tables, hours": (f"{HOURS:.2f}", "yes"),
        "memory of 1000 robots, MB": ("1600", "no"),
    }


def test_each_target_can_be_judged_the_other_way():
    other = measurements(140, 200, (0.9, 0.45), one=2.5, car=2.5e-6, point=0.0, peak=1400)
    judged = [
        [cells[-1].strip("*") for cells in rows(targets_section(one)).values()]
        for one in (MEASURED, other)
    ]
    assert all({*pair} == {"yes", "no"} for pair in zip(*judged, strict=True))


def test_each_part_of_the_cost_has_its_own_line(monkeypatch, tmp_path):
    drawn = []
    monkeypatch.setattr(style, "write", lambda figure, path: drawn.append(figure))
    draw(MEASURED.sizes, tmp_path / "cost.svg")
    lines = {line.get_label(): line for line in drawn[0].axes[0].lines}
    wanted = {"total": [44, 45], "physics": [25, 25], "brain": [9, 9], "rest": [10, 11]}
    assert lines.keys() == wanted.keys()
    for name, heights in wanted.items():
        assert [*lines[name].get_xdata()] == [50, 250]
        assert lines[name].get_ydata() == pytest.approx(heights)
