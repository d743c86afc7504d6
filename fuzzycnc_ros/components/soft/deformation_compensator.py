# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Component `deformation_compensator`: a pattern in, the tool path that stitches it straight out.

The sheet must be known before the pattern comes: nothing is guessed, and nothing that is loaded
later sets off a path that was loaded before.  What the model was not trained for is not
compensated, and said.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.components.soft.compensated_paths import (
    PatternPrimitives,
    compensated_record,
    stitching_tool_path,
)
from fuzzycnc_ros.components.soft.stitch_patterns import (
    STITCHED,
    pattern_primitives,
    sheet_material,
)
from fuzzycnc_ros.core.config import param
from fuzzycnc_ros.core.deformation.compensation import (
    CompensationConfig,
    OffsetPath,
    StepFlag,
    compensate_path,
)
from fuzzycnc_ros.core.deformation.model import GAIN_MAX, GAIN_MIN, DeformationModel
from fuzzycnc_ros.core.deformation.offset_file import StitchOffsets, read_offsets
from fuzzycnc_ros.core.deformation.soft_model import SoftModel, compensated, read_soft_model
from fuzzycnc_ros.core.deformation.stitch_path import SheetMaterial, StitchPath
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.runtime import records
from fuzzycnc_ros.runtime.component import (
    LATCHED,
    Answer,
    Component,
    Emission,
    Health,
    Input,
    Level,
    Output,
)
from fuzzycnc_ros.runtime.enums import PrimitiveKind
from fuzzycnc_ros.runtime.records import Floats, Material, StitchPattern, ToolPath


@dataclass(frozen=True, kw_only=True)
class DeformationCompensatorConfig(CompensationConfig):
    """Parameters of `deformation_compensator`, beside those of the offsets themselves."""

    autostart: bool = param(
        False, '-', 'Configure and activate at start; otherwise a lifecycle manager does'
    )
    model: str = param(
        '',
        '-',
        'Model file made by fuzzycnc soft train, or offsets of one track by fuzzycnc soft learn; '
        'empty stitches without compensation',
        live=True,
    )
    offsets: str = param(
        '',
        '-',
        'File made by fuzzycnc soft learn: offsets of one track, used for it instead of the '
        "model's; empty for none",
        live=True,
    )
    gain: tuple[float, ...] = param(
        (1.0, 1.0), '-', "Factors of the model's X and Y", low=GAIN_MIN, high=GAIN_MAX, live=True
    )
    on_refused: str = param(
        'zero',
        '-',
        'Pattern with refused steps: zero = stitched, these steps uncompensated; stop = not '
        'stitched',
        choices=('zero', 'stop'),
        live=True,
    )
    corner_angle: float = param(
        0.0873,
        'rad',
        'Change of direction between two primitives beyond which the tool stops there',
        low=0.0,
        high=3.1416,
    )

    def __post_init__(self) -> None:
        """Check every field.

        Raises
        ------
        ValueError
            If one is out of its bounds, or the gain is not one of X and Y.
        """
        super().__post_init__()
        if len(self.gain) != 2:
            raise ValueError(f'gain: expected two factors, X and Y, but found {len(self.gain)}')


_LIMITED = (
    StepFlag.RATE_LIMITED
    | StepFlag.OFFSET_LIMITED
    | StepFlag.PROGRESS_LIMITED
    | StepFlag.CLIPPED
    | StepFlag.NO_PROGRESS
)


ContentT = TypeVar('ContentT')


@dataclass(frozen=True)
class OffsetSource(Generic[ContentT]):
    """A file that offsets come from: its content, text and hash."""

    content: ContentT
    text: str
    hash: str


def _source(read: Callable[[str], ContentT], text: str) -> OffsetSource[ContentT] | None:
    """Read the text of a file; none if it is empty."""
    return OffsetSource(read(text), text, text_hash(text)) if text else None


