"""Simulates runs: cohorts are jobs that can stop and continue; results are joined at the end."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import importlib.util
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from ...extras import missing_extra
from ..agents.base import Agent
from ..agents.factory import check_trusted
from ..agents.names import is_own
from ..agents.settings import settings_from
from ..errors import DamagedFileError, InputError, RunError
from ..storage import check_own_folder, locked, remove_drafts, remove_files, resolved
from ..terminal import notice
from .checkpoints import (
    CHECKPOINTS,
    checkpoint_file,
    finished_file,
    read_lives,
    read_minutes,
    set_aside,
)
from .cohort import Cohort, make_agent
from .conditions import CohortKey, Condition
from .jobs import CohortJob, Executor, Job, execute
from .manifest import MANIFEST, check_identity, read_manifest, same_physics, write_manifest
from .plan import Plan, check_agent_memory, check_memory, job_bytes
from .run import Lives, Measured, Run, joined, results_of
from .run_files import (
    RESULTS_FILE,
    ROBOTS_FILE,
    TABLES_FILE,
    check_kept_networks,
    export_robots,
    read_measured,
    write_results,
)


def simulate(
    directory: Path,
    plan: Plan,
    executor: Executor,
    *,
    save_every: float = 60.0,
    quiet: bool = False,
    log: bool = False,
) -> Run:
    """Simulates all robots of a plan that are not finished yet, and stores the results.

    Args:
      directory: Folder of the run: new, empty, or with the same experiment.
      plan: Experiment, and the number of robots wanted in each condition.
      executor: Executor of the cohorts: `local.Local(n)` or `ray_cluster.RayCluster(address)`.
      save_every: Wall-clock seconds between two checkpoints of a cohort.
      quiet: Whether to hide the progress and the notices before it; jobs' messages are shown.
      log: Whether to write learning curves for TensorBoard, too.

    Returns:
      The run with all robots of the folder.

    Raises:
      InputError: the folder is in use, its experiment or physics differs, or an agent is not
        trusted or fails.
      Interrupted: Ctrl-C or a termination signal arrived; checkpoints were written.
      ImportError: a package of an extra is missing.
      RunError: a process died, an agent failed, or a cohort's file could not be written.
      OSError: the results could not be written; the cohorts' files are kept.
    """
    if log:  # raises ModuleNotFoundError without the extra
        from .tensorboard_log import TensorBoardLog
    directory = resolved(directory)  # an agent may change the working directory
    # Before anything is written. A cluster's nodes are not checked.
    UnfinishedRun.read(directory, plan).check(getattr(executor, "processes", 1))
    with locked(directory):
        run = UnfinishedRun.read(directory, plan)
        for message in (*run.begin(), *run.beyond(plan)):
            if not quiet:
                notice(message)
        jobs = run.jobs(save_every)
        if not jobs and not quiet:
            scaled = run.plan.experiment.rehearsal
            words = f" ({scaled}; another folder starts another run)" if scaled else ""
            notice(f"{directory} has all these robots{words}, so nothing is simulated")
        update = TensorBoardLog(run, save_every).update if log else lambda now=False: None
        what = f"cohorts: {len(run.left)}"
        try:
            execute(what, jobs, executor, run.finished, watcher=update, quiet=quiet)
        finally:
            update(now=True)
    if run.left:
        raise RunError(f"unfinished cohorts: {len(run.left)}; the same command continues")
    return run.run


def check_device(plan: Plan) -> None:
    """Raises InputError if a plan's device is missing, too small, or cannot simulate its robots."""
    device, warp = plan.experiment.device, plan.experiment.physics == "warp"
    for module, needed in ("numba", plan.experiment.backend == "numba"), ("mujoco_warp", warp):
        if needed and not importlib.util.find_spec(module):
            raise InputError(missing_extra(ModuleNotFoundError(name=module)))
    if not plan.experiment.on_tensors:
        return
    if others := [condition.proposer for condition in plan.robots if not condition.has_brain]:
        where = "in MuJoCo Warp" if warp else f"on {device}"
        raise InputError(f"only robots with a brain are simulated {where}, not {others[0]}")
    if device == "cpu":
        return
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    number = int(device.partition(":")[2] or 0)
    if number >= count:
        found = f"there are {count}" if count else "there is no GPU that PyTorch can use"
        raise InputError(f"there is no device {device}: {found}")
    free, _ = torch.cuda.mem_get_info(number)
    if (needed := job_bytes(plan)) > free:
        raise InputError(
            f"cohorts of {plan.experiment.cohort_size} robots would need about "
            f"{needed / 2**30:.1f} GiB of memory on {device}, which has {free / 2**30:.1f} GiB free"
        )


