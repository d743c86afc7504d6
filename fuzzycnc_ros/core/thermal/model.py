# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A trained thermal model: inputs, fitted candidates, domain and uncertainty."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import LENGTH_MIN, NUMBER_MAX, Array
from fuzzycnc_ros.core.document import THERMAL_MODEL, ModelFileError, Node, parse_document
from fuzzycnc_ros.core.encodings import decoded
from fuzzycnc_ros.core.names import first_names, text_hash
from fuzzycnc_ros.core.thermal.band import PredictionBand
from fuzzycnc_ros.core.thermal.candidate import (
    CANDIDATES,
    COMPARED_ONLY,
    UNCOMPENSATED,
    Candidate,
    Settings,
    drivers_read,
)
from fuzzycnc_ros.core.thermal.cold_start import ColdStart
from fuzzycnc_ros.core.thermal.domain import Domain
from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint
from fuzzycnc_ros.core.thermal.learning import Basis, Learner
from fuzzycnc_ros.core.thermal.prior import LearningPrior
from fuzzycnc_ros.core.thermal.recursions.base import (
    BOUND_MAX,
    BOUND_MIN,
    INTERVAL_MAX,
    INTERVAL_MIN,
    BoundedRecursion,
    Recursion,
    Stream,
    check_interval,
    combine,
    read_recursion,
    write_recursion,
)
from fuzzycnc_ros.core.thermal.run import (
    DRIVE_NAME,
    DRIVE_NAMES,
    JITTER_MAX,
    SPINDLE_SPEED,
    ThermalRun,
    drive_of,
    driven_speed,
    driver_known,
    speed_drive,
)
from fuzzycnc_ros.core.thermal.screw_growth import screws_of
from fuzzycnc_ros.core.thermal.sensor_watch import InputCluster, InputSelection, SensorWatchModel

REFERENCE_RULE = 'mean of the first three samples'
"""Reference of rises, unless a thermal reference says otherwise."""


class ModelMismatchError(ValueError):
    """A model does not fit the stream or run that it is to be used on."""


