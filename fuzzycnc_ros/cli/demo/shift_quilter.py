# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The second machine of the scenario `shift`: it quilts a pattern on a foam sheet."""

from pathlib import Path

from fuzzycnc_ros.graph.bring_up import NodeSpec

QUILT = 'quilt'
FOAM_SEED = 1000
"""Seed of the samples that the foam model is trained on, before that of the run is added; far from
those that the method's settings were chosen on."""
PATTERN_BAGS = {'before': 'before', 'trained': 'trained', 'after': 'quilt'}
"""Bag of each run of the quilter: as drawn, which gives the gains of the model, by the model as
trained, and compensated.  As with the mill, what is judged is run over DDS, and what it is
compared with in one process."""


def trained_foam(seed: int) -> str:
    """Return the text of a foam model, trained on 265 samples of sheets that scatter."""
    from fuzzycnc_ros.core.deformation.model import write_model
    from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
    from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples

    return write_model(TSFuzzyNetwork().fit(*foam_samples(FOAM_SEED + seed)).model_)


def first_piece(out: Path, foam: str, seed: int) -> str:
    """Stitch a piece without compensation, as in a shop before a series; return the model for it.

    Friction differs from sheet to sheet, and a model knows only the mean of its samples.
    """
    from fuzzycnc_ros.core.deformation.model import read_model, write_model
    from fuzzycnc_ros.studies.soft.foam_learning import fit_gains
    from fuzzycnc_ros.studies.soft.foam_records import read_samples

    bag = out / PATTERN_BAGS['before']
    pattern_alone(bag, '', seed)
    adapted = write_model(fit_gains(read_model(foam), read_samples([bag])).model)
    (out / 'foam.json').write_text(adapted, encoding='utf-8')
    return adapted


def pattern_alone(path: Path, model: str, seed: int) -> None:
    """Stitch the pattern in this process, into a bag; without a model it is not compensated."""
    from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
    from fuzzycnc_ros.studies.published_bag import PublishedBag
    from fuzzycnc_ros.studies.soft.pattern import TRACK, run_patterns

    with PublishedBag(path, machine=QUILT) as bag:
        run_patterns(
            (TRACK,),
            model,
            machine=SimulatedMachineConfig(seed=seed, sheet_seed=seed),
            name=QUILT,
            sink=bag,
        )


def quilt_specs(model: str, seed: int) -> list[NodeSpec]:
    """Return the nodes of a quilter in the order of their turns, the machine last.

    `model` is the path of its model file; empty for no compensation.
    """
    from fuzzycnc_ros.studies.soft.pattern import STITCH_BLEND, TRACK

    managed = {'lockstep': True, 'autostart': True}
    return [
        NodeSpec('deformation_compensator', {**managed, 'model': model}),
        NodeSpec('feedrate_scheduler', {**managed, 'blend': STITCH_BLEND}),
        NodeSpec(
            'simulated_machine',
            {'duties': [''], 'patterns': [TRACK], 'seed': seed, 'sheet_seed': seed},
        ),
    ]
