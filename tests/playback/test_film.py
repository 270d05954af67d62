"""Films, the re-enactments they show, and the window on the same brains."""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import os
import subprocess
import sys
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import imageio.v2 as imageio
import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from musebot import tasks
from musebot.controller import Parameters
from musebot.models.edits import OBSTACLES
from musebot.protocols import cli
from musebot.protocols.agents.base import ppo
from musebot.protocols.errors import InputError
from musebot.protocols.experiment.experiment import Experiment, Plan, save_plan
from musebot.protocols.experiment.schedules import UPPER_LEFT, UPPER_RIGHT
from musebot.protocols.playback import film
from musebot.protocols.playback import scene as picture
from musebot.protocols.playback import stored_brains as replay
from musebot.protocols.playback import viewer as explore
from musebot.protocols.playback.episode import Episode, Moment
from musebot.protocols.results.results import Results, collect, load, save
from musebot.protocols.simulation import engine
from musebot.protocols.simulation.cohort import Cohort
from musebot.protocols.storage import save_arrays
from musebot.tasks.spot_finding import SpotFindingRules
from musebot.tasks.suite import TASKS

CONDITIONS = (
    ("wall_avoidance", "fixed"),
    ("wall_avoidance", "creative"),
    ("spot_finding", "creative"),
)
EXPERIMENT = Experiment(time_scale=0.002, cohort_size=2)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("run")
    plan = Plan.of(EXPERIMENT, CONDITIONS, robots=2)
    lives = []
    for key in plan.cohorts():
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    save_plan(directory / engine.PLAN, plan)
    save(directory, collect(EXPERIMENT, lives))
    return directory


@pytest.fixture(scope="module")
def results(directory: Path) -> Results:
    return load(directory)


@pytest.fixture(scope="module")
def egl() -> None:
    command = [sys.executable, "-m", "musebot.protocols.playback.offscreen"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"nothing draws here: {done.stderr.strip()}")


def candidate(results: Results, **changes) -> replay.Candidate:
    robot = replay.Candidate(EXPERIMENT, results, "wall_avoidance", "creative", 0, "post")
    return dataclasses.replace(robot, **changes)


def make_film(results: Results, output: Path, **changes) -> None:
    length = {name: changes.pop(name, 1.0) for name in ("seconds", "speed")}
    film.film(candidate(results, **changes).episode(), output, **length)


def reenact(results: Results, **changes) -> list[Moment]:
    return list(candidate(results, robot=1, **changes).episode().moments())


def newborn(task: str, robots: int = 2, seed: int = 0) -> ppo.Policies:
    """Policies with weights drawn at random."""
    random = np.random.default_rng(seed)
    sensors = sum(n for n, *_ in shapes_of(task).values())
    arrays = {}
    for when in ("before", "after"):
        for layer, (outputs, inputs) in enumerate([(8, sensors), (8, 8), (2, 8)]):
            weights = random.normal(size=(robots, outputs, inputs))
            arrays[f"{when}.{layer}.weights"] = weights.astype(np.float32)
            arrays[f"{when}.{layer}.biases"] = random.normal(size=(robots, outputs)).astype("f4")
    return ppo.Policies(task, arrays)


def keep(policies: ppo.Policies, path: Path) -> Path:
    save_arrays(path, policies.arrays, task=policies.task)
    return path


# ---- The file ----


