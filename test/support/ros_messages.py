# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of ROS that no wheel has, built from what their definitions say, for slow tests.

`control_msgs` and `tf2_msgs` come with a ROS installation.  Where there is none, the few of their
interfaces that our nodes use are compiled as those of `fuzzycnc_msgs` are.
"""

import ctypes
import importlib
import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]
JOINT = 'string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n'
COMPONENT = f'string joint_name\nuint16 component\n{JOINT.partition(chr(10))[2]}'
TOLERANCES = """\
JointTolerance[] {kind}_tolerance
JointComponentTolerance[] component_{kind}_tolerance
"""
POINTS = ('desired', 'actual', 'error')
FOLLOW = f"""\
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
{TOLERANCES.format(kind='path')}{TOLERANCES.format(kind='goal')}\
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
std_msgs/Header header
string[] joint_names
{''.join(f'trajectory_msgs/JointTrajectoryPoint {name}{chr(10)}' for name in POINTS)}\
int32 index
string[] multi_dof_joint_names
{
    ''.join(
        f'trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{name}{chr(10)}'
        for name in POINTS
    )
}\
int32 multi_dof_index
"""
PACKAGES = {
    'tf2_msgs': (
        ('geometry_msgs',),
        {'msg/TFMessage.msg': 'geometry_msgs/TransformStamped[] transforms\n'},
    ),
    'control_msgs': (
        ('action_msgs', 'trajectory_msgs'),
        {
            'msg/JointTolerance.msg': JOINT,
            'msg/JointComponentTolerance.msg': COMPONENT,
            'action/FollowJointTrajectory.action': FOLLOW,
        },
    ),
}
"""What each package needs and defines."""


def build(folder: Path) -> Path:
    """Compile the packages that are not installed; return their prefix."""
    prefix = folder / 'prefix'
    for name, (needed, files) in PACKAGES.items():
        if find_spec(name) is None:
            _build_one(folder, prefix, name, ('builtin_interfaces', 'std_msgs', *needed), files)
    return prefix


def _build_one(folder, prefix, name, needed, files):
    source = folder / name
    shutil.copytree(ROOT / 'msg_defs' / 'cmake', source / 'cmake')
    for path, text in files.items():
        (source / path).parent.mkdir(exist_ok=True)
        (source / path).write_text(text)
    recipe = (ROOT / 'msg_defs' / 'CMakeLists.txt').read_text()
    recipe = recipe.replace('project(fuzzycnc_msgs)', f'project({name})')
    recipe = recipe.replace('find_package(action_msgs REQUIRED)\n', '')
    found = ''.join(f'find_package({item} REQUIRED)\n' for item in needed)
    recipe = recipe.replace(
        'find_package(rosidl_default_gen', f'{found}find_package(rosidl_default_gen'
    )
    recipe = re.sub('DEPENDENCIES .*', f'DEPENDENCIES {" ".join(needed)}', recipe)
    (source / 'CMakeLists.txt').write_text(recipe)
    manifest = (ROOT / 'msg_defs' / 'package.xml').read_text().replace('fuzzycnc_msgs', name)
    depends = ''.join(f'<depend>{item}</depend>' for item in needed)
    manifest = re.sub('(  <depend>.*</depend>\n)+', f'  {depends}\n', manifest)
    (source / 'package.xml').write_text(manifest)
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ('_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'LD_LIBRARY_PATH', 'PYTHONPATH')
    } | {'AMENT_PREFIX_PATH': sys.prefix, 'CMAKE_PREFIX_PATH': sys.prefix}
    environment['PATH'] = os.pathsep.join([str(Path(sys.prefix) / 'bin'), environment['PATH']])
    work = str(folder / f'build_{name}')
    for command in (
        [
            *('cmake', '-S', str(source), '-B', work, '-DSKBUILD=ON', '-DBUILD_TESTING=OFF'),
            *('-DCMAKE_BUILD_TYPE=Release', '-DCMAKE_INSTALL_LIBDIR=lib'),
            *(f'-DPython3_EXECUTABLE={sys.executable}', f'-DPYTHON_EXECUTABLE={sys.executable}'),
            *(f'-DCMAKE_INSTALL_PREFIX={prefix}', f'-DCMAKE_INSTALL_RPATH={prefix}/lib'),
        ],
        ['cmake', '--build', work],
        ['cmake', '--install', work],
    ):
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


@contextmanager
def installed(prefix: Path):
    """Make the packages importable, here and in processes that are started meanwhile."""
    before = {name: os.environ.get(name) for name in ('LD_LIBRARY_PATH', 'PYTHONPATH')}
    if not prefix.is_dir():  # a ROS installation has them
        yield
        return
    (site,) = prefix.glob('lib/python*/site-packages')
    for name, path in (('LD_LIBRARY_PATH', prefix / 'lib'), ('PYTHONPATH', site)):
        os.environ[name] = os.pathsep.join(filter(None, [str(path), before[name]]))
    sys.path.insert(0, str(site))
    importlib.invalidate_caches()
    for library in sorted((prefix / 'lib').glob('*typesupport*.so')):
        # This process looked at LD_LIBRARY_PATH when it began; what is loaded is found by name.
        ctypes.CDLL(str(library))
    try:
        yield
    finally:
        sys.path.remove(str(site))
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
