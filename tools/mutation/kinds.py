# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The faults that can be put into a source file, each a change of one line."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, replace

KINDS = ('comparison', 'sign', 'bound', 'branch', 'constant', 'return')
FLIPPED: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ('<', '>='),
    ast.LtE: ('<=', '>'),
    ast.Gt: ('>', '<='),
    ast.GtE: ('>=', '<'),
    ast.Eq: ('==', '!='),
    ast.NotEq: ('!=', '=='),
}
SIGNS: dict[type[ast.AST], tuple[str, str]] = {ast.Add: ('+', '-'), ast.Sub: ('-', '+')}
LIMITS = {'min', 'max', 'minimum', 'maximum', 'fmin', 'fmax'}
NUMBERS = ('float', 'int', 'Array', 'Vector')
SILENT = {'__repr__', '__str__', '__hash__'}
INDEX_LIKE = (0, 1, 2)
SELF_CONTAINED = (ast.Name, ast.Constant, ast.Attribute, ast.Call, ast.Subscript)
Span = tuple[int, int, int]
"""Line from 1, first byte in it, byte behind the last."""


@dataclass(frozen=True)
class Place:
    """Where a change is.

    Attributes
    ----------
    lines : (int, int)
        First and last line of the code that behaves differently; a test that runs none of it
        cannot notice.
    owner : str
        Name at the top of the file whose value changes on import; empty in a function's body.
    returns : str
        What the function says it returns.
    index : bool
        Whether it is part of an index.
    """

    lines: tuple[int, int] = (1, 1)
    owner: str = ''
    returns: str = ''
    index: bool = False


@dataclass(frozen=True)
class Change:
    """A kind of fault: the span of a line that is replaced, and what stands there instead."""

    kind: str
    span: Span
    text: str
    place: Place


def changes(source: str) -> Iterator[Change]:
    """Yield all changes of a file's text; each leaves it valid Python."""
    rows = [row.encode() for row in source.split('\n')]
    yield from _changes_of(ast.parse(source), Place(), rows)


def _changes_of(node: ast.AST, place: Place, rows: list[bytes]) -> Iterator[Change]:
    if isinstance(node, ast.stmt):
        body = getattr(node, 'body', None)
        last = node.end_lineno if body is None else max(body[0].lineno - 1, node.lineno)
        place = replace(place, lines=(node.lineno, last or node.lineno))
    for kind, span, text, within in _edits(node, place, rows):
        if span is not None:
            yield Change(kind, span, text, within)
    for child, where in _parts(node, place):
        yield from _changes_of(child, where, rows)


def _parts(node: ast.AST, place: Place) -> Iterator[tuple[ast.AST, Place]]:
    """Yield what is inside a node, but texts, annotations and the messages of errors."""
    match node:
        case ast.Raise() | ast.JoinedStr():  # inside texts positions are wrong before Python 3.12
            return
        case ast.Module(body=body):
            for child in body:
                name = child.targets[0] if isinstance(child, ast.Assign) else child
                name = child.target if isinstance(child, ast.AnnAssign) else name
                owner = getattr(name, 'name', getattr(name, 'id', ''))
                if owner != '__all__':
                    yield child, replace(place, owner=owner)
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            if node.name not in SILENT:
                for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
                    yield default, place
                returns = ast.unparse(node.returns) if node.returns else ''
                for child in node.body:
                    yield child, replace(place, owner='', returns=returns)
        case ast.ClassDef(body=body):
            yield from ((child, place) for child in body)
        case ast.AnnAssign(value=value):
            if value is not None:
                yield value, place
        case ast.Subscript(value=value, slice=index):
            yield value, place
            yield index, replace(place, index=True)
        case ast.If(test=test) if _of_import(test):
            return
        case _:
            yield from ((child, place) for child in ast.iter_child_nodes(node))


