# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Statements about a thermal test, and the channel of the bag of each probe."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan

from fuzzycnc_ros.bags.errors import RunError
from fuzzycnc_ros.core.machine.machine_data import LINEAR_AXES
from fuzzycnc_ros.studies.thermal_test.recording import TestRecording

PROBES = ('X1', 'X2', 'Y1', 'Y2', 'Z')
"""Probes of a nest of five, as ISO 230-3 calls them."""

TILTS = {'A': ('Y', -1.0), 'B': ('X', 1.0)}
"""Tilts by name: the axis of the two probes that show it, and its sign.

A rotation A about X moves a point by -A z along Y, a rotation B about Y by B z along X, where z is
its place along Z.
"""


@dataclass(frozen=True, kw_only=True)
class TestSetUp:
    """Statements about a test; a missing one is empty or NaN.

    Parameters
    ----------
    machine, instrument, operator, history : str
        Machine, instrument, who did it, and what was done before.
    date : str
        When it was done.
    uncertainty : float
        Expanded uncertainty of the instrument, k = 2 [m].
    repeatability : float
        Standard deviation of the probes when nothing moves [m].
    resolution : float
        Smallest step that the probes show [m].
    ambient : str
        Sensor that reads the temperature of the air.
    probes : mapping of str to str
        Channel of each probe, by its name.
    places : mapping of str to str
        Where probes are, in words.
    distance : mapping of str to float
        How much farther in +Z the first probe of an axis is than the second [m], by axis.
    """

    __test__ = False  # no test, whatever pytest makes of the name

    machine: str = ''
    instrument: str = ''
    operator: str = ''
    history: str = ''
    date: str = ''
    uncertainty: float = nan
    repeatability: float = nan
    resolution: float = nan
    ambient: str = ''
    probes: Mapping[str, str] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict)
    distance: Mapping[str, float] = field(default_factory=dict)


def probe_channels(set_up: TestSetUp, recording: TestRecording) -> dict[str, int]:
    """Return the column of each probe in a recording, by its name.

    Probes that nobody names are the channels in their order: the first of an axis is X1, its
    second X2; one alone is called by its axis.

    Raises
    ------
    RunError
        If a channel is unknown or of two probes, a probe is none of its axis, or channels that
        are not along X, Y or Z have to be named.
    """
    channels = ', '.join(recording.channel)
    found: dict[str, int] = {}
    for probe, channel in set_up.probes.items():
        if channel not in recording.channel:
            raise RunError(
                f'probe {probe}: expected a channel of {channels} but found {channel!r}'
            )
        column = recording.channel.index(channel)
        axis = recording.axis[column]
        if column in found.values():
            raise RunError(f'probe {probe}: expected a channel of its own but {channel} has one')
        if probe[0] != axis:
            raise RunError(
                f'probe {probe}: expected a channel along {probe[0]} but {channel} is along {axis}'
            )
        found[probe] = column
    if found:
        return dict(sorted(found.items()))
    for channel, axis in zip(recording.channel, recording.axis, strict=True):
        if axis not in LINEAR_AXES:
            raise RunError(
                f'{recording.name}: expected probes along X, Y and Z but channel {channel} is '
                f'along {axis}; name the probes by --probe, such as X1={recording.channel[0]}'
            )
    for axis in sorted(set(recording.axis)):
        columns = [column for column, name in enumerate(recording.axis) if name == axis]
        alone = len(columns) == 1
        found |= {
            axis if alone else f'{axis}{number}': column
            for number, column in enumerate(columns, start=1)
        }
    return found


def check_distances(set_up: TestSetUp, probes: Mapping[str, int]) -> None:
    """Refuse distances between probes that there are not.

    Raises
    ------
    RunError
        If an axis has not two probes.
    """
    for axis in set_up.distance:
        if not {f'{axis}1', f'{axis}2'} <= probes.keys():
            raise RunError(
                f'distance {axis}: expected probes {axis}1 and {axis}2 but found '
                f'{", ".join(probes)}'
            )
