# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the command `fuzzycnc`: its subcommands."""

from fuzzycnc_ros.cli.application import Application, CommandGroup, Commands
from fuzzycnc_ros.cli.axes.machine import COMMANDS as MACHINE_COMMANDS
from fuzzycnc_ros.cli.axes.machine import HELP as MACHINE_HELP
from fuzzycnc_ros.cli.axes.position import position
from fuzzycnc_ros.cli.axes.servo import COMMANDS as SERVO_COMMANDS
from fuzzycnc_ros.cli.axes.servo import HELP as SERVO_HELP
from fuzzycnc_ros.cli.bags.import_csv import import_csv
from fuzzycnc_ros.cli.bags.info import info
from fuzzycnc_ros.cli.bags.record import record
from fuzzycnc_ros.cli.bags.replay import replay
from fuzzycnc_ros.cli.demo.command import demo
from fuzzycnc_ros.cli.foam.command import COMMANDS as FOAM_COMMANDS
from fuzzycnc_ros.cli.foam.command import HELP as FOAM_HELP
from fuzzycnc_ros.cli.live.operate import COMMANDS as OPERATE_COMMANDS
from fuzzycnc_ros.cli.live.operate import HELP as OPERATE_HELP
from fuzzycnc_ros.cli.live.security import COMMANDS as SECURITY_COMMANDS
from fuzzycnc_ros.cli.live.security import HELP as SECURITY_HELP
from fuzzycnc_ros.cli.live.up import up
from fuzzycnc_ros.cli.models.compare import compare
from fuzzycnc_ros.cli.models.curve import curve
from fuzzycnc_ros.cli.models.evaluate import evaluate
from fuzzycnc_ros.cli.models.simulate import simulate
from fuzzycnc_ros.cli.models.train import train
from fuzzycnc_ros.cli.programs.advise import advise
from fuzzycnc_ros.cli.programs.pareto import pareto
from fuzzycnc_ros.cli.programs.schedule import schedule
from fuzzycnc_ros.cli.schema import schema

HELP = """Measure, predict and compensate the thermal error of a CNC machine.

Try it without a machine: train on three simulated shifts, compensate two others.

    fuzzycnc demo
    fuzzycnc simulate --report shift.html

From your own recording to a judged model:

    fuzzycnc import-csv shift.csv --out shift --time t \\
        --temperature 't*' --displacement ch1=Z:um
    fuzzycnc train shift --end 86400 --out model.json
    fuzzycnc evaluate shift --start 86400 --model model.json

Which model, and how many sensors, on runs that nothing has seen:

    fuzzycnc compare monday tuesday wednesday --report models.html
    fuzzycnc curve monday tuesday wednesday --report sensors.html

What is known of your machine, in one file for the commands below:

    fuzzycnc machine new mill.yaml

What keeps a contour tolerance on a part program, its feeds, and methods side by side:

    fuzzycnc advise part.ngc --tolerance 20um --out best.ngc
    fuzzycnc schedule part.ngc --tolerance 0.01mm --out scheduled.ngc
    fuzzycnc pareto butterfly

How an axis gets to a position, and controllers side by side:

    fuzzycnc position --axis lathe --to -50mm
    fuzzycnc servo compare

Patterns on soft material, straightened beforehand:

    fuzzycnc foam demo

`fuzzycnc COMMAND --help` explains each command with examples.
"""

COMMANDS: Commands = {
    'demo': demo,
    'up': up,
    'operate': CommandGroup(OPERATE_HELP, OPERATE_COMMANDS),
    'simulate': simulate,
    'record': record,
    'replay': replay,
    'train': train,
    'evaluate': evaluate,
    'compare': compare,
    'curve': curve,
    'machine': CommandGroup(MACHINE_HELP, MACHINE_COMMANDS),
    'advise': advise,
    'schedule': schedule,
    'pareto': pareto,
    'position': position,
    'servo': CommandGroup(SERVO_HELP, SERVO_COMMANDS),
    'foam': CommandGroup(FOAM_HELP, FOAM_COMMANDS),
    'import-csv': import_csv,
    'security': CommandGroup(SECURITY_HELP, SECURITY_COMMANDS),
    'info': info,
    'schema': schema,
}
"""The subcommands in the order of the help; each one's docstring is its manual."""

APPLICATION = Application('fuzzycnc', HELP, COMMANDS, watching=('demo', 'up', 'record'))
run = APPLICATION.run


def main() -> None:
    """Run the command line of this process."""
    APPLICATION.main()


if __name__ == '__main__':
    main()
