# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The report of a machine in the words of MTConnect: lines of SHDR, and the file of devices.

SHDR is what adapters send to agents: `timestamp|key|value|...`, a condition alone on its line as
`timestamp|key|level|code|severity|qualifier|text`.  It is pure: documents of `MachineReport` in,
text out.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from fuzzycnc_ros.components.report.reported_values import SPINDLE, told
from fuzzycnc_ros.core.names import file_word, topic_words

UNAVAILABLE = 'UNAVAILABLE'
NAMESPACE = 'urn:mtconnect.org:MTConnectDevices:1.3'
AVAILABILITY, ALARMS = 'availability', 'alarms'
KINDS = {
    'temperature': ('TEMPERATURE', 'CELSIUS', 1.0),
    'offset': ('DISPLACEMENT', 'MILLIMETER', 1e-3),
    'error': ('DISPLACEMENT', 'MILLIMETER', 1e-3),
    SPINDLE: ('ROTARY_VELOCITY', 'REVOLUTION/MINUTE', 1.0),
}
"""Type and units in MTConnect of each reported quantity, and the factor; it has no micrometres."""
LEVELS = {'warning': 'WARNING', 'error': 'FAULT'}
TEXT_MAX = 300
"""Longest text of an alarm [characters]."""
_NO_TEXT = re.compile(r'[|\r\n]')


@dataclass(frozen=True)
class ShdrItem:
    """A data item.

    Attributes
    ----------
    key : str
        Its id and key.
    kind, units : str
        Its type and units in MTConnect.
    said : str
        What the report calls it, for people.
    """

    key: str
    kind: str
    units: str
    said: str


