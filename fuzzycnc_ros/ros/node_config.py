# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes themselves, beside those of their components; needs no ROS."""

from dataclasses import dataclass

from fuzzycnc_ros.core.config import Config, param


@dataclass(frozen=True, kw_only=True)
class ExecutorConfig(Config):
    """Parameters of every node."""

    executor: str = param(
        'lean',
        '-',
        "Executor of the process: the package's own, or the slower SingleThreadedExecutor of "
        'rclpy',
        choices=('lean', 'rclpy'),
    )


@dataclass(frozen=True, kw_only=True)
class HostConfig(ExecutorConfig):
    """Parameters of every node that serves a component."""

    machine: str = param(
        '', '-', 'Name of the machine in frame ids; empty takes the namespace of the node'
    )
    lockstep: bool = param(
        False, '-', 'Work only in turns given by a sequencer (simulated_machine)'
    )
    stamp_ahead_max: float = param(
        60.0,
        's',
        "Time by which a stamp may be ahead of the node's clock, 60 times as much with "
        'use_sim_time; 0 is any',
        low=0.0,
        high=1e9,
    )
    state_directory: str = param(
        '', '-', 'Directory for state that survives a restart; empty keeps none'
    )


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(ExecutorConfig):
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
    split_size: int = param(
        0, 'B', 'Size after which a part of the bag is full; 0 for never', low=0, high=2**50
    )
    split_duration: float = param(
        0.0, 's', 'Log time after which a part of the bag is full; 0 for never', low=0.0, high=1e9
    )
    budget: int = param(
        0,
        'B',
        'Size of the bag beyond which its oldest parts are deleted, with ship only those that '
        'have arrived; 0 for never',
        low=0,
        high=2**50,
    )
    free_min: int = param(
        200_000_000,
        'B',
        'Free space on the disk below which nothing is written until there is more; 0 to write '
        'as long as it goes',
        low=0,
        high=2**50,
    )
    ship: str = param(
        '',
        '-',
        'Folder or URL of fsspec, such as s3://bucket/mill, that closed parts are copied to; no '
        'password in it',
    )


@dataclass(frozen=True, kw_only=True)
class PlayerConfig(ExecutorConfig):
    """Parameters of `player`."""

    bag: str = param('', '-', 'Bag to play: a directory of rosbag2, or a single .mcap file')
    topics: str = param(
        '', '-', 'Regular expression of the recorded topics to play; empty takes all'
    )
    exclude: str = param(
        r'/machine_tick/|/(tick_answer|recorder/progress|diagnostics|rosout|parameter_events|'
        r'node_configuration|node_event|deadline_fired|transition_event)$|/_',
        '-',
        'Regular expression of topics to leave out; /clock is always made by the player',
    )
    start: float = param(
        0.0, 's', 'Where to start, from the beginning of the bag', low=0.0, high=1e9
    )
    end: float = param(
        0.0,
        's',
        'Where to stop, from the beginning of the bag; 0 plays to the end',
        low=0.0,
        high=1e9,
    )
    rate: float = param(1.0, '-', 'Speed without lock-step; 1 is real time', low=0.01, high=1e4)
    start_delay: float = param(
        0.5, 's', 'Wall time for readers to find the topics, without lock-step', low=0.0, high=60.0
    )
    loop: bool = param(
        False, '-', 'Start again at the end, until interrupted; needs restamp to have an effect'
    )
    restamp: bool = param(
        False,
        '-',
        'Move the header stamps of each repetition on, so that readers take them as new; times '
        'inside of messages stay',
    )
    keep_namespace: bool = param(
        True, '-', "Publish under the recorded names; otherwise in the player's own namespace"
    )
    lockstep: bool = param(
        False, '-', 'Play as fast as the nodes answer, as the machine of a lock-step run'
    )
    tick_period: float = param(
        0.0,
        's',
        'Time between two ticks in lock-step; 0 ticks at every stamp',
        low=0.0,
        high=3600.0,
    )
    lockstep_nodes: tuple[str, ...] = param(
        ('temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator'),
        '-',
        'Nodes that get their turn in every tick of a lock-step run, in this order',
    )
    lockstep_recorder: bool = param(
        False, '-', 'Whether a lock-step run waits for the recorder every 500 ticks'
    )
    answer_timeout: float = param(
        1.0,
        's',
        'Wall time after which a silent node of a lock-step run is lost',
        low=0.05,
        high=60.0,
    )


