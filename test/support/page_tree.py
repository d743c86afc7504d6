# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A copy of the package with what a page of the docs adds to it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHOWN = re.compile(r'`([\w./]+\.py)`:\n\n((?:```(?:python|diff)\n.*?```\n+)+)', re.DOTALL)
BLOCK = re.compile(r'```(python|diff)\n(.*?)```', re.DOTALL)


def page_tree(top: Path, text: str, *, new_files_max: int) -> Path:
    """Copy the package to a folder, add what a text shows, and return the folder."""
    leave_out = shutil.ignore_patterns('__pycache__')
    for folder in ('fuzzycnc_ros', 'msg_defs', 'docs', 'tools', 'params'):
        shutil.copytree(ROOT / folder, top / folder, ignore=leave_out)
    shutil.copy(ROOT / 'setup.py', top)
    written = 0
    for name, blocks in SHOWN.findall(text):
        path = top / name
        for kind, block in BLOCK.findall(blocks):
            if kind == 'python':
                assert not path.exists()
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(block, encoding='utf-8')
                written += 1
            else:
                lines = block.splitlines()
                before = '\n'.join(line[1:] for line in lines if line[0] == ' ')
                after = '\n'.join(line[1:] for line in lines)
                whole = path.read_text(encoding='utf-8')
                assert whole.count(f'\n{before}\n') == 1, f'{name}: {before}'
                path.write_text(whole.replace(f'\n{before}\n', f'\n{after}\n'), encoding='utf-8')
    assert 2 <= written <= new_files_max
    return top


def run_in(tree: Path, *words: str) -> str:
    """Run Python in the copy; return what it prints."""
    environment = {**os.environ, 'PYTHONPATH': str(tree)}
    done = subprocess.run(
        [sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_tests(tree: Path) -> None:
    """Run the test that the text shows."""
    (test,) = (tree / 'test').rglob('test_*.py')
    told = run_in(tree, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', str(test))
    assert re.search(r'\d+ passed', told), told
