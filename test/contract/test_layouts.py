# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts for viewers name topics and fields that exist, as each viewer writes them."""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.runtime.host import NodeEvent

ROOT = Path(__file__).parents[2]
FIELD = re.compile(r'^(?:builtin_interfaces/|std_msgs/)?(\w+)(\[\])? +(\w+) *(?:#.*)?$')
TYPES = {
    item.name: item.record.TYPE
    for component in COMPONENTS.values()
    for item in (*component.INPUTS, *component.OUTPUTS)
} | {'node_event': NodeEvent.TYPE}


def fields(topic: str) -> dict[str, bool]:
    """Return the fields of a topic's message, and whether each is an array."""
    package, _, name = TYPES[topic].split('/')
    assert package == 'fuzzycnc_msgs'
    lines = (ROOT / 'msg_defs' / 'msg' / f'{name}.msg').read_text().splitlines()
    found = [FIELD.match(line) for line in lines]
    return {item[3]: bool(item[2]) for item in found if item is not None}


def of_lichtblick(document: Any) -> Iterator[str]:
    """Yield all message paths of a layout."""
    if isinstance(document, dict):
        for key, value in document.items():
            if key in ('value', 'topicPath', 'topicToRender'):
                yield value
            else:
                yield from of_lichtblick(value)
    elif isinstance(document, list):
        for value in document:
            yield from of_lichtblick(value)


def panels(node: Any) -> Iterator[str]:
    """Yield the panels that a layout is split into."""
    if isinstance(node, str):
        yield node
    else:
        assert node['direction'] in ('row', 'column')
        yield from panels(node['first'])
        yield from panels(node['second'])


def broken(paths: list[str], separator: str) -> list[str]:
    """Return the paths that lead to no number: arrays need a place, others have none."""
    form = re.compile(rf'/mill/(\w+)(?:{re.escape(separator)}(\w+)(\[\d+\])?)?')
    found = []
    for path in paths:
        parts = form.fullmatch(path)
        if path == '/diagnostics':
            continue
        if parts is None or parts[1] not in TYPES:
            found.append(path)
        elif parts[2] and fields(parts[1]).get(parts[2]) is not bool(parts[3]):
            found.append(path)
    return found


def test_fields_are_read_as_they_are_written():
    assert (
        fields('compensation').items() >= {'state': False, 'offset': True, 'source': True}.items()
    )
    with pytest.raises(KeyError):
        fields('compensations')


PLOT = set(
    'foxglovePanelTitle lichtblickPanelTitle paths isSynced legendDisplay showLegend '
    'showPlotValuesInLegend showXAxisLabels showYAxisLabels xAxisVal sidebarDimension'.split()
)
"""Keys of a plot that Lichtblick 1.29 reads, and Foxglove's own key of the title."""


def test_each_panel_is_titled_with_the_keys_that_both_viewers_read():
    document = json.loads((ROOT / 'layouts' / 'lichtblick.json').read_text())
    for name, panel in document['configById'].items():
        if name.startswith('Plot!'):
            assert panel['lichtblickPanelTitle'] == panel['foxglovePanelTitle'], name
            assert panel.keys() <= PLOT, name


def test_lichtblick_and_foxglove():
    document = json.loads((ROOT / 'layouts' / 'lichtblick.json').read_text())
    assert sorted(panels(document['layout'])) == sorted(document['configById'])
    paths = list(of_lichtblick(document['configById']))
    assert len(paths) > 20
    assert broken(paths, '.') == []
    assert broken(['/mill/compensation.offset', '/mill/machine_state.speed', '/mill/x'], '.') == [
        '/mill/compensation.offset',
        '/mill/machine_state.speed',
        '/mill/x',
    ]


def test_plotjuggler():
    root = ET.parse(ROOT / 'layouts' / 'plotjuggler.xml').getroot()
    paths = [curve.attrib['name'] for curve in root.iter('curve')]
    assert len(paths) > 20
    assert broken(paths, '/') == []
    for splitter in root.iter('DockSplitter'):
        sizes = [float(size) for size in splitter.attrib['sizes'].split(';')]
        assert len(splitter) == len(sizes) == int(splitter.attrib['count'])
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)
