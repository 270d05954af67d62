"""Hostile command lines of every verb, carried out in this process up to where the work begins."""

import contextlib
import os
import shutil
from pathlib import Path

import numpy as np
from hostile import files, oracle
from hostile.mutations import one

from musebot.protocols.cli import diagnosis as doctor
from musebot.protocols.cli import parser as cli
from musebot.protocols.cli import speed
from musebot.protocols.compare import STUDIES, continual, creativity
from musebot.protocols.errors import InputError, Interrupted
from musebot.protocols.lives import local
from musebot.protocols.lives.budget import cohort_bytes
from musebot.protocols.lives.cohort import Cohort
from musebot.protocols.lives.jobs import CohortJob
from musebot.protocols.pages import film, measured_behaviour, paper_figures, robot_figures

SEED = 20041
WORK_BEGINS = 130  # the exit status where the work would begin, which the tests interrupt

NUMBERS = (
    "0", "-0", "-1", "1", "2", "3", "7", "250", "251", "1000", "1000000", "1000000000", "9" * 18,
    "1" + "0" * 400, "9" * 5000, "1e400", "-1e400", "nan", "inf", "-inf", "1e-320", "0.5", "1.5",
    "1e3", "1_000", "٣", "0x10", "0b1", "True", "None", "null", "", " ", "1 ", "1,5", "½", "+1",
    "--", "1e308", "-1e-9", "2147483648", "18446744073709551616",
    "340282366920938463463374607431768211456",
)  # fmt: skip
TEXTS = (
    "", " ", "a", "fixed", "creative", "wall_avoidance", "spot_finding", "os:system",
    "os.path:join",
    "../x", "/", "a[/]b", "[red]x[/red]", "\x1b[2J", "x\ny", "\u202egpj", "🤖", "\udcff",
    "x" * 10**5,
    "--help", "-h", "-", "=", "a=b", "%s%n", "$(id)", "${HOME}", "<script>", "\r", "\x7f", "'", '"',
    "paper", "steady", "steady-", "kinematic", "mujoco", "printed", "walls", "continual", "ray",
)  # fmt: skip
NESTED = ("[" * 10**5, "[" * 50 + "]" * 50, "{}", '{"a":1}', "[1e400]", "[NaN]", "[[0.5]]")
PARAMETERS = (
    "ideas", "evaluation_hidden", "memory_hidden", "epsilon", "learn_rate", "initial_range",
    "noise",
    "fixed_motors", "exploration_steps", "discount", "bootstrap", "random_share",
    "optimizer", "epsilon_decay_steps", "raw_signals", "nothing", "__class__",
)  # fmt: skip
KINEMATICS = ("radius", "wheel_base", "lag", "pieces", "wall", "felt", "any_contact", "x")

_SHORT = ["--robots", "2", "--time-scale", "0.002", "--body", "kinematic"]
_WORKERS = {"--processes": NUMBERS, "--engine": TEXTS, "--address": TEXTS}
_PLACES = "place"  # an option whose value is a path

