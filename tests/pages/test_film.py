"""Films: the file, the frames in it, and what is left of a film that fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import types
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pytest
from PIL import Image

from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.pages import film
from musebot.protocols.pages.episode import Episode, Moment
from musebot.protocols.pages.panel import HEIGHT, WIDTH
from musebot.protocols.storage import draft_name
from musebot.tasks import make_batch


@pytest.mark.parametrize(
    ("task", "phase", "seconds", "frames"),
    [("wall_avoidance", "pre", 0.6, 15), ("spot_finding", "post", 0.4, 10)],
)
def test_film_is_h264_in_yuv420p_of_the_requested_length_and_something_moves(
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
        images = np.stack([np.asarray(image) for image in reader])
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == 25
    assert meta["duration"] == pytest.approx(seconds, abs=0.5 / 25)
    assert images.shape == (frames, HEIGHT, WIDTH, 3)
    assert images[0].std() > 20  # not a blank frame
    # More changes than compression or the clock alone would change.
    changed = np.abs(images[-1].astype(int) - images[0])[:, : WIDTH - 240].max(axis=2)
    assert (changed > 60).sum() > 100


@pytest.mark.parametrize(
    ("length", "sentence"),
    [
        ({"seconds": 0.0}, "length in seconds must be positive"),
        ({"seconds": float("inf")}, "length in seconds must be positive"),
        ({"speed": -1.0}, "speed must be positive"),
        ({"speed": float("nan")}, "speed must be positive"),
    ],
)
def test_invalid_length_or_speed_is_one_sentence_and_leaves_nothing(
    stored, tmp_path, length, sentence
):
    with pytest.raises(InputError, match=sentence):
        film.film(
            stored().episode(), tmp_path / "film.mp4", **{"seconds": 1.0, "speed": 1.0, **length}
        )
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("film.avi", "must be an .mp4 or a .gif"),
        ("nowhere/film.mp4", "no folder"),
        ("d.mp4", "is a folder"),
    ],
)
def test_output_that_cannot_be_a_film_is_one_sentence(stored, tmp_path, name, sentence):
    (tmp_path / "d.mp4").mkdir()
    with pytest.raises(InputError, match=sentence):
        film.film(stored().episode(), tmp_path / name, seconds=1.0, speed=1.0)
    assert os.listdir(tmp_path) == ["d.mp4"]


def test_folder_that_cannot_be_written_is_one_sentence(stored, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root can write everywhere
    with pytest.raises(InputError, match="cannot be written"):
        film.film(stored().episode(), tmp_path / "film.mp4", seconds=1.0, speed=1.0)


def test_film_without_egl_is_one_sentence_and_leaves_nothing(stored, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(InputError, match="there is no headless OpenGL"):
        film.film(stored().episode(), tmp_path / "film.mp4", seconds=1.0, speed=1.0)
    assert not os.listdir(tmp_path)


def grey(count):
    """Frames of the full size, all grey."""
    return [np.full((HEIGHT, WIDTH, 3), 128, dtype=np.uint8)] * count


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_all_frames_are_written_and_the_older_film_is_replaced(tmp_path, suffix):
    output = tmp_path / f"film{suffix}"
    output.write_bytes(b"older")
    assert film.write(output, grey(5), 5) == 5
    assert os.listdir(tmp_path) == [output.name]
    reader: Any = imageio.get_reader(output)
    with reader:
        assert sum(1 for _ in reader) == 5


def failing():
    """Two frames, and then an error."""
    yield from grey(2)
    raise RuntimeError("out of paint")


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_failed_film_leaves_the_older_one_and_no_draft(tmp_path, suffix):
    output = tmp_path / f"film{suffix}"
    output.write_bytes(b"older")
    with pytest.raises(RuntimeError, match="out of paint"):
        film.write(output, failing(), 5)
    assert os.listdir(tmp_path) == [output.name]
    assert output.read_bytes() == b"older"


def ended():
    """Two frames, and then the signal by which a system ends a process."""
    yield from grey(2)
    os.kill(os.getpid(), signal.SIGTERM)
    yield from grey(100)


def test_film_ended_by_sigterm_leaves_the_older_one_and_no_draft(tmp_path, monkeypatch):
    (tmp_path / "drafts").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "drafts"))
    output = tmp_path / "films" / "film.mp4"
    output.parent.mkdir()
    output.write_bytes(b"older")
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        film.write(output, ended(), 102)
    assert os.listdir(output.parent) == [output.name] and output.read_bytes() == b"older"
    assert not os.listdir(tmp_path / "drafts")
    assert signal.getsignal(signal.SIGTERM) is before


def test_next_film_removes_the_draft_of_one_that_was_killed_and_no_other(tmp_path):
    output = tmp_path / "film.mp4"
    (tmp_path / draft_name("film.mp4")).write_bytes(b"half")
    others = {".film.17.mp4", draft_name("other.mp4")}
    for name in others:
        (tmp_path / name).write_bytes(b"mine")
    film.write(output, grey(5), 5)
    assert {*os.listdir(tmp_path)} == {*others, output.name}


def test_film_with_fewer_frames_than_were_given_is_an_error_and_leaves_nothing(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(film, "_frames_in", lambda path: 24)
    with pytest.raises(OSError, match="could not be written completely"):
        film.write(tmp_path / "film.mp4", grey(25), 25)
    assert not os.listdir(tmp_path)


def test_film_of_fewer_frames_than_announced_says_how_many_it_has(tmp_path):
    assert film.write(tmp_path / "film.mp4", grey(24), 25) == 24


FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from musebot.protocols.playback import film

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
random = np.random.default_rng(0)
count = int(sys.argv[2])
frames = (random.integers(0, 256, (108, 192, 3), dtype=np.uint8) for _ in range(count))
try:
    film.write(Path(sys.argv[1]), frames, count)
except OSError as error:
    print(error)
"""


