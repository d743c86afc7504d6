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

from fuzzycnc_ros.cli.console import check_new_folder
from fuzzycnc_ros.cli.live.graph_processes import GraphProcesses
from fuzzycnc_ros.graph.bring_up import PAGE, NodeSpec
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.ros.arguments import understood
from fuzzycnc_ros.ros.bag_node import check_keeping
from fuzzycnc_ros.ros.node_config import DashboardConfig, HostConfig, RecorderConfig
from fuzzycnc_ros.ros.parameters import ParameterError, declare
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.processes import RANGE, prepare_environment
from fuzzycnc_ros.ros.state_file import StateDirectory, StateFileError
from fuzzycnc_ros.web.keys import check_pair, read_token


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


def page_parameters(arguments: list[str]) -> DashboardConfig:
    """Read and check the parameters of the live page.

    Raises
    ------
    GraphError
        If it would refuse them; the text names the parameter.
    """
    try:
        with _apart() as context, _made(PAGE, arguments, context) as node:
            (config,) = declare(node, DashboardConfig)
            if config.token_file:
                read_token(Path(config.token_file).expanduser())
            if config.certificate:
                check_pair(
                    Path(config.certificate).expanduser(), Path(config.private_key).expanduser()
                )
    except ValueError as error:
        raise GraphError(f'{PAGE}: {error}') from error
    return config


@contextmanager
def _made(name: str, arguments: list[str], context: rclpy.Context) -> Iterator[Node]:
    """Give a node of a name and its parameters."""
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
        yield node
    finally:
        node.destroy_node()


def _check(name: str, arguments: list[str], context: rclpy.Context) -> None:
    """Do what a node does with its parameters.

    Raises
    ------
    ValueError
        If it would refuse them.
    """
    with _made(name, arguments, context) as node:
        if name == 'recorder':
            (recorder,) = declare(node, RecorderConfig)
            check_keeping(recorder)
            check_new_folder(Path(recorder.output))
            return
        host, config = declare(node, HostConfig, COMPONENTS[name].CONFIG)
        component = COMPONENTS[name](config)
        try:
            StateDirectory(host.state_directory, node.get_fully_qualified_name())
        except StateFileError as error:
            raise ParameterError(str(error)) from error
        use_files = getattr(import_module(f'fuzzycnc_ros.nodes.{name}'), 'use_files', None)
        if use_files is not None:
            use_files(component)
