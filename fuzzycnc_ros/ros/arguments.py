# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""ROS arguments as they are meant, and a line on those that are not understood."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import rclpy
import yaml
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity, get_logger_level, set_logger_level
from rclpy.signals import SignalHandlerOptions

from fuzzycnc_ros.ros.leftovers import TemporaryFolder
from fuzzycnc_ros.ros.parameters import NUMBER, ParameterError

MACHINE_FILE = '--machine-file'
"""Option of every node: the machine file that decides its parameters."""
BARE = frozenset('yYnN')
"""Names, such as that of an axis, to YAML 1.2, to PyYAML and to `ros2 param dump`, which writes
them bare; switches to rcl, which refuses them beside other names."""
_WHOLE = re.compile(r'[-+]?\d+')
_PLACE_IN_RCL = re.compile(r', at /\S+:\d+')


def initialise(arguments: Sequence[str] | None) -> None:
    """Initialise ROS with command line arguments, those of the process if there are none.

    Raises
    ------
    ParameterError
        If they are not understood; the text says which.
    """
    with TemporaryFolder() as folder:
        given = sys.argv if arguments is None else arguments
        with understood(with_machine(given, folder)) as words:
            rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)


def with_machine(arguments: Sequence[str], folder: Path) -> list[str]:
    """Return arguments with a machine file (--machine-file) as the first of parameter files.

    Parameters
    ----------
    arguments : sequence of str
        The arguments; those for ROS follow --ros-args.
    folder : Path
        Where its parameters are written to.

    Raises
    ------
    ParameterError
        If it cannot be read; the message names file and line.
    """
    words = list(arguments)
    end = words.index('--ros-args') if '--ros-args' in words else len(words)
    for place, word in enumerate(words[:end]):
        name, sign, value = word.partition('=')
        if name != MACHINE_FILE:
            continue
        if not sign and place + 1 == end:
            raise ParameterError(f'{MACHINE_FILE}: expected a file but found none')
        # Here, as few nodes are started with one, and it is a third of what they would load.
        from fuzzycnc_ros.machine_file.parameters import parameter_text
        from fuzzycnc_ros.machine_file.reader import read_machine_file

        file = value if sign else words[place + 1]
        try:
            text = parameter_text(read_machine_file(file))
        except ValueError as error:
            raise ParameterError(f'{MACHINE_FILE}: {error}') from error
        path = folder / 'machine.yaml'
        path.write_text(text, encoding='utf-8')
        # Those given at the command line come later, and win.
        rest = words[:place] + words[place + (1 if sign else 2) :]
        return [*rest[:1], '--ros-args', '--params-file', str(path), '--', *rest[1:]]
    return words


@contextmanager
def understood(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Yield ROS arguments as they are meant; what rcl refuses is told in one line.

    Raises
    ------
    ParameterError
        If what is done with them finds that they are not understood.
    """
    with ExitStack() as stack:
        words = quoted(arguments, lambda: stack.enter_context(TemporaryFolder()))
        # It would tell the same in words of its own.
        set_logger_level('rcl', LoggingSeverity.FATAL)
        try:
            yield words
        except (
            rclpy_implementation.RCLError,
            rclpy_implementation.RCLInvalidROSArgsError,
            rclpy_implementation.UnknownROSArgsError,
        ) as error:
            text = str(error)
            for given, used in zip(arguments, words, strict=True):
                text = text.replace(used, given)
            raise ParameterError(_line(error, text)) from error
        finally:
            if get_logger_level('rcl') == LoggingSeverity.FATAL:  # nobody has chosen another
                set_logger_level('rcl', LoggingSeverity.UNSET)


def quoted(arguments: Sequence[str], new_folder: Callable[[], Path]) -> list[str]:
    """Return ROS arguments with bare names in lists of parameters in quotes, numbers alike.

    Parameters
    ----------
    arguments : sequence of str
        The arguments.
    new_folder : callable
        Makes a folder for a parameter file that has such names; the arguments name what is there
        instead.
    """
    words = list(arguments)
    for place, (flag, value) in enumerate(pairwise(arguments), 1):
        if flag in ('-p', '--param'):
            name, sign, text = value.partition(':=')
            words[place] = name + sign + quoted_yaml(text)
        elif flag == '--params-file' and Path(value).is_file():  # a pipe can be read once
            try:
                before = Path(value).read_text(encoding='utf-8')
            except (OSError, UnicodeError):
                continue  # rcl says what is wrong with it
            after = quoted_yaml(before)
            if after != before:
                copy = new_folder() / Path(value).name
                copy.write_text(after, encoding='utf-8')
                words[place] = str(copy)
    return words


def quoted_yaml(text: str) -> str:
    """Return YAML with bare y and n in lists in quotes, and whole numbers beside others as such.

    No parameter is a list of switches, and rcl refuses [0.5, 1].
    """
    open_lists: list[list[Any]] = []
    changes: list[tuple[Any, str]] = []
    try:
        for event in yaml.parse(text):
            if isinstance(event, yaml.SequenceStartEvent):
                open_lists.append([])
            elif isinstance(event, yaml.SequenceEndEvent):
                found = open_lists.pop()
                whole = [item for item in found if _WHOLE.fullmatch(item.value)]
                if len(whole) < len(found) and all(NUMBER.fullmatch(i.value) for i in found):
                    changes += [(item, f'{item.value}.0') for item in whole]
            elif open_lists and isinstance(event, yaml.ScalarEvent) and event.style is None:
                open_lists[-1].append(event)
                if event.value in BARE:
                    changes.append((event, f"'{event.value}'"))
    except yaml.YAMLError:
        return text  # rcl says what is wrong with it
    for item, value in sorted(changes, key=lambda change: -change[0].start_mark.index):
        text = text[: item.start_mark.index] + value + text[item.end_mark.index :]
    return text


def _line(error: Exception, text: str) -> str:
    """Return why ROS arguments are refused, in one line with the remedy."""
    text = _PLACE_IN_RCL.sub('', ' '.join(text.split()))
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        return f'unknown ROS arguments {text}'
    if 'Sequence should be of same type' in text:
        text += "; put names such as on, yes and 1 in quotes: ['on', 'X']"
    return f'ROS arguments: {text}'
