# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Files of text in another encoding are refused by its name, whichever command reads them."""

import pytest

SOFT = '--thickness 10mm --depth 2mm --step 2mm --out q.csv'


@pytest.mark.parametrize(
    'words',
    [
        'soft train FILE.csv --out model.json',
        f'soft compensate path.csv --model FILE.json {SOFT}',
        'machine identify FILE.csv --axis X --out axis.yaml',
        'machine new mill.yaml --linuxcnc-ini FILE.ini',
        'machine show FILE.yaml',
        'servo learn FILE.csv --unit mm --out rules.yaml',
        'evaluate shift --model FILE.json',
        'schedule FILE.ngc --tolerance 0.01mm --out part.ngc',
        'pareto FILE.csv',
        'demo --scenario shift --program FILE.ngc',
    ],
)
def test_a_file_in_utf16_is_named_so(refused, tmp_path, words):
    typed = words.replace('FILE', 'given').split()
    (tmp_path / 'shift').mkdir()
    (tmp_path / 'path.csv').write_text('x_mm,y_mm\n0,0\n1,1\n')
    name = next(word for word in typed if word.startswith('given'))
    (tmp_path / name).write_text('a,b\n1,2\n', 'utf-16')
    refused(*typed, naming=[name, 'UTF-16', 'save it as UTF-8'])


def test_a_letter_of_windows_is_placed(refused, tmp_path):
    (tmp_path / 'mill.yaml').write_text('# Fräse\naxes: {}\n', 'cp1252')
    wrong = "line 1: expected text in utf-8 but byte 4 is 0xe4, in cp1252 'ä'; save it as UTF-8"
    refused('machine', 'show', 'mill.yaml', naming=['mill.yaml', wrong])
