# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Latency of a live graph: temperatures published here, compensation back from another process.

Predictor and compensator run composed in one process; this process plays the sensors and the
machine.  The nodes' clock is the stamp of the samples, so that no deadline interferes.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np
from rosgraph_msgs.msg import Clock

from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.cli.live.operator_client import DISCOVERY_TIMEOUT, OperatorClient
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos, subscription_qos
from fuzzycnc_ros.runtime.component import LATCHED, STREAM, Durability
from fuzzycnc_ros.runtime.convert import encode, stamp_of
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import (
    Compensation,
    CompensationApplied,
    MachineState,
    Record,
    Temperatures,
    ThermalReference,
    nanoseconds,
)

SAMPLES = 300
WARM_UP = 20
"""Samples at the start that are not counted: connections and caches settle."""
ANSWER_TIMEOUT = 5.0
"""Wall time [s] after which a measured sample counts as lost."""
MACHINE = 'latency'
TOPICS: dict[str, tuple[type[Record], Durability]] = {
    'temperatures': (Temperatures, STREAM),
    'machine_state': (MachineState, STREAM),
    'compensation_applied': (CompensationApplied, STREAM),
    'thermal_reference': (ThermalReference, LATCHED),
}


def measure_latency(model_file: Path, folder: Path, samples: int = SAMPLES) -> list[float]:
    """Return the time from publishing temperatures to receiving the compensation, per sample [s].

    Parameters
    ----------
    model_file : Path
        Model for the predictor.
    folder : Path
        Where the logs of the nodes go.
    samples : int
        Samples measured, after a warm-up.

    Raises
    ------
    GraphError
        If the nodes do not come up or do not answer.
    """
    model = ThermalModel.from_json(model_file.read_text(encoding='utf-8'))
    with GraphProcesses(MACHINE, folder=folder) as graph:
        graph.start(
            NodeSpec('thermal_predictor', {'model': str(model_file), 'use_sim_time': True}),
            NodeSpec(
                'compensator',
                {'autostart': True, 'axes': list(dict.fromkeys(model.axis)), 'use_sim_time': True},
            ),
        )
        with OperatorClient(MACHINE, graph.check) as operator:
            return _LatencyProbe(operator, model).run(samples)


class _LatencyProbe:
    """Publishes samples one by one and waits for the answer to each."""

    def __init__(self, operator: OperatorClient, model: ThermalModel) -> None:
        self._operator = operator
        self._model = model
        self._interval = nanoseconds(model.interval)
        self._publishers = {
            name: operator.node.create_publisher(
                message_class(record.TYPE), name, publisher_qos(durability)
            )
            for name, (record, durability) in TOPICS.items()
        }
        self._clock = operator.node.create_publisher(Clock, '/clock', 10)
        self._answered: dict[int, float] = {}
        self._subscription = operator.node.create_subscription(
            message_class(Compensation.TYPE),
            'compensation',
            self._on_compensation,
            subscription_qos(STREAM),
        )

    def run(self, samples: int) -> list[float]:
        """Send one sample after the other; return the latencies [s]."""
        operator = self._operator
        operator.spin_until(self._connected, DISCOVERY_TIMEOUT, 'predictor and compensator')
        self._send('thermal_reference', self._reference())
        latencies = []
        for number in range(2, WARM_UP + samples + 2):
            stamp = number * self._interval
            sent = self._send_sample(stamp)
            # The compensator says nothing before it has the read-back: the first may be missing.
            warming_up = number < WARM_UP + 2
            deadline = time.monotonic() + (0.1 if warming_up else ANSWER_TIMEOUT)
            while stamp not in self._answered and time.monotonic() < deadline:
                operator.spin_once(0.01)
            if warming_up:
                continue
            if stamp not in self._answered:
                raise GraphError(f'no compensation within {ANSWER_TIMEOUT:g} s of temperatures')
            latencies.append(self._answered[stamp] - sent)
        return latencies

    def _connected(self) -> bool:
        publishers = self._publishers.values()
        return (
            all(item.get_subscription_count() for item in publishers)
            and self._clock.get_subscription_count() >= 2
            and self._subscription.get_publisher_count() > 0
        )

    def _send_sample(self, stamp: int) -> float:
        """Publish all that belongs to one sample; return when the temperatures went out [s]."""
        model = self._model
        self._clock.publish(Clock(clock=RCLPY.time(stamp)))
        axes = tuple(dict.fromkeys(model.axis))
        nothing = np.zeros(len(axes))
        self._send(
            'machine_state',
            MachineState(
                stamp=stamp,
                state=int(MachineMode.RUNNING),
                homed=True,
                offsets_allowed=True,
                cold_since=1,
                spindle_speed=0.0,
                axis=axes,
                position=nothing,
            ),
        )
        self._send(
            'compensation_applied',
            CompensationApplied(
                stamp=stamp,
                epoch=0,
                status=int(OffsetStatus.IDLE),
                reason='',
                axis=axes,
                offset=nothing,
                at_limit=np.zeros(len(axes), bool),
            ),
        )
        count = len(model.inputs)
        sample = Temperatures(
            stamp=stamp,
            sensor=model.inputs,
            temperature=20.0 + model.domain.mean,
            status=np.zeros(count, np.uint8),
            readings=1,
        )
        sent = time.perf_counter()
        self._send('temperatures', sample)
        return sent

    def _reference(self) -> ThermalReference:
        return ThermalReference(
            stamp=self._interval,
            cold_since=1,
            set_by='operator',
            sensor=self._model.inputs,
            temperature=np.full(len(self._model.inputs), 20.0),
            samples=1,
        )

    def _send(self, name: str, record: Record) -> None:
        self._publishers[name].publish(encode(record, RCLPY))

    def _on_compensation(self, message: Any) -> None:
        self._answered[stamp_of(message.header.stamp)] = time.perf_counter()
