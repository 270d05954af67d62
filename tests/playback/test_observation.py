"""What robots do, read from tracks drawn by hand, and from brains back in their robots."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from musebot.controller import BRAINS
from musebot.protocols.experiment.experiment import CohortKey, Experiment
from musebot.protocols.playback import observation as probes
from musebot.protocols.playback.observation import Track, spins, stay_of
from musebot.protocols.playback.stored_brains import Candidate, stored_brains
from musebot.protocols.results.results import Results, collect
from musebot.protocols.simulation.cohort import Cohort

EXPERIMENT = Experiment(time_scale=0.002, cohort_size=3)
CONDITIONS = (("wall_avoidance", "fixed"), ("spot_finding", "creative"))
R = 0.06


@pytest.fixture(scope="module")
def results() -> Results:
    lives = []
    for condition in CONDITIONS:
        key = CohortKey(*condition, 0)
        cohort = Cohort(EXPERIMENT, key)
        cohort.advance(cohort.steps)
        lives.append((key, cohort.lives()))
    return collect(EXPERIMENT, lives)


def poses(seconds, speed=0.0, turn=0.0, radius=None):
    """A robot that goes `speed` (m/s) straight, or round a circle, and turns `turn` (rad/s)."""
    time = np.arange(10 * seconds + 1) / 10
    angle = turn * time
    if radius:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
    else:
        x, y = speed * time, 0 * time
    return np.stack([x, y, (angle + np.pi) % (2 * np.pi) - np.pi], axis=1)[:, None]


@pytest.mark.parametrize(
    ("track", "expected"),
    [
        (poses(5, turn=4.0), True),
        (poses(5, turn=-8.0), True),
        (poses(5), False),
        (poses(5, speed=0.2), False),
        (poses(5, turn=0.5), False),
        (poses(5, speed=0.05, turn=4.0), False),
        (poses(5, turn=3.0, radius=0.005), True),
        (poses(5, turn=2.0, radius=0.1), False),
    ],
)
def test_who_turns_on_the_spot_spins(track, expected):
    assert spins(track).tolist() == [[expected]] * 5


def test_spinning_is_told_for_every_second_and_robot():
    first, second = poses(2, turn=4.0), poses(2, speed=0.1)
    second[-1, :, :2] += second[-1, :, :2] - second[-2, :, :2]
    assert spins(np.concatenate([first, second], axis=1)).tolist() == [[True, False]] * 2


def test_less_than_a_second_is_judged_by_what_there_is():
    assert spins(poses(1, turn=4.0)[:6]).shape == (1, 1)


def at_the_spot(*parts):
    """A robot's track, of parts: seconds, distance of its nose from the spot, speed, turn."""
    path, nose = [np.zeros((1, 1, 3))], []
    for seconds, distance, speed, turn in parts:
        path.append(path[-1][-1:] + poses(seconds, speed, turn)[1:])
        nose += [[[distance, 0.0]]] * (10 * seconds)
    whole = np.concatenate(path)
    return Track(whole, np.zeros((len(nose), 1), dtype=bool), np.zeros(2), np.array(nose))


FOLLOW, SPIN, AWAY = (R + 0.01, 0.1, 0.0), (0.02, 0.0, 4.0), (0.4, 0.1, 0.0)


def test_a_robot_that_follows_the_contour_and_then_spins_inside():
    stay = stay_of(at_the_spot((60, *FOLLOW), (60, *SPIN)), R)
    assert stay.staying.tolist() == [True]
    np.testing.assert_allclose(stay.following, [[1, 0]])
    np.testing.assert_allclose(stay.spinning, [[0, 1]])
    np.testing.assert_allclose(stay.minutes, [[0, 1, 0], [1, 0, 1]])


def test_time_away_from_the_spot_counts_nowhere():
    parts = (30, *AWAY), (30, *SPIN), (60, *AWAY), (30, *FOLLOW), (30, *AWAY)
    stay = stay_of(at_the_spot(*parts), R)
    np.testing.assert_allclose(stay.spinning, [[1, 0]])
    np.testing.assert_allclose(stay.following, [[0, 1]])
    np.testing.assert_allclose(stay.minutes, [[0, 0, 1], [1, np.nan, np.nan], [2, 1, 0]])


def test_who_leaves_at_once_does_not_stay():
    stay = stay_of(at_the_spot((5, *SPIN), (95, *AWAY)), R)
    assert stay.staying.tolist() == [False]
    never = stay_of(at_the_spot((100, *AWAY)), R)
    assert never.staying.tolist() == [False]
    assert np.isnan(never.following).all()


