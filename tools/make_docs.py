#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Build the site from the pages and the docstrings: `make docs`, result in build/docs/html.

The pages are copied to build/docs/source first, and what only the site has is put beside them:
pages of the API and drawn diagrams.  A warning, a dead link, and anything that a browser would
fetch from elsewhere are errors, and so are pages that are hard to read.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / 'build' / 'docs' / 'source'
HTML = ROOT / 'build' / 'docs' / 'html'
DOORS = ('thermal', 'feedrate', 'servo', 'soft')
BEHIND = ('core', 'papers', 'simulation', 'runtime', 'bags', 'adapters')
"""What the second part of the API reference has."""

LONGEST = 25
"""Words in a sentence of README and tutorials."""

LONGEST_PARAGRAPH = 120
"""Words in a paragraph or a point of a list of any page."""

EASE = {'README.md': 55, 'docs/tutorials': 55, 'docs/how-to': 55, 'docs': 45}
"""Least reading ease (Flesch) of the pages that begin so; the first that fits counts."""

CALQUES = re.compile(
    r"""\b(?:
        no\ good\ against | a\ wish\ to | what\ (?:is|was)\ left | what\ stands | better\ still
      | nobody | somebody | whoever | makes?\ of\ (?:it|them) | counts?\ for\ nothing
      | is\ for\ you\ to | any\ more | (?:each|one)\ for\ itself | is\ another\ one
      | tells? | told | held\ out\ are | sensor\ lies | knows\ no | lacks\ of | um
    )\b""",
    re.VERBOSE | re.IGNORECASE,
)
"""Turns of phrase that an English editor would change, and um for µm."""

OUTSIDE = {'README.md': 'index.md', 'CONTRIBUTING.md': 'contributing.md'}
"""Pages of the repository's root and what the site has in their place."""

FENCE = re.compile(r'^```mermaid\n(.*?)^```', re.M | re.S)
LINK = re.compile(r'(!?)\[([^\]]*)\]\(([^)\s]+)\)')
FETCHED = re.compile(
    r'<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\ssrc(?:set)?="((?:https?:)?//[^"]+)"'
    r'|<link\b(?=[^>]*rel="(?:stylesheet|preload|preconnect|icon|shortcut icon|prefetch)")'
    r'[^>]*?href="((?:https?:)?//[^"]+)"'
    r'|(?:@import\s+|url\()["\']?((?:https?:)?//[^"\')\s]+)'
)


def drawn(page: Path, text: str) -> str:
    """Return a page with its diagrams as pictures."""

    def image(match: re.Match[str]) -> str:
        name = hashlib.sha256(match[1].strip().encode()).hexdigest()[:16]
        path = SOURCE / 'figures' / 'diagrams' / f'{name}.svg'
        if not path.exists():
            raise SystemExit(
                f'{page}: expected a picture of each diagram but {path.name} is missing: '
                'run tools/draw_diagrams.py'
            )
        return f'```{{image}} {os.path.relpath(path, page.parent)}\n:class: diagram\n```'

    return FENCE.sub(image, text)


def linked(page: Path, text: str, origin: Path) -> str:
    """Return a page whose links lead to pages of the site; what else they name is only named."""

    def link(match: re.Match[str]) -> str:
        image, label, target = match.groups()
        name, _, anchor = target.partition('#')
        if not name or re.match(r'[a-z]+:', name):
            return match[0]
        path = Path(os.path.normpath(origin.parent / name))
        path = path / 'index.md' if (path / 'index.md').exists() else path
        inside = path.is_relative_to(ROOT / 'docs')
        if inside:
            path = SOURCE / path.relative_to(ROOT / 'docs')
        elif path.name in OUTSIDE and path.parent == ROOT:
            path = SOURCE / OUTSIDE[path.name]
            anchor = anchor if path.stem != 'index' else ''
        elif path.suffix == '.ipynb':
            path = SOURCE / path.relative_to(ROOT)
        else:
            return label
        found = os.path.relpath(path, page.parent) + (f'#{anchor}' if anchor else '')
        return f'{image}[{label}]({found})'

    parts = re.split(r'(^```.*?^```)', text, flags=re.M | re.S)
    return ''.join(part if part.startswith('```') else LINK.sub(link, part) for part in parts)


