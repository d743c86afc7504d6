# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who commands: restarted nodes, and two sources of one topic."""

from xml.etree import ElementTree

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from fuzzycnc_ros.graph.bring_up import RestartPolicy
from fuzzycnc_ros.ros.command_watch import GONE, SETTLED, Publisher, TopicSources
from fuzzycnc_ros.ros.processes import DISCOVERY_PROFILE

pytestmark = pytest.mark.ros

A, B, UNKNOWN = '/mill/compensator', '/mill/b', '_NODE_NAMESPACE_UNKNOWN_/_NODE_NAME_UNKNOWN_'


def looks(sources, names, until, start=0.0, numbers=()):
    """Look every 0.2 s; return what was found last."""
    publishers = [Publisher(name, bytes([place])) for place, name in enumerate(names)]
    found, now = None, start
    numbers = list(numbers)
    while now < until:
        if numbers:
            sources.heard(numbers.pop(0), lambda: publishers)
        found = sources.look(publishers, now)
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
    assert looks(sources, [A, again], 5.0 + GONE - 1.0, 5.0, numbers=range(1, 60)) is None
    assert looks(sources, [A], 15.0 + GONE, 5.0 + GONE) == ()


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
    assert looks(sources, [A, A], GONE - 1.0) is None
    assert looks(sources, [A, A], GONE + 1.0, GONE - 1.0) == (A, A)


@pytest.fixture
def followed():
    """Sources of a topic that A has published on, up to number 7."""
    sources = TopicSources()
    for number in range(1, 8):
        assert not sources.heard(number, lambda: [OWNER])
    return sources


OWNER, STRANGER = Publisher(A, b'a'), Publisher(B, b'b')
NAMELESS = Publisher(UNKNOWN, b'n')


def test_nobody_asks_who_is_there_while_numbers_go_on(followed):
    """To ask the graph for each message would cost more than the message."""
    asked = []
    assert not followed.heard(8, lambda: asked.append(8) or [OWNER])
    assert not followed.heard(10, lambda: asked.append(10) or [OWNER])
    assert asked == [10]


def test_message_of_another_node_is_refused_before_the_next_look(followed):
    found = followed.heard(1, lambda: [OWNER, STRANGER])
    assert found == f'comes from several nodes at once: {B}, {A}'
    assert not followed.heard(8, lambda: [OWNER])


def test_another_node_that_catches_up_with_the_source_is_not_taken_for_it(followed):
    """It speaks more often, so its numbers come by those of the source."""
    both = [OWNER, STRANGER]
    for number in range(1, 12):
        assert 'several nodes at once' in followed.heard(number, lambda: both), number
    assert not followed.heard(8, lambda: both)


@pytest.mark.parametrize('number', [1, 7])
def test_message_of_a_node_that_is_gone_again_is_refused(followed, number):
    found = followed.heard(number, lambda: [OWNER])
    assert found == f'comes from a node that is gone again; {A} is still there'
    assert not followed.heard(8, lambda: [OWNER])


def test_nameless_node_is_awaited_but_in_lock_step(followed):
    assert 'not known yet' in followed.heard(1, lambda: [OWNER, NAMELESS])
    patient = TopicSources(lockstep=True)
    assert not patient.heard(1, lambda: [OWNER, NAMELESS])


def test_restarted_node_is_believed_from_its_first_message_on(followed):
    again = Publisher(A, b'again')
    assert not followed.heard(1, lambda: [again])
    assert not followed.heard(2, lambda: [again])
    followed.look([again], 10.0)
    assert not followed.heard(3, lambda: [again])
    assert 'gone again' in followed.heard(1, lambda: [again])


def test_source_is_known_by_the_look_too(followed):
    again = Publisher(A, b'again')
    followed.look([again], 10.0)
    assert not followed.heard(1, lambda: [again])
    assert 'gone again' in followed.heard(1, lambda: [again])


def test_lost_messages_and_a_number_that_was_taken_lock_nobody_out(followed):
    assert not followed.heard(20, lambda: [OWNER])  # or a stranger's: nobody can tell
    assert followed.heard(12, lambda: [OWNER])
    assert not followed.heard(13, lambda: [OWNER])
    assert not followed.heard(14, lambda: [OWNER])


def test_what_follows_from_the_lease_of_the_shipped_profile():
    """When a killed node is gone, and when one that hangs is ended."""
    profile = ElementTree.parse(DISCOVERY_PROFILE)
    (seconds,) = profile.iterfind('.//{*}leaseDuration/{*}sec')
    assert float(seconds.text) == GONE - 5.0 == RestartPolicy.silence_max
