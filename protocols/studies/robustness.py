"""What trained brains do when robot, arena or sensors are not those they were trained with.

    python -m musebot.protocols.robustness RUN [RUN ..] --out OUT --robots 60 --processes 2

puts the trained brains of finished runs back into robots, lets them sit the test after training
again, neither learning nor exploring, once for every change of a table, and writes
`OUT/robustness.md`. The same command goes on where it was stopped.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from ...controller import PROPOSERS
from ...models import Dimensions, Kinematics, enlarge
from ...tasks import CONTROL_TIMESTEP, Robots
from ...tasks.rules import RANGEFINDERS
from ...tasks.sensors import distance_signal
from ..agents.base import Brain, senses_of
from ..analysis import intervals
from ..analysis.comparison import described, mean
from ..errors import DamagedFileError, InputError, run_module
from ..experiment.experiment import (
    TASKS,
    Body,
    CohortKey,
    Experiment,
    check_same,
    experiment_of,
    is_physics_of,
    machine,
    physics_probe,
)
from ..experiment.schedules import NAMES, SCHEDULES, UPPER_LEFT, Phase, Schedule, control_steps
from ..options import BODIES_TOLD, PROPOSERS_TOLD, Runs, cores, option
from ..playback import observation as probes
from ..playback.episode import check_seed
from ..playback.stored_brains import stored_brains
from ..reporting import tables
from ..results.results import Results, test_seconds
from ..simulation import engine, pool
from ..simulation.cohort import place
from ..storage import (
    check_folder,
    digest,
    is_draft,
    load_arrays,
    remove_drafts,
    save_arrays,
    write_atomically,
)

STUDY, TABLE = "study.json", "robustness.md"
_WALLS, _SPOTS = ("wall_avoidance",), ("spot_finding",)
_LOWER_LEFT = (UPPER_LEFT[0], -UPPER_LEFT[1])


@dataclasses.dataclass(frozen=True)
class Change:
    """What is not as it was in training.

    Attributes:
      name: of its files.
      says: what is changed, in words.
      tasks: whose robots it is asked of.
      speed: factor on the speed of the robot.
      arena: factor on both sides of the arena; robot and spot start as far from its corners as
        they did.
      spot: where the spot lies in the test: x, y in metres; None for its place in the schedule.
      noise: standard deviation of a normal factor around 1 on each signal, drawn anew for every
        signal, robot and control step; what comes out is kept within the signal's range.
      dead: the rangefinder that sees nothing, if one does.
    """

    name: str
    says: str
    tasks: tuple[str, ...] = TASKS
    speed: float = 1.0
    arena: float = 1.0
    spot: tuple[float, float] | None = None
    noise: float = 0.0
    dead: str | None = None

    def batch(self, experiment: Experiment, task: str, robots: int) -> Robots:
        """Robots in lockstep, in the changed body and arena."""
        if self.speed != 1:
            own = experiment.batch(task, 1).dimensions.motor_speed
            experiment = dataclasses.replace(experiment, motor_speed=self.speed * own)
        edits = [functools.partial(enlarge, factor=self.arena)] if self.arena != 1 else []
        return experiment.batch(task, robots, edits)

    def test(self, schedule: Schedule, size: Dimensions) -> list[Phase]:
        """The phases of the test after training, in an arena of the changed size."""
        moved = (1 - 1 / self.arena) * np.array([size.half_length, size.half_width])

        def there(place: Any) -> Any:
            if not isinstance(place, tuple):
                return place
            return (*(np.array(place[:2]) + np.copysign(moved, place[:2])).tolist(), *place[2:])

        return [
            dataclasses.replace(
                phase, robot=there(phase.robot), spot=there(self.spot or phase.spot)
            )
            for phase in schedule.phases
            if phase.part == "post"
        ]


REFERENCE = Change("unchanged", "nothing")

CHANGES = (
    REFERENCE,
    Change("half-speed", "robot at half speed", speed=0.5),
    Change("double-speed", "robot at double speed", speed=2.0),
    Change(
        "spot-lower-left",
        "spot in the lower left corner's place, 0.50 m from the robot's start instead of 0.85 m",
        _SPOTS,
        spot=_LOWER_LEFT,
    ),
    Change("larger-arena", "arena a third larger in both directions", arena=4 / 3),
    Change("noise", "10 % noise on every signal", noise=0.1),
    # Each of the four: which one a robot misses depends on the way in which it drives and turns.
    *(
        Change(f"dead-{name}", f"{name} distance sensor sees nothing", _WALLS, dead=name)
        for name in RANGEFINDERS
    ),
)


class Misled(Brain):
    """Brains that are told of signals that a change has spoilt."""

    def __init__(self, brain: Brain, change: Change, task: str, random: np.random.Generator):
        """Comes between senses and brains.

        Args:
          brain: of the robots.
          change: spoils the signals.
          task: that the robots live in.
          random: to draw the noise from.
        """
        super().__init__(brain.controller)
        self._noise, self._random = change.noise, random
        signals = senses_of(task).state
        self._low, self._high = np.array([(signal.low, signal.high) for signal in signals]).T
        # Wall avoidance, of which alone it is asked, has the distances first, in this order.
        self._dead = None if change.dead is None else RANGEFINDERS.index(change.dead)

    def act(self, state: np.ndarray, learning: bool) -> np.ndarray:
        """See `Agent.act`."""
        return super().act(self.told(state), learning)

    def told(self, state: np.ndarray) -> np.ndarray:
        """What is left of signals, float32, of the same shape, (B, S)."""
        state = state.copy()
        if self._noise:
            factor = 1 + self._noise * self._random.standard_normal(state.shape)
            state[:] = np.clip(state * factor, self._low, self._high)
        if self._dead is not None:
            # Eq. 2 of a ray that meets nothing, as of a wall at an endless distance: 0.
            state[:, self._dead] = distance_signal(np.array(-1.0))
        return state


@dataclasses.dataclass(frozen=True)
class Sitter:
    """A run whose brains sit the test again.

    Attributes:
      name: of its folder.
      experiment: of the run, with the body and the seed of the study.
      brains: tells the run's brains from others.
      robots: by task and proposer, how many sit: the first ones whose lives were valid.
      physics: of the test, see `physics_probe`.
    """

    name: str
    experiment: Experiment
    brains: str
    robots: Mapping[tuple[str, str], int]
    physics: tuple[float, ...]

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        robots = [
            {"task": task, "proposer": proposer, "robots": count}
            for (task, proposer), count in self.robots.items()
        ]
        fields = {"experiment": dataclasses.asdict(self.experiment), "robots": robots}
        known = {"name": self.name, "brains": self.brains, "physics": self.physics}
        return json.loads(json.dumps(known | fields))

    @classmethod
    def of_plain(cls, fields: Mapping[str, Any]) -> Sitter:
        """The inverse of `plain`."""
        robots = {(row["task"], row["proposer"]): row["robots"] for row in fields["robots"]}
        experiment = experiment_of(fields["experiment"])
        physics = tuple(np.array(fields["physics"], dtype=float).tolist())
        return cls(fields["name"], experiment, fields["brains"], robots, physics)

    def file(self, out: Path, condition: tuple[str, str], change: Change) -> Path:
        """Where is kept what a condition's robots did."""
        return out / self.name / f"{'-'.join(condition)}-{change.name}.safetensors"


