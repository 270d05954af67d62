"""The file `experiment.json`: written, read, refused where damaged, and readable for ever."""

import dataclasses
import json
import os
import random
from pathlib import Path

import pytest
from hypothesis import given
from strategies import CONDITIONS, plans, quick

from musebot.controller import BRAINS, Parameters
from musebot.models import Kinematics
from musebot.protocols.errors import DamagedFileError, InputError
from musebot.protocols.lives import former_names, provenance
from musebot.protocols.lives.experiment import Experiment
from musebot.protocols.lives.manifest import (
    MANIFEST,
    check_physics,
    experiment_from,
    read_manifest,
    same_physics,
    write_manifest,
)
from musebot.protocols.lives.overrides import named_brain
from musebot.protocols.lives.plan import Plan
from musebot.protocols.storage import write_json

KEPT = Path(__file__).parents[2] / "docs" / "results"


@pytest.fixture
def sound(tmp_path):
    """A folder with a sound manifest."""
    write_manifest(tmp_path, Plan.of(Experiment(), CONDITIONS, 100))
    return tmp_path


def content_of(folder):
    return json.loads((folder / MANIFEST).read_text())


def change(folder, **changes):
    """Replaces values of the experiment ("brain" in part), or other values of the manifest."""
    content = content_of(folder)
    for name, value in changes.items():
        if name == "brain":
            content["experiment"]["brain"] |= value
        elif name == "experiment":
            content["experiment"] |= value
        else:
            content[name] = value
    write_json(folder / MANIFEST, content)


def assert_damaged(folder):
    with pytest.raises(DamagedFileError) as caught:
        read_manifest(folder)
    assert str(folder / MANIFEST) in str(caught.value)


# Writing and reading


@quick
@given(plans())
def test_a_plan_survives_its_manifest(tmp_path_factory, plan):
    folder = tmp_path_factory.mktemp("plan")
    write_manifest(folder, plan)
    assert read_manifest(folder) == plan


@pytest.mark.parametrize("name", BRAINS)
def test_an_experiment_keeps_its_brain(name, tmp_path):
    write_manifest(tmp_path, Plan.of(Experiment(brain=named_brain(name)), CONDITIONS, 50))
    kept = read_manifest(tmp_path).experiment
    assert kept.brain == BRAINS[name]
    assert kept.brain_name == name


def test_the_plan_is_a_list_of_tasks_proposers_and_robots(tmp_path):
    plan = Plan(Experiment(cohort_size=2), {CONDITIONS[0]: 4, CONDITIONS[5]: 2})
    write_manifest(tmp_path, plan)
    assert content_of(tmp_path)["plan"] == [
        {"task": "wall_avoidance", "proposer": "fixed", "robots": 4},
        {"task": "spot_finding", "proposer": "creative", "robots": 2},
    ]


def test_a_manifest_says_what_the_run_was_made_with(sound):
    assert content_of(sound)["made_with"] == [provenance.machine()]


def test_a_manifest_names_every_machine_that_continued_the_run(sound, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1000)
    for _ in range(2):
        write_manifest(sound, read_manifest(sound))
    here, there = content_of(sound)["made_with"]
    assert there["cores"] == 1000 != here["cores"]
    write_manifest(sound, read_manifest(sound), begun=False)  # neither simulated any of it
    (there,) = content_of(sound)["made_with"]
    assert there["cores"] == 1000


# Physics


def test_a_run_of_another_physics_is_refused_and_left_alone(sound):
    assert same_physics(sound)
    check_physics(sound)
    physics = content_of(sound)["physics"]
    change(sound, physics=[physics[0] + 1e-5, *physics[1:]])
    before = (sound / MANIFEST).read_bytes()
    assert not same_physics(sound)
    sentence = f"{sound} was simulated in another physics than this version's: "
    with pytest.raises(InputError) as caught:
        check_physics(sound)
    assert str(caught.value) == sentence + "its robots and new ones must not be mixed"
    assert (sound / MANIFEST).read_bytes() == before


