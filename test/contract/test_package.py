# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The package as ROS, colcon and pip see it: one version, real dependencies, whole contents."""

import ast
import os
import re
import runpy
import sys
import xml.etree.ElementTree as ET
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from fuzzycnc_ros import start

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / 'fuzzycnc_ros'

# Names that `rosdep` resolves for Jazzy: released ROS packages, then keys of rosdep/python.yaml.
ROSDEP_KEYS = {
    'action_msgs',
    'ament_cmake',
    'ament_index_python',
    'builtin_interfaces',
    'control_msgs',
    'diagnostic_msgs',
    'geometry_msgs',
    'launch',
    'launch_ros',
    'lifecycle_msgs',
    'rcl_interfaces',
    'rclpy',
    'rosgraph_msgs',
    'rosidl_default_generators',
    'rosidl_default_runtime',
    'sensor_msgs',
    'std_msgs',
    'std_srvs',
    'tf2_msgs',
    'trajectory_msgs',
    'python3-cryptography',
    'python3-serial',
    'python3-hypothesis',
    'python3-jinja2',
    'python3-matplotlib',
    'python3-numpy',
    'python3-pytest',
    'python3-rich',
    'python3-scipy',
    'python3-sklearn',
    'python3-sympy',
    'python3-typer',
    'python3-yaml',
}
KEY_OF_MODULE = {
    'cryptography': 'python3-cryptography',
    'jinja2': 'python3-jinja2',
    'matplotlib': 'python3-matplotlib',
    'mpmath': 'python3-sympy',  # which depends on it
    'numpy': 'python3-numpy',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'serial': 'python3-serial',
    'sklearn': 'python3-sklearn',
    'threadpoolctl': 'python3-sklearn',  # which depends on it
    'typer': 'python3-typer',
    'yaml': 'python3-yaml',
}
DISTRIBUTION_OF_MODULE = {
    'pydantic_core': 'pydantic',
    'paho': 'paho-mqtt',
    'serial': 'pyserial',
    'sklearn': 'scikit-learn',
    'yaml': 'pyyaml',
}
# The documented pip extras `bags`, `modbus`, `opcua` and `mqtt`
WITHOUT_KEY = {'mcap', 'rosbags', 'zstandard', 'pymodbus', 'asyncua', 'pydantic', 'paho-mqtt'}
OPTIONAL = {
    'pandas',  # imported by one function of the Python doors alone
    *('starlette', 'uvicorn', 'websockets'),  # by the live page, newer than there are keys for
}


EXECUTABLES = 'lib/fuzzycnc_ros'


@pytest.fixture(scope='module')
def setup_arguments() -> dict:
    """What setup.py tells setuptools."""
    arguments: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr('setuptools.setup', lambda **given: arguments.update(given))
        runpy.run_path('setup.py')
    return arguments


def manifest(folder: str) -> ET.Element:
    """Return the root element of a package.xml."""
    return ET.parse(ROOT / folder / 'package.xml').getroot()


def dependencies(folder: str) -> set[str]:
    """Return all names that a package.xml depends on."""
    return {item.text or '' for item in manifest(folder) if item.tag.endswith('depend')}


def entry_points(arguments: dict) -> set[str]:
    """Return the names of the executables that `ros2 run` finds."""
    (sources,) = (found for target, found in arguments['data_files'] if target == EXECUTABLES)
    return {Path(source).name for source in sources}


def requirement_name(requirement: str) -> str:
    """Return the normalised distribution name of a requirement."""
    return re.match(r'[\w.-]+', requirement).group().lower().replace('_', '-')


def imported_modules() -> set[str]:
    """Return the top-level names of everything that the package imports."""
    found = set()
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.split('.')[0])
    return found - set(sys.stdlib_module_names) - {'fuzzycnc_ros', '__future__'}


def test_one_version_everywhere(setup_arguments):
    pyproject = (ROOT / 'msg_defs' / 'pyproject.toml').read_text()
    versions = {
        'setup.py': setup_arguments['version'],
        'package.xml': manifest('.').findtext('version'),
        'msg_defs/package.xml': manifest('msg_defs').findtext('version'),
        'msg_defs/pyproject.toml': re.search(r'^version = "(.+)"$', pyproject, re.M).group(1),
    }
    changelog = (ROOT / 'CHANGELOG.md').read_text()
    versions['CHANGELOG.md'] = re.search(r'^## \[?(\d+\.\d+\.\d+)', changelog, re.M).group(1)
    assert len(set(versions.values())) == 1, versions


