# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Devices as all drivers know them: their values, and how to connect to them."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from fuzzycnc_ros.adapters.readings.link import Link
from fuzzycnc_ros.core.thermal.ntc import Ntc

SPINDLE = 'spindle_speed'
"""Field, and name, of the channel that holds the spindle speed."""


@dataclass(frozen=True, kw_only=True)
class DeviceChannel:
    """One value of a device: quantity = scale * raw + offset.

    Parameters
    ----------
    name : str
        Name of the sensor.
    scale, offset : float
        From the raw value to degC, for the spindle to rad/s, for an axis to m or rad.
    open_circuit : tuple of numbers
        Raw values by which the device says that no sensor is connected.
    largest : float
        Size beyond which a value is none; for the spindle, rad/s.
    ntc : Ntc, optional
        Thermistor that the raw value comes from; scale and offset then correct its temperature.
    limits : tuple of (str, float)
        Limits of the sensor in place of those of all, see `SensorLimits`.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    open_circuit: tuple[int | float, ...] = ()
    largest: float = math.inf
    ntc: Ntc | None = None
    limits: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Device(ABC):
    """Base of all devices.

    Parameters
    ----------
    name : str
        Name of the device in messages.
    period : float
        Time between two readings [s].
    timeout : float
        Longest wait for an answer [s].
    channels : tuple of DeviceChannel
        Sensors in the order of the file, then axes, the spindle speed last.
    has_spindle : bool
        Whether the last channel is the spindle speed.
    axes : tuple of str
        Names of the axes whose positions are read.
    """

    name: str
    period: float
    timeout: float
    channels: tuple[DeviceChannel, ...]
    has_spindle: bool
    axes: tuple[str, ...] = ()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        count = len(self.channels) - len(self.axes) - self.has_spindle
        return tuple(channel.name for channel in self.channels[:count])

    @property
    @abstractmethod
    def address(self) -> str:
        """Address for messages."""

    @abstractmethod
    def connect(self) -> Link:
        """Return a new link to it, not yet open."""

    def check(self) -> None:  # noqa: B027
        """Check what only its driver can check, before any thread is started.

        Raises
        ------
        ParameterError
            If a library is missing, or a secret is of no use.
        """
