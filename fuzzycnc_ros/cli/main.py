# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the command `fuzzycnc`: its subcommands."""

from fuzzycnc_ros.cli.application import Application, Commands, LazyCommand

HELP = """Measure, predict and compensate the thermal error of a CNC machine.

Try it without a machine: train on three simulated shifts, compensate two others.

    fuzzycnc demo
    fuzzycnc simulate --report shift.html

From your own recording to a judged model:

    fuzzycnc import-csv shift.csv --out shift --time t \\
        --temperature 't*' --displacement ch1=Z:um
    fuzzycnc train shift --end 86400 --out model.json
    fuzzycnc evaluate shift --start 86400 --model model.json

Which model, and how many sensors, judged on runs that were not used for training:

    fuzzycnc compare monday tuesday wednesday --report models.html
    fuzzycnc curve monday tuesday wednesday --report sensors.html

What is known of your machine, in one file for the commands below:

    fuzzycnc machine new mill.yaml

What to set so that a part program keeps a contour tolerance, the feeds that do, and all methods
compared:

    fuzzycnc advise part.ngc --tolerance 20um --out best.ngc
    fuzzycnc schedule part.ngc --tolerance 0.01mm --out scheduled.ngc
    fuzzycnc pareto butterfly

How an axis moves to a position, and all controllers compared:

    fuzzycnc position --axis lathe --to -50mm
    fuzzycnc servo compare

Patterns on soft material, compensated before they are stitched:

    fuzzycnc soft demo

`fuzzycnc COMMAND --help` explains each command with examples.
"""

COMMANDS: Commands = {
    'demo': LazyCommand(
        'Try',
        'fuzzycnc_ros.cli.demo.command:demo',
        'Watch a simulated mill warm up for two shifts while its thermal error is compensated.',
    ),
    'simulate': LazyCommand(
        'Try',
        'fuzzycnc_ros.cli.models.simulate:simulate',
        'Run a thermal shift of the simulated mill in one process, much faster than live.',
    ),
    'sensors': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.sensors.command',
        'Read sensors for the first time, and find those that are off.',
    ),
    'import-csv': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.bags.import_csv:import_csv',
        'Import the recording of a real machine from a CSV table into a bag.',
    ),
    'train': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.models.train:train',
        'Train thermal models on recorded runs, and write them with their scores to one file.',
    ),
    'evaluate': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.models.evaluate:evaluate',
        "Compare a model's predictions with measurements and simple baselines.",
    ),
    'compare': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.models.compare:compare',
        'Compare all models on runs that none of them has seen.',
    ),
    'curve': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.models.curve:curve',
        'Show how the error on unseen runs falls with the number of sensors.',
    ),
    'model': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.models.model',
        'Show, compare and hand on what probes have taught of a machine.',
    ),
    'fleet': LazyCommand(
        'Calibrate',
        'fuzzycnc_ros.cli.fleet.command',
        'Train, compare, evaluate and report over thousands of bags of many machines.',
    ),
    'up': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.up:up',
        'Bring up and supervise the graph of one machine or several; Ctrl-C takes all of it down.',
    ),
    'operate': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.operate',
        'Operate a running machine: status, activate, set limits, reference, probe and mark.',
    ),
    'probe': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.probe',
        'Write the program by which a control probes its own thermal error.',
    ),
    'linuxcnc': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.linuxcnc',
        'Install and check what a LinuxCNC needs for offsets, axis controllers and feed shares.',
    ),
    'watch': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.watch:watch',
        'Watch a running machine in the terminal: state, offsets, sensors, probes, alarms.',
    ),
    'service': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.live.service',
        'Run a machine as a service of systemd: from boot on, watched, started anew.',
    ),
    'record': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.bags.record:record',
        'Record the topics of a live machine, undecoded, until Ctrl-C.',
    ),
    'replay': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.bags.replay:replay',
        'Recompute the outputs in a bag from its inputs, and compare them byte by byte.',
    ),
    'info': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.bags.info:info',
        'Show the contents of a bag: topics, counts, types, times, attachments and problems.',
    ),
    'report': LazyCommand(
        'Run',
        'fuzzycnc_ros.cli.reports.thermal',
        'Reports on recordings, as pages and as PDF.',
    ),
    'advise': LazyCommand(
        'Part programs',
        'fuzzycnc_ros.cli.programs.advise:advise',
        'Show which settings keep a contour tolerance on LinuxCNC, and recommend the fastest.',
    ),
    'schedule': LazyCommand(
        'Part programs',
        'fuzzycnc_ros.cli.programs.schedule:schedule',
        'Choose the feeds of a part program, so that the contour error keeps a tolerance.',
    ),
    'pareto': LazyCommand(
        'Part programs',
        'fuzzycnc_ros.cli.programs.pareto:pareto',
        'Show what contour error each scheduling method leaves, and in what time.',
    ),
    'machine': LazyCommand(
        'Axes',
        'fuzzycnc_ros.cli.axes.machine',
        'Describe your machine in one file for all commands.',
    ),
    'position': LazyCommand(
        'Axes',
        'fuzzycnc_ros.cli.axes.position:position',
        'Move a simulated axis to a position and judge how it gets there.',
    ),
    'servo': LazyCommand(
        'Axes',
        'fuzzycnc_ros.cli.axes.servo',
        'Compare, learn, tune and judge controllers that position an axis.',
    ),
    'soft': LazyCommand(
        'Soft material',
        'fuzzycnc_ros.cli.soft.command',
        'Compensate patterns and designs on soft material: show, train, compensate, learn.',
    ),
    'papers': LazyCommand(
        'For developers',
        'fuzzycnc_ros.cli.papers:papers',
        'Print the figures of a paper beside those of the same method on the simulated machine.',
    ),
    'schema': LazyCommand(
        'For developers',
        'fuzzycnc_ros.cli.schema:schema',
        'Print the JSON Schema of a configuration file, so that editors complete and check it.',
    ),
    'security': LazyCommand(
        'For developers',
        'fuzzycnc_ros.cli.live.security',
        'Write access rights: each node may do only what it needs.',
    ),
}
"""The subcommands in the order of the help, by jobs; nothing is imported for the help."""

APPLICATION = Application(
    'fuzzycnc',
    HELP,
    COMMANDS,
    watching=('demo', 'up', 'record', 'watch'),
    alone={'--page': '0'},  # the usual port,
    renamed={'foam': 'soft'},
)
run = APPLICATION.run


def main() -> None:
    """Run the command line of this process."""
    APPLICATION.main()


if __name__ == '__main__':
    main()
