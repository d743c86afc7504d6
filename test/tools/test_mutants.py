# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that puts faults into the sources: which, how they are spread, how they are undone."""

import ast
import json
import sys
import textwrap
from collections import Counter
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

TOOLS = Path(__file__).parents[2] / 'tools'


@pytest.fixture(scope='module')
def tool():
    """The tool as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(TOOLS))
        yield SimpleNamespace(
            **{name: import_module(f'mutation.{name}') for name in ('draw', 'kinds')},
            cli=import_module('mutants'),
        )
    for name in [name for name in sys.modules if name.split('.')[0] in ('mutants', 'mutation')]:
        del sys.modules[name]


def small(text: str) -> str:
    return textwrap.dedent(text).strip('\n') + '\n'


@pytest.fixture
def tree(tmp_path):
    """Write files of the package, given by name, into an empty tree."""

    def write(**files: str) -> Path:
        for name, text in files.items():
            file = tmp_path / 'fuzzycnc_ros' / name.replace('__', '/')
            file = file.with_suffix('.py')
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(small(text))
        return tmp_path

    return write


@pytest.fixture
def lines_after(tool, tree):
    """Return the kinds and changed lines that a text can have."""

    def lines(text: str) -> set[tuple[str, str]]:
        top = tree(convert=text)
        found = tool.draw.mutants_of(top, top / 'fuzzycnc_ros' / 'convert.py', 'convert')
        return {(mutant.kind, mutant.after.strip()) for mutant in found}

    return lines


@pytest.mark.parametrize(
    ('body', 'kind', 'after'),
    [
        ('x = (a) < (b)', 'comparison', 'x = (a) >= (b)'),
        ('x = a <= b < 7', 'comparison', 'x = a > b < 7'),
        ('x = a == b', 'comparison', 'x = a != b'),
        ('x = (a - b) - (a + b)', 'sign', 'x = (a - b) + (a + b)'),
        ('x = -(a + b)', 'sign', 'x = (a + b)'),
        ('x = max(0.0, a + b) * 2', 'bound', 'x = (a + b) * 2'),
        ('x = np.clip(a, 0.0, b)', 'bound', 'x = a'),
        ('x = a.clip(0.0, b)', 'bound', 'x = a'),
        ('if a:\n        raise ValueError(b + 5)', 'bound', 'if False:'),
        ('if a:\n        b = 0', 'branch', 'if False:'),
        ('while a:\n        a = g()', 'branch', 'while False:'),
        ('x = 0 if a else b', 'branch', 'x = 0 if False else b'),
        ('x = 0.35 * a', 'constant', 'x = 0.315 * a'),
        ('x = 4 * a', 'constant', 'x = 3 * a'),
        ('return a * b', 'return', 'return -(a * b)'),
    ],
)
def test_a_change_of_one_line(lines_after, body, kind, after):
    assert (kind, after) in lines_after(f'def f(a: float, b: float) -> float:\n    {body}\n')


def test_what_a_function_returns_instead(lines_after):
    found = lines_after("""
        def f(a) -> bool:
            return a.full
        def g(a) -> tuple[float, float]:
            return a, a
    """)
    assert found == {('return', 'return not a.full'), ('return', 'return None')}


def test_text_annotations_indices_and_messages_stay(lines_after):
    assert not lines_after('''
        """At most 5 < 7."""
        __all__ = ['a' + 'b']
        if TYPE_CHECKING:
            LIMIT = 5
        class A:
            x: Annotated[int, 5]
            def __repr__(self):
                return self.name
        def f(a: Literal[5], *b) -> None:
            """Take -1."""
            print(f'{a + 5}', a[-1], a[5:], 'a' + a)
            raise ValueError(a - 5)
    ''')


@pytest.mark.slow
def test_every_mutant_of_the_package_is_python(tool):
    root = TOOLS.parent
    for name in ('core/config.py', 'bags/mcapfile.py', 'runtime/convert.py', 'runtime/records.py'):
        file = root / 'fuzzycnc_ros' / name
        rows = file.read_text().split('\n')
        for mutant in tool.draw.mutants_of(root, file, ''):
            changed = list(rows)
            changed[mutant.line - 1] = mutant.after
            assert changed != rows
            ast.parse('\n'.join(changed))


def test_what_runs_on_import_is_known_by_its_name(tool, tree):
    top = tree(convert='LIMIT = 5\ndef f(a=7):\n    return a\nclass B:\n    size = 9\n')
    found = tool.draw.mutants_of(top, top / 'fuzzycnc_ros' / 'convert.py', 'convert')
    assert [(m.line, m.owner) for m in found] == [(1, 'LIMIT'), (2, 'f'), (3, ''), (5, 'B')]


SOME = """
    def f(a: float, b: float) -> float:
        if a < b:
            return -a + 7.0
        if a > 9.0:
            raise ValueError
        return max(a - 3.0, b)
