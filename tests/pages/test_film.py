"""Films: the file, the frames in it, and what is left of a film that fails."""

import dataclasses
import itertools
import os
import resource
import shutil
import signal
import sys
import tempfile
import weakref
from typing import Any
from unittest.mock import Mock

import imageio.v2 as imageio
import numpy as np
import pytest
from helpers import change_physics, random_policy

from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import InputError
from musebot.protocols.pages import film
from musebot.protocols.pages.panel import HEIGHT, WIDTH
from musebot.protocols.pages.replay import Episode, Moment
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.manifest import read_manifest, write_manifest
from musebot.protocols.runs.run_files import read_measured, write_results
from musebot.protocols.storage import draft_name, save_arrays
from musebot.tasks import make_batch


def test_film_is_h264_in_yuv420p_of_the_requested_length_and_something_moves(
    egl, directory, tmp_path, capsys
):
    output = tmp_path / "film.mp4"
    options = "--task wall_avoidance --robot 1 --speed 2 --seconds 0.6 --phase both"
    assert cli.main(["film", str(directory), "--output", str(output), *options.split()]) == 0
    said = capsys.readouterr()
    assert said.out.strip() == str(output) and "drawing with" in said.err
    assert os.listdir(tmp_path) == ["film.mp4"]

    reader: Any = imageio.get_reader(output)
    with reader:
        meta = reader.get_meta_data()
        images = np.stack([np.asarray(image) for image in reader])
    assert (meta["codec"], meta["pix_fmt"][:7], meta["fps"]) == ("h264", "yuv420p", 25)
    assert meta["duration"] == pytest.approx(0.6, abs=0.5 / 25)
    assert images.shape == (15, HEIGHT, 2 * WIDTH, 3)
    left, right = images[0, 60:, :WIDTH].astype(int), images[0, 60:, WIDTH:]
    assert (abs(left - right) < 20).mean() > 0.9  # two brains of one robot, at one place
    assert images[0].std() > 20  # not a blank frame
    # More changes than compression or the clock alone would change.
    changed = np.abs(images[-1].astype(int) - images[0])[:, : WIDTH - 240].max(axis=2)
    assert (changed > 60).sum() > 100


def test_a_film_that_cannot_be_made_is_one_sentence_and_leaves_nothing(
    stored, tmp_path, monkeypatch
):
    (tmp_path / "d.mp4").mkdir()
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    episode = stored().episode()
    for changes, sentence in (
        ({"seconds": 1e-320}, "length in seconds must lie in"),
        ({"seconds": 3601.0}, r"must lie in \[0.001, 3600\], got 3601"),
        ({"seconds": 3600.0}, "there is no headless OpenGL"),
        ({"speed": float("nan")}, "speed must lie in"),
        ({"output": "film.avi"}, "must be an .mp4 or a .gif"),
        ({"output": "nowhere/film.mp4"}, "no folder"),
        ({"output": "d.mp4"}, "is a folder"),
    ):
        options = {"output": "film.mp4", "seconds": 1.0, "speed": 1.0, **changes}
        output = tmp_path / options.pop("output")
        with pytest.raises(InputError, match=sentence):
            film.film([episode], output, **options)
        assert os.listdir(tmp_path) == ["d.mp4"]


GREY = np.full((HEIGHT, WIDTH, 3), 128, dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_all_frames_are_written_and_only_the_film_and_its_drafts_are_replaced(tmp_path, suffix):
    output = tmp_path / f"film{suffix}"
    output.write_bytes(b"older")
    (tmp_path / draft_name(output.name)).write_bytes(b"half")  # of a film that was killed
    others = {".film.17.mp4", draft_name("other.mp4")}
    for name in others:
        (tmp_path / name).write_bytes(b"mine")
    assert film.write(output, [GREY] * 5, 6) == 5
    assert {*os.listdir(tmp_path)} == {*others, output.name}
    reader: Any = imageio.get_reader(output)
    with reader:
        shapes = [frame.shape[:2] for frame in reader]
    half = 2 if suffix == ".gif" else 1
    assert shapes == [(HEIGHT // half, WIDTH // half)] * 5


def failing():
    """Two frames, and then an error."""
    yield from [GREY] * 2
    raise RuntimeError("out of paint")


def ended():
    """Two frames, and then the signal by which a system ends a process."""
    yield from [GREY] * 2
    os.kill(os.getpid(), signal.SIGTERM)
    yield from [GREY] * 100


def test_failed_film_leaves_the_older_one_and_no_draft(tmp_path, monkeypatch):
    (tmp_path / "drafts").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "drafts"))
    before = signal.getsignal(signal.SIGTERM)
    for suffix, frames, error in (
        (".mp4", failing, RuntimeError), (".gif", ended, KeyboardInterrupt)
    ):  # fmt: skip
        output = tmp_path / suffix / f"film{suffix}"
        output.parent.mkdir()
        output.write_bytes(b"older")
        with pytest.raises(error):
            film.write(output, frames(), 102)
        assert os.listdir(output.parent) == [output.name] and output.read_bytes() == b"older"
        assert not os.listdir(tmp_path / "drafts")
    assert signal.getsignal(signal.SIGTERM) is before


def test_full_disk_is_one_sentence_and_leaves_nothing(tmp_path):
    random, limits = np.random.default_rng(0), resource.getrlimit(resource.RLIMIT_FSIZE)
    frames = (random.integers(0, 256, (108, 192, 3), dtype=np.uint8) for _ in range(300))
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))  # ffmpeg ends before the last
    try:
        with pytest.raises(OSError, match="could not be written completely; is the disk full"):
            film.write(tmp_path / "film.mp4", frames, 300)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not os.listdir(tmp_path)


