# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What `fuzzycnc papers` prints beside the published figures is what the pages say."""

import re

import pytest
from command_lines import read_json

from fuzzycnc_ros.studies.published.papers import PAPERS, example_duty, find_paper

pytestmark = pytest.mark.paper

FIGURES = {
    'ding_zeng': (
        0.02,
        """
        41.5 33.8 41.5 33.8 38.5 32.8
        9.2 8.6 1.5 1.0 2.8 2.2
        4.8 4.6 11.1 3.0 9.3 4.5
        - - 1.0 0.8 2.2 1.7
        """,
    ),
    'kang2007': (
        0.08,
        """
        5.0 7.4 4.9 7.9 4.2 6.9 2.6 4.7
        0.72 1.6 1.78 4.0 0.65 1.3 0.96 1.6
        3.4 4.8 3.0 5.1 3.9 6.1 2.2 4.0
        2.52 5.1 3.32 7.1 2.31 4.9 3.13 5.0
        3.5 5.1 2.6 3.9 2.8 4.6 1.5 3.2
        0.59 1.6 1.90 4.6 0.37 0.8 0.82 1.6
        2.4 3.9 1.9 3.5 1.9 3.8 1.1 2.4
        0.72 1.8 1.76 4.2 0.33 0.8 0.75 1.3
        """,
    ),
    'long2014': (
        0.005,
        """
        0.4998 0.4998 -
        1.0 11.29 0.466
        1.25 33.36 0.887
        - 45.2 0.501
        """,
    ),
    'deng2014': (
        0.02,
        """
        5.09 5.10 0.44 0.43 2.86 2.86
        4.06 0.81 0.34 0.15 5.66 3.12
        - 0.48 - 0.15 - 3.11
        2.42 2.62 0.25 0.44 3.05 3.06
        """,
    ),
}
"""Tolerance, and the figures of the rows on the pages, published and ours; a dash is none."""

NUMBER = re.compile(r'(?<![\w-])\d+\.\d+')


def numbers(cells):
    """Return the numbers with decimals of the cells of a row, but not those of its label."""
    return [float(text) for text in NUMBER.findall(' '.join(cells[1:]))]


@pytest.mark.slow
@pytest.mark.parametrize('key', FIGURES)
def test_published_and_ours_are_those_of_the_pages(key):
    within, text = FIGURES[key]
    table = find_paper(key).compute(lambda text, done, total: None)
    expected = [[float(word) for word in line.split() if word != '-']
                for line in text.strip().splitlines()]  # fmt: skip
    for cells, wanted in zip(table.rows, expected, strict=True):
        assert numbers(cells) == pytest.approx(wanted, rel=within, abs=0.051), cells[0]


@pytest.mark.slow
def test_rows_of_feeds_are_printed_beside_those_here(fuzzycnc, tmp_path):
    outcome = fuzzycnc('papers', 'lin2021', '--json', 'rows.json')
    assert outcome.code == 0
    assert 'The times of the fuzzy method reproduce' in outcome.out
    rows = read_json('rows.json')['rows']
    assert len(rows) == 15
    assert rows[3] == ['infinity', 'fuzzy', '300', '0.056', '0.00162', '62', '63.2']


def test_the_worked_example_gives_its_duty():
    assert example_duty() == pytest.approx(0.4998, abs=5e-5)


def test_a_paper_goes_by_its_number_and_its_key():
    for number, paper in enumerate(PAPERS, 1):
        assert find_paper(str(number)) is find_paper(paper.key) is paper
    with pytest.raises(ValueError, match=r"expected one of 1 \(ding_zeng\), .* found '6'"):
        find_paper('6')


def test_the_command_knows_the_papers_and_their_pages(root):
    from fuzzycnc_ros.cli.papers import KEYS

    assert tuple(paper.key for paper in PAPERS) == KEYS
    methods = root / 'docs' / 'explanation' / 'methods'
    for paper in PAPERS:
        assert f'fuzzycnc papers {paper.key}' in (methods / paper.page).read_text('utf-8')
