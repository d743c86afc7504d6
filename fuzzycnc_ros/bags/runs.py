# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading a thermal run out of a bag, or out of records."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import compress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.bags.errors import BagDataError, BagTopicError, RunError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.components.thermal.control_drives import drives_at, drives_told
from fuzzycnc_ros.components.thermal.predictor_stream import STATE, TOPICS, speed_told, speeds_at
from fuzzycnc_ros.core.names import repeated_names
from fuzzycnc_ros.core.thermal.places import along_axes, place_channels
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun, counted
from fuzzycnc_ros.core.thermal.sensor_limits import SensorLimits
from fuzzycnc_ros.runtime.convert import stamp_of
from fuzzycnc_ros.runtime.records import Record

TEMPERATURES_TYPE = 'fuzzycnc_msgs/msg/Temperatures'
DISPLACEMENT_TYPE = 'fuzzycnc_msgs/msg/Displacement'

_STATUS_OK = 0


class TopicSeries(NamedTuple):
    """Samples of one topic.

    Parameters
    ----------
    stamp : ndarray, shape (n,)
        Header stamps [ns], strictly increasing.
    names : tuple of tuple of str
        The parallel name arrays, the same in every sample.
    values : ndarray, shape (n, k)
        The samples.
    """

    stamp: NDArray[np.int64]
    names: tuple[tuple[str, ...], ...]
    values: NDArray[np.float64]


def read_run(
    path: str | os.PathLike[str],
    *,
    start: float | None = None,
    stop: float | None = None,
    temperatures: str = 'temperatures',
    displacement: str = 'displacement',
    namespace: str | None = None,
    name: str | None = None,
    average: bool = False,
    compensated: bool = False,
    sensors: Callable[[str], bool] | None = None,
    sensor_limits: Iterable[str] = (),
    places: bool = False,
) -> ThermalRun:
    """Read a thermal run from a bag.

    Parameters
    ----------
    path : path
        The bag.
    start, stop : float, optional
        Window whose samples count, in s from the first temperature sample; what it does to the
        others, `windows.counted` says.
    temperatures, displacement : str
        Names of the topics, without namespace, or absolute.
    namespace : str, optional
        The machine, where the bag holds several.
    name : str, optional
        Name of the run; the bag's own name if absent.
    average : bool
        Whether a sample gets the mean of the displacements since the sample before, instead
        of the newest one.
    compensated : bool
        Whether displacements measured under active compensation are accepted; they are what
        was left of the machine's error, so no model can be trained on them.
    sensors : callable, optional
        Says of a sensor's name whether the run is to have it; all if absent.  What the others
        read is not looked at.
    sensor_limits : iterable of str
        Limits of sensors that are not those of a machine's metal, such as `bed:rate_max:0.7`; see
        `SensorLimits`.
    places : bool
        Whether an axis that was measured at several places has a channel for each of them,
        instead of offset, slope and bend; see `core.thermal.places`.

    Returns
    -------
    ThermalRun
        Time in s from the first temperature sample of the bag; readings whose status is not OK
        are NaN; each sample has of each channel the newest displacement that is not newer than
        itself and newer than the sample before, NaN if there is none, and the spindle speed that
        a predictor would have known, where the bag has `machine_state` or `spindle_speed` with
        one.

    Raises
    ------
    BagTopicError
        If the bag lacks a topic, or has it in several namespaces and none is named.
    RunError
        If sensors repeat or change within the bag, stamps do not increase, the window is empty,
        temperatures and displacements do not overlap, compensation was active, or no sensor is
        wanted.
    BagError
        If the bag cannot be read.
    """
    source = Path(path)
    with BagReader(source) as reader:
        topic = find_topic(reader, temperatures, TEMPERATURES_TYPE, namespace)
        depth = temperatures.strip('/').count('/') if not temperatures.startswith('/') else 0
        machine = topic.rsplit('/', depth + 1)[0] if '/' in topic else ''
        other = find_topic(
            reader, displacement, DISPLACEMENT_TYPE, machine if namespace is None else namespace
        )
        sources = speed_topics(reader, machine if namespace is None else namespace)
        wanted = [topic, other, *sources]
        return thermal_run(
            source,
            (topic, other, sources),
            ((item.topic, item.message) for item in reader.messages(wanted)),  # one pass
            start=start,
            stop=stop,
            name=name,
            average=average,
            compensated=compensated,
            sensors=sensors,
            sensor_limits=sensor_limits,
            places=places,
        )


