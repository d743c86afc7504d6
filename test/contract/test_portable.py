# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What runs on a machine computes with nothing whose digits depend on the processor."""

import ast
from collections.abc import Iterator
from pathlib import Path

from each_case import for_each

PACKAGE = Path(__file__).parents[2] / 'fuzzycnc_ros'

TRAINING = {
    'core/deformation/believed_deviation.py': 'learns the offsets of a pattern',
    'core/deformation/regression.py': 'trains',
    'core/deformation/samples.py': 'identifies a sheet from samples',
    'core/deformation/training.py': 'trains',
    'core/fuzzy/takagi_sugeno.py': 'trains; the firing strengths alone run',
    'core/servo/rule_learning.py': 'learns rules',
    'core/servo/stability.py': 'judges settings',
    'core/thermal/domain.py': 'the domain of a model is part of its training',
    'core/thermal/moments.py': 'least squares of a training without a ridge',
    'core/thermal/turned.py': 'doubts a recording before training',
    'simulation/controller/blends.py': 'judges a part program; no bag holds what it gives',
    'simulation/controller/motion.py': 'likewise',
    'simulation/servo/axis_tuning.py': 'tunes',
    'simulation/soft/foam_tracks.py': 'judges stitches',
}
"""Modules whose results reach a machine as a model or settings only, with what they do."""

DECIDES = {
    ('core/fuzzy/clustering.py', 'np.linalg.eigh'): 'clusters of T-S models, which are trained',
    ('core/fuzzy/clustering.py', 'np.linalg.eigvalsh'): 'likewise',
    ('core/deformation/network.py', '**'): 'in training',
    ('core/thermal/band.py', '@'): 'autocorrelation of residuals that are judged',
    ('core/thermal/prior.py', 'np.linalg.eigvalsh'): 'refuses a model file, and no number',
    ('core/thermal/sensor_watch.py', 'np.linalg.eigvalsh'): 'likewise',
    ('core/feedrate/path/nurbs.py', 'np.linalg.svd'): 'tells straight from bent, and no number',
    ('core/servo/params.py', 'np.linalg.eigvals'): 'tells stable from unstable, and no number',
    ('core/servo/controller.py', 'np.linalg.eigvals'): 'likewise, when a loop swings already',
    ('core/servo/params.py', '@'): 'likewise',
    ('core/feedrate/gcode/expressions.py', 'math.atan2'): 'a program has those of the C library',
    ('core/feedrate/gcode/expressions.py', 'math.acos'): 'likewise',
    ('core/feedrate/gcode/expressions.py', 'math.asin'): 'likewise',
    ('core/feedrate/gcode/expressions.py', 'math.exp'): 'likewise',
    ('core/feedrate/gcode/expressions.py', 'math.log'): 'likewise',
}
"""What else there is, and why the digits do not matter."""

RINGS = ('core', 'components', 'simulation')
MODULES = sorted(
    path
    for ring in RINGS
    for path in (PACKAGE / ring).rglob('*.py')
    if (not {'fit', 'identify'} & set(path.parts) or path.name == 'selection.py')
    and str(path.relative_to(PACKAGE)) not in {*TRAINING, 'core/portable.py'}
)

_FUNCTIONS = {
    *'acos arccos arccosh arcsin arcsinh arctan arctan2 arctanh argpartition asin'.split(),
    *'atan atan2 cbrt convolve corrcoef correlate cos cosh cov dot'.split(),
    *'exp exp2 expm1 float_power inner log log10 log1p log2 logaddexp'.split(),
    *'matmul polyfit polyval pow power sin sinh tan tanh tensordot'.split(),
    *'vdot vecdot'.split(),
}
_EXACT = {'norm'}
"""Of `numpy.linalg`, along an axis: numpy's own sum."""


def _name(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f'{_name(node.value)}.{node.attr}'
    return node.id if isinstance(node, ast.Name) else ''


def _found(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield lines and names of what may depend on the processor."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.BinOp, ast.AugAssign)):
            if isinstance(node.op, ast.MatMult):
                yield node.lineno, '@'
            constant = isinstance(node, ast.BinOp) and isinstance(node.left, ast.Constant)
            # The square of a number is a power of the C library too: `x * x`, `np.square`.
            if isinstance(node.op, ast.Pow) and not constant:
                yield node.lineno, '**'
        elif isinstance(node, ast.ImportFrom):
            wrong = _FUNCTIONS if node.module in ('math', 'cmath', 'numpy') else set()
            for item in node.names:
                if item.name in wrong or node.module in ('scipy.linalg', 'cmath'):
                    if item.name != 'block_diag':
                        yield node.lineno, f'{node.module}.{item.name}'
        elif isinstance(node, ast.Call):
            name = _name(node.func)
            module, _, function = name.rpartition('.')
            keywords = {item.arg for item in node.keywords}
            if function == 'argsort' and 'kind' not in keywords:
                yield node.lineno, f'{name} that is not stable'
            elif function == 'einsum' and 'optimize' in keywords:
                yield node.lineno, f'{name} by BLAS'
            elif module == 'np.linalg' and (function not in _EXACT or 'axis' not in keywords):
                yield node.lineno, name
            elif module in ('np', 'math') and function in _FUNCTIONS:
                yield node.lineno, name
            elif function == 'dot' and module != 'np':
                yield node.lineno, name
        elif isinstance(node, ast.Attribute) and _name(node) in _MATH:
            yield node.lineno, _name(node)


_MATH = {f'math.{name}' for name in _FUNCTIONS}


@for_each(MODULES, label=lambda path: str(path.relative_to(PACKAGE)))
def test_what_runs_on_a_machine_is_the_same_on_every_processor(path):
    name = str(path.relative_to(PACKAGE))
    tree = ast.parse(path.read_text(encoding='utf-8'))
    wrong = {f'line {line}: {what}' for line, what in _found(tree) if (name, what) not in DECIDES}
    assert not wrong, f'{sorted(wrong)}: use core/portable.py'


def test_every_exception_is_still_needed():
    for name in TRAINING:
        tree = ast.parse((PACKAGE / name).read_text(encoding='utf-8'))
        assert any(_found(tree)), name
    for name, what in DECIDES:
        tree = ast.parse((PACKAGE / name).read_text(encoding='utf-8'))
        assert what in {item for _, item in _found(tree)}, (name, what)


def test_the_rule_finds_what_it_is_for():
    text = 'a @ b; np.exp(a); a ** 3; np.argsort(a); np.linalg.norm(a); math.sin(a); a.dot(b)'
    text += '; np.einsum("ij,jk", a, b, optimize=True); np.linalg.norm(a, axis=1); a**2'
    found = [what for _, what in _found(ast.parse(text))]
    assert len(set(found)) == 8, found
    assert [what for _, what in _found(ast.parse('x**2 + 2.0**x'))] == ['**']
