# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The scenarios of the fault campaign, in stages that share a graph."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from campaign import actions
from campaign.corrupted_values import FIELDS, KINDS
from campaign.moving import MOVING
from campaign.relay import CLOCK
from campaign.rogue_nodes import FALSE
from campaign.scenario import BY_COMPENSATOR, BY_MACHINE, Ends, Scenario, Stage
from fuzzycnc_ros.graph.bring_up import THERMAL

MACHINE = 'simulated_machine'
ROUTES = {
    'sensor_readings': MACHINE,
    'machine_state': MACHINE,
    'displacement': MACHINE,
    'compensation_applied': MACHINE,
    'temperatures': 'temperature_acquisition',
    'thermal_error': 'thermal_predictor',
    'compensation': 'compensator',
}
"""Streams of thermal compensation and who publishes them."""
_RATE, _SLOW = 300.0, 150.0
"""Speeds of machine time; the slower where a process has to start within what is bridged."""

SAYS: Mapping[str, str] = {
    'nan_sensor_readings': 'missing|lost|substitut|sensor',
    'nan_temperatures': 'missing|lost|substitut|sensor',
    'nan_thermal_error': 'found nan um',
    'nan_compensation': 'expected finite|refused',
    'jump_compensation': 'cut at the limit',
    'jump_thermal_error': 'error_max',
}
"""What diagnostics must tell of a wrong value; the others cannot be told from right ones."""


def _kills() -> Stage:
    scenarios = [
        Scenario(f'kill_{node}', f'kill -9 {node}', actions.kill(node), BY_COMPENSATOR)
        for node in THERMAL
    ]
    scenarios += [
        Scenario(
            'kill_recorder',
            'kill -9 recorder',
            actions.kill('recorder'),
            BY_COMPENSATOR,
            loses=True,
        ),
        Scenario(
            'disk_full',
            "the recorder's file cannot grow (RLIMIT_FSIZE)",
            actions.fill_disk,
            BY_COMPENSATOR,
            loses=True,
        ),
        Scenario(
            'bag_cut',
            'its bag is cut at 20 random bytes and repaired',
            actions.record_on,
            BY_COMPENSATOR,
            cuts=True,
        ),
        Scenario(
            'kill_simulated_machine',
            'kill -9 simulated_machine, which starts at its beginning',
            actions.kill_machine,
            BY_COMPENSATOR,
            Ends.EITHER,
        ),
    ]
    return Stage('kills', _SLOW, tuple(scenarios), {})


def _stops() -> Stage:
    nodes = (*THERMAL, 'recorder', MACHINE)
    return Stage(
        'stops',
        _RATE,
        tuple(
            Scenario(
                f'stop_{node}',
                f'SIGSTOP {node}, SIGCONT {actions.STOPPED:g} s later',
                actions.stop(node),
                BY_MACHINE if node == 'compensator' else BY_COMPENSATOR,
            )
            for node in nodes
        ),
        {},
    )


def _strangers() -> Stage:
    return Stage(
        'strangers',
        _RATE,
        (
            # Before the lasting one: what diagnostics say of both is alike.
            *(
                Scenario(
                    f'brief_{topic}',
                    f'a stranger publishes one {topic} and is gone at once',
                    actions.brief_stranger(topic),
                    BY_MACHINE,
                    says='from a node that is gone|/mill/stranger',
                    loses=True,
                )
                for topic in ('compensation', *FALSE)
            ),
            Scenario(
                'foreign_compensation',
                'a stranger publishes offsets',
                actions.foreign_offsets,
                BY_MACHINE,
                says='/mill/stranger',
            ),
            Scenario(
                'two_compensators',
                'a second compensator is started',
                actions.two_compensators,
                BY_MACHINE,
                says='/mill/compensator_2',
                loses=True,
            ),
            Scenario(
                'foreign_axis_command',
                'two strangers command the drives',
                actions.foreign_axis_commands,
                BY_COMPENSATOR,
                says='/mill/driver_1, /mill/driver_2',
            ),
            Scenario(
                'parameter_out_of_range',
                'each live parameter of each node, beyond its bounds and NaN',
                actions.set_out_of_range,
                BY_COMPENSATOR,
            ),
            Scenario(
                'model_damaged',
                'the predictor is given a damaged model file',
                actions.use_damaged_model,
                BY_COMPENSATOR,
            ),
            Scenario(
                'model_damaged_at_start',
                'kill -9 thermal_predictor with its model file damaged',
                actions.start_with_damaged_model,
                BY_COMPENSATOR,
                Ends.ZERO,
                says='thermal error is late',
            ),
        ),
        {},
    )


def _disturbances() -> Stage:
    return Stage(
        'routes',
        _RATE,
        (
            Scenario('drop', 'every second message is lost', actions.drop(0.5), BY_COMPENSATOR),
            Scenario('delay', 'all messages 30 s late', actions.delay(30.0), BY_COMPENSATOR),
            Scenario('duplicate', 'all messages twice', actions.duplicate(15.0), BY_COMPENSATOR),
            Scenario('reorder', 'all up to 60 s late', actions.reorder(60.0), BY_COMPENSATOR),
        ),
        ROUTES,
    )


def _clocks() -> Stage:
    ahead, back = 600, -600
    return Stage(
        'clocks',
        _RATE,
        (
            Scenario('clock_back', 'clock 10 min back', actions.shift_clock(back), BY_COMPENSATOR),
            Scenario(
                'clock_ahead', 'clock 10 min ahead', actions.shift_clock(ahead), BY_COMPENSATOR
            ),
            *(
                Scenario(
                    f'stamps_{word}_{topic}',
                    f'stamps of {topic} 10 min {word}',
                    actions.shift_stamps(topic, seconds),
                    BY_COMPENSATOR,
                )
                for topic in ('sensor_readings', 'thermal_error', 'compensation')
                for word, seconds in (('back', back), ('ahead', ahead))
            ),
        ),
        {CLOCK: MACHINE, **ROUTES},
    )


def _values(topic: str) -> Stage:
    return Stage(
        topic,
        2.0 * _RATE,
        tuple(
            Scenario(
                f'{kind}_{topic}',
                f'{FIELDS[topic].field} of {topic}: {kind}',
                actions.falsify(FIELDS[topic], kind),
                BY_COMPENSATOR,
                says=SAYS.get(f'{kind}_{topic}', ''),
            )
            for kind in KINDS
        ),
        {topic: ROUTES[topic]},
    )


STAGES = (
    _kills(),
    *MOVING,
    _strangers(),
    _stops(),
    _disturbances(),
    _clocks(),
    *(_values(topic) for topic in FIELDS),
)
"""All stages; the longest first, so that several at a time end together."""


def scenarios() -> list[Scenario]:
    """Return all scenarios in the order of the table."""
    return [scenario for stage in STAGES for scenario in stage.scenarios]


def chosen(names: Sequence[str]) -> list[Stage]:
    """Return the stages with nothing but some scenarios, all if none is named.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    known = [scenario.name for scenario in scenarios()]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(
            f'expected scenarios among {", ".join(known)} but found {", ".join(unknown)}'
        )
    if not names:
        return list(STAGES)
    kept = [
        replace(stage, scenarios=tuple(s for s in stage.scenarios if s.name in names))
        for stage in STAGES
    ]
    return [stage for stage in kept if stage.scenarios]
