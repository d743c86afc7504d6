# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Ranges, times, tilts and phases of thermal tests that are known exactly."""

from dataclasses import replace
from math import nan, sqrt

import numpy as np
import pytest
from thermal_test_bags import (
    AXES,
    CHANNELS,
    COOLING,
    DRIFT,
    HOUR,
    INTERVAL,
    MARKS,
    REMOVED,
    RISE,
    TIME_CONSTANT,
    displacement,
    mark,
    write_test,
)

from fuzzycnc_ros.bags.errors import BagTopicError, RunError
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.thermal_test.phases import Phase, find_phases, kind_of
from fuzzycnc_ros.studies.thermal_test.recording import read_test
from fuzzycnc_ros.studies.thermal_test.report import judge_test, phase_table, phases_table
from fuzzycnc_ros.studies.thermal_test.set_up import TestSetUp, probe_channels

pytest.importorskip('mcap', reason="bags need pip install 'fuzzycnc_ros[bags]'")

DISTANCE = {'X': 0.1, 'Y': 0.08}
MICRO = 1e-6


SET_UP = TestSetUp(distance=DISTANCE)


def judged(path, set_up=SET_UP, **phases):
    recording = read_test(path)
    return judge_test(recording, set_up, find_phases(recording, **phases))


@pytest.fixture(scope='module', params=[False, True], ids=['bare measured', 'with measured'])
def test_of(request, tmp_path_factory):
    """The same test, measured without and with the offsets in force."""
    path = write_test(tmp_path_factory.mktemp('bags') / 'test', includes=request.param)
    return judged(path)


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """A bag of the test, measured without offsets in force."""
    return write_test(tmp_path_factory.mktemp('plain') / 'test')


def close(found, wanted):
    """Whether a range is right to 0.1 um and to 1 %."""
    assert found.why == ''
    assert found.value == pytest.approx(wanted, abs=min(0.1e-6, 0.01 * abs(wanted)))


def rise(duration, constant=TIME_CONSTANT):
    return 1 - np.exp(-duration / constant)


def rise_time(duration, constant):
    """Return when an exponential that is cut off has 90 % of its change [s]."""
    return -constant * np.log(1 - 0.9 * (1 - np.exp(-duration / constant)))


def test_marks_become_phases_with_their_kinds(test_of):
    found = [(item.phase.name, item.phase.kind, item.phase.start) for item in test_of.phases]
    assert found == [
        ('environment', 'environment', 0.0),
        ('spindle 6000', 'spindle', 2 * HOUR),
        ('cooling', 'cooling', 6 * HOUR),
    ]
    assert test_of.phases[-1].phase.end == 8 * HOUR


def test_ranges_and_times_of_each_probe_with_and_without_compensation(test_of):
    environment, spindle, cooling = test_of.phases
    for place, (name, axis) in enumerate(zip(CHANNELS, AXES, strict=True)):
        first = CHANNELS.index('Z' if axis == 'Z' else f'{axis}1')
        for side, left in (('bare', 0.0), ('compensated', REMOVED[axis])):
            # The offset follows the first probe of its axis, for both of them.
            drift = DRIFT[place] - left * DRIFT[first]
            size = RISE[place] - left * RISE[first]
            constant = TIME_CONSTANT[place]
            found = getattr(environment, side)[name]
            close(found.first_hour, abs(drift) / 2)
            close(found.whole, abs(drift) * (1 - INTERVAL / (2 * HOUR)))
            found = getattr(spindle, side)[name]
            close(found.first_hour, abs(size) * rise(HOUR, constant))
            close(found.whole, abs(size) * rise(4 * HOUR, constant))
            assert np.sign(found.change.value) == np.sign(size)
            assert found.rise_time.value == pytest.approx(rise_time(4 * HOUR, constant), rel=0.01)
            found = getattr(cooling, side)[name]
            hot = size * rise(4 * HOUR, constant)
            close(found.first_hour, abs(hot) * rise(HOUR, COOLING))
            close(found.whole, abs(hot) * rise(2 * HOUR, COOLING))
            assert np.sign(found.change.value) == -np.sign(size)
            assert found.rise_time.value == pytest.approx(rise_time(2 * HOUR, COOLING), rel=0.01)