@dataclasses.dataclass(frozen=True)
class Job:
    """A condition's robots sit the test in one change, in lockstep.

    Attributes:
      path: of the file that it comes to.
      experiment: see `Sitter`.
      results: of the run.
      condition: task and proposer.
      rows: of the robots within the condition.
      change: in which.
    """

    path: Path
    experiment: Experiment
    results: Results
    condition: tuple[str, str]
    rows: tuple[int, ...]
    change: Change

    @property
    def minutes(self) -> int:
        """Simulated minutes of all robots, as far as `sit` ticks."""
        schedule = self.experiment.schedule(self.condition[0])
        phases = [phase for phase in schedule.phases if phase.part == "post"]
        return len(self.rows) * sum(probes.minutes_of(phase.minutes) for phase in phases)


def sit(job: Job, tick: probes.Tick = lambda: None) -> dict[str, np.ndarray]:
    """Lets brains sit the test.

    The random streams of brains and noise depend on the condition and the seed alone, not on
    the change.

    Args:
      job: whose.
      tick: called every simulated minute.

    Returns:
      `events`, control steps in contact or in the spot, and `valid`, whether the simulation
      remained stable, each of shape (B,).
    """
    (task, proposer), change, experiment = job.condition, job.change, job.experiment
    seed, random = experiment.seeds(CohortKey(task, proposer, 0))
    which = [(row, "after") for row in job.rows]
    brains = stored_brains(experiment, job.results, task, proposer, which, seed)
    misled = Misled(brains, change, experiment.arena_task(task), random)
    batch = change.batch(experiment, task, len(which))
    events = np.zeros(batch.robots, dtype=np.int32)
    for phase in change.test(experiment.schedule(task), batch.dimensions):
        place(batch, phase, random)
        misled.reset()
        steps = control_steps(phase.minutes)
        track = probes.watch(batch, misled, steps, learning=False, tick=tick)
        events += track.events.sum(axis=0, dtype=np.int32)
    return {"events": events, "valid": batch.valid}