def thermal_run(
    source: Path,
    topics: tuple[str, str, Mapping[str, str]],
    messages: Iterable[tuple[str, Any]],
    *,
    start: float | None = None,
    stop: float | None = None,
    name: str | None = None,
    average: bool = False,
    compensated: bool = False,
    sensors: Callable[[str], bool] | None = None,
    sensor_limits: Iterable[str] = (),
    places: bool = False,
) -> ThermalRun:
    """Gather a thermal run from messages, or from records.

    Parameters
    ----------
    source : Path
        Their file, for refusals and for the run's name.
    topics : tuple
        Topic of the temperatures, that of the displacements, and those that tell the spindle
        speed, each with the name of its source.
    messages : iterable of (topic, message or record)
        In the order of their stamps.
    start, stop, name, average, compensated, sensors, sensor_limits, places
        See `read_run`.

    Raises
    ------
    RunError
        See `read_run`.
    """
    topic, other, sources = topics
    temperature = SampleCollector(source, topic, ('sensor',), 'sensor')
    moving = Displacements(source, other)
    told: list[tuple[str, int, float]] = []
    driven: list[tuple[int, dict[str, float], dict[str, float]]] = []
    for kind, message in messages:
        if kind in sources:
            teller = sources[kind]
            told.append((teller, _stamp(message), speed_told(teller, message)))
            if teller == STATE and (drives := drives_told(message)) is not None:
                driven.append((_stamp(message), *drives))
        elif kind == topic:
            temperature.add(message, message.temperature, message.status == _STATUS_OK)
        elif kind == other:
            if message.includes_compensation and not compensated:
                raise RunError(
                    f'{source}: {other}: expected the error of the bare machine but at stamp '
                    f'{_seconds(_stamp(message))} s compensation was active; use a run '
                    'without it'
                )
            moving.take(message)
    measured, moved = temperature.series(), moving.series()
    time = (measured.stamp - measured.stamp[0]) / 1e9
    joined = _join(measured.stamp, moved, average)
    axis, channel = moved.names
    if not places:
        axis, channel, joined = along_axes(time, axis, channel, moving.position, joined)
    speed = speeds_at(measured.stamp, told)
    inside = (time >= (-np.inf if start is None else start)) & (
        time <= (np.inf if stop is None else stop)
    )
    if not inside.any():
        raise RunError(
            f'{source}: expected samples between {start} and {stop} s but the run lasts from 0 '
            f'to {time[-1]:.6g} s'
        )
    if not np.isfinite(joined[inside]).any():
        if not np.isfinite(moved.values).any():
            raise RunError(
                f'{source}: expected displacements but found {len(moved.stamp)} messages of '
                f'{other} whose values are all missing; record or import the run anew'
            )
        raise RunError(
            f'{source}: expected displacements during the temperatures but found none: '
            f'{topic} has stamps from {_seconds(measured.stamp[0])} to '
            f'{_seconds(measured.stamp[-1])} s, {other} from {_seconds(moved.stamp[0])} to '
            f'{_seconds(moved.stamp[-1])} s; both must use the same clock'
        )
    # Nothing is asked of what comes after the window, which may be why it ends there.
    used = time <= (np.inf if stop is None else stop)
    wanted = [sensors is None or sensors(item) for item in measured.names[0]]
    if not any(wanted):
        raise RunError(
            f'{source}: expected a sensor that is used but found {", ".join(measured.names[0])} '
            'and all of them left out'
        )
    try:
        run = ThermalRun(
            name=name or source.stem,
            time=time[used],
            sensor=tuple(compress(measured.names[0], wanted)),
            temperature=measured.values[np.ix_(used, wanted)],
            channel=channel,
            axis=axis,
            displacement=joined[used],
            spindle_speed=None if speed is None else speed[used],
            drives={name: v[used] for name, v in drives_at(measured.stamp, driven).items()},
            limits=SensorLimits.of(sensor_limits),
        )
        return counted(run, start, stop)
    except ThermalDataError as error:
        raise RunError(f'{source}: {error}') from error


def read_temperatures(
    path: str | os.PathLike[str], namespace: str | None = None
) -> tuple[NDArray[np.float64], tuple[str, ...], NDArray[np.float64], NDArray[np.float64] | None]:
    """Read the temperatures of a bag alone, also those that were found implausible.

    Returns
    -------
    tuple
        Times [s] from the first sample, names of the sensors, temperatures [degC], shape (n, k),
        NaN where there is none, and the spindle speed [rad/s], None if the bag has none.

    Raises
    ------
    BagTopicError
        If the bag lacks the topic, or has it in several namespaces and none is named.
    BagError
        If the bag cannot be read.
    """
    source = Path(path)
    with BagReader(source) as reader:
        topic = find_topic(reader, 'temperatures', TEMPERATURES_TYPE, namespace)
        sources = speed_topics(reader, topic.rpartition('/')[0])
        samples = SampleCollector(source, topic, ('sensor',), 'sensor')
        told: list[tuple[str, int, float]] = []
        for kind, _, _, message in reader.messages([topic, *sources]):
            if kind in sources:
                told.append((sources[kind], _stamp(message), speed_told(sources[kind], message)))
            else:
                samples.add(message, message.temperature)
    found = samples.series()
    time = (found.stamp - found.stamp[0]) / 1e9
    return time, found.names[0], found.values, speeds_at(found.stamp, told)


