# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A control that exposes its compensation as variables of an OPC UA server, in SI units."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.link import LinkError, trouble_in_words
from fuzzycnc_ros.adapters.loops import ConnectionLoop
from fuzzycnc_ros.adapters.opcua.offset_lines import LineLimits, LineOrders, LineStatus
from fuzzycnc_ros.adapters.opcua.session import OpcUaSession, Server
from fuzzycnc_ros.adapters.opcua.variables import ControlVariable, Variables
from fuzzycnc_ros.core.inputs.lines import Lines, Travel
from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Floats, Names

CLOSE_TIMEOUT = 1.0
"""Longest wait for a server that shall say goodbye [s]."""

T = TypeVar('T')


@dataclass(frozen=True, kw_only=True)
class ControlFile:
    """Settings of a control file.

    Parameters
    ----------
    server : Server
        Where the control is and how it is entered.
    axes : tuple of str
        Axes that take offsets.
    travel : Travel
        Ends of the axes [m]; the same for axes whose control takes no slope.
    variables : mapping of str to ControlVariable
        By name: those of an axis as `X.offset`, all others by their field.
    """

    server: Server
    axes: Names
    travel: Travel
    variables: Mapping[str, ControlVariable]


class OpcUaControl(Controller[LineStatus, LineOrders, LineLimits]):
    """One connection to a control.

    Parameters
    ----------
    file : ControlFile
        Where it is and which variables it has.
    name : str
        Who writes, for the variable `owner`.
    login : callable
        Returns user name and password of a credentials file.
    pause : float
        Time [s] after which orders are not written any more: whoever stood still meanwhile, in the
        midst of an exchange, knows nothing of where the control has gone.

    Raises
    ------
    LinkError
        If the control cannot be reached, or a variable is not there, has another type or cannot
        be written; the text names it and the remedy.
    """

    def __init__(
        self,
        file: ControlFile,
        name: str,
        login: Callable[[Path], tuple[str, str]],
        pause: float,
    ) -> None:
        self._file, self._name, self._pause = file, name, pause
        self._timeout = file.server.timeout
        self._claimed = False
        self._shown_due: bool | None = None
        self._written = self._seen = 0
        self._loop = ConnectionLoop()
        self._session: OpcUaSession | None = None
        try:
            self._variables = self._run(self._open(login), 2.0 * self._timeout)
            self._limits = self._limits_of(self._ask())
        except LinkError:
            self.close()
            raise

    def read(self) -> LineStatus:
        """Return state and read-back."""
        if self.probe_due != self._shown_due:
            self._write({'probe_due': self.probe_due})
            self._shown_due = self.probe_due
        return self._status(self._ask())

    def write(self, orders: LineOrders) -> LineStatus:
        """Write a set whose number is new, values first, and the heartbeat; read.

        Before a new set it is read what stands: if that has changed, somebody else writes, and
        nothing is written over.
        """
        until = time.monotonic() + self._pause
        values: dict[str, Any] = {'heartbeat': orders.heartbeat}
        if orders.sequence != self._written:
            found = self._ask()
            if found['sequence'] != self._seen:
                return self._status(found)
            self._write(self._set(orders))
            values['sequence'] = orders.sequence
        if time.monotonic() > until:
            return self.read()
        self._write(values)
        self._written = orders.sequence
        return self.read()

    def limits(self) -> LineLimits:
        """Return the limits as they were read last."""
        return self._limits

    def claim(self) -> None:
        """Write our name, where there is a variable for it."""
        self._write({'owner': self._name})
        self._claimed = True

    def release(self) -> None:
        """Give the hand-shake back, if it is still ours: set 0 makes the control go to zero."""
        if self._claimed and self._ask()['sequence'] == self._written:
            self._write({'sequence': 0, 'owner': ''})
        self._claimed = False

    def close(self) -> None:
        """End the connection."""
        if self._session is not None:
            with contextlib.suppress(Exception):  # it is gone either way
                self._loop.run_until_complete(
                    asyncio.wait_for(self._session.close(), CLOSE_TIMEOUT)
                )
        self._loop.close()

    async def _open(self, login: Callable[[Path], tuple[str, str]]) -> Variables:
        self._session = OpcUaSession(self._file.server, f'fuzzycnc {self._name}', login)
        await self._session.open()
        return await Variables.find(self._session, self._file.variables)

    def _set(self, orders: LineOrders) -> dict[str, Any]:
        values: dict[str, Any] = {'valid_for': orders.validity}
        for place, axis in enumerate(self._file.axes):
            for name in ('offset', 'slope', 'reference_position'):
                values[f'{axis}.{name}'] = getattr(orders.lines, name)[place]
        return values

    def _ask(self) -> dict[str, Any]:
        return self._run(self._variables.read(), self._timeout * self._variables.requests)

    def _write(self, values: Mapping[str, Any]) -> None:
        known = {name: value for name, value in values.items() if name in self._file.variables}
        if known:
            self._run(self._variables.write(known), self._timeout * self._variables.requests)

    def _run(self, work: Coroutine[Any, Any, T], timeout: float) -> T:
        """Run to the end; whatever goes wrong is a connection that is of no more use."""
        try:
            return self._loop.run_until_complete(asyncio.wait_for(work, timeout))
        except LinkError:
            raise
        except Exception as error:
            text = trouble_in_words(error, self._timeout)
        if self._session is not None:
            self._session.well = False
        raise LinkError(f'{self._file.server.url}: {text}')

    def _status(self, found: Mapping[str, Any]) -> LineStatus:
        self._limits, self._seen = self._limits_of(found), found['sequence']
        on = bool(found['on'])
        mode = MachineMode.ON if on else MachineMode.OFF
        if on and found.get('running', False):
            mode = MachineMode.RUNNING
        for name, state in (('fault', MachineMode.FAULT), ('estop', MachineMode.ESTOP)):
            if found.get(name, False):
                mode = state
        allowed = bool(found.get('allowed', True))
        homed = bool(found['homed'])
        return LineStatus(
            mode=mode,
            homed=homed,
            ready=mode in (MachineMode.ON, MachineMode.RUNNING) and homed and allowed,
            writer=str(found.get('owner', '')),
            position=self._column(found, 'position', np.nan),
            applied=self._column(found, 'applied'),
            spindle_speed=found.get('spindle_speed', np.nan),
            coolant=found.get('coolant'),
            spindle_load=found.get('spindle_load', np.nan),
            probe=_probe(found),
            lines=Lines(
                offset=self._column(found, 'offset'),
                slope=self._column(found, 'slope', 0.0),
                reference_position=self._column(found, 'reference_position', 0.0),
            ),
            sequence=found['sequence'],
            acknowledged=found['acknowledged'],
            heartbeat=found['heartbeat'],
            allowed=allowed,
            alive=bool(found.get('alive', True)),
            limits=self._limits,
        )

    def _limits_of(self, found: Mapping[str, Any]) -> LineLimits:
        steps = self._variables.steps
        return LineLimits(
            offset_max=self._column(found, 'limit', np.inf),
            slew_max=float(found.get('slew', np.inf)),
            travel=self._file.travel,
            resolution=np.array(
                [steps[f'{axis}.offset'] + steps[f'{axis}.applied'] for axis in self._file.axes]
            ),
        )

    def _column(self, found: Mapping[str, Any], name: str, default: float = np.nan) -> Floats:
        axes: Iterable[str] = self._file.axes
        return np.array([found.get(f'{axis}.{name}', default) for axis in axes], np.float64)


def _probe(found: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return code and number that a probing cycle told last, if there are variables for them.

    They are read in one request, and the program writes the number first.
    """
    if 'probe_code' not in found:
        return None
    return float(found['probe_code']), float(found['probe_value'])
