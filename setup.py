# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

package_name = 'fuzzycnc_ros'
nodes = [
    'compensator',
    'dashboard',
    'deformation_compensator',
    'feedrate_scheduler',
    'joint_trajectory_bridge',
    'linuxcnc_bridge',
    'mqtt_publisher',
    'mtconnect_adapter',
    'opcua_bridge',
    'opcua_server',
    'player',
    'probe_cycle',
    'recorder',
    'sensor_selector',
    'servo_controller',
    'simulated_body',
    'simulated_machine',
    'temperature_acquisition',
    'thermal_predictor',
]
bags = ['mcap', 'rosbags', 'zstandard']
command_line = ['typer', 'rich', 'pyyaml', *bags]
report = ['jinja2', 'matplotlib']
ml = ['scikit-learn', 'threadpoolctl']
tables = ['pandas']
docs = ['furo', 'myst-nb', 'sphinx', 'textstat<0.7.5']
device_files = ['pydantic>=2.7', 'pyyaml']
modbus = ['pymodbus>=3.10', 'pyserial', *device_files]
mqtt = ['paho-mqtt>=2.1', *device_files]
opcua = ['asyncua>=1.1.5', 'cryptography', *device_files]
designs = ['pyembroidery>=1.5', 'svgelements>=1.9', 'ezdxf>=1.3']
camera = ['opencv-python-headless>=4.8']
page = ['cryptography', 'starlette', 'uvicorn>=0.35', 'websockets']
ship = ['fsspec']
fleet = ['dask', 'distributed', 'pyarrow']
executables = ['fuzzycnc', *nodes]


# colcon fills lib/fuzzycnc_ros with all of them (setup.cfg); pip fills bin/, where only the
# command belongs: recorder, player and dashboard would be in the way of other programs.
colcon = bool({'install', 'develop'} & set(sys.argv))
console_scripts = executables if colcon else ['fuzzycnc']

# Shell and Python at once, as pip writes scripts whose interpreter has a long path.
WRAPPER = """#!/bin/sh
'''exec' "$(command -v "${{0%/*}}/../../bin/python" || echo python3)" "$0" "$@"
' '''
from fuzzycnc_ros.start import {name}

{name}()
"""


def wrappers():
    """Write the executables that `ros2 run` looks for, where pip installs."""
    folder = Path('build', 'executables')
    folder.mkdir(parents=True, exist_ok=True)
    for name in executables:
        path = folder / name
        path.write_text(WRAPPER.format(name=name))
        path.chmod(0o755)
    return [('lib/' + package_name, [str(folder / name) for name in executables])]


setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={
        package_name: [
            'py.typed',
            'machine_file/built_in/*.yaml',
            'ros/*.xml',
            'studies/page/templates/*',
            'studies/servo/templates/*',
            'adapters/probing/programs/*',
            'web/static/*',
            'web/vendor/*/*',
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/params', sorted(glob('params/*.*'))),
        ('share/' + package_name + '/launch', sorted(glob('launch/*.launch.py'))),
        ('share/' + package_name + '/layouts', sorted(glob('layouts/*.*'))),
        ('share/' + package_name + '/linuxcnc', sorted(glob('linuxcnc/*.*'))),
        *([] if colcon else wrappers()),
    ],
    python_requires='>=3.10',
    # What the commands need, for those who install by pip. ROS is not named: the wheel of
    # fuzzycnc_msgs brings it, and beside a real ROS pip must not fetch another one.
    install_requires=['numpy>=1.26', 'scipy>=1.11', 'mpmath', *command_line, *report, *ml],
    extras_require={
        'bags': bags,
        'camera': camera,
        'cli': command_line,
        'designs': designs,
        'docs': docs,
        'fleet': fleet,
        'ml': ml,
        'modbus': modbus,
        'mqtt': mqtt,
        'opcua': opcua,
        'page': page,
        'report': report,
        'ship': ship,
        'tables': tables,
        'all': [
            *command_line,
            *report,
            *ml,
            *tables,
            *modbus,
            *mqtt,
            *opcua,
            *page,
            *ship,
            *fleet,
            *designs,
            *camera,
        ],
        'test': [
            *command_line,
            *report,
            *ml,
            *tables,
            *modbus,
            *mqtt,
            *opcua,
            *page,
            *ship,
            *fleet,
            *designs,
            *camera,
            'httpx',
            'hypothesis',
            'pytest',
            'selenium',
        ],
    },
    zip_safe=False,
    author='The fuzzycnc authors',
    author_email='maintainers@fuzzycnc.example.org',
    maintainer='The fuzzycnc authors',
    maintainer_email='maintainers@fuzzycnc.example.org',
    description='Measures, predicts and compensates the errors of a CNC machine',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    license_files=['LICENSE', 'fuzzycnc_ros/web/vendor/*/LICENSE*'],
    url='https://fuzzycnc.example.org',
    project_urls={
        'Changes': 'https://fuzzycnc.example.org/CHANGELOG.md',
        'Documentation': 'https://fuzzycnc.example.org/docs',
    },
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Manufacturing',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Programming Language :: Python :: 3.10',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Programming Language :: Python :: 3.13',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    entry_points={
        'console_scripts': [f'{name} = fuzzycnc_ros.start:{name}' for name in console_scripts],
    },
)