"""
OTHERS = ('runtime', 'components', 'ros', 'adapters', 'nodes', 'bags', 'cli')
PLACES = ('core__a__x', 'core__b__x', 'core__y', *(f'{group}__x' for group in OTHERS))


@pytest.fixture
def package(tree):
    """A tree with something in each part of the package."""
    return tree(**dict.fromkeys(PLACES, SOME))


def test_a_draw_is_spread_over_parts_folders_and_kinds(tool, package):
    drawn = tool.draw.draw(package, seed=1, count=49)
    groups = Counter(mutant.group for mutant in drawn)
    assert groups == {'core': 7} | dict.fromkeys(OTHERS, 6)
    folders = Counter(m.file.split('/')[2] for m in drawn if m.group == 'core')
    assert sorted(folders.values()) == [2, 2, 3]
    for group in ('bags', 'runtime'):
        assert {m.kind for m in drawn if m.group == group} == set(tool.kinds.KINDS)


def test_a_seed_gives_one_draw_and_a_rejected_mutant_is_replaced(tool, package):
    drawn = tool.draw.draw(package, seed=3, count=30)
    assert drawn == tool.draw.draw(package, seed=3, count=30)
    assert drawn != tool.draw.draw(package, seed=4, count=30)
    without = tool.draw.draw(package, seed=3, count=30, without={drawn[0].id})
    assert drawn[0] not in without
    assert len(without) == len(set(without)) == 30
    assert set(drawn[1:]) <= set(without)


def test_the_command_line_writes_what_it_reads(tool, package, tmp_path, capsys):
    listed = tmp_path / 'rejected.txt'
    listed.write_text('# reasons\n')
    words = ['--tree', str(package), 'draw', '--count', '6', '--without', str(listed)]
    tool.cli.main(words)
    text = capsys.readouterr().out
    first = json.loads(text)[0]['id']
    (tmp_path / 'mutants.json').write_text(text)
    assert tool.cli.read_mutants(tmp_path / 'mutants.json') == tool.draw.draw(package, 1, 6)
    listed.write_text(f'{first}  as good as the original\n')
    tool.cli.main(words)
    assert first not in capsys.readouterr().out


def test_a_mutant_is_undone_after_an_interrupt(tool, package):
    mutant = tool.draw.draw(package, seed=1, count=6)[0]
    file = package / mutant.file
    before = file.read_bytes()

    def interrupted():
        with tool.draw.applied(package, mutant):
            assert mutant.after in file.read_text().split('\n')
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert file.read_bytes() == before


def test_a_mutant_is_found_again_among_equal_lines_that_have_moved(tool, tree):
    text = 'def f(a):\n    a = a + 7\n    a = a + 7\n    return a\n'
    top = tree(convert=text)
    file = top / 'fuzzycnc_ros' / 'convert.py'
    second = next(m for m in tool.draw.mutants_of(top, file, '') if m.occurrence == 1)
    file.write_text('import os\n\n\n' + text)
    assert tool.draw.find(top, second) == 6
    file.write_text(text.replace('7', '8'))
    with pytest.raises(LookupError, match=r'expected .*a \+ 7.* but found it 0 times'):
        tool.draw.find(top, second)


@pytest.mark.slow
def test_the_tests_that_run_a_line_are_tried_on_it(tool, tree, tmp_path, capsys):
    """Also those that run it in another process; a test that fails anyway catches nothing."""
    top = tree(
        convert="""
            def seen(a, b):
                return a if a < b else b
            def started(a: int) -> int:
                return a * 3
            def unseen(a):
                return a or None
        """
    )
    (top / 'fuzzycnc_ros' / '__init__.py').touch()
    (top / 'test_small.py').write_text(
        small("""
            import subprocess
            import sys
            from fuzzycnc_ros import convert
            def test_broken():
                assert convert.seen(1, 2) == 5
            def test_seen():
                assert convert.seen(1, 2) == 1
            def test_started():
                code = 'from fuzzycnc_ros import convert; print(convert.started(2))'
                command = [sys.executable, '-c', code]
                assert subprocess.check_output(command, text=True).strip() == '6'
            def test_unseen():
                convert.unseen(0)
        """)
    )
    kinds = {'comparison': 'seen', 'constant': 'started', 'return': 'unseen'}
    found = tool.draw.mutants_of(top, top / 'fuzzycnc_ros' / 'convert.py', 'convert')
    last = {mutant.kind: mutant for mutant in found if mutant.kind in kinds}
    (tmp_path / 'mutants.json').write_text(json.dumps([asdict(m) for m in last.values()]))
    words = ['--tree', str(top), '--results', str(tmp_path / 'results'), 'run']
    words += [str(tmp_path / 'mutants.json'), '--suite', 'small=test_small.py', '--jobs', '1']
    tool.cli.main(words)
    assert capsys.readouterr().out.endswith('small: 2 of 3 caught\n')
    suite = json.loads((tmp_path / 'results' / 'map-small.json').read_text())
    assert suite['failed'] == ['test_small.py::test_broken']
    results = json.loads((tmp_path / 'results' / 'results.json').read_text())['small']
    caught = {kind: results[mutant.id].get('by') for kind, mutant in last.items()}
    assert caught == {
        'comparison': 'test_small.py::test_seen',
        'constant': 'test_small.py::test_started',
        'return': None,
    }
    tool.cli.main([*words[:-3], 'small'])  # all is known by now
    assert capsys.readouterr().out == 'small: 2 of 3 caught\n'