# Manifests of earlier versions

# Each name and value that an earlier version wrote, and this version's.
OLD_BRAIN = [
    ({"centred": True}, {"centred_inputs": True}),
    ({"reward": "signal"}, {"reward_form": "signal"}),
    ({"reward": "change"}, {"reward_form": "difference"}),
    ({"lingering": 0.5}, {"reward_decay": 0.5}),
    ({"next_value": "selected"}, {"bootstrap": "on_policy"}),
    ({"next_value": "best"}, {"bootstrap": "max"}),
    ({"next_value_capped": True}, {"clipped_bootstrap": True}),
    ({"action_gap": 0.8}, {"advantage_scale": 0.8}),
    ({"error_limit": 0.3}, {"td_error_limit": 0.3}),
    ({"optimizer": "plain"}, {"optimizer": "sgd"}),
    ({"optimizer": "adam"}, {"optimizer": "adam"}),
    ({"memory_goal": "selected"}, {"memory_target": "selected"}),
    ({"memory_goal": "best"}, {"memory_target": "best"}),
    ({"held_steps": 15}, {"exploration_steps": 15}),
    ({"young_epsilon": 0.3}, {"initial_epsilon": 0.3}),
    ({"epsilon_youth": 12000}, {"epsilon_decay_steps": 12000}),
    ({"young_learn_rate": 0.002}, {"initial_learn_rate": 0.002}),
    ({"learn_rate_youth": 31200}, {"learn_rate_decay_steps": 31200}),
    ({"content_steps": 600}, {"stopping_steps": 600}),
]
UNCHANGED_BRAIN = [
    {"raw_signals": True},
    {"raw_reward": True},
    {"random_share": 0.32},
    {"keep_main_idea": True},
    {"noise_on_biases": True},
    {"noisy_share": 0.5},
    {"noise": 0.5},
    {"ideas": 9},
    {"activation": "tanh"},
]
OLD_EXPERIMENT = [
    ({"course": "paper"}, {"protocol": "paper"}),
    ({"course": "walls"}, {"protocol": "walls"}),
    ({"course": "day"}, {"protocol": "continual"}),
]
PAPERS_BRAIN = 13  # parameters of the paper, which are written in every manifest


def first_manifest():
    """Returns the fields of an experiment as the first version wrote them."""
    fields = dataclasses.asdict(Experiment())
    fields["brain"] = dict([*fields["brain"].items()][:PAPERS_BRAIN])
    del fields["kinematics"], fields["protocol"]
    return json.loads(json.dumps(fields))


def ids(changes):
    return " ".join(f"{name}={value}" for name, value in changes.items())


@pytest.mark.parametrize(("old", "new"), OLD_BRAIN, ids=ids)
def test_a_brain_with_old_names_is_read_as_the_one_with_new_names(old, new):
    fields = first_manifest()
    fields["brain"] |= old
    assert experiment_from(fields) == Experiment(brain=Parameters(**new))


@pytest.mark.parametrize("same", UNCHANGED_BRAIN, ids=ids)
def test_a_name_that_never_changed_is_read_as_it_is(same):
    fields = first_manifest()
    fields["brain"] |= same
    assert experiment_from(fields) == Experiment(brain=Parameters(**same))


@pytest.mark.parametrize(("old", "new"), OLD_EXPERIMENT, ids=ids)
def test_an_experiment_with_old_names_is_read_as_the_one_with_new_names(old, new):
    assert experiment_from(first_manifest() | old) == Experiment(**new)


def test_the_tables_of_old_names_hold_every_old_name_and_value():
    pairs = [*OLD_BRAIN, *OLD_EXPERIMENT]
    tested = [(next(iter(o.items())), next(iter(n.items()))) for o, n in pairs]
    names = {old: new for (old, _), (new, _) in tested if old != new}
    assert names == former_names._RENAMED
    values = {(old, o): n for (old, o), (_, n) in tested if o != n}
    assert values == former_names._RENAMED_VALUES
    now = {field.name for kind in (Experiment, Parameters) for field in dataclasses.fields(kind)}
    assert set(names.values()) <= now and not set(names) & now


