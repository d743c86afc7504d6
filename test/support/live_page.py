# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who looks at the live page in a browser, and what is to be seen."""

import json
from collections.abc import Callable, Sequence
from decimal import ROUND_HALF_UP, Decimal
from typing import Any
from urllib.parse import quote, urlsplit

from processes import wait_for

TABS = ('operator', 'temperatures', 'error', 'offsets', 'model', 'motion', 'bags', 'shop')
GAP, MINUS = '\u00a0', '\u2212'
PICTURE = """
const shown = (element) => element.checkVisibility();
const fields = {};
for (const element of document.querySelectorAll('main [data-field]')) {
  if (shown(element)) fields[element.dataset.field] = element.textContent;
}
const sheets = {};
for (const table of document.querySelectorAll('main table')) {
  if (!shown(table)) continue;
  sheets[table.caption.textContent] = [...table.tBodies[0].rows].map(
    (row) => [...row.cells].map((cell) => cell.textContent));
}
const texts = (selector) => [...document.querySelectorAll(selector)]
  .filter(shown).map((element) => element.innerText);
const [, sequence] = document.querySelector('#link').title.match(/view (\\d+)/) ?? [null, null];
const charts = document.querySelector('main > section:not([hidden]) .charts')?.dataset;
return {
  fields, sheets, sequence: sequence && Number(sequence),
  link: document.querySelector('#link').dataset.link,
  state: document.querySelector('#state').dataset.state,
  age: document.querySelector('#age').textContent,
  alarms: [...document.querySelectorAll('#alarms > li')].filter(shown)
    .map((row) => [...row.children].slice(1).map((part) => part.textContent)),
  lost: texts('#lost > li'), noData: texts('#no-data').join(), trouble: texts('.trouble').join(),
  legends: Object.fromEntries([...document.querySelectorAll('.keys button')].filter(shown)
    .map((key) => ['.name', '.value'].map((part) => key.querySelector(part).textContent))),
  rows: Number(charts?.rows ?? 0), drawn: Number(charts?.view ?? 0),
};
"""
"""What a person sees, taken at one moment."""


class LivePage:
    """The live page in a browser."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self.run = driver.execute_script

    def open(self, url: str, machine: str = 'mill', tab: str = 'operator') -> None:
        """Open the page anew, and wait until it shows a machine."""
        self.driver.get('about:blank')
        self.driver.get(f'{url}#{quote(machine, safe="")}/{tab}')
        self.until(lambda: self.seen()['sequence'] is not None, 'a first view')

    def seen(self) -> dict[str, Any]:
        """Return what is seen now."""
        return self.run(PICTURE)

    def until(self, condition: Callable[[], Any], what: str) -> None:
        """Wait until a condition holds."""
        wait_for(condition, f'{what}; seen: {self.run("return document.body.innerText")[:2000]}')

    def one(self, selector: str) -> Any:
        """Return the one element that a selector finds."""
        (found,) = self.driver.find_elements('css selector', selector)
        return found

    def say(self) -> str:
        """Return what the open question says in the end."""
        self.until(lambda: self.run(
            "return document.querySelector('.says')?.textContent && "
            "document.querySelector('.says').dataset.done !== 'wait'"), 'an answer')  # fmt: skip
        return str(self.one('.says').text)

    def look(self, width: int, height: int, theme: str) -> None:
        """Be a screen of a size [px], of a system that is light or dark."""
        size = {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': False}
        self.driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', size)
        features = [{'name': 'prefers-color-scheme', 'value': theme}]
        self.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'features': features})

    def complaints(self) -> list[str]:
        """Return what the browser has complained about since it was asked last."""
        return [entry['message'] for entry in self.driver.get_log('browser')]

    def strangers(self, url: str) -> set[str]:
        """Return the hosts other than that of the page that were asked since the last call."""
        asked = set()
        for entry in self.driver.get_log('performance'):
            message = json.loads(entry['message'])['message']
            if message['method'] == 'Network.requestWillBeSent':
                asked.add(message['params']['request']['url'])
            if message['method'] == 'Network.webSocketCreated':
                asked.add(message['params']['url'])
        assert any(address.startswith(url) for address in asked), 'nothing was asked at all'
        return {urlsplit(address).netloc for address in asked} - {urlsplit(url).netloc, ''}


# What a view is in words, told a second time and in another language than the page's.


def number(value: float | None, digits: int = 0, unit: str = '', *, signed: bool = False) -> str:
    """Return a number as the page writes it."""
    if value is None:
        return '\u2013'
    # A browser rounds what lies in the middle up, Python to the even digit.
    text = str(Decimal(abs(value)).quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP))
    sign = '' if float(text) == 0.0 else MINUS if value < 0.0 else '+' if signed else ''
    return sign + text + (GAP + unit if unit else '')


def micro(value: float | None, digits: int = 1, *, signed: bool = False) -> str:
    """Return a length [m] in micrometres."""
    return number(None if value is None else 1e6 * value, digits, 'µm', signed=signed)


def span(seconds: float | None) -> str:
    """Return a span of time as the page writes it."""
    if seconds is None:
        return '\u2013'
    if abs(seconds) < 9.95:
        return number(seconds, 1, 's')
    if seconds < 59.5:
        return number(seconds, 0, 's')
    minutes = int(seconds / 60.0 + 0.5)
    if seconds < 3569.5:
        return number(minutes, 0, 'min')
    hours, rest = divmod(minutes, 60)
    if seconds < 86399.5:
        return number(hours, 0, 'h') + (GAP + number(rest, 0, 'min') if rest else '')
    return number(seconds / 86400.0, 1, 'd')


def stable(seconds: float | None) -> str:
    """Return a time until something is stable."""
    return 'now' if seconds == 0.0 else span(seconds)


LIMITS = {
    'clamp': 'limit of size',
    'slew': 'limit of rate',
    'machine': 'limit of the machine itself',
}


def limits(names: Sequence[str]) -> str:
    """Return what holds an offset back."""
    return ', '.join(LIMITS[name] for name in names)


def operator_fields(view: dict[str, Any]) -> dict[str, str]:
    """Return the fields of the operator's screen."""
    state, sensors, axes = view['state'], view['sensors'], view['axes']
    times = [axis['stable_in'] for axis in axes]
    spindle = view['spindle']
    found = {
        'compensation': state['compensation'],
        'why': state['why'],
        'machine state': state['machine'],
        'offsets allowed': {True: 'allowed', False: 'refused', None: '\u2013'}[
            state['offsets_allowed']
        ],
        'stable': stable(None if None in times or not times else max(times)),
        'spindle': number(None if spindle is None else spindle * 9.549296585513721, 0, 'rpm'),
        'alarm count': str(len(view['alarms'])),
        'sensors ok': str(sensors['ok']),
        'sensors substituted': str(len(sensors['substituted'])),
        'sensors missing': str(len(sensors['missing'])),
    }
    if view['recording']:
        found['recording'] = view['recording']['bag']
    moves = {'up': '▲ rising', 'down': '▼ falling', 'steady': '■ steady'}
    for axis in axes:
        name, probe, predicted = axis['axis'], axis['probe'], axis['predicted']
        rate, share, band = axis['rate'], axis['share'], axis['band']
        told = number(None if predicted is None else 1e6 * predicted, 1, signed=True)
        if predicted is not None:
            around = '' if band is None else f'{GAP}±{GAP}{number(1e6 * band, 1)}'
            told += f'{around}{GAP}µm'
        found |= {
            f'{name} offset': micro(axis['offset'], signed=True),
            f'{name} move': moves[axis['arrow']],
            f'{name} share': number(None if share is None else 100 * share, 1, '%'),
            f'{name} limit': '\u2013' if axis['limit'] is None else '±' + micro(axis['limit']),
            f'{name} rate': number(None if rate is None else 6e7 * rate, 2, 'µm/min', signed=True),
            f'{name} predicted': told,
            f'{name} stable': stable(axis['stable_in']),
            f'{name} limited': f'✕ {limits(axis["limited"])}' if axis['limited'] else '',
            f'{name} probe': 'none'
            if probe is None
            else f'{micro(probe["measured"], signed=True)} measured, '
            f'{micro(probe["predicted"], signed=True)} predicted, {span(probe["age"])} ago',
        }
    return found


