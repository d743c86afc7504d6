# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Judge many bags with models, by any executor, and write a row per bag, model and channel."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import sqrt
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote

from fuzzycnc_ros.bags.finding import NamedBag
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.core.thermal.band import is_false_band
from fuzzycnc_ros.core.thermal.model import load_model
from fuzzycnc_ros.studies.fleet.cache import Cache, StoredResults
from fuzzycnc_ros.studies.fleet.content import files_of, result_version
from fuzzycnc_ros.studies.fleet.in_flight import Crew, InFlight, Killed
from fuzzycnc_ros.studies.fleet.judging import (
    BagResult,
    BagTask,
    Document,
    FleetModel,
    judge_bag,
    machine_name,
    one_line,
)
from fuzzycnc_ros.studies.fleet.results import Row, TableWriter, new_table

Tell = Callable[[str, int, int], None]
"""Told what is going on, steps done and in all."""

CACHE_FOLDER = '.fuzzycnc-fleet'
"""Folder beside the table in which figures are kept."""

MODEL_SUFFIX = '.json'


class Problem(NamedTuple):
    """Unusable input, and the reason in one line."""

    name: str
    reason: str


@dataclass
class FleetSummary:
    """Results of a fleet.

    Parameters
    ----------
    bags, rows : int
        Bags that were looked at, and rows that were written.
    judged, from_cache : int
        Bags that were judged now, and bags that were known.
    problems : list of Problem
        Bags and models that could not be used, in the order of the table.
    bands : dict
        Machine, model and channel -> number of independent residuals, how many of them were
        inside the band, and the sum of their squares over those of the deviation.
    """

    bags: int = 0
    rows: int = 0
    judged: int = 0
    from_cache: int = 0
    problems: list[Problem] = field(default_factory=list)
    bands: dict[tuple[str, str, str], tuple[float, float, float]] = field(default_factory=dict)

    def false_bands(self) -> list[str]:
        """Return whose band holds far less than it promises, in words; see `is_false_band`."""
        return [
            f'{machine}, model {model}: the band holds {100.0 * inside / number:.0f} % of '
            f'{channel} over all bags; it should cover 95 %'
            for (machine, model, channel), (number, inside, square) in self.bands.items()
            if number and is_false_band(inside / number, sqrt(square / number), number)
        ]


def model_file(folder: Path, machine: str) -> Path:
    """Return the file of a machine's model in a folder of models."""
    return folder / f'{quote(machine, safe="")}{MODEL_SUFFIX}'


def read_models(places: Sequence[Path]) -> tuple[tuple[FleetModel, ...], list[Problem]]:
    """Return the models of files and of folders that `fuzzycnc fleet train` wrote.

    Parameters
    ----------
    places : sequence of Path
        A file is for all bags; in a folder each file is for the bags of the machine that it is
        named after.

    Returns
    -------
    models : tuple of FleetModel
        Those that can be used, in the order in which they are given.
    problems : list of Problem
        Those that cannot, and why.

    Raises
    ------
    ValueError
        If none can be used, or one is given twice.
    """
    models: list[FleetModel] = []
    problems = []
    for path, machine in _model_files(places):
        try:
            text = path.read_text(encoding='utf-8')
            load_model(text if text.lstrip().startswith('{') else path)
        except (OSError, ValueError) as error:
            reason = one_line(error)
            named = reason if str(path) in reason else f'{path}: {reason}'
            problems.append(Problem(str(path), named))
            continue
        model = FleetModel(str(path.absolute()), path.stem, text_hash(text), machine)
        if any((item.hash, item.machine) == (model.hash, machine) for item in models):
            raise ValueError(f'{path}: expected each model once but found it twice; leave one out')
        models.append(model)
    if not models:
        reasons = '; '.join(problem.reason for problem in problems)
        raise ValueError(reasons or 'model: expected one but found none; name one')
    return tuple(models), problems


