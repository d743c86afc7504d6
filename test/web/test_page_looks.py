# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The page fits its screens, is legible and reachable by keyboard, and asks nobody else."""

import re

import pytest
from fake_dashboard import WEB, busy_view, view
from live_page import TABS
from selenium.webdriver.common.keys import Keys

SIZES = ((1920, 1080), (1280, 800), (400, 800))
SEEN = ((SIZES[0], 'light'), (SIZES[-1], 'dark'))
TOO_WIDE = """
const wide = [];
for (const element of document.querySelectorAll('body *')) {
  const box = element.getBoundingClientRect();
  const told = element.outerHTML.slice(0, 120);
  if (!box.width || !element.checkVisibility()) continue;
  if (element.closest('.visually-hidden, thead')) continue;
  if (box.right > innerWidth + 1 && !element.closest('.sheet, .plot')) wide.push(told);
  const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  if (own && element.scrollWidth > element.clientWidth + 2 && element.clientWidth
      && getComputedStyle(element).display !== 'inline') wide.push(`cut: ${told}`);
}
return [document.documentElement.scrollWidth - innerWidth, wide];
"""


@pytest.mark.parametrize(
    ('width', 'height', 'theme'),
    [
        # Themes differ in colours: the fast tests see each once, on the widest and the narrowest.
        pytest.param(*size, theme, marks=() if (size, theme) in SEEN else pytest.mark.slow)
        for size in SIZES
        for theme in ('light', 'dark')
    ],
)
def test_nothing_sticks_out(page, fake, width, height, theme):
    crowded = busy_view('a_machine_with_a_long_name', alarms=busy_view()['alarms'] * 1)
    crowded['axes'][0] |= {'offset': -2.004e-4, 'predicted': -2.004e-4, 'band': 1.23e-5}
    fake.show(
        crowded, view('lathe'), view('grinder', silent='no data for 12 s: all nodes have ended')
    )
    page.look(width, height, theme)
    for tab in TABS:
        page.open(fake.url, 'a_machine_with_a_long_name', tab)
        if tab in ('temperatures', 'error', 'offsets', 'motion'):
            page.until(lambda: page.seen()['rows'] > 300, 'plots')
        beyond, wide = page.run(TOO_WIDE)
        assert beyond <= 0, (tab, wide)
        assert not wide, tab
    assert page.complaints() == []


def test_the_operator_screen_needs_no_scrolling(page, fake):
    fake.show(busy_view())
    page.until(lambda: page.seen()['lost'], 'the view')
    for width, height in ((1920, 1080), (1280, 800)):
        page.look(width, height, 'light')
        assert page.run('return document.documentElement.scrollHeight') <= height


def test_what_counts_is_large(page, fake):
    """Three metres away a letter must be 15 mm high: 54 px on a screen of 24 inches."""
    sizes = page.run(
        "return ['.state .word', '.axis .offset', '.key .figure'].map((selector) => "
        'parseFloat(getComputedStyle(document.querySelector(selector)).fontSize))'
    )
    assert min(sizes) * 0.73 >= 40.0
    assert sizes[0] * 0.73 >= 54.0
    assert sizes[1] * 0.73 >= 54.0


def test_nobody_else_is_asked_and_nothing_is_complained_about(page, fake):
    page.driver.get_log('performance')
    fake.show(busy_view(), view('lathe'))
    for tab in TABS:
        page.open(fake.url, tab=tab)
    assert page.strangers(fake.url) == set()
    loaded = page.run("return performance.getEntriesByType('resource').map((entry) => entry.name)")
    assert loaded
    assert all(name.startswith(fake.url) for name in loaded)
    assert page.complaints() == []


def test_files_name_no_other_place():
    for path in (WEB / 'static').iterdir():
        text = path.read_text(encoding='utf-8').replace('http://www.w3.org/2000/svg', '')
        assert not re.search(r'https?://|[^:]//[a-z]+\.[a-z]', text), path.name
    page = (WEB / 'static' / 'index.html').read_text()
    assert not re.search(r'<style|style=|\son\w+=|<script>', page), 'the policy forbids it'