# With many frames ffmpeg ends before the last one.
@pytest.mark.parametrize(("suffix", "count"), [(".mp4", 300), (".gif", 20)])
def test_full_disk_is_one_sentence_and_leaves_nothing(tmp_path, suffix, count):
    output = tmp_path / f"film{suffix}"
    command = [sys.executable, "-c", FULL, str(output), str(count)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{output} could not be written completely; is the disk full?\n"
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(("seconds", "says"), [(2.0, False), (5.0, True)])
def test_a_film_that_is_shorter_than_asked_says_so(seconds, says, tmp_path, monkeypatch, capsys):
    batch = make_batch("wall_avoidance", 1)
    episode = Episode(
        "wall_avoidance", "nobody", True, batch, lambda _: np.zeros((1, 2)), 20,
        np.random.default_rng(0),
    )  # fmt: skip
    scene = types.SimpleNamespace(renderer="nothing", close=lambda: None)
    monkeypatch.setattr(film, "Scene", lambda task, dimensions: scene)
    monkeypatch.setattr(film, "write", lambda output, frames, count: count)
    film.film(episode, tmp_path / "film.mp4", seconds=seconds, speed=1.0)
    sentence = "the episode lasts 2 s, so the film lasts 2 s"
    assert (sentence in capsys.readouterr().err) is says


def test_film_ends_with_the_episode_at_the_latest():
    assert film.frame_count(30, 4, 600, fps=25) == 30 * 25
    assert film.frame_count(30, 4, 60, fps=25) == 15 * 25
    assert film.frame_count(30, 1e9, 60, fps=25) == 1
    assert film.frame_count(30, 4, float("inf"), fps=8) == 30 * 8


class Unstable:
    """A batch whose simulation becomes unstable in a step."""

    def __init__(self, batch, step):
        self._batch, self._left = batch, step

    def __getattr__(self, name):
        return getattr(self._batch, name)

    def step(self, motors):
        self._left -= 1
        self._batch.step(motors)

    @property
    def valid(self):
        return np.array([self._left > 0])


def test_film_ends_where_the_simulation_became_unstable():
    batch = make_batch("wall_avoidance", 1)
    episode = Episode(
        "wall_avoidance", "nobody", True, Unstable(batch, 5), lambda _: np.zeros((1, 2)), 20,
        np.random.default_rng(0),
    )  # fmt: skip
    times = np.arange(0, 2, 0.15)
    shots = [*film.shots_at(times, episode.moments(), batch.rules, 1)]
    assert [shot.time for shot in shots] == pytest.approx([0, 0.15, 0.3])  # the last step is 0.4 s


def test_robot_turns_the_shorter_way_between_two_control_steps():
    pose = film.between(np.array([0.0, 0.2, 3.0]), np.array([0.1, 0.0, -3.0]), 0.5)
    np.testing.assert_allclose(pose[:2], [0.05, 0.1])
    assert np.cos(pose[2]) == pytest.approx(-1)


def test_a_shot_between_two_control_steps_shows_the_one_before_and_the_pose_between():
    rules = make_batch("spot_finding", 1).rules
    readings = make_batch("spot_finding", 1).sensordata[0]
    moments = [
        Moment(
            0.1 * k,
            pose=np.array([0.1 * k, 0.2 * k, 0.3 * k]),
            spot=np.array([k, -k]) / 10,
            sensordata=readings + 0.001 * k,
            motors=np.array([0.1 * k, -0.1 * k]),
            event=k == 2,
            event_seconds=float(k),
        )
        for k in range(5)
    ]
    first, second = film.shots_at([0.05, 0.25], iter(moments), rules, speed=1)
    assert not first.event and second.event
    np.testing.assert_allclose(first.pose, [0.05, 0.1, 0.15])
    np.testing.assert_allclose(second.pose, [0.25, 0.5, 0.75])
    assert second.motors.tolist() == pytest.approx([0.2, -0.2])
    assert second.spot.tolist() == pytest.approx([0.2, -0.2]) and second.event_seconds == 2
    for name, values in rules.observations(moments[2].sensordata).items():
        np.testing.assert_array_equal(second.signals[name], values)
    trail = [[0, 0], [0.1, 0.2], [0.2, 0.4], [0.25, 0.5]]
    np.testing.assert_allclose(second.trail, trail, atol=1e-12)
    assert second.trail_events.tolist() == [False, False, True, False]
    np.testing.assert_allclose(second.trail_ages, np.array([0.25, 0.15, 0.05, 0]) / 8)


def test_shot_shows_what_happened_since_the_frame_before(stored):
    episode = stored(task="spot_finding", robot=1).episode()
    moments = list(episode.moments())
    moments[3].sensordata[episode.batch.rules.layout.touch] = 1.0  # contact at 0.3 s only
    shots = [*film.shots_at([0.0, 0.5, 1.0], iter(moments), episode.batch.rules, 5)]
    assert [shot.contact for shot in shots] == [False, True, False]
    assert [shot.time for shot in shots] == [0.0, 0.5, 1.0]
    np.testing.assert_allclose(shots[1].pose, moments[5].pose)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--task dancing", "holds policies for spot_finding_walls, not for dancing"),
        ("--task spot_finding", "holds policies for spot_finding_walls, not for spot_finding"),
        ("--task spot_finding_walls --proposer creative", "policies, which have no proposer"),
        ("--task spot_finding_walls --robot 2", "the policies are 0 to 1, got 2"),
        ("--task spot_finding_walls --seed -1", "the seed must lie in"),
        ("--task spot_finding_walls --speed 0", "speed must be positive"),
    ],
)
def test_policy_that_cannot_be_filmed_is_one_sentence_and_leaves_nothing(
    policy_file, tmp_path, capsys, words, sentence
):
    policies = policy_file("spot_finding_walls", tmp_path / "p.safetensors")
    output = ["--output", str(tmp_path / "film.mp4")]
    assert cli.main(["film", str(policies), *words.split(), *output]) == 2
    assert sentence in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["p.safetensors"]


def test_file_without_policies_is_one_sentence(directory, tmp_path, capsys):
    words = ["--task", "spot_finding", "--output", str(tmp_path / "film.mp4")]
    for path, sentence in (
        (tmp_path / "p.safetensors", "there is no file"),
        (directory / "results.safetensors", "holds no policies"),
        (tmp_path, "holds no experiment"),
        (tmp_path / "nothing", "there is no folder"),
        (directory / "robots.csv", "is neither a run's folder nor a .safetensors file"),
    ):
        assert cli.main(["film", str(path), *words]) == 2
        assert sentence in capsys.readouterr().err


def test_film_of_a_policy_can_be_a_gif_of_half_the_size(egl, policy_file, tmp_path):
    policies = policy_file("spot_finding_jumping", tmp_path / "p.safetensors")
    command = ["film", str(policies), "--task", "spot_finding_jumping", "--seconds", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "musebot", *command, "--output", str(tmp_path / "film.gif")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size == (WIDTH // 2, HEIGHT // 2)
        assert gif.n_frames == 8
        assert gif.info["loop"] == 0
