# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Measured, predicted and compensated errors of a shift, duty by duty."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.thermal.control_drives import drives_at, drives_told
from fuzzycnc_ros.components.thermal.predictor_stream import TOPICS as SPEED_TOPICS
from fuzzycnc_ros.components.thermal.predictor_stream import speed_told, speeds_at
from fuzzycnc_ros.components.thermal.sensor_substitution import RiseSource
from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.places import along_axes
from fuzzycnc_ros.core.thermal.run import ThermalDataError, ThermalRun
from fuzzycnc_ros.core.thermal.sensor_limits import JUDGED
from fuzzycnc_ros.runtime.enums import Status
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    Displacement,
    MachineState,
    Record,
    SensorSelection,
    SpindleSpeed,
    Temperatures,
    ThermalError,
    ThermalReference,
)
from fuzzycnc_ros.studies.record_log import RecordLog
from fuzzycnc_ros.studies.thermal.report_data import CompensationRun

Floats = NDArray[np.float64]


class ShiftLog(RecordLog):
    """The records of a shift by topic; a sink for `InProcessGraph`, or read from a bag."""

    TOPICS = MappingProxyType(
        {
            'machine_state': MachineState,
            'spindle_speed': SpindleSpeed,
            'temperatures': Temperatures,
            'thermal_reference': ThermalReference,
            'sensor_selection': SensorSelection,
            'displacement': Displacement,
            'thermal_error': ThermalError,
            'compensation': Compensation,
            'compensation_applied': CompensationApplied,
        }
    )
    REQUIRED = ('temperatures', 'displacement')

    def records(self, topic: str, start: int = 0, stop: int | None = None) -> list[Any]:
        """Return the records of a topic with `start` < stamp <= `stop` [ns]."""
        return self._between(topic, start + 1, None if stop is None else stop + 1)

    def spans(self) -> list[tuple[int, int]]:
        """Return the duties as machine time of their cold start and of their last state [ns]."""
        last: dict[int, int] = {}
        for state in self._records['machine_state']:
            last[state.cold_since] = state.stamp
        return sorted(last.items())

    def thermal_run(self, name: str, start: int = 0, stop: int | None = None) -> ThermalRun:
        """Return temperatures and displacements of a span as `bags.read_run` would.

        Raises
        ------
        ThermalDataError
            If there are too few samples or they are implausible.
        """
        samples = self.records('temperatures', start, stop)
        moved = self.records('displacement', start, stop)
        if not samples or not moved:
            raise ThermalDataError(
                f'run {name!r}: expected temperatures and displacements but found '
                f'{len(samples)} and {len(moved)} messages'
            )
        time = np.array([item.stamp - samples[0].stamp for item in samples]) / SECOND
        measured = _at_stamps(samples, moved, 'displacement', len(moved[0].channel))
        first = moved[0]
        axis, channel, along = along_axes(
            time, first.axis, first.channel, first.position, measured
        )
        return ThermalRun(
            name=name,
            time=time,
            sensor=samples[0].sensor,
            temperature=_temperature(samples),
            channel=channel,
            axis=axis,
            displacement=along,
            spindle_speed=self.spindle_speed(samples, start, stop),
            drives=self.drives(samples, start, stop),
            limits=JUDGED,
        )

    def drives(
        self, samples: Sequence[Temperatures], start: int = 0, stop: int | None = None
    ) -> dict[str, Floats]:
        """Return what else the control told of heat by each sample of a span."""
        told = []
        for item in self.records('machine_state', start, stop):
            found = drives_told(item)
            if found is not None:
                told.append((item.stamp, *found))
        return drives_at(np.array([item.stamp for item in samples]), told)

    def spindle_speed(
        self, samples: Sequence[Temperatures], start: int = 0, stop: int | None = None
    ) -> Floats | None:
        """Return the spindle speed [rad/s] that was known at each sample of a span, if any was."""
        told = [
            (topic, item.stamp, speed_told(topic, item))
            for topic in SPEED_TOPICS
            for item in self.records(topic, start, stop)
        ]
        return speeds_at(np.array([item.stamp for item in samples]), told)


def compensation_runs(
    log: ShiftLog, model: ThermalModel, names: Sequence[str], *, offset_max: float
) -> tuple[CompensationRun, ...]:
    """Judge every duty of a shift: all candidates of the model beside what really happened.

    Parameters
    ----------
    log : ShiftLog
        What was published.
    model : ThermalModel
        Model that predicted.
    names : sequence of str
        Names of the duties, in their order.
    offset_max : float
        Size limit of the compensator [m].

    Returns
    -------
    tuple of CompensationRun
        One per duty, a row per temperature sample.  The prediction `default` is the one that
        was published; the candidates are run over the same rises that the predictor read, with
        its substitutes for lost sensors.

    Raises
    ------
    ValueError
        If the number of duties differs from that of the names, or a duty has no samples.
    """
    spans = log.spans()
    if len(spans) != len(names):
        raise ValueError(
            f'names: expected {len(spans)} duties as machine_state tells them apart but found '
            f'{", ".join(names)}'
        )
    return tuple(
        _compensation_run(log, model, name, span, offset_max)
        for name, span in zip(names, spans, strict=True)
    )


