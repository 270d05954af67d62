"""The study of an old brain in a changed body: arms, branches, recovery, and the verdict."""

import dataclasses
import shutil

import numpy as np
import pytest

from musebot.models import CHANGES, BodyChange
from musebot.protocols import cli
from musebot.protocols.errors import DamagedFileError
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.simulation.placement import place
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies import jobs
from musebot.protocols.studies.study import conduct
from musebot.protocols.studies.wear import branches, probes
from musebot.protocols.studies.wear.arms import ARMS, FACTORS, FROZEN, NEWBORN, learns, pairs
from musebot.protocols.studies.wear.branches import Branch, BranchJob
from musebot.protocols.studies.wear.page import draw, page
from musebot.protocols.studies.wear.probes import (
    PERIODS,
    REFERENCES,
    TRAINING,
    period,
    probe,
)
from musebot.protocols.studies.wear.recovery import (
    Pair,
    Recovery,
    compared,
    effects,
    mean_minutes,
    noise_pairs,
    noise_pairs_by_share,
    verdict,
)
from musebot.protocols.studies.wear.study import LIVES, Wear

TODAY = "trained-noise-random-old"
TINY = Wear(robots=3, time_scale=0.002, arm=(TODAY, "trained-quiet-random-old", NEWBORN, FROZEN))


# ---- Arms ----


def test_the_arms_are_all_combinations_and_two_controls():
    assert len(ARMS) == 18
    assert {name: len(pairs(name, ARMS)) for name in FACTORS} == dict.fromkeys(FACTORS, 8)
    assert pairs("noise", {TODAY: 0, "trained-quiet-random-old": 0, "born-noise-own-old": 0}) == [
        (TODAY, "trained-quiet-random-old")
    ]


@pytest.fixture(scope="module")
def finished(tmp_path_factory, in_process):
    out = tmp_path_factory.mktemp("wear") / "out"
    return out, conduct(TINY, out, in_process())


@pytest.fixture(scope="module")
def life(finished):
    out, _ = finished
    return TINY._lives(out)[0]


def same(first, second, names=lambda name: True):
    return all(np.array_equal(first[name], second[name]) for name in first if names(name))


def test_an_arm_keeps_what_its_name_says(life):
    old, born = life.brains().part("brain"), life.brains().part("before")
    memory = [name for name in old if name.startswith("memory.")]
    assert memory and not same({n: old[n] for n in memory if n in born}, born)
    states = {name: arm.state(old, born) for name, arm in ARMS.items() if arm.levels}
    assert same(states[TODAY], old)
    for name, state in states.items():
        levels = ARMS[name].levels
        assert same(state, old, lambda n: n.startswith("evaluation."))  # Adam's moments, too
        assert (int(state["age"]) == 0) is (levels["clock"] == "reset")
        reborn = {n: state[n] for n in memory if n in born}
        assert same(reborn, born) is (levels["memory"] == "born")
        assert same({n: state[n] for n in memory}, old) is (levels["memory"] == "trained")


def test_an_arms_brain_has_its_noise_and_its_ideas_and_equally_many_candidates():
    old = TINY.experiment.brain
    quiet = ARMS["born-quiet-own-reset"].brain(old)
    assert (quiet.noise, quiet.random_share) == (0, 0)
    assert ARMS[TODAY].brain(old) == old == ARMS[NEWBORN].brain(old)
    assert {arm.brain(old).ideas for arm in ARMS.values()} == {old.ideas}


# ---- Branches ----


def test_without_a_change_an_old_brain_lives_on_as_if_nothing_had_happened(life, monkeypatch):
    """The robots' own learning, from the checkpoint, is that of an uninterrupted life."""
    monkeypatch.setattr(branches, "CHANGES", {"none": BodyChange("nothing changes")})
    branch = Branch(life, life.brains(), "none", ARMS[TODAY])
    for _ in range(3):
        branch.advance(lambda: None)
    cohort = Cohort(life.experiment, life.key)
    cohort.advance(life.steps)
    before = cohort.batch
    robots = np.arange(before.robots)
    before.place(robots, before.pose)  # the change leaves robots at rest
    cohort.agent.reset()
    for part in range(2):
        if part == 0:
            place(before, TRAINING, cohort._random)
        for _ in range(period(life.experiment)):
            state = before.rules.state(before.sensordata).astype(np.float32)
            motors = cohort.agent.act(state, True)
            cohort.agent.learn(before.rules.reward(before.sensordata).astype(np.float32))
            before.step(motors)
    ours, theirs = branch.agent.state(), cohort.agent.state()
    assert ours.keys() == theirs.keys() and same(ours, theirs)
    assert np.array_equal(branch.batch.pose, before.pose)


