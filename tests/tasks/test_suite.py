"""The table of tasks, and its registration with dm_control."""

import inspect

import numpy as np
import pytest
from dm_control import suite

import musebot
from musebot.models import add_noses, add_obstacles, add_velocity, arena_spec, hide_spot
from musebot.tasks import spot_finding, wall_avoidance
from musebot.tasks.suite import TASKS


@pytest.fixture(params=musebot.ALL_TASKS, ids="/".join)
def task(request):
    return request.param


def episode(environment, steps=30):
    random = np.random.RandomState(0)
    spec = environment.action_spec()
    timesteps = [environment.reset()]
    for _ in range(steps):
        timesteps.append(environment.step(random.uniform(spec.minimum, spec.maximum)))
    return np.stack([np.concatenate(list(t.observation.values())) for t in timesteps])


def test_two_tasks_are_tagged_paper_and_all_others_benchmarking():
    assert set(musebot.PAPER) == {("arena", "wall_avoidance"), ("arena", "spot_finding")}
    assert set(musebot.PAPER) | set(musebot.BENCHMARKING) == set(musebot.ALL_TASKS)
    assert musebot.TASKS_BY_DOMAIN == {"arena": tuple(task for _, task in musebot.ALL_TASKS)}
    assert sorted(musebot.SUITE) == sorted(task for _, task in musebot.ALL_TASKS)


def test_every_task_has_a_documented_factory_of_its_name_in_its_module():
    for name, definition in TASKS.items():
        module = wall_avoidance if name.startswith("wall") else spot_finding
        factory = getattr(module, name)
        assert musebot.SUITE[name] is factory
        assert inspect.getdoc(factory).startswith("Returns ")
        assert definition.name == factory.__name__ == name


def test_tasks_without_additions_have_the_papers_arena():
    for name, definition in TASKS.items():
        spec = arena_spec()
        if name.startswith("wall"):
            hide_spot(spec)
        added = {add_noses, add_obstacles, add_velocity} & set(definition.edits)
        assert (definition.spec().to_xml() == spec.to_xml()) == (not added)


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'moon' does not exist: .*\['arena'\], got 'moon'"):
        musebot.load("moon", "wall_avoidance")
    with pytest.raises(ValueError, match="'dancing' does not exist.*wall_avoidance.*'dancing'"):
        musebot.load("arena", "dancing")


def test_dm_control_finds_the_tasks_after_register(task, monkeypatch):
    others = {name: domain for name, domain in suite._DOMAINS.items() if name != "musebot_arena"}
    monkeypatch.setattr(suite, "_DOMAINS", others)
    with pytest.raises(ValueError, match="'musebot_arena' does not exist"):
        suite.load("musebot_arena", task[1])
    musebot.register()
    musebot.register()
    theirs = suite.load("musebot_arena", task[1], task_kwargs={"random": 1})
    ours = musebot.load(*task, task_kwargs={"random": 1})
    np.testing.assert_array_equal(episode(theirs), episode(ours))
    with pytest.raises(
        ValueError, match="Level 'dancing' does not exist in domain 'musebot_arena'"
    ):
        suite.load("musebot_arena", "dancing")
