# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Text of foreign origin is shown, not obeyed."""

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fuzzycnc_ros.core.names import CONTROLS, visible


@pytest.mark.parametrize(
    ('text', 'shown'),
    [
        ('Öl °C 温度\u00a0\u2009µm [red]', 'Öl °C 温度\u00a0\u2009µm [red]'),
        ('\x1b]0;x\x07', r'\x1b]0;x\x07'),
        ('\x00\t\r\n\x7f\x85\x9b', r'\x00\x09\x0d\x0a\x7f\x85\x9b'),
        ('\u200b\u202e\u2066\u2028\ufeff', r'\u200b\u202e\u2066\u2028\ufeff'),
        ('\udcff', r'\udcff'),
        ('\U000e0041', r'\U000e0041'),
    ],
)
def test_controls_are_spelt_out(text, shown):
    assert visible(text) == shown


@given(st.text(st.characters()))
def test_nothing_but_controls_changes(text):
    shown = visible(text, keep='\n')
    assert all(unicodedata.category(c) not in CONTROLS or c == '\n' for c in shown)
    assert visible(shown, keep='\n') == shown
    if not any(unicodedata.category(c) in CONTROLS for c in text):
        assert shown == text
