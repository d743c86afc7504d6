# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every source file carries its licence, and none a path or host of one machine."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

from each_case import for_each

ROOT = Path(__file__).parents[2]
HEADER = ('Copyright The fuzzycnc authors', 'SPDX-License-Identifier: Apache-2.0')
COMMENTED = {
    '.cfg',
    '.css',
    '.html',
    '.in',
    '.j2',
    '.js',
    '.py',
    '.sh',
    '.toml',
    '.txt',
    '.xml',
    '.yaml',
    '.yml',
}
COMMENTED_NAMES = {'.gitignore', 'Makefile', 'run'}
TEXT = COMMENTED | {'.action', '.json', '.md', '.msg', '.srv', ''}
BUILT = {'build', 'install', 'log', '__pycache__', 'node_modules'}
VENDORED = {'vendor'}  # as published, each beside its own licence

# Put together here, so that this file passes its own test.
MACHINE_PATH = re.compile(
    r'(?<![\w.$~{}*)\]/-])/(?:' + '|'.join(['root', 'work', 'tmp', 'home']) + ')/'
)
REGISTRY = re.compile(
    '|'.join(
        re.escape('.'.join(parts))
        for parts in (
            ('pypi', 'org'),
            ('pythonhosted', 'org'),
            ('npmjs', 'org'),
            ('deb', 'debian', 'org'),
            ('archive', 'ubuntu', 'com'),
        )
    )
    + '|--(?:extra-index|index|trusted)-(?:url|host)|file:/{2}'
)


def sources() -> Iterator[Path]:
    """Yield the text files of the source tree."""
    for folder, folders, names in os.walk(ROOT):
        folders[:] = sorted(
            name
            for name in folders
            if name not in BUILT
            and not name.endswith('.egg-info')
            and (not name.startswith('.') or name == '.ci')
        )
        for name in sorted(names):
            path = Path(folder, name)
            if name == '.git':  # of a work tree of its own, which says where the repository is
                continue
            if path.suffix in TEXT or name in COMMENTED_NAMES:
                yield path


def is_recorded(path: Path) -> bool:
    """Return whether a file is data, or published by others, rather than source."""
    parts = path.relative_to(ROOT).parts
    recorded = parts[0] == 'bags' or parts[:2] == ('examples', 'mill_warm_up')
    return (recorded and path.suffix != '.py') or VENDORED <= set(parts)


SOURCES = list(sources())
SOURCE_FILES = [
    path
    for path in SOURCES
    if (path.suffix in COMMENTED or path.name in COMMENTED_NAMES)
    and not is_recorded(path)
    and path.stat().st_size
]


def label(path: Path) -> str:
    """Return a test id."""
    return str(path.relative_to(ROOT))


def test_the_tree_was_found():
    assert {'setup.py', 'Makefile', '.ci/run', 'package.xml'} <= {label(path) for path in SOURCES}


def test_what_others_published_carries_its_licence():
    folders = [path for path in ROOT.glob('fuzzycnc_ros/*/vendor/*') if path.is_dir()]
    assert folders
    assert all((path / 'LICENSE').exists() for path in folders)


@for_each(SOURCE_FILES, label)
def test_header(path):
    head = path.read_text(encoding='utf-8').splitlines()[:6]
    while head and head[0].startswith(('#!', '<?xml', '<!DOCTYPE', '<!doctype')):
        head.pop(0)
    if head and head[0].strip() in ('{#', '/*', '<!--'):
        head.pop(0)
    for line, wanted in zip(head, HEADER, strict=False):
        assert wanted in line, f'expected "{wanted}" but found "{line}"'
    assert len(head) >= len(HEADER)


@for_each(SOURCES, label)
def test_no_machine_path_and_no_registry(path):
    text = path.read_text(encoding='utf-8')
    found = [
        f'{label(path)}:{number}: {line.strip()}'
        for number, line in enumerate(text.splitlines(), 1)
        if MACHINE_PATH.search(line) or REGISTRY.search(line)
    ]
    assert not found