def sensor_names(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the sensors of the first temperatures in a bag, in any namespace.

    Raises
    ------
    BagError
        If the bag cannot be read or has no temperatures.
    """
    with BagReader(Path(path)) as reader:
        topic = find_topic(reader, 'temperatures', TEMPERATURES_TYPE)
        first = next(iter(reader.messages([topic])))
        return tuple(first.message.sensor)


def find_topic(reader: BagReader, name: str, type_name: str, namespace: str | None = None) -> str:
    """Return the topic of a name in whatever namespace the bag has it.

    Parameters
    ----------
    reader : BagReader
        The bag.
    name : str
        Name without namespace, or an absolute topic.
    type_name : str
        The type that it must have.
    namespace : str, optional
        The namespace, where the bag holds several.

    Raises
    ------
    BagTopicError
        If there is no such topic with messages, several, or it has another type.
    """
    if name.startswith('/') or namespace is not None:
        absolute = _absolute(name if name.startswith('/') else f'{namespace}/{name}')
        wanted = [topic for topic in reader.connections if _absolute(topic) == absolute]
    else:
        absolute = name
        wanted = [
            topic
            for topic, connection in reader.connections.items()
            if f'/{topic}'.endswith(f'/{name}')
            and connection.type == type_name
            and connection.message_count
        ]
    if len(wanted) > 1:
        raise BagTopicError(
            f'{reader.path}: expected one topic {name} but found {", ".join(sorted(wanted))}; '
            'name the namespace'
        )
    topic = wanted[0] if wanted else absolute
    reader.require({topic: type_name})
    return topic


class SampleCollector:
    """The samples of a topic as they come, with the name arrays, which must stay the same.

    Parameters
    ----------
    path : Path
        The bag, for messages.
    topic : str
        The topic.
    fields : tuple of str
        Fields of a message that hold the name arrays.
    unique : str
        The one of them whose names must differ.
    """

    def __init__(self, path: Path, topic: str, fields: tuple[str, ...], unique: str) -> None:
        self._where = f'{path}: {topic}'
        self._fields = fields
        self._unique = unique
        self._names: list[list[str]] = []
        self._stamps: list[int] = []
        self._rows: list[NDArray[np.float64]] = []

    def add(
        self, message: Any, values: NDArray[np.float64], valid: NDArray[np.bool_] | None = None
    ) -> None:
        """Take a message, its values, and which of them are valid, all parallel to the names."""
        names = [getattr(message, field) for field in self._fields]
        if names != self._names:
            self._check_names(message, names)
            self._names = names
        for entry in (values, *names, *(() if valid is None else (valid,))):
            if len(entry) != len(names[0]):
                raise BagDataError(
                    f'{self._where}: expected {len(names[0])} entries, one per '
                    f'{self._fields[0]}, but found {len(entry)} at stamp '
                    f'{_seconds(_stamp(message))} s'
                )
        if valid is not None and not valid.all():
            values = np.where(valid, values, np.nan)
        self._stamps.append(_stamp(message))
        self._rows.append(values)

    def _check_names(self, message: Any, names: list[list[str]]) -> None:
        for field, before, now in zip(self._fields, self._names, names, strict=False):
            if before != now:
                raise RunError(
                    f'{self._where}: expected the same {field} names in every message but at '
                    f'stamp {_seconds(_stamp(message))} s they change from {_list(before)} to '
                    f'{_list(now)}; cut the bag there'
                )
        unique = getattr(message, self._unique)
        repeated = repeated_names(unique)
        if repeated:
            raise RunError(
                f'{self._where}: expected each {self._unique} name once but found '
                f'{", ".join(repeated)} more than once'
            )

    def series(self) -> TopicSeries:
        """Return all samples."""
        stamp = np.array(self._stamps, dtype=np.int64)
        backwards = np.flatnonzero(np.diff(stamp) <= 0)
        if len(backwards):
            at = int(backwards[0])
            raise RunError(
                f'{self._where}: expected increasing stamps but found '
                f'{_seconds(stamp[at + 1])} s after {_seconds(stamp[at])} s; the bag holds two '
                'runs, or two publishers'
            )
        names = tuple(tuple(entry) for entry in self._names)
        return TopicSeries(stamp, names, np.array(self._rows, dtype=np.float64))


class Displacements(SampleCollector):
    """The displacements of a topic as they come, each with the place where it was measured.

    Where places are told, an axis may be measured at one after the other: each place is a channel
    of its own, and a message may hold some of them only.
    """

    def __init__(self, path: Path, topic: str) -> None:
        super().__init__(path, topic, ('axis', 'channel'), 'channel')
        self._places: dict[tuple[str, float], int] = {}
        self._told: list[tuple[int, list[tuple[str, float]], NDArray[np.float64]]] = []

    def take(self, message: Any, values: NDArray[np.float64] | None = None) -> None:
        """Take a message, or values of it that are parallel to its displacements."""
        values = message.displacement if values is None else values
        position = np.asarray(message.position, dtype=np.float64)
        if not np.isfinite(position).any() and not self._told:
            self.add(message, values)
            return
        if self._stamps:
            raise RunError(
                f'{self._where}: expected a position in every message but at stamp '
                f'{_seconds(_stamp(message))} s they begin, or end; cut the bag there'
            )
        if not len(position) == len(message.axis) == len(values):
            raise BagDataError(
                f'{self._where}: expected {len(message.axis)} entries, one per axis, but found '
                f'{len(position)} at stamp {_seconds(_stamp(message))} s'
            )
        # NaN is no key; a place is one to the millimetre.
        keys = [
            (str(name), round(float(place), 3) + 0.0 if np.isfinite(place) else np.inf)
            for name, place in zip(message.axis, position, strict=True)
        ]
        for key in keys:
            self._places.setdefault(key, len(self._places))
        self._told.append((_stamp(message), keys, values))

    @property
    def position(self) -> NDArray[np.float64]:
        """Place of measurement of each column [m]; NaN where it is unknown."""
        if not self._told:
            return np.full(len(self._names[0]), np.nan)
        found = np.array([place for _, place in self._order])
        return np.where(np.isfinite(found), found, np.nan)

    @property
    def _order(self) -> list[tuple[str, float]]:
        """Axes and places, those of an axis from its low end on."""
        axes = list(dict.fromkeys(axis for axis, _ in self._places))
        return sorted(self._places, key=lambda key: (axes.index(key[0]), key[1]))

    def series(self) -> TopicSeries:
        """Return all samples."""
        if not self._told:
            return super().series()
        order = self._order
        axis = tuple(name for name, _ in order)
        self._names = [list(axis), list(place_channels(axis, self.position))]
        for stamp, keys, values in self._told:
            row = np.full(len(order), np.nan)
            row[[order.index(key) for key in keys]] = values
            self._stamps.append(stamp)
            self._rows.append(row)
        return super().series()


def speed_topics(reader: BagReader, machine: str) -> dict[str, str]:
    """Return the machine's topics that may tell the spindle speed, to the name of the source."""
    wanted = {_absolute(f'{machine}/{name}'): name for name in TOPICS}
    found = {}
    for topic, connection in reader.connections.items():
        name = wanted.get(_absolute(topic))
        if name and connection.type == TOPICS[name].TYPE and connection.message_count:
            found[topic] = name
    return found


def _absolute(topic: str) -> str:
    """Return a topic with one slash in front and between its parts."""
    return '/' + '/'.join(part for part in topic.split('/') if part)


def _join(stamp: NDArray[np.int64], moved: TopicSeries, average: bool) -> NDArray[np.float64]:
    """Return the displacement of each stamp: the newest, or the mean, since the stamp before."""
    last = np.searchsorted(moved.stamp, stamp, side='right')
    first = np.concatenate([[0], last[:-1]])
    joined = np.full((len(stamp), moved.values.shape[1]), np.nan)
    finite = np.isfinite(moved.values)
    if not average:
        row = np.where(finite, np.arange(len(finite))[:, np.newaxis], -1)
        # Channels may be probed one after the other.
        newest = np.maximum.accumulate(row)[np.maximum(last, 1) - 1]
        measured = (last > first)[:, np.newaxis] & (newest >= first[:, np.newaxis])
        values = np.take_along_axis(moved.values, np.maximum(newest, 0), axis=0)
        return np.where(measured, values, joined)
    zero = np.zeros((1, moved.values.shape[1]))
    total = np.concatenate([zero, np.cumsum(np.where(finite, moved.values, 0.0), axis=0)])
    count = np.concatenate([zero, np.cumsum(finite, axis=0)])
    number = count[last] - count[first]
    np.divide(total[last] - total[first], number, out=joined, where=number > 0)
    return joined


def _stamp(message: Any) -> int:
    return message.stamp if isinstance(message, Record) else stamp_of(message.header.stamp)


def _seconds(stamp: int) -> str:
    return f'{int(stamp) / 1e9:.9g}'


def _list(names: Sequence[str]) -> str:
    shown = ', '.join(names[:6])
    return f'[{shown}{", ..." if len(names) > 6 else ""}]'
