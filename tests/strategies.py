"""Strategies of hypothesis that several tests need: worlds, experiments and plans."""

from hypothesis import strategies as st

from musebot.controller import PROPOSERS, Parameters
from musebot.protocols.runs.conditions import Condition
from musebot.protocols.runs.experiment import Experiment
from musebot.protocols.runs.plan import Plan
from musebot.tasks.lives import PAPER_LIVES
from musebot.tasks.world import SENSORS, World

CONDITIONS = tuple(Condition(life, p) for life in PAPER_LIVES for p in PROPOSERS)

shares = st.floats(-1, 1)
worlds = st.builds(
    World,
    wheels=st.tuples(shares, shares, shares, shares),
    nose=st.floats(-360, 360),
    sensors=st.lists(
        st.tuples(st.sampled_from(SENSORS), shares, shares), unique_by=lambda entry: entry[0]
    ).map(tuple),
    rewarded=st.sampled_from(["task", "driving"]),
)

experiments = st.builds(
    Experiment,
    seed=st.integers(0, 2**64),
    cohort_size=st.integers(1, 300),
    time_scale=st.floats(0, 1, exclude_min=True),
    nose=st.sampled_from(["inverse", "printed"]),
    learn_across_placement=st.booleans(),
    brain=st.builds(
        Parameters,
        learn_rate=st.floats(0, 1),
        fixed_motors=st.lists(st.floats(-0.5, 0.5), min_size=1).map(tuple),
        noise_on_biases=st.booleans(),
    ),
)


@st.composite
def plans(draw):
    experiment = draw(experiments)
    conditions = draw(st.lists(st.sampled_from(CONDITIONS), min_size=1, unique=True))
    return Plan.of(experiment, conditions, draw(st.integers(1, 5)) * experiment.cohort_size)
