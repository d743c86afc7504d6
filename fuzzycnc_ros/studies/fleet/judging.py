# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""One bag judged with some models: plain values in, plain values out, for any executor."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fuzzycnc_ros.bags.errors import MissingLibraryError
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import TEMPERATURES_TYPE, read_run
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.candidate import DEFAULT, UNCOMPENSATED
from fuzzycnc_ros.core.thermal.model import ThermalModel, load_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.core.threads import single_threaded
from fuzzycnc_ros.files.os_errors import os_sentence
from fuzzycnc_ros.studies.fleet.content import FileState, content_hash, files_of, result_version
from fuzzycnc_ros.studies.thermal.missing_readings import MATES, Bridged, judge_recorded

if TYPE_CHECKING:
    from fuzzycnc_ros.core.thermal.fit import Evaluation

Document = dict[str, Any]
"""Values as JSON has them, NaN and infinity among them."""

MACHINE_BY = ('bag', 'folder')
"""Sources of the machine's name of a bag: its topics, or the folder that it lies in."""

one_at_a_time = threading.Lock()
"""Held while figures are computed: the number of threads of linear algebra is one per process."""


@dataclass(frozen=True)
class FleetModel:
    """A model that bags are judged with.

    Parameters
    ----------
    path : str
        Its file, absolute: a worker may run in another folder.
    label : str
        What it is called.
    hash : str
        SHA-256 of the text of the file.
    machine : str, optional
        The machine whose bags it is judged on; all if absent.
    """

    path: str
    label: str
    hash: str
    machine: str | None = None

    def fits(self, machine: str) -> bool:
        """Return whether the bags of a machine are judged with it."""
        return self.machine is None or self.machine == machine


@dataclass(frozen=True)
class BagTask:
    """A bag and what is wanted of it.

    Parameters
    ----------
    number : int
        Its place among all bags.
    path, name : str
        Absolute path of the bag, and what its run is called.
    models : tuple of FleetModel
        What it is judged with.
    machine_by : str
        One of `MACHINE_BY`.
    only_hash : bool
        Whether nothing is wanted but the hash of its content.
    """

    number: int
    path: str
    name: str
    models: tuple[FleetModel, ...]
    machine_by: str
    only_hash: bool = False


@dataclass(frozen=True)
class BagResult:
    """Result of a bag.

    Parameters
    ----------
    sha256 : str
        Hash of its content; empty if that cannot be read.
    files : tuple of FileState
        Its files when they were hashed.
    version : str
        What computed the figures.
    facts : dict
        `machines`, `begin` [ns], `duration_s`; or `problem`, if the bag cannot be used at all.
    figures : dict
        (Namespace in the bag, hash of the model) -> what `_figures` says.
    lasting : bool
        Whether that is so wherever and whenever this content is read.
    """

    sha256: str
    files: tuple[FileState, ...]
    version: str
    facts: Document
    figures: Mapping[tuple[str, str], Document]
    lasting: bool = True


def machine_name(namespace: str, path: str, machine_by: str) -> str:
    """Return the machine that a bag is of: the namespace in it, or else the folder of the bag."""
    return namespace if machine_by == 'bag' and namespace else Path(path).parent.name


def judge_bag(task: BagTask) -> BagResult:
    """Judge a bag with models; what is wrong becomes a sentence.

    The figures are the same in any process on any host: linear algebra has one thread.
    """
    path = Path(task.path)
    try:
        # The state is taken first: what changes meanwhile is read anew the next time.
        files = files_of(path)
        sha256 = content_hash(path, files)
    except OSError as error:
        facts = {'problem': os_sentence(error)}
        return BagResult('', (), result_version(), facts, {}, lasting=False)
    if task.only_hash:
        return BagResult(sha256, files, result_version(), {}, {})
    with one_at_a_time:
        lasting, facts = _tried(partial(bag_facts, path), task)
        figures: dict[tuple[str, str], Document] = {}
        for namespace in facts.get('machines', ()):
            machine = machine_name(namespace, task.path, task.machine_by)
            fitting = [model for model in task.models if model.fits(machine)]
            told, found = _of_machine(task, namespace, fitting)
            figures |= found
            lasting &= told
    return BagResult(sha256, files, result_version(), facts, figures, lasting)


def one_line(error: Exception) -> str:
    """Return what is wrong in one line."""
    text = os_sentence(error) if isinstance(error, OSError) else str(error)
    return ' '.join(text.split())


def _tried(work: Callable[[], Document], task: BagTask) -> tuple[bool, Document]:
    """Return whether the outcome depends on the content alone, and the outcome.

    A sentence on what is wrong names the bag, and so comes with the names that stand in it.
    """
    try:
        return True, work()
    except (OSError, MissingLibraryError) as error:
        return False, {'problem': one_line(error)}
    except ValueError as error:
        return True, {'problem': one_line(error), **_place(task)}


