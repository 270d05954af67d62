"""The tasks as Gymnasium environments: one robot, or a batch of robots.

`musebot.register_gymnasium` registers both. Observations are the task's signals concatenated in
the order of docs/tasks.md; observations and actions are 32-bit floats. Episodes never terminate;
`gymnasium.make` truncates them after 1,000 steps, or after a registered task's own time limit. The
dictionary `info` holds the entries of `INFO`.
"""

from ...extras import extra_needed

with extra_needed("gym"):
    from .common import INFO
    from .single import ArenaEnv
    from .vector import ArenaVectorEnv

__all__ = ["INFO", "ArenaEnv", "ArenaVectorEnv"]
