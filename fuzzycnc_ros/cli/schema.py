# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc schema`: JSON Schemas of configuration files, for editors."""

import json
from typing import Annotated, Any

import typer

from fuzzycnc_ros.cli.completion import one_of
from fuzzycnc_ros.cli.console import check_folder, say, write_text
from fuzzycnc_ros.cli.options import OptionalPath, given

KINDS = ('devices', 'control', 'machine', 'broker', 'thermal-test', 'probe')
"""Files that have a schema."""

DIALECT = 'https://json-schema.org/draft/2020-12/schema'


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            metavar='|'.join(KINDS),
            help='Which file the schema is of.',
            autocompletion=one_of(KINDS),
        ),
    ],
    out: Annotated[OptionalPath, given('Write it here.', metavar='FILE.json')] = None,
) -> None:
    """Print the JSON Schema of a configuration file, so that editors complete and check it.

    Editors with a YAML language server take it from the first line of the file:
    # yaml-language-server: $schema=machine.schema.json

        fuzzycnc schema machine --out machine.schema.json
        fuzzycnc schema devices --out devices.schema.json
        fuzzycnc schema control --out control.schema.json
        fuzzycnc schema broker --out broker.schema.json
        fuzzycnc schema thermal-test --out thermal-test.schema.json
        fuzzycnc schema probe --out probe.schema.json
    """
    check_folder(out)
    if kind not in KINDS:
        raise ValueError(f'schema: expected one of {", ".join(KINDS)} but found {kind!r}')
    text = json.dumps(_schema(kind), indent=2, ensure_ascii=False, allow_nan=False)
    if out is None:
        for line in text.splitlines():
            say(line)
        return
    write_text(out, text + '\n')
    say(f'{out}: the schema of files of kind {kind}')


def _schema(kind: str) -> dict[str, Any]:
    if kind == 'machine':
        from fuzzycnc_ros.machine_file.schema import machine_schema

        return machine_schema()
    if kind == 'devices':
        from fuzzycnc_ros.adapters.readings.device_file import DeviceFile

        found = DeviceFile.model_json_schema()
    elif kind == 'broker':
        from fuzzycnc_ros.adapters.mqtt.broker_file import BrokerFile

        found = BrokerFile.model_json_schema()
    elif kind == 'thermal-test':
        from fuzzycnc_ros.cli.reports.thermal_test_file import ThermalTestFile

        found = ThermalTestFile.model_json_schema()
    elif kind == 'probe':
        from fuzzycnc_ros.adapters.probing.probe_file import ProbeFields

        found = ProbeFields.model_json_schema()
    else:
        from fuzzycnc_ros.adapters.opcua.control_file import ControlFields

        found = ControlFields.model_json_schema()
    return {'$schema': DIALECT} | found | {'title': f'File of {kind} of fuzzycnc'}
