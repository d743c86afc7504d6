# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Gate, gain and file of a trained network."""

import json

import numpy as np
import pytest
from fuzzing.file_mutations import one_of_each, places_of_numbers
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzzycnc_ros.core.deformation.model import AxisGain, read_model, write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.document import ModelFileError
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples


@pytest.fixture(scope='module')
def data():
    return foam_samples(22)


@pytest.fixture(scope='module')
def model(data):
    return TSFuzzyNetwork(ridge=0.03).fit(data.x, data.s).model_


@pytest.fixture(scope='module')
def linear(data):
    lines = data.x[:, 2] == 2
    return TSFuzzyNetwork('sts', ridge=0.1).fit(data.x[lines], data.s[lines]).model_


@settings(deadline=None, max_examples=100)
@given(
    thickness=st.floats(1.0, 60.0),
    ratio=st.floats(0.601, 3.0),
    angle=st.floats(-30.0, 150.0),
    kind=st.sampled_from([1.0, 2.0]),
    step=st.floats(0.5, 10.0),
)
def test_a_foot_too_deep_for_its_sheet_is_always_refused(
    model, thickness, ratio, angle, kind, step
):
    assert not model.accepts([[angle, ratio * thickness, kind, step, thickness]])[0]


@settings(deadline=None, max_examples=100)
@given(
    row=st.integers(0, 264),
    angle=st.floats(60.00001, 179.99999),
    turns=st.integers(-3, 3),
)
def test_an_angle_outside_the_box_is_always_refused(data, model, row, angle, turns):
    x = data.x[row].copy()
    x[0] = angle + 180.0 * turns
    assert not model.accepts([x])[0]


def test_rounding_of_a_direction_is_let_pass(data, model):
    # The share without support is refused either way.
    moved = data.x + np.array([5e-7, 0.0, 0.0, 0.0, 0.0])
    assert np.array_equal(model.accepts(moved), model.accepts(data.x))
    assert model.accepts(data.x).mean() >= 0.985


def test_nothing_that_is_no_number_gets_through(data, model):
    for column in range(5):
        x = data.x[:3].copy()
        x[1, column] = np.nan
        assert not model.accepts(x)[1]
    assert not model.accepts([[30.0, 0.0, 2.0, 3.0, 0.0]])[0]
    # An average of arc and line lies in the box and is neither.
    assert not model.accepts([[30.0, 6.0, 1.5, 3.0, 15.0]])[0]


def test_clipped_rows_are_inside_the_box(data, model):
    wild = data.x * np.random.default_rng(0).uniform(0.2, 3.0, data.x.shape)
    wild[:, 2] = data.x[:, 2]
    assert model.gate.inside(model.clip(wild)).all()
    assert np.allclose(model.clip(data.x), data.x)


def test_gain_is_least_squares_with_a_prior():
    rng = np.random.default_rng(5)
    said = rng.normal(0, 3, (12, 2))
    needed = said * [1.3, 0.8] + rng.normal(0, 0.1, (12, 2))
    gain = AxisGain.unit(2)
    for pair in zip(said, needed, strict=True):
        gain = gain.updated(*pair)
    # Minimum of sum (needed - k said)^2 / 0.25 + (k - 1)^2 / 0.1.
    expected = ((said * needed).sum(axis=0) / 0.25 + 10.0) / ((said**2).sum(axis=0) / 0.25 + 10.0)
    assert gain.value == pytest.approx(expected, rel=1e-12)


def test_gain_stays_in_its_bounds_and_leads_back(data, model):
    wild = model.adapted(data.x, 9.0 * data.s)
    assert wild.gain.value.tolist() == [2.0, 2.0]
    assert np.allclose(wild.predict(data.x), 2.0 * model.predict(data.x))
    one, _ = wild.predict_one(data.x[7].tolist())
    assert one == pytest.approx(wild.predict(data.x[7:8])[0])
    assert np.array_equal(wild.stored().predict(data.x), model.predict(data.x))
    assert model.adapted(data.x, -data.s).gain.value.tolist() == [0.5, 0.5]


