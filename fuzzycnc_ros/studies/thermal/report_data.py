# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Data of a report: arrays of compensation runs, curves, latencies, facts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.studies.page.document import shown_as
from fuzzycnc_ros.studies.page.html import Remark, Section

APPLIED = 'applied'
"""Name under which the error left by the offsets in force is scored."""


class ReportDataError(ValueError):
    """The arrays of a report do not fit together; the message names the array."""


@dataclass(frozen=True)
class Score:
    """Size of a residual: largest and root mean square [m]; inf if it diverged."""

    max: float = field(metadata=shown_as('max_um', 1e6))
    rms: float = field(metadata=shown_as('rms_um', 1e6))

    @classmethod
    def of(cls, residual: NDArray[np.float64], measured: NDArray[np.float64]) -> 'Score':
        """Score a residual [m] where something was measured; both of shape (n,).

        A NaN in the residual means that nothing was predicted there: it is not judged.  An
        infinity is: the score is infinite.  Where nothing is left to judge both are NaN.
        """
        judged = residual[np.isfinite(measured) & ~np.isnan(residual)]
        if not judged.size:
            return cls(np.nan, np.nan)
        if not np.isfinite(judged).all():
            return cls(np.inf, np.inf)
        # A diverged prediction may be finite and still too large to square.
        largest = float(np.abs(judged).max())
        scale = largest or 1.0
        return cls(largest, scale * float(np.sqrt(np.mean((judged / scale) ** 2))))


