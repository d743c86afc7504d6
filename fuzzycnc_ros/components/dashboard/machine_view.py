# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The state of one machine as a person needs it, from what its nodes publish.

It is pure: records, reports of nodes and the time go in, a document for JSON comes out.  Two times
are told apart: stamps are machine time, `now` is the time of the one who watches [s], of a clock
that does not step; a simulated machine may run at any speed against it.
"""

import json
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from math import hypot, isfinite
from statistics import median
from typing import Any

from fuzzycnc_ros.components.dashboard.equipment import (
    feeds_document,
    probing_document,
    servo_document,
    soft_document,
)
from fuzzycnc_ros.components.dashboard.history import History
from fuzzycnc_ros.components.dashboard.node_report import NodeReport
from fuzzycnc_ros.components.dashboard.trend import Trend
from fuzzycnc_ros.components.dashboard.values import finite, number, value_of, word
from fuzzycnc_ros.core.inputs.lines import read_travel
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.runtime.component import Health, Level
from fuzzycnc_ros.runtime.enums import CompensationState, MachineMode, Reason, SpeedStatus, Status
from fuzzycnc_ros.runtime.host import FINALIZED, WAS_FINALIZED, NodeConfiguration
from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensatedPath,
    Compensation,
    CompensationApplied,
    Displacement,
    FeedSchedule,
    MachineState,
    PredictorState,
    ProbeCycleState,
    ProbeStatus,
    Record,
    SensorSelection,
    ServoState,
    SpindleSpeed,
    Temperatures,
    ThermalError,
    ThermalReference,
    TrajectoryState,
)

SOURCES: Mapping[str, type[Record]] = {
    'temperatures': Temperatures,
    'thermal_error': ThermalError,
    'compensation': Compensation,
    'compensation_applied': CompensationApplied,
    'machine_state': MachineState,
    'displacement': Displacement,
    'sensor_selection': SensorSelection,
    'thermal_reference': ThermalReference,
    'predictor_state': PredictorState,
    'probe_status': ProbeStatus,
    'probe_cycle_state': ProbeCycleState,
    'spindle_speed': SpindleSpeed,
    'feed_schedule': FeedSchedule,
    'trajectory_state': TrajectoryState,
    'servo_state': ServoState,
    'axis_state': AxisState,
    'compensated_path': CompensatedPath,
}
"""Topics that a view is made of, and their records."""
PULSE = ('temperatures', 'thermal_error', 'compensation_applied', 'machine_state')
"""Topics that come all the time: their silence is that of the machine."""
DATA = ('temperatures', 'thermal_error', 'compensation')
"""Topics whose records are what people wait to see."""
SILENT = 2.0
"""Time [s] without a word from anybody after which a machine is silent: nodes report once a
second."""
LATE_FACTOR = 3.0
"""Data that come slowly are late after so many of their own intervals."""
SIMULATED = frozenset({'simulated_machine', 'simulated_body', 'player'})
"""Nodes that play a machine."""
PROBE_CHANNELS_MAX = 100
"""Channels of a probe that are shown."""

_STATUS_WORDS = {
    Status.MISSING: 'no reading',
    Status.OUT_OF_RANGE: 'out of range',
    Status.RATE: 'moves faster than metal can',
    Status.STUCK: 'stuck',
    Status.DRIFT: 'drifts away from its mates',
}
_STATE_WORDS = {
    CompensationState.INACTIVE: 'the compensator is not activated',
    CompensationState.ACTIVE: 'offsets follow the predicted error',
    CompensationState.HOLDING: 'the predicted error is of no use now: offsets are held',
    CompensationState.RAMPING: 'offsets go to zero',
    CompensationState.EXPIRED: 'offsets are at zero until the predicted error is of use',
}
_IN_FORCE = frozenset(
    {CompensationState.ACTIVE, CompensationState.HOLDING, CompensationState.RAMPING}
)
"""States in which offsets of the compensator are in force, if the machine agrees."""


@dataclass
class _Reception:
    """Times at which a topic was received.

    Attributes
    ----------
    at : float
        Time of the newest message [s].
    gaps : list of float
        The newest gaps between messages [s].
    """

    at: float
    gaps: list[float] = field(default_factory=list)

    def again(self, now: float) -> None:
        """Note another message."""
        self.gaps = [*self.gaps[-8:], now - self.at]
        self.at = now

    def late(self, now: float) -> bool:
        """Return True if nothing came for much longer than usual."""
        usual = median(self.gaps) if self.gaps else 0.0
        return now - self.at > max(SILENT, LATE_FACTOR * usual)


class MachineView:
    """Put together what the nodes of one machine say.

    Parameters
    ----------
    machine : str
        Its name, the namespace of its nodes.
    history : History, optional
        Where the series go; its own if left out.
    """

    def __init__(self, machine: str, history: History | None = None) -> None:
        self.machine = machine
        self.history = History() if history is None else history
        self._newest: dict[str, Any] = {}
        self._heard: dict[str, _Reception] = {}
        self._nodes: dict[str, NodeReport] = {}
        self._stamp: int | None = None
        self._sequence = 0
        self.news = 0
        """Number of records of `DATA` so far."""
        self._model: dict[str, Any] | None = None
        self._model_clusters: list[dict[str, Any]] = []
        self._model_hash = ''
        self._trends: dict[str, Trend] = {}
        self._approaches: dict[str, Trend] = {}
        self._probes: dict[str, tuple[int, float, float | None]] = {}
        self._since: dict[tuple[str, str], float | None] = {}
        self._bag: str | None = None
        self._takers: dict[type[Record], Callable[[Any], None]] = {
            Temperatures: self._on_temperatures,
            ThermalError: self._on_thermal_error,
            Compensation: self._on_compensation,
            CompensationApplied: self._on_applied,
            Displacement: self._on_displacement,
            AxisState: self._on_axis_state,
        }

    # What comes in.

    def take(self, topic: str, record: Record, now: float) -> None:
        """Take a record of one of `SOURCES`."""
        before = self._newest.get(topic)
        if topic in PULSE and before is not None and record.stamp < before.stamp:
            self._begin_anew(record.stamp)
        self._newest[topic] = record
        self.note(topic, now)
        self.news += topic in DATA
        if topic in PULSE:
            self._stamp = record.stamp if self._stamp is None else max(self._stamp, record.stamp)
        take = self._takers.get(type(record))
        if take is not None:
            take(record)

    def note(self, topic: str, now: float) -> None:
        """Note that something came on a topic, whether or not it is looked at."""
        known = self._heard.get(topic)
        if known is None:
            self._heard[topic] = _Reception(now)
        elif now > known.at:
            known.again(now)

    def take_health(self, node: str, items: Iterable[Health], now: float) -> None:
        """Take what a node reports on /diagnostics."""
        report = self._nodes.setdefault(node, NodeReport())
        report.heard_at, report.items = now, tuple(items)
        report.ended = False

    def take_configuration(self, configuration: NodeConfiguration) -> None:
        """Take what a node runs with."""
        report = self._nodes.setdefault(configuration.node, NodeReport())
        report.configuration = configuration
        report.parameters = _object(configuration.parameters)
        if configuration.model_hash and configuration.model_hash != self._model_hash:
            self._model_hash = configuration.model_hash
            document = _object(configuration.model)
            self._model = _model_facts(document, configuration, report.parameters)
            self._model_clusters = _model_clusters(document)

    def set_nodes(self, present: Collection[str], ended: Collection[str]) -> None:
        """Say which nodes are in the graph, and which of all have ended for sure."""
        for name in present:
            self._nodes.setdefault(name, NodeReport())
        for name, report in self._nodes.items():
            report.ended = name in ended

    def set_recording(self, bag: str | None) -> None:
        """Say which bag is recorded from here; None if none is."""
        self._bag = bag

    # What goes out.

    @property
    def stamp(self) -> int | None:
        """Newest machine time [ns]; None before the first record."""
        return self._stamp

    @property
    def _told(self) -> dict[str, NodeReport]:
        return {name: report for name, report in self._nodes.items() if report.told}

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of all nodes that have said anything."""
        return tuple(self._told)

    @property
    def living_nodes(self) -> tuple[str, ...]:
        """Names of those that have not ended."""
        return tuple(name for name, report in self._told.items() if not report.ended)

    @property
    def complete(self) -> bool:
        """True if all nodes that live have reported, and there are data."""
        living = [report for report in self._told.values() if not report.ended]
        told = all(report.heard_at is not None for report in living)
        return bool(living) and told and self._stamp is not None

    def quiet_for(self, now: float) -> float:
        """Return for how long nothing was heard of the machine or its nodes [s]."""
        heard = [item.at for item in self._heard.values()]
        heard += [r.heard_at for r in self._nodes.values() if r.heard_at is not None]
        return now - max(heard) if heard else 0.0

    def key(self, now: float) -> object:
        """Return what is told at once when it changes, to be compared with that of before."""
        told, applied = self._newest.get('compensation'), self._newest.get('compensation_applied')
        machine = self._newest.get('machine_state')
        return (
            None if told is None else (told.state, told.at_limit.tobytes()),
            None if applied is None else (applied.status, applied.at_limit.tobytes()),
            None if machine is None else (machine.state, machine.homed, machine.offsets_allowed),
            self._bag,
            bool(self._silence(now)),
            tuple(
                (
                    *(name, report.ended, report.silent(now), report.lifecycle),
                    *((item.name, item.level) for item in report.items if item.level),
                )
                for name, report in self._told.items()
            ),
        )

    def newest(self, topic: str) -> Any:
        """Return the newest record of a topic, None if there is none."""
        return self._newest.get(topic)

    def parameter(self, node: str, name: str) -> Any:
        """Return a parameter of a node as it has told it, None if it has not."""
        report = self._nodes.get(node)
        return None if report is None else report.parameters.get(name)

    def document(self, now: float) -> dict[str, Any]:
        """Return the view, with values that JSON can hold: unknown ones are None."""
        self._sequence += 1
        return {
            'machine': self.machine,
            'sequence': self._sequence,
            'stamp': None if self._stamp is None else self._stamp / SECOND,
            'age': self._age(now),
            'simulated': bool(SIMULATED & self._nodes.keys()),
            'silent': self._silence(now),
            'state': self._state(),
            'axes': self._axes(),
            'spindle': self._spindle(),
            'sensors': self._sensors(),
            'model': self._model_document(),
            'nodes': [report.document(name, now) for name, report in sorted(self._told.items())],
            'alarms': self._alarms(now),
            'recording': self._recording(now),
            'feeds': feeds_document(
                self._newest.get('feed_schedule'), self._newest.get('trajectory_state')
            ),
            'servo': servo_document(
                self._newest.get('servo_state'), self._newest.get('axis_state')
            ),
            'soft': soft_document(self._newest.get('compensated_path')),
            'probing': probing_document(
                self._newest.get('probe_status'),
                self._newest.get('probe_cycle_state'),
                self._stamp,
            ),
        }

    # Records.

    def _begin_anew(self, stamp: int) -> None:
        """Forget by stamps of before what a clock that was set, or a new run, makes void."""
        self._stamp = stamp
        self.history.clear()
        self._trends, self._approaches, self._probes = {}, {}, {}
        self._since = {}
        self._newest = {
            topic: record for topic, record in self._newest.items() if topic not in PULSE
        }

    def _on_temperatures(self, record: Temperatures) -> None:
        error = self._newest.get('thermal_error')
        substituted = set() if error is None else {*error.substituted}
        bad = {name for name, status in zip(record.sensor, record.status, strict=False) if status}
        values = zip(map(visible, record.sensor), record.temperature.tolist(), strict=False)
        marked = frozenset(map(visible, substituted | bad))
        self.history['temperatures'].add(record.stamp, dict(values), marked)

    def _on_thermal_error(self, record: ThermalError) -> None:
        row = {}
        rows = zip(
            record.axis, record.channel, record.error, record.standard_deviation, strict=False
        )
        for axis, channel, error, deviation in rows:
            name = visible(channel)
            row[f'{name} predicted'] = float(error)
            row[f'{name} band'] = 2.0 * float(deviation)
            self._approaches.setdefault(axis, Trend())
        for axis, approach in self._approaches.items():
            place = record.axis.index(axis) if axis in record.axis else None
            if place is not None:
                approach.add(record.stamp, float(record.error[place]))
        self.history['error'].add(record.stamp, row)

    def _on_compensation(self, record: Compensation) -> None:
        self._keep_offsets(record.stamp)

    def _on_applied(self, record: CompensationApplied) -> None:
        for axis, offset in zip(record.axis, record.offset.tolist(), strict=False):
            self._trends.setdefault(axis, Trend()).add(record.stamp, offset)
        self._keep_offsets(record.stamp)

    def _keep_offsets(self, stamp: int) -> None:
        """Keep what is asked for and what is in force: both hold until they change."""
        row = {}
        for topic, what in (('compensation', 'requested'), ('compensation_applied', 'applied')):
            newest = self._newest.get(topic)
            if newest is None:
                continue
            for axis, offset in zip(newest.axis, newest.offset.tolist(), strict=False):
                row[f'{visible(axis)} {what}'] = offset
                if self._limit is not None:
                    row[f'{visible(axis)} limit'] = self._limit
        self.history['compensation'].add(stamp, row)

    def _on_displacement(self, record: Displacement) -> None:
        error = self._newest.get('thermal_error')
        applied = self._newest.get('compensation_applied')
        row = {}
        measured = list(
            zip(record.channel, record.axis, record.displacement.tolist(), strict=False)
        )
        for channel, axis, value in measured[:PROBE_CHANNELS_MAX]:
            if not isfinite(value):
                continue
            expected = None if error is None else value_of(error.channel, error.error, channel)
            offset = None
            if record.includes_compensation and applied is not None:
                offset = value_of(applied.axis, applied.offset, axis)
            name = visible(channel)
            # beside the predicted error, which the offset takes off
            row[f'{name} probed'] = value - (offset or 0.0)
            if expected is not None:
                expected = expected + (offset or 0.0)
                row[f'{name} residual'] = value - expected
            if channel == axis or axis not in record.channel:
                self._probes[axis] = (record.stamp, value, expected)
        self.history['error'].add(record.stamp, row)

    def _on_axis_state(self, record: AxisState) -> None:
        row = {}
        for axis, wanted, place in zip(
            record.axis, record.reference, record.position, strict=False
        ):
            row[f'{visible(axis)} position'] = float(place)
            row[f'{visible(axis)} following'] = float(wanted) - float(place)
        self.history['axes'].add(record.stamp, row)

    def _items(self, node: str) -> tuple[Health, ...]:
        """Return the newest health of a node; nothing if it has told none."""
        report = self._nodes.get(node)
        return () if report is None else report.items

    def _said(self, node: str, name: str) -> str:
        """Return the text of an item of a node's health; empty if there is none."""
        return next((item.message for item in self._items(node) if item.name == name), '')

    # Parts of the document.

    def _age(self, now: float) -> float | None:
        heard = [self._heard[topic].at for topic in PULSE if topic in self._heard]
        return max(0.0, now - max(heard)) if heard else None

    def _silence(self, now: float) -> str:
        """Say that there are no data, for how long and why; empty while they come."""
        told = self._told
        ended = sorted(name for name, report in told.items() if report.ended)
        alive = [
            name
            for name, report in told.items()
            if not report.ended and (report.heard_at is None or now - report.heard_at < SILENT)
        ]
        age = self._age(now)
        since = 'no data yet' if age is None else f'no data for {max(age, 1.0):.0f} s'
        if told and not alive:
            if ended:
                return (
                    f'{since}: the nodes of /{self.machine} have ended; start them again with '
                    'fuzzycnc up'
                )
            return (
                f'{since}: no node of /{self.machine} reports any more; look at the computer and '
                'the network that they run on'
            )
        pulse = [self._heard[topic] for topic in PULSE if topic in self._heard]
        if not pulse:
            return f'{since}: nodes are there, but no temperatures and no machine state come'
        if all(heard.late(now) for heard in pulse):
            why = next(
                (f'{name}: {item.message}' for name, item in self._troubles(ended)),
                'the machine, or what reads it, is silent',
            )
            return f'{since}: {visible(why)}'
        return ''

    def _troubles(self, ended: Collection[str]) -> list[tuple[str, Health]]:
        """Return what nodes that live are troubled by, the worst first."""
        found = [
            (name, item)
            for name, report in self._told.items()
            if name not in ended
            for item in report.items
            if item.level > Level.OK
        ]
        return sorted(found, key=lambda entry: -entry[1].level)

    def _state(self) -> dict[str, Any]:
        told = self._newest.get('compensation')
        machine = self._newest.get('machine_state')
        report = self._nodes.get('compensator')
        state, why = 'absent', 'no compensator is in the graph; start one with fuzzycnc up'
        if report is not None and report.ended:
            why = 'the compensator has ended; the machine goes to zero by itself'
        elif report is not None:
            said, _, reason = self._said('compensator', 'state').partition(': ')
            states = {item.name.lower(): item for item in CompensationState}
            known = states.get(said, CompensationState.INACTIVE) if told is None else told.state
            state = word(CompensationState, known)
            why = visible(reason) if reason and said == state else _STATE_WORDS.get(known, state)
            if report.lifecycle == FINALIZED:
                why = f'the compensator {WAS_FINALIZED}'
            if known in _IN_FORCE:
                state, why = self._in_force(state, why)
        applied = self._newest.get('compensation_applied')
        if state != 'refused' and applied is not None and applied.status == OffsetStatus.REFUSED:
            why += f'; the machine refuses offsets: {visible(applied.reason)}'
        mode = 'unknown'
        if machine is not None:
            mode = {
                MachineMode.OFF: 'off',
                MachineMode.ESTOP: 'e-stop',
                MachineMode.ON: 'homed' if machine.homed else 'on, not homed',
                MachineMode.RUNNING: 'running',
                MachineMode.FAULT: 'fault',
            }.get(machine.state, 'unknown')
        return {
            'compensation': state,
            'why': why,
            'machine': mode,
            'offsets_allowed': bool(machine is not None and machine.offsets_allowed),
        }

    def _in_force(self, state: str, why: str) -> tuple[str, str]:
        """Return state and reason of a compensator at work, as the machine side sees it.

        One that hangs has told nothing else: what it told last is no longer true then.
        """
        told, applied = self._newest.get('compensation'), self._newest.get('compensation_applied')
        if applied is not None and applied.status == OffsetStatus.REFUSED:
            return 'refused', f'the machine refuses offsets: {visible(applied.reason)}'
        out_of_date = (
            told is not None and self._stamp is not None and (self._stamp > told.valid_until)
        )
        if out_of_date or (applied is not None and applied.status == OffsetStatus.EXPIRED):
            return 'expired', 'no command of the compensator is in force: the machine goes to zero'
        return state, why

    @property
    def _limit(self) -> float | None:
        """Largest offset that the compensator gives [m], as it has told."""
        limit = self.parameter('compensator', 'offset_max')
        known = isinstance(limit, (int, float)) and isfinite(limit) and limit > 0.0
        return float(limit) if known else None

    def _axes(self) -> list[dict[str, Any]]:
        told = self._newest.get('compensation')
        applied = self._newest.get('compensation_applied')
        error = self._newest.get('thermal_error')
        named = [*(told.axis if told is not None else ())]
        for record in (applied, error):
            named += [axis for axis in (record.axis if record is not None else ())]
        return [self._axis(axis, told, applied, error) for axis in dict.fromkeys(named)]

    def _axis(self, axis: str, told: Any, applied: Any, error: Any) -> dict[str, Any]:
        limit = self._limit
        offset = None if applied is None else value_of(applied.axis, applied.offset, axis)
        requested = None if told is None else value_of(told.axis, told.offset, axis)
        shown = requested if offset is None else offset
        limited = []
        if told is not None and axis in told.axis:
            place = told.axis.index(axis)
            limited += ['clamp'] if told.at_limit[place] else []
            limited += ['slew'] if told.slewing[place] else []
        if applied is not None and axis in applied.axis:
            limited += ['machine'] if applied.at_limit[applied.axis.index(axis)] else []
        predicted = deviation = None
        if error is not None and error.valid:
            predicted = value_of(error.axis, error.error, axis)
            deviation = value_of(error.axis, error.standard_deviation, axis)
        trend, approach = self._trends.get(axis), self._approaches.get(axis)
        arrow = 'steady' if trend is None else trend.arrow
        stable_in = None if approach is None else approach.stable_in
        if stable_in == 0.0 and arrow != 'steady':
            stable_in = None  # what moves is not stable, however near its end the curve says it is
        probe = self._probes.get(axis)
        return {
            'axis': visible(axis),
            'offset': offset,
            'requested': requested,
            'slope': None if told is None else value_of(told.axis, told.slope, axis),
            'reference_position': (
                None if told is None else value_of(told.axis, told.reference_position, axis)
            ),
            'limit': limit,
            'share': None if limit is None or shown is None else abs(shown) / limit,
            'rate': None if trend is None else trend.rate,
            'arrow': arrow,
            'predicted': predicted,
            'band': None if deviation is None else 2.0 * deviation,
            'limited': limited,
            'probe': None if probe is None else self._probe(*probe),
            'stable_in': stable_in,
            'along': self._along(axis, told, error),
        }

    def _along(self, axis: str, told: Any, error: Any) -> dict[str, list[float | None]] | None:
        """Return error, band and offset at both ends and the middle of an axis that slopes."""
        if error is None or not error.valid or axis not in error.axis:
            return None
        number = error.axis.index(axis)
        slope, reference = float(error.slope[number]), float(error.reference_position[number])
        travel = self.parameter('compensator', 'travel')
        texts = travel if isinstance(travel, (list, tuple)) else ()
        try:
            own = [str(text) for text in texts if str(text).startswith(f'{axis}:')]
            found = read_travel(own, [axis], 'travel')
        except ValueError:
            return None
        if not (isfinite(slope) and isfinite(reference) and found.sloping[0]):
            return None
        low, high = float(found.low[0]), float(found.high[0])
        places = [low, 0.5 * (low + high), high]
        steep = float(error.slope_deviation[number])
        steep = steep if isfinite(steep) else 0.0
        spread = float(error.standard_deviation[number])
        offset: list[float | None] = [None, None, None]
        if told is not None and axis in told.axis:
            at = told.axis.index(axis)
            offset = [
                finite(told.offset[at] + told.slope[at] * (x - told.reference_position[at]))
                for x in places
            ]
        return {
            'position': [finite(place) for place in places],
            'error': [finite(error.error[number] + slope * (x - reference)) for x in places],
            'band': [finite(2.0 * hypot(spread, steep * (x - reference))) for x in places],
            'offset': offset,
        }

    def _probe(self, stamp: int, measured: float, predicted: float | None) -> dict[str, Any]:
        age = None if self._stamp is None else max(0.0, (self._stamp - stamp) / SECOND)
        return {'measured': measured, 'predicted': predicted, 'age': age}

    def _spindle(self) -> float | None:
        own = self._newest.get('spindle_speed')
        if own is not None and own.status == SpeedStatus.OK and isfinite(own.speed):
            return float(own.speed)
        machine = self._newest.get('machine_state')
        return None if machine is None else finite(machine.spindle_speed)

    def _sensors(self) -> dict[str, Any]:
        sample = self._newest.get('temperatures')
        error = self._newest.get('thermal_error')
        missing, values = [], {}
        if sample is not None:
            rows = zip(sample.sensor, sample.temperature.tolist(), sample.status, strict=False)
            for name, value, status in rows:
                values[visible(name)] = finite(value)
                if status:
                    why = _STATUS_WORDS.get(int(status), f'status {int(status)}')  # type: ignore[call-overload]
                    missing.append({'name': visible(name), 'why': why})
        substituted = []
        if error is not None:
            for lost, mate in zip(error.substituted, error.substitute, strict=False):
                substituted.append({'name': visible(lost), 'by': visible(mate)})
        poor = {item['name'] for item in (*missing, *substituted)}
        return {
            'ok': sum(name not in poor for name in values),
            'substituted': substituted,
            'missing': missing,
            'values': values,
            'clusters': self._clusters(),
        }

    def _clusters(self) -> list[dict[str, Any]]:
        """Return the clusters of sensors: the model's own, else those of the newest selection."""
        if self._model_clusters:
            return self._model_clusters
        selection = self._newest.get('sensor_selection')
        found = () if selection is None else selection.cluster
        return [_cluster(item.chosen, item.member) for item in found]

    def _model_document(self) -> dict[str, Any] | None:
        error = self._newest.get('thermal_error')
        if self._model is None and error is None:
            return None
        shadow = distance = None
        for item in self._items('thermal_predictor'):
            if item.name == 'prediction':
                distance = finite(number(item.values.get('distance [-]', 'nan')))
            if item.name == 'swap':
                shadow = {'name': visible(item.message), 'difference': {}}
        label = '' if error is None else visible(error.model)
        facts = self._model or {'file': '', 'hash': '', 'runs': [], 'held_out': {}}
        why = ''
        if error is not None and not error.valid:
            why = word(Reason, error.reason).replace('_', ' ')
        return {
            'name': label,
            **facts,
            'valid': bool(error is not None and error.valid),
            'why': why,
            'in_domain': bool(error is not None and error.in_domain),
            'distance': distance,
            'shadow': shadow,
        }

    def _alarms(self, now: float) -> list[dict[str, Any]]:
        nodes = sorted(self._told.items())
        found = [alarm for name, report in nodes for alarm in report.alarms(name, now)]
        found.sort(key=lambda alarm: alarm.level != 'error')
        known = {(alarm.node, alarm.name) for alarm in found}
        self._since = {key: since for key, since in self._since.items() if key in known}
        stamp = None if self._stamp is None else self._stamp / SECOND
        return [
            {
                'level': alarm.level,
                'node': visible(alarm.node),
                'name': visible(alarm.name),
                'cause': visible(alarm.cause),
                'remedy': visible(alarm.remedy),
                'since': self._since.setdefault((alarm.node, alarm.name), stamp),
            }
            for alarm in found
        ]

    def _recording(self, now: float) -> dict[str, Any] | None:
        if self._bag is not None:
            return {'active': True, 'bag': visible(self._bag)}
        report = self._nodes.get('recorder')
        if report is None or report.ended or report.heard_at is None or report.silent(now):
            return None
        bag = next((item.values.get('bag', '') for item in report.items), '')
        return {'active': True, 'bag': visible(bag)}


