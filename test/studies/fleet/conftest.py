# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A shop of two machines, and a model."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from fleet_bags import DAY, FIRST_DAY, warm_up, write_bag
from kept import kept

from fuzzycnc_ros.core.thermal.fit import train_model

CANDIDATES = ('static_ridge', 'lag_ridge')


@kept
def fleet_model() -> str:
    """Return the text of a model of both machines."""
    runs = [warm_up(1, samples=120), warm_up(2, samples=120)]
    return train_model(runs, candidates=CANDIDATES).to_json()


class Shop(NamedTuple):
    """Folders and files of a shop."""

    archive: Path
    model: Path
    out: Path


@pytest.fixture(scope='session')
def archive(tmp_path_factory):
    """Six bags of two machines; nobody may change them."""
    folder = tmp_path_factory.mktemp('archive')
    for number in range(6):
        machine = f'mill_{number % 2 + 1}'
        begin = FIRST_DAY + (number // 2) * DAY
        path = folder / machine / f'day_{number // 2}'
        write_bag(warm_up(10 + number, samples=60), path, begin, machine)
    return folder


@pytest.fixture
def shop(archive, tmp_path):
    """A copy of the bags, the model beside them, and where the table goes."""
    shutil.copytree(archive, tmp_path / 'archive')
    model = tmp_path / 'mill.json'
    model.write_text(fleet_model(), encoding='utf-8')
    return Shop(tmp_path / 'archive', model, tmp_path / 'shop.parquet')