@dataclass(frozen=True, eq=False)
class ThermalModel:
    """Everything that a predictor needs, as it is written to a model file.

    Parameters
    ----------
    inputs : tuple of str, length p
        Sensors in the order of the rises.
    interval : float
        Sampling interval that the recursions belong to [s].
    channel, axis : tuple of str, length c
        Displacement channels and the ISO 841 axis of each.
    runs : tuple of str
        Runs that it was trained on.
    candidates : mapping of str to Candidate
        All fitted candidates, so that an evaluation can show them side by side.
    default : tuple of str, length c
        Candidate that each channel uses.
    selection : InputSelection
        How the inputs were chosen, with their substitutes and gains.
    domain : Domain
        Rises that it was trained on.
    band : Band
        How far the default may be off, from samples that neither fit nor choice had seen.
    drivers : tuple of str, length d
        What the candidates may read behind the rises, see `drivers_of`: the driver of the
        spindle speed comes first, where it was recorded.
    bound : ndarray, shape (c,), optional
        Largest absolute error that the default may predict [m]; absent in old files, where it
        has no bound.
    omitted : mapping of str to str
        Candidates that could not be fitted, and why.
    reference : str
        Rule by which the reference of the rises was found.
    watch : SensorWatchModel, optional
        How the sensors follow each other, to find faulty ones and to stand in for them; files
        of earlier versions have none.
    cold_start : ColdStart, optional
        How the inputs differ before the machine is used; files of earlier versions have none.
    fingerprints : tuple of Fingerprint
        What it was trained on, to recognise it; files of earlier versions have none.
    prior : LearningPrior, optional
        What learning from probes begins with; files of earlier versions have none, nor have
        models of very many inputs.
    """

    inputs: tuple[str, ...]
    interval: float
    channel: tuple[str, ...]
    axis: tuple[str, ...]
    runs: tuple[str, ...]
    candidates: Mapping[str, Candidate]
    default: tuple[str, ...]
    selection: InputSelection
    domain: Domain
    band: PredictionBand
    drivers: tuple[str, ...] = ()
    bound: Array | None = None
    omitted: Mapping[str, str] = field(default_factory=dict)
    reference: str = REFERENCE_RULE
    watch: SensorWatchModel | None = None
    cold_start: ColdStart | None = None
    fingerprints: tuple[Fingerprint, ...] = ()
    prior: LearningPrior | None = None
    _default_recursion: Recursion = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check that the parts belong together and assemble the default's recursion.

        Raises
        ------
        ValueError
            If a part contradicts another; the message names it.
        """
        check_interval(self.interval)
        _check_parts(self)
        names = set(self.default)
        if len(names) == 1:
            recursion = self.candidates[names.pop()].recursion
        else:
            recursion = combine(
                [
                    self.candidates[name].recursion.channel(channel)
                    for channel, name in enumerate(self.default)
                ]
            )
        if self.bound is not None:
            recursion = BoundedRecursion(recursion, self.bound)
        object.__setattr__(self, '_default_recursion', recursion)

    def to_json(self) -> str:
        """Return the model as a JSON document; equal models give equal text."""
        return _write_document(self)

    @staticmethod
    def from_json(text: str) -> 'ThermalModel':
        """Return the model of a document that `to_json` returned.

        Raises
        ------
        ModelFileError
            If it is no usable model; the message says where and why.
        """
        fields = _read_document(text)
        try:
            model = ThermalModel(**fields)
            _check_output(model)
        except ValueError as error:
            raise ModelFileError(f'model file: {error}') from error
        return model

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the model file's text, 64 hexadecimal digits."""
        return text_hash(self.to_json())

    @property
    def held_out_rms(self) -> Array:
        """Root mean square that the default left on held-out samples, (c,) [m]."""
        return np.array(
            [
                self.candidates[used].held_out_rms[number]
                for number, used in enumerate(self.default)
            ]
        )

    @property
    def uncompensated(self) -> tuple[str, ...]:
        """Channels that the default leaves as they are: no model improved them beyond chance."""
        pairs = zip(self.channel, self.default, strict=True)
        return tuple(name for name, used in pairs if used == UNCOMPENSATED)

    @property
    def losing(self) -> dict[str, tuple[float, float]]:
        """Channels that are worse with the default than without, on held-out samples.

        Their residual with it and without [m].  Only a model that was named for all channels
        can be so; files of earlier versions cannot tell.
        """
        bare = self.candidates.get(UNCOMPENSATED)
        if bare is None:
            return {}
        found = {}
        for number, (name, used) in enumerate(zip(self.channel, self.default, strict=True)):
            left = float(self.candidates[used].held_out_rms[number])
            none = float(bare.held_out_rms[number])
            if used != UNCOMPENSATED and left >= none:
                found[name] = (left, none)
        return found

    def warmth(self, reference: ArrayLike) -> dict[str, float]:
        """Return the inputs that are warmer than at a cold start, by how much [K].

        Parameters
        ----------
        reference : array_like, shape (p,)
            Temperature of each input at the start of a run [degC].
        """
        if self.cold_start is None:
            return {}
        warmth = self.cold_start.warmth(reference)
        pairs = zip(self.inputs, warmth.tolist(), strict=True)
        return {name: kelvin for name, kelvin in pairs if kelvin}

    @property
    def needs_speed(self) -> bool:
        """True if the default reads the spindle speed."""
        return SPINDLE_SPEED in self.drivers_of()

    def drivers_of(self, candidate: str | None = None) -> tuple[str, ...]:
        """Return the drivers that a candidate, or the default, reads; they come first."""
        names = self.default if candidate is None else (candidate,)
        return max((drivers_read(name, self.drivers) for name in names), key=len)

    @property
    def speed_max(self) -> float:
        """Largest spindle speed that it was trained on [rad/s]; infinite if it reads none."""
        if not self.needs_speed or not len(self.domain.drive):
            return np.inf
        return float(driven_speed(self.domain.drive[0]))

    @property
    def drives_max(self) -> dict[str, float]:
        """Largest of each drive that the default reads, beside the speed, in its training."""
        read = zip(self.drivers_of(), self.domain.drive.tolist(), strict=False)
        return {name: largest for name, largest in read if name != SPINDLE_SPEED}

    def drive(
        self,
        spindle_speed: float,
        drives: Mapping[str, float] = MappingProxyType({}),
        candidate: str | None = None,
    ) -> Array:
        """Return what stands behind the rises in a sample, shape (d,) [-].

        Parameters
        ----------
        spindle_speed : float
            Spindle speed [rad/s]; not looked at unless it is needed.
        drives : mapping of str to float
            What else the control tells, see `ThermalRun`; likewise.
        candidate : str, optional
            Candidate that is stepped; the default if absent.
        """
        found = np.zeros(len(self.drivers))
        for number, name in enumerate(self.drivers_of(candidate)):
            is_speed = name == SPINDLE_SPEED
            found[number] = speed_drive(np.array(spindle_speed)) if is_speed else drives[name]
        return found

    def drives(self, run: ThermalRun) -> Array:
        """Return what stands behind the rises of a run, shape (n, d) [-]; zeros if unknown."""
        found = np.zeros((len(run.time), len(self.drivers)))
        for column, name in zip(found.T, self.drivers, strict=True):
            if driver_known(run, name):
                column[:] = drive_of(run, (name,))[:, 0]
        return found

    def candidates_on(self, run: ThermalRun) -> tuple[str, ...]:
        """Return the candidates that find all they read in a run."""
        return tuple(
            name
            for name in self.candidates
            if all(driver_known(run, driver) for driver in self.drivers_of(name))
        )

    def check_stream(self, sensors: Sequence[str], interval: float) -> None:
        """Refuse a stream that the model was not made for.

        Parameters
        ----------
        sensors : sequence of str
            Sensors that the stream carries, in any order.
        interval : float
            Its sampling interval [s].

        Raises
        ------
        ModelMismatchError
            If inputs are missing or the interval differs by more than 10 %; the message spells
            out the difference.
        """
        missing = [name for name in self.inputs if name not in sensors]
        if missing:
            raise ModelMismatchError(
                f'sensors: expected the inputs {first_names(self.inputs)} of the model, but found '
                f'no {first_names(missing)}; the stream has {first_names(sensors)}'
            )
        if not abs(interval - self.interval) <= JITTER_MAX * self.interval:
            raise ModelMismatchError(
                f'interval: expected {self.interval:g} s as the model was trained with, but '
                f'found {interval:g} s; average the stream, or convert the model with '
                'with_interval'
            )

    def recursion(self, candidate: str | None = None) -> Recursion:
        """Return the recursion of a candidate, or of the default.

        Raises
        ------
        ValueError
            If the model holds no such candidate.
        """
        if candidate is None:
            return self._default_recursion
        if candidate not in self.candidates:
            why = self.omitted.get(candidate)
            raise ValueError(
                f'candidate: expected one of {", ".join(self.candidates)}, but found '
                f'{candidate!r}' + (f', which was left out: {why}' if why else '')
            )
        return self.candidates[candidate].recursion

    def start(self, candidate: str | None = None) -> Stream:
        """Begin a run, sample by sample.

        Parameters
        ----------
        candidate : str, optional
            Candidate to run; the default of each channel if absent.

        Returns
        -------
        Stream
            Its `step` takes the rises (p,) [K], with `drive` behind them, and returns the
            thermal errors (c,) [m]; its `state` is a flat array that a checkpoint may keep.
        """
        return Stream(self.recursion(candidate))

    def predict(self, source: ThermalRun | ArrayLike, candidate: str | None = None) -> Array:
        """Return the thermal error of a whole run.

        Parameters
        ----------
        source : ThermalRun or array_like, shape (n, p + d)
            A run that carries the inputs at the model's interval, or the rises of the inputs
            [K] and the drivers behind them, from the start of the run.
        candidate : str, optional
            Candidate to run; the default of each channel if absent.

        Returns
        -------
        ndarray, shape (n, c)
            Thermal error [m]; infinite or NaN where a candidate has diverged.

        Raises
        ------
        ModelMismatchError
            If the run lacks inputs or has another interval, or the rises have another width.
        ThermalDataError
            If the run lacks a spindle speed that the default, or the candidate, reads.
        ValueError
            If a rise is NaN: a failed sensor needs its substitute first.
        """
        recursion = self.recursion(candidate)
        if candidate is not None and isinstance(source, ThermalRun):
            drive_of(source, self.drivers_of(candidate))  # refuses a run without one of them
        return recursion.run(self.rises(source))

    def rises(self, source: ThermalRun | ArrayLike) -> Array:
        """Return the samples of a run, shape (n, p + d), checked as `predict` says.

        Rises [K] come first, then the drivers [-]; zeros of one that the run does not have in
        every sample and the default does not need.
        """
        width = len(self.inputs) + len(self.drivers)
        if isinstance(source, ThermalRun):
            self.check_stream(source.sensor, source.interval)
            drive_of(source, self.drivers_of())  # refuses a run without one of them
            drive = self.drives(source)
            rise = np.hstack([source.rise()[:, source.columns(self.inputs)], drive])
        else:
            rise = np.asarray(source, dtype=np.float64)
            if rise.ndim != 2 or rise.shape[1] != width:
                raise ModelMismatchError(
                    f'rise: expected {width} columns ({", ".join(self.inputs + self.drivers)}), '
                    f'but found shape {rise.shape}'
                )
        bad = np.argwhere(~np.isfinite(rise))
        if len(bad):
            row, column = bad[0]
            raise ValueError(
                f'rise: expected finite values, but found {rise[row, column]} of input '
                f'{(self.inputs + self.drivers)[column]!r} at sample {row}; put a substitute in '
                'its place'
            )
        return rise

    def distance(self, rise: ArrayLike) -> Array:
        """Return the distance of samples (..., p + d) from the training, shape (...) [-].

        It is in units of the domain's limit: up to 1 a sample is in the domain.  A driver counts
        only where the default reads it, so that a run and a stream give the same.
        """
        samples = np.asarray(rise, dtype=np.float64)
        samples = samples[..., : len(self.inputs) + len(self.drivers_of())]
        return self.domain.distance(samples)

    def in_domain(self, rise: ArrayLike) -> NDArray[np.bool_]:
        """Return whether samples (..., p + d) lie where the model was trained, shape (...)."""
        return np.asarray(self.distance(rise) <= 1.0)

    def standard_deviation(self, rise: ArrayLike) -> Array:
        """Return the standard deviation of the prediction at samples (..., p + d).

        Returns
        -------
        ndarray, shape (..., c)
            That of the held-out residual, wider with the distance from the training [m]; see
            `PredictionBand`.
        """
        samples = np.asarray(rise, dtype=np.float64)
        return self.band.at(self.distance(samples))

    def learner(self) -> Learner:
        """Return a learner that begins with what calibration runs taught, or with nothing.

        Raises
        ------
        ValueError
            If there are more inputs than can be learnt from.
        """
        if self.prior is not None:
            return self.prior.learner(self.channel)
        screws = screws_of(self.channel)
        return Learner(Basis(len(self.inputs), True, self.interval, screws=screws), self.channel)

    def with_interval(self, interval: float) -> 'ThermalModel':
        """Return the model for another sampling interval [s], with the same time constants.

        Raises
        ------
        ValueError
            If `interval` is not positive, or the default has no meaning at another interval;
            other candidates without one are left out.
        """
        check_interval(interval)
        ratio = interval / self.interval
        candidates, omitted = {}, dict(self.omitted)
        for name, item in self.candidates.items():
            try:
                recursion = item.recursion.with_interval(ratio)
            except ValueError as error:
                if name in self.default:
                    raise ValueError(f'candidate {name!r}: {error}') from error
                omitted[name] = str(error)
            else:
                candidates[name] = replace(item, recursion=recursion)
        prior = None if self.prior is None else self.prior.with_interval(interval)
        return replace(
            self, interval=interval, candidates=candidates, omitted=omitted, prior=prior
        )


