# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import fields

import pytest
import typer

from fuzzycnc_ros.cli.options import node_parameters
from fuzzycnc_ros.cli.quantities import (
    in_declared_unit,
    number_in,
    quantity,
    signed_quantity,
    with_their_units,
)
from fuzzycnc_ros.core.units import DECLARED, LENGTHS, TIMES, si_value, with_point
from fuzzycnc_ros.registry import COMPONENTS


def test_every_unit_of_a_parameter_that_is_a_number_can_be_written():
    units = {
        item.metadata['unit']
        for component in COMPONENTS.values()
        for item in fields(component.CONFIG)
        if isinstance(item.default, float)
    }
    assert units <= set(DECLARED)


@pytest.mark.parametrize('unit', DECLARED)
def test_a_plain_number_keeps_its_meaning_and_the_declared_unit_may_stand_behind_it(unit):
    assert in_declared_unit('a.b', '0.25', unit) == 0.25
    assert in_declared_unit('a.b', '-2e-3', unit) == -2e-3
    if unit[0].isalpha():
        assert in_declared_unit('a.b', f'0.25{unit}', unit) == 0.25
    if unit != '-':
        assert in_declared_unit('a.b', f'0.25 {unit}', unit) == 0.25


@pytest.mark.parametrize(
    ('text', 'unit', 'value'),
    [
        ('5um', 'm', 5e-6),
        ('5 µm', 'm', 5e-6),
        ('1 inch', 'm', 0.0254),
        ('0.6 m/min', 'm/s', 0.01),
        ('3um/min', 'm/s', 5e-8),
        ('20 min', 's', 1200.0),
        ('250 ms', 's', 0.25),
        ('1 d', 's', 86400.0),
        ('500mK', 'K', 0.5),
        ('36 K/h', 'K/s', 0.01),
        ('2 1/mm', '1/m', 2000.0),
        ('1500 mm/s^2', 'm/s^2', 1.5),
        ('180deg', 'rad', 3.14159265358979),
        ('60 rpm', 'rad/s', 6.28318530717959),
        ('40 %', '-', 0.4),
    ],
)
def test_other_units_of_the_same_kind(text, unit, value):
    assert in_declared_unit('a.b', text, unit) == value


@pytest.mark.parametrize(
    ('given', 'message'),
    [
        ('compensator.offset_max=5s', 'a length in mm, um, m or inch but found'),
        ('compensator.slew_max=5 um', "a velocity in um/s, .*inch/min but found '5 um'"),
        ('linuxcnc_bridge.lead_max=1 m', 'a time in s, ms, min, h or d but found'),
        ('compensator.offset_max=far', "a length in .* but found 'far'"),
    ],
)
def test_a_unit_of_another_kind_is_refused_and_the_right_one_is_named(given, message):
    name = given.partition('=')[0]
    with pytest.raises(ValueError, match=f'^{name}: expected {message}'):
        node_parameters('set', [given])


@pytest.mark.parametrize(
    'read',
    [
        lambda text: quantity('--tolerance', text, LENGTHS, example='20um'),
        lambda text: signed_quantity('Y', text, LENGTHS, example='-3um'),
        lambda text: in_declared_unit('compensator.offset_max', text, 'm'),
        lambda text: number_in(LENGTHS, 'a length')(text),
        lambda text: si_value(text, 'm'),
    ],
)
@pytest.mark.parametrize('typed', ['0,01mm', '-2,5 um', '0,01', '1,5e-2mm'])
def test_a_decimal_comma_is_named(read, typed):
    with pytest.raises((ValueError, typer.BadParameter)) as caught:
        read(typed)
    remedy = f'found {typed!r}; decimals take a point, as in {typed.replace(",", ".")}'
    assert remedy in str(caught.value)


@pytest.mark.parametrize('typed', ['1,2,3', '1,2 mm, 3', ',5mm', '5,', 'a,1', '1um,Y=2um'])
def test_other_commas_are_none(typed):
    assert with_point(typed) == ''


def test_parameters_of_nodes_take_units_and_text_stays_text():
    found = node_parameters(
        '--param',
        [
            'compensator.offset_max=5 um',
            'compensator.slew_max=20e-9',
            'simulated_machine.axis_velocity_max=[200mm/s, 12 m/min, 0.3]',
            'simulated_machine.duties=[T2]',
            'compensator.lockstep=true',
            'nobody.knows=5um',
        ],
    )
    assert found == {
        'compensator': {'offset_max': 5e-6, 'slew_max': 20e-9, 'lockstep': True},
        'simulated_machine': {'axis_velocity_max': [0.2, 0.2, 0.3], 'duties': ['T2']},
        'nobody': {'knows': '5um'},
    }


def test_options_in_seconds_take_other_units():
    read = number_in(TIMES, 'a time')
    assert [read(text) for text in ('86400', '24h', '24 h', '1440min', 86400.0)] == 5 * [86400.0]
    with pytest.raises(typer.BadParameter, match=r"a time in s, ms, min, h or d but found '5um'"):
        read('5um')


def test_a_space_before_the_unit():
    for text in ('20um', '20 um', ' 20  um ', '0.02 mm'):
        assert quantity('--tolerance', text, LENGTHS, example='20um') == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ('typed', 'joined'),
    [
        ('a --tolerance 20 um --out b', ['a', '--tolerance', '20 um', '--out', 'b']),
        ('a --load 40 % b', ['a', '--load', '40 %', 'b']),
        ('a --load=-40 %', ['a', '--load=-40 %']),
        ('set compensator.offset_max=5 um', ['set', 'compensator.offset_max=5 um']),
        ('probe Y=-3 um Z=0.012 mm', ['probe', 'Y=-3 um', 'Z=0.012 mm']),
        ('a --size 150x100 mm', ['a', '--size', '150x100 mm']),
        ('a --start 24 h shift', ['a', '--start', '24 h', 'shift']),
        ('a --feed 2e3 mm/min', ['a', '--feed', '2e3 mm/min']),
    ],
)
def test_two_words_for_one_quantity(typed, joined):
    assert with_their_units(typed.split()) == joined


def test_what_is_no_quantity_stays_two_words(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in (
        'info 2024 m',
        'train monday s',
        'a --out=b m',
        'a --axis X m',
        'a --seed 3 shift',
    ):
        assert with_their_units(line.split()) == line.split()
    (tmp_path / 's').mkdir()
    assert with_their_units(['train', '--seed', '3', 's']) == ['train', '--seed', '3', 's']


def test_commands_take_them(fuzzycnc, refused, bag):
    path = bag()
    refused('train', path, '--out', 'm.json', '--end', '5um', naming=['--end', "'5um'", 'a time'])
    refused('advise', path / 'no', '--tolerance', '20', 'um', naming=['a part program'])
    outcome = fuzzycnc(
        'position', '--to', '5', 'mm', '--duration', '400', 'ms', '--load', '4', '%'
    )
    assert outcome.code == 0, outcome.err
