# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The scenarios of the fault campaign on machines that move: feeds, servo axes, patterns."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from campaign import actions
from campaign.corrupted_values import (
    DRIVE_FIELDS,
    KINDS,
    PATH_FIELDS,
    PATTERN_FIELDS,
    Falsified,
)
from campaign.scenario import AXIS, BY_DRIVE, BY_PATH, Kind, Scenario, Stage

MACHINE, OPERATOR = 'simulated_machine', 'witness'
SCHEDULER, CONTROLLER, COMPENSATOR = (
    'feedrate_scheduler',
    'servo_controller',
    'deformation_compensator',
)
_SECOND = 1.0 / 60.0
_PATH_RATE, _DRIVE_RATE = 0.5, 0.2
"""Speeds of machine time: axes tick every millisecond of it, and a period that is answered late on
a busy computer is a fault already."""
_PATH, _DRIVE, _MOVE = 1.5 * _SECOND, 0.4 * _SECOND, 0.9 * _SECOND
"""Machine time [min] for which routes are disturbed and values wrong: paths begin anew in it, and
driven axes go further than it takes to find them out, or to the end of their travel."""

SAYS: Mapping[str, str] = {
    'nan_tool_path': 'refused',
    'nan_trajectory': 'finite|refused',
    'jump_trajectory': 'refused|given up|to go on from',
    'nan_axis_reference': 'does not tell where|waits',
    'nan_axis_state': 'not finite',
    'stuck_axis_state': 'feedback|jumped|does not answer|runs away|moving',
    'jump_axis_state': 'jumped',
    'nan_axis_command': 'duty: expected',
    'nan_position_command': 'position',
    'jump_position_command': 'position|travel',
    'nan_material': 'material',
    'jump_material': 'unlike the training',
    'nan_stitch_pattern': 'refused',
    'nan_compensated_path': 'not stitched',
}
"""What diagnostics must tell of a wrong value."""
UNTOLD = frozenset(
    {
        'stuck_axis_state',  # while an axis settles it looks like one that friction holds
        'drift_axis_state',
        'drift_axis_command',
        'stuck_axis_command',
        'jump_axis_command',
        'stuck_position_command',
        'drift_position_command',
    }
)
"""What cannot be told from what is right, by the one who gets it: only the limits hold."""


def _falsified(
    label: str,
    wrong: Falsified,
    stated: float,
    minutes: float,
    meanwhile: Callable[[Any], None] = actions.nothing,
) -> list[Scenario]:
    """Return the scenarios of one input."""
    return [
        Scenario(
            f'{kind}_{label}',
            f'{wrong.name(kind)} of {wrong.topic}: {kind}',
            actions.falsify(wrong, kind, minutes, meanwhile),
            stated,
            says=SAYS.get(f'{kind}_{label}', ''),
            found=f'{kind}_{label}' not in UNTOLD,
        )
        for kind in KINDS
    ]


def _routed(topic: str, late: float, stated: float, minutes: float) -> list[Scenario]:
    """Return what happens to the messages of one route, up to so late [s of machine time]."""
    return [
        Scenario(
            f'drop_{topic}',
            f'every second {topic} is lost',
            actions.drop(0.5, minutes),
            stated,
        ),
        Scenario(
            f'delay_{topic}', f'{topic} {late:g} s late', actions.delay(late, minutes), stated
        ),
        Scenario(
            f'reorder_{topic}',
            f'{topic} up to {late:g} s late',
            actions.reorder(late, minutes),
            stated,
        ),
    ]


def _processes(node: str, stated: float, minutes: float) -> list[Scenario]:
    """Return what happens to the process of a node."""
    return [
        Scenario(f'kill_{node}', f'kill -9 {node}', actions.kill(node), stated),
        Scenario(
            f'stop_{node}',
            f'SIGSTOP {node}, SIGCONT {actions.STOPPED:g} s later',
            actions.stop(node, minutes),
            stated,
        ),
    ]


def _feeds() -> Stage:
    return Stage(
        'feeds',
        _PATH_RATE,
        (
            *_processes(SCHEDULER, BY_PATH, _PATH),
            *_routed('trajectory', 0.6, BY_PATH, _PATH),
            *_falsified('trajectory', PATH_FIELDS['trajectory'], BY_PATH, _PATH),
        ),
        {'trajectory': SCHEDULER},
        Kind.PATH,
        (SCHEDULER,),
    )


def _paths() -> Stage:
    labels = ('tool_path', 'feed_of_tool_path', 'axis_reference', 'trajectory_state')
    return Stage(
        'paths',
        _PATH_RATE,
        tuple(
            scenario
            for label in labels
            for scenario in _falsified(
                label, PATH_FIELDS[label], BY_PATH, _PATH, actions.begin_anew
            )
        ),
        dict.fromkeys(('tool_path', 'axis_state', 'trajectory_state'), MACHINE),
        Kind.PATH,
        (SCHEDULER,),
    )


def _feedback() -> Stage:
    return Stage(
        'feedback',
        _DRIVE_RATE,
        (
            *_routed('axis_state', 0.05, BY_DRIVE, _DRIVE),
            *_falsified('axis_state', DRIVE_FIELDS['axis_state'], BY_DRIVE, _DRIVE),
        ),
        {'axis_state': MACHINE},
        Kind.DRIVE,
        (CONTROLLER,),
    )


def _drives() -> Stage:
    commands = _falsified('axis_command', DRIVE_FIELDS['axis_command'], BY_DRIVE, _MOVE)
    return Stage(
        'drives',
        _DRIVE_RATE,
        (
            *_processes(CONTROLLER, BY_DRIVE, _DRIVE),
            *_routed('axis_command', 0.05, BY_DRIVE, _DRIVE),
            # no controller stands behind what a drive gets then: it goes as fast as it can
            *(replace(item, speed_max=1.05 * AXIS.gain) for item in commands),
            *_falsified(
                'position_command',
                DRIVE_FIELDS['position_command'],
                BY_DRIVE,
                _MOVE,
                actions.begin_anew,
            ),
        ),
        {'axis_command': CONTROLLER, 'position_command': OPERATOR},
        Kind.DRIVE,
        (CONTROLLER,),
    )


def _patterns() -> Stage:
    return Stage(
        'patterns',
        _PATH_RATE,
        (
            *_processes(COMPENSATOR, BY_PATH, _PATH),
            *(
                scenario
                for label, wrong in PATTERN_FIELDS.items()
                for scenario in _falsified(label, wrong, BY_PATH, 1.5 * _PATH)
            ),
        ),
        {'material': MACHINE, 'stitch_pattern': MACHINE, 'compensated_path': COMPENSATOR},
        Kind.PATTERN,
        (COMPENSATOR, SCHEDULER),
    )


MOVING = (_patterns(), _paths(), _drives(), _feeds(), _feedback())
"""Stages of machines that move."""