def test_what_is_written_now_has_new_names_only_and_is_read_unchanged():
    for brain in BRAINS.values():
        experiment = Experiment(brain=brain, protocol="continual")
        fields = json.loads(json.dumps(dataclasses.asdict(experiment)))
        assert not {*fields, *fields["brain"]} & set(former_names._RENAMED)
        assert experiment_from(fields) == experiment


def test_the_first_version_had_the_papers_brain_and_protocol():
    assert experiment_from(first_manifest()) == Experiment()


@pytest.mark.parametrize(("name", "count"), [("paper", 0), ("steady", 8)])
def test_a_number_of_random_ideas_is_read_as_their_share(name, count, tmp_path):
    write_manifest(tmp_path, Plan.of(Experiment(brain=named_brain(name)), CONDITIONS, 50))
    content = content_of(tmp_path)
    content["experiment"]["brain"]["random_ideas"] = count
    del content["experiment"]["brain"]["random_share"]
    write_json(tmp_path / MANIFEST, content)
    assert read_manifest(tmp_path).experiment.brain == BRAINS[name]


@pytest.mark.parametrize(
    ("removed", "readable"),
    [
        ({"judge_rate": 1.0, "noticed_signals": False, "capped": False, "ages_with": "time"}, True),
        ({"judge_rate": 0.02}, False),
        ({"noticed_signals": True}, False),
        ({"capped": True}, False),
        ({"ages_with": "reward"}, False),
        ({"ages_with": "time_and_reward"}, False),
    ],
)
def test_a_removed_parameter_is_ignored_where_it_had_no_effect(removed, readable, sound):
    change(sound, brain=removed)
    if readable:
        assert read_manifest(sound).experiment.brain == Parameters()
    else:
        assert_damaged(sound)


KEPT_MANIFESTS = sorted(KEPT.rglob(MANIFEST))


@pytest.mark.parametrize(
    "path", KEPT_MANIFESTS, ids=lambda path: str(path.parent.relative_to(KEPT))
)
def test_a_kept_run_is_readable_with_the_meaning_it_had(path):
    plan = read_manifest(path.parent)
    fields = json.loads(path.read_text())["experiment"]
    rows = json.loads(path.read_text())["plan"]
    assert [(c.task, c.proposer, n) for c, n in plan.robots.items()] == [
        (row["task"], row["proposer"], row["robots"]) for row in rows
    ]
    experiment, brain = plan.experiment, plan.experiment.brain
    defaults = dataclasses.asdict(Experiment()), dataclasses.asdict(Parameters())
    for ours, default, stored in (
        (dataclasses.asdict(experiment), defaults[0], fields),
        (dataclasses.asdict(brain), defaults[1], fields["brain"]),
    ):
        today = translated(stored)
        for name, value in ours.items():
            if name in ("brain", "kinematics"):
                continue
            wanted = today.get(name, default[name])
            assert value == (tuple(wanted) if isinstance(wanted, list) else wanted), name
    assert experiment.kinematics == Kinematics(**fields.get("kinematics", {}))


def translated(stored):
    """Returns stored fields by this version's names, from the tables of these tests."""
    today = dict(stored)
    if "random_ideas" in today:
        today["random_share"] = today.pop("random_ideas") / today["ideas"]
    for old, new in [*OLD_BRAIN, *OLD_EXPERIMENT]:
        (old_name, old_value), (new_name, new_value) = *old.items(), *new.items()
        if old_name in stored:
            value = stored[old_name]
            if old_name != new_name:
                today.pop(old_name, None)
                today.setdefault(new_name, value)
            if value == old_value and isinstance(value, str):
                today[new_name] = new_value
    return today


