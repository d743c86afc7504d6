# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The interface of an adapter to a controller, and what one tells in a cycle.

docs/how-to/opcua-output.md shows how to write one.

An adapter only speaks the controller's language.  Owner, expiry, slew, epochs and adoption are the
business of the component behind which it stands.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from fuzzycnc_ros.runtime.enums import MachineMode
from fuzzycnc_ros.runtime.records import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Readout:
    """State read from a controller; arrays are parallel to the axes of the bridge."""

    mode: MachineMode
    homed: bool
    ready: bool
    """The machine is on and homed, and takes offsets."""
    writer: str = ''
    """Present writer of offsets; empty if there is none, or it is unknown."""
    position: Floats
    """Commanded, without offsets; NaN where the controller does not tell [m]."""
    applied: Floats
    """Offsets in force: the read-back [m]."""
    spindle_speed: float = np.nan
    """Positive clockwise seen from the spindle [rad/s]."""
    coolant: bool | None = None
    """True while flood or mist is on; None where the controller does not report it."""
    spindle_load: float = np.nan
    """Load of the spindle drive; 1 is its rated one [-]."""
    probe: tuple[float, float] | None = None
    """Code and number that a probing cycle told last; see `adapters/probing/programs.py`."""

    @property
    def obstacle(self) -> str:
        """Why offsets are not taken; empty if they are."""
        if self.ready:
            return ''
        words = {MachineMode.ESTOP: 'in emergency stop', MachineMode.FAULT: 'in a fault'}
        word = words.get(self.mode, 'off')
        return 'machine is not homed' if not self.homed else f'machine is {word}'


StatusT = TypeVar('StatusT', bound=Readout)
OrdersT = TypeVar('OrdersT')
LimitsT = TypeVar('LimitsT')


class Controller(ABC, Generic[StatusT, OrdersT, LimitsT]):
    """One connection to a controller: it is open when it is made, and never opened again.

    All methods but `close` raise `LinkError` if the controller is not there any more, refuses, or
    says what cannot be true; the text tells the operator what to do.  The connection is closed
    then, and a new one is made.

    Attributes
    ----------
    probe_due : bool
        Whether the control is shown that a probing cycle is due, from the next call on.
    """

    probe_due = False

    @abstractmethod
    def read(self) -> StatusT | None:
        """Return state and read-back; None if nothing new has come since the last call."""

    @abstractmethod
    def write(self, orders: OrdersT) -> StatusT | None:
        """Bring the offsets, show that the bridge is alive; return what `read` does.

        It is called in every cycle, also when the offsets stay as they are.
        """

    @abstractmethod
    def limits(self) -> LimitsT:
        """Return the limits that the controller keeps whatever it is told."""

    @abstractmethod
    def claim(self) -> None:
        """Become the writer, from the offsets that stand; nothing moves by it.

        Raises
        ------
        LinkError
            If somebody else writes.
        """

    @abstractmethod
    def release(self) -> None:
        """Write no more; what still stands goes to zero by the controller itself, at once."""

    @abstractmethod
    def close(self) -> None:
        """End the connection; offsets that stand are left to the controller's watchdog."""
