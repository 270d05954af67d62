"""The brain: an evaluation network that judges, a creative memory that proposes. Torch only."""

from .evaluation import EvaluationNetwork
from .memory import CreativeMemory, NoisePatterns
from .networks import Networks
from .neurocontroller import Neurocontroller
from .parameters import BRAINS, INGREDIENTS, PROPOSERS, Parameters, Proposer
from .reading import Senses, Signal

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
    "Senses",
    "Signal",
]
