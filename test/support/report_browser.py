# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Who reads reports in a browser."""

import csv
import re
import time
from pathlib import Path
from typing import Any

from processes import wait_for

SIZES = (1280, 400)
WIDTHS = """
const wide = [...document.querySelectorAll('main .sheet')]
  .filter(box => box.scrollWidth > box.clientWidth).map(box => box.innerText.slice(0, 60));
return {
  page: document.documentElement.scrollWidth, window: innerWidth, wide,
  declared: document.querySelectorAll('figure').length,
  live: document.querySelectorAll('figure.live').length,
  canvases: document.querySelectorAll('figure.live canvas').length,
  ink: getComputedStyle(document.body).color,
};
"""


class Reader:
    """A report in a browser, and who reads it."""

    def __init__(self, driver: Any, downloads: Path) -> None:
        self.driver, self.downloads = driver, downloads
        behavior = {'behavior': 'allow', 'downloadPath': str(downloads)}
        driver.execute_cdp_cmd('Browser.setDownloadBehavior', behavior)
        self.run = driver.execute_script
        self._touched_at = time.time()

    def open(self, page: Path, width: int = 1280, theme: str = 'light') -> None:
        """Open a page on a screen of a width [px], of a system that is light or dark."""
        size = {'width': width, 'height': 900, 'deviceScaleFactor': 1, 'mobile': False}
        self.driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', size)
        features = [{'name': 'prefers-color-scheme', 'value': theme}]
        self.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'features': features})
        self.driver.get('about:blank')
        self.complaints()  # of the page before, whose pixels a test may have read
        self.driver.get(page.as_uri())
        wait_for(
            lambda: self.run('return document.readyState') == 'complete', f'all of {page.name}'
        )

    def complaints(self) -> list[str]:
        """Return what the browser has complained about since it was asked last."""
        return [entry['message'] for entry in self.driver.get_log('browser')]

    def plot(self, figure: int, panel: int = 0) -> Any:
        """Return the area of a plot, in sight."""
        found = self.driver.find_elements('css selector', f'#figure-{figure} .u-over')[panel]
        self.run("arguments[0].scrollIntoView({block: 'center'})", found)
        return found

    def ends(self, figure: int, panel: int = 0) -> list[float]:
        """Return the stretch of x that a plot says it shows."""
        said = self.run(
            'return [...document.querySelectorAll(`#figure-${arguments[0]} .panel`)]'
            '[arguments[1]].lastElementChild.textContent',
            figure,
            panel,
        )
        low, high = re.fullmatch(r'Shown: .* (\S+) to (\S+)(?: .*)?', said).groups()
        return [float(low), float(high)]

    def shown(self, figure: int) -> dict[str, list[float]]:
        """Return the stretches that a plane says it shows, by axis; none while it is whole."""
        said = self.run(
            'return document.querySelector(`#figure-${arguments[0]} .panel`)'
            '.lastElementChild.textContent',
            figure,
        )
        found = re.findall(r'(\w+) (\S+) to (\S+?)(?: µm| mm)?(?:, |; |$)', said)
        assert bool(found) == bool(said), said
        return {name: [float(low), float(high)] for name, low, high in found}

    def read(self, figure: int) -> str:
        """Return what a plane reads out at the cursor."""
        return self.run(
            'return document.querySelector(`#figure-${arguments[0]} .nearest`).textContent', figure
        )

    def wheel(self, area: Any, way: float, *, control: bool = True) -> None:
        """Turn the wheel [px] in the middle of a plot, as a rule with Ctrl."""
        event = {'type': 'mouseWheel', 'deltaX': 0, 'deltaY': way, 'modifiers': 2 * control}
        self._send('Input.dispatchMouseEvent', {**event, **self._place(area, 0.5)})

    def press(self, area: Any, *keys: str) -> None:
        """Press keys where the focus is on a plot."""
        self.run('arguments[0].focus()', area)
        self._hand().send_keys(*keys).perform()

    def pinch(self, area: Any, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Move two fingers on a plot, from two shares of its width to two others."""
        steps = [begin, tuple((a + b) / 2 for a, b in zip(begin, end, strict=True)), end]
        for kind, shares in zip(('touchStart', 'touchMove', 'touchMove'), steps, strict=True):
            points = [{**self._place(area, share), 'id': i} for i, share in enumerate(shares)]
            self._send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': points})
        self._send('Input.dispatchTouchEvent', {'type': 'touchEnd', 'touchPoints': []})

    def tap(self, area: Any, times: int = 1) -> None:
        """Touch the middle of a plot: a second after all before, every 0.1 s by the browser."""
        self._touched_at += 1.0
        for _ in range(times):
            self._touched_at += 0.1
            for kind, points in (('touchStart', [self._place(area, 0.5)]), ('touchEnd', [])):
                event = {'type': kind, 'touchPoints': points, 'timestamp': self._touched_at}
                self._send('Input.dispatchTouchEvent', event)

    def swipe(self, area: Any) -> None:
        """Move one finger up over a plot, as if to scroll on."""
        begin = self._place(area, 0.5)
        places = [{**begin, 'y': begin['y'] - 15.0 * step} for step in range(11)]
        for kind, points in [
            ('touchStart', places[:1]),
            *(('touchMove', [place]) for place in places[1:]),
            ('touchEnd', []),
        ]:
            self._send('Input.dispatchTouchEvent', {'type': kind, 'touchPoints': points})

    def _place(self, area: Any, share: float) -> dict[str, float]:
        left, top, width, height = self.run(
            'const box = arguments[0].getBoundingClientRect();'
            'return [box.left, box.top, box.width, box.height]',
            area,
        )
        return {'x': left + share * width, 'y': top + 0.5 * height}

    def _send(self, command: str, event: dict[str, Any]) -> None:
        self.driver.execute_cdp_cmd(command, event)

    def drag(self, area: Any, begin: float, end: float) -> None:
        """Drag across a plot, between shares of its width."""
        width = area.size['width']
        hand = self._hand()
        hand.move_to_element_with_offset(area, int((begin - 0.5) * width), 0)
        hand.click_and_hold()
        hand.move_by_offset(int((end - begin) * width), 0)
        hand.release().perform()

    def double_click(self, area: Any) -> None:
        """Double-click into the middle of a plot."""
        self._hand().move_to_element(area).double_click().perform()

    def hover(self, area: Any, share: float) -> None:
        """Put the cursor at a share of a plot's width."""
        way = int((share - 0.5) * area.size['width'])
        self._hand().move_to_element_with_offset(area, way, 0).perform()

    def point_at(self, area: Any, share: float) -> dict[str, str]:
        """Put the cursor at a share of a plot's width; return what is read out then."""
        self.hover(area, share)
        rows = self.run(
            "return [...arguments[0].closest('.uplot').querySelectorAll('.u-series')]"
            ".filter(row => !row.hidden).map(row => [row.querySelector('.u-label').textContent,"
            " row.querySelector('.u-value').textContent])",
            area,
        )
        return dict(rows)

    def data(self, figure: int) -> list[dict[str, str]]:
        """Return the rows of the CSV file that a figure is saved as."""
        for old in self.downloads.iterdir():
            old.unlink()
        button = self.driver.find_element('css selector', f'#figure-{figure} .tools button')
        self.run("arguments[0].scrollIntoView({block: 'center'}); arguments[0].click()", button)
        wait_for(lambda: [*self.downloads.glob('*.csv')], f'the CSV file of figure {figure}')
        (file,) = self.downloads.glob('*.csv')
        wait_for(lambda: file.read_bytes().endswith(b'\n'), 'the end of the file')
        with file.open(encoding='utf-8-sig', newline='') as stream:
            return list(csv.DictReader(stream))

    def _hand(self) -> Any:
        from selenium.webdriver.common.action_chains import ActionChains

        return ActionChains(self.driver, duration=0)


def check(reader: Reader, page: Path, themes: tuple[str, ...] = ('light', 'dark')) -> None:
    """Check that a page fits wide and narrow screens, light and dark, and nothing complains."""
    ink = set()
    for theme in themes:
        for width in SIZES:
            reader.open(page, width, theme)
            found = reader.run(WIDTHS)
            assert found['page'] <= found['window'] == width, (theme, found)
            assert not (width == SIZES[0] and found['wide']), found
            assert found['live'] == found['declared'], found
            complaints = reader.complaints()
            assert not complaints, complaints
            ink.add(found['ink'])
    assert len(ink) == len(themes)
