# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The operator's screen in a terminal: the view of a machine in lines of 80 characters."""

from collections.abc import Mapping, Sequence
from math import pi
from typing import Any

from rich.text import Text

from fuzzycnc_ros.core.names import visible

WIDTH, HEIGHT = 80, 24
"""Characters and lines that the screen needs; more are used where there are more."""
_MICRO, _MINUTE, _HOUR = 1e-6, 60.0, 3600.0
_ARROWS = {'up': '↑', 'down': '↓', 'steady': '→'}
_STATES = {
    'active': 'bold green',
    'holding': 'bold yellow',
    'ramping': 'bold red',
    'expired': 'bold red',
    'refused': 'bold red',
    'inactive': 'bold',
    'absent': 'bold red',
}
_LEVELS = {'ok': 'green', 'warn': 'yellow', 'error': 'red', 'stale': 'red'}
_ALARM = 'bold white on red'
_COLUMNS = (4, 11, 11, 7, 16, 10, 11)
_TITLES = ('axis', 'offset µm', 'limit µm', 'share', 'rate µm/min', 'band µm', 'stable in')


def screen(view: Mapping[str, Any], width: int = WIDTH, height: int = HEIGHT) -> Text:
    """Return the screen of a view, no wider and no higher than is said."""
    head = [
        *_head(view, width),
        *_axes(view),
        *_probing(view['probing']),
        *_sensors(view, width),
    ]
    tail = [*_model(view), *_nodes(view, width)]
    room = height - len(head) - len(tail)
    lines = head + _alarms(view['alarms'], width, room) + tail
    for line in lines:
        line.truncate(width, overflow='ellipsis')
    return Text('\n').join(lines[:height])


def _head(view: Mapping[str, Any], width: int) -> list[Text]:
    """Return machine, time and state; without data, nothing else can be meant first."""
    state = view['state']
    title = f'{view["machine"]}{"  SIMULATED" if view["simulated"] else ""}'
    age = '' if view['age'] is None else f'age {_duration(view["age"])}'
    right = f'{_clock(view["stamp"])}  {age}'.strip()
    gap = max(2, width - len(title) - len(right))
    lines = [Text(f'{visible(title)}{" " * gap}{right}', style='bold')]
    if view['silent']:
        banner = Text(' NO DATA '.center(width, '█'), style=_ALARM)
        text = Text(f' {view["silent"]}', style=_ALARM)
        text.truncate(width, overflow='ellipsis')
        text.pad_right(max(0, width - text.cell_len))
        lines += [banner, text]
    word = state['compensation']
    lines.append(
        Text.assemble(
            'compensation ',
            (f' {word.upper()} ', f'{_STATES.get(word, "bold")} reverse'),
            f'  {state["why"]}',
        )
    )
    spindle = view['spindle']
    turning = 'unknown' if spindle is None else f'{spindle * 30.0 / pi:.0f} rpm'
    allowed = 'allowed' if state['offsets_allowed'] else 'NOT allowed'
    recording = view['recording']
    bag = '' if recording is None else f' · recording {recording["bag"]}'
    lines.append(Text(f'machine {state["machine"]} · offsets {allowed} · spindle {turning}{bag}'))
    return lines


def _axes(view: Mapping[str, Any]) -> list[Text]:
    if not view['axes']:
        return [Text('no axis has an offset yet', style='dim')]
    lines = [Text(_row(_TITLES), style='dim')]
    probes = []
    for axis in view['axes']:
        rate = axis['rate']
        speed = '' if rate is None else f'{rate / _MICRO * _MINUTE:+.2f}'
        share = axis['share']
        cells = (
            axis['axis'],
            _micro(axis['offset'] if axis['offset'] is not None else axis['requested'], '+.2f'),
            _micro(axis['limit'], '.0f'),
            '' if share is None else f'{100.0 * share:.0f} %',
            f'{_ARROWS[axis["arrow"]]} {speed}',
            '' if axis['band'] is None else f'±{_micro(axis["band"], ".1f")}',
            '' if axis['stable_in'] is None else _stable(axis['stable_in']),
        )
        line = Text(_row(cells))
        if axis['limited']:
            line.append(f'  {" ".join(axis["limited"])}', style='bold yellow')
        lines.append(line)
        if axis['along'] is not None:
            lines.append(Text(_along(axis['along']), style='dim'))
        probe = axis['probe']
        if probe is not None:
            age = '' if probe['age'] is None else f' {_duration(probe["age"])} ago'
            told = f'{axis["axis"]} {_micro(probe["measured"], "+.1f")} µm'
            predicted = _micro(probe['predicted'], '+.1f') or '?'
            probes.append(f'{told} (predicted {predicted} µm){age}')
    lines.append(Text('last probe: ' + ('; '.join(probes) or 'none')))
    return lines


def _along(along: Mapping[str, Sequence[float | None]]) -> str:
    """Return error with its widest band, and offset, from one end of an axis to the other."""
    error, offset = (
        ' '.join(_micro(value, '+.1f') or '?' for value in along[name])
        for name in ('error', 'offset')
    )
    low, high = (1e3 * (along['position'][at] or 0.0) for at in (0, -1))
    band = _micro(max(value or 0.0 for value in along['band']), '.1f')
    return f'  from {low:.0f} to {high:.0f} mm: error {error} ±{band} µm, offset {offset}'