def _check_parts(model: 'ThermalModel') -> None:
    """Refuse parts that contradict each other.

    Raises
    ------
    ValueError
        The message names the part.
    """
    inputs, channels = len(model.inputs), len(model.channel)
    if not inputs or len(set(model.inputs)) != inputs:
        raise ValueError(f'inputs: expected each sensor once, but found {model.inputs}')
    if not channels or len(set(model.channel)) != channels:
        raise ValueError(f'channel: expected each channel once, but found {model.channel}')
    for name, found in (
        ('axis', len(model.axis)),
        ('default', len(model.default)),
        ('residual_deviation', len(model.band.deviation)),
    ):
        if found != channels:
            raise ValueError(f'{name}: expected one per channel ({channels}), but found {found}')
    if model.selection.chosen != model.inputs:
        raise ValueError(
            f'selection: expected the inputs {", ".join(model.inputs)} as chosen sensors, but '
            f'found {", ".join(model.selection.chosen)}'
        )
    drives = model.drivers[model.drivers[:1] == (SPINDLE_SPEED,) :]
    if len(set(drives)) < len(drives) or not all(map(DRIVE_NAME.fullmatch, drives)):
        raise ValueError(
            f'drivers: expected {SPINDLE_SPEED} before {DRIVE_NAMES}, each once, but found '
            f'{", ".join(model.drivers)}'
        )
    if model.domain.drive.shape != (len(model.drivers),):
        raise ValueError(
            f'domain: expected {len(model.drivers)} drivers, but found {len(model.domain.drive)}'
        )
    if model.watch is not None and model.watch.input != model.inputs:
        raise ValueError(
            f'watch: expected the inputs {", ".join(model.inputs)}, but found '
            f'{", ".join(model.watch.input)}'
        )
    if model.cold_start is not None and model.cold_start.pattern.shape != (inputs,):
        raise ValueError(
            f'cold_start: expected {inputs} inputs, but found {model.cold_start.pattern.shape}'
        )
    if model.prior is not None and len(model.prior.known) != channels:
        raise ValueError(
            f'prior: expected one of each channel ({channels}), but found {len(model.prior.known)}'
        )
    if model.domain.mean.shape != (inputs,):
        raise ValueError(f'domain: expected {inputs} inputs, but found {model.domain.mean.shape}')
    for name, candidate in model.candidates.items():
        shape = (candidate.recursion.channels, candidate.recursion.inputs)
        width = inputs + len(model.drivers)
        if shape != (channels, width):
            raise ValueError(
                f'candidate {name!r}: expected {channels} channels and {width} inputs, but '
                f'found {shape[0]} and {shape[1]}'
            )
    for name in model.default:
        if name not in model.candidates:
            raise ValueError(
                f'default: expected one of {", ".join(model.candidates)}, but found {name!r}'
            )
        if model.candidates[name].problems:
            raise ValueError(
                f'default: expected a reliable candidate, but found {name!r}: '
                f'{"; ".join(model.candidates[name].problems)}'
            )