def test_tilts_are_rotations_by_the_right_hand_rule_and_untouched_by_offsets(test_of):
    spindle = test_of.phases[1]
    for drifts in (spindle.bare, spindle.compensated):
        # B: the upper probe moves farther in +X; A: the upper one moves less in -Y.
        b = (RISE[0] - RISE[1]) / DISTANCE['X']
        a = -(RISE[2] - RISE[3]) / DISTANCE['Y']
        assert (a, b) == pytest.approx((-75e-6, 50e-6))
        for name, size, constant in (('A', a, 2400.0), ('B', b, 1500.0)):
            found = drifts[name]
            assert found.first_hour.value == pytest.approx(
                abs(size) * rise(HOUR, constant), rel=0.01
            )
            assert found.change.value == pytest.approx(size * rise(4 * HOUR, constant), rel=0.01)
            assert found.rise_time.value == pytest.approx(rise_time(4 * HOUR, constant), rel=0.01)


def test_the_combined_drift_is_that_of_the_first_probe_of_each_axis(test_of):
    whole = RISE[[0, 2, 4]] * rise(4 * HOUR, TIME_CONSTANT[[0, 2, 4]])
    close(test_of.phases[1].bare['combined'].whole, np.linalg.norm(whole))
    left = 1 - np.array([REMOVED[axis] for axis in 'XYZ'])
    close(test_of.phases[1].compensated['combined'].whole, np.linalg.norm(left * whole))


def test_the_table_says_which_side_was_measured(test_of):
    table = phase_table(test_of, 2)
    groups = [group for group, _ in table.groups() if group]
    if test_of.phases[1].includes == 'all':
        assert groups == ['without, computed', 'with, measured']
    else:
        assert groups == ['without, measured', 'with, computed']
    row = next(row for row in table.rows if row[0] == 'Z [µm]')
    assert [float(cell) for cell in row[1:]] == pytest.approx(
        [18.96, 29.45, 29.45, 129.0, 1.896, 2.945, 2.945, 129.0], rel=0.01
    )


def test_uncertainty_has_a_source_for_each_term_and_none_that_is_made_up(plain):
    bare = judged(plain)
    assert [term.source == '' for term in bare.budget.terms] == [True, False, True, False]
    assert bare.budget.missing('Z') == ['Instrument', 'Resolution']
    stated = TestSetUp(uncertainty=0.6e-6, repeatability=0.05e-6, resolution=0.012e-6)
    budget = judged(plain, stated).budget
    sizes = [1e6 * term.uncertainty['Z'] for term in budget.terms]
    environment = 1.0 * (1 - INTERVAL / (2 * HOUR)) / sqrt(12)
    wanted = [0.3, 0.05 * sqrt(2), 0.012 * sqrt(2) / sqrt(12), environment]
    assert sizes == pytest.approx(wanted)
    assert 1e6 * budget.expanded('Z') == pytest.approx(2 * np.linalg.norm(wanted))
    assert budget.missing('Z') == []


def test_noise_is_told_from_drift_and_is_the_repeat_of_the_probes(tmp_path):
    rng = np.random.default_rng(3)

    def noisy(time, measured):
        flat = np.zeros_like(measured)
        flat[:, 4] = measured[:, 4]
        return time, flat + 0.1e-6 * rng.normal(size=flat.shape)

    test = judged(write_test(tmp_path / 'test', spoilt=noisy, compensation=False))
    assert not test.compensated
    spindle = test.phases[1].bare
    assert [spindle[name].rise_time.why for name in CHANNELS] == ['no change'] * 4 + ['']
    repeat = test.budget.terms[1]
    assert 1e6 * repeat.uncertainty['X1'] == pytest.approx(0.1 * sqrt(2), rel=0.1)
    assert 'scatter' in repeat.source


def test_without_a_distance_tilts_are_not_stated(plain):
    test = judged(plain, TestSetUp(distance={'X': -0.1}))
    rows = {row[0]: row[1:] for row in phase_table(test, 2).rows}
    assert rows['A [µm/m]'][:4] == ('not stated', 'not stated', '', '')
    assert 'A' not in test.phases[1].bare
    # X1 is the lower one here: the other way round.
    assert test.phases[1].bare['B'].change.value == pytest.approx(-50e-6, rel=0.01)


