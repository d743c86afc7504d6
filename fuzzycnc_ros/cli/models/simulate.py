# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc simulate`: a thermal shift in one process, without DDS."""

from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from fuzzycnc_ros.cli.completion import settings, some_of
from fuzzycnc_ros.cli.console import (
    JsonFile,
    Tell,
    check_at_least,
    check_folder,
    check_new_folder,
    progress_bar,
    say,
    show,
    words,
    write_json,
    write_report,
)
from fuzzycnc_ros.cli.options import DUTIES, OptionalPath, given, node_parameters

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.page.table import Table
    from fuzzycnc_ros.studies.shift.thermal_shift import Calibration
    from fuzzycnc_ros.studies.thermal.report_data import CompensationRun

Figures = dict[str, dict[str, dict[str, dict[str, Optional[float]]]]]  # noqa: UP045
"""run -> candidate -> channel -> figure [um]."""


def simulate(
    duties: Annotated[
        list[str],
        typer.Option(
            metavar='DUTY,...',
            help=f'Duties to compensate, of {", ".join(DUTIES)}, one a day.',
            autocompletion=some_of(DUTIES),
        ),
    ] = ['T2,T3'],  # noqa: B006 - typer copies it
    training: Annotated[
        list[str],
        typer.Option(
            '--train',
            metavar='DUTY,...',
            help='Duties to train on first.',
            autocompletion=some_of(DUTIES),
        ),
    ] = ['D0,D0b,T1'],  # noqa: B006
    model: Annotated[
        OptionalPath, given('Use this model file instead of training.', metavar='MODEL')
    ] = None,
    seed: Annotated[int, typer.Option(help='Seed of all measuring noise.')] = 0,
    seeds: Annotated[
        int, typer.Option(help='Repeat with so many seeds, and give the medians.')
    ] = 1,
    fault: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            show_default=False,
            metavar='SENSOR:KIND:START[:VALUE]',
            help='Sensor fault during the compensated duties: dead, stuck, drift, open or jump; '
            'START in s after a duty began, VALUE in K/h (drift) or K. Repeat for more.',
        ),
    ] = None,
    param: Annotated[
        Optional[list[str]],  # noqa: UP045
        typer.Option(
            show_default=False,
            metavar='NODE.NAME=VALUE',
            help='Parameter of a node, a number with its unit or in SI, see '
            'docs/reference/parameters.md; repeat.',
            autocompletion=settings,
        ),
    ] = None,
    out: Annotated[
        OptionalPath,
        given(
            'Record everything into this new bag, and the calibration runs into '
            'BAG_calibration beside it.',
            metavar='BAG',
        ),
    ] = None,
    report: Annotated[OptionalPath, given('Write a page with plots.', metavar='FILE.html')] = None,
    json_file: JsonFile = None,
) -> None:
    """Run a thermal shift of the simulated mill in one process, much faster than live.

    The mill runs some duties to train on and then, compensated, others that no model has seen.
    The same components run as on a live graph and give the same outputs. The table shows the
    remaining thermal error: uncompensated, with plain baselines, with every candidate, with
    the model in use as it predicted, and as the offsets in force on the machine left it.

    With --seeds, --out and --report show the first seed.

        fuzzycnc simulate
        fuzzycnc simulate --seeds 12 --json shift.json
        fuzzycnc simulate --duties T2 --fault T18:drift:3600 --report t2.html
        fuzzycnc simulate --out shift --param compensator.offset_max=20um
    """
    from fuzzycnc_ros.studies.shift.thermal_shift import shift_components
    from fuzzycnc_ros.studies.thermal.summary import summary_document, summary_table

    check_at_least('--seed', seed, 0)
    check_at_least('--seeds', seeds, 1)
    names, calibrated_on = words(duties), words(training)
    check_new_folder(out)
    if out is not None and model is None:
        check_new_folder(_calibration_folder(out))
    check_folder(report, json_file)
    parameters = node_parameters('--param', param or [])
    shift_components(names, seed, faults=fault or (), parameters=parameters)
    documents: list[Figures] = []
    with progress_bar('simulating') as tell:
        for number in range(seed, seed + seeds):
            first = number == seed
            shift = _Shift(
                names, calibrated_on, number, tuple(fault or ()), parameters, model, tell
            )
            shift.run(out if first else None)
            if first:
                shown = shift
            documents.append(summary_document(shift.runs))
    if seeds == 1:
        show(summary_table(shown.runs))
    else:
        show(median_table(documents, shown.runs))
    for line in shown.lines():
        say(line if seeds == 1 else f'seed {seed}: {line}')
    if out is not None:
        say(f'{out}: everything that was published; try fuzzycnc replay {out}')
    if report is not None:
        shown.write_report(report)
    write_json(
        json_file,
        {
            'runs': median_figures(documents),
            'seeds': [
                {'seed': seed + number, 'runs': document}
                for number, document in enumerate(documents)
            ],
        },
    )


