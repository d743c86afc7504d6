# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Error along an axis as channels: names, least squares, and what probes at places tell."""

import numpy as np
import pytest

from fuzzycnc_ros.core.thermal.places import (
    AxisSpan,
    along_axes,
    channel_axis,
    channel_spans,
    read_places,
    sloping_channels,
    span_of,
    told_of_channels,
)

SPAN = AxisSpan('Y', -0.5, 0.0, bent=True)


def test_names_tell_the_span():
    assert SPAN.channels == ('Y', 'Y slope -500..0 mm', 'Y bend -500..0 mm')
    assert span_of('Y slope -500..0 mm') == AxisSpan('Y', -0.5, 0.0)
    for name in ('Y', 'Y bend -500..0 mm', 'Y slope 0..0 mm', 'Y slope a..b mm', 'slope 0..1 mm'):
        assert span_of(name) is None
    assert [channel_axis(name) for name in SPAN.channels] == ['Y', 'Y', 'Y']
    channels = sloping_channels(('X', 'Y', 'Z'), (SPAN,))
    assert channels == ('X', 'Y', 'Z', *SPAN.channels[1:])
    (found,) = channel_spans(channels)
    assert (found.span, found.columns) == (SPAN, (1, 3, 4))


def test_the_line_leaves_as_much_at_the_ends_as_in_the_middle():
    rng = np.random.default_rng(1)
    places = np.array([-0.5, -0.25, 0.0])
    values = rng.normal(0.0, 1e-5, (20, 3))
    axis, channel, found = along_axes(
        60.0 * np.arange(20), ['Y'] * 3, ['a', 'b', 'c'], places, values
    )
    assert (axis, channel) == (('Y',) * 3, SPAN.channels)
    left = values - found[:, :2] @ SPAN.shares(places)[:, :2].T
    np.testing.assert_allclose(left[:, 0], -left[:, 1], atol=1e-15)
    np.testing.assert_allclose(left[:, 2], -left[:, 1], atol=1e-15)
    np.testing.assert_allclose(found[:, 2], values[:, 1] - values[:, [0, 2]].mean(1), atol=1e-15)
    np.testing.assert_allclose(found @ SPAN.shares(places).T, values, atol=1e-15)


def test_places_that_are_probed_one_after_the_other_are_one_look():
    time = 60.0 * np.arange(60)
    values = np.full((60, 2), np.nan)
    values[::6, 0], values[3::6, 1] = 1e-8 * time[::6], -1e-8 * time[3::6]
    _, _, found = along_axes(time, 'YY', 'ab', np.array([-0.5, 0.0]), values)
    looked = np.isfinite(values).any(axis=1)
    inner = looked & (time >= 180.0) & (time <= 3240.0)
    np.testing.assert_allclose(found[inner, 1], -1e-8 * time[inner], atol=1e-15)
    assert np.isnan(found[~looked]).all()


def test_places_that_are_probed_hours_apart_tell_no_slope():
    time = 3600.0 * np.arange(10)
    values = np.full((10, 2), np.nan)
    values[::2, 0] = values[1::2, 1] = 1e-6
    _, _, found = along_axes(time, 'YY', 'ab', np.array([-0.5, 0.0]), values)
    assert np.isnan(found).all()


def test_without_the_middle_the_bend_is_unknown_and_the_line_is_not():
    values = np.full((10, 3), 4e-6)
    values[:, 1] = np.nan
    values[0, 1] = 4e-6
    time = 3600.0 * np.arange(10)
    _, channel, found = along_axes(time, 'YYY', 'abc', np.array([-0.5, -0.25, 0.0]), values)
    assert channel == SPAN.channels
    np.testing.assert_allclose(found[1:, :2], np.tile([4e-6, 0.0], (9, 1)), atol=1e-18)
    assert np.isnan(found[1:, 2]).all()


def test_an_axis_at_one_place_stays_as_it_is():
    values = np.arange(20.0).reshape(10, 2)
    axis, channel, found = along_axes(
        np.arange(10.0), 'YZ', ('p', 'q'), np.array([np.nan, -0.2]), values
    )
    assert (axis, channel) == (('Y', 'Z'), ('p', 'q'))
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize('places', [[-0.5, 0.0], [-0.5, -0.25, 0.0], [-0.1], [-0.5, np.nan]])
def test_each_channel_is_told_what_the_joint_update_knows(places):
    rng = np.random.default_rng(2)
    shares = SPAN.shares(np.array(places))
    deviation = np.array([20e-6, 30e-6, 5e-6])
    mean = rng.normal(0.0, 1e-5, 3)
    noise = np.full(len(places), 0.7e-6)
    measured = rng.normal(0.0, 3e-5, len(places))
    gain = np.diag(deviation**2) @ shares.T
    gain = gain @ np.linalg.inv(shares @ np.diag(deviation**2) @ shares.T + np.diag(noise**2))
    expected = mean + gain @ (measured - shares @ mean)
    variance = np.diag((np.eye(3) - gain @ shares) @ np.diag(deviation**2))
    told, spread, _ = told_of_channels(shares, measured, noise, 0 * noise, mean, deviation)
    known = np.isfinite(told)
    weight = deviation**2 / (deviation**2 + spread**2)
    updated = np.where(known, mean + weight * (told - mean), mean)
    np.testing.assert_allclose(updated, expected, rtol=0.0, atol=1e-11)
    after = np.where(known, (1.0 - weight) * deviation**2, deviation**2)
    np.testing.assert_allclose(after, variance, rtol=2e-3)


def test_an_offset_in_force_reaches_the_channels_as_an_error_would():
    shares = SPAN.shares(np.array([-0.5, -0.25, 0.0]))
    line = np.array([10e-6, -20e-6, 0.0])
    values = shares @ line
    _, _, offset = told_of_channels(
        shares, 0 * values, np.full(3, 1e-9), values, np.zeros(3), np.full(3, 30e-6)
    )
    np.testing.assert_allclose(offset, line, atol=1e-10)


@pytest.mark.parametrize(
    'text', ['Y', 'Y:0', 'Y:0:0', 'Q:0:1', 'Y:a:1', 'Y:0:1:2:3', 'Y:0:inf', 'Y:nan:1']
)
def test_places_that_are_none_are_refused(text):
    with pytest.raises(ValueError, match='learn_places: expected each of the axes Y, Z'):
        read_places([text], ['Y', 'Z'], 'learn_places')
