# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc linuxcnc`, with programs in the place of those of LinuxCNC."""

import os
import re

import pytest

from fuzzycnc_ros.adapters.linuxcnc.component import hal_text
from fuzzycnc_ros.machine_file.reader import built_in_path

INI = """[HAL]
HALFILE = own.hal
[TRAJ]
COORDINATES = X Z Z A
[AXIS_X]
MIN_LIMIT = 0
MAX_LIMIT = 400
[AXIS_Z]
MIN_LIMIT = -200
"""
VERSION = '#!/bin/sh\necho 2.9.0~pre1+git2023\n'
COMPILER = """#!/bin/sh
case $1 in
--print-modinc) echo {folder}/modinc ;;
--install)
    IFS= ; name=${{2##*/}}
    while read -r line; do echo "$line"; done <$2 >{folder}/${{name%.comp}}.so ;;
esac
"""


@pytest.fixture
def installation(tmp_path, monkeypatch):
    """A LinuxCNC with a compiler of components."""
    (tmp_path / 'modinc').write_text(f'RTLIBDIR := /nowhere\nRTLIBDIR := {tmp_path}\n')
    programs = tmp_path / 'bin'
    programs.mkdir()
    texts = {'linuxcnc_var': VERSION, 'halcompile': COMPILER.format(folder=tmp_path)}
    for name, text in texts.items():
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    monkeypatch.setenv('PATH', str(programs))
    return programs


@pytest.fixture
def ini(tmp_path):
    path = tmp_path / 'mill.ini'
    path.write_text(INI)
    return path


def test_what_it_installs_passes_its_check(installation, ini, fuzzycnc):
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 1
    assert '! component: fuzzycnc_offset is not installed' in done.out
    done = fuzzycnc('linuxcnc', 'install', ini)
    assert done.code == 0, done
    assert ini.read_text() == INI
    lines = re.findall(r'^  (\[\S+\])(.*)$', done.out, re.M)
    assert ('[AXIS_Z]', 'OFFSET_AV_RATIO = 0.05') in lines
    assert not any('AXIS_Y' in section for section, _ in lines)
    text = INI + '\n'.join(f'{section}\n{line}' for section, line in lines)
    ini.write_text(text + '\n[AXIS_Z]\nMAX_LIMIT = 1\n')
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 0, done.out
    assert 'travel Z: -200 to 1' in done.out
    ini.write_text(ini.read_text().replace('OFFSET_AV_RATIO = 0.05', 'OFFSET_AV_RATIO = 0.0'))
    assert '[AXIS_Z]OFFSET_AV_RATIO = 0.05' in fuzzycnc('linuxcnc', 'check', ini).out


def test_feed_shares_are_installed_and_checked_where_they_are_asked_for(
    installation, ini, fuzzycnc
):
    ini.write_text(f'{INI}\n[HAL]\nHALFILE = fuzzycnc_feed.hal\n')
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert '! component of feed shares: fuzzycnc_feed is not installed' in done.out
    done = fuzzycnc('linuxcnc', 'install', ini, '--feed')
    assert done.code == 0, done
    lines = re.findall(r'^  (\[\S+\])(.*)$', done.out, re.M)
    assert ('[FUZZYCNC]', 'FEED_TABLE = part.feed') in lines
    assert (ini.parent / 'fuzzycnc_feed.hal').exists()
    more = '\n'.join(f'{section}\n{line}' for section, line in lines)
    ini.write_text(f'{ini.read_text()}{more}\n[AXIS_Z]\nMAX_LIMIT = 1\n')
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 0, done.out


def test_feed_shares_of_another_program_are_refused(fuzzycnc, refused, tmp_path):
    program, table = tmp_path / 'part.ngc', tmp_path / 'part.feed'
    program.write_text('G1 X1 F60\n')
    table.write_text('no table\n')
    refused('linuxcnc', 'feed', program, table, naming=['expected a table'])
    table.write_text(
        f'fuzzycnc-feed 1\nprogram {"ab" * 32}\nwork-offset 0\ntool-length -1\npoints 0\n'
    )
    refused('linuxcnc', 'feed', program, table, naming=['that of another program (abababab)'])