# The words of a sound command line, and the options of each verb with their hostile values.
VERBS = {
    "run": (
        ["OUT", *_SHORT, "--proposer", "fixed"],
        {
            "--robots": NUMBERS, "--cohort-size": NUMBERS, "--seed": NUMBERS, "--task": TEXTS,
            "--proposer": TEXTS, "--agent": TEXTS, "--signals": TEXTS,
            "--agent-set": (*TEXTS, "rate=nan", "rate=1e400"), "--protocol": TEXTS,
            "--time-scale": NUMBERS,
            "--nose": TEXTS, "--body": TEXTS, "--brain": TEXTS, "--motor-speed": NUMBERS,
            "--arena-scale": NUMBERS,
            "--motor-torque": TEXTS, "--device": TEXTS, "--physics": TEXTS,
            "--nose-place": TEXTS, "--reading": TEXTS, "--config": _PLACES,
            "--set": "set", "--kinematics": "kinematics", "--save-every": NUMBERS,
            "--trust-agent": ("", "x"), "--log": TEXTS, **_WORKERS,
        },
    ),
    "tables": (["RUN"], {"--compare": _PLACES, "--json": ("", "x"), "--exact-classes": ("", "x")}),
    "film": (
        ["RUN", "--task", "spot_finding", "--output", "FILE"],
        {
            "--task": TEXTS, "--output": _PLACES, "--proposer": TEXTS, "--robot": NUMBERS,
            "--agent": TEXTS,
            "--phase": TEXTS, "--seconds": NUMBERS, "--speed": NUMBERS, "--seed": NUMBERS,
        },
    ),
    "report": (["RUN"], {"--output": _PLACES}),
    "figure": (["architecture", "new.svg"], {"--task": TEXTS, "--x": TEXTS}),
    "figure typical": (["new.png", "RUN"], {"--task": TEXTS}),
    "explore": (
        ["wall_avoidance"],
        {
            "--out": _PLACES, "--policies": _PLACES, "--keys": ("",), "--random": ("",),
            "--proposer": TEXTS, "--robot": NUMBERS, "--phase": TEXTS, "--agent": TEXTS,
        },
    ),
    "demo": (
        ["OUT"],
        {"--robots": NUMBERS, "--time-scale": NUMBERS, "--seed": NUMBERS, **_WORKERS},
    ),
    "list": (["tasks"], {"--x": TEXTS}),
    "check-agent": (
        ["newborn"],
        {
            "--task": TEXTS, "--protocol": TEXTS, "--signals": TEXTS,
            "--agent-set": (*TEXTS, "rate=nan", "rate=1e400"),
        },
    ),
    "bench": (
        ["--quick"],
        {
            "--json": _PLACES, "--quick": ("", "1"), "--device": TEXTS,
        },
    ),
    "doctor": ([], {"--x": TEXTS}),
    "study": ([], {"--x": TEXTS}),
    "study sensitivity": (["OUT"], {"--robots": NUMBERS, "--time-scale": NUMBERS, **_WORKERS}),
    "study reading": (
        ["OUT", "--time-scale", "0.002"],
        {
            "--robots": NUMBERS, "--newborns": NUMBERS, "--screened": NUMBERS, "--stage": NUMBERS,
            "--finalists": NUMBERS, "--time-scale": NUMBERS, **_WORKERS,
        },
    ),
    "study proposers": (
        ["OUT", "--part", "rule", "--robots", "2", "--time-scale", "0.002"],
        {"--part": TEXTS, "--robots": NUMBERS, "--time-scale": NUMBERS, **_WORKERS},
    ),
    "study tune": (
        ["OUT", "--agent", "q_learner", "--robots", "2", "--time-scale", "0.002", "--trials", "2",
         "--kept", "1"],
        {
            "--agent": TEXTS, "--signals": TEXTS, "--task": TEXTS, "--trials": NUMBERS,
            "--kept": NUMBERS, "--robots": NUMBERS, "--seed": NUMBERS, "--kinematics": "kinematics",
            "--time-scale": NUMBERS, **_WORKERS,
        },
    ),
    "study wear": (
        ["OUT", "--robots", "2", "--time-scale", "0.002", "--arm", "frozen"],
        {
            "--change": TEXTS, "--arm": TEXTS, "--robots": NUMBERS, "--seed": NUMBERS,
            "--body": TEXTS, "--kinematics": "kinematics", "--time-scale": NUMBERS, **_WORKERS,
        },
    ),
    "study evolve": (
        ["OUT", "--budget", "4", "--generation", "4", "--robots", "2", "--time-scale", "0.002"],
        {
            "--brain": TEXTS, "--set": "set", "--over": PARAMETERS, "--budget": NUMBERS,
            "--generation": NUMBERS, "--robots": NUMBERS, "--task": TEXTS, "--protocol": TEXTS,
            "--time-scale": NUMBERS, "--kinematics": "kinematics", "--seed": NUMBERS, **_WORKERS,
        },
    ),
    "study ablation": (
        ["OUT"],
        {
            "--robots": NUMBERS, "--task": TEXTS, "--cohort-size": NUMBERS, "--seed": NUMBERS,
            "--body": TEXTS, "--kinematics": "kinematics", "--time-scale": NUMBERS, **_WORKERS,
        },
    ),
    "study creativity": (["OUT", "--runs", "BOARD"], {"--runs": _PLACES, **_WORKERS}),
    "study robustness": (
        ["OUT", "--runs", "RUN"],
        {
            "--runs": _PLACES, "--robots": NUMBERS, "--seed": NUMBERS, "--body": TEXTS,
            "--proposer": TEXTS, **_WORKERS,
        },
    ),
    "study continued-learning": (
        ["OUT", "--runs", "RUN"],
        {
            "--runs": _PLACES, "--agent": TEXTS, "--robots": NUMBERS, "--seed": NUMBERS,
            **_WORKERS,
        },
    ),
    "study learning-progress": (
        ["OUT", "--brains", "paper", "--robots", "2", "--body", "kinematic"],
        {
            "--brains": TEXTS, "--robots": NUMBERS, "--seed": NUMBERS, "--body": TEXTS,
            "--kinematics": "kinematics", "--time-scale": NUMBERS, "--reading": TEXTS, **_WORKERS,
        },
    ),
    "study continual": (["OUT", "--runs", "MOVED"], {"--runs": _PLACES, **_WORKERS}),
    "study benchmark": (
        ["OUT", "--agent", "q_learner", "--robots", "2", "--time-scale", "0.002", "--body",
         "kinematic", "--signals", "raw", "--board", "walls"],
        {
            "--tuned": _PLACES, "--agent": TEXTS, "--signals": TEXTS, "--board": TEXTS,
            "--robots": NUMBERS, "--seed": NUMBERS, "--body": TEXTS, "--time-scale": NUMBERS,
            **_WORKERS,
        },
    ),
    "study leaderboard": (
        ["OUT", "--runs", "BOARD"],
        {"--runs": _PLACES, "--tuned": _PLACES, **_WORKERS},
    ),
    "study ppo": (
        ["OUT", "--task", "spot_finding_unit"],
        {
            "--task": TEXTS, "--policies": NUMBERS, "--steps": NUMBERS, "--seed": NUMBERS,
            **_WORKERS,
        },
    ),
    "study timestep": (["OUT"], {"--robots": NUMBERS, "--minutes": NUMBERS, **_WORKERS}),
    "study nothing": (["OUT"], {"--x": TEXTS}),
    "nothing": (["OUT"], {"--x": TEXTS}),
}  # fmt: skip