def evaluate_fleet(
    bags: Sequence[NamedBag],
    models: Sequence[FleetModel],
    out: Path,
    *,
    crew: Crew | None = None,
    machine_by: str = 'bag',
    cache: Path | None = None,
    tell: Tell = lambda text, done, total: None,
) -> FleetSummary:
    """Judge each bag with each model that is for its machine, and write the table.

    Parameters
    ----------
    bags : sequence of NamedBag
        The bags, as `find_bags` returns them; rows come in their order.
    models : sequence of FleetModel
        What they are judged with.
    out : Path
        Parquet file to write.
    crew : Crew, optional
        Who judges; this process if absent.  The table does not depend on it.
    machine_by : {'bag', 'folder'}
        Whether the namespace in a bag names its machine, or the folder that it lies in.
    cache : Path, optional
        Folder of what was judged before; beside the table if absent.
    tell : callable
        Told how far it is.

    Raises
    ------
    ValueError
        If the cache cannot be used, or the workers are gone.
    OSError
        If the table or the cache cannot be written.
    """
    folder = out.parent / CACHE_FOLDER if cache is None else cache
    with Cache(folder, result_version()) as known, new_table(out) as table:
        fleet = _Fleet(bags, tuple(models), machine_by, known, table, tell)
        fleet.judge(crew)
        fleet.write()
        return fleet.summary


class _Fleet:
    """The work on many bags.

    A table is written in the order of the bags.  As long as all are known, each is written when
    it is looked up; from the first one that is not, when all are there.
    """

    def __init__(
        self,
        bags: Sequence[NamedBag],
        models: tuple[FleetModel, ...],
        machine_by: str,
        cache: Cache,
        table: TableWriter,
        tell: Tell,
    ) -> None:
        self._bags, self._models, self._by = bags, models, machine_by
        self._places = [str(bag.path.absolute()) for bag in bags]
        self._cache, self._table, self._tell = cache, table, tell
        self._hashes: list[str | None] = [None] * len(bags)
        self._lost: dict[int, BagResult] = {}  # what is not for the cache
        self._written = 0
        self.summary = FleetSummary(bags=len(bags))

    def judge(self, crew: Crew | None) -> None:
        """Bring everything into the cache that it does not have."""
        moved: list[int] = []
        unknown: list[int] = []
        for at, bag in enumerate(self._bags):
            try:
                files = files_of(bag.path)
            except OSError:
                unknown.append(at)  # who reads it says why it cannot be read
                continue
            self._hashes[at] = self._cache.content_of(self._places[at], files)
            known = self._known(at)
            if known is not None and self._written == at:
                self._write(at, known)
            elif known is None:
                new_here = self._hashes[at] is None and self._cache.may_have_moved(files)
                (moved if new_here else unknown).append(at)
            self._say(at + 1 - len(moved) - len(unknown))
        work = InFlight(judge_bag, crew)
        for task, found in work.done(self._tasks(moved, only_hash=True), len(moved)):
            if isinstance(found, BagResult) and found.sha256:
                self._cache.put(task.path, found)
                self._hashes[task.number] = found.sha256
            if self._known(task.number) is None:
                unknown.append(task.number)
        unknown.sort()
        self.summary.judged = len(unknown)
        self.summary.from_cache = done = len(self._bags) - len(unknown)
        for task, judged in work.done(self._tasks(unknown), len(unknown)):
            self._take(task, judged)
            done += 1
            self._say(done)

    def write(self) -> None:
        """Write the rows that are not in the table yet."""
        for at in range(self._written, len(self._bags)):
            lost = self._lost.pop(at, None)
            known = (
                StoredResults(lost.facts, lost.figures) if lost is not None else self._known(at)
            )
            assert known is not None
            self._write(at, known)

    def _tasks(self, numbers: Sequence[int], only_hash: bool = False) -> Iterator[BagTask]:
        for at in numbers:
            bag = self._bags[at]
            yield BagTask(at, self._places[at], bag.name, self._models, self._by, only_hash)

    def _known(self, at: int) -> StoredResults | None:
        """Return what the cache has of a bag; None unless that is all that is wanted."""
        sha256 = self._hashes[at]
        known = None if sha256 is None else self._cache.known(sha256)
        if known is None or known.facts is None:
            return None
        wanted = (
            (namespace, model.hash)
            for namespace, _, model in self._wanted(at, known.facts)
            if model is not None
        )
        return known if all(key in known.figures for key in wanted) else None

    def _wanted(self, at: int, facts: Document) -> Iterator[tuple[str, str, FleetModel | None]]:
        """Yield namespace, machine and model of all that a bag is judged with.

        None stands for the model of a machine that none is for.
        """
        for namespace in facts.get('machines', ()):
            machine = machine_name(namespace, self._places[at], self._by)
            fitting = [model for model in self._models if model.fits(machine)]
            if not fitting:
                yield namespace, machine, None
            for model in fitting:
                yield namespace, machine, model

    def _take(self, task: BagTask, judged: BagResult | Killed) -> None:
        """Keep what came of a bag."""
        if isinstance(judged, Killed):
            problem = (
                f'{task.path}: its process was killed each time it was judged; if memory ran '
                'out, judge it with fewer workers'
            )
            judged = BagResult('', (), '', {'problem': problem}, {}, lasting=False)
        elif judged.version != result_version():
            raise ValueError(
                f'expected workers with fuzzycnc {result_version()} but found {judged.version}; '
                'install the same fuzzycnc, numpy and scipy there'
            )
        if judged.lasting:
            self._cache.put(task.path, judged)
            self._hashes[task.number] = judged.sha256
        else:
            self._lost[task.number] = judged

    def _write(self, at: int, known: StoredResults) -> None:
        """Write the rows of a bag."""
        bag, facts = self._bags[at], known.facts or {}
        common: Row = {
            'bag': bag.name,
            'path': str(bag.path),
            'bag_sha256': self._hashes[at],
            'begin': facts.get('begin'),
            'duration_s': facts.get('duration_s'),
            'version': result_version(),
        }
        rows: list[Row] = []
        if 'problem' in facts:
            machine = machine_name('', self._places[at], 'folder')
            problem = _renamed(facts, bag)
            rows.append({**common, 'machine': machine, 'problem': problem})
            self.summary.problems.append(Problem(bag.name, problem))
        for namespace, machine, model in self._wanted(at, facts):
            if model is None:
                problem = f'{bag.path}: expected a model for machine {machine} but found none'
                rows.append({**common, 'machine': machine, 'problem': problem})
                self.summary.problems.append(Problem(bag.name, problem))
                continue
            figures = known.figures[namespace, model.hash]
            own = {**common, 'machine': machine, **_of_model(model, figures)}
            rows += [{**own, **channel} for channel in figures.get('channels', ())]
            for channel in figures.get('channels', ()):
                self._note_band((machine, model.label, channel['channel']), channel)
            if 'problem' in figures:
                problem = f'{model.label}: {_renamed(figures, bag)}'
                rows.append({**own, 'problem': problem})
                self.summary.problems.append(Problem(bag.name, problem))
        self._table.add(rows)
        self.summary.rows += len(rows)
        self._written = at + 1

    def _note_band(self, key: tuple[str, str, str], figures: Document) -> None:
        """Add the independent residuals of a bag to those of the other bags."""
        number, inside, square = self.summary.bands.get(key, (0.0, 0.0, 0.0))
        if figures['samples']:
            number += figures['independent']
            inside += figures['independent'] * figures['covered']
            square += figures['independent'] * figures['band_ratio'] ** 2
        self.summary.bands[key] = number, inside, square

    def _say(self, done: int) -> None:
        self._tell(f'{len(self._bags)} bags', done, len(self._bags))