def test_samples_that_are_missing_leave_no_wrong_number(tmp_path):
    def spoilt(time, measured):
        measured = measured.copy()
        measured[(time > 2.2 * HOUR) & (time < 2.6 * HOUR), 0] = np.nan
        measured[:, 1] = np.nan
        late = (time > 6 * HOUR) & (time < 7.9 * HOUR)
        return time[~late], measured[~late]

    test = judged(write_test(tmp_path / 'test', spoilt=spoilt))
    environment, spindle, cooling = test.phases
    assert environment.bare['X1'].whole.why == ''
    assert spindle.bare['X1'].first_hour.why == spindle.bare['X1'].whole.why
    assert spindle.bare['X1'].whole.why.startswith('gap of 24')
    assert {spindle.bare['X2'].whole.why, spindle.bare['B'].whole.why} == {'not known'}
    close(spindle.bare['Y1'].whole, 20e-6 * rise(4 * HOUR, 2400.0))
    assert cooling.bare['Z'].whole.why.startswith('gap of 114')
    assert cooling.bare['Z'].rise_time.why.startswith('gap')


def test_phases_that_are_too_short_say_so(tmp_path):
    marks = (
        (0.0, 'environment'),
        (0.5 * HOUR, 'spindle'),
        (0.5 * HOUR + 5.0, 'off'),
        (HOUR, 'end'),
    )
    test = judged(write_test(tmp_path / 'test', marks=marks))
    assert [item.phase.name for item in test.phases] == ['environment', 'spindle', 'off']
    short, one, off = (item.bare['Z'] for item in test.phases)
    assert short.first_hour.why == 'too short: 30 min'
    close(short.whole, 0.25e-6)
    assert one.whole.why == one.change.why == 'one sample'
    assert off.whole.why == ''


@pytest.mark.parametrize('rows', [1, 2])
def test_a_test_of_hardly_a_sample_has_no_ranges(rows, tmp_path):
    test = judged(
        write_test(
            tmp_path / 'test',
            marks=(),
            temperatures=False,
            spoilt=lambda time, measured: (time[:rows], measured[:rows]),
        )
    )
    (phase,) = test.phases
    found = phase.bare['Z']
    assert found.first_hour.why
    assert found.rise_time.why
    assert found.whole.why == ('one sample' if rows == 1 else '')


def test_offsets_that_nobody_told_are_not_made_up(tmp_path):
    """What a read-back said long ago is not taken for the offset in force."""
    silent = write_test(tmp_path / 'silent', includes=True, silent_after=3 * HOUR)
    recording = read_test(silent)
    known = np.isfinite(recording.offset).all(axis=1)
    assert recording.time[known].max() == pytest.approx(3 * HOUR, abs=3 * INTERVAL)
    none = judged(write_test(tmp_path / 'none', includes=True, compensation=False))
    for test in (judged(silent), none):
        assert test.phases[2].bare['Z'].whole.why == 'not known'
        close(test.phases[1].compensated['Z'].whole, 3e-6 * rise(4 * HOUR, 3600.0))
    assert judged(silent).phases[1].bare['Z'].whole.why.startswith('gap of 180')


def test_phases_follow_the_spindle_speed_where_nobody_marked(tmp_path):
    test = judged(write_test(tmp_path / 'test', marks=(), speed=True))
    found = [(i.phase.name, i.phase.kind, i.phase.start, i.phase.end) for i in test.phases]
    assert found == [
        ('spindle at rest', 'environment', 0.0, pytest.approx(2 * HOUR, abs=INTERVAL)),
        ('spindle 3000 rpm', 'spindle', pytest.approx(2 * HOUR, abs=INTERVAL), 6 * HOUR),
        ('spindle at rest', 'cooling', 6 * HOUR, 8 * HOUR),
    ]


def test_phases_that_somebody_names_go_first_and_kinds_by_their_names(plain):
    given = [Phase('B', 'other', HOUR, 3 * HOUR), Phase('rest', 'cooling', 3 * HOUR, np.inf)]
    test = judged(plain, given=given, kinds={'B': 'axis'})
    assert [(item.phase.name, item.phase.kind, item.phase.end) for item in test.phases] == [
        ('B', 'axis', 3 * HOUR),
        ('rest', 'cooling', 8 * HOUR),
    ]


def late(at):
    """Return the speed of a spindle that starts an hour after its mark and ends one late."""
    return 50.0 * np.pi if 3 * HOUR <= at < 7 * HOUR else 0.0


