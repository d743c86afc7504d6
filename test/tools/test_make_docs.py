# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `make docs` checks by itself: requests to elsewhere, links that leave the pages, prose."""

import runpy
from pathlib import Path

import pytest
from each_case import for_each

ROOT = Path(__file__).parents[2]
DOCS = runpy.run_path(str(ROOT / 'tools' / 'make_docs.py'))


@pytest.mark.parametrize(
    'line',
    [
        '<script async="async" src="https://cdn.example.org/mathjax.js"></script>',
        '<link rel="stylesheet" type="text/css" href="//fonts.example.org/css" />',
        '<link href="https://fonts.example.org" rel="preconnect" />',
        '<img alt="badge" src="http://example.org/badge.svg" />',
        '@import url("https://fonts.example.org/css");',
        'src: url(https://fonts.example.org/a.woff2)',
    ],
)
def test_a_request_to_elsewhere_is_seen(line):
    assert DOCS['FETCHED'].search(line)


@pytest.mark.parametrize(
    'line',
    [
        '<script src="_static/doctools.js?v=1"></script>',
        '<a class="reference external" href="https://doi.org/10.1109/21.256541">doi</a>',
        '<svg xmlns="http://www.w3.org/2000/svg">',
        'background: url("data:image/svg+xml;base64,AA")',
    ],
)
def test_what_is_only_named_or_local_is_no_request(line):
    assert not DOCS['FETCHED'].search(line)


@pytest.mark.parametrize(
    ('link', 'found'),
    [
        ('[scaling](scaling.md#cost)', '[scaling](scaling.md#cost)'),
        ('[Try it](../../README.md#try-it)', '[Try it](../index.md)'),
        ('[rules](../../CONTRIBUTING.md#set-up)', '[rules](../contributing.md#set-up)'),
        ('[messages](../../msg_defs/msg)', 'messages'),
        (
            '[decisions](../explanation/decisions/)',
            '[decisions](../explanation/decisions/index.md)',
        ),
        ('[paper](https://example.org/a)', '[paper](https://example.org/a)'),
    ],
)
def test_links_lead_to_pages_of_the_site(link, found):
    page = DOCS['SOURCE'] / 'how-to' / 'linuxcnc.md'
    assert DOCS['linked'](page, link, ROOT / 'docs' / 'how-to' / 'linuxcnc.md') == found


def test_prose_is_sentences_without_code_tables_and_headings():
    page = (
        '# A heading\n\nOne sentence. Another one with `code` and [a link](x.md)!\n\n'
        '```sh\nfuzzycnc demo\n```\n\n| a | b |\n|---|---|\n| c | d |\n\n- a point of a list\n'
    )
    assert DOCS['prose'](page) == [
        'One sentence.',
        'Another one with code and a link!',
        'a point of a list',
    ]


@for_each(DOCS['pages']().items(), lambda case: case[0])
def test_pages_are_easy_to_read(page, text):
    assert DOCS['clumsy'](page, text) == []


@pytest.mark.parametrize(
    ('page', 'text'),
    [
        ('docs/tutorials/a.md', f'{"Word " * 26}.'),
        ('docs/explanation/a.md', 'word. ' * 121),
        ('docs/explanation/a.md', '- Nobody misses it.'),
        ('docs/how-to/a.md', 'What is left are 3 µm.'),
        ('docs/how-to/a.md', 'It leaves 3 um.'),
    ],
)
def test_what_is_hard_to_read_is_seen(page, text):
    assert len(DOCS['clumsy'](page, text)) == 1


def test_code_tables_and_names_may_be_as_they_are():
    text = f'# What is left\n\n| um |\n\n```\n{"um " * 130}\n```\n\nSee `tell(um)`.\n'
    assert DOCS['clumsy']('docs/how-to/a.md', text) == []
