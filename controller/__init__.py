"""The brain: an evaluation network that judges, a creative memory that proposes. Torch only."""

from .evaluation import EvaluationNetwork
from .memory import CreativeMemory, NoisePatterns
from .networks import Networks
from .neurocontroller import Neurocontroller
from .parameters import PROPOSERS, Parameters, Proposer

__all__ = [
    "PROPOSERS",
    "CreativeMemory",
    "EvaluationNetwork",
    "Networks",
    "Neurocontroller",
    "NoisePatterns",
    "Parameters",
    "Proposer",
]
