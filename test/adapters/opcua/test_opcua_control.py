# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Control files, and the adapter to a control against a real OPC UA server, without a node."""

import hashlib
import re
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy')
pytest.importorskip('asyncua')

from equipment.field_servers import Field, Route
from equipment.opcua_machine import FILE, ControlServer, LineControl, control_file
from equipment.secured_server import PINNING, SECURITY, secured, user_file

from fuzzycnc_ros.adapters.controller import Controller
from fuzzycnc_ros.adapters.link import LinkError
from fuzzycnc_ros.adapters.opcua.control import OpcUaControl
from fuzzycnc_ros.adapters.opcua.control_file import ControlFields, check_axes, read_control
from fuzzycnc_ros.adapters.opcua.file_fields import read_credentials
from fuzzycnc_ros.adapters.opcua.offset_lines import LineOrders
from fuzzycnc_ros.adapters.threaded import ThreadedController
from fuzzycnc_ros.core.inputs.lines import Lines
from fuzzycnc_ros.ros.parameters import ParameterError
from fuzzycnc_ros.runtime.enums import MachineMode

pytestmark = pytest.mark.ros

ORDERS = LineOrders(
    lines=Lines(
        offset=np.array([12e-6, -7.0004e-6]),
        slope=np.array([5e-5, 0.0]),
        reference_position=np.array([0.1, 0.0]),
    ),
    sequence=17,
    heartbeat=18,
    validity=10.0,
)


@pytest.fixture(scope='module')
def field():
    """An event loop for servers."""
    opened = Field()
    yield opened
    opened.close()


@pytest.fixture(scope='module')
def started(field):
    """A server for the tests of this file; it takes seconds to start."""
    return field.add(ControlServer(LineControl()))


@pytest.fixture
def server(field, started):
    """A control at which nothing has been written."""
    field.call(started.reset(LineControl()))
    return started


@contextmanager
def connected(path):
    """An adapter, closed in the end."""
    adapter = OpcUaControl(read_control(path), 'tester', read_credentials, 60.0)
    try:
        yield adapter
    finally:
        adapter.close()


