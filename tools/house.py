#!/usr/bin/env python3
# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Count what there is to read: code lines, names with two meanings, loops between folders.

Usage: tools/house.py [--before OTHER_TREE]

Code lines hold a statement: no docstring, comment or blank line.  Folders are those right below
the package, and its modules there.  An arrow is an import from one into another that no longer way
of arrows implies, so that there is one picture of folders without loops.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'fuzzycnc_ros'
PICTURE = Path('docs') / 'explanation' / 'architecture.md'
QUESTION = re.compile(r'\W*(?:What|Whether|How|Who|Where|When)\b')
IGNORED = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}

Graph = dict[str, set[str]]


def docstrings(tree: ast.Module) -> Iterator[ast.Constant]:
    """Yield the strings that stand alone: docstrings of modules, classes, functions, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if isinstance(node.value.value, str):
                yield node.value


def python_lines(text: str) -> int:
    """Return the code lines of a Python file."""
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in IGNORED:
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in docstrings(ast.parse(text)):
        lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def script_lines(text: str) -> int:
    """Return the code lines of a JavaScript file."""
    bare = re.sub(r'^\s*/\*.*?\*/', '', text, flags=re.M | re.S)
    lines = [line.strip() for line in bare.splitlines()]
    return sum(bool(line) and not line.startswith('//') for line in lines)


def folder(path: Path, package: Path) -> str:
    """Return the folder or module right below the package."""
    return path.relative_to(package).parts[0].removesuffix('.py')


def imports(package: Path) -> Graph:
    """Return the folders that each folder imports from, by the modules' own statements."""
    found: Graph = {}
    for path in set(package.rglob('*.py')) - set(package.glob('__*__.py')):
        targets = found.setdefault(folder(path, package), set())
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.ImportFrom):
                base = (node.module or '').split('.')
                names = [[*base, alias.name] for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name.split('.') for alias in node.names]
            else:
                continue
            targets |= {name[1] for name in names if name[0] == PACKAGE and len(name) > 1}
    return {name: (targets & set(found)) - {name} for name, targets in found.items()}


def reached(graph: Graph, start: str) -> set[str]:
    """Return all folders that lie along the arrows from one of them."""
    seen: set[str] = set()
    ahead = [*graph[start]]
    while ahead:
        name = ahead.pop()
        if name not in seen:
            seen.add(name)
            ahead += graph.get(name, ())
    return seen


def reduced(graph: Graph) -> set[tuple[str, str]]:
    """Return the arrows of a graph without those that a longer way implies."""
    left = {name: set(targets) for name, targets in graph.items()}
    for name in sorted(left):
        for target in sorted(left[name]):
            left[name].discard(target)
            if target not in reached(left, name):
                left[name].add(target)
    return {(name, target) for name, targets in left.items() for target in targets}


def drawn(tree: Path) -> set[tuple[str, str]]:
    """Return the arrows of the first picture on the page of the architecture."""
    text = (tree / PICTURE).read_text(encoding='utf-8').split('```mermaid', 1)[1].split('```')[0]
    found = re.findall(r'^ *(\w+)(?:\[[^\]]*\])? --> (\w+)', text, re.M)
    return {(name.rstrip('_'), target.rstrip('_')) for name, target in found}  # `graph_`


def measured(tree: Path) -> dict[str, int]:
    """Return all figures of a tree."""
    package = tree / PACKAGE
    sources = {
        part: [path.read_text(encoding='utf-8') for path in (tree / part).rglob('*.py')]
        for part in (PACKAGE, 'test', 'tools')
    }
    scripts = [path for path in package.rglob('*.js') if 'vendor' not in path.parts]
    parsed = [ast.parse(text) for text in sources[PACKAGE]]
    classes = [
        name
        for module in parsed
        for name in {node.name for node in ast.walk(module) if isinstance(node, ast.ClassDef)}
    ]
    graph = imports(package)
    return {
        'code lines of the package': sum(map(python_lines, sources[PACKAGE])),
        'code lines of the tests': sum(map(python_lines, sources['test'])),
        'code lines of the tools': sum(map(python_lines, sources['tools'])),
        'code lines of JavaScript': sum(script_lines(path.read_text()) for path in scripts),
        'class names with two meanings': len(
            {name for name in classes if classes.count(name) > 1}
        ),
        'docstrings that begin with a question': sum(
            QUESTION.match(str(node.value)) is not None
            for module in parsed
            for node in docstrings(module)
        ),
        'folders on a loop of imports': sum(name in reached(graph, name) for name in graph),
        'arrows drawn': len(drawn(tree)),
        'arrows there': len(reduced(graph)),
        'arrows drawn wrong or missing': len(drawn(tree) ^ reduced(graph)),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--before', type=Path, help='tree of another state, shown beside')
    given = parser.parse_args()
    now = measured(ROOT)
    before = measured(given.before.resolve()) if given.before else {}
    for name, value in now.items():
        print(f'{name:<40} {before.get(name, ""):>8} {value:>8}')


if __name__ == '__main__':
    main()
