# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a graph, refused as its nodes would refuse them, before the first is started."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import rclpy
from rclpy.node import Node
from yaml.nodes import MappingNode
from yaml.nodes import Node as YamlNode

from fuzzycnc_ros.bags.yaml_file import compose
from fuzzycnc_ros.cli.console import check_new_folder
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.arguments import understood
from fuzzycnc_ros.ros.bag_node import check_keeping
from fuzzycnc_ros.ros.bring_up import NodeSpec
from fuzzycnc_ros.ros.parameters import ParameterError, declare
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.processes import RANGE, prepare_environment
from fuzzycnc_ros.ros.state_file import StateDirectory, StateFileError
from fuzzycnc_ros.runtime.host import HostConfig, RecorderConfig

_PARAMETERS = 'ros__parameters'


def check_files(files: Sequence[Path]) -> None:
    """Refuse files that are no YAML or hold no parameters, in which ROS finds less to name.

    Raises
    ------
    ValueError
        If one is none; the message names the line.
    """
    for file in files:
        root = compose(file, 'a ROS parameter file')
        for key, value in root.value if isinstance(root, MappingNode) else ():
            if not _has_parameters(value):
                raise ValueError(
                    f'{file}: line {key.start_mark.line + 1}: expected `/**/NODE:` with '
                    f'`{_PARAMETERS}:` below it but found `{key.value}:`; keep device files and '
                    'others outside of the folder of parameter files'
                )


def _has_parameters(node: YamlNode) -> bool:
    """Whether the parameters of a node are somewhere below this one."""
    if not isinstance(node, MappingNode):
        return False
    return any(key.value == _PARAMETERS or _has_parameters(value) for key, value in node.value)


def check_parameters(
    graphs: Sequence[GraphProcesses], plans: Sequence[Sequence[tuple[NodeSpec, ...]]]
) -> None:
    """Read and check the parameters of all nodes by the declarations that the nodes use.

    Raises
    ------
    GraphError
        If a node would refuse them; the text names machine, node and parameter.
    """
    with _apart() as context:
        for graph, plan in zip(graphs, plans, strict=True):
            for group in plan:
                arguments = graph.arguments(*group)
                for spec in group:
                    try:
                        _check(spec.name, arguments, context)
                    except ValueError as error:
                        raise GraphError(f'{graph.machine}/{spec.name}: {error}') from error


@contextmanager
def _apart() -> Iterator[rclpy.Context]:
    """Give a context whose nodes nobody finds, and which find nobody."""
    prepare_environment()
    chosen, context = os.environ.get(RANGE), rclpy.Context()
    os.environ[RANGE] = 'OFF'
    try:
        rclpy.init(context=context)
    finally:
        os.environ.pop(RANGE)
        if chosen is not None:
            os.environ[RANGE] = chosen
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def _check(name: str, arguments: list[str], context: rclpy.Context) -> None:
    """Do what a node does with its parameters.

    Raises
    ------
    ValueError
        If it would refuse them.
    """
    with understood(arguments) as words:
        node = Node(
            name,
            context=context,
            cli_args=words,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
    try:
        if name == 'recorder':
            (recorder,) = declare(node, RecorderConfig)
            check_keeping(recorder)
            check_new_folder(Path(recorder.output))
            return
        host, config = declare(node, HostConfig, COMPONENTS[name].CONFIG)
        component = COMPONENTS[name](config)
        StateDirectory(host.state_directory, node.get_fully_qualified_name())
        use_files = getattr(import_module(f'fuzzycnc_ros.nodes.{name}'), 'use_files', None)
        if use_files is not None:
            use_files(component)
    except StateFileError as error:
        raise ParameterError(str(error)) from error
    finally:
        node.destroy_node()
