# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Closed loops in the servo thread of a LinuxCNC without hardware, recorded in every period.

All joints are of one axis X and so are told the same.  Each has a simulated axis of its own, a
component as `servo export --to plant` writes it, and a controller: an exported one, or LinuxCNC's
own `pid`.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from fuzzycnc_ros.adapters.linuxcnc.component import install_component, remove_component
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import (
    LOADED,
    LOOPBACKS,
    PYTHON,
    THREAD,
    Limits,
    LinuxcncSimulation,
    exclusive,
    ini_text,
    own_folder,
)
from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.ros.processes import child_set_up

AXIS = 'X'
PLANT = 'fuzzycnc_loop_plant'
"""Component of the simulated axis: no name that a machine's own may have."""
SHARED = ('command', 'command-deriv', 'enable')
"""Signals of the first joint, the same for all."""
OWN = ('feedback', 'output', 'position', 'fault-code', 'time')
"""Signals of every joint; `position` is the true one, `time` that of the controller [cycles]."""
RECORDED = ('feedback', 'output', 'position')
_TYPES = {'enable': 'b', 'fault-code': 's', 'time': 's'}  # others are floats
_SAMPLES = 20  # that HAL takes
_DEPTH = 16000  # samples that HAL keeps while nobody reads them
_DRAIN = 30.0  # time that their reader has to take the last ones [s]
_FERROR = 20.0  # of which a loop that has gone wrong is stopped [mm]


@dataclass(frozen=True)
class LoopController:
    """Controller of a joint.

    Attributes
    ----------
    name : str
        Name of the component; of LinuxCNC's own, `pid`.
    source : str
        Its source for halcompile; empty for one that LinuxCNC has.
    settings : mapping of str to str
        Values of its pins and parameters.
    """

    name: str
    source: str = ''
    settings: Mapping[str, str] = field(default_factory=dict)

    def lines(self, joint: int) -> tuple[str, str, str]:
        """Return what loads it, its prefix in HAL, and its function."""
        if self.source:
            prefix = self.name.replace('_', '-')
            return f'loadrt {self.name}', prefix, prefix
        return f'loadrt {self.name} names=own-{joint}', f'own-{joint}', f'own-{joint}.do-pid-calcs'


