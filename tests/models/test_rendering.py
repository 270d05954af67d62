"""Pictures and windows: without a display, with one, and with the user's choice of a backend.

Each script runs in a process of its own, because a process chooses OpenGL once.
"""

import importlib
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

import musebot
from musebot import extras
from musebot.models import arena_spec, rendering
from musebot.protocols import errors
from musebot.protocols.pages.offscreen import Canvas

pytest.importorskip("gymnasium", reason="needs the extra `gym`")

# Everything is imported in the order of habit, in which musebot comes last.
HEADLESS = """
import gc, json, os, sys, warnings
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # dm_control's own, where it is imported first
    import dm_control.suite
import gymnasium
import mujoco
import numpy as np
import musebot
from gymnasium.wrappers import RecordEpisodeStatistics, RecordVideo
from gymnasium.wrappers.vector import RecordVideo as VecRecordVideo

seen = {}
musebot.register()
env = dm_control.suite.load("musebot_arena", "spot_finding")
env.reset()
physics = env.physics
seen["before"] = os.environ.get("MUJOCO_GL"), "OpenGL" in sys.modules
small = physics.render(64, 96, "overhead")
seen["std"] = float(small.std())
seen["twice"] = bool((physics.render(64, 96, "overhead") == small).all())
seen["large"] = physics.render(720, 1280, "overhead").shape
seen["after large"] = bool((physics.render(64, 96, "overhead") == small).all())
twin = physics.copy(share_model=True)  # its picture enlarges the buffer of the shared model
seen["shared"] = bool((twin.render(960, 1600) == physics.render(960, 1600)).all())


def make(mode="rgb_array", **kwargs):
    made = gymnasium.make("musebot/SpotFinding-v0", render_mode=mode, **kwargs)
    made.reset(seed=0)
    return made


def sentence(**kwargs):
    try:
        make(**kwargs)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


one, two = make(), make(width=1280, height=720)
image, large = one.render(), two.render()
seen["gymnasium"] = image.shape, str(image.dtype), float(image.std()), large.shape
own = one.unwrapped._environment.physics.render(320, 480, "overhead")
seen["both renderers"] = bool((own == image).all())
one.close()
one.close()
seen["after close"] = bool((two.render() == large).all())
three = make()
three.render()
del two
gc.collect()
seen["after deletion"] = bool((three.render() == image).all())
seen["among others"] = bool((physics.render(64, 96, "overhead") == small).all())
depth = make("depth_array").render()
both = make("rgbd_tuple").render()
seen["depth"] = depth.shape, float(depth.min()), float(depth.max()), float(depth.std())
seen["rgbd"] = bool((both[0] == image).all() and (both[1] == depth).all())
seen["window"] = sentence(mode="human")
seen["camera"] = sentence(camera="nose")

# Gymnasium warns that folders exist, and of moviepy's own warnings; neither is ours.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    film = RecordVideo(RecordEpisodeStatistics(make()), "single", disable_logger=True)
    robots = gymnasium.make_vec(
        "musebot/SpotFinding-v0", 2, vectorization_mode="sync", render_mode="rgb_array",
        width=96, height=64,
    )
    films = VecRecordVideo(
        robots, "batch", step_trigger=lambda n: n == 0, video_length=3, disable_logger=True
    )
    film.reset(seed=0)
    films.reset(seed=0)
    for _ in range(4):
        films.step(np.zeros((2, 2), np.float32))
        film.step(np.zeros(2, np.float32))
    film.close()
    films.close()
seen["after"] = os.environ["MUJOCO_GL"], "torch" in sys.modules
print(json.dumps(seen))
"""

WINDOW = """
import gymnasium, musebot, numpy as np, os
env = musebot.load("arena", "spot_finding")
env.reset()


def make(mode):
    made = gymnasium.make("musebot/SpotFinding-v0", render_mode=mode, camera="follow")
    made.reset(seed=0)
    return made


still = env.physics.render(64, 96)
window, pictures = make("human"), make("rgb_array")
first = pictures.render()
assert first.std() > 0
window.step(np.zeros(2, np.float32))
shown = window.unwrapped.mujoco_renderer.viewer.cam
assert shown.fixedcamid == window.unwrapped.model.camera("follow").id
assert (pictures.render() == first).all() and (env.physics.render(64, 96) == still).all()
window.close()
assert (pictures.render() == first).all() and (env.physics.render(64, 96) == still).all()
window = make("human")
assert (pictures.render() == first).all()
print(os.environ.get("MUJOCO_GL"))
"""

