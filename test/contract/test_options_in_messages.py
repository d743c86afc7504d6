# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every option that a message names exists where the message is printed.

A text is printed by whatever reaches the function that it stands in: a command, a node, a door for
Python.  So each command has to have the options that the texts in its reach name, and neither
nodes nor doors may name any, unless they put the text into their own words.  A whole command may
stand anywhere, such as `fuzzycnc info --repair`, if it exists and has the option.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import typer

from fuzzycnc_ros.cli.main import APPLICATION

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / 'fuzzycnc_ros'

OPTION = re.compile(r'(?<![\w-])--[a-z][a-z0-9-]*')
COMMAND = re.compile(r'fuzzycnc((?: [a-z][a-z0-9-]*)+)(?:\\\n|[^`;\n])*')

OTHERS = (
    *('--ros-args', '--params-file', '--param', '--nthreads'),
    *('--install', '--print-modinc'),  # of halcompile
    *('--bar', '--hue'),  # variables of a style sheet
)
"""No options of our commands: those of ROS nodes and `dask worker`, and what only looks so."""

OF_NODES = '--machine-file'
"""Option that the executables of nodes take beside those of ROS."""

COMMAND_LINES = {
    'fuzzycnc_ros.cli.live.service': (
        'fuzzycnc up',
        'fuzzycnc record',
        'fuzzycnc service install',
        'fuzzycnc service remove',
        'fuzzycnc service show',
    ),
    'fuzzycnc_ros.cli.live.service_units': ('fuzzycnc up', 'fuzzycnc record'),
}
"""Modules that put together the command lines of others, and these."""

OWN_WORDS = {
    'fuzzycnc_ros.bags.csv_import',
    'fuzzycnc_ros.bags.csv_mapping',
    'fuzzycnc_ros.bags.csv_table',
    'fuzzycnc_ros.bags.csv_time',
}
"""Modules whose texts the doors for Python and the nodes put into their own words."""

IN_OWN_WORDS = {'fuzzycnc sensors check'}
"""Commands that do so too: they name `fuzzycnc import-csv`, which has the options."""

Place = tuple[str, str]
"""Module and name of a function, class or constant in it; no name is the module itself."""


def module_of(path: Path) -> str:
    """Return the name of a file's module."""
    parts = path.relative_to(ROOT).with_suffix('').parts
    return '.'.join(part for part in parts if part != '__init__')


@cache
def trees() -> Mapping[str, ast.Module]:
    """Return the source of each module, without what is imported for types only."""
    found = {}
    for path in PACKAGE.rglob('*.py'):
        tree = ast.parse(path.read_text(encoding='utf-8'))
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and getattr(node.test, 'id', '') == 'TYPE_CHECKING':
                node.body = [ast.Pass()]
        found[module_of(path)] = tree
    return found


def parts(tree: ast.Module) -> Iterator[tuple[tuple[str, ...], ast.stmt]]:
    """Return each statement of a module with the names that it defines."""
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield (node.name,), node
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield tuple(item.id for item in targets if isinstance(item, ast.Name)) or ('',), node
        else:
            yield ('',), node


@cache
def imported(module: str) -> Mapping[str, Place]:
    """Return what names of a module mean that are imported, anywhere in it."""
    found = {}
    for node in ast.walk(trees()[module]):
        if isinstance(node, ast.ImportFrom) and node.module in trees():
            for item in node.names:
                whole = f'{node.module}.{item.name}'
                place = (whole, '') if whole in trees() else (node.module, item.name)
                found[item.asname or item.name] = place
        elif isinstance(node, ast.ImportFrom):
            for item in node.names:
                if (whole := f'{node.module}.{item.name}') in trees():
                    found[item.asname or item.name] = (whole, '')
    return found


@cache
def uses() -> Mapping[Place, frozenset[Place]]:
    """Return which places each place uses."""
    found: dict[Place, set[Place]] = defaultdict(set)
    for module, tree in trees().items():
        named = {name: (module, name) for names, _ in parts(tree) for name in names if name}
        known = {**imported(module), **named}
        for name, place in imported(module).items():
            found[module, name].add(place)
        for names, statement in parts(tree):
            used = set()
            for node in ast.walk(statement):
                if isinstance(node, ast.Name) and node.id in known:
                    used.add(known[node.id])
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    place = known.get(node.value.id)
                    if place is not None and not place[1]:
                        used.add((place[0], node.attr))
            for name in names:
                found[module, name] |= used
    return {place: frozenset(used) for place, used in found.items()}


def reached(*roots: Place) -> frozenset[Place]:
    """Return all places that are used from some, directly or through others."""
    found, left = set(roots), list(roots)
    while left:
        new = uses().get(left.pop(), frozenset()) - found
        found |= new
        left += new
    return frozenset(found)


