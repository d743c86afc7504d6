# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A command line: its commands and groups of them, and what becomes of their errors."""

import inspect
import os
import re
import sys
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from types import MappingProxyType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from fuzzycnc_ros import __version__
from fuzzycnc_ros.cli.background_output import background_output
from fuzzycnc_ros.cli.completion import join_bash_words
from fuzzycnc_ros.cli.console import complain, flush, say
from fuzzycnc_ros.cli.quantities import with_their_units
from fuzzycnc_ros.cli.remedies import command_with, sentence
from fuzzycnc_ros.core.names import visible
from fuzzycnc_ros.core.remedies import remedied
from fuzzycnc_ros.core.units import with_point
from fuzzycnc_ros.files.os_errors import os_sentence
from fuzzycnc_ros.files.uninterrupted import uninterrupted
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.ros.processes import StopRequest, interruptible
from fuzzycnc_ros.ros.streams import steady_streams

EPILOG = (
    'Exit codes: 0 done; 1 done, but the result is not as wanted; 2 refused, with one line on '
    'standard error; 130 ended by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP. --debug, anywhere on the '
    'line, shows the traceback of an error. Not a safety function: e-stop, limit switches and '
    'drive limits stay in hardware.'
)

INTERRUPTED = 130
ENDED_BY = 128
"""A command that a signal has ended ends with this and the number of the signal."""

# What the command line itself refuses; typer keeps the classes in different places.
_Refusal: type[Exception] = next(
    kind for kind in reversed(typer.BadParameter.__mro__) if hasattr(kind, 'format_message')
)


_NO_NUMBER = re.compile(
    r"'([^']*)' is not a valid (?:float|integer)|expected a valid \w+ but found '([^']*)'"
)


class _PipeError(Exception):
    """The reader of a pipe has gone; carries the error that says so."""


@dataclass(frozen=True)
class CommandGroup:
    """Subcommands that belong together, and the manual of all of them."""

    help: str
    commands: Mapping[str, Callable[..., Any]]


@dataclass(frozen=True)
class LazyCommand:
    """A command, or a group of them, whose module is imported when it is used.

    Parameters
    ----------
    job : str
        Heading under which the help lists it.
    place : str
        Module, a colon, and the name of its function; without a name the module is a group, of
        which it has the manual in `HELP` and the commands in `COMMANDS`.
    help : str
        First paragraph of its manual.
    """

    job: str
    place: str
    help: str

    def load(self) -> Callable[..., Any] | CommandGroup:
        """Return it."""
        path, _, name = self.place.partition(':')
        module = import_module(path)
        return getattr(module, name) if name else CommandGroup(module.HELP, module.COMMANDS)


Commands = Mapping[str, Callable[..., Any] | CommandGroup | LazyCommand]
"""Commands in the order of the help; each one's docstring is its manual."""


def manual(text: str) -> str:
    """Return a help text whose indented paragraphs, such as examples, keep their lines."""
    paragraphs = inspect.cleandoc(text).split('\n\n')
    return '\n\n'.join(
        f'\b\n{paragraph}' if paragraph.startswith('    ') else paragraph
        for paragraph in paragraphs
    )


_SETTINGS = {'help_option_names': ['-h', '--help']}


class _CommandGroup(TyperGroup):
    """Commands; of one that does not exist the nearest are proposed, whatever typer does."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first word names."""
        if args and not args[0].startswith('-') and self.get_command(ctx, args[0]) is None:
            near = get_close_matches(args[0], self.list_commands(ctx))
            proposal = f'; did you mean {" or ".join(map(repr, near))}?' if near else ''
            ctx.fail(f'No such command {args[0]!r}{proposal}')
        return super().resolve_command(ctx, args)


