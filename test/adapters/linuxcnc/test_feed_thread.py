# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The C of the component `fuzzycnc_feed`, compiled without LinuxCNC.

Every step of `FeedThread` checks that the share is never above 1 and never stuck at zero.
"""

import math

import numpy as np
import pytest
from benches.feed_thread import FeedThread, table_text

SPEED = 20.0
"""Of the tool with a share of 1 [mm/s]."""


class Path:
    """A path of lines, and a tool that goes along it as the share says."""

    def __init__(self, folder, corners, shares, lines=None):
        self.corners = np.array(corners, dtype=float)
        lines = list(range(2, len(corners) + 1)) if lines is None else list(lines)
        self.lines, self.shares = [*lines, lines[-1]], np.array(shares, dtype=float)
        length = np.linalg.norm(np.diff(self.corners, axis=0), axis=1)
        self.place = np.append(0.0, np.cumsum(length))
        file = folder / 'part.feed'
        file.write_text(table_text(self.corners, self.lines, shares))
        self.thread = FeedThread(file)

    def at(self, place):
        """Return the point at a place [mm], and the line of the program there."""
        index = min(np.searchsorted(self.place, place, 'right') - 1, len(self.lines) - 2)
        point = [np.interp(place, self.place, column) for column in self.corners.T]
        return np.array(point), self.lines[index]

    def share(self, place):
        return float(np.interp(place, self.place, self.shares))

    def drive(self, begin=0.0, end=None, feed=1.0, wobble=None):
        """Run the path; yield place, share and the share of the table there."""
        place, share = begin, self.thread.least
        end = self.place[-1] if end is None else end
        while place < end:
            place += max(1e-6, SPEED * share * feed * FeedThread.PERIOD)
            point, line = self.at(place)
            noise = 0.0 if wobble is None else wobble.normal(0.0, 1e-5, 3)
            share = self.thread.step(point + noise, line)
            yield place, share, self.share(place + SPEED * share * feed * FeedThread.PERIOD)


def on_table(steps, leave=20):
    """Check that the share is that of the table, but for the periods until the path is found."""
    found = list(steps)[leave:]
    assert found
    for place, share, wanted in found:
        assert share == pytest.approx(wanted, abs=0.02), place
    return found


def random_path(folder, seed, count=40):
    rng = np.random.default_rng(seed)
    corners = np.cumsum(rng.normal(0.0, 1.0, (count, 3)), axis=0)
    return Path(folder, corners, rng.uniform(0.1, 1.0, count))


@pytest.mark.parametrize('seed', range(3))
def test_random_paths_are_followed(tmp_path, seed):
    path = random_path(tmp_path, seed)
    path.thread.start(path.corners[0])
    on_table(path.drive(wobble=np.random.default_rng(seed)))


def test_share_is_one_until_it_is_armed(tmp_path):
    path = random_path(tmp_path, 1)
    assert all(share == 1.0 for _, share, _ in path.drive())
    # in the middle of a program it is not armed any more: nobody knows where the tool is
    path.thread.pins.idle, path.thread.pins.arm = 0, 1
    assert all(share == 1.0 for _, share, _ in path.drive())
    assert not path.thread.active


@pytest.mark.parametrize('offset', [(5, 0, 0), (0, 0, 0.1), (-300, 200, 1), (0.1, 0.1, 0)])
def test_shifted_program_gets_the_least_share(tmp_path, offset):
    path = random_path(tmp_path, 2)
    path.thread.start(path.corners[0])
    least = path.thread.least
    places = np.arange(0.0, path.place[-1], 0.02)
    points = [(path.at(place)[0] + offset, path.at(place)[1]) for place in places]
    shares = [path.thread.step(*point) for point in points]
    # it may cross the path it is not on, but does not stay on it
    assert np.mean(np.array(shares) == least) > 0.97


def test_table_of_another_program_gets_the_least_share(tmp_path):
    path, other = random_path(tmp_path, 3), random_path(tmp_path, 4)
    other.thread.start(path.corners[0])
    shares = [other.thread.step(*path.at(place)) for place in np.arange(0.0, 60.0, 0.02)]
    assert np.mean(np.array(shares) == other.thread.least) > 0.97
    assert not other.thread.on_path


def test_crossing_is_not_taken_for_the_part_that_comes_later(tmp_path):
    """A figure of eight: at its crossing it has the share of 0.9, later that of 0.2."""
    corners = [(-10, -10, 0), (10, 10, 0), (10, -10, 0), (-10, 10, 0)]
    path = Path(tmp_path, corners, (0.9, 0.9, 0.2, 0.2))
    path.thread.start(path.corners[0])
    on_table(path.drive())


@pytest.mark.parametrize('lines', [(2, 3, 4, 5), (2, 2, 2, 2)])
def test_repeated_passes_are_told_apart(tmp_path, lines):
    """There and back, twice, on one line of the program or on one each."""
    corners = [(0, 0, 0), (8, 0, 0), (0, 0, 0), (8, 0, 0), (0, 0, 0)]
    path = Path(tmp_path, corners, (0.9, 0.3, 0.6, 0.2, 0.8), lines)
    path.thread.start(path.corners[0])
    on_table(path.drive())


def test_run_from_line_finds_the_pass_of_that_line(tmp_path):
    corners = [(0, 0, 0), (8, 0, 0), (0, 0, 0), (8, 0, 0), (0, 0, 0)]
    path = Path(tmp_path, corners, (0.9, 0.3, 0.6, 0.2, 0.8))
    path.thread.start(path.corners[0])
    on_table(path.drive(begin=17.0))
    assert path.thread.part == 3


def test_lines_that_the_path_does_not_have_run_as_written(tmp_path):
    path = random_path(tmp_path, 5)
    path.thread.start((50.0, 50.0, 50.0))
    assert path.thread.step((50.1, 50.0, 50.0), 1) == 1.0
    assert path.thread.step((50.2, 50.0, 50.0), 2) == path.thread.least


def test_feed_hold_and_override_stay_on_the_path(tmp_path):
    path = random_path(tmp_path, 6)
    path.thread.start(path.corners[0])
    rng, place = np.random.default_rng(6), 0.0
    while place < path.place[-1] - 1.0:
        stretch = rng.uniform(0.5, 4.0)
        list(path.drive(place, min(place + stretch, path.place[-1]), feed=rng.uniform(0.05, 1.5)))
        place += stretch
        held = [path.thread.step(*path.at(min(place, path.place[-1]))) for _ in range(200)]
        assert path.thread.on_path
        assert len(set(held[1:])) == 1
        place = min(place, path.place[-1] - 0.01)
        assert held[-1] == pytest.approx(path.share(place), abs=0.02)


def test_aborted_program_starts_anew(tmp_path):
    path = random_path(tmp_path, 7)
    path.thread.start(path.corners[0])
    list(path.drive(end=15.0))
    path.thread.pins.idle = 1
    path.thread.step((9.0, 9.0, 9.0), 0)  # jogged
    path.thread.start(path.corners[0])
    on_table(path.drive())


def test_leap_of_the_position_is_lost_until_the_line_is_found_again(tmp_path):
    path = random_path(tmp_path, 8)
    path.thread.start(path.corners[0])
    list(path.drive(end=10.0))
    point, line = path.at(10.0)
    assert path.thread.step(point + 3.0, line) == path.thread.least
    on_table(path.drive(begin=20.0))


@pytest.mark.parametrize('value', [math.nan, math.inf])
def test_position_that_is_none_is_lost(tmp_path, value):
    path = random_path(tmp_path, 9)
    path.thread.start(path.corners[0])
    list(path.drive(end=10.0))
    for _ in range(3):
        assert path.thread.step((value, 0.0, 0.0), 3) == path.thread.least
    on_table(path.drive(begin=10.0))


def test_silent_helper_leaves_the_least_share_until_the_program_ends(tmp_path):
    path = random_path(tmp_path, 10)
    path.thread.start(path.corners[0])
    list(path.drive(end=5.0))
    path.thread.speaks = False
    shares = [share for _, share, _ in path.drive(5.0, 5.0 + SPEED)]
    least = path.thread.least
    assert shares[-1] == least
    assert not path.thread.active
    path.thread.speaks = True  # it comes too late for this program
    assert all(share == least for _, share, _ in path.drive(30.0, 32.0))
    path.thread.pins.arm, path.thread.pins.idle = 0, 1
    assert path.thread.step(path.corners[0], 0) == 1.0


def test_other_line_than_that_of_the_place_is_believed(tmp_path):
    """Two passes on the same way: the control runs the later one, whatever was followed."""
    corners = [(0, 0, 0), (8, 0, 0), (8, 1, 0), (0, 1, 0), (0, 0, 0), (8, 0, 0)]
    path = Path(tmp_path, corners, (0.9, 0.9, 0.9, 0.9, 0.2, 0.2))
    path.thread.start(path.corners[0])
    list(path.drive(end=2.0))
    shares = [path.thread.step((2.0 + 0.01 * k, 0, 0), 6) for k in range(300)]
    assert path.thread.part == 4
    assert shares[-1] == pytest.approx(0.2)


@pytest.mark.parametrize('seed', [1, 2])
def test_whatever_is_commanded(tmp_path, seed):
    """Random pins: `step` checks the bounds."""
    rng, path = np.random.default_rng(seed), random_path(tmp_path, seed)
    place = 0.0
    for _ in range(20_000):
        if rng.random() < 0.02:
            path.thread.pins.arm, path.thread.pins.idle = rng.integers(0, 2, 2).tolist()
            path.thread.speaks = rng.random() < 0.8
        if rng.random() < 0.01:
            place = rng.uniform(0.0, path.place[-1])
        place = min(place + 0.02, path.place[-1])
        point, line = path.at(place)
        scale = 10.0 ** rng.uniform(-9, 9) if rng.random() < 0.01 else 0.0
        path.thread.step(point + rng.normal(0.0, scale, 3), line if rng.random() < 0.99 else -line)


@pytest.mark.parametrize(
    'change',
    [
        ('fuzzycnc-feed 1', 'fuzzycnc-feed 2'),
        ('points 3', 'points 4'),
        ('points 3', 'points 1'),
        (' 0.5000', ' 0.0000'),
        (' 0.5000', ' 1.0001'),
        (' 0.5000', ' nan'),
        ('3 1.00000', '3 inf'),
        ('3 1.00000', '0 1.00000'),
        ('0123456789abcdef', ''),
    ],
)
def test_what_is_no_table_is_not_taken(tmp_path, change):
    file = tmp_path / 'part.feed'
    text = table_text([(0, 0, 0), (1, 0, 0), (2, 0, 0)], (2, 3, 3), (0.9, 0.5, 0.8))
    file.write_text(text)
    assert FeedThread(file).least == 0.5
    assert text.replace(*change) != text
    file.write_text(text.replace(*change))
    with pytest.raises(ValueError, match='no table'):
        FeedThread(file)