# ---- Places: what a path of a command line may be ----


def places(base, folder):
    """Makes a folder of places of every kind; returns them by kind.

    Args:
      base: Folder with `a`, made by `files.make`.
      folder: New folder.
    """
    folder.mkdir()
    run, foreign = folder / "run", folder / "foreign"
    shutil.copytree(base / "a" / "run", run)
    foreign.mkdir()
    (foreign / ".secret").write_text("mine")
    (foreign / "notes.txt").write_text("mine")
    (folder / "file.txt").write_text("mine")
    (folder / "film.mp4").write_text("mine")
    (folder / "link").symlink_to(foreign)
    (folder / "to_run").symlink_to(run)
    (folder / "dangling").symlink_to(folder / "nowhere")
    (folder / "loop").symlink_to("loop")
    (folder / "film_link.mp4").symlink_to(folder / "film.mp4")
    (folder / "hidden").mkdir()
    (folder / "hidden" / ".git").mkdir()
    os.mkfifo(folder / "pipe")
    shutil.copy(base / "a" / "policies.safetensors", folder)
    names = [
        "new", "run", "foreign", "file.txt", "link", "to_run", "dangling", "loop", "hidden", "pipe",
        "file.txt/x", "a/b/c", "a[/]b", "x\ny", "\x1b[2J", "\udcff", "x" * 255, "x" * 4000,
        "y/" * 2000 + "z", "policies.safetensors", "new.mp4", "film.mp4", "film_link.mp4",
        "new.gif",
        "new.html", "foreign/new.html", "new.svg", "link/new.mp4", "new.json", "🤖.mp4", "MP4.MP4",
        "-", "\u202e.mp4", "foreign/notes.txt", "foreign/x.mp4", "nowhere/x.mp4", "run/robots.csv",
        "run/x.mp4", "run/figures", "run/experiment.json", "..", ".", "run/../foreign", "%s", "{}",
    ]  # fmt: skip
    return [str(folder / name) for name in names] + [
        "", " ", ".", "..", "-", "/", "/dev/null", "/dev/full", "/proc/1/mem", "/proc/self/fd/1",
        "/sys/x.mp4", "/dev/null/x", "~/x", "/root/../dev/full", "~nobody", "//", "/dev/stdout",
    ]  # fmt: skip


