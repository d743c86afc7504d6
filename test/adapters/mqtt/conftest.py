# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import pytest
from equipment.mqtt_broker import MqttBroker


@pytest.fixture
def serve(tmp_path):
    """Start a broker."""
    made = []

    def of(**security):
        made.append(MqttBroker(tmp_path, **security))
        made[-1].start()
        return made[-1]

    yield of
    for broker in made:
        broker.close()