def test_marked_phases_are_cut_and_named_by_what_the_spindle_did(tmp_path):
    bag = write_test(tmp_path / 'test', speed=late)
    test = judged(bag)
    assert test.source == 'marked in the bag; where the spindle did otherwise, by that'
    found = [(i.phase.name, i.phase.kind, i.phase.start, i.phase.end) for i in test.phases]
    assert found == [
        ('environment', 'environment', 0.0, 2 * HOUR),
        ('spindle 6000: spindle at rest', 'environment', 2 * HOUR, 3 * HOUR),
        ('spindle 6000: spindle at 1500 rpm', 'spindle', 3 * HOUR, 6 * HOUR),
        ('cooling: spindle at 1500 rpm', 'spindle', 6 * HOUR, 7 * HOUR),
        ('cooling: spindle at rest', 'cooling', 7 * HOUR, 8 * HOUR),
    ]


def test_a_rest_at_speed_is_no_cooling_and_a_spindle_at_rest_no_spindle(tmp_path):
    bag = write_test(tmp_path / 'test', speed=late)
    given = [
        Phase('rest', 'cooling', 4 * HOUR, 6 * HOUR),
        Phase('spindle', 'spindle', 7.5 * HOUR, np.inf),
        Phase('X axis', 'axis', 3 * HOUR, 4 * HOUR),
        Phase('run', 'spindle', 2 * HOUR, 7 * HOUR),
    ]
    found = [(item.phase.name, item.phase.kind) for item in judged(bag, given=given).phases]
    assert found == [
        ('rest: spindle at 1500 rpm', 'spindle'),
        ('spindle: spindle at rest', 'cooling'),
        ('X axis', 'axis'),
        ('run, at rest for 1.0 h of it', 'spindle'),
    ]
    told = judged(bag, given=given[:1], kinds={'rest': 'other'}).phases[0].phase
    assert (told.name, told.kind) == ('rest', 'other')


def test_a_short_rest_or_run_up_belongs_to_its_phase(tmp_path):
    def speed(at):
        pausing = 4 * HOUR <= at < 4 * HOUR + 100.0
        return 100.0 * np.pi if 2 * HOUR + 60.0 <= at < 6 * HOUR and not pausing else 0.0

    test = judged(write_test(tmp_path / 'test', speed=speed))
    assert [item.phase.name for item in test.phases] == ['environment', 'spindle 6000', 'cooling']


@pytest.mark.parametrize('pause', [60.0, 100.0, 300.0])
def test_pauses_of_a_cycle_are_told_in_the_name_of_its_phase(pause, tmp_path):
    """Each is too short for a phase, or they are too many; together they are hours."""

    def speed(at):
        return 100.0 * np.pi if 2 * HOUR <= at < 6 * HOUR and at % (2 * pause) >= pause else 0.0

    test = judged(write_test(tmp_path / 'test', speed=speed))
    found = [(item.phase.name, item.phase.kind) for item in test.phases]
    assert found == [
        ('environment', 'environment'),
        ('spindle 6000, at rest for 2.0 h of it', 'spindle'),
        ('cooling', 'cooling'),
    ]


@pytest.mark.parametrize('marks', [(), MARKS])
def test_noise_of_an_encoder_is_no_turning(marks, tmp_path):
    rng = np.random.default_rng(0)

    def speed(at):
        return rng.normal(100.0 * np.pi if 2 * HOUR <= at < 6 * HOUR else 0.0, 1.2)

    test = judged(write_test(tmp_path / 'test', marks=marks, speed=speed))
    assert [item.phase.kind for item in test.phases] == ['environment', 'spindle', 'cooling']
    assert not any('turning' in item.phase.name for item in test.phases)


@pytest.mark.parametrize('marks', [(), MARKS])
def test_a_speed_that_is_told_no_more_is_unknown(marks, tmp_path):
    def speed(at):
        return 0.0 if at < 2 * HOUR else 100.0 * np.pi if at < 5 * HOUR else np.nan

    test = judged(write_test(tmp_path / 'test', marks=marks, speed=speed))
    found = [(i.phase.name, i.phase.kind, i.phase.end) for i in test.phases]
    if marks:
        assert found == [
            ('environment', 'environment', 2 * HOUR),
            ('spindle 6000', 'spindle', 6 * HOUR),
            ('cooling', 'cooling', 8 * HOUR),
        ]
    else:
        assert found == [
            ('spindle at rest', 'environment', 2 * HOUR),
            ('spindle 3000 rpm', 'spindle', 5 * HOUR),
            ('spindle speed unknown', 'other', 8 * HOUR),
        ]