def keep(job: Job) -> None:
    """Lets brains sit the test, and keeps what they did."""
    arrays = sit(job, functools.partial(pool.tick, len(job.rows)))
    save_arrays(job.path, arrays, change=_plain(job.change))


def kept(path: Path, change: Change) -> dict[str, np.ndarray] | None:
    """What `keep` wrote; None where nothing is yet.

    Raises:
      InputError: the file is damaged, or of another change of this name.
    """
    if not path.exists():
        return None
    arrays, notes = load_arrays(path)
    if notes["change"] != _plain(change):
        raise InputError(f"{path} was measured with another change than {change.name}")
    return arrays


def _plain(change: Change) -> dict[str, Any]:
    return json.loads(json.dumps(dataclasses.asdict(change)))


def sitters(
    runs: Sequence[Path],
    robots: int,
    body: Body | None,
    seed: int,
    proposers: Sequence[str] = PROPOSERS,
) -> list[tuple[Sitter, Results]]:
    """Whose brains sit the test, and the lives that left them.

    Args:
      runs: folders of finished runs.
      robots: of each condition, at most.
      body: of the test; None for each run's own.
      seed: of the random streams of brains and noise.
      proposers: whose brains.

    Raises:
      InputError: a folder holds no such brains, or they cannot stand in one table.
    """
    for name in proposers:
        if name not in PROPOSERS:
            raise InputError(f"the proposer must be one of {', '.join(PROPOSERS)}, got {name!r}")
    if not runs:
        raise InputError("no run is named whose brains could sit the test")
    names = [run.resolve().name for run in runs]
    if len({*names}) < len(names):
        raise InputError(f"the runs must have different names, got {', '.join(names)}")
    found = []
    for name, run in zip(names, runs, strict=True):
        experiment, results = engine.read_run(run, enact=True)
        experiment = dataclasses.replace(experiment, seed=seed)
        if body and body != experiment.body:  # what only the other body was told is void
            experiment = dataclasses.replace(experiment, body=body, kinematics=Kinematics())
        chosen = {
            condition: count
            for condition in probes.lived(results)
            if condition[1] in proposers
            and (count := len(probes.sample(results, *condition, robots)))
        }
        if not chosen:
            names = " or ".join(proposers)
            raise InputError(f"{run} holds no brain of a {names} robot that could be put back")
        brains = digest({k: v for k, v in results.brains.items() if "/after/" in k})
        physics = physics_probe(experiment.body, experiment.kinematics)
        found.append((Sitter(name, experiment, brains, chosen, physics), results))
    scales = sorted({sitter.experiment.time_scale for sitter, _ in found})
    if len(scales) > 1:
        raise InputError(
            "the runs cannot stand in one table: their durations are the paper's times "
            f"{' and '.join(f'{scale:g}' for scale in scales)}"
        )
    return found