def check_agents(plan: Plan, held: Measured | None = None) -> None:
    """Makes a cohort of every agent in a plan that is no brain, and lets it act once.

    Args:
      plan: Plan of the robots that are still to be simulated.
      held: Measurements of the run's finished robots; None if there are none.

    Raises:
      InputError: there is no such agent, it needs more memory than the machine has, does not
        return motor values, or has weights of another kind than the finished robots.
    """
    experiment = plan.experiment
    settings = settings_from(experiment.settings, several=True)
    differ = any(len(values) > 1 for values in settings.values())  # between robots, as in tuning
    for condition in plan.robots:
        if condition.has_brain:
            continue
        proposer = condition.proposer
        if is_own(proposer) and not differ:
            # Measured on 1 and 2 robots, before all are made; other agents may need all robots.
            one, two = (_sizes(make_agent(experiment, condition, n, 0)) for n in (1, 2))
            check_agent_memory(plan, condition, *(two - one))
        cohort = Cohort(experiment, CohortKey(condition, 0))
        cohort.agent.reset()
        cohort.decide(False)  # checks what the agent returns
        check_agent_memory(plan, condition, *(_sizes(cohort.agent) / experiment.cohort_size))
        if held and condition in held:
            check_same_weights(condition, cohort.agent.weights(), held[condition].after)


def _sizes(agent: Agent) -> np.ndarray:
    """Returns the bytes of an agent's state and of its weights."""
    both = agent.state(), agent.weights()
    return np.array([sum(array.nbytes for array in arrays.values()) for arrays in both])


def check_same_weights(
    who: Condition | CohortKey, own: Mapping[str, np.ndarray], kept: Mapping[str, np.ndarray]
) -> None:
    """Raises InputError if the weights `own` and `kept` differ in name, dtype or shape per robot.

    Another version of the agent may have simulated the earlier robots, or they were kept without
    their networks.
    """
    if own and not kept:
        raise InputError(f"the robots of {who} that the run has are kept without their networks")
    kinds, known = (
        {(name, array.dtype, array.shape[1:]) for name, array in weights.items()}
        for weights in (own, kept)
    )
    if kinds != known:
        names = sorted({name for name, *_ in kinds ^ known})
        raise InputError(
            f"{who} keeps other weights than the robots of the run, which another version "
            f"simulated: {', '.join(names)}"
        )


