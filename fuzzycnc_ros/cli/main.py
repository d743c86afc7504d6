# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Entry point of the command `fuzzycnc`: its subcommands, and what becomes of their errors."""

import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import typer

from fuzzycnc_ros import __version__
from fuzzycnc_ros.cli import evaluate, import_csv, info, record, replay, simulate, train

HELP = """Measure, predict and compensate the errors of a CNC machine.

Try it without a machine: train on three simulated shifts, compensate two others.

\b
  fuzzycnc simulate --report shift.html

From your own recording to a judged model:

\b
  fuzzycnc import-csv shift.csv --out shift --time t --temperature 't*' --displacement ch1=Z:um
  fuzzycnc train shift --end 86400 --out model.json
  fuzzycnc evaluate shift --start 86400 --model model.json

`fuzzycnc COMMAND --help` explains each command with examples.
"""

EPILOG = (
    'Exit codes: 0 done, 1 done and something differs, 2 refused with one line on standard '
    'error, 130 interrupted. --debug, anywhere on the line, shows the traceback of an error. '
    'Not a safety function: e-stop, limit switches and drive limits stay in hardware.'
)

COMMANDS = (
    simulate,
    record,
    replay,
    train,
    evaluate,
    import_csv,
    info,
)
"""Modules of the subcommands, in the order of the help; each has a function `register`."""

INTERRUPTED = 130

# What the command line itself refuses; typer keeps the classes in different places.
_Refusal: type[Exception] = next(
    kind for kind in reversed(typer.BadParameter.__mro__) if hasattr(kind, 'format_message')
)

app = typer.Typer(
    name='fuzzycnc',
    help=HELP,
    epilog=EPILOG,
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={'help_option_names': ['-h', '--help']},
)
for _module in COMMANDS:
    _module.register(app)


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
        print('interrupted', file=sys.stderr)
        return INTERRUPTED
    except Exception as error:  # the one place where every error becomes a line for people
        if debug:
            traceback.print_exc()
        print(f'error: {_line(error)}', file=sys.stderr)
        return 2
    return code if isinstance(code, int) else 0


def main() -> None:
    """Run the command line of this process."""
    sys.exit(run(sys.argv[1:]))


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
    elif isinstance(error, (ValueError, OSError, ModuleNotFoundError)):
        text = str(error)
    else:
        text = (
            f'unexpected {type(error).__name__}: {error}; this is a fault of fuzzycnc, '
            '--debug shows where'
        )
    return ' '.join(text.split())


if __name__ == '__main__':
    main()