def test_a_branch_trains_and_probes_robots_of_the_changed_body(life, monkeypatch):
    edits = []

    def spy(experiment, networks, stream, given, tick):
        edits.append(given)
        return np.zeros(3)

    monkeypatch.setattr(branches, "probe", spy)
    start = Branch(life, life.brains(), "polarity", ARMS[TODAY])
    assert start.batch.dimensions.gains == CHANGES["polarity"].gains == (-1, -1)
    assert np.array_equal(start.batch.valid, life.brains().part("batch")["valid"])
    start.advance(lambda: None)
    assert edits == [[CHANGES["polarity"]]]


def test_a_probe_is_made_in_the_edited_body(life, monkeypatch):
    gains = []

    def spy(batch, agent, steps, tick):
        gains.append(batch.dimensions.gains)
        return np.zeros(batch.robots, dtype=np.int32)

    monkeypatch.setattr(probes, "count_events", spy)
    for edits in ((), [CHANGES["polarity"]]):
        probe(life.experiment, life.brains().part("before"), ("reference", 0, 0), edits)
    assert gains == [(1, 1), (-1, -1)]


def test_a_newborn_is_the_brain_that_the_old_one_was(life):
    newborn = Branch(life, life.brains(), "polarity", ARMS[NEWBORN])
    assert same(newborn.agent.weights(), life.brains().part("before"))


def test_a_frozen_brain_never_learns(life):
    frozen = Branch(life, life.brains(), "polarity", ARMS[FROZEN])
    before = {name: array.copy() for name, array in frozen.agent.weights().items()}
    for _ in range(3):
        frozen.advance(lambda: None)
    assert same(frozen.agent.weights(), before) and len(frozen.shares) == 3


def test_all_arms_of_a_cohort_are_probed_at_the_same_places(finished, monkeypatch):
    out, _ = finished
    seen = {}

    def spy(experiment, networks, stream, edits, tick):
        seen.setdefault(arm, []).append(stream)
        return np.zeros(3)

    monkeypatch.setattr(branches, "probe", spy)
    for arm in TINY.arm:
        life = TINY._lives(out)[0]
        branch = Branch(life, life.brains(), "polarity", ARMS[arm])
        for _ in range(2):
            branch.advance(lambda: None)
    assert len({str(streams) for streams in seen.values()}) == 1 and len(seen) == 4


def stopping_after(count):
    """A function that asks to stop at its count-th call."""
    calls = iter(range(count))
    return lambda: next(calls, None) is None


def test_a_job_that_is_killed_again_and_again_ends_with_the_same_bytes(finished, tmp_path):
    out, _ = finished
    (whole,) = [job for job in TINY._branches(out) if job.arm == TODAY]
    other = dataclasses.replace(whole, folder=tmp_path)
    stops = 0
    while not other.run(stopping_after(7), lambda cost, message: None):
        stops += 1
        assert other.shares() is None and not other.done()
    assert stops > 2 and other.done()
    assert other.path.read_bytes() == whole.path.read_bytes()


def test_a_life_that_is_killed_continues_to_the_same_bytes(finished, tmp_path, monkeypatch):
    out, _ = finished
    monkeypatch.setattr(jobs, "_CHUNK", 20)
    whole = TINY._lives(out)[0]
    other = dataclasses.replace(whole, folder=tmp_path)
    assert not other.run(stopping_after(5), lambda cost, message: None)
    assert not other.run(stopping_after(9), lambda cost, message: None)
    assert other.run(lambda: False, lambda cost, message: None)
    assert other.path.read_bytes() == whole.path.read_bytes()


def test_a_finished_study_is_kept_without_its_lives(finished, tmp_path, in_process):
    out, first = finished
    kept = tmp_path / "kept"
    shutil.copytree(out, kept, ignore=lambda folder, names: {*names} & {"life-0000.safetensors"})
    assert conduct(TINY, kept, in_process()).markdown == first.markdown
    assert not list((kept / LIVES).iterdir())