# ---- The work, which is begun and no more ----


class Trial:
    """An executor that begins the first job: its cohort is born and takes two steps."""

    def __call__(self, jobs, progress):
        job = jobs[0]
        if isinstance(job, CohortJob):
            if cohort_bytes(job.experiment, job.keys[0].condition) < 2**26:
                cohort = Cohort(job.experiment, job.keys[0])
                cohort.advance(2)
                for weights in cohort.agent.weights().values():
                    assert np.isfinite(weights).all(), "weights that are not finite"
        raise Interrupted
        yield


class _Stage:
    """Stands for the scene of a film."""

    renderer = "nothing"

    def __init__(self, task, half_length):
        del task, half_length

    def draw(self, shot, trail):
        del shot, trail
        return np.zeros((496, 720, 3), np.uint8)

    def close(self):
        """Closes nothing."""


def _begin(*arguments, **options):
    raise Interrupted


def _two_frames(output, frames, count):
    del output, count
    for _, _ in zip(range(2), frames, strict=False):
        pass
    raise Interrupted


@contextlib.contextmanager
def begun_only(patch):
    """Lets every command stop where its long work begins.

    Args:
      patch: Pytest's MonkeyPatch.
    """
    patch.setattr(local, "Local", lambda processes: Trial())
    patch.setattr(film, "Scene", _Stage)
    patch.setattr(film, "write", _two_frames)
    patch.setattr(measured_behaviour, "observe", _begin)
    patch.setattr(robot_figures, "typical", _begin)
    for name in ("architecture", "robot"):
        patch.setattr(paper_figures, name, _begin)
    for measurement in ("lives", "interfaces", "processes", "populations"):
        patch.setattr(speed, measurement, _begin)
    patch.setattr(doctor, "report", lambda: 0)
    for study in (continual, creativity):
        patch.setattr(study, "draw", _begin)
    patch.delenv("DISPLAY", raising=False)
    patch.delenv("WAYLAND_DISPLAY", raising=False)
    with contextlib.suppress(InputError):
        from musebot.protocols.lives import ray_cluster

        def refused(address):
            raise InputError(f"there is no Ray cluster at {address!r}")

        patch.setattr(ray_cluster, "RayCluster", refused)
    yield


# ---- Cases ----


