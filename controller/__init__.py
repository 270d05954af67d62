"""The robot's brain: an evaluation network and a creative memory. Depends on NumPy and torch."""

try:
    import torch as _torch  # noqa: F401
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "torch is not installed; pip install 'musebot[brain]' gets it", name=error.name
    ) from error

from .brains import BRAINS, INGREDIENTS
from .creative_memory import CreativeMemory
from .evaluation_network import EvaluationNetwork
from .networks import Networks
from .neurocontroller import Neurocontroller
from .noise import NoisePatterns
from .parameters import Parameters
from .proposers import PROPOSERS, Proposer, RandomActions
from .senses import Senses, Signal

__all__ = [
    "BRAINS",
    "INGREDIENTS",
    "PROPOSERS",
    "CreativeMemory",
    "EvaluationNetwork",
    "Networks",
    "Neurocontroller",
    "NoisePatterns",
    "Parameters",
    "Proposer",
    "RandomActions",
    "Senses",
    "Signal",
]