def test_lives_that_were_deleted_can_be_begun_again_and_stopped(
    finished, tmp_path, in_process, monkeypatch, capfd
):
    out, _ = finished
    kept = tmp_path / "kept"
    shutil.copytree(out, kept, ignore=lambda folder, names: {*names} & {"life-0000.safetensors"})
    more = dataclasses.replace(TINY, arm=(*TINY.arm, "born-noise-own-old"))
    monkeypatch.setattr(jobs, "_CHUNK", 20)
    (life,) = more._lives(kept)
    assert not life.run(stopping_after(5), lambda cost, message: None)
    assert all(job.done() for job in TINY._branches(kept))
    text = conduct(more, kept, in_process()).markdown
    assert "| `born-noise-own-old` |" in text and "run again" not in capfd.readouterr().err


def test_arms_of_other_lives_are_named_and_run_again(finished, tmp_path, here, capfd):
    out, _ = finished
    kept = tmp_path / "kept"
    shutil.copytree(out, kept, ignore=lambda folder, names: {*names} & {"life-0000.safetensors"})
    frozen = kept / "polarity" / "frozen-0000.safetensors"
    arrays, notes = load_arrays(frozen)
    save_arrays(frozen, arrays, **notes | {"life": "another"})
    more = dataclasses.replace(TINY, arm=(*TINY.arm, "born-noise-own-old"))
    conduct(more, kept, here)
    assert "so these run again: polarity, frozen, cohort 0\n" in capfd.readouterr().err
    ran = [job.arm for job in here.jobs if isinstance(job, BranchJob)]
    assert {*ran} == {"frozen", "born-noise-own-old"}
    assert load_arrays(frozen)[1]["life"] != "another"


def test_a_file_of_another_arm_is_named_and_refused(finished, tmp_path):
    out, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    frozen = copy / "polarity" / "frozen-0000.safetensors"
    frozen.write_bytes((copy / "polarity" / "newborn-0000.safetensors").read_bytes())
    with pytest.raises(DamagedFileError, match="frozen-0000.safetensors is another's: its arm is"):
        TINY.check(copy)


def changed(job, folder, change):
    """Returns a job in another folder, whose file is that of a finished job but for a change."""
    other = dataclasses.replace(job, folder=folder)
    arrays, notes = load_arrays(job.path)
    change(arrays, notes)
    save_arrays(other.path, arrays, **notes)
    return other


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda arrays, _: arrays.pop("shares"), "it has no shares"),
        (lambda _, notes: notes.pop("life"), "it has no shares"),
        (lambda arrays, _: arrays.update(shares=arrays["shares"][:, :2]), r"shares are of \(25, 2"),
        (
            lambda arrays, _: arrays.update(shares=np.vstack([arrays["shares"]] * 2)),
            r"its shares are of \(50, 3\)",
        ),
        (lambda arrays, _: arrays.pop("reference"), "its reference is missing or foreign"),
        (
            lambda arrays, _: arrays.update(reference=arrays["reference"][:, :2]),
            "its reference is missing or foreign",
        ),
        (
            lambda arrays, _: arrays.update(shares=arrays["shares"][:3]),
            "its reference is missing or foreign",
        ),
        (lambda arrays, _: arrays.update(reference=arrays["reference"] + 2), "is not within"),
    ],
)
def test_a_damaged_file_of_an_arm_is_refused(change, sentence, finished, tmp_path):
    job = changed(TINY._branches(finished[0])[0], tmp_path, change)
    with pytest.raises(DamagedFileError, match=sentence):
        job.shares()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda _, notes: notes.update(index=1), "it is cohort 1"),
        (
            lambda arrays, _: arrays.update(reference=arrays["reference"][:, :2]),
            "reference has the shape",
        ),
        (lambda arrays, _: arrays.pop("reference"), "is of other robots"),
    ],
)
def test_a_file_of_other_lives_is_refused(change, sentence, life, tmp_path):
    with pytest.raises(DamagedFileError, match=sentence):
        changed(life, tmp_path, change).check()


