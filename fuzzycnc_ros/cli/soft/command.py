# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc soft`: soft material that a path is straightened for beforehand."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fuzzycnc_ros.cli.console import (
    JsonFile,
    check_at_least,
    check_folder,
    check_new,
    progress_bar,
    say,
    show,
    write_json,
    write_report,
    write_text,
)
from fuzzycnc_ros.cli.options import OptionalPath, OptionalText, Report, choice, given
from fuzzycnc_ros.cli.soft.compensate import compensate, read_model_file
from fuzzycnc_ros.cli.soft.trial import measure, simulate, write_trial

if TYPE_CHECKING:
    from fuzzycnc_ros.studies.soft.foam_records import Samples

HELP = """Compensate patterns and designs on soft material: show, train, compensate, learn.

    fuzzycnc soft demo --report foam.html
    fuzzycnc soft pattern --out trial.dst --marks marks.csv
    fuzzycnc soft measure photo.jpg --pattern trial.dst --marks marks.csv --out measured.csv
    fuzzycnc soft train calibration --out model.json
    fuzzycnc soft compensate quilt.ngc --model model.json --thickness 15mm --depth 6mm \\
        --step 3mm --out quilt_compensated.ngc
    fuzzycnc soft learn monday --out offsets.json

`soft compensate` and `deformation_compensator` take both kinds of files.
"""

FEATURES = ('load', 'physical', 'thickness', 'paper')

TRAINED = ('auto', 'none', 'ridge', 'gaussian_process', 'network')

Force = Annotated[bool, typer.Option('--force', help='Overwrite the file.')]


