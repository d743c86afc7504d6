# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Which of two sources tells the spindle speed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.components.thermal.predictor_stream import (
    LEAD_MAX,
    OWN,
    STATE,
    SpeedReading,
    SpeedSources,
    speed_told,
    speeds_at,
)
from fuzzycnc_ros.runtime.component import Level
from fuzzycnc_ros.runtime.enums import MachineMode, SpeedStatus
from fuzzycnc_ros.runtime.records import SECOND, MachineState, SpindleSpeed


def sources(*told: tuple[str, float, float]) -> SpeedSources:
    """Return sources that have told speeds [rad/s] at times [s]."""
    made = SpeedSources()
    for topic, time, speed in told:
        made.note(topic, round(time * SECOND), speed)
    return made


def test_state_of_the_machine_has_precedence():
    made = sources((STATE, 10.0, 100.0), (OWN, 11.0, 101.0), (OWN, 10.0 + LEAD_MAX, 102.0))
    assert made.newest == SpeedReading(STATE, 10 * SECOND, 100.0)
    assert made.health().message == '100 rad/s (955 rpm) from machine_state'


def test_state_that_is_silent_or_does_not_know_gives_way():
    late = 10.5 + LEAD_MAX
    for known in ((), ((STATE, 10.0, 100.0), (STATE, 20.0, np.nan), (STATE, 70.0, np.nan))):
        made = sources(*known, (OWN, late, 102.0))
        assert made.newest == SpeedReading(OWN, round(late * SECOND), 102.0)
        assert made.health().message.endswith('from spindle_speed')
    made.note(STATE, round(late * SECOND), 99.0)
    assert made.newest.source == STATE


def test_unknown_speed_leaves_the_last_known():
    made = sources((OWN, 5.0, 50.0), (OWN, 6.0, np.nan), (STATE, 7.0, np.nan))
    assert made.newest == SpeedReading(OWN, 5 * SECOND, 50.0)
    assert sources((STATE, 1.0, np.nan), (OWN, 1.0, np.inf)).newest is None
    assert sources().health().level is Level.WARN


def test_sources_that_contradict_each_other_are_named():
    """A source in rpm that says rad/s; the controller counts."""
    told = [
        entry
        for time in np.arange(0.0, 2.0 * LEAD_MAX, 5.0)
        for entry in ((STATE, time, 314.16), (OWN, time + 1.0, 3000.0))
    ]
    made = sources(*told)
    item = made.health()
    assert item.level is Level.WARN
    assert item.message.startswith('314.2 rad/s (3000 rpm) from machine_state, but spindle_speed')
    # At once when they agree again, here turning the other way round.
    made.note(OWN, round(3.0 * LEAD_MAX * SECOND), -314.0)
    made.note(STATE, round(3.0 * LEAD_MAX * SECOND), 314.0)
    assert made.health().level is Level.OK


def test_a_spindle_that_speeds_up_is_no_contradiction():
    """One source lags behind by seconds."""
    told = [
        entry
        for time in np.arange(0.0, 600.0, 1.0)
        for entry in (
            (STATE, time, 400.0 * (time >= 100.0)),
            (OWN, time, 400.0 * (1.0 - np.exp(-max(time - 100.0, 0.0) / 5.0))),
        )
    ]
    made = SpeedSources()
    for topic, time, speed in told:
        made.note(topic, round(time * SECOND), speed)
        assert made.health().level is Level.OK


def test_what_records_tell():
    state = MachineState(
        stamp=1,
        state=int(MachineMode.ON),
        homed=False,
        offsets_allowed=False,
        cold_since=0,
        spindle_speed=-7.0,
        axis=(),
        position=np.empty(0),
    )
    assert speed_told(STATE, state) == -7.0
    for status in SpeedStatus:
        told = speed_told(OWN, SpindleSpeed(stamp=1, speed=7.0, status=int(status)))
        assert (told == 7.0) if status is SpeedStatus.OK else np.isnan(told)


def test_no_speed_is_none():
    assert speeds_at(np.arange(5), []) is None
    assert speeds_at(np.arange(5), [(STATE, 1, np.nan)]) is None


told_lists = st.lists(
    st.tuples(
        st.sampled_from((STATE, OWN)),
        st.integers(0, 400).map(lambda time: time * SECOND),
        st.one_of(st.just(np.nan), st.floats(-1e3, 1e3)),
    ),
    max_size=30,
    unique_by=lambda item: item[:2],
)


@given(told_lists, st.randoms(use_true_random=False))
def test_recording_gives_what_a_predictor_knew(told, random):
    """Whatever the order in the bag, by the same rule; a sample sees what has its own stamp."""
    stamps = np.arange(0, 450, 30) * SECOND
    live, wanted = SpeedSources(), []
    events = sorted([(stamp, 0, topic, speed) for topic, stamp, speed in told], key=lambda e: e[0])
    for stamp in stamps:
        while events and events[0][0] <= stamp:
            at, _, topic, speed = events.pop(0)
            live.note(topic, at, speed)
        wanted.append(np.nan if live.newest is None else live.newest.speed)
    shuffled = list(told)
    random.shuffle(shuffled)
    found = speeds_at(stamps, shuffled)
    if found is None:
        assert not np.isfinite(wanted).any()
    else:
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize('topic', [STATE, OWN])
def test_one_source_alone_is_held(topic):
    found = speeds_at(np.array([0, 10, 20, 10**15]), [(topic, 15, 3.0), (topic, 10, 2.0)])
    np.testing.assert_array_equal(found, [np.nan, 2.0, 3.0, 3.0])