@pytest.mark.parametrize(
    ("task", "phase", "seconds", "frames"),
    [("wall_avoidance", "pre", 0.6, 15), ("spot_finding", "post", 0.4, 10)],
)
def test_film_is_h264_in_yuv420p_of_the_length_asked_for_and_something_moves(
    egl: None, directory: Path, tmp_path: Path, task: str, phase: str, seconds: float, frames: int
) -> None:
    output = tmp_path / "film.mp4"
    options = f"--proposer creative --robot 1 --speed 2 --seconds {seconds} --phase {phase}"
    done = subprocess.run(
        [sys.executable, "-m", "musebot", "film", str(directory), "--task", task]
        + ["--output", str(output), *options.split()],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(output)
    assert "drawing with" in done.stderr
    assert os.listdir(tmp_path) == ["film.mp4"]

    reader: Any = imageio.get_reader(output)
    with reader:
        meta = reader.get_meta_data()
        pictures = np.stack([np.asarray(picture) for picture in reader])
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == 25
    assert meta["duration"] == pytest.approx(seconds, abs=0.5 / 25)
    assert pictures.shape == (frames, picture.HEIGHT, picture.WIDTH, 3)
    assert pictures[0].std() > 20  # not a blank picture
    # More moves than compression or the clock alone would.
    changed = np.abs(pictures[-1].astype(int) - pictures[0])[:, : picture.WIDTH - 240].max(axis=2)
    assert (changed > 60).sum() > 100


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"task": "dancing"}, "the task must be one of"),
        ({"proposer": "muse"}, "the proposer must be one of"),
        ({"proposer": "random"}, "no robot of wall_avoidance, random has lived in this run"),
        ({"robot": 2}, "are 0 to 1, got 2"),
        ({"robot": -1}, "are 0 to 1, got -1"),
        ({"phase": "training"}, "the phase must be one of"),
        ({"seconds": 0.0}, "length in seconds must be positive"),
        ({"seconds": float("inf")}, "length in seconds must be positive"),
        ({"speed": -1.0}, "speed must be positive"),
        ({"speed": float("nan")}, "speed must be positive"),
        ({"seed": -1}, "the seed must lie in"),
    ],
)
def test_what_cannot_be_filmed_is_one_sentence_and_leaves_nothing(
    results: Results, tmp_path: Path, changes: dict, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        make_film(results, tmp_path / "film.mp4", **changes)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("film.avi", "must be an .mp4 or a .gif"),
        ("nowhere/film.mp4", "no folder"),
        ("d.mp4", "is a folder"),
    ],
)
def test_where_no_film_can_be_written_is_one_sentence(
    results: Results, tmp_path: Path, name: str, sentence: str
) -> None:
    (tmp_path / "d.mp4").mkdir()
    with pytest.raises(InputError, match=sentence):
        make_film(results, tmp_path / name)
    assert os.listdir(tmp_path) == ["d.mp4"]


