# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What the scenarios do to a live graph, each undone at its end where that is possible."""

import signal
from collections.abc import Callable
from typing import Any

from campaign.corrupted_values import Falsified, falsified, shifted, shifted_clock
from campaign.relay import CLOCK, Delay, Drop, Duplicate, Falsify, RouteFault
from campaign.scenario import Live, MovingLive, ThermalLive

Action = Callable[[Live], None]
ThermalAction = Callable[[ThermalLive], None]

SEED = 7
STOPPED = 1.5
"""Wall time [s] for which a process is stopped."""
UNWRITTEN = 1.2
"""Wall time [s] before a recorder dies in which the mark of the scenario gets onto the disk."""
FAULTY = 14.0
"""Machine time [min] for which a value is wrong: the predictor bridges a little more."""
DISTURBED = 15.0
"""Machine time [min] for which routes are disturbed."""


def kill(node: str) -> Action:
    """Return what kills a node, which the supervisor then starts again."""

    def act(live: Live) -> None:
        if node == 'recorder':
            live.wait(UNWRITTEN)
        live.signal(node, signal.SIGKILL)
        live.await_restart(node)

    return act


def kill_machine(live: ThermalLive) -> None:
    """Kill what makes time and start it anew."""
    live.restart_machine()
    live.run(5.0)


def stop(node: str, minutes: float = 2.0) -> Action:
    """Return what stops a process, lets it go on, and waits a while [min of machine time]."""

    def act(live: Live) -> None:
        live.signal(node, signal.SIGSTOP)
        live.wait(STOPPED)
        live.signal(node, signal.SIGCONT)
        live.run(minutes)

    return act


def nothing(live: Any) -> None:
    """Let the graph go on."""


def disturb(
    make: Callable[[Live], RouteFault],
    minutes: float = DISTURBED,
    meanwhile: Callable[[Any], None] = nothing,
) -> Action:
    """Return what disturbs the routes of the relay for a while, and does something meanwhile."""

    def act(live: Live) -> None:
        fault = make(live)
        live.relay.fault = fault
        meanwhile(live)
        # What is sent seldom, as a pattern is, comes when it comes on a busy computer.
        live.until(lambda: getattr(fault, 'struck', True), 'something comes that is falsified')
        live.run(minutes)
        live.relay.fault = None
        live.destroyed += getattr(fault, 'count', 0)

    return act


def drop(share: float, minutes: float = DISTURBED) -> Action:
    """Return what loses a share of all messages for a while."""
    return disturb(lambda live: Drop(share, SEED), minutes)


def delay(seconds: float, minutes: float = DISTURBED) -> Action:
    """Return what delays all messages [s of machine time] for a while."""
    return disturb(lambda live: Delay(seconds / live.rate, seconds / live.rate, SEED), minutes)


def duplicate(seconds: float) -> Action:
    """Return what sends all messages twice, the second time later [s of machine time]."""
    return disturb(lambda live: Duplicate(seconds / live.rate))


def reorder(seconds: float, minutes: float = DISTURBED) -> Action:
    """Return what delays each message by another time up to this one [s of machine time]."""
    return disturb(lambda live: Delay(0.0, seconds / live.rate, SEED), minutes)


def falsify(
    wrong: Falsified,
    kind: str,
    minutes: float = FAULTY,
    meanwhile: Callable[[Any], None] = nothing,
) -> Action:
    """Return what makes the values on a topic wrong for a while."""
    return disturb(lambda live: Falsify(wrong.topic, falsified(wrong, kind)), minutes, meanwhile)


def begin_anew(live: MovingLive) -> None:
    """Have what leads the axes begin something else at once."""
    live.begin_anew()


def shift_stamps(topic: str, seconds: float) -> Action:
    """Return what moves the stamps of a topic for a while."""
    return disturb(lambda live: Falsify(topic, shifted(seconds)), 5.0)


def shift_clock(seconds: int) -> Action:
    """Return what moves machine time as nodes see it for a while."""
    return disturb(lambda live: Falsify(CLOCK, shifted_clock(seconds)), 5.0)


def fill_disk(live: ThermalLive) -> None:
    """Let the recorder's file grow no further; it ends, and is started again with another one."""
    live.wait(UNWRITTEN)
    live.fill_disk()
    live.await_restart('recorder')


def set_out_of_range(live: ThermalLive) -> None:
    """Set parameters out of their range while the node works."""
    live.refused_everywhere()
    live.run(5.0)


def use_damaged_model(live: ThermalLive) -> None:
    """Let the predictor take over a model whose file is damaged."""
    file = live.damage_model()
    if not live.set_parameters('thermal_predictor', {'model': file}):
        live.findings.append('the predictor takes a damaged model')
    live.run(5.0)


def start_with_damaged_model(live: ThermalLive) -> None:
    """Damage the model file and kill the predictor: it cannot be started again."""
    live.damage_model()
    live.signal('thermal_predictor', signal.SIGKILL)
    live.until(live.at_zero, 'offsets go to zero')
    live.run(2.0)


def foreign_offsets(live: ThermalLive) -> None:
    """Let a stranger publish offsets, of the highest rank, beside the compensator."""
    strangers = live.stranger('compensation', ('stranger',))
    live.wait(1.0)
    strangers.order()
    live.until(live.at_zero, 'offsets go to zero')
    strangers.order()
    live.run(2.0)
    strangers.leave()


def brief_stranger(topic: str) -> Callable[[ThermalLive], None]:
    """Return an action: a stranger says one thing and is gone, sooner than anybody looks."""

    def act(live: ThermalLive) -> None:
        stranger = live.stranger(topic, ('stranger',))
        live.until(stranger.heard, 'the stranger is heard')
        live.wait(0.2)  # he knows them now, and they know him
        stranger.order()
        live.wait(0.05)
        stranger.leave()
        live.run(5.0)

    return act


def foreign_axis_commands(live: ThermalLive) -> None:
    """Let two strangers command the drives."""
    strangers = live.stranger('axis_command', ('driver_1', 'driver_2'))
    live.wait(1.0)
    strangers.order()
    live.run(5.0)
    strangers.leave()


def two_compensators(live: ThermalLive) -> None:
    """Start a second compensator on the same machine."""
    end = live.second_compensator()
    live.until(live.at_zero, 'offsets go to zero')
    live.run(2.0)
    end()


def record_on(live: Live) -> None:
    """Let the recording go on: its bag is cut afterwards."""
    live.run(5.0)
