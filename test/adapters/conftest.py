# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import time

import pytest


@pytest.fixture
def poll_file(tmp_path):
    """Poll the devices of a file with this text."""
    from equipment.polled import close

    from fuzzycnc_ros.adapters.readings.device_file import read_devices
    from fuzzycnc_ros.adapters.readings.polling import Poller

    pollers = []

    def begin(text):
        path = tmp_path / f'devices-{len(pollers)}.yaml'
        path.write_text(text)
        devices = read_devices(path)
        for device in devices:
            device.check()
        pollers.append(Poller(devices, time.monotonic_ns))
        return pollers[-1]

    yield begin
    for poller in pollers:
        close(poller)


@pytest.fixture
def refused_file(tmp_path):
    """Return the one line by which the text of a device file is refused."""
    from fuzzycnc_ros.adapters.readings.device_file import read_devices
    from fuzzycnc_ros.ros.parameters import ParameterError

    def line(text):
        path = tmp_path / 'refused.yaml'
        path.write_text(text)
        with pytest.raises(ParameterError) as caught:
            all_checked(path)
        return str(caught.value)

    def all_checked(path):
        for device in read_devices(path):
            device.check()

    return line
