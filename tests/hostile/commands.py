"""Hostile command lines of every verb, carried out in this process up to where the work begins."""

import contextlib
import dataclasses
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import get_type_hints

import numpy as np
from hostile import oracle
from hostile.oracle import one

from musebot.protocols.cli import doctor, speed, verbs
from musebot.protocols.cli import parser as cli
from musebot.protocols.errors import Interrupted
from musebot.protocols.pages import film, measured_behaviour
from musebot.protocols.runs import local
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.jobs import CohortJob
from musebot.protocols.runs.plan import cohort_bytes

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
    "os.path:join", "../x", "/", "a[/]b", "[red]x[/red]", "\x1b[2J", "x\ny", "\u202egpj", "🤖",
    "\udcff", "x" * 10**5, "--help", "-h", "-", "=", "a=b", "%s%n", "$(id)", "${HOME}",
    "<script>", "\r", "\x7f", "'", '"', "paper", "steady", "steady-", "kinematic", "mujoco",
    "printed", "body", "body@2", "continual", "ray",
)  # fmt: skip
NESTED = ("[" * 10**5, "[" * 50 + "]" * 50, "{}", '{"a":1}', "[1e400]", "[NaN]", "[[0.5]]")
NAMES = (
    "ideas evaluation_hidden memory_hidden epsilon learn_rate initial_range noise fixed_motors "
    "discount bootstrap optimizer epsilon_decay_steps raw_signals nothing __class__ radius "
    "wheel_base lag pieces wall felt motor_speed brain.epsilon brain.ideas "
    "kinematics.lag rate"
).split()
PLACES = "--output --config --compare --out --policy --tuned --json".split()

_SHORT = "--robots 2 --time-scale 0.002"
# A sound command line of each verb; the options come from the verb's own fields.
SOUND = {
    "run": f"OUT {_SHORT} --body kinematic --proposer fixed",
    "tables": "RUN",
    "film": "RUN --task spot_finding --output FILE",
    "report": "RUN",
    "explore": "wall_avoidance",
    "list": "tasks",
    "bench": "--quick",
    "doctor": "",
    "benchmark run": f"OUT --agent q_learner {_SHORT} --life body --signals raw",
    "benchmark tune": f"OUT --agent q_learner {_SHORT} --trials 2 --kept 1",
    "benchmark ppo": "OUT --task spot_finding_unit",
}
VERBS = [*SOUND]


def options_of(verb):
    """Returns the options of a verb by name, and whether each takes a value."""
    found, kinds = {}, [verbs.verb_class(verb)]
    for kind in kinds:
        hints = get_type_hints(kind)
        for field in dataclasses.fields(kind):
            if dataclasses.is_dataclass(hint := hints[field.name]):
                kinds.append(hint)
            else:
                found[f"--{field.name.replace('_', '-')}"] = hint is not bool
    return found | {"--x": True}


# ---- Places: what a path of a command line may be ----