def _compensation_run(
    log: ShiftLog, model: ThermalModel, name: str, span: tuple[int, int], offset_max: float
) -> CompensationRun:
    start, _ = span
    recorded = log.thermal_run(name, *span)
    samples: list[Temperatures] = log.records('temperatures', *span)
    errors: list[ThermalError] = log.records('thermal_error', *span)
    rise, known = _rises(log, model, samples, errors, span)
    rise = np.hstack([rise, model.drives(recorded)])
    size = len(model.channel)
    predicted = {}
    for candidate in model.candidates_on(recorded):
        if candidate == UNCOMPENSATED:
            continue  # the page has it as what was measured, known or not
        with np.errstate(over='ignore', invalid='ignore'):
            values = model.predict(rise, candidate)
        predicted[candidate] = np.where(known[:, np.newaxis], values, np.nan)
    valid = [item for item in errors if item.valid]
    predicted[DEFAULT] = _at_stamps(samples, valid, 'error', size)
    in_domain = {item.stamp: item.in_domain for item in errors}
    place = {sensor: index for index, sensor in enumerate(recorded.sensor)}
    cluster = np.full(len(recorded.sensor), -1)
    for label, item in enumerate(model.selection.clusters):
        cluster[[place[member] for member in item.member]] = label
    columns = [recorded.channel.index(channel) for channel in model.channel]
    return CompensationRun(
        name=name,
        time=np.array([item.stamp - start for item in samples]) / SECOND,
        sensor=recorded.sensor,
        temperature=recorded.temperature,
        cluster=tuple(cluster.tolist()),
        chosen=model.inputs,
        channel=model.channel,
        measured=recorded.displacement[:, columns],
        predicted=predicted,
        default=DEFAULT,
        standard_deviation=_at_stamps(samples, errors, 'standard_deviation', size),
        in_domain=np.array([in_domain.get(item.stamp, False) for item in samples]),
        offset=offsets_of(samples, log.records('compensation', *span), model.axis),
        applied=offsets_of(samples, log.records('compensation_applied', *span), model.axis),
        offset_limit=offset_max,
        spindle_speed=recorded.spindle_speed,
    )


def _temperature(samples: Sequence[Temperatures]) -> Floats:
    temperature = np.array([item.temperature for item in samples])
    temperature[np.array([item.status for item in samples]) != Status.OK] = np.nan
    return temperature


def _rises(
    log: ShiftLog,
    model: ThermalModel,
    samples: Sequence[Temperatures],
    errors: Sequence[ThermalError],
    span: tuple[int, int],
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the rises (n, p) [K] that the predictor read, and which of them are known."""
    references: list[ThermalReference] = log.records('thermal_reference', *span)
    rise = np.zeros((len(samples), len(model.inputs)))
    known = np.zeros(len(samples), np.bool_)
    if not references:
        return rise, known
    selections: list[SensorSelection] = log.records('sensor_selection', -1, span[1])
    selection = selections[-1] if selections else None
    source = RiseSource(model, samples[0].sensor, references[0], selection)
    substituted = {item.stamp: item.substituted for item in errors}
    for row, sample in enumerate(samples):
        # What the predictor found to be faulty is as good as not read.
        faulty = np.isin(sample.sensor, substituted.get(sample.stamp, ()))
        found = source.rise(sample.temperature, (sample.status == Status.OK) & ~faulty)
        known[row] = found is not None
        # Where nothing is known the models are held, not fed with a guess.
        rise[row] = found if found is not None else rise[max(row - 1, 0)]
    return rise, known


def _at_stamps(samples: Sequence[Record], records: Sequence[Any], field: str, size: int) -> Floats:
    """Return a field of the records with the samples' stamps, shape (n, size); else NaN."""
    by_stamp = {item.stamp: getattr(item, field) for item in records}
    nothing = np.full(size, np.nan)
    return np.array([by_stamp.get(item.stamp, nothing) for item in samples])


def _newest(samples: Sequence[Record], records: Sequence[Any]) -> list[Any]:
    """Return the newest record at each sample, the first one before there is any."""
    stamps = np.array([item.stamp for item in records])
    order = np.argsort(stamps, kind='stable')
    at = np.searchsorted(stamps[order], [item.stamp for item in samples], side='right') - 1
    return [records[order[max(index, 0)]] for index in at]


def offsets_of(samples: Sequence[Record], records: Sequence[Any], axes: Sequence[str]) -> Floats:
    """Return the newest offset of each axis at each sample, shape (n, axes) [m]; else NaN."""
    if not records:
        return np.full((len(samples), len(axes)), np.nan)
    rows = []
    for record in _newest(samples, records):
        by_axis = dict(zip(record.axis, record.offset.tolist(), strict=True))
        rows.append([by_axis.get(axis, np.nan) for axis in axes])
    return np.array(rows)