class AxisLoop(LinuxcncSimulation):
    """A LinuxCNC whose joints are simulated axes in closed loops.

    Parameters
    ----------
    folder : Path
        Where its files go.
    controllers : sequence of LoopController
        One per joint; a component of LinuxCNC at most once.
    limits : Limits
        What the axis is allowed.
    record : sequence of str
        Signals of each joint that are recorded, of `OWN`.
    noise : float
        RMS of the noise of all sensors [m].
    lines : sequence of str
        Further lines of HAL; the signal `load` is that of all axes.
    further : mapping of str to str
        Signals of these lines that are recorded, with the letter of their type.
    """

    def __init__(
        self,
        folder: Path,
        controllers: Sequence[LoopController],
        limits: Limits,
        record: Sequence[str] = RECORDED,
        noise: float = 0.0,
        lines: Sequence[str] = (),
        further: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        super().__init__(folder, letters=AXIS * len(controllers))
        self._controllers, self._limits, self._noise = tuple(controllers), limits, noise
        self._more, self._further = tuple(lines), further
        self._signals = (
            *SHARED,
            *further,
            *(f'{name}-{joint}' for joint in range(len(controllers)) for name in record),
        )
        if len(self._signals) > _SAMPLES:
            raise ValueError(
                f'record: expected at most {_SAMPLES} signals but found {len(self._signals)}'
            )
        self._reader: subprocess.Popen[bytes] | None = None
        self._rows = folder / 'samples'

    @property
    def _types(self) -> str:
        kinds = (name.rstrip('0123456789').rstrip('-') for name in self._signals)
        known = {**_TYPES, **self._further}
        return ''.join(known.get(kind, 'f') for kind in kinds)

    def start(self) -> None:
        """Start it, off and not homed; every period is recorded.

        Raises
        ------
        LinuxcncError
            If it does not come up.
        """
        super().start()
        program = Path(__file__).with_name('sampler_process.py')
        with self._rows.open('wb') as rows:
            self._reader = subprocess.Popen(
                [PYTHON, '-I', str(program), self._types],
                stdin=subprocess.PIPE,
                stdout=rows,
                preexec_fn=child_set_up(),
            )

    def run_program(self, text: str, timeout: float = 120.0) -> None:
        """Run a part program to its end.

        Raises
        ------
        LinuxcncError
            If it takes longer, or LinuxCNC ends it.
        """
        self.run(self.write_program('program', text))
        self.wait_for_end(timeout)

    def samples(self) -> dict[str, Array]:
        """End the recording and return it.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            Each signal by its name, in units of LinuxCNC: millimetres, seconds.

        Raises
        ------
        LinuxcncError
            If samples were lost.
        """
        self._end_reader()
        table = np.fromfile(self._rows).reshape(-1, 1 + len(self._signals))
        if len(table) < 2 or not np.all(np.diff(table[:, 0]) == 1.0):
            raise LinuxcncError('samples are missing: they were read too late')
        return dict(zip(self._signals, table.T[1:], strict=True))

    def end(self) -> None:
        """End it as its operator does."""
        self._end_reader()
        super().end()

    def _end_reader(self) -> None:
        if self._reader is not None:
            assert self._reader.stdin is not None
            self._reader.stdin.close()
            self._reader.wait(_DRAIN)
            self._reader = None

    def _files(self) -> dict[str, str]:
        ini = ini_text(self.letters, [], self._limits)
        return {
            'test.ini': ini.replace('TYPE = LINEAR', f'TYPE = LINEAR\nFERROR = {_FERROR}'),
            'machine.hal': '\n'.join([LOADED, *self._hal_lines(), LOOPBACKS]),
        }

    def _hal_lines(self) -> Iterator[str]:
        joints = range(len(self._controllers))
        found = [one.lines(joint) for joint, one in enumerate(self._controllers)]
        yield f'loadrt {PLANT} names={",".join(f"plant-{joint}" for joint in joints)}'
        yield from (load for load, _, _ in found)
        yield f'loadrt sampler depth={_DEPTH} cfg={self._types}'
        # what a function reads has been computed before it in the same period
        yield from (f'addf plant-{joint}.measure servo-thread' for joint in joints)
        yield THREAD
        yield from (f'addf {function} servo-thread' for _, _, function in found)
        yield from (f'addf plant-{joint}.drive servo-thread' for joint in joints)
        yield 'addf sampler.0 servo-thread'
        yield f'net load {" ".join(f"plant-{joint}.load" for joint in joints)}'
        for joint, (_, prefix, function) in enumerate(found):
            yield f'setp plant-{joint}.noise {self._noise:.9g}'
            yield f'setp plant-{joint}.seed {joint + 1}'
            own = {name: f'{name}-{joint}' for name in (*SHARED, *OWN)}
            motion = f'joint.{joint}'
            yield f'net {own["command"]} {motion}.motor-pos-cmd => {prefix}.command'
            yield f'net {own["command-deriv"]} {motion}.vel-cmd => {prefix}.command-deriv'
            yield f'net {own["enable"]} {motion}.amp-enable-out => {prefix}.enable'
            yield (
                f'net {own["feedback"]} plant-{joint}.reading => {prefix}.feedback '
                f'{motion}.motor-pos-fb'
            )
            yield f'net {own["output"]} {prefix}.output => plant-{joint}.duty'
            yield f'net {own["position"]} plant-{joint}.position'
            yield f'net {own["time"]} {function}.time'
            if self._controllers[joint].source:
                yield f'net fault-{joint} {prefix}.fault => {motion}.amp-fault-in'
                yield f'net {own["fault-code"]} {prefix}.fault-code'
            for name, value in self._controllers[joint].settings.items():
                yield f'setp {prefix}.{name} {value}'
        yield from self._more
        for pin, signal in enumerate(self._signals):
            name = f'{signal}-0' if signal in SHARED else signal
            yield f'net {name} => sampler.0.pin.{pin}'


@contextlib.contextmanager
def axis_loop(
    controllers: Sequence[LoopController],
    plant: str,
    limits: Limits,
    record: Sequence[str] = RECORDED,
    noise: float = 0.0,
    lines: Sequence[str] = (),
    further: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[AxisLoop]:
    """Build and load components, start a LinuxCNC with them that is off, and end it.

    Parameters
    ----------
    controllers, limits, record, noise, lines, further
        As `AxisLoop`.
    plant : str
        Source of the component `PLANT`.

    Raises
    ------
    LinuxcncError
        If LinuxCNC is not installed or another one runs, or a component cannot be built.
    """
    sources = {PLANT: plant, **{one.name: one.source for one in controllers if one.source}}
    with exclusive(), contextlib.ExitStack() as ending:
        folder = Path(ending.enter_context(own_folder()))
        for name, source in sources.items():
            path = folder / f'{name}.comp'
            path.write_text(source)
            ending.callback(remove_component, name)
            install_component(path)
        machine = AxisLoop(folder, controllers, limits, record, noise, lines, further)
        ending.callback(machine.end)
        machine.start()
        yield machine