def test_the_minutes_are_of_those_that_stay():
    stayer, leaver = at_the_spot((100, *FOLLOW)), at_the_spot((5, *SPIN), (95, *AWAY))
    both = [
        np.concatenate([getattr(track, name) for track in (stayer, leaver)], axis=1)
        for name in ("poses", "events", "nose")
    ]
    stay = stay_of(Track(both[0], both[1], np.zeros(2), both[2]), R)
    assert stay.staying.tolist() == [True, False]
    np.testing.assert_allclose(stay.minutes, [[0, 1, 0], [1, 1, 0]])


@pytest.mark.parametrize(
    ("part", "following", "spinning"),
    [
        ((R, 0.0, 0.0), 0, 0),  # standing at the rim
        ((0.02, 0.1, 0.0), 0, 0),  # going through
        ((R + 0.01, 0.0, 4.0), 0, 0),  # spinning outside
        ((R - 0.01, 0.1, 0.0), 1, 0),
        ((R - 0.01, 0.0, 4.0), 0, 1),
    ],
)
def test_what_counts_as_following_and_what_as_spinning_inside(part, following, spinning):
    stay = stay_of(at_the_spot((30, *part)), R)
    np.testing.assert_allclose(stay.following, [[following] * 2])
    np.testing.assert_allclose(stay.spinning, [[spinning] * 2])


# ---- Brains back in their robots ----


def test_a_batch_of_brains_does_what_each_does_alone(results):
    # Fixed proposes without noise, so that every brain goes its own way to the last bit.
    rows = [(0, "before"), (2, "after"), (1, "before")]
    track = probes.sit(EXPERIMENT, results, "wall_avoidance", "fixed", rows, 0.02)
    for index, (row, when) in enumerate(rows):
        phase = {"before": "pre", "after": "post"}[when]
        alone = Candidate(EXPERIMENT, results, "wall_avoidance", "fixed", row, phase).episode()
        for pose, moment in zip(track.poses[:, index], alone.moments(), strict=False):
            np.testing.assert_allclose(pose, moment.pose, atol=1e-6)


def test_a_stored_brain_beyond_the_papers_does_in_its_robot_what_it_did():
    experiment = dataclasses.replace(EXPERIMENT, brain=BRAINS["steady"])
    key = CohortKey("spot_finding", "fixed", 0)
    cohort = Cohort(experiment, key)
    cohort.advance(cohort.steps)
    lived = cohort.agent
    stored = collect(experiment, [(key, cohort.lives())])
    again = stored_brains(
        experiment, stored, key.task, key.proposer, [(i, "after") for i in range(3)], 0
    )
    random = np.random.default_rng(0)
    for _ in range(20):
        nose = random.uniform(0, 10 / 11, (3, 1)).astype(np.float32)
        np.testing.assert_array_equal(again.act(nose, False), lived.act(nose, False))


def test_everything_lived_is_observed_and_every_tick_announced(results):
    ticks = []
    behaviour = probes.observe(EXPERIMENT, results, lambda: ticks.append(1))
    assert behaviour.spinning.keys() == set(CONDITIONS)
    for shares in behaviour.spinning.values():
        assert shares.shape == (3, 2)
        assert ((shares >= 0) & (shares <= 1)).all()
    assert len(ticks) == probes.ticks(EXPERIMENT, results) > 0


def test_only_robots_that_found_the_spot_are_set_before_it_again(results):
    row = next(r for r in results.robots if r.task == "spot_finding")
    four = [dataclasses.replace(row, robot=i, category="L < 0") for i in range(4)]
    brains = {
        k: np.concatenate([v, v[:1]]) for k, v in results.brains.items() if k.startswith("spot")
    }
    scaled = dataclasses.replace(EXPERIMENT, time_scale=1 / 60)  # minutes 1 to 4 are training
    curves = np.zeros((4, 6))
    curves[[0, 2], 1:5] = 0.5
    curves[1, [0, 5]] = 1.0
    lives = Results(four, {"spot_finding/creative": curves}, brains)
    behaviour = probes.observe(scaled, lives)
    assert len(behaviour.stays["creative"].staying) == 2


def test_invalid_robots_are_not_watched(results):
    rows = [dataclasses.replace(r, category="invalid") for r in results.robots]
    behaviour = probes.observe(EXPERIMENT, Results(rows, results.curves, results.brains))
    assert behaviour.spinning == {} and behaviour.stays == {}
    assert probes.ticks(EXPERIMENT, Results(rows, results.curves, results.brains)) == 0