class DeformationCompensator(Component[DeformationCompensatorConfig]):
    """Shift the stitches of patterns so that the relaxed sheet shows them where they belong."""

    NAME = 'deformation_compensator'
    SUMMARY = (
        'Shifts the stitches of a pattern on soft material, so that the relaxed sheet shows the '
        'nominal one. Managed lifecycle.'
    )
    CONFIG = DeformationCompensatorConfig
    INPUTS = (
        Input('material', Material, LATCHED),
        Input('stitch_pattern', StitchPattern, LATCHED, driving=True),
    )
    OUTPUTS = (
        Output('compensated_path', records.CompensatedPath, LATCHED),
        Output('tool_path', ToolPath, LATCHED),
    )
    MANAGED = True

    def __init__(self, config: DeformationCompensatorConfig | None = None) -> None:
        super().__init__(config)
        self._active = False
        self._model: OffsetSource[SoftModel] | None = None
        self._offsets: OffsetSource[StitchOffsets] | None = None
        self._handled = (-1, '')  # stamp and name of the newest pattern that was taken
        self._level, self._text = Level.OK, 'inactive'
        self._values: dict[str, str] = {}
        self._unused = ''  # why learnt offsets were not used

    @property
    def model_text(self) -> str:
        """Text of the model file in use."""
        return '' if self._model is None else self._model.text

    def on_stitch_pattern(self, pattern: StitchPattern) -> Iterator[Emission]:
        """Compensate a pattern and publish the path, if the component is active."""
        if not self._active:
            self._say(Level.WARN, f'{pattern.path_id} dropped: inactive; activate, send it again')
            return
        if (pattern.stamp, pattern.path_id) == self._handled:
            return  # a latched topic says it again
        self._handled = (pattern.stamp, pattern.path_id)
        self._values, self._unused = {}, ''
        try:
            yield from self._compensate(pattern)
        except ValueError as error:
            self._say(Level.ERROR, f'{pattern.path_id or "pattern"} refused: {error}')

    def renewed(self, step: int) -> 'tuple[DeformationCompensator, list[Emission]]':
        """Go on: nothing rests on times but which pattern was taken last."""
        self._handled = (-1, '')
        return self, []

    def on_request(self, name: str, arguments: Mapping[str, Any], stamp: int) -> Answer:
        """`activate`, `deactivate`, `use_model` and `use_offsets`, by the text of their files."""
        if name in ('activate', 'deactivate'):
            return self._switch(name == 'activate')
        if name not in ('use_model', 'use_offsets'):
            return super().on_request(name, arguments, stamp)
        what = name.removeprefix('use_')
        text = str(arguments[what])
        source: OffsetSource[Any] | None = None
        try:
            if what == 'model':
                source = self._model = _source(read_soft_model, text)
            else:
                source = self._offsets = _source(read_offsets, text)
        except ValueError as error:
            return Answer(False, str(error))
        said = f'using the {what} {source.hash[:8]}' if source else f'using no {what}'
        return Answer(True, f'{said}, from the next pattern on')

    def health(self) -> list[Health]:
        """Report the newest pattern, what was refused of it and limited, and by which model."""
        model = 'none' if self._model is None else self._model.hash[:8]
        items = [Health('state', self._level, self._text, {'model': model, **self._values})]
        if self._unused:
            items.append(Health('offsets', Level.WARN, f'learnt offsets not used: {self._unused}'))
        return items

    def _switch(self, active: bool) -> Answer:
        state = 'active' if active else 'inactive'
        if self._active is active:
            return Answer(False, f'already {state}' if active else 'not active')
        self._active = active
        self._say(Level.OK, 'waiting for a pattern' if active else 'inactive')
        self._values, self._unused = {}, ''
        return Answer(True, state)

    def _compensate(self, pattern: StitchPattern) -> Iterator[Emission]:
        """Yield the compensated path of a pattern and its tool path."""
        material = self._sheet(pattern)
        numbers, primitives = zip(*pattern_primitives(pattern), strict=True)
        course = PatternPrimitives(numbers, primitives)
        runs = course.runs()
        for _, path in runs:
            material.check(path)
        points = np.concatenate([path.points for _, path in runs])
        learnt = self._learnt(pattern, material, points)
        source: OffsetSource[Any] | None = self._model if learnt is None else learnt
        found = self._shifted(course, runs, material, learnt)
        self._report(pattern.path_id, found, course, learnt is not None)
        if found.refused.any() and self._config.on_refused == 'stop':
            self._say(Level.ERROR, f'{self._text}; not stitched, as on_refused says')
            return
        record = compensated_record(
            pattern, course, material, found, '' if source is None else source.hash
        )
        tool_path = stitching_tool_path(
            pattern, course, found.commanded, self._config.corner_angle
        )
        yield Emission('compensated_path', record)
        yield Emission('tool_path', tool_path)

    def _sheet(self, pattern: StitchPattern) -> SheetMaterial:
        """Return the sheet that a pattern is for.

        Raises
        ------
        ValueError
            If it is unknown or malformed, or lies in another frame than the pattern.
        """
        record = self._newest.get('material')
        if not isinstance(record, Material):
            raise ValueError(
                'no material: expected the sheet to be known before the pattern; publish '
                'material, then send the pattern again'
            )
        frame = self.frame('workpiece')
        for name, found in (('material', record.frame_id), ('pattern', pattern.frame_id)):
            if found != frame:
                raise ValueError(f'frame_id of {name}: expected {frame} but found {found!r}')
        try:
            return sheet_material(record)
        except ValueError as error:
            raise ValueError(f'material: {error}') from error

    def _learnt(
        self, pattern: StitchPattern, material: SheetMaterial, points: Floats
    ) -> OffsetSource[Any] | None:
        """Return the learnt offsets for a pattern; None if there are none for it."""
        for source in (self._offsets, self._model):
            if source is None or not isinstance(source.content, StitchOffsets):
                continue
            self._unused = source.content.mismatch(
                pattern.path_id, material.name, material.thickness, points
            )
            if not self._unused:
                return source
        return None

    def _shifted(
        self,
        course: PatternPrimitives,
        runs: Sequence[tuple[NDArray[np.intp], StitchPath]],
        material: SheetMaterial,
        learnt: OffsetSource[StitchOffsets] | None,
    ) -> OffsetPath:
        """Return a pattern with the offsets of its runs, each compensated by itself."""
        whole = OffsetPath.unchanged(course.points)
        own = None if learnt is None else learnt.content.of_runs([path.points for _, path in runs])
        for number, (at, path) in enumerate(runs):
            if own is None:
                found = self._with_model(path, material)
            else:
                found = compensated(path, material, own[number], self._config)
            whole.offset[at] = found.offset
            for name in ('compensation', 'support', 'flag'):
                getattr(whole, name)[at[1:] - 1] = getattr(found, name)
        rests = np.append(False, np.isin(course.kind, (PrimitiveKind.TRIM, PrimitiveKind.STOP)))
        rests[np.concatenate([at for at, _ in runs])] = False
        for point in np.flatnonzero(rests):  # the tool stays where it is
            whole.offset[point] = whole.offset[point - 1]
        return whole

    def _with_model(self, path: StitchPath, material: SheetMaterial) -> OffsetPath:
        """Return a path with the model's offsets; without a model all are 0."""
        if self._model is None or not isinstance(self._model.content, DeformationModel):
            return OffsetPath.unchanged(path.points)
        model, gain = self._model.content, np.array(self._config.gain)

        def predict(x: Floats) -> Floats:
            return np.asarray(gain * model.predict(x))

        return compensate_path(
            path, material, predict, config=self._config, gate=model, support=model.support
        )

    def _report(
        self, name: str, path: OffsetPath, course: PatternPrimitives, learnt: bool
    ) -> None:
        """Say what became of a pattern."""
        steps = int(np.isin(course.kind, STITCHED).sum())
        refused = int(path.refused.sum())
        limited = int((path.flag & int(_LIMITED) != 0).sum())
        clipped = int((path.flag & int(StepFlag.CLIPPED) != 0).sum())
        reach = 1e3 * float(np.hypot(*path.offset.T).max())
        self._values = {
            'pattern': name,
            'steps': str(steps),
            'refused [%]': f'{100.0 * refused / steps:.1f}',
            'limited [%]': f'{100.0 * limited / steps:.1f}',
            'cut at the edge [%]': f'{100.0 * clipped / steps:.1f}',
            'largest offset [mm]': f'{reach:.3f}',
        }
        if refused:
            self._say(
                Level.WARN,
                f'{name}: {refused} of {steps} steps are unlike the training and were refused',
            )
        elif learnt:
            self._say(Level.OK, f'{name}: learnt offsets')
        else:
            what = 'compensated'
            if self._model is None or isinstance(self._model.content, StitchOffsets):
                what = 'not compensated: no model'
            elif not self._model.content.corrects:
                what = 'not compensated: the model says that no correction is better'
            self._say(Level.OK, f'{name}: {what}')

    def _say(self, level: Level, text: str) -> None:
        self._level, self._text = level, text