def _place(task: BagTask) -> Document:
    return {'path': task.path, 'name': task.name}


def bag_facts(path: Path) -> Document:
    """Return what a bag says of itself.

    Returns
    -------
    dict
        `machines`: namespaces with temperatures; `begin` [ns]; `duration_s`.

    Raises
    ------
    BagError
        If it cannot be read.
    """
    with BagReader(path) as reader:
        spaces = [
            topic.rpartition('/')[0].strip('/')
            for topic, info in reader.connections.items()
            if topic.rpartition('/')[2] == 'temperatures'
            and info.type == TEMPERATURES_TYPE
            and info.message_count
        ]
        return {
            # One that reads no temperatures gets its sentence from who looks for them.
            'machines': sorted(set(spaces)) or [''],
            'begin': reader.start,
            'duration_s': 1e-9 * (reader.stop - reader.start),
        }


def _of_machine(
    task: BagTask, namespace: str, models: Sequence[FleetModel]
) -> tuple[bool, dict[tuple[str, str], Document]]:
    """Judge the run of a machine in a bag, which is read once, with all models."""
    runs: list[ThermalRun] = []

    def judged(model: FleetModel) -> Document:
        trained = _model(model.path, model.hash)
        if not runs:
            runs.append(read_run(task.path, namespace=namespace, name=task.name))
        document = _figures(trained, runs[0])
        if 'problem' in document:
            document |= _place(task)
        return document

    lasting, found = True, {}
    for model in models:
        told, document = _tried(partial(judged, model), task)
        lasting &= told
        found[namespace, model.hash] = document
    return lasting, found


@cache
def _model(path: str, digest: str) -> ThermalModel:
    """Return the model of a file, which is kept for the bags to come.

    Raises
    ------
    OSError
        If it cannot be read here, or is another one than where the work was handed out.
    """
    text = Path(path).read_text(encoding='utf-8')
    if text_hash(text) != digest:
        raise OSError(
            f'{path}: expected the same model file as where the command was given but found '
            'another one; do not change it meanwhile, and give all workers the same disk'
        )
    return load_model(text)


def _figures(model: ThermalModel, recorded: ThermalRun) -> Document:
    """Return what a model leaves of a run.

    Returns
    -------
    dict
        `channels`: list of figures by channel; `in_domain`, `trained_on` [-]; `warm`: inputs that
        did not start cold; `sensors`: lists of name and shares of samples [-] that are missing,
        that others stand in for, and that straight lines bridge; `problem` instead of the figures
        where the model cannot be judged.
    """
    try:
        judged, _, bridged = _single(model, recorded)
    except ValueError as error:
        return {'problem': one_line(error), 'sensors': _sensors(model, recorded, ())}
    return {
        'channels': [
            {
                'channel': name,
                'axis': judged.axis[c],
                'candidate': judged.default[c],
                'samples': judged.samples[c],
                'uncompensated_rms_um': 1e6 * float(judged.rms[UNCOMPENSATED][c]),
                'uncompensated_max_um': 1e6 * float(judged.largest[UNCOMPENSATED][c]),
                'rms_um': 1e6 * float(judged.rms[DEFAULT][c]),
                'max_um': 1e6 * float(judged.largest[DEFAULT][c]),
                'held_out_rms_um': 1e6 * float(model.held_out_rms[c]),
                'covered': float(judged.covered[c]),
                'band_um': 1e6 * float(judged.half_width[c]),
                'independent': float(judged.independent[c]),
                'band_ratio': float(judged.band_ratio[c]),
            }
            for c, name in enumerate(judged.channel)
        ],
        'in_domain': judged.in_domain,
        'trained_on': float(sum(judged.trained_on.values())),
        'warm': sorted(judged.warm),
        'sensors': _sensors(model, recorded, bridged),
    }


@single_threaded
def _single(
    model: ThermalModel, recorded: ThermalRun
) -> 'tuple[Evaluation, ThermalRun, tuple[Bridged, ...]]':
    return judge_recorded(model, recorded, candidates=())


def _sensors(
    model: ThermalModel, recorded: ThermalRun, bridged: Sequence[Bridged]
) -> list[tuple[str, float, float, float]]:
    """Return of each sensor the shares that are missing, substituted and bridged [-]."""
    try:
        even = recorded.averaged(model.interval)
    except ValueError:
        even = recorded  # which the model refuses
    count = len(even.time)
    missing = np.isnan(even.temperature).mean(axis=0)
    found = []
    for name, share in zip(even.sensor, missing, strict=True):
        own = [gap for gap in bridged if gap.sensor == name]
        mates = sum(gap.samples for gap in own if gap.by == MATES)
        lines = sum(gap.samples for gap in own if gap.by != MATES)
        found.append((name, float(share), mates / count, lines / count))
    return found