def _edits(
    node: ast.AST, place: Place, rows: list[bytes]
) -> Iterator[tuple[str, Span | None, str, Place]]:
    """Yield the changes of a node itself; no span where it is on several lines."""
    match node:
        case ast.Compare():
            sides = [node.left, *node.comparators]
            for left, operator, right in zip(sides, node.ops, node.comparators, strict=False):
                if type(operator) in FLIPPED:
                    between, text = _between(left, right, rows)
                    text = text.replace(*FLIPPED[type(operator)], 1)
                    yield 'comparison', between, text, place
        case ast.BinOp(left=left, op=operator, right=right):
            numbers = _is_number(left) and _is_number(right)
            if type(operator) in SIGNS and numbers and not place.index:
                between, text = _between(left, right, rows)
                yield 'sign', between, text.replace(*SIGNS[type(operator)], 1), place
        case ast.UnaryOp(op=ast.USub(), operand=operand) if not place.index:
            yield 'sign', _span(node), _text(operand, rows), place
        case ast.Call(func=func, args=args, keywords=[]):
            name = getattr(func, 'id', getattr(func, 'attr', ''))
            bounded = [arg for arg in args if not isinstance(arg, ast.Constant)] or args
            if any(isinstance(arg, ast.Starred) for arg in args):
                return
            if name in LIMITS and len(args) == 2:
                yield 'bound', _span(node), _text(bounded[0], rows), place
            elif name == 'clip' and isinstance(func, ast.Attribute):
                kept = func.value if len(args) == 2 else args[0]
                yield 'bound', _span(node), _text(kept, rows), place
        case ast.If(test=test, body=body) | ast.While(test=test, body=body):
            guards = isinstance(node, ast.If) and all(isinstance(b, ast.Raise) for b in body)
            named = any(isinstance(child, ast.NamedExpr) for child in ast.walk(test))
            if not named and not _of_import(test):
                lines = body[0].lineno, body[-1].end_lineno or body[-1].lineno
                within = replace(place, lines=lines)
                yield 'bound' if guards else 'branch', _span(test), 'False', within
        case ast.IfExp(test=test):
            yield 'branch', _span(test), 'False', place
        case ast.Constant(value=int() | float() as value) if type(value) is not bool:
            if value not in INDEX_LIKE and not place.index:
                way = 1 if node.lineno % 2 else -1
                more = value + way * max(1, round(0.1 * value))
                part = repr(float(f'{value * (1 + 0.1 * way):.6g}'))
                yield 'constant', _span(node), str(more) if type(value) is int else part, place
        case ast.Return(value=ast.expr() as value):
            number = '[' not in place.returns and any(n in place.returns for n in NUMBERS)
            nothing = isinstance(value, ast.Constant) and not value.value
            if place.returns == 'bool':
                yield 'return', _span(value), f'not {_text(value, rows)}', place
            elif not nothing:
                text = f'-{_text(value, rows)}' if number else 'None'
                yield 'return', _span(value), text, place


def _of_import(test: ast.expr) -> bool:
    """Return whether a condition asks how the file is used, not what it works on."""
    return any(name in ast.unparse(test) for name in ('TYPE_CHECKING', '__name__'))


def _is_number(side: ast.expr) -> bool:
    """Return whether an operand may be a number, not a text, list or set."""
    if isinstance(side, ast.Constant):
        return isinstance(side.value, (int, float))
    if isinstance(side, ast.Call):
        return getattr(side.func, 'id', '') not in {'dict', 'list', 'set', 'str', 'tuple'}
    return not isinstance(side, (ast.JoinedStr, ast.List, ast.Set, ast.Tuple))


def _span(node: ast.expr) -> Span | None:
    if node.lineno != node.end_lineno or node.end_col_offset is None:
        return None
    return node.lineno, node.col_offset, node.end_col_offset


def _between(left: ast.expr, right: ast.expr, rows: list[bytes]) -> tuple[Span | None, str]:
    """Return what stands between two operands: the operator, and parentheses of theirs."""
    if left.end_lineno != right.lineno or left.end_col_offset is None:
        return None, ''
    span = right.lineno, left.end_col_offset, right.col_offset
    return span, rows[span[0] - 1][span[1] : span[2]].decode()


def _text(node: ast.expr, rows: list[bytes]) -> str:
    """Return the text of an expression, in parentheses unless it is one thing."""
    span = _span(node)
    text = rows[span[0] - 1][span[1] : span[2]].decode() if span else ''
    return text if isinstance(node, SELF_CONTAINED) else f'({text})'