def test_gain_refuses_what_is_not_finite(data, model):
    with pytest.raises(ValueError, match='expected 2 finite predictions'):
        model.adapted(data.x[:1], [[np.nan, 1.0]])
    with pytest.raises(ValueError, match='expected shape'):
        model.adapted(data.x[:2], data.s[:1])


@pytest.mark.parametrize('name', ['model', 'linear'])
def test_a_written_model_is_read_as_it_was(data, request, name):
    model = request.getfixturevalue(name)
    lines = data.x[data.x[:, 2] == 2]
    again = read_model(write_model(model))
    assert write_model(again) == write_model(model)
    # The last bit of a product depends on where its arrays lie in memory.
    np.testing.assert_allclose(again.predict(lines), model.predict(lines), rtol=1e-12, atol=1e-12)
    assert np.array_equal(again.accepts(lines), model.accepts(lines))


def changed(document, path, value):
    """Return the document with one value replaced."""
    copy = json.loads(json.dumps(document))
    at = copy
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return json.dumps(copy)


@pytest.mark.parametrize(
    ('path', 'value', 'message'),
    [
        (('schema',), 'fuzzycnc/thermal-model', 'but found a thermal model'),
        (('schema_version',), 3, 'expected schema version 1 or 2'),
        (('schema_version',), 2, 'expected none in version 2'),
        (('features',), 'all', 'expected one of load'),
        (('inputs',), ['sin', 'cos'], 'in this order'),
        (('inputs',), ['cos'], 'expected 1 numbers'),
        (('rules', 'center', 0), [1.0], 'expected 6 numbers'),
        (('rules', 'width', 0, 0), 0.0, 'expected a number from 1e-09'),
        (('rules', 'decay'), -1.0, 'expected a number from 1e-09'),
        (('rules', 'power'), 3, 'expected 1 or 2'),
        (('inner', 0), [[1.0] * 7], 'expected 2 matrices of equal size'),
        (('outer', 0, 0, 0), None, 'expected a number'),
        (('outer',), [[[0.0] * 10]] * 2, 'as many rows as there are hidden nodes'),
        (('offset',), [0.0], 'expected 2 numbers'),
        (('gate', 'low'), [0.0], 'expected 5 numbers'),
        (('gate', 'high', 0), -99.0, 'expected no value below'),
        (('gain', 'value', 0), 9.0, 'expected a number from 0.5 to 2'),
        (('gain', 'variance', 0), -1.0, 'expected a number from 0 to'),
    ],
)
def test_a_document_that_is_no_model_is_refused(model, path, value, message):
    with pytest.raises(ModelFileError, match=message):
        read_model(changed(json.loads(write_model(model)), path, value))


@pytest.mark.filterwarnings('ignore::RuntimeWarning')
def test_no_number_makes_a_model_predict_what_is_not_finite(model):
    document = json.loads(write_model(model))
    inputs = foam_samples(22).x
    wrong = []
    for path in one_of_each(places_of_numbers(document)):
        for value in (5e-324, 1e-300, -1.0, 0.0, 1e13, -1e13, 1e300, 1e308):
            try:
                found = read_model(changed(document, path, value)).predict(inputs)
            except ModelFileError as error:
                field = next(key for key in reversed(path) if isinstance(key, str))
                if field not in str(error):
                    wrong.append(f'{path} = {value}: {error}')
            else:
                if not np.isfinite(found).all():
                    wrong.append(f'{path} = {value}: {found}')
    assert not wrong


def test_text_that_is_no_document_is_refused(model):
    for text, message in (
        ('', 'expected JSON'),
        ('[' * 100_000, 'expected JSON'),
        ('[]', 'an object with'),
        (' ' * (5 * 1024 * 1024), 'expected at most'),
        (write_model(model).replace('"decay": 2.0', '"decay": NaN'), 'finite numbers'),
    ):
        with pytest.raises(ModelFileError, match=message):
            read_model(text)