CHECKERS = """
import contextlib, warnings
import gymnasium
from gymnasium.utils.env_checker import check_env
import musebot

checkers = [lambda env: check_env(env.unwrapped, skip_render_check=False)]
with contextlib.suppress(ImportError):
    from stable_baselines3.common import env_checker
    checkers.append(lambda env: env_checker.check_env(env, skip_render_check=False))
warnings.simplefilter("error")
# Of the paper's action limits, which the paper prescribes.
warnings.filterwarnings("ignore", "We recommend you to use a symmetric and normalized Box")
for check in checkers:  # tests/tasks/test_gymnasium_env.py has every task, without pictures
    check(gymnasium.make("musebot/WallAvoidanceObstacles-v0", render_mode="rgb_array"))
print("checked")
"""

# As in the first script that many write: nothing is closed.
OPEN = """
import gymnasium
import musebot

env = gymnasium.make("musebot/SpotFinding-v0", render_mode="rgb_array")
robots = gymnasium.make_vec("musebot/SpotFinding-v0", num_envs=2, render_mode="rgb_array")
for one in (env, robots):
    one.reset(seed=1)
    one.render()
musebot.load("arena", "spot_finding").physics.render()
"""
FIRST = """
import gymnasium, musebot
env = gymnasium.make("musebot/SpotFinding-v0", render_mode="rgb_array")
env.reset(seed=0)
assert env.render().std() > 0
"""

# As Gymnasium's AsyncVectorEnv does with context="fork", after the parent has drawn.
FORKED = """
import os, signal, sys, threading, warnings
import gymnasium, musebot
warnings.simplefilter("ignore")
env = gymnasium.make("musebot/SpotFinding-v0", render_mode="rgb_array")
robots = gymnasium.make_vec("musebot/SpotFinding-v0", num_envs=2, render_mode="rgb_array")
suite = musebot.load("arena", "spot_finding")
def new():
    return gymnasium.make("musebot/SpotFinding-v0", render_mode="rgb_array")
def draw(one):
    one.reset(seed=1)
    return one.render()
if sys.argv[1] == "musebot":
    draw(env), draw(robots), suite.physics.render()
else:  # MuJoCo's own
    import mujoco
    mujoco.Renderer(env.unwrapped.model)
if os.fork() == 0:
    signal.alarm(60)
    for one in (env, robots, None, new()):
        try:
            draw(one) if one else suite.physics.render()
        except RuntimeError as error:
            print(error, flush=True)
    env.close()
    os._exit(0)
status = os.wait()[1]
seen = []
def elsewhere():  # pictures of a second thread are those of the first
    seen.extend([env.render(), robots.render()[0], suite.physics.render()])
draw(env), draw(robots)
first = [env.render(), robots.render()[0], suite.physics.render()]
thread = threading.Thread(target=elsewhere)
thread.start()
thread.join()
same = all((one == other).all() for one, other in zip(first, seen, strict=True))
assert status == 0 and same and env.render().std() > 0, status
"""


