# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The rings of docs/explanation/architecture.md: imports run inward, inner rings know no ROS."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import house
import pytest
from each_case import for_each

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / 'fuzzycnc_ros'
MODULES = sorted(PACKAGE.rglob('*.py'))

ROS = {
    'action_msgs',
    'ament_index_python',
    'builtin_interfaces',
    'diagnostic_msgs',
    'fuzzycnc_msgs',
    'lifecycle_msgs',
    'rcl_interfaces',
    'rclpy',
    'rosgraph_msgs',
    'sensor_msgs',
    'std_msgs',
}
WITHOUT_ROS = (
    'core',
    'simulation',
    'papers',
    'runtime',
    'components',
    'registry',
    'replay',
    'bags',
    'files',
    'machine_file',
    'studies',
    'api',
)
PURE = ('core', 'simulation', 'papers', 'runtime', 'components')
LOADED_ON_USE = {
    'asyncua',
    'cryptography',
    'distributed',
    'jinja2',
    'matplotlib',
    'mcap',
    'mpmath',
    'paho',
    'pandas',
    'pyarrow',
    'pymodbus',
    'rich',
    'rosbags',
    'serial',
    'sklearn',
    'starlette',
    'typer',
    'uvicorn',
    'websockets',
    'yaml',
}
IMPURE = {
    'asyncio',
    'datetime',
    'io',
    'logging',
    'os',
    'pathlib',
    'random',
    'shutil',
    'socket',
    'subprocess',
    'tempfile',
    'threading',
    'time',
}
SEEDED = {'BitGenerator', 'Generator', 'PCG64', 'RandomState', 'SeedSequence', 'default_rng'}

# The one function of the core that may open a file: a model is named by its path everywhere.
FILE_READERS = {'core/thermal/model.py': {'os', 'pathlib'}}

# Imports every module of some rings where neither ROS nor any optional library is installed.
IMPORT_ALL = """
import importlib, pkgutil, sys
for name in {blocked!r}:
    sys.modules[name] = None
for name in {packages!r}:
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(getattr(package, '__path__', ()), name + '.'):
        importlib.import_module(module.name)
"""


def ring_of(path: Path) -> str:
    """Return the ring that a source file belongs to; empty for the package itself."""
    part = path.relative_to(PACKAGE).parts[0].removesuffix('.py')
    return '' if part == '__init__' else part


@cache
def imports(path: Path) -> list[tuple[int, str]]:
    """Return line and absolute dotted name of everything that a source file imports."""
    package = path.relative_to(ROOT).parent.parts
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                found.append((node.lineno, alias.name))
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = '.'.join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                found.append((node.lineno, f'{stem}.{alias.name}'))
    return found


def label(path: Path) -> str:
    """Return a test id."""
    return str(path.relative_to(PACKAGE))


def test_imports_run_along_the_arrows_of_the_picture():
    """By folders: an import that no way of arrows allows is a missing arrow here."""
    graph = house.imports(PACKAGE)
    there, drawn = house.reduced(graph), house.drawn(ROOT)
    assert not there - drawn, 'imports without an arrow in docs/explanation/architecture.md'
    assert not drawn - there, 'arrows of which there is no import, or that others imply'
    assert not [name for name in graph if name in house.reached(graph, name)], 'loops'


@for_each([path for path in MODULES if ring_of(path) in WITHOUT_ROS], label)
def test_ros_stays_outside(path):
    found = [
        f'{label(path)}:{line} imports {name}'
        for line, name in imports(path)
        if name.split('.')[0] in ROS
    ]
    assert not found


EXCHANGES = {('os', 'replace'), ('os', 'rename'), ('shutil', 'move')}


def test_files_are_exchanged_in_one_place():
    """It alone knows a link, a pipe or a device, in whose place no file may come."""
    found = {
        str(path.relative_to(PACKAGE))
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and (node.value.id, node.attr) in EXCHANGES
    }
    assert found == {'files/atomic.py'}


def test_no_node_imports_another():
    nodes = sorted(path.stem for path in (ROOT / 'params').glob('*.yaml'))
    assert nodes
    found = [
        f'{node}.py:{line} imports {name}'
        for node in nodes
        for line, name in imports(PACKAGE / 'nodes' / f'{node}.py')
        for other in nodes
        if other != node and f'{name}.'.startswith(f'fuzzycnc_ros.nodes.{other}.')
    ]
    assert not found


@for_each([path for path in MODULES if ring_of(path) in PURE], label)
def test_inner_rings_are_pure(path):
    """No clock, file, log or global random state: the same inputs give the same outputs."""
    found = [
        f'{label(path)}:{line} imports {name}'
        for line, name in imports(path)
        if name.split('.')[0] in IMPURE - FILE_READERS.get(label(path), set())
    ]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in ('open', 'print', 'input'):
                found.append(f'{label(path)}:{node.lineno} calls {node.func.id}')
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
            module = ast.unparse(node.value)
            if module in ('np.random', 'numpy.random') and node.attr not in SEEDED:
                found.append(f'{label(path)}:{node.lineno} uses np.random.{node.attr}')
    assert not found


@pytest.mark.parametrize('ring', [*PURE, 'registry'])
def test_inner_rings_import_in_plain_python(ring):
    """Numpy and scipy are enough."""
    script = IMPORT_ALL.format(
        blocked=sorted(ROS | LOADED_ON_USE), packages=[f'fuzzycnc_ros.{ring}']
    )
    done = subprocess.run(
        [sys.executable, '-c', script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.ros
def test_nodes_start_with_rclpy_numpy_and_scipy_alone():
    """What else a node can use is loaded on use."""
    blocked = sorted(LOADED_ON_USE - {'yaml'})  # rclpy itself needs it
    script = IMPORT_ALL.format(
        blocked=blocked,
        packages=[f'fuzzycnc_ros.{ring}' for ring in ('ros', 'adapters', 'graph', 'nodes')],
    )
    done = subprocess.run(
        [sys.executable, '-c', script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


NODE_START = """
import importlib, sys
*others, scheduler = sys.argv[1:]
for name in others:
    importlib.import_module('fuzzycnc_ros.nodes.' + name)
needless = ['scipy'] if 'scipy' in sys.modules else []
importlib.import_module('fuzzycnc_ros.nodes.' + scheduler)
on_use = (
    'asyncua', 'jinja2', 'matplotlib', 'mcap', 'paho', 'pydantic', 'pymodbus', 'rich', 'rosbags',
    'serial', 'sklearn', 'starlette', 'typer', 'uvicorn', 'websockets',
)
print(*needless, *[name for name in on_use if name in sys.modules])
"""


@pytest.mark.ros
def test_nodes_load_nothing_else_at_start():
    """Also where it is installed: scikit-learn alone would cost a second of every start.

    Scipy costs a third of a second; only the scheduler has work for it whenever it runs.
    """
    pytest.importorskip('rclpy')
    pytest.importorskip('fuzzycnc_msgs')
    nodes = [
        path.stem for path in (PACKAGE / 'nodes').glob('*.py') if 'def make()' in path.read_text()
    ]
    assert len(nodes) >= 7
    nodes.remove('feedrate_scheduler')
    done = subprocess.run(
        [sys.executable, '-c', NODE_START, *sorted(nodes), 'feedrate_scheduler'],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []
