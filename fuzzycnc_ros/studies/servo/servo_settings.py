# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a controller's universes, and rules that are learnt, as a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fuzzycnc_ros.core.servo.controller import AxisController
    from fuzzycnc_ros.core.servo.rule_table import RuleTable

_KEYS = ('axis', 'settings', 'rules', 'about')


@dataclass(frozen=True, eq=False)
class ServoSettings:
    """Settings of a settings file.

    Parameters
    ----------
    path : Path
        The file.
    axis : str
        Axis that the settings are for; empty if the file does not say.
    numbers : mapping of str to float
        Settings by name, in SI.
    rules : RuleTable, optional
        Rules instead of the published ones.
    """

    path: Path
    axis: str = ''
    numbers: Mapping[str, float] = field(default_factory=dict)
    rules: RuleTable | None = None

    def controller(self, name: str, axis: str) -> AxisController:
        """Return the controller of a name for a built-in axis with these settings."""
        from fuzzycnc_ros.core.servo.axis_control import DISTURBANCE, WITH_RULES
        from fuzzycnc_ros.core.servo.built_in import built_in_controller

        try:
            if DISTURBANCE in self.numbers and name != WITH_RULES:
                raise ValueError(
                    f'{DISTURBANCE}: expected with {WITH_RULES}, which has an observer, alone '
                    'but found it'
                )
            return built_in_controller(axis, name, self.numbers, self.rules)
        except ValueError as error:
            raise ValueError(f'{self.path}: {error}') from error

    def check(self, controller: AxisController) -> None:
        """Refuse settings whose loop does not settle near the target at the nominal gain.

        Raises
        ------
        ValueError
            If it does not.
        """
        from fuzzycnc_ros.core.servo.stability import stability_report
        from fuzzycnc_ros.core.servo.variable_universe import VariableUniverseController

        if not isinstance(controller, VariableUniverseController):
            return
        radius = stability_report(controller, gains=(1.0,)).spectral_radius[1.0]
        # an integral or the model's own integrator lies on 1 but for rounding
        if radius > 1.0 + 1e-6:
            raise ValueError(
                f'{self.path}: expected settings with which the axis settles but found a loop '
                f'that swings, spectral radius {radius:.4f}; `fuzzycnc servo stability` shows '
                'the margins'
            )


def read_settings(path: Path) -> ServoSettings:
    """Read a file of settings, YAML or JSON.

    Raises
    ------
    ValueError
        If it is none; the message names the file and what is wrong.
    """
    from fuzzycnc_ros.core.servo.axis_control import DISTURBANCE, UNIVERSES
    from fuzzycnc_ros.core.servo.rule_table import RuleTable
    from fuzzycnc_ros.files.yaml_file import YamlReading

    wanted = "'settings' or 'rules', or both"
    reading = YamlReading(path, f'a file with {wanted}')
    found = reading.top(wanted)
    if 'axes' in found:
        raise ValueError(
            f"{path}: expected 'settings' or 'rules' but found the axes of a machine file, which "
            'has the settings of its controllers; give it as machine file'
        )
    reading.known(found, _KEYS, '')
    if not found.keys() & {'settings', 'rules'}:
        raise ValueError(f'{path}: expected {wanted}, but found neither')
    numbers = reading.section(found, 'settings')
    reading.known(numbers, (*UNIVERSES, DISTURBANCE), 'settings')
    rules = None
    if 'rules' in found:
        table = reading.section(found, 'rules')
        reading.known(table, ('centres', 'values'), 'rules')
        try:
            rules = RuleTable(
                tuple(map(float, reading.plain(table['centres']))),
                tuple(tuple(map(float, row)) for row in reading.plain(table['values'])),
            )
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise reading.wrong(
                found['rules'].line,
                'rules',
                f'expected centres and a square table of numbers: {error}',
            ) from error
    return ServoSettings(
        path,
        str(reading.value(found['axis'])) if 'axis' in found else '',
        {name: reading.number(entry, f'settings.{name}') for name, entry in numbers.items()},
        rules,
    )


def rules_text(path: Path, axis: str, rules: RuleTable, about: str) -> str:
    """Return the text of a file of rules: JSON if the path is called that, else YAML."""
    document = {
        'about': about,
        'axis': axis,
        'rules': {
            'centres': list(rules.centres),
            'values': [[round(value, 6) for value in row] for row in rules.values],
        },
    }
    if path.suffix.lower() == '.json':
        return json.dumps(document, indent=2) + '\n'
    import yaml

    text: str = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99)
    return text