class Shdr:
    """Turn reports of a machine into lines of SHDR.

    Parameters
    ----------
    machine : str
        Its name.
    age_max : float
        Age [s] beyond which a value is no longer told.

    Attributes
    ----------
    items : dict
        Data items that have been there so far, by key; they only grow in number.
    """

    def __init__(self, machine: str, age_max: float) -> None:
        self._machine, self._age_max = machine, age_max
        self.items: dict[str, ShdrItem] = {}
        self._values: dict[str, str] = {}
        self._alarms: dict[str, str] = {}
        self._time = ''

    def take(self, document: Mapping[str, Any]) -> list[str]:
        """Take a report; return lines on what has changed since the last one."""
        self._time = str(document['time']).replace('+00:00', 'Z')
        values = {AVAILABILITY: 'AVAILABLE', **dict.fromkeys(self.items, UNAVAILABLE)}
        for item, value in self._told(document):
            self.items.setdefault(item.key, item)
            values[item.key] = UNAVAILABLE if value is None else f'{value:.9g}'
        alarms = dict(_alarm(alarm) for alarm in document['alarms'])
        changed = {key: text for key, text in values.items() if self._values.get(key) != text}
        gone = [code for code in self._alarms if code not in alarms]
        new = [code for code, line in alarms.items() if self._alarms.get(code) != line]
        lines = [self._line(changed)] if changed else []
        lines += [f'{self._time}|{ALARMS}|NORMAL|{code}|||' for code in gone]
        lines += [f'{self._time}|{ALARMS}|{alarms[code]}' for code in new]
        self._values, self._alarms = values, alarms
        return lines

    def everything(self) -> list[str]:
        """Return lines on all that is known, for who comes anew."""
        if not self._values:
            return []
        begin = [self._line(self._values), f'{self._time}|{ALARMS}|NORMAL||||']
        return [*begin, *(f'{self._time}|{ALARMS}|{line}' for line in self._alarms.values())]

    def devices(self) -> str:
        """Return the file of devices for an agent, with all data items so far."""
        ElementTree.register_namespace('', NAMESPACE)
        root = ElementTree.Element(_tag('MTConnectDevices'))
        ElementTree.SubElement(
            root,
            _tag('Header'),
            # An agent puts its own header into its place.
            creationTime='2000-01-01T00:00:00Z',
            sender='fuzzycnc',
            instanceId='1',
            version='1.3.0.0',
            bufferSize='131072',
        )
        devices = ElementTree.SubElement(root, _tag('Devices'))
        name = file_word(self._machine)
        device = ElementTree.SubElement(
            devices, _tag('Device'), id=f'{name}_device', name=name, uuid=f'fuzzycnc-{name}'
        )
        ElementTree.SubElement(device, _tag('Description')).text = 'Thermal compensation, fuzzycnc'
        own = ElementTree.SubElement(device, _tag('DataItems'))
        for key, kind, category in (
            (AVAILABILITY, 'AVAILABILITY', 'EVENT'),
            (ALARMS, 'SYSTEM', 'CONDITION'),
        ):
            fields = {'id': f'{name}_{key}', 'name': key, 'type': kind, 'category': category}
            ElementTree.SubElement(own, _tag('DataItem'), fields)
        places = {'TEMPERATURE': 'Sensor', 'DISPLACEMENT': 'Controller', 'ROTARY_VELOCITY': ''}
        parts = ElementTree.SubElement(device, _tag('Components'))
        for kind, component in places.items():
            chosen = sorted(
                (item for item in self.items.values() if item.kind == kind),
                key=lambda item: item.key,
            )
            if not chosen:
                continue
            names = {'id': f'{name}_{kind.lower()}', 'name': kind.lower()}
            if component:
                part = ElementTree.SubElement(parts, _tag(component), names)
            else:  # a spindle is an axis that turns
                axes = ElementTree.SubElement(parts, _tag('Axes'), id=f'{name}_axes', name='axes')
                inner = ElementTree.SubElement(axes, _tag('Components'))
                part = ElementTree.SubElement(inner, _tag('Rotary'), names | {'name': 'S'})
            found = ElementTree.SubElement(part, _tag('DataItems'))
            for item in chosen:
                given = {'id': f'{name}_{item.key}', 'name': item.key, 'category': 'SAMPLE'}
                units = {'units': item.units, 'nativeUnits': item.units}
                sub = {'subType': 'ACTUAL'} if item.key == SPINDLE else {}
                made = ElementTree.SubElement(
                    found, _tag('DataItem'), {**given, 'type': kind, **sub, **units}
                )
                ElementTree.SubElement(made, _tag('Source')).text = item.said
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding='unicode')
        return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'

    def _line(self, values: Mapping[str, str]) -> str:
        return '|'.join([self._time, *(f'{key}|{text}' for key, text in values.items())])

    def _told(self, document: Mapping[str, Any]) -> Iterator[tuple[ShdrItem, float | None]]:
        """Yield data items with their values; None where there is none, or it is too old."""
        found = list(told(document, self._age_max))
        names = {kind: sorted(item.name for item in found if item.kind == kind) for kind in KINDS}
        words = {kind: topic_words(chosen) for kind, chosen in names.items() if kind != SPINDLE}
        for item in found:
            key = f'{item.kind}_{words[item.kind][item.name]}' if item.name else item.kind
            word, units, factor = KINDS[item.kind]
            value = None if item.value is None else factor * item.value
            yield ShdrItem(key, word, units, f'{item.kind} {item.name}'.strip()), value


def _alarm(alarm: Mapping[str, str]) -> tuple[str, str]:
    """Return the code of an alarm, and the rest of its line."""
    code = _plain(f'{alarm["node"]}.{alarm["name"]}').replace(' ', '_')
    level = LEVELS[alarm['level']]
    return code, f'{level}|{code}|||{_plain(alarm["text"])}'


def _plain(text: str) -> str:
    """Return a text that ends neither its field nor its line."""
    return _NO_TEXT.sub('/', text)[:TEXT_MAX]


def _tag(name: str) -> str:
    return f'{{{NAMESPACE}}}{name}'