def _of_model(model: FleetModel, figures: Document) -> Row:
    """Return the cells of a model that all channels share."""
    names = ('sensor', 'missing', 'substituted', 'bridged')
    return {
        'model': model.label,
        'model_hash': model.hash,
        'in_domain': figures.get('in_domain'),
        'trained_on': figures.get('trained_on'),
        'warm': figures.get('warm'),
        'sensors': [dict(zip(names, item, strict=True)) for item in figures.get('sensors', ())],
    }


def _renamed(document: Document, bag: NamedBag) -> str:
    """Return what is wrong with a bag under its path and name of today."""
    text: str = document['problem']
    if 'path' in document:
        text = text.replace(f'run {document["name"]!r}', f'run {bag.name!r}')
        text = text.replace(document['path'], str(bag.path))
    return text


def _model_files(places: Sequence[Path]) -> Iterator[tuple[Path, str | None]]:
    """Yield the files of models, each with the machine that it is for."""
    for place in places:
        if not place.is_dir():
            yield place, None
            continue
        found = sorted(place.glob(f'*{MODEL_SUFFIX}'))
        if not found:
            raise ValueError(
                f'{place}: expected models such as mill_1{MODEL_SUFFIX} but found none; train '
                'them with `fuzzycnc fleet train`'
            )
        for path in found:
            yield path, unquote(path.stem)
