"""What robots do, measured from tracks made by hand."""

import numpy as np

from musebot.protocols.analysis.behaviour import Track, spins, stay_of

R = 0.06  # [m]; radius of the spot


def poses(seconds, speed=0.0, turn=0.0, radius=None):
    """A robot that moves at `speed` (m/s) straight, or in a circle, and turns at `turn` (rad/s)."""
    time = np.arange(10 * seconds + 1) / 10
    angle = turn * time
    if radius:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
    else:
        x, y = speed * time, 0 * time
    return np.stack([x, y, (angle + np.pi) % (2 * np.pi) - np.pi], axis=1)[:, None]


def test_a_robot_that_turns_without_moving_spins_in_every_second():
    tracks = [
        (poses(5, turn=4.0), True),
        (poses(5, turn=-8.0), True),
        (poses(5), False),
        (poses(5, speed=0.2), False),
        (poses(5, turn=0.5), False),
        (poses(5, speed=0.05, turn=4.0), False),
        (poses(5, turn=3.0, radius=0.005), True),
        (poses(5, turn=2.0, radius=0.1), False),
    ]
    found = spins(np.concatenate([track for track, _ in tracks], axis=1))
    assert found.tolist() == [[expected for _, expected in tracks]] * 5
    assert spins(tracks[0][0][:6]).shape == (1, 1)  # a shorter track counts as one second


def at_the_spot(*parts):
    """A robot's track of parts: seconds, distance of its nose from the spot, speed, turn."""
    path, nose = [np.zeros((1, 1, 3))], []
    for seconds, distance, speed, turn in parts:
        path.append(path[-1][-1:] + poses(seconds, speed, turn)[1:])
        nose += [[[distance, 0.0]]] * (10 * seconds)
    whole = np.concatenate(path)
    return Track(whole, np.zeros((len(nose), 1), dtype=bool), np.zeros((1, 2)), np.array(nose))


FOLLOW, SPIN, AWAY = (R + 0.01, 0.1, 0.0), (0.02, 0.0, 4.0), (0.4, 0.1, 0.0)


def test_robot_follows_the_contour_first_and_spins_inside_later():
    stay = stay_of(at_the_spot((60, *FOLLOW), (60, *SPIN)), R)
    assert stay.staying.tolist() == [True]
    np.testing.assert_allclose(stay.following, [[1, 0]])
    np.testing.assert_allclose(stay.spinning, [[0, 1]])
    np.testing.assert_allclose(stay.minutes, [[1, 0], [0, 1]])


def test_a_minute_has_sixty_seconds_and_the_last_one_may_be_short():
    stay = stay_of(at_the_spot((60, *FOLLOW), (1, *SPIN), (60, *FOLLOW)), R)
    np.testing.assert_allclose(stay.minutes, [[1, 0], [59 / 60, 1 / 60], [1, 0]])


def test_time_away_from_the_spot_does_not_count():
    parts = (30, *AWAY), (30, *SPIN), (60, *AWAY), (30, *FOLLOW), (30, *AWAY)
    stay = stay_of(at_the_spot(*parts), R)
    np.testing.assert_allclose(stay.spinning, [[1, 0]])
    np.testing.assert_allclose(stay.following, [[0, 1]])
    np.testing.assert_allclose(stay.minutes, [[0, 1], [np.nan, np.nan], [1, 0]])


def test_robots_that_leave_at_once_do_not_stay_nor_count():
    tracks = at_the_spot((100, *FOLLOW)), at_the_spot((5, *SPIN), (95, *AWAY))
    both = [
        np.concatenate([getattr(track, name) for track in (*tracks, at_the_spot((100, *AWAY)))], 1)
        for name in ("poses", "events", "nose")
    ]
    stay = stay_of(Track(both[0], both[1], np.zeros((2, 2)), both[2]), R)
    assert stay.staying.tolist() == [True, False, False] and np.isnan(stay.following[2]).all()
    np.testing.assert_allclose(stay.minutes, [[1, 0], [1, 0]])


def test_motion_and_distance_decide_between_following_and_spinning():
    for part, following, spinning in (
        ((R, 0.0, 0.0), 0, 0),  # stationary at the rim
        ((0.02, 0.1, 0.0), 0, 0),  # moves through the spot
        ((R + 0.01, 0.0, 4.0), 0, 0),  # spins outside
        ((R - 0.01, 0.1, 0.0), 1, 0),
        ((R - 0.01, 0.0, 4.0), 0, 1),
    ):
        for seconds in (1, 30):
            stay = stay_of(at_the_spot((seconds, *part)), R)
            np.testing.assert_allclose(stay.following, [[following] * 2])
            np.testing.assert_allclose(stay.spinning, [[spinning] * 2])
            assert stay.staying.tolist() == [True]