def jobs(out: Path, wanted: Sequence[tuple[Sitter, Results]]) -> list[Job]:
    """All jobs of a study, the longest first, so that processes end together."""
    found = []
    for sitter, results in wanted:
        for condition, count in sitter.robots.items():
            rows = tuple(probes.sample(results, *condition, count))
            found += [
                Job(sitter.file(out, condition, c), sitter.experiment, results, condition, rows, c)
                for c in CHANGES
                if condition[0] in c.tasks
            ]
    return sorted(found, key=lambda job: -job.minutes)


def check_study(out: Path, wanted: Sequence[Sitter]) -> None:
    """Raises InputError where OUT cannot hold this study, or holds something else."""
    check_folder(out)
    if not (out / STUDY).is_file():
        if out.is_dir() and not all(map(is_draft, out.iterdir())):
            raise InputError(f"{out} is not empty and holds no study of musebot's")
        return
    held = read_study(out)
    names = [", ".join(sitter.name for sitter in one) for one in (held, wanted)]
    if names[0] != names[1]:
        raise InputError(f"{out} holds a study of {names[0]}, not of {names[1]}")
    for own, asked in zip(held, wanted, strict=True):
        check_same(f"{out} holds a study of {own.name}", own.experiment, asked.experiment)
        if own.robots != asked.robots:
            counts = [", ".join(map(str, one.robots.values())) for one in (own, asked)]
            raise InputError(
                f"{out} holds a study of {counts[0]} robots of {own.name}, not of {counts[1]}"
            )
        if own.brains != asked.brains:
            raise InputError(f"{out} holds a study of other brains than those of {own.name}")
        if not is_physics_of(own.physics, asked.experiment.body, asked.experiment.kinematics):
            raise InputError(f"{out} was measured in another physics than this version's")


def save_study(out: Path, wanted: Sequence[Sitter]) -> None:
    """Writes `study.json`: whose brains, in what experiments and physics, and on what machines."""
    made_with = []
    if (out / STUDY).exists():
        made_with = json.loads((out / STUDY).read_bytes())["made_with"]
    content = {
        "runs": [sitter.plain() for sitter in wanted],
        "made_with": [*(one for one in made_with if one != machine()), machine()],
    }
    write_atomically(out / STUDY, (json.dumps(content, indent=2) + "\n").encode())