def _check_output(model: 'ThermalModel') -> None:
    """Refuse numbers that are finite one by one, but of which no finite prediction follows.

    Raises
    ------
    ValueError
        If an error or a deviation amid the training is not finite.
    """
    sample = np.concatenate([model.domain.mean, model.domain.drive])
    stream = model.start()
    with np.errstate(all='ignore'):
        values = [stream.step(sample) for _ in range(3)]
        deviation = model.standard_deviation(sample)
    if not (np.isfinite(values).all() and np.isfinite(deviation).all()):
        raise ValueError(
            f'default: expected finite errors and deviations amid the training, but found '
            f'{values[-1]} and {deviation}; train the model anew'
        )


def load_model(source: str | os.PathLike[str]) -> ThermalModel:
    """Return the model of a file, or of a text that `ThermalModel.to_json` returned.

    Parameters
    ----------
    source : str or path
        Path of a model file; a text that begins with a brace is taken for the document itself.

    Raises
    ------
    ModelFileError
        If the file cannot be read or is no usable model.

    Notes
    -----
    This is the one place where the core reads a file: a model is what users load by path.
    """
    if isinstance(source, str) and source.lstrip().startswith('{'):
        return ThermalModel.from_json(source)
    path = Path(source)
    if path.is_dir():
        raise ModelFileError(
            f'{path}: expected a model file, as `fuzzycnc train` writes it, but found a folder'
        )
    try:
        with path.open('rb') as file:
            data = file.read(4 * SIZE_MAX + 1)  # characters of four bytes each
    except OSError as error:
        raise ModelFileError(f'{path}: expected a readable model file, but: {error}') from error
    try:
        return ThermalModel.from_json(decoded(data))
    except ValueError as error:
        raise ModelFileError(f'{path}: {error}') from error


