# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A graph that runs live over DDS in lock-step into a bag, and the replay of that bag."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Steps, ended, lockstep_graph
from fuzzycnc_ros.graph.bring_up import NodeSpec

if TYPE_CHECKING:
    from fuzzycnc_ros.replay.replay import ReplayReport

MACHINE = 'mill'


class LiveRun(NamedTuple):
    """A run over DDS and its replay."""

    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float

    @classmethod
    def of(cls, outcome: Mapping[str, Any], seconds: float, replayed: 'ReplayReport') -> 'LiveRun':
        """Return the run of a machine's outcome, its wall time [s] and its replay."""
        ticks = int(outcome.get('ticks', 0))
        return cls(
            hash=replayed.hash,
            replay_identical=replayed.identical,
            degraded=bool(outcome.get('degraded', True)),
            ticks=ticks,
            ticks_per_second=round(ticks / seconds, 1),
        )

    def facts(self) -> dict[str, str]:
        """Return what the report says of it."""
        return {
            'Ticks': f'{self.ticks}, {self.ticks_per_second:.0f} per second over DDS',
            'Replay': 'identical' if self.replay_identical else 'differs',
            'Canonical hash': self.hash,
        }

    def lines(self) -> tuple[str, str]:
        """Return what the terminal says of it."""
        return (
            f'replay of the bag: {"identical" if self.replay_identical else "DIFFERS"}, '
            f'hash {self.hash[:16]}',
            f'{self.ticks} ticks at {self.ticks_per_second:.0f} per second',
        )

    def problem(self) -> str:
        """Return why it proves nothing; empty if it does."""
        if self.replay_identical and not self.degraded:
            return ''
        return 'the run was degraded or its replay differs; see the report'


def run_live(
    specs: Sequence[NodeSpec], label: str, out: Path, progress: Steps, folder: str = 'bag'
) -> LiveRun:
    """Run nodes in lock-step into a bag, and replay that.

    Parameters
    ----------
    specs : sequence of NodeSpec
        The nodes, the simulated machine last.
    label : str
        What they did, for the terminal.
    out : Path
        The demo's folder.
    progress : Steps
        Shows how far it is.
    folder : str
        Name of the bag in it.
    """
    from fuzzycnc_ros.replay.replay import replay

    with lockstep_graph(MACHINE, specs, out / folder, out / 'log' / folder) as graph:
        started = time.monotonic()
        with progress.step(f'{label} live over DDS, in lock-step'):
            graph.wait('simulated_machine', RUN_TIMEOUT)
        seconds = time.monotonic() - started
        outcome = ended(graph)
    with progress.step(f'replayed {folder} and compared every output'):
        return LiveRun.of(outcome, seconds, replay(out / folder))


def day_specs(given: Mapping[str, Mapping[str, Any]]) -> list[NodeSpec]:
    """Return nodes in lock-step, of the parameters of each."""
    return [NodeSpec(name, {'lockstep': True, **values}) for name, values in given.items()]