def _probing(probing: Mapping[str, Any] | None) -> list[Text]:
    """Return when the next probe is due and why, and what the last one changed."""
    if probing is None:
        return []
    style = 'yellow' if probing['due'] else ''
    if probing['due']:
        text = f'probe due: {probing["reason"]}'
    elif probing['due_in'] is not None:
        text = f'next probe due in about {_duration(probing["due_in"])}'
    else:
        text = 'no probe due'
    changes = ', '.join(
        f'{item["channel"]} {_micro(item["change"], "+.1f")} µm' for item in probing['changes']
    )
    if changes:
        text += f'; the last changed {changes}'
    lines = [Text(text, style=style)]
    cycle = probing['cycle']
    if cycle is not None and (cycle['outcome'] or cycle['due'] or not probing['reason']):
        told = cycle['outcome'] or cycle['reason']
        style = '' if cycle['accepted'] else 'yellow'
        lines.append(Text(f'probing cycle: {told}', style=style))
    return lines


def _sensors(view: Mapping[str, Any], width: int) -> list[Text]:
    sensors = view['sensors']
    total = len(sensors['values'])
    text = f'sensors {sensors["ok"]} of {total} good'
    substituted = [f'{item["name"]} by {item["by"]}' for item in sensors['substituted']]
    missing = [f'{item["name"]} {item["why"]}' for item in sensors['missing']]
    poor = []
    if substituted:
        poor.append(f'substituted: {", ".join(substituted)}')
    if missing:
        poor.append(f'bad: {", ".join(missing)}')
    if not total:
        return [Text('no temperatures yet', style='dim')]
    style = 'yellow' if poor else ''
    return [Text('; '.join([text, *poor]), style=style)]


def _model(view: Mapping[str, Any]) -> list[Text]:
    model = view['model']
    if model is None:
        return []
    place = 'in domain' if model['in_domain'] else 'OUTSIDE its training range'
    held = ', '.join(f'{name} {_micro(left, ".1f")}' for name, left in model['held_out'].items())
    text = f'model {model["name"] or "none"}: {place if model["valid"] else model["why"]}'
    return [Text(text + (f'; left on unseen runs {held} µm' if held else ''))]


def _nodes(view: Mapping[str, Any], width: int) -> list[Text]:
    line = Text('nodes ')
    for number, node in enumerate(view['nodes']):
        line.append(', ' if number else '')
        plain = node['lifecycle'] in ('active', 'running')
        told = node['name'] if plain else f'{node["name"]} {node["lifecycle"]}'
        line.append(told, style=_LEVELS.get(node['level'], ''))
    lines = line.wrap(_Plain, width)
    return list(lines)


def _alarms(alarms: Sequence[Mapping[str, Any]], width: int, room: int) -> list[Text]:
    """Return the alarms, the worst first, in so many lines; what has no room is counted."""
    if not alarms:
        return [Text('no alarms', style='green')]
    lines = [Text(f'{len(alarms)} alarm{"s" if len(alarms) > 1 else ""}', style='bold')]
    for number, alarm in enumerate(alarms):
        style = _LEVELS[alarm['level']]
        since = '' if alarm['since'] is None else f' (since {_clock(alarm["since"])})'
        remedy = f' → {alarm["remedy"]}' if alarm['remedy'] else ''
        text = f'{alarm["level"].upper()} {alarm["node"]} {alarm["name"]}: {alarm["cause"]}'
        block = list(Text(f'{text}{since}{remedy}', style=style).wrap(_Plain, width))
        left = len(alarms) - number
        if len(lines) + len(block) + (left > 1) > room:
            lines.append(Text(f'and {left} more: a higher window shows them', style='bold'))
            break
        lines += block
    return lines


class _Still:
    """Console that rich asks when it wraps a text."""

    tab_size = 8
    options = None


_Plain: Any = _Still()


def _row(cells: Sequence[str]) -> str:
    first, *others = zip(cells, _COLUMNS, strict=True)
    return f'{first[0]:<{first[1]}}' + ''.join(f'{cell:>{size}}' for cell, size in others)


def _micro(value: float | None, form: str) -> str:
    """Return a length [m] in micrometres; empty if it is unknown."""
    return '' if value is None else f'{value / _MICRO:{form}}'


def _stable(time: float) -> str:
    return 'now' if time == 0.0 else _duration(time)


def _duration(time: float) -> str:
    if time < 2.0 * _MINUTE:
        return f'{time:.0f} s' if time >= 10.0 else f'{time:.1f} s'
    if time < 2.0 * _HOUR:
        return f'{time / _MINUTE:.0f} min'
    return f'{time / _HOUR:.1f} h'


def _clock(stamp: float | None) -> str:
    """Return machine time as a clock of the day, in UTC as recordings have it."""
    if stamp is None:
        return 'no time yet'
    seconds = int(stamp) % 86400
    return f'{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d} UTC'