_SCHEMA_VERSION = 3
"""Version of the layout that is written."""

READABLE_VERSIONS = (1, 2, 3)
"""Versions that are read.

The first knew neither drivers nor bounds; the second had an ellipsoid in all directions as its
domain, one growth of the band for all models, and neither cold starts nor fingerprints."""

GROWTH_BEFORE = 2.0
"""Growth of the band in files of earlier versions [-]."""

NOT_KEPT = 'a model that is only compared; `fuzzycnc compare` fits it'
"""Why a model file leaves a candidate out."""

UNITS = {'time': 's', 'rise': 'K', 'displacement': 'm'}
"""Units of the numbers in a model file."""

DEVIATION_MAX = 1.0
"""Largest standard deviation of a held-out residual [m]."""

GROWTH_MAX = 100.0
"""Largest growth of a band [-]; see `PredictionBand`."""

GAIN_MAX = 1e4
"""Largest rise of a sensor in rises of the one that stands in for it [-]."""

SCORE_ROUNDING = 1e-6
"""Excess over their range that scores and correlations have from rounding [-]."""

SIZE_MAX = 16 * 1024 * 1024
"""Largest model file that is read [characters]; 76 inputs with all candidates take 3.6 million."""


def _write_document(model: 'ThermalModel') -> str:
    """Return the model as a JSON document; equal models give equal text."""
    for name in model.default:
        if name in COMPARED_ONLY:
            raise ValueError(
                f'default: expected a model that runs on machines, but found {name!r}, which is '
                'only compared'
            )
    kept = {name: item for name, item in model.candidates.items() if name not in COMPARED_ONLY}
    left_out = dict.fromkeys(model.candidates.keys() - kept.keys(), NOT_KEPT)
    document = {
        'schema': THERMAL_MODEL,
        'schema_version': _SCHEMA_VERSION,
        'units': UNITS,
        'inputs': list(model.inputs),
        'drivers': list(model.drivers),
        'interval': model.interval,
        'reference': model.reference,
        'channels': [
            {
                'name': name,
                'axis': axis,
                'default': default,
                'residual_deviation': deviation,
                'bound': bound,
            }
            for name, axis, default, deviation, bound in zip(
                model.channel,
                model.axis,
                model.default,
                model.band.deviation.tolist(),
                [None] * len(model.channel) if model.bound is None else model.bound.tolist(),
                strict=True,
            )
        ],
        'training_runs': list(model.runs),
        'candidates': {name: _candidate(item) for name, item in kept.items()},
        'omitted': {**model.omitted, **dict(sorted(left_out.items()))},
        'selection': _selection(model.selection),
        'band_growth': model.band.growth,
        'domain': {
            'mean': model.domain.mean.tolist(),
            'directions': model.domain.directions.tolist(),
            'reach': model.domain.reach.tolist(),
            'thickness': model.domain.thickness if isfinite(model.domain.thickness) else None,
            'drive': model.domain.drive.tolist(),
        },
        'cold_start': None if model.cold_start is None else model.cold_start.document(),
        'fingerprints': [item.document() for item in model.fingerprints],
        'watch': None if model.watch is None else model.watch.document(),
    }
    if model.prior is not None:  # else a file of an earlier version keeps its text
        document['prior'] = model.prior.document()
    return json.dumps(document, allow_nan=False) + '\n'