def test_a_film_that_is_shorter_than_asked_says_so(tmp_path, monkeypatch, capsys):
    picture, counts = np.zeros((HEIGHT - 44, WIDTH - 240, 3), np.uint8), []
    scene = Mock(renderer="nothing", draw=lambda shot, trail: picture)
    monkeypatch.setattr(film, "Scene", lambda task, dimensions: scene)

    def write(output, frames, count):
        counts.append((count, len([*frames])))
        return counts[-1][1]

    def unstable(moments):  # from the step after these moments on
        monkeypatch.setattr(Episode, "moments", lambda self: itertools.islice(moments(self), 5))

    monkeypatch.setattr(film, "write", write)
    for seconds, speed, frames, sentence in (
        (2.0, 1.0, (50, 50), ""),
        (5.0, 1.0, (50, 50), "the episode lasts 2 s, so the film lasts 2 s"),
        (1.0, 4.0, (12, 12), "the episode lasts 2 s, so the film lasts 0.48 s"),
        (5.0, 1e9, (1, 1), "the episode lasts 2 s, so the film lasts 0.04 s"),
        (2.0, 1.0, (50, 11), "the simulation became unstable: the film ends there, after 0.44"),
    ):
        if "unstable" in sentence:
            unstable(Episode.moments)
        batch, random = make_batch("wall_avoidance", 1), np.random.default_rng(0)
        words = "wall_avoidance", "nobody", "after training", "in contact"
        episode = Episode(*words, batch, lambda _: np.zeros((1, 2)), 20, random)
        film.film([episode], tmp_path / "film.mp4", seconds=seconds, speed=speed)
        said = capsys.readouterr().err
        assert sentence in said and said.count("musebot:") == 1 + bool(sentence)
        assert counts.pop() == frames


def test_a_shot_shows_one_instant_the_control_step_before_and_the_pose_between():
    turns = 0.0, 0.3, 3.0, -3.0, 0.0
    moments = [
        Moment(
            0.1 * k, np.array([k / 100, k / 50, turns[k]]), np.array([k, -k]), {"nose": k},
            np.array([k, -k]), contact=k == 1, event=k == 2, event_seconds=float(k),
        )
        for k in range(5)
    ]  # fmt: skip
    (first, _), (second, trail), (last, _) = film.shots_at([0.05, 0.25, 0.4], iter(moments), 1)
    for shot, time, step in ((first, 0.05, 0), (second, 0.25, 2), (last, 0.4, 4)):
        assert (shot.time, shot.event, shot.contact) == (time, step == 2, step == 1)
    np.testing.assert_allclose(first.pose, [0.005, 0.01, 0.15])
    np.testing.assert_allclose(second.pose[:2], [0.025, 0.05])
    assert np.cos(second.pose[2]) == pytest.approx(-1)  # it turned the shorter way
    np.testing.assert_allclose(last.pose, moments[4].pose)
    assert last.motors is moments[4].motors  # the episode is over
    for name in ("motors", "signals", "spot", "event_seconds"):
        assert getattr(second, name) is getattr(moments[2], name)
    points = [[0, 0], [0.01, 0.02], [0.02, 0.04], [0.025, 0.05]]
    np.testing.assert_allclose(trail.points, points, atol=1e-12)
    assert trail.events.tolist() == [False, False, True, False]
    np.testing.assert_allclose(trail.ages, np.array([0.25, 0.15, 0.05, 0]) / 8)