def words_of(draw, base, where):
    """Returns a hostile command line.

    Args:
      draw: Random stream.
      base: Folder with `a`, made by `files.make`.
      where: Places, as `places` returns them.
    """
    verb = [*VERBS][draw.integers(len(VERBS))]
    sound, options = VERBS[verb]
    words = list(sound)
    for _ in range(1 + int(draw.integers(4) // 3) + int(draw.integers(6) // 5)):
        _change(draw, words, options, where)
    own = placed(base, where)
    return [
        *verb.split(),
        *(
            one(draw, where) if word in ("OUT", "FILE", "RUN") and draw.random() < 0.35
            else own.get(word, word)
            for word in words
        ),
    ]  # fmt: skip


def sound_words(verb, base, where):
    """Returns the sound command line of a verb; see `words_of` for the arguments."""
    own = placed(base, where)
    return [*verb.split(), *(own.get(word, word) for word in VERBS[verb][0])]


def _change(draw, words, options, where):
    names = [*options]
    name = one(draw, names)
    what = draw.integers(16)
    if what == 0 and words:
        words.pop(draw.integers(len(words)))
    elif what == 1:
        words.insert(int(draw.integers(len(words) + 1)), one(draw, TEXTS))
    elif name in words and words.index(name) + 1 < len(words):
        words[words.index(name) + 1] = _value(draw, options[name], where)
    else:
        words += [name, _value(draw, options[name], where)]
        if words[-1] == "" and what < 10:
            words.pop()


def _value(draw, kind, where):
    if kind == _PLACES:
        return one(draw, where)
    if kind in ("set", "kinematics"):
        names = PARAMETERS if kind == "set" else KINEMATICS
        values = (*NUMBERS, *NESTED, *TEXTS) if draw.random() < 0.5 else NUMBERS
        return f"{one(draw, names)}={one(draw, values)}"
    return one(draw, kind)


def placed(base, where):
    """Returns the paths that stand for the words of a sound command line.

    Args:
      base: Folder with `a`, made by `files.make`; no case may change it.
      where: Places, as `places` returns them.
    """
    own = Path(where[0]).parent
    paths = {"OUT": own / "new", "FILE": own / "new.mp4", "RUN": own / "run"}
    paths |= {"BOARD": base / "a" / "board", "MOVED": base / "a" / "moved"}
    return {word: str(path) for word, path in paths.items()}


def case(base, folder, number):
    """Carries out one command line; returns the class of what happened, and a sentence.

    Args:
      base: Folder with `a`, made by `files.make`.
      folder: Folder of the case; it is removed.
      number: Number of the case.
    """
    draw = np.random.default_rng([SEED, number])
    folder.mkdir()
    where = places(base, folder / "all")
    here = folder / "here"
    here.mkdir()
    words = words_of(draw, base, where)
    before, outside = oracle.snapshot(folder), oracle.snapshot(base, contents=False)
    with contextlib.chdir(here):
        outcome = oracle.carried_out(lambda: (cli.main(words), None))
    shown = [word if len(word) < 200 else f"{word[:60]}...({len(word)})" for word in words]
    said = f"command {number}, {shown!a}: {outcome.status} {outcome.printed.strip()[-1500:]}"
    after = oracle.snapshot(folder)
    changed = [path for path in {*before, *after} if before.get(path) != after.get(path)]
    for path in (folder / "all").rglob("*"):
        if path.is_dir() and not path.is_symlink():
            path.chmod(0o755)
    shutil.rmtree(folder)
    assert oracle.snapshot(base, contents=False) == outside, (
        f"{said}: something outside was changed"
    )
    lost = [p for p in changed if p in before and os.fsencode(folder / "all") in p]
    lost = [p for p in lost if b"/all/run" not in p]
    return _judged(words, outcome, sorted(changed), lost), said


def _judged(words, outcome, changed, lost):
    if lost:
        return f"wrong: changed {lost}"
    if outcome.status == 0:
        return "carried out" if not changed or words[0] == "study" else f"wrong: changed {changed}"
    if outcome.status == WORK_BEGINS:
        return "sound: the work would begin"
    if wrong := oracle.complaint(outcome):
        return f"wrong: {wrong}"
    if changed:
        return f"wrong: refused, but changed {changed}"
    return f"refused, status {outcome.status}"


assert {f"study {name}" for name in STUDIES} <= {*VERBS}
assert files.KINDS