def _read_document(text: str) -> dict[str, Any]:
    """Return the fields of the `ThermalModel` that a JSON document describes.

    Parameters
    ----------
    text : str
        Text that `_write_document` returned.

    Returns
    -------
    dict
        Arguments of `ThermalModel`.

    Raises
    ------
    ModelFileError
        If it is too large, no JSON, of another schema or version, or holds a value of
        another type or shape.
    """
    root = parse_document(text, 'model file', SIZE_MAX)
    root.check_kind('schema', THERMAL_MODEL)
    version = root.get('schema_version').value
    if type(version) is not int or version not in READABLE_VERSIONS:
        raise ModelFileError(
            f'model file: expected schema version {_SCHEMA_VERSION}, but found '
            f'{root.get("schema_version").value!r}; train the model anew with this version'
        )
    if root.get('units').value != UNITS:
        root.get('units').refuse(f'the units {UNITS}')
    try:
        return _fields(root)
    except ModelFileError:
        raise
    except RecursionError as error:
        raise ModelFileError('model file: expected recursions that are not nested') from error
    except ValueError as error:
        raise ModelFileError(f'model file: {error}') from error


def _held_out(values: Array) -> list[float | None] | None:
    """Return figures, null for infinity; null for all of a candidate that was not judged."""
    if np.isnan(values).all():
        return None
    return [value if isfinite(value) else None for value in values.tolist()]


