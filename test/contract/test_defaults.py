# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that train do by default what the library does."""

import inspect

import pytest

from fuzzycnc_ros.cli.models.compare import compare
from fuzzycnc_ros.cli.models.train import train
from fuzzycnc_ros.core.thermal.fit import train_model

NAMES = {
    'interval': 'interval',
    'sensors': 'sensors',
    'clusters': 'n_clusters',
    'speed': 'spindle_speed',
    'seed': 'random_state',
}


@pytest.mark.parametrize('command', [train, compare])
def test_options_have_the_defaults_of_the_library(command):
    told = inspect.signature(command).parameters
    own = inspect.signature(train_model).parameters
    assert {name: told[name].default for name in NAMES} == {
        name: own[other].default for name, other in NAMES.items()
    }