class _Shift:
    """One seed's shift: calibration, training, compensation."""

    def __init__(
        self,
        duties: tuple[str, ...],
        training: tuple[str, ...],
        seed: int,
        faults: tuple[str, ...],
        parameters: dict[str, dict[str, Any]],
        model: Path | None,
        tell: Tell,
    ) -> None:
        self._duties, self._training, self._seed = duties, training, seed
        self._faults, self._parameters = faults, parameters
        self._model_file, self._tell = model, tell
        self._text = ''
        self._calibration: Calibration | None = None
        self.runs: tuple[CompensationRun, ...] = ()

    def run(self, out: Path | None) -> None:
        """Carry it out; record it if `out` is given."""
        from fuzzycnc_ros.core.thermal.fit import train_model
        from fuzzycnc_ros.core.thermal.model import load_model
        from fuzzycnc_ros.studies.published_bag import PublishedBag
        from fuzzycnc_ros.studies.shift.thermal_shift import record_calibration

        if self._model_file is not None:
            self._text = load_model(self._model_file).to_json()
        else:
            self._calibration = record_calibration(
                self._training,
                self._seed,
                folder=None if out is None else _calibration_folder(out),
                parameters=self._parameters,
                progress=self._tell,
            )
            trained = train_model(
                self._calibration.runs,
                progress=lambda stage, name, done, total: self._tell(
                    f'{stage} {name}', done, total
                ),
            )
            self._text = trained.to_json()
        if out is None:
            self._compensate(None)
            return
        with PublishedBag(out) as bag:
            bag.attach('model.json', self._text)
            self._compensate(bag)

    def _compensate(self, sink: Any) -> None:
        from fuzzycnc_ros.studies.shift.thermal_shift import run_shift

        self.runs = run_shift(
            self._text,
            self._calibration,
            self._duties,
            self._seed,
            faults=self._faults,
            parameters=self._parameters,
            sink=sink,
            progress=self._tell,
        )

    def lines(self) -> list[str]:
        """Return what was trained and what is wrong with it."""
        from fuzzycnc_ros.cli.models.train import default_text, problem_lines
        from fuzzycnc_ros.core.thermal.model import load_model

        model = load_model(self._text)
        return [
            f'trained on duties {", ".join(model.runs)}; sensors {", ".join(model.inputs)}; '
            f'default: {default_text(model)}',
            *problem_lines(model),
        ]

    def write_report(self, path: Path) -> None:
        """Write the page with plots."""
        from fuzzycnc_ros.core.thermal.model import load_model
        from fuzzycnc_ros.studies.shift.shift_report import shift_report
        from fuzzycnc_ros.studies.thermal.report_page import report_page

        facts = {'Machine': f'simulated mill, noise seed {self._seed}'}
        if self._faults:
            facts['Sensor faults'] = ', '.join(self._faults)
        calibration = () if self._calibration is None else self._calibration.runs
        data = shift_report(
            self.runs, load_model(self._text), self._text, calibration=calibration, facts=facts
        )
        write_report(path, report_page(data))


def median_figures(documents: list[Figures]) -> Figures:
    """Return the median over seeds of every figure; None where most runs diverged."""
    import numpy as np

    def median(run: str, name: str, channel: str, figure: str) -> float | None:
        values = [document[run][name][channel][figure] for document in documents]
        # The middle one is taken, or the worse of two: halves of infinity have no mean.
        ordered = np.sort([inf if value is None else value for value in values])
        middle = float(ordered[len(ordered) // 2])
        if len(ordered) % 2 == 0 and isfinite(middle):
            middle = float(ordered[len(ordered) // 2 - 1] + middle) / 2.0
        return middle if isfinite(middle) else None

    return {
        run: {
            name: {
                channel: {figure: median(run, name, channel, figure) for figure in figures}
                for channel, figures in channels.items()
            }
            for name, channels in names.items()
        }
        for run, names in documents[0].items()
    }


def median_table(documents: list[Figures], runs: tuple['CompensationRun', ...]) -> 'Table':
    """Return the medians over noise seeds of all models, in micrometres."""
    from fuzzycnc_ros.studies.page.table import Column, Table
    from fuzzycnc_ros.studies.thermal.summary import candidate_label, micrometres

    medians = median_figures(documents)
    columns, names = [Column('Model', numeric=False)], list(next(iter(medians.values())))
    cells: list[list[str]] = [[] for _ in names]
    for run in runs:
        for channel in run.channel:
            for figure in ('max', 'rms'):
                columns.append(Column(figure, f'{run.name} {channel}'))
                for row, name in enumerate(names):
                    value = medians[run.name][name][channel.lower()][f'{figure}_um']
                    cells[row].append(micrometres(inf if value is None else 1e-6 * value))
    rows = tuple((candidate_label(n), *line) for n, line in zip(names, cells, strict=True))
    title = f'Residual thermal error, median of {len(documents)} noise seeds [µm]'
    return Table(title, tuple(columns), rows)


def _calibration_folder(out: Path) -> Path:
    return out.with_name(f'{out.name}_calibration')
