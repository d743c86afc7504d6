# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Any controller in a thread of its own, so that a node never waits for a network."""

import threading
import time
from collections.abc import Callable

from fuzzycnc_ros.adapters.controller import Controller, LimitsT, OrdersT, StatusT
from fuzzycnc_ros.adapters.link import LinkError

TEXT_MAX = 300
"""Longest text that is passed on: a part of it may come from the controller."""
CLOSE_TIMEOUT = 5.0
"""Longest wait for a controller that is let go [s]."""


class ThreadedController(Controller[StatusT, OrdersT, LimitsT]):
    """Exchange orders and status with a controller, one exchange per period.

    Nothing here waits: `read` and `write` return what has come since the last call, and raise
    what has gone wrong meanwhile.

    Parameters
    ----------
    connect : callable
        Makes the connection; called in the thread.
    period : float
        Time between two exchanges [s].
    pause : float
        Time without one [s] after which it is read before anything is written: a controller that
        heard nobody may have let the offsets go, and must not be sent back to them.
    """

    def __init__(
        self,
        connect: Callable[[], Controller[StatusT, OrdersT, LimitsT]],
        period: float,
        pause: float,
    ) -> None:
        self._connect, self._period, self._pause = connect, period, pause
        self._begun = time.monotonic()
        self._stale = False  # what is handed over was ordered before a pause
        self._looked = False  # the newest exchange was the look after one
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._status: StatusT | None = None
        self._limits: LimitsT | None = None
        self._error: LinkError | None = None
        self._orders: OrdersT | None = None
        self._claims = self._releases = False
        self._thread = threading.Thread(target=self._run, name='controller', daemon=True)
        self._thread.start()

    def read(self) -> StatusT | None:
        """Return the newest status, None if there is none since the last call."""
        with self._lock:
            self._orders = None
            return self._take()

    def write(self, orders: OrdersT) -> StatusT | None:
        """Hand over what to write in the next exchange; return as `read` does."""
        with self._lock:
            if self._stale:
                self._stale = self._status is None  # orders after this status know of the pause
            else:
                self._orders = orders
            return self._take()

    def limits(self) -> LimitsT:
        """Return the limits as they were read last."""
        with self._lock:
            if self._limits is None:
                raise LinkError('the controller has not been read yet')
            return self._limits

    def claim(self) -> None:
        """Become the writer before the next exchange; a refusal is raised by what comes next."""
        with self._lock:
            self._claims, self._releases = True, False

    def release(self) -> None:
        """Let go before the next exchange."""
        with self._lock:
            self._claims, self._releases, self._orders = False, True, None

    def close(self) -> None:
        """Carry out what was asked for last, and end."""
        self._ended.set()
        if self._error is None:  # else it ends by itself, and nobody needs to wait
            self._thread.join(CLOSE_TIMEOUT)

    def _take(self) -> StatusT | None:
        if self._error is not None:
            raise self._error
        status, self._status = self._status, None
        return status

    def _run(self) -> None:
        controller: Controller[StatusT, OrdersT, LimitsT] | None = None
        try:
            controller = self._connect()
            last = False
            while not last:
                last = self._ended.is_set()
                self._exchange(controller, last)
                self._ended.wait(self._period)
        except LinkError as error:
            self._fail(error)
        except Exception as error:  # whatever a controller made a library stumble over
            text = f'answer not understood: {type(error).__name__}: {error}'
            self._fail(LinkError(text[:TEXT_MAX]))
        finally:
            if controller is not None:
                controller.close()

    def _exchange(self, controller: Controller[StatusT, OrdersT, LimitsT], last: bool) -> None:
        """Claim or release if that is asked for, write, read; the last time only let go."""
        with self._lock:
            self._look_after_pause()
            claims, releases, orders = self._claims, self._releases, self._orders
            self._claims = self._releases = False
        if releases:
            controller.release()
        if last:
            return
        if claims:
            controller.claim()
        controller.probe_due = self.probe_due
        status = controller.read() if orders is None else controller.write(orders)
        limits = controller.limits()
        with self._lock:
            self._limits = limits
            if status is not None:
                self._status = status

    def _look_after_pause(self) -> None:
        """Drop the orders from before a pause; where all exchanges are slow, every second time."""
        begun, self._begun = self._begun, time.monotonic()
        self._looked = self._begun - begun > self._pause and not self._looked
        if self._looked:
            self._status, self._orders, self._stale = None, None, True

    def _fail(self, error: LinkError) -> None:
        with self._lock:
            self._error = error