def _object(text: str) -> Mapping[str, Any]:
    """Return a JSON object; an empty one if the text is none."""
    try:
        found = json.loads(text)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _cluster(chosen: str, member: Iterable[str]) -> dict[str, Any]:
    """Return a cluster of sensors as it is shown, the chosen one first."""
    others = [name for name in member if name != chosen]
    return {'chosen': visible(chosen), 'members': list(map(visible, [chosen, *others]))}


def _model_clusters(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the clusters among which a model's sensors were chosen; empty if it names none."""
    try:
        return [
            _cluster(str(item['chosen']), map(str, item['member']))
            for item in document['selection']['clusters']
        ]
    except (KeyError, TypeError):
        return []  # of another version


def _model_facts(
    document: Mapping[str, Any],
    configuration: NodeConfiguration,
    parameters: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the facts shown about a model file: its training runs and held-out errors."""
    runs = document.get('training_runs')
    held_out = {}
    try:
        for place, item in enumerate(document['channels']):
            left = document['candidates'][item['default']]['held_out_rms'][place]
            held_out[visible(str(item['name']))] = finite(left)
    except (KeyError, IndexError, TypeError):
        held_out = {}  # of another version, or without scores
    return {
        'file': visible(str(parameters.get('model') or '').rpartition('/')[2]),
        'hash': visible(configuration.model_hash[:12]),
        'runs': [visible(str(run)) for run in runs] if isinstance(runs, list) else [],
        'held_out': held_out,
    }
