# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Start the thermal compensation of one machine, and on request its feedrate scheduler."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, RegisterEventHandler
from launch.conditions import IfCondition
from launch.events import matches_action
from launch.substitutions import AndSubstitution, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition

PACKAGE = 'fuzzycnc_ros'
NODES = ('temperature_acquisition', 'sensor_selector', 'thermal_predictor')


def generate_launch_description() -> LaunchDescription:
    machine = LaunchConfiguration('machine')
    params = LaunchConfiguration('params_dir')
    sim_time = {
        'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)
    }

    def common(name: str) -> dict:
        return {
            'package': PACKAGE,
            'executable': name,
            'name': name,
            'namespace': machine,
            'output': 'screen',
        }

    def all_true(*arguments: str) -> IfCondition:
        """Whether all these launch arguments are true."""
        value = LaunchConfiguration(arguments[0])
        for argument in arguments[1:]:
            value = AndSubstitution(value, LaunchConfiguration(argument))
        return IfCondition(value)

    def params_file(name: str) -> PathJoinSubstitution:
        return PathJoinSubstitution([params, f'{name}.yaml'])

    def managed(name: str, *only_if: str) -> list:
        """A managed node, configured and activated once where `autostart` says so."""
        node = LifecycleNode(
            **common(name),
            # The transitions are made below, so that a manual deactivation is not undone.
            parameters=[params_file(name), sim_time, {'autostart': False}],
            condition=all_true(*only_if) if only_if else None,
        )

        def change(transition: int, condition: IfCondition | None = None) -> EmitEvent:
            event = ChangeState(
                lifecycle_node_matcher=matches_action(node), transition_id=transition
            )
            return EmitEvent(event=event, condition=condition)

        wanted = all_true('autostart', *only_if)
        activate_once = RegisterEventHandler(
            OnStateTransition(
                target_lifecycle_node=node,
                start_state='configuring',
                goal_state='inactive',
                entities=[change(Transition.TRANSITION_ACTIVATE)],
            ),
            condition=wanted,
        )
        return [activate_once, node, change(Transition.TRANSITION_CONFIGURE, wanted)]

    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'machine', default_value='mill', description='Namespace: the name of the machine'
            ),
            DeclareLaunchArgument(
                'simulated',
                default_value='true',
                choices=['true', 'false'],
                description='Start the simulated machine; false: a bridge of a real one runs',
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value=LaunchConfiguration('simulated'),
                description='Take the time from /clock, which the simulated machine publishes',
            ),
            DeclareLaunchArgument(
                'params_dir',
                default_value=str(Path(get_package_share_directory(PACKAGE), 'params')),
                description='Folder with one parameter file per node, <node>.yaml',
            ),
            DeclareLaunchArgument(
                'autostart',
                default_value=LaunchConfiguration('simulated'),
                description='Configure and activate the managed nodes; '
                'by default only where the machine is simulated',
            ),
            DeclareLaunchArgument(
                'feedrate',
                default_value='false',
                choices=['true', 'false'],
                description='Start the feedrate scheduler too, which runs tool paths',
            ),
            DeclareLaunchArgument(
                'deformation',
                default_value='false',
                choices=['true', 'false'],
                description='Start the deformation compensator too, which shifts patterns on soft '
                'material for the feedrate scheduler',
            ),
            DeclareLaunchArgument(
                'linuxcnc',
                default_value='false',
                choices=['true', 'false'],
                description='Start the bridge to the LinuxCNC of this computer; simulated:=false',
            ),
            DeclareLaunchArgument(
                'opcua',
                default_value='false',
                choices=['true', 'false'],
                description='Start the bridge to a control with OPC UA; simulated:=false',
            ),
            LogInfo(
                msg='fuzzycnc is not a safety function (ISO 13849): emergency stop, limit '
                'switches and drive limits stay in hardware.'
            ),
            Node(
                **common('simulated_machine'),
                parameters=[params_file('simulated_machine')],
                condition=IfCondition(LaunchConfiguration('simulated')),
            ),
            *[Node(**common(name), parameters=[params_file(name), sim_time]) for name in NODES],
            *managed('linuxcnc_bridge', 'linuxcnc'),
            *managed('opcua_bridge', 'opcua'),
            *managed('compensator'),
            *managed('feedrate_scheduler', 'feedrate'),
            *managed('deformation_compensator', 'deformation'),
        ]
    )