def _candidate(candidate: Candidate) -> dict[str, Any]:
    return {
        'settings': list(candidate.settings),
        'problems': list(candidate.problems),
        'held_out_rms': _held_out(candidate.held_out_rms),
        'held_out_max': _held_out(candidate.held_out_max),
        'recursion': write_recursion(candidate.recursion),
    }


def _selection(selection: InputSelection) -> dict[str, Any]:
    return {
        'method': selection.method,
        'partition_coefficient': selection.partition_coefficient,
        'xie_beni': selection.xie_beni if isfinite(selection.xie_beni) else None,
        'dropped': list(selection.dropped),
        'calibration': list(selection.calibration),
        'clusters': [
            {
                'member': list(cluster.member),
                'score': list(cluster.score),
                'chosen': cluster.chosen,
                'substitute': list(cluster.substitute),
                'gain': list(cluster.gain),
                'correlation': list(cluster.correlation),
            }
            for cluster in selection.clusters
        ],
    }


def _fields(root: Node) -> dict[str, Any]:
    found = root.get('candidates').items()
    kept = {name: node for name, node in found.items() if name not in COMPARED_ONLY}
    left_out = {name: NOT_KEPT for name in found if name not in kept}
    inputs = root.get('inputs').texts()
    channels = root.get('channels').list()
    version = root.get('schema_version').value
    first = version == 1
    drivers = () if first else root.get('drivers').texts()
    width = len(inputs) + len(drivers)
    return dict(
        inputs=inputs,
        interval=root.get('interval').number(INTERVAL_MIN, INTERVAL_MAX),
        channel=tuple(node.get('name').text() for node in channels),
        axis=tuple(node.get('axis').text() for node in channels),
        runs=root.get('training_runs').texts(),
        candidates={name: _read_candidate(name, node, width) for name, node in kept.items()},
        default=tuple(_read_default(node.get('default')) for node in channels),
        selection=_read_selection(root.get('selection')),
        domain=(_read_ellipsoid if version < 3 else _read_domain)(
            root.get('domain'), len(inputs), first
        ),
        band=PredictionBand(
            np.array(
                [node.get('residual_deviation').number(0.0, DEVIATION_MAX) for node in channels]
            ),
            GROWTH_BEFORE if version < 3 else root.get('band_growth').number(0.0, GROWTH_MAX),
        ),
        drivers=drivers,
        bound=_read_bound(channels, first),
        omitted=left_out
        | {name: node.text() for name, node in root.get('omitted').items().items()},
        reference=root.get('reference').text(),
        watch=None if first else _read_watch(root.get('watch')),
        cold_start=None if version < 3 else _read_start(root.get('cold_start')),
        fingerprints=()
        if version < 3
        else tuple(Fingerprint.read(node) for node in root.get('fingerprints').list()),
        prior=_read_prior(root, len(inputs)),
    )


def _read_prior(root: Node, inputs: int) -> LearningPrior | None:
    """Return the prior of a document, which files of earlier versions do not have."""
    if (node := root.items().get('prior')) is None:
        return None
    return LearningPrior.read(node, inputs, root.get('interval').number(INTERVAL_MIN))


def _read_domain(node: Node, inputs: int, first: bool) -> Domain:
    thickness = node.get('thickness')
    with node.named():
        return Domain(
            mean=node.get('mean').vector(),
            directions=node.get('directions').matrix(inputs),
            reach=node.get('reach').vector(),
            thickness=inf if thickness.value is None else thickness.number(),
            drive=np.empty(0) if first else node.get('drive').vector(),
        )


