# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A real LinuxCNC without a screen, for one test at a time of the whole machine."""

import contextlib
from collections.abc import Iterator

import pytest

from fuzzycnc_ros.adapters.linuxcnc import simulation as linuxcnc_simulation
from fuzzycnc_ros.adapters.linuxcnc.component import COMPONENT, install_component
from fuzzycnc_ros.adapters.linuxcnc.control import LinuxcncError
from fuzzycnc_ros.adapters.linuxcnc.simulation import LinuxcncSimulation as LinuxcncMachine

__all__ = ['LinuxcncMachine', 'exclusive']


@contextlib.contextmanager
def exclusive(*, slopes: bool = False) -> Iterator[None]:
    """Keep other tests of this machine away from LinuxCNC; skip where there is none to be had.

    Parameters
    ----------
    slopes : bool
        Whether the component `fuzzycnc_offset` is needed: it is built from the sources.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(linuxcnc_simulation.exclusive())
            if slopes:
                install_component(linuxcnc_simulation.shipped(f'{COMPONENT}.comp'))
        except LinuxcncError as error:
            pytest.skip(str(error))
        yield