def test_one_licence_and_maintainer_everywhere(setup_arguments):
    assert 'Apache License' in (ROOT / 'LICENSE').read_text()[:200]
    assert setup_arguments['license'] == 'Apache-2.0'
    for folder in ('.', 'msg_defs'):
        assert manifest(folder).findtext('license') == 'Apache-2.0'
        held = ROOT / folder / manifest(folder).find('license').get('file')
        assert held.read_bytes() == (ROOT / 'LICENSE').read_bytes()
        email = manifest(folder).find('maintainer').get('email')
        assert email == setup_arguments['maintainer_email']
        # catkin_pkg refuses a last part shorter than two letters
        assert re.fullmatch(r'[\w.+-]+@[\w-]+(\.[\w-]+)*\.[a-z]{2,}', email)


@pytest.mark.parametrize('folder', ['.', 'msg_defs'])
def test_rosdep_resolves_every_dependency(folder):
    unknown = dependencies(folder) - ROSDEP_KEYS - {'fuzzycnc_msgs'}
    assert not unknown, f'expected names of ROSDEP_KEYS but found {sorted(unknown)}'


def test_every_import_is_declared(setup_arguments):
    declared = dependencies('.')
    extras = {
        requirement_name(requirement)
        for requirements in [
            setup_arguments['install_requires'],
            *setup_arguments['extras_require'].values(),
        ]
        for requirement in requirements
    }
    for module in sorted(imported_modules()):
        distribution = DISTRIBUTION_OF_MODULE.get(module, module)
        if distribution in WITHOUT_KEY | OPTIONAL:
            assert distribution in extras, f'{module} is in no extra of setup.py'
        elif module in KEY_OF_MODULE:
            assert KEY_OF_MODULE[module] in declared, f'{module} is not in package.xml'
            assert distribution in extras, f'{module} is in no extra of setup.py'
        else:
            assert module in declared, f'{module} is not in package.xml'


def test_the_environment_holds_every_extra(setup_arguments):
    locked = {
        requirement_name(line)
        for name in ('environment', 'docs')  # `make docs` puts the second beside the first
        for line in (ROOT / 'requirements' / f'{name}.txt').read_text().splitlines()
        if line[:1].isalpha()
    }
    wanted = {
        requirement_name(requirement)
        for requirements in setup_arguments['extras_require'].values()
        for requirement in requirements
    }
    assert wanted <= locked


@pytest.mark.parametrize('name', ['docs', 'environment', 'floor'])
def test_locks_are_pinned_hashed_and_up_to_date(name):
    text = (ROOT / 'requirements' / f'{name}.txt').read_text().replace('\\\n', '')
    lines = [line for line in text.splitlines() if line and not line.startswith('#')]
    for line in lines:
        assert re.match(r'[a-z0-9.-]+==[\w.+]+ ', line), line[:80]
        assert ' --hash=sha256:' in line, line[:80]
    wanted = (ROOT / 'requirements' / f'{name}.in').read_text().splitlines()
    names = {requirement_name(line) for line in wanted if line[:1].isalpha()}
    assert names <= {requirement_name(line) for line in lines}


def test_message_build_uses_what_the_lock_holds():
    text = (ROOT / 'msg_defs' / 'pyproject.toml').read_text()
    requires = re.findall(r'^  "(.+)",$', text.partition(']\nbuild-backend')[0], re.M)
    assert requires
    locked = (ROOT / 'requirements' / 'environment.txt').read_text()
    missing = [
        requirement
        for requirement in requires
        if not re.search(rf'^{re.escape(requirement_name(requirement))}==', locked, re.M)
    ]
    assert not missing


@pytest.mark.parametrize('installer', ['pip', 'colcon'])
def test_executables_lie_where_their_installer_puts_them(installer, setup_arguments, monkeypatch):
    """Only the command comes into the PATH of all programs."""
    arguments = dict(setup_arguments)
    if installer == 'colcon':
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(sys, 'argv', ['setup.py', 'build', 'install'])
        monkeypatch.setattr('setuptools.setup', lambda **given: arguments.update(given))
        runpy.run_path('setup.py')
    scripts = {line.split(' = ')[0] for line in arguments['entry_points']['console_scripts']}
    every = entry_points(setup_arguments)
    assert scripts == (every if installer == 'colcon' else {start.COMMAND})
    assert (EXECUTABLES in dict(arguments['data_files'])) == (installer == 'pip')


