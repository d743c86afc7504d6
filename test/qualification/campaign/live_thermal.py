# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A graph of thermal compensation that faults are put into."""

import random
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from campaign.live_graphs import MACHINE, MAKES_TIME, LiveGraph
from campaign.rogue_nodes import FALSE, STRANGER, Strangers, strange_word
from campaign.scenario import Stage
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.graph.bring_up import NodeSpec
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Compensation,
    CompensationApplied,
    MachineState,
    Record,
    Temperatures,
    ThermalError,
)

DUTY = 'T2'
AT_WORK = 2e-6
"""Offset from which on compensation is at work [m]."""
LASTING = 10
"""Ticks in a row in which it has to be at work: after a jump of clocks it comes and goes."""


class ThermalGraph(LiveGraph):
    """A mill that is compensated.

    Parameters
    ----------
    stage, folder
        As `LiveGraph`.
    model : Path
        Model of the predictor; it is copied, as scenarios damage it.
    seed : int
        Of what is random.
    """

    SPEAKS: ClassVar[Mapping[str, tuple[str, type[Any]]]] = {
        'temperature_acquisition': ('temperatures', Temperatures),
        'thermal_predictor': ('thermal_error', ThermalError),
        'compensator': ('compensation', Compensation),
    }
    REJOINS = 5.0

    def __init__(self, stage: Stage, folder: Path, model: Path, seed: int) -> None:
        self._random = random.Random(seed)
        self._model = folder / 'model.json'
        self._model.write_bytes(model.read_bytes())
        self._applied: CompensationApplied | None = None
        self._told: Compensation | None = None
        self._imitated: dict[str, Record] = {}
        self._error: ThermalError | None = None
        self._working = 0
        super().__init__(stage, folder)

    def at_work(self) -> bool:
        """Whether the machine has followed a compensator that moves it for some ticks."""
        return self._working >= LASTING

    def _works(self) -> bool:
        return (
            self._applied is not None
            and self._told is not None
            and self._error is not None
            and self._applied.status == OffsetStatus.FOLLOWING
            and self._told.state == CompensationState.ACTIVE
            and self._error.valid
            and bool(np.abs(self._applied.offset).max() > AT_WORK)
        )

    def at_zero(self) -> bool:
        """Whether no offset is in force."""
        return self._applied is not None and not self._applied.offset.any()

    def restart_machine(self) -> None:
        """Kill the simulated machine and start it anew."""
        self.signal(MAKES_TIME, signal.SIGKILL)
        while MAKES_TIME not in self.graph.poll():
            time.sleep(0.01)
        self.graph.start(next(spec for spec in self._specs() if spec.name == MAKES_TIME))
        self._now = 0
        self.until(lambda: self._now > 0, 'the machine ticks again')

    def refused_everywhere(self) -> None:
        """Set each live parameter of each node out of its range; all must be refused."""
        for name in (*self.SPEAKS, 'sensor_selector'):
            for item in fields(COMPONENTS[name].CONFIG):
                if not item.metadata['live'] or item.metadata['high'] is None:
                    continue
                high = item.metadata['high']
                wrong: list[Any] = [type(high)(2 * high + 1), 'many']
                if isinstance(item.default, float):
                    wrong = [2.0 * high + 1.0, -2.0 * abs(high) - 1.0, float('nan'), 'many']
                for value in wrong:
                    if not self.set_parameters(name, {item.name: value}):
                        self.findings.append(f'{name} takes {item.name} = {value}')

    def damage_model(self) -> str:
        """Cut the model file at a random byte; return its name."""
        size = self._model.stat().st_size
        with self._model.open('r+b') as file:
            file.truncate(self._random.randrange(1, size - 1))
        return str(self._model)

    def stranger(self, topic: str, names: tuple[str, ...]) -> Strangers:
        """Return nodes that publish a topic which is not theirs."""

        def order() -> Record:
            return strange_word(topic, self._now + SECOND, self._imitated.get(topic))

        return Strangers(self.context, f'/{MACHINE}', topic, names, order)

    def second_compensator(self) -> Callable[[], None]:
        """Start another compensator of the machine; return what ends it."""
        folder = self.folder / 'second'
        folder.mkdir(exist_ok=True)
        params = folder / 'second.yaml'
        params.write_text('/**: {ros__parameters: {autostart: true, use_sim_time: true}}\n')
        second = GraphProcesses(
            MACHINE, folder=folder, params=[params], remap=['__node:=compensator_2']
        )
        began = time.monotonic()
        second.start(NodeSpec('compensator'))

        def end() -> None:
            second.stop()
            # Its first message may come before the recorder has met it, its last as it leaves.
            self.outages.append(('compensator', began, time.monotonic()))

        return end

    def _specs(self) -> list[NodeSpec]:
        return self._stage_specs(
            {}, duties=(DUTY,), model=self._model, state_directory=self.folder / 'state'
        )

    def _listen_to_machine(self) -> None:
        self._listen('compensation_applied', CompensationApplied, self._note)
        self._listen('machine_state', MachineState, self._note)

    def _operate(self) -> None:
        """Do nothing: the machine goes through its duty by itself."""

    def _note(self, topic: str, record: Any) -> None:
        if isinstance(record, Compensation):
            if record.source == STRANGER:
                return
            self._told = record
        elif isinstance(record, ThermalError):
            self._error = record
        elif isinstance(record, CompensationApplied):
            self._applied = record
            self._working = self._working + 1 if self._works() else 0
        elif isinstance(record, MachineState):
            self._now = record.stamp
        else:
            return
        if topic == 'compensation' or topic in FALSE:
            self._imitated[topic] = record
        self._hear(topic, record)
