# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/add-a-method.md: what each section shows is put into a copy of the package."""

import re

import pytest
from page_tree import page_tree, run_in, run_tests

SECTIONS = ('A thermal model', 'A scheduler', 'A controller', 'A sensor driver')


@pytest.mark.slow
@pytest.mark.parametrize('heading', SECTIONS)
def test_what_a_section_adds_passes_its_test(root, tmp_path, heading):
    page = (root / 'docs' / 'how-to' / 'add-a-method.md').read_text(encoding='utf-8')
    (section,) = re.findall(rf'^## {heading}\n(.*?)(?=^## |\Z)', page, re.M | re.DOTALL)
    tree = page_tree(tmp_path, section, new_files_max=2)
    run_tests(tree)
    run_in(tree, 'tools/make_tables.py')
    if heading == 'A scheduler':
        written = (tree / 'docs' / 'reference' / 'parameters.md').read_text(encoding='utf-8')
        assert 'normal_jerk' in written