def _read_ellipsoid(node: Node, inputs: int, first: bool) -> Domain:
    """Return the domain of an earlier version, which has the border in every direction."""
    inverse = node.get('inverse_covariance').matrix(inputs, -NUMBER_MAX, NUMBER_MAX)
    if inverse.shape != (inputs, inputs):
        node.get('inverse_covariance').refuse(f'{inputs} rows')
    curvature, directions = portable.eigh(0.5 * (inverse + inverse.T))
    if not (curvature > 0.0).all():
        node.get('inverse_covariance').refuse('a positive definite matrix')
    limit = node.get('limit').number(LENGTH_MIN, NUMBER_MAX)
    with node.named():
        return Domain(
            mean=node.get('mean').vector(),
            directions=directions.T,
            reach=limit / np.sqrt(curvature),
            thickness=inf,
            drive=np.empty(0) if first else node.get('drive').vector(),
        )


def _read_start(node: Node) -> ColdStart | None:
    return None if node.value is None else ColdStart.read(node)


def _read_watch(node: Node) -> SensorWatchModel | None:
    return None if node.value is None else SensorWatchModel.read(node)


def _read_bound(channels: Sequence[Node], first: bool) -> Array | None:
    nodes = [] if first else [node.get('bound') for node in channels]
    if all(node.value is None for node in nodes):
        return None
    return np.array([node.number(BOUND_MIN, BOUND_MAX) for node in nodes])


def _read_default(node: Node) -> str:
    if (name := node.text()) in COMPARED_ONLY:
        node.refuse(f'a model that runs on machines, since {name} is only compared; train anew')
    return name


def _read_candidate(name: str, node: Node, inputs: int) -> Candidate:
    if name not in (UNCOMPENSATED, *CANDIDATES):
        node.refuse(f'one of {", ".join(CANDIDATES)} and not {name!r}')
    recursion = read_recursion(node.get('recursion'), inputs)
    unknown = np.full(recursion.channels, np.nan)
    scores = {
        field: unknown if node.get(field).value is None else node.get(field).sizes_or_infinite()
        for field in ('held_out_rms', 'held_out_max')
    }
    for score, values in scores.items():
        if len(values) != recursion.channels:
            node.get(score).refuse(f'{recursion.channels} numbers')
    return Candidate(
        name=name,
        settings=_read_settings(node.get('settings'), recursion.channels),
        recursion=recursion,
        problems=node.get('problems').texts(),
        held_out_rms=scores['held_out_rms'],
        held_out_max=scores['held_out_max'],
    )


def _read_settings(node: Node, channels: int) -> tuple[Settings, ...]:
    """Return the settings of each channel; earlier versions have one for all."""
    if not isinstance(node.value, list):
        return (_read_setting(node),) * channels
    settings = tuple(_read_setting(item) for item in node.list())
    if len(settings) != channels:
        node.refuse(f'settings of {channels} channels')
    return settings


def _read_setting(node: Node) -> Settings:
    settings: Settings = {}
    for name, item in node.items().items():
        if isinstance(item.value, list):
            settings[name] = item.numbers()
        else:
            settings[name] = item.text() if isinstance(item.value, str) else item.number()
    return settings


def _read_selection(node: Node) -> InputSelection:
    index = node.get('xie_beni')
    return InputSelection(
        method=node.get('method').text(),
        clusters=tuple(_read_cluster(item) for item in node.get('clusters').list()),
        partition_coefficient=node.get('partition_coefficient').number(0.0, 1.0 + SCORE_ROUNDING),
        xie_beni=float('nan') if index.value is None else index.number(0.0),
        dropped=node.get('dropped').texts(),
        calibration=node.get('calibration').texts(),
    )


def _read_cluster(node: Node) -> InputCluster:
    cluster = InputCluster(
        member=node.get('member').texts(),
        score=node.get('score').numbers(-SCORE_ROUNDING, 1.0 + SCORE_ROUNDING),
        chosen=node.get('chosen').text(),
        substitute=node.get('substitute').texts(),
        gain=node.get('gain').numbers(-GAIN_MAX, GAIN_MAX),
        correlation=node.get('correlation').numbers(-1.0 - SCORE_ROUNDING, 1.0 + SCORE_ROUNDING),
    )
    lengths: Mapping[str, tuple[int, int]] = {
        'score': (len(cluster.score), len(cluster.member)),
        'gain': (len(cluster.gain), len(cluster.substitute)),
        'correlation': (len(cluster.correlation), len(cluster.substitute)),
    }
    for part, (found, expected) in lengths.items():
        if found != expected:
            node.get(part).refuse(f'{expected} numbers')
    return cluster