def test_folder_that_cannot_be_written_is_one_sentence(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(InputError, match="cannot be written"):
        make_film(results, tmp_path / "film.mp4")


def test_invalid_robot_is_not_filmed(results: Results, tmp_path: Path) -> None:
    robots = [dataclasses.replace(row, category="invalid") for row in results.robots]
    with pytest.raises(InputError, match="is invalid"):
        make_film(dataclasses.replace(results, robots=robots), tmp_path / "film.mp4")


def test_without_egl_the_sentence_says_how_to_get_it(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(InputError, match="apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"):
        make_film(results, tmp_path / "film.mp4")
    assert not os.listdir(tmp_path)


class FailingStage:
    """Draws grey, and fails at the third picture."""

    renderer = "nothing"

    def __init__(self, *_: object) -> None:
        self.drawn = 0

    def draw(self, _: picture.Shot) -> np.ndarray:
        self.drawn += 1
        if self.drawn == 3:
            raise RuntimeError("out of paint")
        return np.full((picture.HEIGHT - 44, picture.WIDTH - 240, 3), 128, dtype=np.uint8)

    def close(self) -> None:
        pass


def test_failed_film_leaves_the_older_one_and_no_half_one(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "Stage", FailingStage)
    output = tmp_path / "film.mp4"
    output.write_bytes(b"older")
    with pytest.raises(RuntimeError, match="out of paint"):
        make_film(results, output)
    assert os.listdir(tmp_path) == ["film.mp4"]
    assert output.read_bytes() == b"older"


class GreyStage(FailingStage):
    """Draws grey, and never fails."""

    def draw(self, shot: picture.Shot) -> np.ndarray:
        self.drawn = 0
        return super().draw(shot)


def test_film_that_the_encoder_cut_short_is_an_error_and_leaves_nothing(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "Stage", GreyStage)
    # As where the disk is full: ffmpeg ends early, and imageio does not ask.
    monkeypatch.setattr(imageio_ffmpeg, "count_frames_and_secs", lambda _: (24, 0.96))
    with pytest.raises(OSError, match="could not be written whole"):
        make_film(results, tmp_path / "film.mp4")
    assert not os.listdir(tmp_path)


def test_film_ends_with_the_episode_at_the_latest() -> None:
    assert film.frame_count(30, 4, 600, fps=25) == 30 * 25
    assert film.frame_count(30, 4, 60, fps=25) == 15 * 25
    assert film.frame_count(30, 1e9, 60, fps=25) == 1
    assert film.frame_count(30, 4, float("inf"), fps=8) == 30 * 8


def test_robot_turns_the_shorter_way_between_two_control_steps() -> None:
    pose = film._between(np.array([0.0, 0.2, 3.0]), np.array([0.1, 0.0, -3.0]), 0.5)
    np.testing.assert_allclose(pose[:2], [0.05, 0.1])
    assert np.cos(pose[2]) == pytest.approx(-1)


def test_signal_goes_from_grey_to_hot() -> None:
    hot = (1.0, 0.0, 0.0)
    assert picture.heat(1.0, hot) == hot
    assert picture.heat(0.0, hot) != picture.heat(0.5, hot) != hot


# ---- The re-enactment ----


@pytest.mark.parametrize(("phase", "when"), [("pre", "before"), ("post", "after")])
def test_brain_is_the_robots_own_from_before_or_after_training(
    results: Results, phase: str, when: str
) -> None:
    brain = candidate(results, task="spot_finding", robot=1, phase=phase).brain()
    networks = brain.controller.networks()
    stored = {name for name in results.brains if name.startswith(f"spot_finding/creative/{when}/")}
    assert stored == {f"spot_finding/creative/{when}/{name}" for name in networks}
    for name, tensor in networks.items():
        whole = results.brains[f"spot_finding/creative/{when}/{name}"]
        np.testing.assert_array_equal(tensor.numpy(), whole[1:2])


def test_reenactment_lasts_a_test_from_its_start(results: Results) -> None:
    moments = reenact(results, task="spot_finding")
    times = [moment.time for moment in moments]
    np.testing.assert_allclose(times, 0.1 * np.arange(1 + round(3600 * 0.002 / 0.1)))
    np.testing.assert_allclose(moments[0].pose, UPPER_LEFT, atol=1e-12)
    assert (moments[0].event, moments[0].event_seconds) == (False, 0.0)
    for moment, after in zip(moments[:-1], moments[1:], strict=True):
        assert after.event_seconds - moment.event_seconds == pytest.approx(0.1 * after.event)


def test_spot_lies_where_the_test_has_it(results: Results) -> None:
    for moment in reenact(results, task="spot_finding", phase="pre"):
        np.testing.assert_array_equal(moment.spot, UPPER_RIGHT[:2])


def test_reenactment_does_not_change_the_brain(
    results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    brain = candidate(results, robot=1).brain()
    monkeypatch.setattr(replay.Candidate, "brain", lambda _: brain)
    before = {name: tensor.clone() for name, tensor in brain.controller.networks().items()}
    assert len(reenact(results)) > 1
    for name, tensor in brain.controller.networks().items():
        np.testing.assert_array_equal(tensor, before[name])


def path(moments: list[Moment]) -> np.ndarray:
    return np.array([[*moment.pose, *moment.motors] for moment in moments])


def test_same_seed_gives_the_same_reenactment_and_another_seed_another(results: Results) -> None:
    np.testing.assert_array_equal(path(reenact(results)), path(reenact(results)))
    assert not np.array_equal(path(reenact(results)), path(reenact(results, seed=1)))


def test_fixed_actions_have_no_noise_for_a_seed_to_change(results: Results) -> None:
    first, second = (reenact(results, proposer="fixed", seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(path(first), path(second))


def test_brain_of_another_shape_is_refused(results: Results) -> None:
    other = dataclasses.replace(EXPERIMENT, brain=Parameters(memory_hidden=6))
    with pytest.raises(ValueError, match="must have shape"):
        candidate(results, experiment=other).brain()


# ---- An episode of a policy's ----


@pytest.mark.parametrize("task", TASKS)
def test_episode_is_the_one_that_gymnasium_starts_with_the_same_seed(task: str) -> None:
    gymnasium_env = pytest.importorskip("musebot.tasks.gymnasium_env")
    policies = newborn(task)
    steps = 2 * (TASKS[task].spot_steps or 15) + 5
    episode = Episode.of_policy(policies, 1, "post", seed=3)
    moments = list(itertools.islice(episode.moments(), steps))
    robots = gymnasium_env.ArenaVectorEnv(task, 1)
    state, _ = robots.reset(seed=3)
    for moment in moments:
        sensed = episode.batch.rules.state(moment.sensordata).astype(np.float32)
        np.testing.assert_array_equal(sensed, state[0])
        np.testing.assert_array_equal(moment.pose, robots._batch.pose[0])
        np.testing.assert_array_equal(moment.spot, robots._batch.spot[0])
        motors = policies.one(1).act(state)
        np.testing.assert_array_equal(moment.motors, motors[0])
        state, *_ = robots.step(motors * 2 * TASKS[task].limit)
    spots = len(np.unique([moment.spot for moment in moments], axis=0))
    assert spots == (3 if TASKS[task].spot_steps else 1)


def test_policys_episode_lasts_as_long_as_the_tasks() -> None:
    times = [
        m.time for m in Episode.of_policy(newborn("spot_finding_unit"), 0, "post", 0).moments()
    ]
    np.testing.assert_allclose(times, 0.1 * np.arange(1001))
    assert Episode.of_policy(newborn("spot_finding"), 0, "post", 0).seconds == float("inf")


def test_policy_drives_as_it_was_born_or_as_it_was_when_trained() -> None:
    policies = newborn("spot_finding_walls")
    for phase, trained in (("pre", False), ("post", True)):
        episode = Episode.of_policy(policies, 0, phase, 0)
        moment = next(episode.moments())
        state = episode.batch.rules.state(moment.sensordata[None]).astype(np.float32)
        np.testing.assert_array_equal(moment.motors, policies.one(0).act(state, trained)[0])
        assert episode.trained == trained


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--task dancing", "holds policies for spot_finding_walls, not for dancing"),
        ("--task spot_finding", "holds policies for spot_finding_walls, not for spot_finding"),
        ("--task spot_finding_walls --proposer creative", "only brains have a proposer"),
        ("--task spot_finding_walls --robot 2", "the policies are 0 to 1, got 2"),
        ("--task spot_finding_walls --seed -1", "the seed must lie in"),
        ("--task spot_finding_walls --speed 0", "speed must be positive"),
    ],
)
def test_policy_that_cannot_be_filmed_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, sentence: str
) -> None:
    policies = keep(newborn("spot_finding_walls"), tmp_path / "p.safetensors")
    output = ["--output", str(tmp_path / "film.mp4")]
    assert cli.main(["film", str(policies), *words.split(), *output]) == 2
    assert sentence in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["p.safetensors"]


def test_policies_that_are_not_there_or_none_are_one_sentence(
    directory: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--task", "spot_finding", "--output", str(tmp_path / "film.mp4")]
    for path, sentence in (
        (tmp_path / "p.safetensors", "there is no file"),
        (directory / "brains.safetensors", "holds no policies"),
        (tmp_path, "holds no experiment"),
    ):
        assert cli.main(["film", str(path), *words]) == 2
        assert sentence in capsys.readouterr().err


def test_policys_film_may_be_a_gif_of_half_the_size(egl: None, tmp_path: Path) -> None:
    policies = keep(newborn("spot_finding_jumping"), tmp_path / "p.safetensors")
    command = ["film", str(policies), "--task", "spot_finding_jumping", "--seconds", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "musebot", *command, "--output", str(tmp_path / "film.gif")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size == (picture.WIDTH // 2, picture.HEIGHT // 2)
        assert gif.n_frames == 8
        assert gif.info["loop"] == 0


DRAW = """
import sys
import numpy as np
from musebot.protocols.playback.scene import Shot, Stage
from musebot.tasks.suite import TASKS

pose, trail, nobody = np.array([0.0, -0.2, 0.0]), np.zeros((1, 2)), np.zeros(1)
pictures = {}
for task, row in TASKS.items():
    stage = Stage(task)
    for name, spot, signal, contact in (
        ("plain", (-0.4, 0.2), 0.0, False),
        ("spot", (0.4, 0.2), 0.0, False),
        ("signal", (-0.4, 0.2), 0.9, False),
        ("contact", (-0.4, 0.2), 0.0, True),
    ):
        signals = {name: np.full(n, signal) for name, (n, *_) in row.rules.shapes.items()}
        shot = (signals, np.zeros(2), contact, False, 0.0, trail, nobody, nobody)
        pictures[f"{task}/{name}"] = stage.draw(Shot(0.0, pose, np.array(spot), *shot)).copy()
    stage.close()
np.savez(sys.argv[1], **pictures)
"""


@pytest.fixture(scope="module")
def drawn(egl: None, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """Of every task: a robot below the middle, looking to the right, and what may change."""
    path = tmp_path_factory.mktemp("stage") / "drawn.npz"
    subprocess.run([sys.executable, "-c", DRAW, str(path)], check=True)
    with np.load(path) as pictures:
        return {name: pictures[name].astype(int) for name in pictures}


def differ(first: np.ndarray, second: np.ndarray, x: float, y: float) -> bool:
    """Whether two pictures of the stage differ where x, y in metres is."""
    column, row = round(360 + 630 * x), round(248 - 630 * y)
    near = slice(row - 3, row + 4), slice(column - 3, column + 4)
    return bool((np.abs(first[near] - second[near]) > 20).any())


@pytest.mark.parametrize("task", TASKS)
def test_stage_shows_what_stands_in_the_arena_and_what_the_robot_senses(
    drawn: dict[str, np.ndarray], task: str
) -> None:
    plain, spot, signal, contact = (
        drawn[f"{task}/{name}"] for name in ("plain", "spot", "signal", "contact")
    )
    smells, sees = (issubclass(TASKS[task].rules, SpotFindingRules), "distances" in shapes_of(task))
    for x in (-0.4, 0.4):
        assert differ(plain, spot, x, 0.2) == smells
    for x, y, _ in OBSTACLES[::2]:  # out of the reach of a nose
        empty = drawn["wall_avoidance/plain"]
        assert differ(plain, empty, x, y) == (task == "wall_avoidance_obstacles")
    assert differ(plain, signal, 0.1, -0.2 + 0.02) == smells  # in the frustum of a nose ahead
    aside = [differ(plain, signal, 0.08, -0.2 + side) for side in (-0.12, 0.12)]
    assert aside == [task == "spot_finding_two_noses"] * 2
    assert differ(plain, signal, -0.3, -0.2) == sees  # the ray of the eye astern
    assert differ(plain, contact, 0.0, -0.2 + 0.034) == sees


def shapes_of(task: str) -> Mapping[str, tuple[int, float, float]]:
    return TASKS[task].rules.shapes


def panel_of(task: str) -> tuple[picture.Panel, picture.Shot, np.ndarray]:
    """A panel, a shot of a robot at rest, and the panel's picture of it."""
    episode = Episode.of_policy(newborn(task), 0, "post", 0)
    (shot,) = film._shots(episode.moments(), episode.batch.rules, [0.0], speed=1)
    panel = picture.Panel(task, "nobody", True, speed=1, seconds=1)
    return panel, shot, panel.frame(STAGE, shot)


STAGE = np.zeros((picture.HEIGHT - 44, picture.WIDTH - 240, 3), dtype=np.uint8)


@pytest.mark.parametrize("task", TASKS)
def test_panel_shows_every_signal(task: str) -> None:
    panel, shot, before = panel_of(task)
    for name, values in shot.signals.items():
        if name == "contact":
            changed = [dataclasses.replace(shot, contact=not shot.contact)]
        else:
            changed = [
                dataclasses.replace(
                    shot, signals={**shot.signals, name: np.where(one, 0.77, values)}
                )
                for one in np.eye(len(values), dtype=bool)
            ]
        for other in changed:
            assert (panel.frame(STAGE, other) != before).any(), name


@pytest.mark.parametrize("task", TASKS)
def test_everything_on_the_panel_is_inside_the_picture(task: str) -> None:
    panel, shot, before = panel_of(task)
    panel.frame(STAGE, dataclasses.replace(shot, event=True, time=1.0))
    last = panel.frame(STAGE, dataclasses.replace(shot, time=1.0))
    timeline = (last != before).any(axis=2).any(axis=1).nonzero()[0].max()
    assert timeline < picture.HEIGHT - 5


# ---- The window ----


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_exploring_without_a_display_points_to_films(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="no display.*musebot film"):
        explore.explore("wall_avoidance")


def test_exploring_with_opengl_elsewhere_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(InputError, match="MUJOCO_GL is 'egl'"):
        explore.explore("wall_avoidance")


def test_exploring_an_unknown_task_or_robot_is_one_sentence(results: Results) -> None:
    with pytest.raises(InputError, match="the task must be one of"):
        explore.explore("dancing")
    with pytest.raises(InputError, match="are 0 to 1, got 7"):
        explore.Driver.of_candidate(candidate(results, robot=7))
    with pytest.raises(InputError, match="are 0 to 1, got 7"):
        explore.Driver.of_policy(newborn("spot_finding"), 7, "post")


@pytest.mark.parametrize("task", ["wall_avoidance", "spot_finding"])
def test_explored_brain_drives_the_task_and_is_the_same_in_every_episode(
    results: Results, task: str
) -> None:
    policy = explore.Driver.of_candidate(candidate(results, task=task)).policy
    environment = tasks.load("arena", task, {"robot": (0, 0, 0), "spot": (0.3, 0.1)})
    episodes = []
    for _ in range(2):
        timestep = environment.reset()
        actions = []
        for _ in range(5):
            actions.append(policy(timestep))
            environment.action_spec().validate(actions[-1].astype(float))
            timestep = environment.step(actions[-1])
        episodes.append(actions)
    np.testing.assert_array_equal(*episodes)


def test_random_motors_hold_each_value_for_some_steps() -> None:
    environment = tasks.load("arena", "wall_avoidance", {"random": 0})
    policy = explore.RandomMotors(seed=0, steps=3)
    timestep = environment.reset()
    actions = []
    for _ in range(6):
        actions.append(policy(timestep))
        timestep = environment.step(actions[-1])
    assert len(np.unique(actions, axis=0)) == 2
    assert np.abs(actions).max() <= 0.5


class Listeners(list):
    """As dm_control's: `+=` takes a single one."""

    def __iadd__(self, listener: Callable) -> Listeners:  # type: ignore[override]
        self.append(listener)
        return self


class Window:
    """dm_control's window, where there is no display: lives some steps and remembers them."""

    opened: ClassVar[list[Window]] = []

    def __init__(self, title: str) -> None:
        self.title = title
        self.actions: list[np.ndarray] = []
        self._window = types.SimpleNamespace(keyboard=types.SimpleNamespace(on_key=Listeners()))
        self.opened.append(self)

    def launch(self, loader: Callable[[], Any], policy: Callable[[Any], np.ndarray]) -> None:
        environment = loader()
        timestep = environment.reset()
        for press in (None, explore.UP):
            if press:
                self._announce(press, 1)
            self.actions.append(policy(timestep))
            environment.action_spec().validate(self.actions[-1].astype(float))
            timestep = environment.step(self.actions[-1])

    def _announce(self, key: int, activity: int) -> None:
        for listener in self._window.keyboard.on_key:
            listener(key, activity, 0)


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> type[Window]:
    module = types.ModuleType("dm_control.viewer.application")
    module.Application = Window  # type: ignore[attr-defined]
    viewer = types.ModuleType("dm_control.viewer")
    viewer.application = module  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "dm_control.viewer", viewer)
    monkeypatch.setattr(explore, "check_display", lambda: None)
    monkeypatch.setattr(Window, "opened", [])
    return Window


@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_explored_in_its_own_units(window: type[Window], task: str) -> None:
    explore.explore(task)
    explore.explore(task, explore.Driver.of_policy(newborn(task), 1, "post"))
    explore.explore(task, explore.Driver("arrow keys", explore.ArrowKeys()))
    by_chance, by_policy, by_keys = window.opened
    assert by_policy.title == f"Musebot: {task}, PPO, policy 1, post-training"
    assert np.abs(by_chance.actions).max() > 0
    limit = TASKS[task].limit
    np.testing.assert_array_equal(by_keys.actions, [[0, 0], [limit, limit]])


def test_a_driver_that_learnt_another_task_is_shown_in_it(
    window: type[Window],
) -> None:
    policy = explore.Driver.of_policy(newborn("spot_finding_walls"), 1, "post").policy
    explore.explore("spot_finding", explore.Driver("walls", policy, task="spot_finding_walls"))
    (shown,) = window.opened
    assert shown.title == "Musebot: spot_finding_walls, walls"
    assert len(shown.actions) == 2


def test_held_arrow_keys_drive_and_released_ones_stop() -> None:
    keys, timestep = explore.ArrowKeys(), tasks.load("arena", "wall_avoidance").reset()
    press, repeat, release = 1, 2, 0
    for key, activity, motors in (
        (explore.UP, press, [0.5, 0.5]),
        (explore.UP, repeat, [0.5, 0.5]),
        (explore.LEFT, press, [0.25, 0.5]),
        (explore.UP, release, [-0.25, 0.25]),
        (32, press, [-0.25, 0.25]),  # the space bar is the viewer's
        (explore.LEFT, release, [0, 0]),
        (explore.DOWN, press, [-0.5, -0.5]),
        (explore.RIGHT, press, [-0.25, -0.5]),
        (explore.DOWN, release, [0.25, -0.25]),
        (explore.RIGHT, release, [0, 0]),
    ):
        keys.on_key(key, activity, 0)
        np.testing.assert_array_equal(keys(timestep), motors)


def test_keys_are_those_of_the_viewers_library() -> None:
    # Read, not imported: that would look for a display.
    source = Path(importlib.util.find_spec("dm_control").submodule_search_locations[0])
    text = (source / "viewer" / "user_input.py").read_text()
    for name in ("UP", "DOWN", "LEFT", "RIGHT"):
        assert f"\nKEY_{name} = {getattr(explore, name)}\n" in text
    assert f"\nRELEASE = {explore.RELEASE}\n" in text
    # And the viewer's window, which is private, has the keyboard that announces them.
    assert "self._window = " in (source / "viewer" / "application.py").read_text()
    assert "self._window.keyboard" in (source / "viewer" / "application.py").read_text()
    assert "self.on_key = " in (source / "viewer" / "gui" / "glfw_gui.py").read_text()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("wall_avoidance --keys --policies p.safetensors", "only one can drive"),
        ("wall_avoidance --proposer fixed", "only brains have a proposer"),
        ("dancing", "the task must be one of"),
        ("spot_finding_unit --policies p.safetensors", "holds policies for spot_finding_walls"),
        ("spot_finding_unit --policies q.safetensors", "there is no file q.safetensors"),
    ],
)
def test_what_cannot_be_explored_is_one_sentence(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: str,
    sentence: str,
) -> None:
    keep(newborn("spot_finding_walls"), tmp_path / "p.safetensors")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["explore", *words.split()]) == 2
    assert sentence in capsys.readouterr().err
