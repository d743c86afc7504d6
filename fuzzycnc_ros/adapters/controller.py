# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The interface of an adapter to a controller; docs/opcua-output.md shows how to write one.

An adapter only speaks the controller's language.  Owner, expiry, slew, epochs and adoption are the
business of the component behind which it stands.
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from fuzzycnc_ros.adapters.controller_status import Readout

StatusT = TypeVar('StatusT', bound=Readout)
OrdersT = TypeVar('OrdersT')
LimitsT = TypeVar('LimitsT')


class Controller(ABC, Generic[StatusT, OrdersT, LimitsT]):
    """One connection to a controller: it is open when it is made, and never opened again.

    All methods but `close` raise `LinkError` if the controller is not there any more, refuses, or
    says what cannot be true; the text tells the operator what to do.  The connection is closed
    then, and a new one is made.
    """

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