def along_travel(along: dict[str, Any] | None, name: str, band: str = '') -> str:
    """Return values at places of an axis, with their band, as the page writes them."""
    if along is None:
        return '\u2013'
    spread = along[band] if band else along[name]
    places = [
        number(None if place is None else 1e3 * place, 3, 'mm') for place in along['position']
    ]
    return ', '.join(
        f'{place}: {micro(value, 1, signed=True)}' + (f' ± {micro(width)}' if band else '')
        for place, value, width in zip(places, along[name], spread, strict=True)
    )


def offset_rows(view: dict[str, Any]) -> list[list[str]]:
    """Return the rows of the table of offsets."""
    return [
        [
            axis['axis'],
            micro(axis['requested'], 2, signed=True),
            micro(axis['offset'], 2, signed=True),
            '\u2013' if axis['limit'] is None else '±' + micro(axis['limit']),
            number(None if axis['share'] is None else 100 * axis['share'], 1, '%'),
            number(None if axis['slope'] is None else 1e6 * axis['slope'], 2, 'µm/m', signed=True),
            number(
                None if axis['reference_position'] is None else 1e3 * axis['reference_position'],
                3,
                'mm',
            ),
            along_travel(axis['along'], 'error', 'band'),
            along_travel(axis['along'], 'offset'),
            limits(axis['limited']) or 'nothing',
        ]
        for axis in view['axes']
    ]


def model_fields(view: dict[str, Any]) -> dict[str, str]:
    """Return the fields of the model in use; none where there is none."""
    model = view['model']
    if model is None:
        return {}
    inside = '✓ inside its training range'
    return {
        'name': model['name'] or '\u2013',
        'file': model['file'] or '\u2013',
        'hash': model['hash'] or '\u2013',
        'prediction': '✓ valid' if model['valid'] else f'✕ not valid: {model["why"]}',
        'domain': inside if model['in_domain'] else '▲ outside its training range',
        'distance from training': number(model['distance'], 2),
        'trained on': ', '.join(model['runs']) or '\u2013',
        'error on held-out runs (rms)': ', '.join(
            f'{name} {micro(rms, 2)}' for name, rms in model['held_out'].items()
        )
        or '\u2013',
    }


def node_rows(view: dict[str, Any]) -> list[list[str]]:
    """Return the rows of the table of nodes."""
    levels = {'ok': '✓ ok', 'warn': '▲ warning', 'error': '✕ error', 'stale': '\u00d7 silent'}
    return [
        [
            node['name'],
            node['lifecycle'] or '\u2013',
            levels[node['level']],
            number(node['rate'], 2, '1/s'),
            number(None if node['latency'] is None else 1e3 * node['latency'], 1, 'ms'),
            '; '.join(node['trouble']) or 'none',
        ]
        for node in view['nodes']
    ]
