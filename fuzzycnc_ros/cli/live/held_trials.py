# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Trials of controllers on a machine's axis, each only for as long as a key is held."""

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Mapping
from typing import Any

import numpy as np

from fuzzycnc_ros.cli.console import say
from fuzzycnc_ros.cli.live.operator_client import SETTLED, OperatorClient
from fuzzycnc_ros.components.servo.servo_trial import UNSTABLE
from fuzzycnc_ros.core.servo.course import AxisFigures
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.topics import RCLPY, create_publisher, create_subscription, subscription_qos
from fuzzycnc_ros.runtime.component import Durability
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.enums import ServoStatus, TrialStatus
from fuzzycnc_ros.runtime.records import ServoState, ServoTrial, ServoTrialState, nanoseconds
from fuzzycnc_ros.simulation.servo.axis_tuning import AxisCase

HELD = 0.3
"""Time after the last sign of a key from which on it counts as let go [s]: a held one repeats 25
times a second or more."""

RENEWED, LEAD = 0.1, 0.03
"""Time between two signs of life to the node, and by how much they are stamped ahead, so that none
comes late [s]."""

LOST = 3.0
"""Time without a word of the node after which it is lost [s]; it tells each 0.05 s."""


class HeldKey:
    """A key of the terminal that is held down, as it repeats itself.

    Raises
    ------
    GraphError
        If standard input is no terminal.
    """

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise GraphError(
                'standard input: expected a terminal, whose space bar is held while the axis '
                'moves, but found none'
            )
        self._file = sys.stdin.fileno()
        self._before: list[Any] = []
        self._last = self._first = -HELD

    def __enter__(self) -> 'HeldKey':
        """Take keys one by one; Ctrl-C still interrupts."""
        self._before = termios.tcgetattr(self._file)
        tty.setcbreak(self._file)
        return self

    def __exit__(self, *error: object) -> None:
        """Give the terminal back as it was."""
        termios.tcsetattr(self._file, termios.TCSAFLUSH, self._before)

    @property
    def held(self) -> bool:
        """True while the key is held: two signs of it and more, the last one just now.

        Raises
        ------
        GraphError
            If the terminal has gone.
        """
        now = time.monotonic()
        while select.select([self._file], [], [], 0.0)[0]:
            try:
                found = os.read(self._file, 256)
            except OSError:
                found = b''
            if not found:
                raise GraphError('the terminal has gone; the axis was stopped')
            self._first = self._last if now - self._last < HELD else now
            self._last = now
        return now - self._last < HELD and self._first < self._last


class HeldTrials:
    """Tries controllers on an axis, through the node that drives it.

    Parameters
    ----------
    operator : OperatorClient
        At the graph of the machine.
    key : HeldKey
        What the operator holds.
    axis, machine_file : str
        The axis, and the hash of what its machine file says of it.
    """

    def __init__(
        self, operator: OperatorClient, key: HeldKey, axis: str, machine_file: str
    ) -> None:
        self._operator, self._key = operator, key
        self._axis, self._machine_file = axis, machine_file
        self._state: ServoState | None = None
        self._heard = time.monotonic()
        self._told: ServoTrialState | None = None
        self._stamp = 0
        # another command's numbers must not be taken for these
        self._number = time.time_ns() // 1_000_000_000 % 2**31
        node, qos = operator.node, subscription_qos(Durability.STREAM)
        create_subscription(node, ServoState.TYPE, 'servo_state', self._on_state, qos)
        create_subscription(node, ServoTrialState.TYPE, 'servo_trial_state', self._on_trial, qos)
        self._publisher = create_publisher(node, ServoTrial.TYPE, 'servo_trial', Durability.STREAM)
        operator.spin_until(
            lambda: self._state is not None and self._publisher.get_subscription_count() > 0,
            20.0,
            'servo_controller, which drives the axis',
        )
        operator.pause(SETTLED)  # a recorder that missed the first sign could not be replayed

    def __call__(
        self, name: str, settings: Mapping[str, float], case: AxisCase, error_max: float
    ) -> AxisFigures:
        """Try a controller in a case, anew where the key was let go.

        Raises
        ------
        GraphError
            If the node refuses it for the axis' sake, or is lost, or the terminal is.
        """
        while True:
            self._until_ready()
            self._number += 1
            asked = {
                'axis_name': self._axis,
                'trial': self._number,
                'machine_file': self._machine_file,
                'controller': name,
                'setting': tuple(settings),
                'value': np.array([*settings.values()], np.float64),
                'gain': case.gain,
                'way': case.way,
                'pace': case.pace,
                'error_max': error_max,
            }
            told = self._held(asked)
            if told is None:
                continue
            if told.status == TrialStatus.REFUSED and UNSTABLE not in told.reason:
                raise GraphError(told.reason)
            return AxisFigures(
                rms=told.rms, largest=told.largest, rest=told.rest, fault=told.reason
            )

    def _held(self, asked: Mapping[str, Any]) -> ServoTrialState | None:
        """Hold a trial to its end; return what became of it, None where the key was let go."""
        renewed = 0.0
        try:
            while self._key.held:
                if time.monotonic() - renewed >= RENEWED:
                    self._sign(asked)
                    renewed = time.monotonic()
                self._spin()
                told = self._told
                if told is not None and told.trial == self._number:
                    if told.status != TrialStatus.RUNNING:
                        return told
            return None
        finally:
            told = self._told
            if told is None or told.trial != self._number or told.status == TrialStatus.RUNNING:
                self._sign({**asked, 'controller': ''})

    def _until_ready(self) -> None:
        """Wait until the key is held, the axis rests, and a fault of the node is mended."""
        told = False
        while True:
            self._spin()
            state = self._state
            fault = state is not None and state.status == ServoStatus.FAULT
            if state is not None and fault and not told:
                say(
                    f'servo_controller: {state.reason}; look at the axis, then go on with '
                    '`fuzzycnc operate deactivate servo_controller` and `... activate ...`'
                )
                told = True
            resting = state is not None and not fault and state.status != ServoStatus.MOVING
            if self._key.held and resting:
                return

    def _spin(self) -> None:
        self._operator.spin_once(0.02)
        if time.monotonic() - self._heard > LOST:
            raise GraphError(
                f'servo_controller: nothing heard of it for {LOST:g} s; the drives are at zero '
                'once their last command is out of date'
            )

    def _sign(self, asked: Mapping[str, Any]) -> None:
        """Give a sign of life, at the machine's time."""
        assert self._state is not None
        since = time.monotonic() - self._heard
        self._stamp = max(self._state.stamp + nanoseconds(since + LEAD), self._stamp + 1)
        self._publisher.publish(encode(ServoTrial(stamp=self._stamp, **asked), RCLPY))

    def _on_state(self, message: Any) -> None:
        self._state, self._heard = decode(ServoState, message), time.monotonic()

    def _on_trial(self, message: Any) -> None:
        self._told = decode(ServoTrialState, message)
