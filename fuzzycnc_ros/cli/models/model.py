# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc model`: what probes have taught of a machine, shown, compared and handed on."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.console import JsonFile, check_folder, say, show, write_json, write_text
from fuzzycnc_ros.core.document import ModelFileError

if TYPE_CHECKING:
    from fuzzycnc_ros.runtime.records import ThermalPosterior
    from fuzzycnc_ros.studies.thermal.posterior import Memory

HELP = """Show, compare and hand on what probes have taught of a machine.

    fuzzycnc model show shift_1 shift_2
    fuzzycnc model export shift_2 --out mill_learnt.json

Sources are bags with `thermal_posterior`, or the file of that name in a state directory.
"""

Sources = Annotated[
    list[Path],
    typer.Argument(metavar='SOURCE...', help='Bags, or files thermal_posterior.state.'),
]
Model = Annotated[
    Optional[Path],  # noqa: UP045 - typer 0.9 does not read the newer form
    typer.Option(help='Model file that was in use; leave it out where all was learnt.'),
]


def show_learnt(sources: Sources, model: Model = None, json_file: JsonFile = None) -> None:
    """Show what probes have taught, of one source or of several side by side.

    The table has the error where all sensors are warmer by 10 K for long, with two deviations.
    Below it are the sensors with the largest part, each warmer by 10 K alone.

        fuzzycnc model show shift_1 shift_2
        fuzzycnc model show state/mill.thermal_predictor.thermal_posterior.state
    """
    from fuzzycnc_ros.studies.thermal.posterior import (
        memory_document,
        memory_table,
        sensor_lines,
    )

    check_folder(json_file)
    memories = [_memory(source, model) for source in sources]
    show(memory_table(memories))
    for item in memories:
        for line in sensor_lines(item):
            say(line)
    write_json(json_file, memory_document(memories))


def export(
    source: Annotated[
        Path, typer.Argument(metavar='SOURCE', help='Bag, or file thermal_posterior.state.')
    ],
    out: Annotated[Path, typer.Option(help='Model file to write.')],
    model: Model = None,
) -> None:
    """Write what probes have taught to a model file, with which another machine begins to learn.

    `fuzzycnc up --learn --model FILE` begins with it. That the probes of a machine were found
    right is not handed on: each machine is tried in part first.

        fuzzycnc model export shift_2 --out mill_learnt.json
    """
    check_folder(out)
    exported = _memory(source, model).exported()
    write_text(out, exported.to_json())
    say(f'{out}: written, hash {exported.hash[:16]}')


def _memory(source: Path, model: Path | None) -> 'Memory':
    from fuzzycnc_ros.core.thermal.model import load_model
    from fuzzycnc_ros.studies.thermal.posterior import memory_of

    loaded = None if model is None else load_model(model)
    return memory_of(source.name, _posterior(source), loaded)


def _posterior(source: Path) -> 'ThermalPosterior':
    """Return the newest posterior of a bag, or that of a state file.

    Raises
    ------
    BagTopicError
        If a bag has none, or those of several machines.
    ModelFileError
        If a file holds none.
    """
    from fuzzycnc_ros.bags.reader import BagReader
    from fuzzycnc_ros.bags.runs import find_topic
    from fuzzycnc_ros.bags.typestore import deserialize
    from fuzzycnc_ros.runtime.convert import decode
    from fuzzycnc_ros.runtime.records import ThermalPosterior

    if source.suffix == '.state':
        try:
            head, _, body = source.read_bytes().partition(b'\n')
        except OSError as error:
            raise ModelFileError(f'{source}: {error.strerror}') from error
        if head != ThermalPosterior.TYPE.encode():
            raise ModelFileError(
                f'{source}: expected {ThermalPosterior.TYPE}, but found '
                f'{head[:80].decode("ascii", "replace")!r}'
            )
        return decode(ThermalPosterior, deserialize(body, ThermalPosterior.TYPE))
    with BagReader(source) as reader:
        topic = find_topic(reader, 'thermal_posterior', ThermalPosterior.TYPE)
        newest = deque(reader.messages([topic]), maxlen=1)[0].message
    return decode(ThermalPosterior, newest)


COMMANDS: dict[str, Callable[..., Any]] = {'show': show_learnt, 'export': export}
