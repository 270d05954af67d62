"""Registration of the tasks with Gymnasium, without loading any of them."""

from __future__ import annotations

from .extras import extra_needed

# Gymnasium ids in the namespace "musebot", and their tasks. A task that changes gets a new version.
GYMNASIUM_TASKS = {
    "WallAvoidance-v0": "wall_avoidance",
    "SpotFinding-v0": "spot_finding",
    "WallAvoidanceUnit-v0": "wall_avoidance_unit",
    "WallAvoidanceObstacles-v0": "wall_avoidance_obstacles",
    "SpotFindingUnit-v0": "spot_finding_unit",
    "SpotFindingTwoNoses-v0": "spot_finding_two_noses",
    "SpotFindingWalls-v0": "spot_finding_walls",
    "SpotFindingJumping-v0": "spot_finding_jumping",
}


USUAL_STEPS = 1000  # control steps of an episode
# Users' own tasks: steps of an episode (None: no end), and the module that registers the task.
EPISODE_STEPS: dict[str, int | None] = {}
MODULES: dict[str, str] = {}


LIFE_ID = "musebot/Life-v0"


def register_gymnasium() -> None:
    """Registers the tasks for `gymnasium.make("musebot/WallAvoidance-v0")`.

    Importing musebot calls this: Gymnasium 1.x has no plugins, so a package must register its
    environments when it is imported. Only the names are registered; no environment is loaded.

    Raises:
      ModuleNotFoundError: Gymnasium is not installed.
    """
    with extra_needed():
        import gymnasium
    kinds = {f"musebot/{name}": task for name, task in GYMNASIUM_TASKS.items()}
    for name, task in {**kinds, LIFE_ID: "life"}.items():
        if name in gymnasium.registry:
            continue
        gymnasium.register(
            id=name,
            entry_point="musebot.tasks.gymnasium_env:ArenaEnv",
            vector_entry_point="musebot.tasks.gymnasium_env:ArenaVectorEnv",
            kwargs={"task": f"{MODULES[task]}:{task}" if task in MODULES else task},
            # An episode of a life ends by itself.
            max_episode_steps=None if name == LIFE_ID else EPISODE_STEPS.get(task, USUAL_STEPS),
        )
