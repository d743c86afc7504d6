# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who commands: restarted nodes, and two sources of one topic."""

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.nodes.command_watch import LEASE, SETTLED, TopicSources

pytestmark = pytest.mark.ros

A, B, UNKNOWN = '/mill/compensator', '/mill/b', '_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_'


def looks(sources, names, until, start=0.0, numbers=()):
    """Look every 0.2 s; return what was found last."""
    found, now = None, start
    numbers = list(numbers)
    while now < until:
        if numbers:
            sources.heard(numbers.pop(0))
        found = sources.look(names, now)
        now += 0.2
    return found


def test_different_names_are_two_sources_at_once():
    sources = TopicSources()
    assert looks(sources, [A], 5.0) == ()
    assert looks(sources, [B, A], 5.0 + 0.1, 5.0) is None
    assert looks(sources, [B, A], 5.0 + 0.2 * (SETTLED + 1), 5.2) == (B, A)
    assert looks(sources, [A], 7.0, 6.5) == ()


@pytest.mark.parametrize('again', [A, UNKNOWN])
def test_restarted_node_is_one_source(again):
    """Until its lease runs out the graph shows the dead one too."""
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, again], 5.0 + LEASE - 1.0, 5.0, numbers=range(1, 60)) is None
    assert looks(sources, [A], 40.0, 30.0) == ()


@pytest.mark.parametrize('again', [A, UNKNOWN])
def test_two_that_speak_are_two_sources_whatever_their_names(again):
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, again], 5.7, 5.0, numbers=[75, 1, 76, 2, 77]) == tuple(
        sorted([A, again])
    )


def test_two_that_begin_together_are_two_sources():
    sources = TopicSources()
    assert looks(sources, [A, A], 1.5, numbers=[1, 1, 2, 2, 3, 3]) == (A, A)


def test_two_restarts_in_a_row_are_still_one_source():
    sources = TopicSources()
    looks(sources, [A], 5.0, numbers=range(50, 75))
    assert looks(sources, [A, A], 7.0, 5.0, numbers=range(1, 11)) is None
    assert looks(sources, [A, A, A], 9.0, 7.0, numbers=range(1, 11)) is None


def test_two_of_one_name_that_outlast_the_lease_are_two_sources():
    sources = TopicSources()
    assert looks(sources, [A, A], LEASE - 1.0) is None
    assert looks(sources, [A, A], LEASE + 1.0, LEASE - 1.0) == (A, A)
