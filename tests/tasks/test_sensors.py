"""Sensor signals: Eqs. 2 and 3 against plain-Python oracles, one number at a time."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from musebot.tasks.sensors import Nose, contact_signal, distance_signal

thorough = settings(max_examples=300)
FORMS = ("inverse", "printed")
forms = pytest.mark.parametrize("form", FORMS)


# Distances, Eq. 2


@thorough
@given(st.floats(-10, 1e6) | st.just(math.inf))
@example(0.0)
@example(-1.0)
@example(-5e-324)
def test_the_distance_signal_is_equation_2_and_0_where_a_ray_hits_nothing(distance):
    signal = distance_signal(np.array([distance]))[0]
    wanted = 1 / (1 + distance) ** 10 if distance >= 0 else 0
    assert signal == pytest.approx(wanted, rel=1e-12) and 0 <= signal <= 1


# Contact


@thorough
@given(st.floats(0, exclude_min=True) | st.just(0.0))
@example(5e-324)
def test_contact_signals_minus_1_for_every_force_however_small_else_0(force):
    assert contact_signal(np.array([force])).tolist() == [-1 if force else 0]


# The nose, Eq. 3


def smell(x, y, odour, alpha, r, form):
    """Section 3 and Eq. 3 in scalars, the spot's centre x ahead and y to the left."""
    d = math.hypot(x, y)
    beta = abs(math.atan2(y, x))
    if d < r:
        raw = odour  # "the full load"
    elif beta > alpha / 2:
        raw = 0.0  # "it does not smell anything"
    elif form == "printed":
        raw = odour * (d / r) * (1 - 2 * beta / alpha)
    else:
        raw = odour * (r / d) * (1 - 2 * beta / alpha)
    return raw / (1 + raw)


noses = st.builds(
    Nose,
    odour=st.floats(0.01, 20),
    frustum=st.floats(0.1, 2 * math.pi),
    spot_radius=st.floats(0.03, 0.3),
    form=st.sampled_from(FORMS),
)


def signal(nose, x, y):
    return float(nose.signal(np.array([x, y])))


@thorough
@given(noses, st.floats(0, 1.3), st.floats(-math.pi, math.pi))
@example(Nose(), 0.0, 0.0)
@example(Nose(form="printed"), 0.0, 0.0)
@example(Nose(), 0.5, math.pi)
@example(Nose(), 0.5, -math.pi)
@example(Nose(), 0.3, math.pi / 4)  # beta = alpha / 2
@example(Nose(form="printed"), 0.3, -math.pi / 4)
@example(Nose(), 1e-300, -math.pi / 4)
def test_the_nose_is_equation_3_in_every_direction(nose, distance, beta):
    x, y = distance * math.cos(beta), distance * math.sin(beta)
    assume(abs(math.hypot(x, y) - nose.spot_radius) > 1e-12)
    wanted = smell(x, y, nose.odour, nose.frustum, nose.spot_radius, nose.form)
    assert signal(nose, x, y) == pytest.approx(wanted, abs=1e-12)
    assert 0 <= signal(nose, x, y) < 1
    assert bool(nose.inside(np.array([x, y]))) == (math.hypot(x, y) < nose.spot_radius)


@forms
def test_the_edge_of_the_spot_is_outside(form):
    nose = Nose(form=form)
    for x, y in [(0.06, 0.0), (0.0, 0.06), (0.0, -0.06), (-0.06, 0.0)]:
        assert not nose.inside(np.array([x, y]))
        assert signal(nose, x, y) == pytest.approx(10 / 11 if x > 0 else 0, abs=1e-12)


def test_many_measurements_signal_as_single_ones():
    inverse, printed = (Nose(form=form) for form in FORMS)
    places = np.random.default_rng(0).uniform(-0.2, 0.2, (4, 50, 3))
    for function in (inverse.signal, printed.signal, inverse.inside):
        found = function(places)
        assert found.shape == (4, 50) and 0 < np.mean(found > 0) < 1
        for index in np.ndindex(4, 50):
            assert found[index] == function(places[index])
    flat = inverse.signal(places * [1, 1, 0])  # the height of the spot has no effect
    np.testing.assert_array_equal(inverse.signal(places), flat)
    for function in (distance_signal, contact_signal):
        single = [function(place) for place in places.ravel()]
        np.testing.assert_array_equal(function(places).ravel(), single)
