# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A public name of the core and of the simulations means one thing."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / 'fuzzycnc_ros'
RINGS = ('core', 'simulation')


def defined(tree: ast.Module) -> list[str]:
    """Return the public names that a module defines itself."""
    names = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            if 'overload' not in {ast.unparse(item) for item in node.decorator_list}:
                names.append(node.name)
        elif isinstance(node, ast.Assign):
            names += [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.append(node.target.id)
    return [name for name in names if not name.startswith('_')]


def test_no_name_is_defined_twice():
    """Two ideas have two names; one idea is defined once and imported."""
    owners = defaultdict(list)
    for ring in RINGS:
        for path in sorted((PACKAGE / ring).rglob('*.py')):
            for name in defined(ast.parse(path.read_text(encoding='utf-8'))):
                owners[name].append(path.relative_to(PACKAGE).as_posix())
    assert len(owners) > 500
    assert not {name: found for name, found in owners.items() if len(found) > 1}