def test_every_entry_point_has_its_module(setup_arguments):
    for name in entry_points(setup_arguments):
        path = PACKAGE / ('cli/main.py' if name == start.COMMAND else f'nodes/{name}.py')
        functions = [
            item.name
            for item in ast.parse(path.read_text()).body
            if isinstance(item, ast.FunctionDef)
        ]
        assert 'main' in functions, f'{name}: no function main in {path.relative_to(ROOT)}'


def test_every_node_is_an_entry_point_with_params(setup_arguments):
    """Node = module = executable = params file = one word."""
    nodes = entry_points(setup_arguments) - {start.COMMAND}
    assert nodes == {path.stem for path in (ROOT / 'params').glob('*.yaml')}
    for node in nodes:
        content = yaml.safe_load((ROOT / 'params' / f'{node}.yaml').read_text())
        assert list(content) == [f'/**/{node}']


def test_everything_shared_is_installed(setup_arguments):
    """What a launch or params file needs at run time is in setup.py."""
    installed = {
        (target, Path(source).name)
        for target, sources in setup_arguments['data_files']
        for source in sources
    }
    for target, source in {
        *(('share/fuzzycnc_ros/params', path) for path in (ROOT / 'params').glob('*.*')),
        *(('share/fuzzycnc_ros/launch', path) for path in (ROOT / 'launch').glob('*.py')),
        *(('share/fuzzycnc_ros/layouts', path) for path in (ROOT / 'layouts').glob('*.*')),
        *(('share/fuzzycnc_ros/linuxcnc', path) for path in (ROOT / 'linuxcnc').glob('*.*')),
        ('share/fuzzycnc_ros', ROOT / 'package.xml'),
        ('share/ament_index/resource_index/packages', ROOT / 'resource' / 'fuzzycnc_ros'),
    }:
        assert source.is_file()
        assert (target, source.name) in installed


def test_every_package_folder_is_a_package(setup_arguments):
    folders = {'.'.join(path.parent.relative_to(ROOT).parts) for path in PACKAGE.rglob('*.py')}
    assert folders == set(setup_arguments['packages']), 'an __init__.py is missing'


def test_package_data_is_installed(setup_arguments):
    patterns = setup_arguments['package_data']['fuzzycnc_ros']
    held = {path for pattern in patterns for path in PACKAGE.glob(pattern)}
    others = {
        path
        for path in PACKAGE.rglob('*')
        if path.is_file() and path.suffix != '.py' and '__pycache__' not in path.parts
    }
    assert others == held


def test_the_guide_names_the_extras_without_rosdep_keys():
    text = (ROOT / 'docs' / 'how-to' / 'integration.md').read_text()
    assert 'fuzzycnc_ros[bags,modbus,opcua,mqtt]' in text
    assert all(name in text for name in WITHOUT_KEY)


LAUNCH_FILES = sorted((ROOT / 'launch').glob('*.launch.py'))


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_follows_the_table(path):
    """Nodes, parameters and restarts come from `graph/bring_up.py`, by its test."""
    tree = ast.parse(path.read_text())
    functions = {item.name for item in tree.body if isinstance(item, ast.FunctionDef)}
    assert 'generate_launch_description' in functions
    named = {
        item.value
        for item in ast.walk(tree)
        if isinstance(item, ast.Constant) and isinstance(item.value, str)
    }
    assert not named & {path.stem for path in (ROOT / 'params').glob('*.yaml')}


@pytest.mark.ros
def test_installed_package_is_found_in_the_ament_index(setup_arguments, monkeypatch):
    from ament_index_python.packages import get_package_prefix, get_package_share_directory

    prefix = Path(sys.prefix)
    if not os.environ.get('AMENT_PREFIX_PATH'):
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))
    marker = 'share/ament_index/resource_index/packages/fuzzycnc_ros'
    if find_spec('fuzzycnc_ros') is None or not any(
        Path(folder, marker).is_file() for folder in os.environ['AMENT_PREFIX_PATH'].split(':')
    ):
        pytest.skip('fuzzycnc_ros is not installed here: run `make test`')
    executables = Path(get_package_prefix('fuzzycnc_ros'), 'lib', 'fuzzycnc_ros')
    for name in entry_points(setup_arguments):
        assert os.access(executables / name, os.X_OK), name
    share = Path(get_package_share_directory('fuzzycnc_ros'))
    for folder in ('params', 'launch'):
        held = {path.name for path in (share / folder).iterdir() if path.is_file()}
        assert held == {path.name for path in (ROOT / folder).glob('*.*')}
    assert Path(get_package_share_directory('fuzzycnc_msgs'), 'msg', 'Temperatures.msg').is_file()
