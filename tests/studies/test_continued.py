"""Agents that are frozen, explore or learn in the test after training."""

import dataclasses
import shutil

import numpy as np
import pytest

from musebot.protocols import cli
from musebot.protocols.agents.base import Agent
from musebot.protocols.agents.names import recorded_name
from musebot.protocols.errors import DamagedFileError, Interrupted
from musebot.protocols.experiment.conditions import CohortKey, Condition
from musebot.protocols.playback import rollout
from musebot.protocols.results.run_files import BRAINS_FILE, read_run
from musebot.protocols.simulation import local
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import load_arrays, save_arrays
from musebot.protocols.studies.learners.continued import MODES, ContinuedLearning
from musebot.protocols.studies.study import conduct

SPOT = Condition("spot_finding", recorded_name("dqn"))


class Restless(Agent):
    """Counts how often it acts, explores and learns; its one weight grows as it learns."""

    made: list["Restless"] = []
    breaks = False

    def __init__(self, robots, senses, seed):
        self.robots, self.acted, self.explored, self.learned = robots, 0, 0, 0
        self.weight = np.zeros((robots, 1), dtype=np.float32)
        Restless.made.append(self)

    def reset(self):
        """Nothing to forget."""

    def act(self, state, learning):
        self.acted += 1
        self.explored += learning
        return np.zeros((self.robots, 2), dtype=np.float32)

    def learn(self, reward):
        self.learned += 1
        self.weight[-1] = np.nan if self.breaks else self.learned

    def state(self):
        return self.weights() | {"age": np.array(self.acted)}

    def load_state(self, arrays):
        assert arrays["age"] == self.acted  # another's age may mean anything
        self.weight[:] = arrays["weight"]

    def weights(self):
        return {"weight": self.weight}

    def load_weights(self, arrays):
        self.weight[:] = arrays["weight"]


USERS = f"{__name__}:Restless"


