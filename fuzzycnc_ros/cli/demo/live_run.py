# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Whole days of a mill, live over DDS in lock-step and replayed: scenarios `learn` and `axis`."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fuzzycnc_ros.cli.demo.steps import RUN_TIMEOUT, Steps, ended, lockstep_graph
from fuzzycnc_ros.graph.bring_up import NodeSpec

MACHINE = 'mill'


class DaysRun(NamedTuple):
    """A run over DDS and its replay."""

    hash: str
    replay_identical: bool
    degraded: bool
    ticks: int
    ticks_per_second: float

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


def run_days(
    given: Mapping[str, Mapping[str, Any]], label: str, out: Path, progress: Steps
) -> DaysRun:
    """Run nodes in lock-step into `out / 'bag'`, and replay that.

    Parameters
    ----------
    given : mapping
        Parameters of each node, the simulated machine last.
    label : str
        Days that are run, for the terminal.
    out : Path
        The demo's folder.
    progress : Steps
        Told its steps.
    """
    from fuzzycnc_ros.replay.replay import replay

    specs = [NodeSpec(name, {'lockstep': True, **values}) for name, values in given.items()]
    with lockstep_graph(MACHINE, specs, out / 'bag', out / 'log') as graph:
        started = time.monotonic()
        with progress.step(f'ran the {label} live over DDS, in lock-step'):
            graph.wait('simulated_machine', RUN_TIMEOUT)
        live_s = time.monotonic() - started
        outcome = ended(graph)
    with progress.step('replayed the bag and compared every output'):
        replayed = replay(out / 'bag')
    ticks = int(outcome.get('ticks', 0))
    return DaysRun(
        hash=replayed.hash,
        replay_identical=replayed.identical,
        degraded=bool(outcome.get('degraded', True)),
        ticks=ticks,
        ticks_per_second=round(ticks / live_s, 1),
    )