def test_a_speed_that_is_known_too_late_is_none(plain):
    recording = read_test(plain)
    unknown = np.full(len(recording.time), np.nan)
    found = find_phases(replace(recording, speed=unknown, marks=()))
    assert [item.name for item in found.phases] == ['whole recording']


def test_a_speed_that_changes_within_a_phase_is_no_single_speed(tmp_path):
    bag = write_test(tmp_path / 'test', speed=True)
    given = [Phase('half', 'other', HOUR, 3 * HOUR), Phase('full', 'spindle', 3 * HOUR, 6 * HOUR)]
    rows = phases_table(judged(bag, given=given)).rows
    assert [row[5] for row in rows] == ['0 to 3000', '3000']


@pytest.mark.parametrize(
    ('name', 'kind'),
    [
        ('ETVE', 'environment'),
        ('spindle 6000', 'spindle'),
        ('12000 rpm', 'spindle'),
        ('spindle stopped', 'cooling'),
        ('cool-down', 'cooling'),
        ('coolant on', 'other'),
        ('X axis, 10 m/min', 'axis'),
        ('lunch', 'other'),
    ],
)
def test_names_tell_what_a_phase_is(name, kind):
    assert kind_of(name) == kind


@pytest.mark.parametrize(
    ('phases', 'named'),
    [
        ({'given': [Phase('late', 'other', 9 * HOUR, np.inf)]}, 'phase late: expected a start'),
        ({'given': [Phase('back', 'other', HOUR, HOUR)]}, 'phase back: expected an end after'),
        (
            {'given': [Phase('long', 'other', HOUR, 9 * HOUR)]},
            'phase long: expected an end of 28800',
        ),
        ({'kinds': {'noon': 'other'}}, "expected a phase of cooling, .* but found 'noon'"),
    ],
)
def test_phases_that_there_are_not_are_refused(phases, named, plain):
    with pytest.raises(RunError, match=named):
        judged(plain, **phases)


@pytest.mark.parametrize(
    ('set_up', 'named'),
    [
        (
            TestSetUp(probes={'X1': 'ch1'}),
            "probe X1: expected a channel of X1, .* but found 'ch1'",
        ),
        (TestSetUp(probes={'X1': 'Y1'}), 'probe X1: expected a channel along X but Y1 is along Y'),
        (TestSetUp(probes={'X1': 'X1', 'X2': 'X1'}), 'probe X2: expected a channel of its own'),
        (TestSetUp(probes={'X1': 'X1'}, distance={'X': 0.1}), 'distance X: expected probes X1'),
        (
            TestSetUp(ambient='hall'),
            "ambient: expected a sensor of ambient, bearing but found 'hall'",
        ),
    ],
)
def test_set_ups_that_do_not_fit_the_bag_are_refused(set_up, named, plain):
    with pytest.raises(RunError, match=named):
        judged(plain, set_up)


def test_channels_that_are_no_probes_have_to_be_named(plain):
    recording = replace(read_test(plain), axis=('X', 'X', 'Y', 'Y', 'A'))
    with pytest.raises(RunError, match='channel Z is along A; name the probes by --probe'):
        probe_channels(SET_UP, recording)
    assert probe_channels(TestSetUp(probes={'Y2': 'Y1'}), recording) == {'Y2': 2}


def test_a_mark_that_is_none_is_refused(tmp_path):
    with PublishedBag(tmp_path / 'odd') as bag:
        bag('node_event', replace(mark(0.0, 'rest'), request='{"face": 1}'))
        bag('displacement', displacement(0.0, np.zeros(5), includes=False))
    with pytest.raises(RunError, match='expected a phase as `fuzzycnc operate mark` writes it'):
        read_test(tmp_path / 'odd')


def test_bags_without_displacements_are_refused(tmp_path):
    BagWriter(tmp_path / 'empty').close()
    with pytest.raises(BagTopicError, match='displacement'):
        read_test(tmp_path / 'empty')
    write_test(tmp_path / 'nan', spoilt=lambda time, measured: (time, nan * measured))
    with pytest.raises(RunError, match='all 2881 samples are NaN'):
        read_test(tmp_path / 'nan')
