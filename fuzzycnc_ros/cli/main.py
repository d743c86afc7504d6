# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the command `fuzzycnc`: its subcommands, and what becomes of their errors."""

import inspect
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fuzzycnc_ros import __version__
from fuzzycnc_ros.cli.advise import advise
from fuzzycnc_ros.cli.background_output import background_output
from fuzzycnc_ros.cli.compare import compare
from fuzzycnc_ros.cli.console import complain
from fuzzycnc_ros.cli.curve import curve
from fuzzycnc_ros.cli.demo import demo
from fuzzycnc_ros.cli.evaluate import evaluate
from fuzzycnc_ros.cli.faults import faults
from fuzzycnc_ros.cli.foam import COMMANDS as FOAM_COMMANDS
from fuzzycnc_ros.cli.foam import HELP as FOAM_HELP
from fuzzycnc_ros.cli.graph_processes import GraphError
from fuzzycnc_ros.cli.import_csv import import_csv
from fuzzycnc_ros.cli.info import info
from fuzzycnc_ros.cli.machine import COMMANDS as MACHINE_COMMANDS
from fuzzycnc_ros.cli.machine import HELP as MACHINE_HELP
from fuzzycnc_ros.cli.operate import COMMANDS as OPERATE_COMMANDS
from fuzzycnc_ros.cli.operate import HELP as OPERATE_HELP
from fuzzycnc_ros.cli.pareto import pareto
from fuzzycnc_ros.cli.position import position
from fuzzycnc_ros.cli.record import record
from fuzzycnc_ros.cli.replay import replay
from fuzzycnc_ros.cli.schedule import schedule
from fuzzycnc_ros.cli.security import COMMANDS as SECURITY_COMMANDS
from fuzzycnc_ros.cli.security import HELP as SECURITY_HELP
from fuzzycnc_ros.cli.servo import COMMANDS as SERVO_COMMANDS
from fuzzycnc_ros.cli.servo import HELP as SERVO_HELP
from fuzzycnc_ros.cli.simulate import simulate
from fuzzycnc_ros.cli.soak import soak
from fuzzycnc_ros.cli.train import train
from fuzzycnc_ros.cli.up import up
from fuzzycnc_ros.core.visible import visible
from fuzzycnc_ros.ros.ending import interruptible

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

EPILOG = (
    'Exit codes: 0 done; 1 done, and something differs; 2 refused, with one line on standard '
    'error; 130 interrupted, 143 if by SIGTERM, 129 if by SIGHUP. --debug, anywhere on the line, '
    'shows the traceback of an error. Not a safety function: e-stop, limit switches and drive '
    'limits stay in hardware.'
)


@dataclass(frozen=True)
class CommandGroup:
    """Subcommands that belong together, and the manual of all of them."""

    help: str
    commands: Mapping[str, Callable[..., Any]]


COMMANDS: dict[str, Callable[..., Any] | CommandGroup] = {
    'demo': demo,
    'up': up,
    'operate': CommandGroup(OPERATE_HELP, OPERATE_COMMANDS),
    'faults': faults,
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
    'soak': soak,
    'info': info,
}
"""The subcommands in the order of the help; each one's docstring is its manual."""

WATCHING = ('demo', 'up', 'faults', 'record', 'soak')
"""Commands that watch over nodes, and so must never wait for the reader of their output."""

INTERRUPTED = 130
ENDED_BY = 128
"""A command that a signal has ended ends with this and the number of the signal."""

# What the command line itself refuses; typer keeps the classes in different places.
_Refusal: type[Exception] = next(
    kind for kind in reversed(typer.BadParameter.__mro__) if hasattr(kind, 'format_message')
)


def manual(text: str) -> str:
    """Return a help text whose indented paragraphs, such as examples, keep their lines."""
    paragraphs = inspect.cleandoc(text).split('\n\n')
    return '\n\n'.join(
        f'\b\n{paragraph}' if paragraph.startswith('    ') else paragraph
        for paragraph in paragraphs
    )


class _InOrder(TyperGroup):
    """Lists groups of commands where they stand among the others, not ahead of them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands."""
        return list(COMMANDS)


_SETTINGS = {'help_option_names': ['-h', '--help']}

app = typer.Typer(
    name='fuzzycnc',
    cls=_InOrder,
    help=manual(HELP),
    epilog=EPILOG,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=_SETTINGS,
)


def _add(to: typer.Typer, commands: Mapping[str, Callable[..., Any] | CommandGroup]) -> None:
    """Make commands and groups of them known."""
    for name, command in commands.items():
        text = manual(command.help if isinstance(command, CommandGroup) else command.__doc__ or '')
        # The whole first paragraph: typer would cut it at 45 characters.
        short = ' '.join(text.split('\n\n')[0].split())
        if isinstance(command, CommandGroup):
            group = typer.Typer(rich_markup_mode=None, context_settings=_SETTINGS)
            _add(group, command.commands)
            to.add_typer(group, name=name, help=text, short_help=short)
        else:
            to.command(name, help=text, short_help=short)(command)


_add(app, COMMANDS)


@app.callback()
def common(
    version: Annotated[bool, typer.Option('--version', help='Print the version and end.')] = False,
    debug: Annotated[
        bool, typer.Option('--debug', help='Show the traceback of an error; may stand anywhere.')
    ] = False,
) -> None:
    """Take the options that stand before the subcommand."""
    # --debug never gets here: it may stand anywhere, so `run` takes it out beforehand.


def run(arguments: Sequence[str]) -> int:
    """Carry out a command line and return its exit code."""
    words, debug = _without_debug(arguments)
    if words[:1] == ['--version']:
        print(f'fuzzycnc {__version__}')
        return 0
    try:
        code = app(words or ['--help'], prog_name='fuzzycnc', standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:  # the one place where every error becomes a line for people
        if debug:
            print(visible(traceback.format_exc(), keep='\n'), file=sys.stderr, end='')
        complain(_line(error))
        return 2
    if code == INTERRUPTED:  # newer versions of typer return it themselves
        print('interrupted', file=sys.stderr)
    return code if isinstance(code, int) else 0


def main() -> None:
    """Run the command line of this process."""
    words, _ = _without_debug(sys.argv[1:])
    watching = bool(words) and words[0] in WATCHING
    with interruptible() as wish, background_output() if watching else nullcontext():
        code = run(sys.argv[1:])
    if code == INTERRUPTED and wish.number:
        code = ENDED_BY + wish.number
    sys.exit(code)


def _without_debug(arguments: Sequence[str]) -> tuple[list[str], bool]:
    words = list(arguments)
    end = words.index('--') if '--' in words else len(words)
    kept = [word for word in words[:end] if word != '--debug'] + words[end:]
    return kept, len(kept) < len(words)


def _line(error: Exception) -> str:
    """Return an error in one line."""
    if isinstance(error, _Refusal):
        text = error.format_message()  # type: ignore[attr-defined]
        context = getattr(error, 'ctx', None)
        command = context.command_path if context is not None else 'fuzzycnc'
        text = f'{text.rstrip(".")}; see `{command} --help`'
    elif isinstance(error, (ValueError, OSError, ModuleNotFoundError, GraphError)):
        text = str(error)
    else:
        text = (
            f'unexpected {type(error).__name__}: {error}; this is a fault of fuzzycnc, '
            '--debug shows where'
        )
    return ' '.join(text.split())


if __name__ == '__main__':
    main()