@dataclasses.dataclass
class UnfinishedRun:
    """A run that is being simulated.

    Attributes:
      directory: Folder of the run, an absolute path.
      plan: Plan with all robots that the run will have.
      measured: Measurements of the robots in results.safetensors.gz.
      left: Cohorts of the wanted conditions whose results are still to be read.
      lives: Results of finished cohorts, kept until all cohorts are finished.
    """

    directory: Path
    plan: Plan
    measured: Measured
    left: list[CohortKey]
    lives: dict[CohortKey, Lives]

    @classmethod
    def read(cls, directory: Path, plan: Plan) -> UnfinishedRun:
        """Compares what a folder holds with what a plan asks for; changes nothing.

        Conditions that only the folder plans wait: an agent of theirs may be failing.

        Raises:
          InputError: the folder's experiment or physics differs, a file is damaged, a folder is a
            link, or the folder's experiment names an agent that is not trusted.
        """
        directory = resolved(directory)
        check_own_folder(directory / CHECKPOINTS)
        wanted = plan.robots
        if (directory / MANIFEST).exists():
            held = read_manifest(directory)
            check_identity(directory, vars(held.experiment), vars(plan.experiment))
            plan = plan.merged_with(held)
        measured = read_measured(directory, plan.experiment)
        keys = [key for key in plan.cohorts() if key.condition in wanted]
        left = [key for key in keys if not _holds(measured, key, plan)]
        if left and (directory / MANIFEST).exists():
            if not same_physics(directory):
                raise InputError(
                    f"{directory} was simulated in another physics than this version's, or by "
                    "another version of Numba or Warp: its robots and new ones must not be mixed"
                )
            check_kept_networks(directory, measured)
        for key in left:
            check_trusted(key.condition.proposer, directory)
        return cls(directory, plan, measured, left, {})

    @property
    def run(self) -> Run:
        """The run with the robots in `measured`."""
        experiment = self.plan.experiment
        return Run(self.directory.name, experiment, results_of(experiment, self.measured))

    def check(self, at_once: int = 1) -> None:
        """Checks that the remaining robots can be simulated, `at_once` jobs at a time.

        Raises:
          InputError: a device is missing, an agent fails, or the memory is too small.
        """
        if not self.left:
            return
        counts = collections.Counter(key.condition for key in self.left)
        robots = {c: n * self.plan.experiment.cohort_size for c, n in counts.items()}
        remaining = dataclasses.replace(self.plan, robots=robots)
        check_device(remaining)
        check_memory(remaining, at_once, self.plan)
        check_agents(remaining, self.measured)

    def beyond(self, wanted: Plan) -> list[str]:
        """Returns messages about robots that the run plans beyond those of a command."""
        more = [c for c, robots in wanted.robots.items() if robots < self.plan.robots[c]]
        others = [key for key in self.plan.cohorts() if key.condition not in wanted.robots]
        waiting = {key.condition for key in others if not _holds(self.measured, key, self.plan)}
        messages = {"the run plans more robots of": more, "the run still lacks robots of": waiting}
        return [f"{text} {', '.join(map(str, sorted(c)))}" for text, c in messages.items() if c]

    def curve(self, condition: Condition) -> np.ndarray:
        """Returns the mean share of time with the measured event, by simulated minute, shape (M,).

        All finished and wanted robots have reached these M minutes. Invalid ones are left out.
        """
        experiment = self.plan.experiment
        steps = experiment.life_of(condition.life).steps_of_minutes()
        done = [lives for key, lives in self.lives.items() if key.condition == condition]
        if held := self.measured.get(condition):
            done.append(held)
        counts = [lives.minutes[lives.valid] for lives in done]
        for key in [key for key in self.left if key.condition == condition]:
            counts.append(read_minutes(self.directory, experiment, key))
        if not counts:  # none has finished, and the command does not name them
            return np.zeros(0)
        reached = min(count.shape[1] for count in counts)
        robots = np.concatenate([count[:, :reached] for count in counts])
        return robots.mean(axis=0) / steps[:reached] if len(robots) else np.zeros(0)

    def begin(self) -> list[str]:
        """Writes the manifest and reads the cohorts that an earlier call finished.

        Returns:
          Messages about damaged files that were set aside.
        """
        checkpoints = self.directory / CHECKPOINTS
        for name in (MANIFEST, RESULTS_FILE, ROBOTS_FILE, TABLES_FILE):
            remove_drafts(self.directory, name)
        remove_drafts(checkpoints)
        if not self.left:
            if not (self.directory / ROBOTS_FILE).exists():
                export_robots(self.directory, self.plan.experiment, self.measured)
            self._clear()
            return []
        begun = bool(self.measured) or checkpoints.exists()
        write_manifest(self.directory, self.plan, begun)
        messages = []
        for key in [*self.left]:
            path = finished_file(self.directory, key)
            try:
                lives = read_lives(path, self.plan.experiment, key)
            except FileNotFoundError:
                continue
            except DamagedFileError as error:
                messages.append(set_aside(path, key, str(error)))
            else:
                self._add(key, lives)
        return messages

    def jobs(self, save_every: float) -> list[CohortJob]:
        """Returns the jobs of the cohorts that are left, one each."""
        experiment = self.plan.experiment
        return [CohortJob(self.directory, experiment, key, save_every) for key in self.left]

    def finished(self, job: Job) -> None:
        """Reads a job's finished cohort; after the last cohort, writes the results of all."""
        assert isinstance(job, CohortJob)
        self._add(job.key, read_lives(job.path, job.experiment, job.key))

    def _add(self, key: CohortKey, lives: Lives) -> None:
        """Adds a finished cohort.

        Raises:
          InputError: its agent has weights of another kind than an earlier cohort.
        """
        earlier = next((one for k, one in self.lives.items() if k.condition == key.condition), None)
        if earlier is not None:
            check_same_weights(key, lives.after, earlier.after)
        self.lives[key] = lives
        self.left.remove(key)
        if not self.left:
            held = read_manifest(self.directory)  # of another run, if this one's folder was moved
            check_identity(self.directory, vars(held.experiment), vars(self.plan.experiment))
            self.measured = joined(self.measured, self.lives.items())
            write_results(self.directory, self.plan.experiment, self.measured)
            self.lives.clear()
            self._clear()

    def _clear(self) -> None:
        """Removes the files of cohorts in `measured`; their folder stays if it holds others."""
        done = [key for key in self.plan.cohorts() if _holds(self.measured, key, self.plan)]
        files = (checkpoint_file, finished_file)
        ours = {file(self.directory, key).name for key in done for file in files}
        remove_files(self.directory / CHECKPOINTS, ours.__contains__)
        with contextlib.suppress(OSError):
            (self.directory / CHECKPOINTS).rmdir()


def _holds(measured: Measured, key: CohortKey, plan: Plan) -> bool:
    """Returns whether a plan's cohort is among these measurements."""
    lives = measured.get(key.condition)
    return lives is not None and key.index < len(lives.valid) // plan.experiment.cohort_size