def test_what_lacks_is_named(installation, ini, fuzzycnc, refused, tmp_path):
    fuzzycnc('linuxcnc', 'install', ini)
    ini.write_text(INI + '[HAL]\nHALFILE = fuzzycnc.hal\nHALFILE = fuzzycnc_offset.hal\n')
    os.utime(tmp_path / 'fuzzycnc_offset.so', (0, 0))
    (tmp_path / 'fuzzycnc_offset.hal').write_text('# another one\n')
    (installation / 'linuxcnc_var').write_text(VERSION.replace('2.9.0', '2.8.4'))
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 1
    for text in (
        '! LinuxCNC: expected LinuxCNC 2.9 or newer but found 2.8.4',
        'is older than its source',
        'is not that for X, Z',
        '! INI file: loads fuzzycnc.hal and fuzzycnc_offset.hal: remove the first',
        '! INI file: lacks [FUZZYCNC]SCALE',
        '! travel Z: no MAX_LIMIT in [AXIS_Z]',
    ):
        assert text in done.out
    refused('linuxcnc', 'install', ini, naming=['fuzzycnc_offset.hal', 'remove it'])
    assert (tmp_path / 'fuzzycnc_offset.hal').read_text() == '# another one\n'


def test_without_a_compiler_the_way_without_slopes_is_named(installation, ini, refused):
    (installation / 'halcompile').unlink()
    refused('linuxcnc', 'install', ini, naming=['linuxcnc-uspace-dev', 'without it fuzzycnc.hal'])
    assert not ini.with_name('fuzzycnc_offset.hal').exists()


def test_shipped_file_is_that_of_a_mill(root):
    assert hal_text('XYZ') == (root / 'linuxcnc' / 'fuzzycnc_offset.hal').read_text()


def test_every_axis_has_its_number():
    text = hal_text('ZX')
    assert 'personality=2' in text
    assert 'net fuzzycnc-position-z axis.z.pos-cmd => fuzzycnc-offset.position-0' in text
    assert 'setp fuzzycnc-offset.max-1 [AXIS_X]MAX_LIMIT' in text


def with_lines(ini, out, where):
    """Add the lines that were shown for the INI file, and for a HAL file of its own."""
    ini_lines, hal_lines = (re.findall('^  (.*)$', part, re.M) for part in out.split('HAL files'))
    text = ''.join(line.replace(']', ']\n', 1) + '\n' for line in ini_lines)
    ini.write_text('[HAL]\nHALFILE = own.hal\n[TRAJ]\nCOORDINATES = Y X\n' + text)
    nets = 'net a fuzzycnc-axis-x.feedback\nnet b fuzzycnc-axis-x.output\n'
    nets += 'net c => fuzzycnc-axis-x.command\n'
    where.write_text('\n'.join(hal_lines) + '\n' + nets)


def test_controller_of_an_axis_is_that_of_its_machine_file(
    installation, ini, fuzzycnc, refused, tmp_path
):
    machine = tmp_path / 'own.yaml'
    plain = built_in_path('ballscrew').read_text()
    machine.write_text(plain)
    words = ('linuxcnc', 'install', ini, '--machine-file', machine)
    ini.write_text('[TRAJ]\nCOORDINATES = Y X\n')
    done = fuzzycnc(*words)
    assert done.code == 0, done
    assert '[JOINT_1]FUZZYCNC_MACHINE_FILE' in done.out
    assert 'joint.1.amp-enable-out => fuzzycnc-axis-x.enable' in done.out
    with_lines(ini, done.out, tmp_path / 'own.hal')
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 0, done.out
    # a comment changes nothing; a setting of the axis does
    machine.write_text(plain + '# tuned in May\n')
    assert fuzzycnc('linuxcnc', 'check', ini).code == 0
    machine.write_text(plain.replace('bandwidth: 1.85', 'bandwidth: 1.9'))
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert done.code == 1
    assert 'is exported from another state of' in done.out
    machine.write_text(plain)
    (tmp_path / 'own.hal').write_text('net a fuzzycnc-axis-x.feedback\n')
    done = fuzzycnc('linuxcnc', 'check', ini)
    assert '! HAL X: no `addf fuzzycnc-axis-x servo-thread`' in done.out
    ini.write_text(ini.read_text().replace('_HASH = 0x', '_HASH = 0xf'))
    assert 'FUZZYCNC_MACHINE_HASH: expected 0x' in fuzzycnc('linuxcnc', 'check', ini).out


def test_axis_that_a_configuration_lacks_is_named(installation, ini, refused):
    words = ('linuxcnc', 'install', ini)
    refused(*words, '--axis', 'X', naming=['--machine-file', 'expected one'])
    ini.write_text('[TRAJ]\nCOORDINATES = Y Z\n')
    refused(*words, '--machine-file', 'lathe', naming=['expected X once', 'Y Z'])