@dataclass(frozen=True, kw_only=True)
class MqttPublisherConfig(ExecutorConfig):
    """Parameters of `mqtt_publisher`."""

    broker_file: str = param(
        '', '-', 'File that says where the broker is and how the way to it is secured; required'
    )


@dataclass(frozen=True, kw_only=True)
class MtconnectAdapterConfig(ExecutorConfig):
    """Parameters of `mtconnect_adapter`."""

    listen: str = param(
        '127.0.0.1',
        '-',
        'Address to serve agents at; SHDR has no encryption and no login',
    )
    port: int = param(
        7878, '-', 'TCP port to serve agents at; 0 takes a free one', low=0, high=65535
    )
    devices_file: str = param(
        '',
        '-',
        'File of devices that is written for the agent when no new data item has come for 5 s; '
        'empty: none',
    )
    age_max: float = param(
        150.0,
        's',
        'Age beyond which a value is UNAVAILABLE; longer than the sampling interval',
        low=0.1,
        high=86400.0,
    )


@dataclass(frozen=True, kw_only=True)
class OpcuaServerConfig(ExecutorConfig):
    """Parameters of `opcua_server`."""

    listen: str = param(
        '127.0.0.1',
        '-',
        'Address to serve at; any that other computers reach needs certificate, private_key and '
        'credentials',
    )
    port: int = param(4840, '-', 'TCP port; 0 takes a free one', low=0, high=65535)
    certificate: str = param('', '-', 'File with the own certificate, DER or PEM')
    private_key: str = param('', '-', 'File with the key of the own certificate')
    credentials: str = param(
        '',
        '-',
        'File with username and password of those who may read, readable by its owner only',
    )
    age_max: float = param(
        150.0,
        's',
        'Age beyond which a value has a bad status; longer than the sampling interval',
        low=0.1,
        high=86400.0,
    )


OWN_FOLDER = '~/.fuzzycnc/dashboard'
"""Folder of the live page's token and certificate."""


@dataclass(frozen=True, kw_only=True)
class DashboardConfig(ExecutorConfig):
    """Parameters of `dashboard`."""

    listen: str = param(
        '127.0.0.1',
        '-',
        'Address to serve the page at; beyond this computer encrypted, and acting needs the token',
    )
    port: int = param(
        8642, '-', 'Port to serve the page at; 0 takes a free one', low=0, high=65535
    )
    hosts: tuple[str, ...] = param(
        (), '-', 'Further names of this computer by which browsers may ask for the page'
    )
    interval: float = param(
        1.0, 's', 'Time between two views of a machine on the page', low=0.2, high=60.0
    )
    bags: str = param(
        '',
        '-',
        'Folder of recordings started on the page, and of bags to download; empty for none',
    )
    state_directory: str = param(
        '',
        '-',
        'Directory of certificate and token that are made at the first start; empty takes '
        '~/.fuzzycnc/dashboard',
    )
    token_file: str = param(
        '',
        '-',
        'File with the token for acting; empty: one is made where other computers reach the page',
    )
    certificate: str = param(
        '',
        '-',
        'File with a certificate in PEM; empty: one of its own where others reach the page',
    )
    private_key: str = param('', '-', 'File with the key of the certificate in PEM')
    forget_after: float = param(
        86400.0,
        's',
        'Time after which a machine without data is no longer shown',
        low=60.0,
        high=1e7,
    )
