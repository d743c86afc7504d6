# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

package_name = 'fuzzycnc_ros'
nodes = [
    'compensator',
    'deformation_compensator',
    'feedrate_scheduler',
    'linuxcnc_bridge',
    'opcua_bridge',
    'player',
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
modbus = ['pymodbus>=3.10']
opcua = ['asyncua>=1.1.5', 'cryptography']

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['py.typed', 'nodes/*.xml', 'report/templates/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/params', sorted(glob('params/*.*'))),
        ('share/' + package_name + '/launch', sorted(glob('launch/*.launch.py'))),
        ('share/' + package_name + '/linuxcnc', sorted(glob('linuxcnc/*.*'))),
    ],
    python_requires='>=3.10',
    install_requires=['numpy>=1.26', 'scipy>=1.11'],
    extras_require={
        'bags': bags,
        'cli': command_line,
        'ml': ml,
        'modbus': modbus,
        'opcua': opcua,
        'report': report,
        'all': command_line + report + ml + modbus + opcua,
        'test': [*command_line, *report, *ml, *modbus, *opcua, 'hypothesis', 'pytest'],
    },
    zip_safe=False,
    author='The fuzzycnc authors',
    author_email='maintainers@fuzzycnc.example.org',
    maintainer='The fuzzycnc authors',
    maintainer_email='maintainers@fuzzycnc.example.org',
    description='Measures, predicts and compensates the errors of a CNC machine',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'fuzzycnc = fuzzycnc_ros.cli.main:main',
            *(f'{node} = fuzzycnc_ros.nodes.{node}:main' for node in nodes),
        ],
    },
)