def places(base, folder):
    """Makes a folder of places of every kind from the files in `base`; returns their paths."""
    folder.mkdir()
    run, foreign = folder / "run", folder / "foreign"
    shutil.copytree(base / "a" / "run", run)
    (folder / "hidden" / ".git").mkdir(parents=True)
    foreign.mkdir()
    for file in (foreign / ".secret", foreign / "notes.txt", folder / "file.txt"):
        file.write_text("mine")
    (folder / "film.mp4").write_text("mine")
    links = {"link": foreign, "to_run": run, "dangling": folder / "nowhere", "loop": "loop"}
    for name, target in (links | {"film_link.mp4": folder / "film.mp4"}).items():
        (folder / name).symlink_to(target)
    os.mkfifo(folder / "pipe")
    shutil.copy(base / "a" / "policy.safetensors", folder)
    names = [
        "new", "run", "foreign", "file.txt", "link", "to_run", "dangling", "loop", "hidden", "pipe",
        "file.txt/x", "a/b/c", "a[/]b", "x\ny", "\x1b[2J", "\udcff", "x" * 255, "x" * 4000,
        "y/" * 2000 + "z", "policy.safetensors", "new.mp4", "film.mp4", "film_link.mp4",
        "new.gif", "new.html", "foreign/new.html", "new.svg", "link/new.mp4", "new.json", "🤖.mp4",
        "MP4.MP4", "-", "\u202e.mp4", "foreign/notes.txt", "foreign/x.mp4", "nowhere/x.mp4",
        "run/robots.csv", "run/x.mp4", "run/figures", "run/experiment.json", "..", ".",
        "run/../foreign", "%s", "{}",
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
            if cohort_bytes(job.experiment, job.key.condition) < 2**26:
                cohort = Cohort(job.experiment, job.key)
                cohort.advance(2)
                for weights in cohort.agent.weights().values():
                    assert np.isfinite(weights).all(), "weights that are not finite"
        raise Interrupted
        yield


def _begin(*arguments, **options):
    raise Interrupted


def _two_frames(output, frames, count):
    for _, _ in zip(range(2), frames, strict=False):
        pass
    raise Interrupted


def _stage(task, half_length):
    """Stands for the scene of a film."""
    picture = np.zeros((496, 720, 3), np.uint8)
    return SimpleNamespace(renderer="nothing", draw=lambda shot, trail: picture, close=lambda: None)


def begun_only(patch):
    """Lets every command stop where its long work begins, by pytest's MonkeyPatch."""
    patch.setattr(local, "Local", lambda processes: Trial())
    patch.setattr(film, "Scene", _stage)
    patch.setattr(film, "write", _two_frames)
    for module, names in (
        (measured_behaviour, ("observe",)),
        (speed, ("lives", "interfaces", "backends", "populations")),
        (doctor, ("report",)),
    ):
        for name in names:
            patch.setattr(module, name, _begin)
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        patch.delenv(variable, raising=False)
    patch.setitem(sys.modules, "ray", None)  # no cluster is looked for


# ---- Cases ----


def words_of(draw, where):
    """Returns a hostile command line, with places of `places`."""
    verb = one(draw, VERBS)
    words, options = SOUND[verb].split(), options_of(verb)
    for _ in range(1 + int(draw.integers(4) // 3) + int(draw.integers(6) // 5)):
        _change(draw, words, options, where)
    hostile = _placed(words, where, lambda: draw.random() < 0.35 and one(draw, where))
    return [*verb.split(), *hostile]


def sound_words(verb, where):
    """Returns the sound command line of a verb, with places of `places`."""
    return [*verb.split(), *_placed(SOUND[verb].split(), where, lambda: None)]


def _placed(words, where, other):
    """Returns words with paths for OUT, FILE and RUN."""
    names = {"OUT": "new", "FILE": "new.mp4", "RUN": "run"}
    own = Path(where[0]).parent
    return [(other() or str(own / names[word])) if word in names else word for word in words]


def _change(draw, words, options, where):
    name = one(draw, [*options])
    what = draw.integers(16)
    if what == 0 and words:
        words.pop(draw.integers(len(words)))
    elif what == 1:
        words.insert(int(draw.integers(len(words) + 1)), one(draw, TEXTS))
    elif name in words and words.index(name) + 1 < len(words):
        words[words.index(name) + 1] = _value(draw, name, where)
    elif options[name] or what > 13:
        words += [name, _value(draw, name, where)]
    else:
        words.append(name)


def _value(draw, name, where):
    """Returns a hostile value; most are of the kind that the option takes."""
    if (name in PLACES) == (draw.random() < 0.9):
        return one(draw, where)
    if name == "--set":
        values = (*NUMBERS, *NESTED, *TEXTS) if draw.random() < 0.5 else NUMBERS
        return f"{one(draw, NAMES)}={one(draw, values)}"
    return one(draw, NUMBERS if draw.random() < 0.5 else TEXTS)


def case(base, folder, number):
    """Carries out one command line of a number, in a folder that is then removed.

    Returns:
      The class of what happened, and a sentence.
    """
    draw = np.random.default_rng([SEED, number])
    folder.mkdir()
    where = places(base, folder / "all")
    here = folder / "here"
    here.mkdir()
    words = words_of(draw, where)
    before, outside = oracle.snapshot(folder), oracle.snapshot(base, contents=False)
    with contextlib.chdir(here):
        outcome = oracle.carried_out(lambda: (cli.main(words), None))
    shown = [word if len(word) < 200 else f"{word[:60]}...({len(word)})" for word in words]
    said = f"command {number}, {shown!a}: {outcome.status} {outcome.printed.strip()[-1500:]}"
    after = oracle.snapshot(folder)
    changed = [path for path in {*before, *after} if before.get(path) != after.get(path)]
    shutil.rmtree(folder)
    now = oracle.snapshot(base, contents=False)
    assert now == outside, f"{said}: something outside was changed"
    theirs, ours = (os.fsencode(folder / name) for name in ("all", "all/run"))
    lost = [p for p in changed if p in before and theirs in p and ours not in p]
    return _judged(words, outcome, sorted(changed), lost), said


def _judged(words, outcome, changed, lost):
    if lost:
        return f"wrong: changed {lost}"
    if outcome.status == 0:
        return "carried out" if not changed else f"wrong: changed {changed}"
    if outcome.status == WORK_BEGINS:
        return "sound: the work would begin"
    if wrong := oracle.complaint(outcome):
        return f"wrong: {wrong}"
    if changed:
        return f"wrong: refused, but changed {changed}"
    return f"refused, status {outcome.status}"