def test_markup_is_never_made_of_text():
    for path in (WEB / 'static').glob('*.js'):
        found = re.search(
            r'innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(', path.read_text()
        )
        assert not found, path.name


def luminance(colour):
    """Return the relative luminance of a colour, as WCAG 2.1 defines it."""
    parts = [int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.03928 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return sum(w * p for w, p in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


def contrast(one, other):
    """Return the contrast of two colours, as WCAG 2.1 defines it."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize('theme', [0, 1], ids=['light', 'dark'])
def test_colours_are_legible(theme):
    text = (WEB / 'static' / 'page.css').read_text()
    pairs = re.findall(r'--([\w-]+): light-dark\((#\w{6}), (#\w{6})\)', text)
    colours = {name: values[theme] for name, *values in pairs}
    grounds = {
        'ink': ('page', 'card', 'accent-tint', 'good-tint', 'warn-tint', 'error-tint'),
        'muted': ('page', 'card', 'good-tint', 'warn-tint', 'error-tint'),
        'accent': ('page', 'card', 'accent-tint', 'good-tint'),
        'good': ('card', 'good-tint'),
        'warn': ('card', 'warn-tint'),
        'error': ('card', 'error-tint'),
    }
    poor = [
        (name, ground, round(contrast(colours[name], colours[ground]), 2))
        for name, found in grounds.items()
        for ground in found
        if contrast(colours[name], colours[ground]) < 4.5
    ]
    assert not poor
    assert contrast('#ffffff', colours['shout']) > 4.5
    lines = [name for name in colours if name.startswith('line-')]
    assert len(lines) == 8
    assert all(contrast(colours[name], colours['card']) > 3.0 for name in lines)


def background(page):
    """Return the brightness of the page's ground, 0 to 255."""
    return page.run(
        'return Number(getComputedStyle(document.body).backgroundColor.match(/\\d+/)[0])'
    )


def test_the_theme_follows_the_system_or_the_switch(page, fake):
    assert background(page) > 200
    page.look(1920, 1080, 'dark')
    page.until(lambda: background(page) < 50, 'dark')
    switch = page.one('#theme')
    assert 'system' in switch.get_attribute('aria-label')
    switch.click()
    assert background(page) > 200
    switch.click()
    assert background(page) < 50
    page.look(1920, 1080, 'light')
    page.open(fake.url)
    assert background(page) < 50, 'the choice is kept'
    page.one('#theme').click()
    assert background(page) > 200


def test_tabs_by_keyboard(page, fake):
    page.one('#tab-operator').send_keys(Keys.ARROW_RIGHT)
    page.until(lambda: page.one('#panel-temperatures').is_displayed(), 'the next tab')
    active = page.driver.switch_to.active_element
    assert active.get_attribute('id') == 'tab-temperatures'
    active.send_keys(Keys.END)
    page.until(lambda: page.one('#panel-shop').is_displayed(), 'the last tab')
    page.driver.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
    page.until(lambda: page.one('#panel-operator').is_displayed(), 'round')
    chosen = page.driver.find_elements('css selector', '[role="tab"][aria-selected="true"]')
    assert [tab.text for tab in chosen] == ['Operator']
    assert page.driver.current_url.endswith('#mill/operator'), 'a tab has an address'


def test_everything_has_a_name(page, fake):
    fake.show(busy_view(), view('lathe'))
    for tab in TABS:
        page.open(fake.url, tab=tab)
        names = page.run(
            "return [...document.querySelectorAll('button, select, input, a, [role=region], "
            "[role=meter], [role=img], [role=tabpanel]')].filter((e) => e.checkVisibility())"
            '.map((e) => [e.outerHTML.slice(0, 100), e.computedName ?? (e.ariaLabel || '
            "e.innerText || e.labels?.[0]?.innerText || e.getAttribute('aria-labelledby'))])"
        )
        assert len(names) > 10
        assert [where for where, name in names if not name] == []
