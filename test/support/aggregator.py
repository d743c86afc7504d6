# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The example of analyzers for diagnostic_aggregator, and what its GenericAnalyzer matches."""

from pathlib import Path
from typing import Any

import yaml

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'diagnostic_aggregator.yaml'


def analyzers() -> dict[str, dict[str, Any]]:
    """Return the analyzers of the example by their path, those of groups too."""
    parameters = yaml.safe_load(EXAMPLE.read_text())['analyzers']['ros__parameters']

    def found(items: dict[str, Any], above: str) -> dict[str, dict[str, Any]]:
        every = {}
        for item in items.values():
            if isinstance(item, dict):
                path = f'{above}/{item["path"]}'
                if item['type'] == 'diagnostic_aggregator/AnalyzerGroup':
                    every |= found(item['analyzers'], path)
                else:
                    assert item['type'] == 'diagnostic_aggregator/GenericAnalyzer', item
                    every[path] = item
        return every

    return found(parameters, f'/{parameters["path"]}')


def matching(name: str) -> list[str]:
    """Return the paths of the analyzers that take a status of this name."""
    return [
        path
        for path, item in analyzers().items()
        if any(name.startswith(start) for start in item['startswith'])
    ]
