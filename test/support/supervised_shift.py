# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc up` with a thermal shift: its processes, and what offsets may do meanwhile."""

import os
import re
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from live_graph import Graph, Observer

from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.thermal.compensator import CompensatorConfig
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.runtime.enums import CompensationState
from fuzzycnc_ros.runtime.records import SECOND, Compensation, CompensationApplied

LIMITS, MACHINE = CompensatorConfig(), SimulatedMachineConfig()
MICRO = 1e-6
AT_WORK = 3 * MICRO
"""Offset from which on compensation is at work [m]."""


class Up:
    """A supervised graph of a thermal shift, started by the command line.

    Parameters
    ----------
    graph : Graph
        Who starts it.
    observer : Observer
        Hears what is told and applied.
    model, folder : Path
        The model of the predictor, and where the bag and the outcome are written.
    rate : float
        Machine time per wall time [-].
    options : str
        Further options of the command.
    """

    def __init__(
        self,
        graph: Graph,
        observer: Observer,
        model: Path,
        folder: Path,
        rate: float,
        *options: str,
    ) -> None:
        self.folder = folder
        self.told = observer.records('compensation', Compensation)
        self.applied = observer.records('compensation_applied', CompensationApplied)
        command = [
            *(sys.executable, '-m', 'fuzzycnc_ros.cli.main', 'up', '--simulate', 'T2'),
            *('--rate', f'{rate:g}', '--model', str(model), '--autostart'),
            *('--record', str(folder / 'bag'), '--json', str(folder / 'outcome.json'), *options),
        ]
        self.process = graph.launch('up', command, folder)

    def pid(self, node: str) -> int | None:
        """Return the process id of a node's newest life."""
        found = re.findall(rf'\b{node} runs as process (\d+)', self.process.output)
        return int(found[-1]) if found else None

    def lives(self, node: str) -> int:
        """Return how often a node was started."""
        return len(re.findall(rf'\b{node} runs as process', self.process.output))

    def living(self) -> list[int]:
        """Return the processes that it has started and that still run."""
        pids = map(int, re.findall(r'runs as process (\d+)', self.process.output))
        return [pid for pid in pids if os.path.exists(f'/proc/{pid}')]

    def at_work(self, since: int = 0) -> bool:
        """Whether offsets have been in force after a time stamp [ns]."""
        command = self.told[-1] if self.told else None
        return (
            command is not None
            and command.stamp > since
            and command.state == CompensationState.ACTIVE
            and np.abs(self.applied[-1].offset).max() > AT_WORK
            and self.applied[-1].status == OffsetStatus.FOLLOWING
        )


def check_steps(
    told: Sequence[Compensation], applied: Sequence[CompensationApplied]
) -> list[float]:
    """Hold all that was told and applied against limits; return the worst steps [m]."""
    steps = [0.0, 0.0]
    assert len(applied) > 30
    for before, after in pairwise(applied):
        elapsed = (after.stamp - before.stamp) / SECOND
        step = np.abs(after.offset - before.offset).max()
        steps[0] = max(steps[0], step)
        assert np.abs(after.offset).max() <= MACHINE.offset_max
        assert step <= MACHINE.slew_max * elapsed + 1e-12, f'at {after.stamp / SECOND} s'
    epoch = 0
    for number, command in enumerate(told):
        assert np.isfinite(command.offset).all()
        assert np.abs(command.offset).max() <= LIMITS.offset_max
        if command.epoch == epoch:
            before = told[number - 1]
            elapsed = (command.stamp - before.stamp) / SECOND
            step = np.abs(command.offset - before.offset).max()
            steps[1] = max(steps[1], step)
            assert step <= LIMITS.slew_max * elapsed + 1e-12, f'at {command.stamp / SECOND} s'
            continue
        epoch = command.epoch
        # A new owner starts from what is in force: the newest read-back that it can know.
        known = [item.offset for item in applied if item.stamp <= command.stamp][-6:]
        reach = LIMITS.slew_max * LIMITS.period + 1e-12
        nearest = min((np.abs(command.offset - offset).max() for offset in known), default=0.0)
        assert nearest <= reach, f'epoch {epoch} begins with a step of {nearest / MICRO} um'
    return steps