@dataclass(frozen=True, eq=False)
class CompensationRun:
    """One run: temperatures, measured and predicted error, and what was compensated.

    Parameters
    ----------
    name : str
        Name of the run.
    time : array_like, shape (n,)
        Time of each row [s], increasing; plots count from the first one.
    sensor : sequence of str, length s
        Names of the temperature sensors.
    temperature : array_like, shape (n, s)
        Temperatures [degC]; NaN leaves a gap.
    cluster : sequence of int, length s
        Cluster of each sensor, counted from 0; -1 for a sensor that was left out.
    chosen : sequence of str
        Sensors that the model reads.
    channel : sequence of str, length c
        Measured channels: axis names, or names of probes.
    measured : array_like, shape (n, c)
        Thermal error without compensation, actual minus nominal [m]; NaN: not measured.
    predicted : mapping of str to array_like, shape (n, c)
        Error predicted by each candidate [m], in the order of tables; NaN: no prediction.
    default : str or sequence of str, length c
        Candidate that the compensation used, for all channels or for each; drawn in front.
    standard_deviation : array_like, shape (n, c), optional
        One standard deviation of the prediction in use [m].
    in_domain : array_like of bool, shape (n,), optional
        Whether the rises lay within the training domain.
    offset, applied : array_like, shape (n, c), optional
        Offset commanded, and offset in force on the machine [m].
    offset_limit : float, optional
        Size limit of the offsets [m].
    spindle_speed : array_like, shape (n,), optional
        Spindle speed [rad/s].

    Raises
    ------
    ReportDataError
        If an array has another shape, a name is unknown, or time does not increase.
    """

    name: str
    time: NDArray[np.float64]
    sensor: tuple[str, ...]
    temperature: NDArray[np.float64]
    cluster: tuple[int, ...]
    chosen: tuple[str, ...]
    channel: tuple[str, ...]
    measured: NDArray[np.float64]
    predicted: Mapping[str, NDArray[np.float64]]
    default: str | tuple[str, ...]
    standard_deviation: NDArray[np.float64] | None = None
    in_domain: NDArray[np.bool_] | None = None
    offset: NDArray[np.float64] | None = None
    applied: NDArray[np.float64] | None = None
    offset_limit: float | None = None
    spindle_speed: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Turn sequences into tuples and arrays, and check that they fit together."""
        for name in ('sensor', 'chosen', 'channel'):
            object.__setattr__(self, name, tuple(str(item) for item in getattr(self, name)))
        object.__setattr__(self, 'cluster', tuple(int(label) for label in self.cluster))
        if isinstance(self.default, str):
            object.__setattr__(self, 'default', (self.default,) * len(self.channel))
        object.__setattr__(self, 'default', tuple(self.default))
        time = np.asarray(self.time, dtype=np.float64)
        object.__setattr__(self, 'time', time)
        if time.ndim != 1 or len(time) < 2 or not np.all(np.diff(time) > 0.0):
            raise ReportDataError(
                f'run {self.name}: expected two or more increasing times but found '
                f'shape {time.shape}'
            )
        rows, channels = len(time), len(self.channel)
        self._fit('temperature', (rows, len(self.sensor)))
        self._fit('measured', (rows, channels))
        for name in ('standard_deviation', 'offset', 'applied'):
            self._fit(name, (rows, channels))
        self._fit('in_domain', (rows,), dtype=np.bool_)
        self._fit('spindle_speed', (rows,))
        predicted = {
            str(key): self._fitted(f'predicted[{key!r}]', values, (rows, channels))
            for key, values in self.predicted.items()
        }
        object.__setattr__(self, 'predicted', predicted)
        self._check_names()

    def _fit(
        self, name: str, shape: tuple[int, ...], dtype: type[np.generic] = np.float64
    ) -> None:
        values = getattr(self, name)
        if values is not None:
            object.__setattr__(self, name, self._fitted(name, values, shape, dtype))

    def _fitted(
        self,
        name: str,
        values: ArrayLike,
        shape: tuple[int, ...],
        dtype: type[np.generic] = np.float64,
    ) -> NDArray[np.generic]:
        array = np.asarray(values, dtype=dtype)
        if array.shape != shape:
            raise ReportDataError(
                f'run {self.name}: expected {name} of shape {shape} but found {array.shape}'
            )
        return array

    def _check_names(self) -> None:
        if len(self.cluster) != len(self.sensor):
            raise ReportDataError(
                f'run {self.name}: expected cluster of {len(self.sensor)} labels, one per '
                f'sensor, but found {len(self.cluster)}'
            )
        unknown = [name for name in self.chosen if name not in self.sensor]
        if unknown:
            raise ReportDataError(
                f'run {self.name}: expected chosen sensors among those recorded but found '
                f'{", ".join(unknown)}'
            )
        if len(self.default) != len(self.channel):
            raise ReportDataError(
                f'run {self.name}: expected default of one name or {len(self.channel)}, one per '
                f'channel, but found {len(self.default)}'
            )
        unknown = [name for name in self.default if name not in self.predicted]
        if unknown:
            raise ReportDataError(
                f'run {self.name}: expected default among {", ".join(self.predicted)} '
                f'but found {", ".join(unknown)}'
            )

    def prediction(self) -> NDArray[np.float64]:
        """Return the error predicted by the candidate in use, shape (n, c) [m]."""
        columns = [self.predicted[name][:, c] for c, name in enumerate(self.default)]
        return np.stack(columns, axis=1)

    def residual(self) -> NDArray[np.float64]:
        """Return the error that is left, shape (n, c) [m].

        Measured plus the offset in force; without one, measured minus predicted.
        """
        if self.applied is not None:
            return self.measured + self.applied
        return self.measured - self.prediction()

    def scores(self) -> dict[str, tuple[Score, ...]]:
        """Score every candidate, each a score per channel, uncompensated first.

        Where the run has offsets in force, the error they leave comes last as `applied`.
        """
        left = {UNCOMPENSATED: self.measured}
        left.update({name: self.measured - values for name, values in self.predicted.items()})
        if self.applied is not None:
            left[APPLIED] = self.measured + self.applied
        return {name: self._score(residual) for name, residual in left.items()}

    def scores_in_use(self) -> tuple[Score, ...]:
        """Score `residual`, per channel."""
        return self._score(self.residual())

    def _score(self, residual: NDArray[np.float64]) -> tuple[Score, ...]:
        return tuple(
            Score.of(residual[:, c], self.measured[:, c]) for c in range(len(self.channel))
        )


@dataclass(frozen=True, eq=False)
class SensorCountCurve:
    """Largest residual against the number of sensors.

    Parameters
    ----------
    count : sequence of int, length k
        Numbers of sensors, increasing.
    channel : sequence of str, length c
        Measured channels.
    residual_max : array_like, shape (k, c)
        Largest residual on the held-out run [m]; NaN where a channel has no model.
    run : str
        Name of the held-out run.
    model : str
        Which model that is, for people.
    chosen_count : int, optional
        Number of sensors in use; marked in the plot.
    """

    count: tuple[int, ...]
    channel: tuple[str, ...]
    residual_max: NDArray[np.float64]
    run: str
    model: str
    chosen_count: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'count', tuple(int(item) for item in self.count))
        object.__setattr__(self, 'channel', tuple(self.channel))
        values = np.asarray(self.residual_max, dtype=np.float64)
        object.__setattr__(self, 'residual_max', values)
        shape = (len(self.count), len(self.channel))
        if values.shape != shape:
            raise ReportDataError(
                f'sensor count curve: expected residual_max of shape {shape} '
                f'but found {values.shape}'
            )


@dataclass(frozen=True, eq=False)
class Latency:
    """Time from a temperature sample to its compensation, shape (n,) [s], wall clock."""

    sample: NDArray[np.float64]

    def __post_init__(self) -> None:
        values = np.asarray(self.sample, dtype=np.float64)
        object.__setattr__(self, 'sample', values)
        if values.ndim != 1 or not values.size or not np.isfinite(values).all():
            raise ReportDataError(
                f'latency: expected one or more finite times but found shape {values.shape}'
            )

    @property
    def median(self) -> float:
        """Median [s]."""
        return float(np.median(self.sample))

    @property
    def p99(self) -> float:
        """99th percentile [s]."""
        return float(np.percentile(self.sample, 99.0))


@dataclass(frozen=True, eq=False)
class ReportData:
    """Everything on one page.

    Parameters
    ----------
    title : str
        Headline.
    runs : sequence of CompensationRun
        Held-out runs, at least one.
    summary : str
        One or two sentences under the headline.
    sensor_count_curve : SensorCountCurve, optional
        Residual against the number of sensors.
    latency : Latency, optional
        Temperature to compensation.
    judged : sequence of Remark
        What was judged, whether it was trained on, and what of it calls for attention.
    facts : mapping of str to str
        Provenance: training runs, seed, model hash, versions, ...; shown as a table.
    notes : sequence of str
        Remarks for the reader, one paragraph each.
    sections : sequence of Section
        Further parts of the page, behind those on the runs.
    """

    title: str
    runs: Sequence[CompensationRun]
    summary: str = ''
    sensor_count_curve: SensorCountCurve | None = None
    latency: Latency | None = None
    judged: Sequence[Remark] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    sections: Sequence[Section] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, 'runs', tuple(self.runs))
        if not self.runs:
            raise ReportDataError('runs: expected at least one run but found none')
        names = [run.name for run in self.runs]
        if len(set(names)) != len(names):
            raise ReportDataError(f'runs: expected each name once but found {", ".join(names)}')
