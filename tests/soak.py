"""Simulates robots in MuJoCo for many hours, and reports the extremes of their motion.

    .venv/bin/python tests/soak.py [--robot-hours HOURS] [--seed SEED]

One process. Each round has three worlds: creative robots with the paper's brain in wall avoidance,
creative robots with the brain `steady` in spot finding, and robots among pillars whose motors are
randomly -0.5 or 0.5. After each control step it reads tilt, depth in a wall, speed and kinetic
energy of every robot; after each round, what the process holds. Prints JSON. Not part of the
suite; a test at night runs it (test_night.py).
"""

import argparse
import gc
import json
import os
import sys
import time

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from musebot.controller.presets import BRAINS
from musebot.models.kinematic import gaps
from musebot.protocols.runs.cohort import Cohort
from musebot.protocols.runs.conditions import CohortKey, Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.local import prepare_process
from musebot.tasks import make_batch
from musebot.tasks.starts import random_poses

ROBOTS = 50
# Task, brain and factor on the durations of the lives of a round: 8 and 9 simulated minutes.
LIVES = (("wall_avoidance", "paper", 0.05), ("spot_finding", "steady", 0.025))
MINUTES, HELD = 5, (1, 20)  # among pillars; control steps for which motor values are held


def watch(batch, worst):
    """Keeps the largest values of `motion` of a batch's robots after each of its steps."""
    data, step = mujoco.MjData(batch.model), batch.step
    mujoco.mj_forward(batch.model, data)
    inertia = np.zeros((batch.model.nv, batch.model.nv))  # of a robot that faces +x
    mujoco.mj_fullM(batch.model, data, inertia)

    def watched(motors):
        step(motors)
        for name, values in motion(batch, inertia).items():
            worst[name] = max(worst.get(name, 0.0), float(values.max()))

    batch.step = watched


def room(poses, size):
    """Returns the distance from each robot's rim to the nearest wall or pillar in [m]."""
    found = gaps(poses, size)
    for x, y, radius in size.obstacles:
        apart = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        found = np.minimum(found, apart - radius - size.radius)
    return found


def motion(batch, inertia):
    """Returns tilt, depth, speed, energy and height of all robots, each of shape (B,)."""
    nq, nv = batch.model.nq, batch.model.nv
    state = batch.arrays()["state"]
    qpos, qvel = state[:, 1 : 1 + nq], state[:, 1 + nq : 1 + nq + nv]
    x, y = qpos[:, 4:6].T
    # The energy does not depend on the place, and the wheels are round: the velocity is turned into
    # the robot's frame (that of the angular velocity is its own already).
    turned = Rotation.from_quat(qpos[:, [4, 5, 6, 3]]).apply(qvel[:, :3], inverse=True)
    own = np.concatenate([turned, qvel[:, 3:]], axis=1)
    at_rest = batch.model.qpos0[2]
    return {
        "tilt_deg": 2 * np.degrees(np.arcsin(np.minimum(np.hypot(x, y), 1))),
        "depth_mm": -1000 * room(batch.pose, batch.dimensions),
        "up_mm": 1000 * (qpos[:, 2] - at_rest),
        "down_mm": 1000 * (at_rest - qpos[:, 2]),
        "speed_m_s": np.linalg.norm(qvel[:, :3], axis=1),
        "energy_mJ": 500 * np.einsum("bi,ij,bj->b", own, inertia, own),
    }


def lives(worst, task, brain, time_scale, seed):
    """Simulates the lives of a cohort; returns robot-hours and the number of invalid robots."""
    fields = dict(cohort_size=ROBOTS, time_scale=time_scale, brain=BRAINS[brain])
    cohort = Cohort(Experiment(seed=seed, **fields), CohortKey(Condition(task, "creative"), 0))
    watch(cohort.batch, worst)
    cohort.advance(10**9)
    return ROBOTS * cohort.steps / 36000, int((~cohort.batch.valid).sum())


def among_pillars(worst, seed):
    """Lets robots push walls and pillars at full speed; returns the same as `lives`."""
    random = np.random.default_rng(seed)
    batch = make_batch("wall_avoidance_obstacles", ROBOTS)
    watch(batch, worst)
    batch.place(np.arange(ROBOTS), random_poses(random, batch.dimensions, ROBOTS))
    motors, left = np.zeros((ROBOTS, 2)), np.zeros((ROBOTS, 2), int)
    for _ in range(600 * MINUTES):
        motors = np.where(left > 0, motors, random.choice([-0.5, 0.5], motors.shape))
        left = np.where(left > 0, left, random.integers(*HELD, left.shape, endpoint=True)) - 1
        batch.step(motors)
    return ROBOTS * MINUTES / 60, int((~batch.valid).sum())


def held():
    """Returns what this process holds: memory in MB (10^6 bytes), open files and threads."""
    gc.collect()
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[1])
    return {
        "MB": round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1),
        "files": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
    }


def soak(robot_hours, seed=1):
    """Simulates rounds until there are so many robot-hours; returns what was seen in each world."""
    found = {"robot_hours": 0.0, "invalid": 0, "worst": {}, "held": []}
    began = time.process_time()
    while found["robot_hours"] < robot_hours:
        number = seed + len(found["held"])
        worlds = {f"{life[0]}, {life[1]}": (lives, *life, number) for life in LIVES}
        worlds["pillars, random"] = among_pillars, number
        for name, (simulate, *arguments) in worlds.items():
            worst = found["worst"].setdefault(name, {})
            hours, invalid = simulate(worst, *arguments)
            found["robot_hours"] += hours
            found["invalid"] += invalid
        found["held"].append(held())
        print(f"{found['robot_hours']:.1f} robot-hours, {found['held'][-1]}", file=sys.stderr)
    found["seconds"] = round(time.process_time() - began, 1)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--robot-hours", type=float, default=150, help="at least so many (150)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first round (1)")
    options = parser.parse_args()
    prepare_process()
    print(json.dumps(soak(options.robot_hours, options.seed), indent=1))