def read_study(out: Path) -> list[Sitter]:
    """Reads `study.json`: whose brains, in what experiments and physics.

    Raises:
      InputError: there is none, or it is damaged.
    """
    path = out / STUDY
    if not path.is_file():
        raise InputError(f"{out} holds no study of musebot's")
    try:
        return [Sitter.of_plain(fields) for fields in json.loads(path.read_bytes())["runs"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedFileError(f"{path} is no study of musebot's ({error!r})") from error


def measure(wanted: Sequence[Job], processes: int) -> None:
    """Does the jobs that are not kept yet.

    Raises:
      InputError: see `kept`.
      Interrupted, RunError, OSError: see `pool.work_off`.
    """
    left = [job for job in wanted if kept(job.path, job.change) is None]
    minutes = sum(job.minutes for job in left)
    pool.work_off("tests", keep, [(job,) for job in left], processes, minutes)


def shares(out: Path, sitter: Sitter, condition: tuple[str, str], change: Change) -> np.ndarray:
    """What a condition's robots did in one change.

    Returns:
      Shares of the test's time in contact or in the spot, NaN for a robot whose simulation became
      unstable, shape (B,).

    Raises:
      InputError: the file is missing or damaged, or of another change of this name.
    """
    path = sitter.file(out, condition, change)
    if (arrays := kept(path, change)) is None:
        raise InputError(f"{out} lacks {path.relative_to(out)}")
    times = arrays["events"] * CONTROL_TIMESTEP
    seconds = test_seconds(sitter.experiment, condition[0])
    return np.where(arrays["valid"], times / seconds, np.nan)


def cells(found: np.ndarray, reference: np.ndarray) -> list[str]:
    """A condition's cells of a row: the share, its difference, how many robots never were there.

    Args:
      found: each robot's share of the time, NaN for one that became unstable, shape (B,).
      reference: likewise, with nothing changed; the first row's own, which has no difference.
    """
    sound = found[~np.isnan(found)]
    share = _joined(tables.number(float(mean(sound))), intervals.mean(sound))
    never = f"{int((sound == 0).sum())} of {len(sound)}"
    if found is reference:
        return [share, "", never]
    both = ~np.isnan(found - reference)
    interval = intervals.difference(found[both], reference[both], mean, paired=True)
    return [share, _joined(f"{float(mean((found - reference)[both])):+.4f}", interval), never]


def _joined(number: str, interval: intervals.Interval) -> str:
    return " ".join(filter(None, (number, tables.bracket(interval))))


def report(out: Path) -> str:
    """The page that a finished study comes to, as Markdown; changes nothing.

    Raises:
      InputError: a file is missing or damaged.
    """
    studied = read_study(out)
    parts = [_table(out, studied, task) for task in TASKS]
    return "\n".join([*filter(None, parts), _note(studied)])


def _table(out: Path, studied: Sequence[Sitter], task: str) -> str:
    """A task's table, a row a change; empty where nobody was trained for it."""
    event = SCHEDULES[task].event
    changes = [change for change in CHANGES if task in change.tasks]
    head, rows = ["changed"], [[change.says] for change in changes]
    for sitter in studied:
        for condition in sitter.robots:
            if condition[0] != task:
                continue
            head += [f"{sitter.name}, {condition[1]}: {event}", "difference", f"never {event}"]
            found = [shares(out, sitter, condition, change) for change in changes]
            for row, measured in zip(rows, found, strict=True):
                row += cells(measured, found[0])
    if len(head) == 1:
        return ""
    title = f"### {NAMES[task]}"
    if (scale := studied[0].experiment.time_scale) != 1:
        title += f", a rehearsal: every duration times {scale:g}"
    lines = [tables.line(head), tables.line(["---", *("---:" for _ in head[1:])])]
    return "\n".join([title, "", *lines, *map(tables.line, rows), ""])


def _note(studied: Sequence[Sitter]) -> str:
    lines = [
        "Trained brains sit the test after training once more, without learning anew: "
        "share of the time, mean over robots, in brackets its 95 % interval (BCa bootstrap). "
        "*Difference*: from the test in which nothing was changed, robot by robot. No interval "
        "where robots are too few or all alike.",
        "",
    ]
    lines += [described(sitter.name, sitter.experiment) for sitter in studied]
    return "\n".join([*lines, ""])


def main(
    runs: Runs,
    out: Annotated[Path, tyro.conf.arg(metavar="OUT")],
    robots: int = 60,
    processes: int = cores(),
    body: Annotated[Body | None, option(BODIES_TOLD, "each run's own")] = None,
    seed: int = 0,
    proposer: Annotated[tuple[str, ...], option(f"{PROPOSERS_TOLD} ..", "all three")] = PROPOSERS,
) -> None:
    """Lets trained brains sit their test in robots and arenas that they were not trained in.

    Args:
      runs: folders of finished runs.
      out: folder of what is measured, and of robustness.md; an unfinished one goes on.
      robots: of each condition, at most.
      processes: tests at a time, one core each.
      body: of the tests.
      seed: of the random streams of brains and noise.
      proposer: whose brains.
    """
    for name, number in (("robots", robots), ("processes", processes)):
        if number < 1:
            raise InputError(f"the number of {name} must be at least 1, got {number}")
    check_seed(seed)
    wanted = sitters(runs, robots, body, seed, proposer)
    study = [sitter for sitter, _ in wanted]
    check_study(out, study)
    with engine.locked(out):
        for folder in (out, *(out / sitter.name for sitter in study)):
            remove_drafts(folder)
        save_study(out, study)
        measure(jobs(out, wanted), processes)
        text = report(out)
        write_atomically(out / TABLE, text.encode())
    print(text)


if __name__ == "__main__":
    run_module(main)