@pytest.fixture(scope="module")
def runs(tmp_path_factory, in_process):
    """A rehearsal of `dqn`, one of `steady`, and one of a user's agent."""
    folder = tmp_path_factory.mktemp("runs")
    words = "--robots 6 --cohort-size 6 --time-scale 0.004 --body kinematic --processes 1".split()
    for name, more in (
        ("dqn", ["--agent", "dqn"]),
        ("steady", ["--brain", "steady", "--proposer", "creative"]),
        ("restless", ["--agent", USERS, "--task", "spot_finding"]),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(local, "Local", lambda processes: in_process())
            assert cli.main(["run", str(folder / name), *more, *words]) == 0
    return folder


@pytest.fixture(scope="module")
def finished(runs, tmp_path_factory, in_process):
    study = ContinuedLearning((runs / "dqn", runs / "steady"), robots=4)
    out = tmp_path_factory.mktemp("continued") / "out"
    return study, out, conduct(study, out, in_process())


def job(study, out, condition, mode):
    (found,) = [j for j in study._jobs(out) if (j.condition, j.mode) == (condition, mode)]
    return found


def test_a_frozen_agent_repeats_the_test_of_its_run(finished, runs):
    """Without contact is what counts in wall avoidance."""
    study, out, _ = finished
    walls = dataclasses.replace(SPOT, task="wall_avoidance")
    contact = read_run(runs / "dqn").shares(walls, "post")[:4]
    assert contact.any() and not contact.all()
    np.testing.assert_allclose(job(study, out, walls, "frozen").shares(), 1 - contact)


def test_each_mode_explores_and_learns_as_it_says(runs, tmp_path, in_process, monkeypatch):
    study = ContinuedLearning((runs / "restless",), agent=(USERS,))
    out = tmp_path / "out"
    conduct(study, out, in_process())
    condition = Condition("spot_finding", USERS)
    monkeypatch.setattr(Restless, "breaks", True)
    does = {"frozen": (0, 0), "exploring": (1, 0), "learning": (1, 1)}
    assert does.keys() == MODES.keys()
    for name, (explores, learns) in does.items():
        Restless.made.clear()
        one = job(study, out, condition, name)
        one.path.unlink()
        assert one.run(lambda: False, lambda done, message: None)
        (agent,) = Restless.made
        steps = read_run(runs / "restless").experiment.schedule(condition.task).steps_of("post")
        assert (agent.acted, agent.explored) == (steps, explores * steps)
        assert agent.learned == learns * steps
        # The last robot's weight is not finite once it has learned.
        assert np.isnan(one.shares()).tolist() == [False] * 5 + [learns == 1]

    # That robot is left out of all modes, so that the means are of the same robots.
    (row,) = [line for line in study.page(out).markdown.splitlines() if "`restless`" in line][:1]
    assert "| 5 of 6 |" in row


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
@pytest.mark.parametrize(("name", "proposer"), [("dqn", SPOT.proposer), ("steady", "creative")])
def test_agents_of_ours_have_the_age_of_the_end_of_their_lives(
    finished, runs, monkeypatch, task, name, proposer
):
    study, out, _ = finished
    ages, condition = [], Condition(task, proposer)

    def spy(batch, agent, steps, **words):
        ages.append(agent.state()["age"].item())
        raise RuntimeError

    monkeypatch.setattr(rollout, "count_events", spy)
    with pytest.raises(RuntimeError):
        job(study, out, condition, "learning").run(lambda: False, lambda *_: None)
    cohort = Cohort(read_run(runs / name).experiment, CohortKey(condition, 0))
    cohort.advance(cohort.steps)
    assert ages == [cohort.agent.state()["age"].item()] and ages[0] > 100


def test_a_condition_whose_robots_were_all_stopped_in_a_mode_has_a_row(finished, tmp_path):
    study, out, _ = finished
    kept = tmp_path / "kept"
    shutil.copytree(out, kept)
    learning = job(study, kept, SPOT, "learning")
    _, notes = load_arrays(learning.path)
    save_arrays(learning.path, {"shares": np.full(4, np.nan)}, **notes)
    assert "| dqn (`dqn`) | 0 of 4 | - | - | - | - |" in study.page(kept).markdown


def test_the_page_has_a_row_for_each_condition_and_is_made_without_brains(finished, runs, tmp_path):
    study, out, page = finished
    rows = [line for line in page.markdown.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows if "`" in row] == [
        "dqn (`dqn`)", "creative (`steady`)",
    ] * 2  # fmt: skip
    brains = runs / "dqn" / BRAINS_FILE
    away = brains.rename(tmp_path / "brains")
    try:
        again = ContinuedLearning(study.runs, robots=4)
        again.check(out)
        assert again.page(out).markdown == page.markdown
    finally:
        away.rename(brains)


def test_a_killed_study_continues_to_the_same_bytes(finished, runs, tmp_path, in_process):
    study, out, page = finished
    other = tmp_path / "out"
    with pytest.raises(Interrupted):
        conduct(study, other, in_process(most=3))
    assert conduct(study, other, in_process()).markdown == page.markdown
    for path in out.rglob("*.safetensors"):
        assert path.read_bytes() == (other / path.relative_to(out)).read_bytes()


def test_a_file_of_another_mode_is_refused(finished, runs, tmp_path, in_process):
    study, out, _ = finished
    exploring = job(study, out, SPOT, "exploring")
    kept = exploring.path.read_bytes()
    try:
        exploring.path.write_bytes(job(study, out, SPOT, "frozen").path.read_bytes())
        with pytest.raises(DamagedFileError, match="its mode is 'frozen', not 'exploring'"):
            study.check(out)
        arrays, notes = load_arrays(job(study, out, SPOT, "frozen").path)
        notes = notes | {"mode": "exploring"}
        save_arrays(exploring.path, {"shares": arrays["shares"] + 2}, **notes)
        with pytest.raises(DamagedFileError, match="a share is not within"):
            study.check(out)
    finally:
        exploring.path.write_bytes(kept)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--robots", "0"], "robots must be at least 1, got 0"),
        (["--seed", "-1"], "the seed must lie in [0, 2^63), got -1"),
        (["--agent", "avg"], "no run has robots of avg"),
        (["--agent", "dnq"], "there is no agent 'dnq': did you mean dqn?"),
    ],
)
def test_bad_options_are_refused_in_one_sentence(runs, tmp_path, capsys, words, sentence):
    out = tmp_path / "out"
    command = ["study", "continued-learning", str(out), "--runs", str(runs / "dqn"), *words]
    assert cli.main(command) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.strip().splitlines()) == 1
    assert not out.exists()


def test_runs_of_the_same_name_are_refused(tmp_path, capsys):
    """The study keeps its files under the runs' names."""
    runs = [str(tmp_path / name / "run") for name in ("a", "b")]
    command = ["study", "continued-learning", str(tmp_path / "out"), "--runs", *runs]
    assert cli.main(command) == 2
    assert "the runs must have different names, got run, run" in capsys.readouterr().err


def test_a_run_without_brains_is_refused_before_any_test(runs, tmp_path, capsys):
    brains = runs / "dqn" / BRAINS_FILE
    away = brains.rename(tmp_path / "brains")
    try:
        out = tmp_path / "out"
        assert cli.main(["study", "continued-learning", str(out), "--runs", str(runs / "dqn")]) == 2
        assert "lacks a file" in capsys.readouterr().err
        assert not out.exists()
    finally:
        away.rename(brains)


def test_the_code_of_an_agent_that_only_a_file_names_is_not_run(
    runs, tmp_path, capsys, monkeypatch
):
    from musebot.protocols.agents import trust

    monkeypatch.setattr(trust, "_TRUSTED", set())
    command = ["study", "continued-learning", str(tmp_path / "out")]
    assert cli.main([*command, "--runs", str(runs / "restless")]) == 2
    sentence = f"allow it by --agent {USERS}, or in `musebot run` by --trust-agent"
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