def demo(
    seed: Annotated[int, typer.Option(help='Seed of samples, sheets and stitches.')] = 0,
    runs: Annotated[int, typer.Option(help='Runs of each track and method.')] = 11,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Stitch five tracks on the simulated sheet, without and with compensation.

    Models are trained on 265 samples; each track is stitched --runs times on sheets that scatter:
    as it is, with linear rules, with the default, and as published. Then the tracks are learnt
    from their recorded runs in three cycles. Ten seconds.

        fuzzycnc soft demo
        fuzzycnc soft demo --seed 3 --json figures.json --report foam.html
    """
    from fuzzycnc_ros.studies.soft import foam_page as shown
    from fuzzycnc_ros.studies.soft.foam_comparison import SIZE, compare_foam

    check_at_least('--seed', seed, 0)
    check_at_least('--runs', runs, 1)
    check_folder(report, json_file)
    with progress_bar('stitching') as tell:
        found = compare_foam(seed, runs=runs, progress=tell)
    for table in (
        shown.tracks_table(found),
        shown.published_table(found),
        shown.learning_table(found),
    ):
        show(table)
        say('')
    for line in shown.comparison_remarks(found):
        say(line)
    if report is not None:
        facts = {
            'Sheets': f'simulated foam, {1e3 * SIZE[0]:g} x {1e3 * SIZE[1]:g} mm, clamped all '
            'around; friction and modulus scatter from run to run',
            'Training': '265 samples in the middle of a sheet of 200 x 120 mm, thicknesses 5 to '
            '35 mm',
            'Seed': str(seed),
        }
        write_report(report, shown.comparison_page(found, facts))
    write_json(json_file, found)


def train(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar='BAG...|CSV',
            help='Bags of runs with deformation_compensator, or one .csv with the columns '
            'direction_deg, depth_mm, type (1 arc, 2 line), step_mm, thickness_mm, s_x_mm, s_y_mm '
            'and, if known, sheet.',
        ),
    ],
    out: Annotated[Path, typer.Option(metavar='MODEL', help='Model file to write.')],
    method: Annotated[
        str,
        choice('Model: what held-out samples choose, or one of the others by name.', TRAINED),
    ] = 'auto',
    consequent: Annotated[
        str, choice('Rules of the network: with a hidden layer, or linear ones.', ('nts', 'sts'))
    ] = 'nts',
    features: Annotated[
        str,
        choice(
            'Inputs of the network: drift per load of the foot, physical ones, those of the '
            'paper with the thickness, those of the paper.',
            FEATURES,
        ),
    ] = 'load',
    adapt: Annotated[
        OptionalPath,
        given('Only fit the gains of X and Y of this model to the samples.', metavar='MODEL'),
    ] = None,
    baselines: Annotated[
        bool,
        typer.Option('--baselines/--no-baselines', help='Judge plain regressors as well.'),
    ] = True,
    seed: Annotated[int, typer.Option(help='Seed of the training.')] = 0,
    force: Force = False,
    report: Report = None,
    json_file: JsonFile = None,
) -> None:
    """Train a model of feed compensation on samples, and write it.

    A sample is a primitive that was stitched on a fresh sheet without compensation: its direction,
    depth, type, step and thickness, and the offset that it called for per 50 mm of feed. Later
    sides of recorded paths, and compensated ones, are taken by the fading of the drift. Each model
    is judged on samples that were held out; samples of one sheet, path or equal process stay
    together. No correction, ridge regression, a Gaussian process and the fuzzy network compete: a
    model is taken over a simpler one only if it is better beyond chance. Samples that contradict
    the others are left out and named.

    With --adapt nothing is trained: two gains, within 0.5 and 2, bring a model to another sheet or
    foot from a single run.

        fuzzycnc soft train calibration --out model.json
        fuzzycnc soft train samples.csv --method network --out fuzzy.json --report training.html
        fuzzycnc soft train monday --adapt model.json --out model_monday.json
    """
    from fuzzycnc_ros.studies.soft.foam_records import read_samples

    for option, value, known in (
        ('--method', method, TRAINED),
        ('--consequent', consequent, ('nts', 'sts')),
        ('--features', features, FEATURES),
    ):
        if value not in known:
            raise ValueError(f'{option}: expected one of {", ".join(known)} but found {value!r}')
    check_at_least('--seed', seed, 0)
    if not force:
        check_new(out, remedy='add --force')
    check_folder(out, report, json_file)
    if adapt is not None:
        if report is not None:
            raise ValueError('--report: expected none with --adapt, which trains nothing')
        _adapt(read_samples(sources), adapt, out, json_file)
        return
    samples = read_samples(sources)
    settings = {'consequent': consequent, 'features': features, 'random_state': seed}
    _train(samples, settings, method, baselines, out, report, json_file)


def _train(
    samples: 'Samples',
    settings: dict[str, Any],
    method: str,
    baselines: bool,
    out: Path,
    report: Path | None,
    json_file: Path | None,
) -> None:
    """Judge and train, and write what came of it."""
    from fuzzycnc_ros.core.deformation.model import write_model
    from fuzzycnc_ros.core.names import text_hash
    from fuzzycnc_ros.studies.soft import foam_page as shown
    from fuzzycnc_ros.studies.soft import foam_training as judged

    other = 'sts' if settings['consequent'] == 'nts' else 'nts'
    others = [judged.network(judged.CONSEQUENTS[other], **{**settings, 'consequent': other})]
    lines = list(samples.lines)
    if baselines:
        try:
            others += judged.baselines(settings['features'], settings['random_state'])
        except ModuleNotFoundError as error:
            lines.append(f'no plain regressors: {error}; pip install "fuzzycnc_ros[ml]"')
    with progress_bar('training') as tell:
        found = judged.train_model(samples, settings, method, others=others, progress=tell)
    text = write_model(found.model)
    lines += found.lines
    for line in lines:
        say(line)
    for table in (shown.coverage_table(found.judged), shown.training_table(found.judged)):
        say('')
        show(table)
    write_text(out, text)
    say(f'{out}: written, hash {text_hash(text)[:16]}')
    if report is not None:
        facts = {
            'Model': found.judged.errors[found.judged.used].name,
            'Inputs': found.model.features,
            'Rules': str(len(found.model.network.antecedent.center)),
            'Seed': str(settings['random_state']),
        }
        write_report(report, shown.training_page(found.judged, lines, facts))
    document = shown.training_document(found.judged)
    write_json(
        json_file,
        {
            'model': str(out), 'hash': text_hash(text), 'notes': lines, 'method': found.method,
            'outliers': found.outliers, **settings, **document,
        },
    )  # fmt: skip


def _adapt(samples: 'Samples', source: Path, out: Path, json_file: Path | None) -> None:
    """Fit the gains of a model to samples, and write it."""
    from fuzzycnc_ros.core.deformation.model import DeformationModel, write_model
    from fuzzycnc_ros.core.names import text_hash
    from fuzzycnc_ros.studies.soft.foam_learning import fit_gains

    model = read_model_file(source)
    if not isinstance(model, DeformationModel):
        raise ValueError(
            f'{source}: expected a model of `soft train` but found offsets of one track, which '
            'have no gains'
        )
    for line in samples.lines:
        say(line)
    try:
        fit = fit_gains(model, samples)
    except ValueError as error:
        raise ValueError(f'{source}: {error}') from error
    for line in fit.lines():
        say(line)
    text = write_model(fit.model)
    write_text(out, text)
    say(f'{out}: written, hash {text_hash(text)[:16]}')
    document = {
        'model': str(out), 'hash': text_hash(text), 'samples': fit.samples,
        'left_out': fit.left_out, 'gain_before': fit.before, 'gain': fit.gain,
        'rms_before': 0.02 * fit.error_before, 'rms': 0.02 * fit.error,
    }  # fmt: skip
    write_json(json_file, document)


def learn(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar='SOURCE...',
            help='Bags of runs of one track, of the last cycle, or a .csv for each run with the '
            'columns x_mm, y_mm, stitched_x_mm, stitched_y_mm and, if the run had offsets, '
            'offset_x_mm and offset_y_mm, and jump, as `soft compensate` and `soft measure` write '
            'them.',
        ),
    ],
    out: Annotated[Path, typer.Option(metavar='OFFSETS', help='File of offsets to write.')],
    gain: Annotated[
        float, typer.Option(help='Share of the deviation that a cycle takes away, above 0 to 1.')
    ] = 0.7,
    path_id: Annotated[
        OptionalText,
        given('Track, if the bags hold several; of a .csv its name.', '--path', metavar='NAME'),
    ] = None,
    material: Annotated[
        OptionalText, given('Of a .csv: material, as in the pattern.', metavar='NAME')
    ] = None,
    thickness: Annotated[
        OptionalText, given('Of a .csv: thickness, such as 15mm.', metavar='LENGTH')
    ] = None,
    size: Annotated[
        OptionalText,
        given(
            'Of a .csv: clamped area from the origin, such as 150x100mm.', metavar='WIDTHxHEIGHT'
        ),
    ] = None,
    force: Force = False,
    json_file: JsonFile = None,
) -> None:
    """Learn the offsets of one track from recorded runs of it.

    The offsets of the next run are those of the recorded ones and a share of what was left. Runs
    of one cycle count by their mean; runs with other offsets, of another track or material are
    refused. No model is needed, and a track is learnt where no model was trained.

        fuzzycnc soft learn first_run --out offsets.json
        fuzzycnc soft learn second_run --out offsets.json --force
        fuzzycnc soft learn run.csv --path star --material foam --thickness 15mm --out offsets.json
    """
    from fuzzycnc_ros.cli.soft.tables import TrackOptions, read_tables
    from fuzzycnc_ros.core.deformation.offset_file import write_offsets
    from fuzzycnc_ros.studies.soft.foam_learning import learn_track
    from fuzzycnc_ros.studies.soft.foam_records import read_recordings

    if not 0.0 < gain <= 1.0:
        raise ValueError(f'--gain: expected more than 0 and at most 1 but found {gain:g}')
    if not force:
        check_new(out, remedy='add --force')
    check_folder(out, json_file)
    for source in sources:
        if not source.exists():
            raise ValueError(f'{source}: expected a bag or a .csv but nothing is there')
    options = TrackOptions(path_id, material, thickness, size)
    tables = read_tables(sources, options)
    recordings = read_recordings(sources) if tables is None else tables
    learnt = learn_track(recordings.paths, path_id, gain)
    write_text(out, write_offsets(learnt.offsets))
    for reason, count in sorted(recordings.left_out.items()):
        say(f'left out: {count} {reason}')
    for line in learnt.lines():
        say(line)
    say(f'{out}: the offsets of {learnt.offsets.path_id!r} on {learnt.offsets.material!r}')
    write_json(json_file, learnt.document() | {'offsets': str(out), 'gain': gain})


COMMANDS: dict[str, Callable[..., Any]] = {
    'demo': demo,
    'train': train,
    'compensate': compensate,
    'learn': learn,
    'pattern': write_trial,
    'measure': measure,
    'simulate': simulate,
}
"""The subcommands in the order of the help."""