@cache
def commands() -> Mapping[str, tuple[Place, frozenset[str]]]:
    """Return each command: its function, and its options."""
    found = {}

    def walk(command, words):
        if hasattr(command, 'list_commands'):
            context = command.make_context(words, [], resilient_parsing=True)
            for name in command.list_commands(context):
                walk(command.get_command(context, name), f'{words} {name}')
            return
        options = {name for item in command.params for name in (*item.opts, *item.secondary_opts)}
        function = command.callback
        place = function.__module__, function.__name__
        found[words] = place, frozenset(options | {'--help', '--debug', '--version'})

    walk(typer.main.get_command(APPLICATION.typer), 'fuzzycnc')
    return found


def others() -> Mapping[str, frozenset[Place]]:
    """Return what else prints: nodes and doors, each with all that it reaches."""
    found = {}
    for module, tree in trees().items():
        area = module.split('.')[1] if '.' in module else ''
        if area in ('nodes', 'api', 'web'):
            roots = [(module, name) for names, _ in parts(tree) for name in names]
            found[module] = reached(*roots)
    return found


def with_dashes() -> Iterator[tuple[str, ast.Module]]:
    """Return the modules that may name options."""
    for path in PACKAGE.rglob('*.py'):
        if OPTION.search(path.read_text(encoding='utf-8')):
            yield module_of(path), trees()[module_of(path)]


def texts(statement: ast.stmt) -> Iterator[tuple[int, str]]:
    """Return the texts that may be printed: all but docstrings; values of f-strings as VALUE."""
    silent: set[int] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            silent.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            silent |= {id(part) for part in node.values}
            constants = (getattr(part, 'value', None) for part in node.values)
            yield (
                node.lineno,
                ''.join(item if isinstance(item, str) else 'VALUE' for item in constants),
            )
    for node in ast.walk(statement):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in silent:
                yield node.lineno, node.value


def in_commands(text: str) -> tuple[str, list[str]]:
    """Return a text without the whole commands in it, and what is wrong with these."""
    wrong = []
    for match in COMMAND.finditer(text):
        names = ['fuzzycnc', *match[1].split()]
        whole = (' '.join(names[:end]) for end in range(len(names), 1, -1))
        name = next((name for name in whole if name in commands()), None)
        if name is None:
            continue
        # Behind a lone -- stand options of another command.
        own = match[0].split(' -- ')[0]
        wrong += [
            f'{option} is no option of {name}'
            for option in OPTION.findall(own)
            if option not in commands()[name][1]
        ]
    return COMMAND.sub('', text), wrong


@cache
def named_options() -> tuple[tuple[str, Place, str], ...]:
    """Return each option that stands alone in a text: where, in which place, the option."""
    return tuple(
        (f'{module}:{line}', (module, names[0]), option)
        for module, tree in with_dashes()
        for names, statement in parts(tree)
        for line, text in texts(statement)
        if '--' in text
        for option in OPTION.findall(in_commands(text)[0])
        if option not in OTHERS
    )


def test_every_option_in_a_text_is_one_of_the_command_that_prints_it():
    reach = {name: (reached(place), options) for name, (place, options) in commands().items()}
    wrong = []
    for where, place, option in named_options():
        printing = [(name, options) for name, (found, options) in reach.items() if place in found]
        if place[0] in COMMAND_LINES:
            printing = [(name, reach[name][1]) for name in COMMAND_LINES[place[0]]]
            lacking = [] if any(option in options for _, options in printing) else [place[0]]
        else:
            told = IN_OWN_WORDS if place[0] in OWN_WORDS else set()
            lacking = [n for n, options in printing if option not in options and n not in told]
        if lacking:
            wrong.append(f'{where}: {option} is no option of {", ".join(lacking[:4])}')
    assert not wrong, '\n' + '\n'.join(wrong)


def test_nodes_and_doors_name_no_option_of_a_command():
    reach = others()
    wrong = []
    for where, place, option in named_options():
        if place[0] in OWN_WORDS:
            continue
        printing = [name for name, found in reach.items() if place in found]
        if option == OF_NODES:
            printing = [name for name in printing if '.nodes.' not in name]
        if printing:
            wrong.append(f'{where}: {option} is printed by {", ".join(printing[:4])}')
    assert not wrong, '\n' + '\n'.join(wrong)


def test_whole_commands_in_texts_exist_and_have_their_options():
    wrong = [
        f'{module}:{line}: {item}'
        for module, tree in with_dashes()
        for _, statement in parts(tree)
        for line, text in texts(statement)
        if '--' in text
        for item in in_commands(text)[1]
    ]
    assert not wrong, '\n' + '\n'.join(wrong)


def test_the_reach_is_no_guess():
    """A text is found in what prints it, and in nothing else, on places that are known."""
    train, evaluate = commands()['fuzzycnc train'][0], commands()['fuzzycnc evaluate'][0]
    check_gaps = ('fuzzycnc_ros.core.thermal.fit.training_runs', 'check_gaps')
    assert check_gaps in reached(train)
    learning = ('fuzzycnc_ros.studies.soft.foam_learning', 'learn_track')
    assert learning in uses()
    assert learning not in reached(evaluate)
    assert check_gaps in others()['fuzzycnc_ros.api.thermal']
    assert len(commands()) > 40
    assert len(named_options()) > 100