def wait(condition):
    """Wait for what the program of the control does."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_set_arrives_whole_and_is_read_back_in_si_units(server, tmp_path):
    control = server.control
    control.spindle_speed, control.running, control.watchdog = 3000.0, True, 600.0
    control.position = np.array([0.25, 0.0])
    with connected(control_file(tmp_path, server.port)) as adapter:
        adapter.claim()
        wait(lambda: adapter.read().mode is MachineMode.RUNNING)
        first = adapter.read()
        adapter.write(ORDERS)
        wait(lambda: control.acknowledged == 17)
        wait(lambda: np.abs(control.applied - [19.5e-6, -7e-6]).max() < 1e-8)
        wait(lambda: abs(adapter.read().applied[0] - 19.5e-6) < 1e-8)
        status = adapter.read()
    assert first.mode is MachineMode.RUNNING
    assert first.ready
    assert first.spindle_speed == pytest.approx(3000.0 * 2 * np.pi / 60)
    np.testing.assert_allclose(first.position, [0.25, np.nan])
    assert (status.sequence, status.acknowledged, status.heartbeat) == (17, 17, 18)
    assert status.writer == 'tester'
    assert control.valid_for == pytest.approx(10.0)
    np.testing.assert_allclose(status.lines.offset, [12e-6, -7e-6], atol=1e-12)
    np.testing.assert_allclose(status.lines.slope, [5e-5, 0.0], atol=1e-12)
    np.testing.assert_allclose(status.lines.reference_position, [0.1, 0.0])
    np.testing.assert_allclose(status.limits.offset_max, 60e-6)
    assert status.limits.slew_max == pytest.approx(20e-6)
    np.testing.assert_allclose(status.limits.resolution, [0.0, 1e-9])
    assert control.owner == 'tester'


def test_release_gives_back_what_is_ours_alone(server, field, tmp_path):
    with connected(control_file(tmp_path, server.port)) as adapter:
        adapter.claim()
        adapter.read()
        adapter.write(ORDERS)
        field.call(server.put('sequence', 99))
        adapter.release()
        assert adapter.read().sequence == 99
    with connected(control_file(tmp_path, server.port)) as adapter:
        adapter.claim()
        adapter.read()
        adapter.write(ORDERS)
        adapter.release()
        status = adapter.read()
        assert (status.sequence, status.writer) == (0, '')


def test_nothing_is_written_over_another_set(server, field, tmp_path):
    with connected(control_file(tmp_path, server.port)) as adapter:
        adapter.claim()
        adapter.read()
        field.call(server.put('sequence', 99))
        assert adapter.write(ORDERS).sequence == 99
        assert not np.any(adapter.read().lines.offset)


@pytest.mark.parametrize(
    ('old', 'new', 'texts'),
    [
        ('"nsu=urn:fuzzycnc:test;s=X.offset"', 'text', ['X.offset', 'a number', 'it is String']),
        ('"nsu=urn:fuzzycnc:test;s=X.offset"', 'int32', ['Int32 without a scale', 'give scale']),
        ('"nsu=urn:fuzzycnc:test;s=X.offset"', 'shown', ['X.offset', 'this user can write']),
        ('"nsu=urn:fuzzycnc:test;s=X.offset"', 'array', ['X.offset', 'it holds an array']),
        ('ns=2;s=sequence', 'double', ['sequence', 'expected a whole number', 'it is Double']),
        ('ns=2;s=heartbeat', 'byte', ['heartbeat', '16 bits or more', 'it is Byte']),
        ('ns=2;s=homed', 'float', ['homed', 'expected a switch', 'it is Float']),
        ('ns=2;s=owner', 'int32', ['owner', 'expected a text', 'it is Int32']),
        ('ns=2;s=Z.applied', 'none', ['Z.applied: node ns=2;s=none', 'no such node']),
    ],
)
def test_wrong_variables_are_named(server, tmp_path, old, new, texts):
    assert old in FILE
    path = control_file(tmp_path, server.port, FILE.replace(old, f'ns=2;s={new}'))
    with pytest.raises(LinkError) as error, connected(path):
        pass
    for text in texts:
        assert text in str(error.value)


def test_wrong_paths_and_namespaces_are_named_together(server, tmp_path):
    text = FILE.replace('Mill/2:acknowledged', 'Mill/2:nothing').replace(
        'urn:fuzzycnc', 'urn:other'
    )
    with pytest.raises(LinkError) as error, connected(control_file(tmp_path, server.port, text)):
        pass
    assert 'acknowledged: path 0:Objects/2:Mill/2:nothing' in str(error.value)
    assert 'X.offset: node nsu=urn:other:test;s=X.offset' in str(error.value)
    assert 'no namespace urn:other:test' in str(error.value)


def test_counts_that_do_not_fit_are_named(server, tmp_path):
    text = FILE.replace('ns=2;s=Z.offset, scale: 0.001', 'ns=2;s=int16, scale: 0.0001')
    with connected(control_file(tmp_path, server.port, text)) as adapter:
        adapter.claim()
        adapter.read()
        with pytest.raises(LinkError, match='-70004 counts do not fit into Int16'):
            adapter.write(ORDERS)


def test_nobody_there(tmp_path):
    with pytest.raises(LinkError, match='connection refused; is the server running'):
        with connected(control_file(tmp_path, 1)):
            pass


@pytest.mark.parametrize('fault', ['refuse', 'cut', 'hang', 'garble'])
def test_any_fault_of_the_way_ends_the_connection_with_a_reason(server, field, tmp_path, fault):
    route = field.add(Route(server))
    with connected(control_file(tmp_path, route.port, timeout=3.0)) as adapter:
        adapter.read()
        field.call(route.set(fault))
        with pytest.raises(LinkError, match=f'opc.tcp://127.0.0.1:{route.port}/: '):
            adapter.read()
    field.call(route.set(''))


class Recorded(Controller):
    """A controller that notes what is asked of it, and can stand still."""

    def __init__(self):
        self.asked, self.stands = [], 0.0

    def read(self):
        self.asked.append(None)
        return len(self.asked)

    def write(self, orders):
        self.asked.append(orders)
        if self.stands:
            self.asked.clear()
            time.sleep(self.stands)
            self.stands = 0.0
        return len(self.asked)

    def limits(self):
        return None

    claim = release = close = limits


def test_after_a_pause_it_is_read_before_anything_is_written():
    """What was ordered before it does not know that the control let go meanwhile."""
    fake = Recorded()
    adapter = ThreadedController(lambda: fake, 0.001, 0.1)
    wait(lambda: adapter.write('before') and 'before' in fake.asked)
    fake.stands = 0.2
    # Another pause before it may have taken away what it is to stand at.
    wait(lambda: (not fake.stands and fake.asked) or (adapter.write('before') and None))
    assert fake.asked[0] is None
    wait(lambda: adapter.write('amid') is not None)
    wait(lambda: adapter.write('after') and fake.asked[-1] == 'after')
    assert set(fake.asked) == {None, 'after'}
    adapter.close()


def test_in_a_thread_nothing_waits(server, field, tmp_path):
    file = read_control(control_file(tmp_path, server.port))
    gate = threading.Event()
    adapter = ThreadedController(
        lambda: gate.wait() and OpcUaControl(file, 'tester', read_credentials, 1.0), 0.02, 1.0
    )
    assert adapter.read() is None
    with pytest.raises(LinkError, match='has not been read yet'):
        adapter.limits()
    gate.set()
    wait(lambda: adapter.read() is not None)
    assert adapter.limits().slew_max == pytest.approx(20e-6)
    adapter.claim()
    wait(lambda: adapter.write(ORDERS) is not None and server.control.acknowledged == 17)
    adapter.release()
    adapter.close()
    wait(lambda: server.control.sequence == 0)
    failing = ThreadedController(
        lambda: OpcUaControl(read_control(control_file(tmp_path, 1)), '', read_credentials, 1.0),
        0.02,
        1.0,
    )

    def lost():
        try:
            failing.read()
        except LinkError as error:
            return 'connection refused' in str(error)
        return False

    wait(lost)
    failing.close()


def edited(tmp_path, old, new):
    assert old in FILE
    return control_file(tmp_path, 4840, FILE.replace(old, new, 1))


@pytest.mark.parametrize(
    ('old', 'new', 'text'),
    [
        ('unit: um', 'unit: ym', 'line 3: unit: expected one of um, mm, m, inch but found'),
        ('unit: um\n', '', "expected the field 'unit' but it is missing"),
        ('  heartbeat: ns=2;s=heartbeat\n', '', "hand_shake: expected the variable 'heartbeat'"),
        ('ns=2;s=sequence', 'ns=2;sequence', 'expected a node id such as ns=2;s=Spindle.T1'),
        ('    applied: ns=2;s=Z.applied\n', '', "axis Z: expected the variable 'applied'"),
        ('  Z:', '  Q:', 'expected one of X, Y, Z'),
        ('    travel: [-200, 300]\n', '', 'travel is missing'),
        ('[-200, 300]', '[300, -200]', 'expected the two ends of the axis'),
        ('[-200, 300]', '[300]', 'expected the two ends of the axis'),
        ('slew: ns=2', 'slow: ns=2', "unknown field 'slow'; did you mean slew?"),
        ('scale: 0.001', 'scale: 0', 'expected another number than 0'),
        ('ns=2;s=heartbeat', 'ns=2;s=sequence', 'are the same variable, node ns=2;s=sequence'),
        ('unit: rpm', 'unit: Hz', 'unit: expected one of rpm, rad/s'),
        ('opc.tcp:', 'http:', 'expected opc.tcp://HOST:PORT/PATH'),
        ('hand_shake:', 'handshake:', "expected the field 'hand_shake' but it is missing"),
        ('timeout: {timeout}', 'timeout: 0', 'timeout: expected a number from 0.05 to 60 s'),
        ('unit: um', 'security: {{policy: None}}\nunit: um', 'policy: expected one of Basic256'),
        ('unit: um', 'credentials: nobody.yaml\nunit: um', 'expected a file but nothing is at'),
        ('unit: um', 'allow_plain_password: yes\nunit: um', 'expected one of true, false but'),
    ],
)
def test_wrong_files_are_refused(tmp_path, old, new, text):
    with pytest.raises(ParameterError) as error:
        read_control(edited(tmp_path, old, new))
    assert text in str(error.value)
    assert str(tmp_path / 'control.yaml') in str(error.value)


@pytest.mark.parametrize(
    ('unit', 'metres'), [('um', 1e-6), ('mm', 1e-3), ('m', 1.0), ('inch', 0.0254)]
)
def test_lengths_are_in_the_unit_of_the_file(tmp_path, unit, metres):
    file = read_control(edited(tmp_path, 'position_unit: mm', f'position_unit: {unit}'))
    assert file.travel.low[0] == pytest.approx(-200.0 * metres)
    assert file.travel.high[0] == pytest.approx(300.0 * metres)


def test_the_schema_takes_what_is_read_and_refuses_what_is_not(root):
    jsonschema = pytest.importorskip('jsonschema')
    validator = jsonschema.Draft202012Validator(ControlFields.model_json_schema())

    def fields(text):
        read = yaml.safe_load(text)
        if True in read.get('state', {}):  # YAML 1.1 takes `on` for a switch, editors do not
            read['state']['on'] = read['state'].pop(True)
        return read

    page = (root / 'docs' / 'how-to' / 'opcua-output.md').read_text()
    examples = re.findall(r'^```yaml\n(url:.*?)^```', page, re.M | re.S)
    good = FILE.format(host='10.0.0.7', port=4840, timeout=2.0)
    good = good.replace('1e-9', '1.0e-9')  # a number in YAML 1.1 too
    assert (root / 'examples' / 'opcua-control.yaml').read_text().endswith(examples[0])
    for text in [*examples, good]:
        validator.validate(fields(text))
    for old, new in [('unit: um', 'unit: ym'), ('  Z:', '  Q:'), ('slew:', 'slow:')]:
        assert not validator.is_valid(fields(good.replace(old, new, 1))), new


def test_file_without_axes_is_refused(tmp_path):
    start = FILE.index('  X:')
    path = control_file(tmp_path, 1, FILE[: start - len('axes:\n')])
    with pytest.raises(ParameterError, match='expected axes'):
        read_control(path)


def test_axes_of_file_and_parameter_are_the_same(tmp_path):
    file = read_control(control_file(tmp_path, 1))
    check_axes(file, ('X', 'Z'))
    with pytest.raises(ParameterError, match='parameter axes: expected X, Z'):
        check_axes(file, ('X', 'Y', 'Z'))


def test_sign_and_unit_of_a_control_that_counts_the_other_way(server, tmp_path):
    text = FILE.replace(
        'offset: "nsu=urn:fuzzycnc:test;s=X.offset"',
        'offset: {{node: ns=2;s=X.offset, scale: -1}}',
    )
    with connected(control_file(tmp_path, server.port, text)) as adapter:
        adapter.claim()
        adapter.read()
        status = adapter.write(ORDERS)
        wait(lambda: server.control.offset[0] == pytest.approx(-12e-6))
        assert status.lines.offset[0] == pytest.approx(12e-6)


def in_a_template(text):
    return text.replace('{', '{{').replace('}', '}}')


@pytest.mark.parametrize('security', ['', PINNING.replace('{', '{mode: Sign, ')])
def test_a_password_that_everybody_could_read_is_refused_with_the_remedy(tmp_path, security):
    for name in ('own.der', 'own-key.pem'):
        (tmp_path / name).touch()
    user = user_file(tmp_path)
    text = in_a_template(f'credentials: user.yaml\n{security}\n') + FILE
    with pytest.raises(ParameterError) as error:
        read_control(control_file(tmp_path, 4840, text))
    assert 'line 1: credentials: expected security with mode SignAndEncrypt' in str(error.value)
    assert 'or say allow_plain_password: true' in str(error.value)
    allowed = f'allow_plain_password: true\n{text}'
    assert read_control(control_file(tmp_path, 4840, allowed)).server.credentials == user
    plain = text.replace('credentials: user.yaml', 'allow_plain_password: false')
    assert read_control(control_file(tmp_path, 4840, plain)).server.credentials is None


def test_a_certificate_is_pinned_in_the_state_directory_or_beside_the_file(tmp_path):
    for name in ('own.der', 'own-key.pem', 'control.der'):
        (tmp_path / name).touch()
    path = control_file(tmp_path, 4840, in_a_template(f'{PINNING}\n') + FILE)
    beside = read_control(path).server.security
    assert beside.pinned
    assert beside.server_certificate == tmp_path / 'opcua-127.0.0.1-4840.pem'
    state = read_control(path, '/var/lib/mill').server.security
    assert state.server_certificate == Path('/var/lib/mill/opcua-127.0.0.1-4840.pem')
    path = control_file(tmp_path, 4840, in_a_template(f'{SECURITY}\n') + FILE)
    given = read_control(path, '/var/lib/mill').server.security
    assert not given.pinned
    assert given.server_certificate == tmp_path / 'control.der'


def test_the_first_certificate_of_a_server_is_pinned_and_another_refused(field, tmp_path):
    """Who takes its place gets no password."""
    server = field.add(ControlServer(LineControl(), secured(tmp_path)))
    user_file(tmp_path)
    text = in_a_template(f'{PINNING}\ncredentials: user.yaml\n') + FILE
    path = control_file(tmp_path, server.port, text)
    pin = tmp_path / f'opcua-127.0.0.1-{server.port}.pem'
    assert not pin.exists()
    with connected(path) as adapter:
        assert adapter.read().limits.slew_max == pytest.approx(20e-6)
    first = pin.read_text()
    with connected(path):
        pass
    assert pin.read_text() == first
    # Another server takes its place, with a certificate of its own and ears for passwords.
    asked, other = [], tmp_path / 'other'
    other.mkdir()
    field.call(server.stop())
    server._secure = secured(other, asked.append)
    field.call(server.start())
    with pytest.raises(LinkError) as error, connected(path):
        pass
    assert f'the server shows another certificate than {pin}' in str(error.value)
    assert 'delete that file' in str(error.value)
    assert hashlib.sha256((other / 'control.der').read_bytes()).hexdigest() in str(error.value)
    assert asked == []
    pin.unlink()
    with connected(path):
        pass
    assert asked == ['joe']
    assert pin.read_text() != first


@pytest.mark.slow
def test_secured_server_with_credentials(field, tmp_path):
    server = field.add(ControlServer(LineControl(), secured(tmp_path)))
    text = in_a_template(f'{SECURITY}\ncredentials: user.yaml\n') + FILE
    user = user_file(tmp_path, 'wrong')
    path = control_file(tmp_path, server.port, text, timeout=5.0)
    with pytest.raises(LinkError) as error, connected(path):
        pass
    assert str(error.value).startswith(f'the server refuses {user} (Bad')
    assert error.value.pause > 10.0
    user_file(tmp_path)
    with connected(path) as adapter:
        adapter.claim()
        adapter.read()
        adapter.write(ORDERS)
        wait(lambda: server.control.acknowledged == 17)
    path = control_file(tmp_path, server.port, timeout=5.0)
    with pytest.raises(LinkError, match='does not offer this connection'), connected(path):
        pass


PROBE = """\
probe:
  due: ns=2;s=probe_due
  code: ns=2;s=double
  value: ns=2;s=float
"""


def test_a_probing_cycle_is_read_and_shown_what_is_due(server, field, tmp_path):
    path = control_file(tmp_path, server.port, FILE + PROBE)
    with connected(path) as adapter:
        assert adapter.read().probe == (0.0, 0.0)
        adapter.probe_due = True
        field.call(server.put('float', -52.5))
        field.call(server.put('double', 3.0))
        assert adapter.read().probe == (3.0, -52.5)
        assert field.call(server.get('probe_due')) is True
        adapter.probe_due = False
        adapter.read()
        assert field.call(server.get('probe_due')) is False
    field.call(server.put('double', 0.0))
    field.call(server.put('float', 0.0))


def test_code_and_value_of_a_probing_cycle_go_together(server, tmp_path):
    text = FILE + PROBE.replace('  value: ns=2;s=float\n', '')
    path = control_file(tmp_path, server.port, text)
    with pytest.raises(ParameterError, match=r'expected code and value, or none of them'):
        read_control(path)
    with connected(control_file(tmp_path, server.port)) as adapter:
        adapter.probe_due = True
        assert adapter.read().probe is None