def test_there_are_kept_runs_of_several_versions():
    assert len(KEPT_MANIFESTS) >= 50
    brains = [json.loads(path.read_text())["experiment"]["brain"] for path in KEPT_MANIFESTS]
    assert len({tuple(brain) for brain in brains}) > 3


# Damage


def test_a_truncated_manifest_is_damaged(sound):
    path = sound / MANIFEST
    whole = path.read_bytes()
    for length in range(len(whole.rstrip())):
        path.write_bytes(whole[:length])
        assert_damaged(sound)


def test_a_flipped_bit_changes_no_plan_or_is_named(sound):
    path = sound / MANIFEST
    whole, plan = path.read_bytes(), read_manifest(sound)
    bits, named = random.Random(0), 0
    for index in range(len(whole)):
        flipped = bytearray(whole)
        flipped[index] ^= 1 << bits.randrange(8)
        path.write_bytes(flipped)
        try:
            assert read_manifest(sound) == plan
        except InputError as error:
            assert str(path) in str(error)
            named += 1
    assert named > len(whole) / 2


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"null", b"[]", b"{}", b'{"experiment": 1}', b"\xff\xfe", b'"experiment"'),
        *(b"[" * 100_000, b'{"experiment":' * 100_000, b"1" * 5000, b"NaN"),
    ],
    ids=lambda content: content[:20].decode(errors="replace"),
)
def test_a_file_of_another_kind_is_damaged(tmp_path, content):
    (tmp_path / MANIFEST).write_bytes(content)
    assert_damaged(tmp_path)


@pytest.mark.parametrize(
    ("group", "changes", "error"),
    [
        ("experiment", {"time_scale": 2}, InputError),
        ("experiment", {"seed": "one"}, InputError),
        ("experiment", {"mood": "good"}, DamagedFileError),
        ("experiment", {"brain": 1}, DamagedFileError),
        ("plan", {"robots": 75}, InputError),
        ("plan", {"robots": 1.5}, InputError),
        ("plan", {"proposer": "divine"}, InputError),
        ("made_with", "nothing", DamagedFileError),
        ("physics", ["heavy"], DamagedFileError),
        ("physics", [float("nan")], DamagedFileError),
        ("physics", [10**400], DamagedFileError),
        ("made_with", [1], DamagedFileError),
        ("plan", {"robots": True}, DamagedFileError),
        ("plan", {"task": "spot_finding"}, DamagedFileError),
        ("experiment", {"turned_start": 10**400}, DamagedFileError),
        ("experiment", {"motor_speed": 10**400}, DamagedFileError),
        ("experiment", {"time_scale": "1"}, DamagedFileError),
        ("experiment", {"time_scale": 10**400}, DamagedFileError),
        ("experiment", {"seed": True}, DamagedFileError),
        ("experiment", {"learn_across_placement": 1}, DamagedFileError),
        ("experiment", {"kinematics": [1]}, DamagedFileError),
        ("experiment", {"nose": ["inverse"]}, DamagedFileError),
        ("brain", {"random_ideas": 1, "ideas": 0}, DamagedFileError),
        ("brain", {"random_ideas": 10**400}, DamagedFileError),
        ("brain", {"fixed_motors": ["a"]}, DamagedFileError),
        ("brain", {"learn_rate": 10**400}, DamagedFileError),
    ],
)
def test_a_manifest_with_an_invalid_value_is_refused(sound, group, changes, error):
    content = content_of(sound)
    if group == "plan":
        content["plan"][0] |= changes
    elif group == "experiment":
        content["experiment"] |= changes
    elif group == "brain":
        content["experiment"]["brain"] |= changes
    else:
        content[group] = changes
    write_json(sound / MANIFEST, content)
    with pytest.raises(error) as caught:
        read_manifest(sound)
    assert str(sound / MANIFEST) in str(caught.value) and len(str(caught.value)) < 600


def test_a_missing_manifest_is_missing_and_not_damaged(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_manifest(tmp_path)