def test_a_robot_that_is_placed_elsewhere_does_not_drive_there():
    places = [np.array([x, 0.0, 1.0]) for x in (0.0, 0.01, 0.4)]
    spot, signals = np.zeros(2), {"nose": np.zeros(1)}
    moments = [
        Moment(0.1 * k, place, spot, signals, np.zeros(2), False, False, 0.0)
        for k, place in enumerate(places)
    ]
    shots = [shot.pose for shot, _ in film.shots_at([0.05, 0.15, 0.2], iter(moments), 1)]
    np.testing.assert_allclose(shots, [[0.005, 0, 1], places[1], places[2]])


def test_a_film_keeps_no_more_moments_than_a_trail_draws():
    made, place = [], np.zeros(3)

    def moments():
        for k in range(3000):
            one = Moment(0.1 * k, place, place[:2], {}, place[:2], False, False, 0.0)
            made.append(weakref.ref(one))
            yield one

    for speed in (1000, 0.01):
        for _, trail in film.shots_at(np.arange(0, 299, 7.0), moments(), speed):
            assert sum(one() is not None for one in made) <= 905
            assert len(trail.points) <= 902
        made.clear()


def test_a_source_that_cannot_be_filmed_is_one_sentence_and_leaves_nothing(
    directory, tmp_path, capsys
):
    walkers = random_policy("spot_finding_walls").arrays
    save_arrays(tmp_path / "p.safetensors", walkers, task="spot_finding_walls")
    save_arrays(tmp_path / "other.safetensors", {"age": np.zeros(1)})
    (tmp_path / "text.csv").write_text("text")
    output = ["--output", str(tmp_path / "film.mp4")]
    walls, spot = "--task spot_finding_walls", "--task spot_finding"
    for source, words, sentence in (
        ("p.safetensors", "--task dancing", "a policy for spot_finding_walls, not for dancing"),
        ("p.safetensors", f"{walls} --proposer creative", "holds a policy: --proposer needs a run"),
        ("p.safetensors", f"{walls} --robot 0", "holds a policy: --robot needs a run"),
        ("p.safetensors", f"{walls} --seed -1", "the seed must lie in"),
        ("q.safetensors", spot, "there is no file"),
        ("other.safetensors", spot, "holds no policy"),
        (directory / "results.safetensors.gz", spot, "is neither a run's folder nor"),
        ("text.csv", spot, "is neither a run's folder nor a .safetensors file"),
    ):
        assert cli.main(["film", str(tmp_path / source), *words.split(), *output]) == 2
        said = capsys.readouterr().err
        assert sentence in said and said.count("\n") == 1
        assert {*os.listdir(tmp_path)} == {"p.safetensors", "other.safetensors", "text.csv"}


def commanded(folder, words, output):
    """Returns the status of `musebot film` for wall avoidance."""
    words = f"--task wall_avoidance --output {output} {words}".split()
    return cli.main(["film", str(folder), *words])


def test_nothing_is_simulated_before_a_refusal(directory, tmp_path, monkeypatch, capsys):
    shutil.copytree(directory, warp := tmp_path / "warp")
    plan = read_manifest(directory)
    measured = read_measured(directory, plan.experiment)
    other = dataclasses.replace(plan.experiment, physics="warp")
    write_manifest(warp, dataclasses.replace(plan, experiment=other), begun=False)
    write_results(warp, other, measured)
    monkeypatch.setattr(Cohort, "advance", Mock(side_effect=AssertionError))
    for folder, words, name, sentence in (
        (directory, "--minute 0.3", "x.avi", "must be an .mp4 or a .gif"),
        (directory, "--minute 0.3 --seconds 0", "x.gif", "length in seconds must lie in"),
        (directory, "--minute 0.3 --phase pre", "x.gif", "it excludes --phase and --seed"),
        (warp, "--minute 0.3", "x.gif", "in MuJoCo Warp cannot be simulated again"),
    ):
        assert commanded(folder, words, tmp_path / name) == 2
        said = capsys.readouterr().err
        assert sentence in said and said.count("\n") == 1
        assert os.listdir(tmp_path) == ["warp"]


def test_another_physics_is_told_once(directory, tmp_path, monkeypatch, capsys):
    shutil.copytree(directory, other := tmp_path / "run")
    change_physics(other)
    made = []
    monkeypatch.setattr(film, "film", lambda episodes, *_, **__: made.extend(episodes))
    for words, count in (("--phase both", 2), ("--minute 0.1", 1)):
        assert commanded(other, words, "x.gif") == 0
        assert capsys.readouterr().err.count("was simulated in another physics") == 1
        assert len(made) == count
        made.clear()