def ran(code, folder=None, *words, **changes):
    """Runs a script in a process that has no display but a given one."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    environment = {k: v for k, v in os.environ.items() if k not in names} | changes
    return subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=300,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("painter", ["musebot", "mujoco"])
def test_a_forked_process_refuses_pictures_after_its_parent_has_drawn_but_a_thread_draws(
    egl, painter
):
    done = ran(FORKED, None, painter, **({} if painter == "musebot" else {"MUJOCO_GL": "egl"}))
    assert done.returncode == 0, done.stderr
    sentences = done.stdout.splitlines()
    assert len(sentences) == 4 and len(set(sentences)) == 1
    assert sentences[0].startswith("OpenGL cannot be used in a process that was forked after a ")


DELETED = """
import os, tempfile
folder = tempfile.mkdtemp()
os.chdir(folder)
import musebot, musebot.tasks
os.rmdir(folder)
env = musebot.load("arena", "spot_finding")
env.reset()
assert env.physics.render().std() > 0
"""


@pytest.mark.slow
def test_a_deleted_working_directory_is_harmless_or_one_sentence(egl):
    done = ran(DELETED)
    assert done.returncode == 0, done.stderr
    last = ran(DELETED.replace(", musebot.tasks", "")).stderr.splitlines()[-1]
    assert last.startswith("FileNotFoundError: the working directory does not exist any more: ")


@pytest.mark.slow
def test_pictures_depth_and_films_are_made_without_a_display(egl, tmp_path):
    pytest.importorskip("moviepy", reason="needs the extra `gym`")
    done = ran(HEADLESS, tmp_path)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    # dm_control renders twice, in any size; EGL is chosen by the first picture and not before.
    assert seen["std"] > 0 and seen["twice"]
    assert seen["large"] == [720, 1280, 3] and seen["after large"] and seen["shared"]
    assert seen["before"] == [None, False] and seen["after"] == ["egl", False]
    # Gymnasium renders the same picture, and environments leave each other's pictures alone.
    shape, dtype, std, large = seen["gymnasium"]
    assert (shape, dtype, large) == ([320, 480, 3], "uint8", [720, 1280, 3]) and std > 0
    assert seen["both renderers"]
    assert seen["after close"] and seen["after deletion"] and seen["among others"]
    assert not done.stderr  # no warning, and nothing at exit, where four of them are still open
    shape, low, high, std = seen["depth"]
    assert shape == [320, 480] and 0 <= low < high <= 1 and std > 0 and seen["rgbd"]
    # A window and an unknown camera are one sentence.
    assert seen["window"] == (
        "RuntimeError: there is no display to open a window on; "
        "render_mode='rgb_array' needs no display"
    )
    assert seen["camera"].startswith("ValueError: camera must be one of ['overhead', ")
    assert seen["camera"].endswith("got 'nose'")
    for name in ("single", "batch"):
        (film,) = (tmp_path / name).glob("*.mp4")
        assert film.stat().st_size > 1000


@pytest.fixture(scope="module")
def display():
    """Number of a display, of its own or of a virtual one."""
    if not shutil.which("Xvfb"):
        pytest.skip("needs Xvfb")
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x1024x24"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    yield f":{server.stdout.readline().strip()}"
    server.terminate()
    server.wait()


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [{}, {"MUJOCO_GL": "egl"}], ids=["unset", "egl"])
def test_a_window_and_pictures_share_a_process(display, egl, chosen):
    done = ran(WINDOW, DISPLAY=display, **chosen)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == str(chosen.get("MUJOCO_GL"))


@pytest.mark.slow
@pytest.mark.parametrize("screen", [True, False], ids=["display", "none"])
def test_the_checkers_of_gymnasium_and_stable_baselines_skip_nothing(request, egl, screen):
    done = ran(CHECKERS, **({"DISPLAY": request.getfixturevalue("display")} if screen else {}))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "checked"


@pytest.mark.slow
@pytest.mark.parametrize("script", [OPEN, FIRST], ids=["several", "one"])
def test_environments_that_nobody_closes_end_in_silence(egl, script):
    done = ran(script)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")


@pytest.mark.parametrize(
    ("chosen", "sentence"),
    [
        ("off", "MUJOCO_GL is 'off', with which nothing is drawn: unset it"),
        ("glfw", "MUJOCO_GL is 'glfw', but there is no display .*: unset it, or set it to 'egl'"),
    ],
)
def test_the_users_choice_stands_and_its_failure_is_one_sentence(
    no_display, monkeypatch, chosen, sentence
):
    monkeypatch.setenv("MUJOCO_GL", chosen)
    physics = musebot.load("arena", "wall_avoidance").physics
    for _ in range(2):
        with pytest.raises(RuntimeError, match=sentence):
            physics.render(64, 64)
    assert os.environ["MUJOCO_GL"] == chosen


def test_without_egl_a_picture_is_refused_with_the_remedy_every_time(no_display, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")  # as if it were unset
    monkeypatch.setitem(sys.modules, "dm_control._render.pyopengl.egl_renderer", None)
    rendering._egl_context.cache_clear()
    for _ in range(2):
        with pytest.raises(RuntimeError, match=f"no headless OpenGL.*`{extras.EGL_REMEDY}`"):
            rendering.choose_backend()
    assert os.environ["MUJOCO_GL"] == ""


@pytest.mark.parametrize("canvas", [False, True], ids=["environment", "film"])
def test_triton_is_imported_before_egl(no_display, monkeypatch, tmp_path, canvas):
    (tmp_path / "triton.py").write_text("raise RuntimeError('broken, and harmless')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv("MUJOCO_GL")
    names = []
    imported = importlib.import_module
    monkeypatch.setattr(importlib, "import_module", lambda n: (names.append(n), imported(n)))
    for module in ("dm_control._render.pyopengl.egl_renderer", "mujoco.egl"):
        monkeypatch.setitem(sys.modules, module, None)
    rendering._egl_context.cache_clear()
    with pytest.raises((RuntimeError, errors.InputError), match="no headless OpenGL"):
        Canvas(arena_spec().compile(), "overhead", 64, 48) if canvas else rendering.choose_backend()
    assert names == ["triton"]


def test_the_buffer_grows_and_never_shrinks():
    model = arena_spec().compile()
    size = model.vis.global_
    assert not rendering.fit_buffer(model, 64, 64)
    assert rendering.fit_buffer(model, 1920, 64)
    assert (size.offwidth, size.offheight) == (1920, 960)
    assert not rendering.fit_buffer(model, np.int64(1920), 960)
