# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes themselves, beside those of their components.

They are declared here, apart from the nodes, so that `params/*.yaml` and the tables of the docs
are made where ROS is not installed.
"""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class HostConfig(Config):
    """Parameters of every node that serves a component."""

    machine: str = param(
        '', '-', 'Name of the machine in frame ids; empty takes the namespace of the node'
    )
    lockstep: bool = param(
        False, '-', 'Work only in turns given by a sequencer (simulated_machine)'
    )
    state_directory: str = param(
        '', '-', 'Directory for state that survives a restart; empty keeps none'
    )


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(Config):
    """Parameters of `recorder`."""

    output: str = param('', '-', 'Directory of the new bag; must not exist')
    topics: str = param(
        '', '-', 'Regular expression of the topics to record; empty takes all of the namespace'
    )
    exclude: str = param(
        '/(tick_answer|recorder/progress|rosout|parameter_events)$|/_',
        '-',
        'Regular expression of topics to leave out',
    )
    lockstep: bool = param(
        False, '-', 'Take turns in a lock-step run, and log by message stamp instead of wall time'
    )