def copy_pages() -> None:
    """Copy the pages, so that the site's own ones do not lie among them."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    shutil.copytree(ROOT / 'docs', SOURCE)
    # Notebooks read what lies beside them.
    shutil.copytree(
        ROOT / 'examples', SOURCE / 'examples', ignore=shutil.ignore_patterns('README.md')
    )
    shutil.copy(ROOT / 'CONTRIBUTING.md', SOURCE / 'contributing.md')
    for page in SOURCE.rglob('*.md'):
        origin = ROOT / 'docs' / page.relative_to(SOURCE)
        if page.name == 'contributing.md':
            origin = ROOT / 'CONTRIBUTING.md'
        text = linked(page, page.read_text(encoding='utf-8'), origin)
        page.write_text(drawn(page, text), encoding='utf-8')


def add_contents(page: str, *entries: str) -> None:
    """Add pages that only the site has to the contents of a page."""
    path = SOURCE / page
    head, _, tail = path.read_text(encoding='utf-8').rpartition('\n```')
    path.write_text('\n'.join([head, *entries, '```', tail]), encoding='utf-8')


def titled(title: str, text: str) -> list[str]:
    """Return the beginning of a page."""
    return [title, '=' * len(title), '', text, '']


def contents(names: list[str]) -> list[str]:
    """Return a table of contents."""
    return ['.. toctree::', '   :maxdepth: 1', '', *(f'   {name}' for name in names), '']


def modules() -> Iterator[str]:
    """Yield the modules of the second part that define something public."""
    for ring in BEHIND:
        for path in sorted((ROOT / 'fuzzycnc_ros' / ring).rglob('*.py')):
            parts = path.relative_to(ROOT).with_suffix('').parts
            if path.stem != '__init__' and not path.stem.startswith('_'):
                yield '.'.join(parts)


def write_api() -> None:
    """Write a page for each door, for each public name of it, and for each module behind."""
    folder = SOURCE / 'reference' / 'api'
    folder.mkdir(parents=True)
    for door in DOORS:
        name = f'fuzzycnc_ros.api.{door}'
        found = import_module(name)
        lines = titled(f'fuzzycnc_ros.{door}', f'.. automodule:: {name}\n   :no-members:')
        lines += [f'.. currentmodule:: {name}', '', '.. autosummary::', '   :toctree: .', '']
        lines += [f'   {item}' for item in found.__all__]
        (folder / f'{door}.rst').write_text('\n'.join(lines) + '\n', encoding='utf-8')
    names = []
    for name in modules():
        lines = titled(name.removeprefix('fuzzycnc_ros.'), f'.. automodule:: {name}\n   :members:')
        (folder / f'{name}.rst').write_text('\n'.join(lines) + '\n', encoding='utf-8')
        names.append(name)
    lines = titled('Python', 'The doors first: from data to a result in a few lines.')
    lines += contents(list(DOORS))
    lines += ['Everything behind them. Here names may still move from version to version.', '']
    lines += contents(names)
    (folder / 'index.rst').write_text('\n'.join(lines), encoding='utf-8')


def fetched() -> list[str]:
    """Return what a browser would fetch from elsewhere when it shows the site."""
    found = []
    for path in sorted(HTML.rglob('*')):
        if path.suffix in ('.html', '.css', '.svg'):
            for groups in FETCHED.findall(path.read_text(encoding='utf-8')):
                found.append(f'{path.relative_to(HTML)}: {"".join(groups)}')
    return found


def paragraphs(text: str) -> list[str]:
    """Return the paragraphs and points of a page, without code blocks, tables and headings."""
    text = re.sub(r'^ *```.*?^ *```', '\n', text, flags=re.M | re.S)
    text = re.sub(r'<[^>]+>', '', text)
    text = re.sub(r'!?\[([^\]]*)\]\([^)]*\)', r'\1', text)
    text = re.sub(r'^(?:#| *\||    |:::).*$', '', text, flags=re.M)
    text = re.sub(r'^\s*(?:[-*]|\d+\.) +', '\n\n', text, flags=re.M)
    return [' '.join(item.split()) for item in re.split(r'\n\s*\n', text) if item.strip()]


def prose(text: str) -> list[str]:
    """Return the sentences of a page, without code blocks, tables, headings and addresses."""
    found = []
    for paragraph in paragraphs(text):
        words = re.sub(r'[`*]', '', paragraph)
        found += [
            item for item in re.split(r'(?<=[.!?:])\s+(?=[^a-z]|fuzzycnc)', words) if ' ' in item
        ]
    return found


def clumsy(page: str, text: str) -> list[str]:
    """Return what makes a page hard to read, without its reading ease."""
    found = []
    if not page.startswith('docs/') or page.startswith('docs/tutorials'):
        found += [
            f'{page}: expected sentences of at most {LONGEST} words but found "{item}"'
            for item in prose(text)
            if len(item.split()) > LONGEST
        ]
    for item in paragraphs(text):
        if len(item.split()) > LONGEST_PARAGRAPH:
            found.append(
                f'{page}: expected paragraphs of at most {LONGEST_PARAGRAPH} words but found '
                f'{len(item.split())}: "{item[:60]} ..."'
            )
        found += [
            f'{page}: expected plain English but found "{match[0]}" in "{item[:60]} ..."'
            for match in CALQUES.finditer(re.sub(r'`[^`]*`', '', item))
        ]
    return found


def pages() -> dict[str, str]:
    """Return the text of README and of every page, by path."""
    paths = (ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md')))
    return {str(path.relative_to(ROOT)): path.read_text(encoding='utf-8') for path in paths}


def unreadable() -> list[str]:
    """Return what makes pages hard to read."""
    import textstat

    found = []
    for page, text in pages().items():
        found += clumsy(page, text)
        ease = textstat.flesch_reading_ease(
            ' '.join(item.rstrip('.:') + '.' for item in prose(text))
        )
        least = next(value for begin, value in EASE.items() if page.startswith(begin))
        if ease < least:
            found.append(f'{page}: expected a reading ease of at least {least} but found {ease}')
    return found


def main() -> int:
    """Build the site and say what is wrong with it."""
    from sphinx.cmd.build import build_main

    os.environ['SOURCE_DATE_EPOCH'] = '0'  # the same pages from the same sources
    sys.path.insert(0, str(ROOT))
    copy_pages()
    write_api()
    add_contents('reference/index.md', 'api/index')
    add_contents('index.md', 'contributing')
    for book in sorted((SOURCE / 'examples').glob('*.ipynb')):
        add_contents('tutorials/index.md', f'../examples/{book.stem}')
    shutil.rmtree(HTML, ignore_errors=True)
    options = ['-W', '--keep-going', '-q', '-j', 'auto', '-b', 'html']
    options += ['-d', str(HTML.parent / 'doctrees')]
    failed = build_main([*options, *sys.argv[1:], str(SOURCE), str(HTML)])
    found = fetched()
    for line in found:
        print(f'expected nothing from elsewhere but found {line}')
    for line in (hard := unreadable()):
        print(line)
    print(f'{len(list(HTML.rglob("*.html")))} pages in {HTML.relative_to(ROOT)}/index.html')
    return int(bool(failed or found or hard))


if __name__ == '__main__':
    sys.exit(main())