class Application:
    """A command line.

    Parameters
    ----------
    name : str
        Name of the command.
    text : str
        Its manual.
    commands : mapping
        Subcommands by name.
    watching : collection of str
        Commands that watch over nodes, and so must never wait for the reader of their output.
    alone : mapping of str to str
        Options whose value may be left out, as typer has none, and what it then is; where it is
        given an equals sign has to stand before it.
    renamed : mapping of str to str
        Old names of commands, which are taken for one version more with a note, and the new ones.
    """

    def __init__(
        self,
        name: str,
        text: str,
        commands: Commands,
        watching: Collection[str] = (),
        alone: Mapping[str, str] = MappingProxyType({}),
        renamed: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.name = name
        self._watching = watching
        self._alone = alone
        self.renamed = renamed

        class InOrder(_CommandGroup):
            """Lists commands in their order, under headings, and loads one when it is used."""

            _listing = False

            def list_commands(self, ctx: Any) -> list[str]:
                """Return the names of the commands."""
                return list(commands)

            def get_command(self, ctx: Any, cmd_name: str) -> Any:
                """Return a command, None if there is none of that name."""
                command = commands.get(cmd_name)
                if isinstance(command, LazyCommand) and self._listing:
                    return TyperCommand(cmd_name, help=command.help)
                if isinstance(command, LazyCommand) and cmd_name not in self.commands:
                    holder = typer.Typer(rich_markup_mode=None, context_settings=_SETTINGS)
                    _add(holder, {cmd_name: command.load()})
                    self.commands.update(typer.main.get_group(holder).commands)
                return super().get_command(ctx, cmd_name)

            def invoke(self, ctx: Any) -> Any:
                """Run the command; typer would end a broken pipe without a word."""
                try:
                    return super().invoke(ctx)
                except BrokenPipeError as error:
                    raise _PipeError(error) from error

            def shell_complete(self, ctx: Any, incomplete: str) -> Any:
                """Return the names that begin as what was typed, without loading any command."""
                self._listing = True
                try:
                    return super().shell_complete(ctx, incomplete)
                finally:
                    self._listing = False

            def format_commands(self, ctx: Any, formatter: Any) -> None:
                """Write what each command does, by jobs, without loading any."""
                later = {n: item for n, item in commands.items() if isinstance(item, LazyCommand)}
                for job in dict.fromkeys(item.job for item in later.values()):
                    with formatter.section(job):
                        formatter.write_dl(
                            [(n, item.help) for n, item in later.items() if item.job == job]
                        )
                if not later:
                    super().format_commands(ctx, formatter)

        self.typer = typer.Typer(
            name=name,
            cls=InOrder,
            help=manual(text),
            epilog=EPILOG,
            no_args_is_help=True,
            pretty_exceptions_enable=False,
            rich_markup_mode=None,
            context_settings=_SETTINGS,
        )
        _add(
            self.typer,
            {n: item for n, item in commands.items() if not isinstance(item, LazyCommand)},
        )
        self.typer.callback()(_common)

    def run(self, arguments: Sequence[str], wish: StopRequest | None = None) -> int:
        """Carry out a command line and return its exit code.

        An error that nobody can name, after a wish to end, is what became of the wish in a library
        that does not pass exceptions on.
        """
        words, debug = _without_debug(arguments)
        try:
            if words[:1] == ['--version']:
                say(f'{self.name} {__version__}')
                return 0
            if words and words[0] in self.renamed:
                new = self.renamed[words[0]]
                print(
                    f'note: `{self.name} {words[0]}` is now `{self.name} {new}`; the next version '
                    'knows the new name alone',
                    file=sys.stderr,
                )
                words = [new, *words[1:]]
            words = [self._with_value(word) for word in words]
            words = with_their_units(words)
            code = self.typer(words or ['--help'], prog_name=self.name, standalone_mode=False)
            flush()
        except (KeyboardInterrupt, typer.Abort):
            code = INTERRUPTED
        except Exception as error:  # the one place where every error becomes a line for people
            if wish is not None and wish.number and not _is_named(error):
                return self._interrupted()
            if debug:
                print(visible(traceback.format_exc(), keep='\n'), file=sys.stderr, end='')
            complain(_line(error, self.name))
            return 2
        if code == INTERRUPTED:  # newer versions of typer return it themselves
            return self._interrupted()
        return code if isinstance(code, int) else 0

    def _interrupted(self) -> int:
        print('interrupted', file=sys.stderr)
        return INTERRUPTED

    def check(self, command: str, arguments: Sequence[str]) -> None:
        """Refuse what a command would refuse of its arguments, without carrying it out."""
        group = typer.main.get_command(self.typer)
        with group.make_context(self.name, [command], resilient_parsing=True) as context:
            words = with_their_units([self._with_value(word) for word in arguments])
            group.get_command(context, command).make_context(  # type: ignore[attr-defined]
                command, words, parent=context
            ).close()

    def _with_value(self, word: str) -> str:
        """Return an option that stands alone with the value that it then has."""
        return f'{word}={self._alone[word]}' if word in self._alone else word

    def main(self) -> None:
        """Run the command line of this process."""
        steady_streams(output_matters=True)
        words, _ = _without_debug(sys.argv[1:])
        if os.environ.get(f'_{self.name.upper()}_COMPLETE') == 'complete_bash':
            join_bash_words(os.environ)
        watching = bool(words) and words[0] in self._watching
        with interruptible() as wish:
            try:
                with ExitStack() as shown:
                    if watching:
                        with uninterrupted():  # what is half set up could not be taken back
                            shown.enter_context(background_output())
                    code = self.run(sys.argv[1:], wish)
            except KeyboardInterrupt:  # before the command began, or after its end
                code = self._interrupted()
        _drop_unwritten()
        if code == INTERRUPTED and wish.number:
            code = ENDED_BY + wish.number
        sys.exit(code)


def _drop_unwritten() -> None:
    """Drop what a full disk or a broken pipe does not take: that was said already."""
    try:
        sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


class _RemedyCommand(TyperCommand):
    """A command that says what helps in its own options and manual."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take the words of the command line; the parser does not say whose options it refuses."""
        try:
            return super().parse_args(ctx, args)
        except _Refusal as error:
            error.ctx = getattr(error, 'ctx', None) or ctx  # type: ignore[attr-defined]
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with command_with([option for item in self.params for option in item.opts]):
            try:
                return super().invoke(ctx)
            except ValueError as error:
                if remedied(error) is None:
                    raise
                raise ValueError(sentence(error)) from error


def _add(to: typer.Typer, commands: Mapping[str, Callable[..., Any] | CommandGroup]) -> None:
    """Make commands and groups of them known."""
    for name, command in commands.items():
        text = manual(command.help if isinstance(command, CommandGroup) else command.__doc__ or '')
        # The whole first paragraph: typer would cut it at 45 characters.
        short = ' '.join(text.split('\n\n')[0].split())
        if isinstance(command, CommandGroup):
            group = typer.Typer(
                cls=_CommandGroup, rich_markup_mode=None, context_settings=_SETTINGS
            )
            _add(group, command.commands)
            to.add_typer(group, name=name, help=text, short_help=short)
        else:
            to.command(name, cls=_RemedyCommand, help=text, short_help=short)(command)


def _common(
    version: Annotated[bool, typer.Option('--version', help='Print the version and end.')] = False,
    debug: Annotated[
        bool,
        typer.Option('--debug', help='Show the traceback of an error; works anywhere.'),
    ] = False,
) -> None:
    """Take the options that stand before the subcommand."""
    # --debug never gets here: it may stand anywhere, so `run` takes it out beforehand.


def _without_debug(arguments: Sequence[str]) -> tuple[list[str], bool]:
    words = list(arguments)
    end = words.index('--') if '--' in words else len(words)
    kept = [word for word in words[:end] if word != '--debug'] + words[end:]
    return kept, len(kept) < len(words)


def _has_place() -> bool:
    """Return whether there is a working folder, without which relative names mean nothing."""
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _is_named(error: Exception) -> bool:
    """Return whether an error says itself what is wrong."""
    kinds = (_Refusal, _PipeError, OSError, ValueError, ModuleNotFoundError, GraphError)
    return isinstance(error, kinds)


def _with_value(text: str, error: Exception) -> str:
    """Return what typer says of a value that is no number, with the value in all its versions."""
    of_value = getattr(error.__cause__, 'errors', None)
    if of_value is not None:
        (first, *_) = of_value()
        told = first['msg'].partition(',')[0].replace('Input should be', 'expected')
        text = f'{text.partition(": ")[0]}: {told} but found {first["input"]!r}'
    found = _NO_NUMBER.search(text)
    return text + (with_point(found[1] or found[2]) if found else '')


def _line(error: Exception, name: str) -> str:
    """Return an error in one line."""
    if isinstance(error, _PipeError):
        (error,) = error.args
    if isinstance(error, (OSError, ValueError)) and not _has_place():
        told = f'{error}; '
        if isinstance(error, OSError):
            told = '' if error.filename is None else f'{error.filename}: '
        text = f'{told}the working folder was deleted or cannot be entered: cd to another one'
    elif isinstance(error, _Refusal):
        text = error.format_message()  # type: ignore[attr-defined]
        context = getattr(error, 'ctx', None)
        command = context.command_path if context is not None else name
        text = f'{_with_value(text.rstrip("."), error)}; see `{command} --help`'
    elif isinstance(error, OSError):
        text = os_sentence(error)
    elif isinstance(cause := error.__cause__, OSError) and str(cause) in str(error):
        text = os_sentence(cause)
    elif _is_named(error):
        text = str(error)
    else:
        text = (
            f'unexpected {type(error).__name__}: {error}; this is a fault of fuzzycnc, '
            '--debug shows where'
        )
    return ' '.join(text.split())
