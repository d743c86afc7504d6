# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Permissions of each node in a graph that denies everything else (docs/how-to/security.md).

Topics come from the declarations of the components; what nodes have beside them stands here.
Names are relative to the machine, `~/` to the node, or absolute.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from fuzzycnc_ros.components.dashboard.machine_view import SOURCES
from fuzzycnc_ros.components.report.machine_report import SOURCES as REPORTED
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.component import Component

RECORDER, PLAYER, OPERATOR, DASHBOARD = 'recorder', 'player', 'operator', 'dashboard'
MQTT, MTCONNECT, OPCUA = 'mqtt_publisher', 'mtconnect_adapter', 'opcua_server'
TOOLS = (RECORDER, PLAYER, OPERATOR, DASHBOARD, MQTT, MTCONNECT, OPCUA)
"""Nodes without a component; `operator` is that of `fuzzycnc operate`."""
PRETENDERS = ('simulated_machine', 'simulated_body', PLAYER)
"""Nodes that play a machine: of no use beside a real one, and trusted with its topics."""

PARAMETERS = tuple(
    f'~/{name}'
    for name in (
        'describe_parameters',
        'get_parameter_types',
        'get_parameters',
        'get_type_description',
        'list_parameters',
        'set_parameters',
        'set_parameters_atomically',
    )
)
LIFECYCLE = tuple(
    f'~/{name}'
    for name in (
        'change_state',
        'get_available_states',
        'get_available_transitions',
        'get_state',
        'get_transition_graph',
    )
)
SERVICES = {
    'feedrate_scheduler': ('schedule_program',),
    'sensor_selector': ('select_sensors',),
    'temperature_acquisition': ('set_thermal_reference',),
    'thermal_predictor': ('forget_thermal_posterior',),
}
ACTIONS = {
    'thermal_predictor': ('train_thermal_model',),
    'joint_trajectory_bridge': ('follow_joint_trajectory',),
}
DRIVERS = {
    'temperature_acquisition': ('sensor_readings', 'spindle_speed'),
    'probe_cycle': ('probe_touch',),
}
"""Topics that drivers publish on behalf of a machine."""
VIEWED = {
    'temperature_acquisition': ('temperature/*',),
    'joint_trajectory_bridge': ('/tf', '/tf_static'),
}
"""Topics that viewers of ROS read, beside those of the components."""
ASKED = {'joint_trajectory_bridge': ('joint_trajectory',)}
"""Topics that tools of ROS publish for a node, beside those of the components."""
PROVENANCE = ('node_configuration', 'node_event', 'deadline_fired')
EVERYTHING = '*'
"""All topics of the machine: a pattern as of file names, in which `*` stands for slashes too."""


@dataclass(frozen=True, kw_only=True)
class Access:
    """Permissions of a node; everything else is forbidden."""

    publish: tuple[str, ...]
    subscribe: tuple[str, ...] = ()
    reply: tuple[str, ...] = ()
    """Services that it offers."""
    request: tuple[str, ...] = ()
    """Services that it calls."""
    execute: tuple[str, ...] = ()
    """Actions that it offers."""
    call: tuple[str, ...] = ()
    """Actions that it calls."""


def access_of(node: str) -> Access:
    """Return what a node may do.

    Parameters
    ----------
    node : str
        A component's node, or one of `TOOLS`.

    Raises
    ------
    ValueError
        If there is no such node.
    """
    if node in COMPONENTS:
        return _component(COMPONENTS[node])
    own = ('/rosout', '/parameter_events')
    if node == RECORDER:
        return Access(
            publish=('recorder/progress', 'tick_answer', '/diagnostics', *own),
            # Its own turns are topics of the machine too.
            subscribe=(EVERYTHING, '/clock', '/diagnostics'),
            reply=PARAMETERS,
        )
    if node == PLAYER:
        return Access(
            publish=(EVERYTHING, '/clock', '/diagnostics', *own),
            subscribe=('tick_answer', '/clock'),
            reply=PARAMETERS,
        )
    if node == OPERATOR:
        return Access(
            publish=('displacement', 'servo_trial', 'node_event', *own),
            subscribe=(EVERYTHING, '/clock', '/diagnostics'),
            reply=PARAMETERS,
            request=_offered(),
            call=tuple(name for names in ACTIONS.values() for name in names),
        )
    if node in {MQTT, MTCONNECT, OPCUA}:
        return Access(
            publish=('/diagnostics', *own),
            subscribe=(*REPORTED, '/clock', '/diagnostics'),
            reply=PARAMETERS,
        )
    if node == DASHBOARD:
        managed = [name for name, item in COMPONENTS.items() if item.MANAGED]
        return Access(
            publish=('displacement', 'node_event', '/diagnostics', *own),
            subscribe=(*SOURCES, 'node_configuration', '/clock', '/diagnostics'),
            reply=PARAMETERS,
            request=(
                'set_thermal_reference',
                'forget_thermal_posterior',
                *(f'{name}/{call}' for name in managed for call in ('change_state', 'get_state')),
            ),
        )
    raise ValueError(
        f'expected a node among {", ".join((*COMPONENTS, *TOOLS))} but found {node!r}'
    )


def _component(component: type[Component]) -> Access:
    name = component.NAME
    publish = [item.name for item in component.OUTPUTS]
    publish += [*DRIVERS.get(name, ()), *VIEWED.get(name, ()), *PROVENANCE, '/diagnostics']
    subscribe = [*(item.name for item in component.INPUTS), *ASKED.get(name, ()), '/clock']
    if name == 'simulated_machine':
        publish += [f'machine_tick/{other}' for other in (*COMPONENTS, RECORDER) if _turns(other)]
        subscribe += ['tick_answer']
    elif _turns(name):
        publish += ['tick_answer']
        subscribe += [f'machine_tick/{name}']
    if name in PRETENDERS:
        publish += ['/clock']
    publish += ['/rosout', '/parameter_events']
    if component.MANAGED:
        publish += ['~/transition_event']
    return Access(
        publish=tuple(publish),
        subscribe=tuple(subscribe),
        reply=(*SERVICES.get(name, ()), *PARAMETERS, *(LIFECYCLE if component.MANAGED else ())),
        execute=ACTIONS.get(name, ()),
    )


def _turns(node: str) -> bool:
    """Return True if a node takes turns in a lock-step run; machines make its time."""
    return node not in PRETENDERS


def _offered() -> tuple[str, ...]:
    """Return the services of all nodes, as another node of the machine calls them."""

    def seen(node: str, names: Iterable[str]) -> tuple[str, ...]:
        return tuple(name.replace('~', node, 1) for name in names)

    found = [name for names in SERVICES.values() for name in names]
    for name, component in COMPONENTS.items():
        found += seen(name, PARAMETERS)
        found += seen(name, LIFECYCLE if component.MANAGED else ())
    return tuple(found)