@pytest.mark.parametrize(("more", "references"), [(1, 0), (-1, REFERENCES)])
def test_a_life_of_another_step_than_its_probes_is_refused(more, references, life, tmp_path):
    other = dataclasses.replace(life, folder=tmp_path)
    cohort = Cohort(life.experiment, life.key)
    cohort.advance(life.steps + more)
    other._save(cohort, np.zeros((references, 3)))
    with pytest.raises(DamagedFileError, match="is not before the change"):
        other.check()


def test_more_robots_and_arms_are_added_to_a_study(finished, tmp_path, here):
    out, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    more = dataclasses.replace(TINY, arm=(*TINY.arm, "born-noise-own-old"))
    text = conduct(more, copy, here).markdown
    assert [job.arm for job in here.jobs if isinstance(job, BranchJob)] == ["born-noise-own-old"]
    assert "| `born-noise-own-old` |" in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--change", "colour"], "the change must be one of polarity, half-gain, turned-nose, "),
        (["--arm", "trained"], "the arm must be one of trained-noise-random-old, "),
        (["--arm", FROZEN, FROZEN], "arm must name different ones, got frozen frozen"),
        (["--robots", "0"], "robots must be at least 1, got 0"),
        (["--time-scale", "0"], "the time scale must lie in"),
        (["--kinematics", "lag=-1"], "lag must be finite and not negative"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(words, sentence, tmp_path, capsys):
    assert cli.main(["study", "wear", str(tmp_path / "out"), *words]) == 2
    complaint = capsys.readouterr().err
    assert sentence in complaint and complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


# ---- Recovery ----


def recovery(minutes, reference=0.8, robots=None):
    """Robots that reach their reference at these minutes; None for never."""
    minutes = [minutes] * (robots or 1) if robots else minutes
    shares = np.zeros((PERIODS + 1, len(minutes)))
    for robot, minute in enumerate(minutes):
        if minute is not None:
            shares[minute // 10 :, robot] = 0.9 * reference
    return Recovery(shares, np.full(len(minutes), reference))


def test_recovery_is_the_first_probe_at_nine_tenths_of_the_reference():
    own = recovery([0, 30, None, 240])
    assert own.durations.times.tolist() == [0, 30, 240, 240]
    assert own.durations.happened.tolist() == [True, True, False, True]
    assert mean_minutes(own) == (0 + 30 + 240 + 240) / 4
    below = Recovery(own.shares * 0.999, own.reference)
    assert not below.durations.happened.any()


def test_robots_that_had_learned_nothing_are_left_out():
    own = Recovery(np.ones((PERIODS + 1, 3)), np.array([0.49, 0.5, np.nan]))
    assert own.learned.tolist() == [False, True, False]
    assert np.isnan(own.minutes).tolist() == [True, False, True]


def test_a_stopped_robot_is_censored_when_it_stops():
    own = recovery([None, 100])
    own.shares[6:, 0] = np.nan
    assert own.durations.times.tolist() == [50, 100]
    assert own.durations.happened.tolist() == [False, True]


def four(random, own):
    """Arms with a trained memory: minutes with and without noise, by kind of ideas."""
    arms = {}
    for ideas, (noise, quiet) in (("random", random), ("own", own)):
        for clock in ("old", "reset"):
            arms[f"trained-noise-{ideas}-{clock}"] = noise
            arms[f"trained-quiet-{ideas}-{clock}"] = quiet
    return arms


FAST, SLOW, NEVER = recovery(20, robots=40), recovery(120, robots=40), recovery(None, robots=40)


@pytest.mark.parametrize(
    ("arms", "sentence"),
    [
        (four((FAST, NEVER), (FAST, NEVER)), "The claim holds: noise is essential."),
        (four((FAST, SLOW), (FAST, NEVER)), "Noise helps, but is not essential."),
        (four((FAST, FAST), (FAST, NEVER)), "The claim fails: noise helps only where no ideas"),
        (four((SLOW, FAST), (FAST, FAST)), "The claim fails: noise hinders."),
        (four((SLOW, SLOW), (FAST, FAST)), "The claim fails: noise has no detectable effect."),
        (four((SLOW, FAST), (FAST, SLOW)), "The claim fails: noise helps only where no ideas"),
        (four((FAST, SLOW), (FAST, FAST)), "Mixed: noise helps trained-noise-random-old, "),
    ],
)
def test_the_verdict_is_the_first_line_of_the_rule_that_holds(arms, sentence):
    assert verdict(arms, noise_pairs(arms)).startswith(sentence)
    assert verdict(arms, noise_pairs_by_share(arms)).startswith(sentence)


@pytest.mark.parametrize("absent", ["random-old", "random-reset", "own-old", "own-reset"])
def test_there_is_no_verdict_until_all_pairs_are_there(absent):
    arms = four((FAST, FAST), (FAST, NEVER))
    del arms[f"trained-quiet-{absent}"]
    sentence = f"No verdict: not finished: trained-quiet-{absent}."
    assert verdict(arms, noise_pairs(arms)) == sentence


def test_the_reset_pairs_suffice_without_any_other_clock():
    arms = four((FAST, FAST), (FAST, NEVER))
    arms = {name: arm for name, arm in arms.items() if name.endswith("reset")}
    assert verdict(arms, noise_pairs(arms)).startswith("The claim fails: noise helps only")


def test_shares_of_time_after_the_first_probe_are_compared_in_pairs():
    random = np.random.default_rng(3)
    first, second = recovery(20, robots=40), recovery(20, robots=40)
    level = random.uniform(0.3, 0.8, 40)
    second.shares[:] = level
    first.shares[:] = level + 0.02 + random.normal(0, 0.01, 40)
    first.shares[0] = 0.9  # the probe before any training does not count
    first.shares[-1, 0] = np.nan  # a robot that was stopped
    second.reference[1] = 0.1  # a robot that had not learned
    arms = four((first, second), (first, first))
    found, *_, nothing = noise_pairs_by_share(arms)
    assert np.isnan(first.spot).tolist() == [True] + 39 * [False]
    assert np.isnan(second.spot).tolist() == [False, True] + 38 * [False]
    expected = (first.shares[1:, 2:] - second.shares[1:, 2:]).mean()
    assert found.difference == pytest.approx(expected) and found.p < 0.001 and found.sign == 1
    assert (nothing.difference, nothing.p, nothing.sign) == (0.0, 1.0, 0)
    worse, *_ = noise_pairs_by_share(four((second, first), (first, first)))
    assert worse.sign == -1 and worse.difference == pytest.approx(-expected)


def test_a_born_memory_does_not_decide():
    arms = four((FAST, FAST), (FAST, FAST))
    arms |= {"born-noise-own-old": FAST, "born-quiet-own-old": NEVER}
    assert verdict(arms, noise_pairs(arms)).endswith("noise has no detectable effect.")
    assert verdict({}, []) == "No noise pair with a trained memory is finished."
    nothing = recovery([None], reference=0.1)
    arms = four((nothing, nothing), (nothing, nothing))
    assert verdict(arms, noise_pairs(arms)) == "Undecided: no robot had learned."


def test_a_change_that_costs_nothing_tells_nothing():
    at_once = recovery(0, robots=40)
    arms = four((at_once, at_once), (at_once, at_once))
    sentence = "Undecided: the change cost most robots nothing."
    assert verdict(arms, noise_pairs(arms)) == sentence
    arms = four((at_once, FAST), (FAST, SLOW))
    assert verdict(arms, noise_pairs(arms)) != sentence
    arms |= {FROZEN: recovery([0] * 20 + [None] * 20)}
    assert verdict(arms, noise_pairs(arms)) != sentence
    mostly = recovery([0] * 21 + [None] * 19)
    assert mostly.unharmed == 21 / 40
    assert verdict(arms | {FROZEN: mostly}, noise_pairs(arms)) == sentence
    lucky = {FROZEN: recovery([100] * 21 + [None] * 19)}
    sentence = "Undecided: most robots reach the bound without learning."
    assert verdict(arms | lucky, noise_pairs(arms)) == sentence
    lucky = {FROZEN: recovery([100] * 20 + [None] * 20)}
    assert verdict(arms | lucky, noise_pairs(arms)) == "Noise helps, but is not essential."


def test_the_goal_needs_a_known_median_of_the_best_arm():
    arms = four((NEVER, NEVER), (NEVER, NEVER)) | {NEWBORN: NEVER}
    assert "not met; the best arm" in page({"polarity": arms}, Wear().experiment).markdown
    arms = four((recovery(70, robots=40), NEVER), (NEVER, NEVER)) | {NEWBORN: NEVER}
    assert "not met; the best arm" in page({"polarity": arms}, Wear().experiment).markdown
    arms = four((recovery(60, robots=40), NEVER), (NEVER, NEVER)) | {NEWBORN: NEVER}
    assert ": met; the best arm" in page({"polarity": arms}, Wear().experiment).markdown


def test_pairs_are_corrected_over_their_family():
    (one,) = compared({"a": FAST, "b": SLOW}, [("a", "b")])
    two = compared({"a": FAST, "b": SLOW, "c": FAST}, [("a", "b"), ("a", "c")])
    assert two[0].p == pytest.approx(min(2 * one.p, 1)) and two[0].sign == 1
    assert Pair("a", "b", float("nan"), -5.0).sign == 0 == two[1].sign
    assert Pair("a", "b", 0.01, -5.0, less_is_better=False).sign == -1


def test_an_effect_is_the_mean_difference_of_each_robot():
    arms = four((recovery([0, 10]), recovery([20, 50])), (recovery([0, 0]), recovery([100, 100])))
    found = {name.partition(":")[0]: values[:2] for name, values in effects(arms).items()}
    assert found["noise"] == (2, (20 + 40) / 2)  # without the arms that cannot learn
    assert found["ideas"] == (2, -5) and found["clock"] == (3, 0) and "memory" not in found
    assert found["noise x ideas"] == (4, 100 - 30)


def test_arms_that_cannot_learn_are_known(life):
    """What they learn about values does not reach their actions: the memory's one idea stays."""
    for name, arm in ARMS.items():
        branch = Branch(life, life.brains(), "polarity", arm)
        before = {k: weights.copy() for k, weights in branch.agent.weights().items()}
        for _ in range(3):
            branch.advance(lambda: None)
        changed = [
            k for k, weights in branch.agent.weights().items() if (weights != before[k]).any()
        ]
        assert any(k.startswith("memory.") for k in changed) is learns(name)
        assert any(k.startswith("evaluation.") for k in changed) is (name != FROZEN)


def test_the_page_names_the_verdict_and_the_goal():
    arms = four((FAST, SLOW), (FAST, NEVER)) | {NEWBORN: SLOW, FROZEN: NEVER}
    study = Wear(seed=7, kinematics=("lag=0.08",))
    text = page({"polarity": arms, "half-gain": {}}, study.experiment).markdown
    assert "Kinematic simulator lag=0.08; seed 7." in text
    assert "MuJoCo; seed 1." in page({"polarity": arms}, Wear(body="mujoco").experiment).markdown
    assert "**Noise helps, but is not essential.**" in text
    assert "a quarter of the newborns' median: met; the best arm" in text
    assert "| `frozen` | 40 | 0.000 | 0.000 | 0 [0%, 9%] | over 240 [over 240, over 240] |" in text
    assert "No arm is finished yet." in text


def test_the_figure_has_a_curve_for_each_arm_that_it_names():
    arms = four((FAST, SLOW), (FAST, NEVER)) | {NEWBORN: SLOW, FROZEN: NEVER}
    own, random = draw(arms).axes
    for axis in (own, random):
        words = sorted(text.get_text() for text in axis.texts)
        assert words == [
            "frozen",
            "newborn",
            "noise-old",
            "noise-reset",
            "quiet-old",
            "quiet-reset",
        ]
        assert len(axis.lines) == 6
    heights = {float(np.asarray(line.get_ydata())[-1]) for line in own.lines}
    assert heights == {0.0, 1.0}


def test_a_curve_rises_to_the_share_of_robots_that_have_recovered():
    some = recovery([20] * 30 + [None] * 10)
    own, random = draw(four((FAST, SLOW), (some, NEVER)) | {NEWBORN: SLOW}).axes
    for axis, share in ((own, 0.75), (random, 1.0)):
        names = {text.get_color(): text.get_text() for text in axis.texts}
        lines = {names[line.get_color()]: line for line in axis.lines}
        times, shares = lines["noise-old"].get_data()
        heights = [shares[np.searchsorted(times, time, "right") - 1] for time in (0, 19, 21, 239)]
        assert heights == pytest.approx([0, 0, share, share])
        assert shares[-1] == pytest.approx(share)
        assert lines["newborn"].get_ydata()[-1] == 1 and lines["newborn"].get_linestyle() == "--"
