# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc fleet`: thousands of bags of many machines."""

from collections.abc import Callable
from typing import Any

from fuzzycnc_ros.cli.fleet.evaluate import evaluate, report
from fuzzycnc_ros.cli.fleet.machines import compare, train
from fuzzycnc_ros.cli.fleet.prior import prior

HELP = """Train, compare, evaluate and report over thousands of bags of many machines.

Work goes to processes of this host, or with --dask to the workers of a Dask scheduler. Figures
are the same to the last bit wherever they are computed. It needs the extra `fleet`.

    fuzzycnc fleet train archive --out models
    fuzzycnc fleet evaluate archive --model models --out shop.parquet
    fuzzycnc fleet report shop.parquet --out shop.html
"""

COMMANDS: dict[str, Callable[..., Any]] = {
    'evaluate': evaluate,
    'train': train,
    'compare': compare,
    'prior': prior,
    'report': report,
}
