# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The docs say what is there: generated tables, links, names, commands, the picture, figures."""

import ast
import re
import runpy
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from each_case import for_each

from fuzzycnc_ros.core.thermal.fit import evaluate, train_model
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.graph.bring_up import LAUNCH_ARGUMENTS
from fuzzycnc_ros.registry import COMPONENTS, MACHINES
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.simulation.thermal.duties import record_runs

ROOT = Path(__file__).parents[2]
TABLES = runpy.run_path(str(ROOT / 'tools' / 'make_tables.py'))
PAGES = [
    path for path in (*ROOT.glob('*.md'), *(ROOT / 'docs').rglob('*.md'), *ROOT.glob('bags/*.md'))
]
NODES = {node.name: node for node in TABLES['nodes']()}
CALLS = {
    path.stem: kind
    for kind in ('srv', 'action')
    for path in (ROOT / 'msg_defs' / kind).glob(f'*.{kind}')
}
MESSAGES = {path.stem for path in (ROOT / 'msg_defs' / 'msg').glob('*.msg')}
FIGURE_TOLERANCE = 0.3
"""What other versions of numpy and scipy may change [um]."""


def label(path: Path) -> str:
    """Return a test id."""
    return str(path.relative_to(ROOT))


EVERY_PAGE = for_each(PAGES, label)


def anchors(path: Path) -> set[str]:
    """Return the anchors that GitHub gives the headings of a page."""
    found = set()
    for heading in re.findall(r'^#+ (.+)$', path.read_text(), re.M):
        plain = re.sub(r'[^\w\- ]', '', heading.lower())
        found.add(plain.strip().replace(' ', '-'))
    return found


def commands(text: str) -> list[str]:
    """Return the command lines of all code blocks, continued lines joined."""
    blocks = re.findall(r'^```(\w*)\n(.*?)^```', text, re.M | re.S)
    shown = [body for language, body in blocks if language in ('', 'sh')]
    lines = '\n'.join(shown).replace('\\\n', ' ').splitlines()
    return [line.strip().removeprefix('.venv/bin/') for line in lines] + re.findall(
        r'`((?:fuzzycnc|ros2|make) [^`]+)`', text
    )


def test_the_pages_were_found():
    assert {
        'README.md',
        'CHANGELOG.md',
        'docs/explanation/architecture.md',
        'docs/reference/conventions.md',
    } <= {label(page) for page in PAGES}


@for_each(TABLES['files']().items(), lambda case: label(case[0]))
def test_generated_file_is_up_to_date(path, content):
    assert path.read_text() == content, 'run `make tables`'


def declared_topics(node: str, *, lockstep: bool) -> tuple[set[str], set[str]]:
    """Return what the tables say that a node publishes and subscribes to."""
    component = COMPONENTS[node]
    writes = {item.name for item in component.OUTPUTS} | {'/diagnostics'}
    writes |= {'node_configuration', 'node_event'}
    reads = {item.name for item in component.INPUTS}
    if node in ('simulated_machine', 'simulated_body'):
        writes.add('/clock')
        if lockstep and node == 'simulated_machine':
            turns = component.CONFIG().lockstep_nodes
            writes |= {f'machine_tick/{name}' for name in turns}
            reads.add('tick_answer')
    elif lockstep:
        writes.add('tick_answer')
        reads.add(f'machine_tick/{node}')
    if not lockstep:
        writes.add('deadline_fired')
    if node == 'joint_trajectory_bridge':
        reads.add('joint_trajectory')
        writes |= {'/tf', '/tf_static'} if find_spec('tf2_msgs') else set()
    known = {
        name for item in TABLES['EXTRAS'] for name in item.topic.replace('<node>', '').split(', ')
    }
    own = {item.name for item in (*component.OUTPUTS, *component.INPUTS)}
    assert {re.sub('(machine_tick/).*', r'\1', name) for name in writes | reads} <= known | own
    return tuple(
        {name if name[0] == '/' else f'/mill/{name}' for name in s} for s in (writes, reads)
    )


@pytest.mark.ros
@pytest.mark.parametrize('lockstep', [False, True], ids=['real time', 'lock-step'])
@pytest.mark.parametrize('node', list(COMPONENTS))
def test_nodes_have_the_topics_of_the_tables(node, lockstep, domain, monkeypatch):
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')
    # Nothing is sent, but a graph under test need not see the node either.
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    switch = f'lockstep:={str(lockstep).lower()}'
    rclpy.init(args=['--ros-args', '-r', '__ns:=/mill', '-p', switch])
    try:
        host = import_module(f'fuzzycnc_ros.nodes.{node}').make()
        of_rclpy = {'/rosout', '/parameter_events', f'/mill/{node}/transition_event'}
        published = {item.topic_name for item in host.node.publishers} - of_rclpy
        subscribed = {item.topic_name for item in host.node.subscriptions} - of_rclpy
        assert (published, subscribed) == declared_topics(node, lockstep=lockstep)
        host.stop()
    finally:
        rclpy.shutdown()


@EVERY_PAGE
def test_links_lead_somewhere(page):
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.M | re.S)
    broken = []
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if re.match(r'[a-z]+:', target):
            continue
        name, _, anchor = target.partition('#')
        file = (page.parent / name).resolve() if name else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            broken.append(target)
    assert not broken


@EVERY_PAGE
def test_dotted_names_can_be_imported(page):
    for name in sorted(set(re.findall(r'`(fuzzycnc_ros(?:\.\w+)+)`', page.read_text()))):
        module, _, attribute = name.rpartition('.')
        try:
            found = hasattr(import_module(module), attribute)
        except ModuleNotFoundError:
            found = False
        assert found or import_module(name), name


@EVERY_PAGE
def test_named_paths_exist(page):
    """Paths of the repository in inline code."""
    tops = '|'.join(('bags', 'docs', 'launch', 'msg_defs', 'params', 'test', 'tools', r'\.ci'))
    rings = '|'.join(path.name for path in (ROOT / 'fuzzycnc_ros').iterdir() if path.is_dir())
    text = page.read_text()
    shown = set(re.findall(r'`([\w./]+)`:\n\n```python', text))  # files that the reader writes
    for name in set(re.findall(rf'`((?:{tops})/[\w./-]+)`', text)) - shown:
        assert (ROOT / name).exists(), name
    for name in re.findall(rf'`((?:{rings})/[\w./-]*)`', text):
        assert (ROOT / 'fuzzycnc_ros' / name).exists(), name


@EVERY_PAGE
def test_ros_commands_name_what_exists(page):
    for line in commands(page.read_text()):
        words = line.split()
        if words[:3] == ['ros2', 'run', 'fuzzycnc_ros'] and len(words) > 3:
            if words[3].startswith('<'):
                continue
            node = NODES[words[3]]
            names = {item for record in node.records for item in record.__dataclass_fields__}
            assert set(re.findall(r'-p (\w+):=', line)) <= names | {'use_sim_time'}
        if words[:3] == ['ros2', 'launch', 'fuzzycnc_ros']:
            assert (ROOT / 'launch' / words[3]).is_file(), words[3]
            assert set(re.findall(r' (\w+):=', line)) <= set(LAUNCH_ARGUMENTS), line
        for kind, name in re.findall(r'fuzzycnc_msgs/(srv|action)/(\w+)', line):
            assert CALLS[name] == kind
        for name in re.findall(r'fuzzycnc_msgs/msg/(\w+)', line):
            assert name in MESSAGES


@EVERY_PAGE
def test_make_targets_exist(page):
    targets = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.M))
    used = [line.split()[1] for line in commands(page.read_text()) if line.startswith('make ')]
    assert set(used) <= targets


@EVERY_PAGE
def test_commands_and_options_exist(page):
    """Every `fuzzycnc ...` that a page shows can be typed like that."""
    used = [line for line in commands(page.read_text()) if line.startswith('fuzzycnc ')]
    if not used:
        return
    typer = pytest.importorskip(
        'typer', reason="typer is missing: pip install 'fuzzycnc_ros[cli]'"
    )
    from fuzzycnc_ros.cli.main import APPLICATION

    group = typer.main.get_command(APPLICATION.typer)
    # behind two dashes stand options of `up`
    parts = [part for line in used for part in line.replace(' -- ', '\nfuzzycnc up ').split('\n')]
    for line in parts:
        command, words = group, line.split()[1:]
        words[:1] = [APPLICATION.renamed.get(word, word) for word in words[:1]]  # of old versions
        # down to the command itself: `servo tune` is one of `servo`
        while words and not words[0].startswith('--') and hasattr(command, 'commands'):
            command, words = command.get_command(None, words[0]), words[1:]
            assert command is not None, line
        if hasattr(command, 'commands'):
            continue
        options = {o for item in command.params for o in (*item.opts, *item.secondary_opts)}
        given = {word.partition('=')[0] for word in words if word.startswith('--')}
        assert given <= options | {'--help', '--debug'}, line


@cache
def routes() -> set[tuple[str, str, str, bool]]:
    """Return (writer, topic, reader, latched) of every declared route between two nodes.

    A bridge has those of the simulated machine that it has at all.
    """
    bridges = set(MACHINES[1:])
    return {
        (writer, output.name, reader, output.durability is LATCHED)
        for writer, source in COMPONENTS.items()
        for output in source.OUTPUTS
        for reader, sink in COMPONENTS.items()
        for entry in sink.INPUTS
        if entry.name == output.name and not bridges & {writer, reader}
    }


def test_figures_in_the_picture_of_the_readme_are_those_of_its_demo():
    page = (ROOT / 'docs' / 'tutorials' / 'try-it.md').read_text()
    shown = re.findall(r'^\d \(T\d\)  ([YZ]) +([\d.]+) +[\d.]+ +[\d.]+ +([\d.]+)', page, re.M)
    picture = (ROOT / 'docs' / 'figures' / 'learnt.svg').read_text()
    drawn = re.findall(r'([\d.]+) → ([\d.]+) µm rms', picture)
    assert drawn == [(bare, left) for _, bare, left in sorted(shown, key=lambda row: row[0])]


def test_picture_of_the_graph_is_the_declaration():
    text = (ROOT / 'docs' / 'explanation' / 'architecture.md').read_text()
    drawn = {
        (writer, topic, reader, arrow == '-.->')
        for writer, arrow, topic, reader in re.findall(
            r'^\s*(\w+) (-->|-\.->)\|(\w+)\| (\w+)$', text, re.M
        )
    }
    assert drawn == routes()


def figures(section: str) -> dict[str, list[float]]:
    """Return the rows of the table below a heading of the thermal page: name to numbers."""
    text = (ROOT / 'docs' / 'explanation' / 'methods' / 'thermal.md').read_text()
    body = re.split(r'\n##+ ', text.partition(f'## {section}')[2])[0]
    found = {}
    for line in re.findall(r'^\| (.+) \|$', body, re.M):
        name, *cells = (cell.strip(' *') for cell in line.split('|'))
        if cells and re.match(r'\d', cells[0]):
            found[name] = [float(number) for number in re.findall(r'\d+\.\d+', ' '.join(cells))]
    return found


def numbers(page: str, row: str) -> list[float]:
    """Return the numbers of the first row of a table or output that begins so."""
    text = (ROOT / 'docs' / page).read_text()
    (line, *_) = re.findall(rf'^(?:\| )?{re.escape(row)} .*$', text, re.M)
    return [float(number) for number in re.findall(r'\d+\.\d+', line.removeprefix(row))]


def test_figures_of_the_readme_are_those_of_the_pages():
    text = (ROOT / 'README.md').read_text()
    rows = dict(re.findall(r'^\| \*\*\[(.+?)\].*?\*\*.*? \| (.+) \|$', text, re.M))
    trained = figures('Measured: a real spindle')
    drift = [trained[name][2] for name in ('uncompensated', 'static_ridge', 'default')]
    before, held, _, learnt, *_ = numbers('explanation/methods/thermal.md', 'spindle ch3')
    page = (ROOT / 'docs' / 'explanation' / 'linuxcnc-feedrate.md').read_text()
    advised = page.partition('### Corners and advice')[2].partition('\n## ')[0]
    programs = [
        (float(own), float(grid), float(best))
        for own, grid, best in re.findall(
            r'^\| `\w.+?` \| [\d.]+ / (\d+) \| ([\d.]+) / .+? \| ([\d.]+) / .+ \|$',
            advised,
            re.M,
        )
    ]
    assert len(programs) == 7
    error, grid, best = programs[0]
    assert rows == {
        'Trained': ' | '.join(f'{value:.1f} µm' for value in drift),
        'Learnt from hourly probes': f'{before:.1f} µm | {held:.1f} µm | {learnt:.1f} µm',
        'Feeds': f'{error:.0f} µm | {grid:.1f} s | {best:.1f} s',
    }
    saved = [100.0 * (1.0 - best / grid) for _, grid, best in programs]
    told = ' '.join(text.split())
    assert f'took {min(saved):.0f} to {max(saved):.0f} % less time' in told
    for place in range(5):  # a plain rule is beaten on each channel, not on the chosen one alone
        plain = min(trained[name][place] for name in ('least_squares', 'static_ridge'))
        assert trained['default'][place] < plain


def test_the_readme_is_short():
    """What is longer stands on a page of its own."""
    assert len((ROOT / 'README.md').read_text().split()) <= 450


@pytest.mark.slow
@pytest.mark.paper
def test_figures_of_the_mill_are_measured():
    measured: dict[str, list[np.ndarray]] = {}
    for seed in range(12):
        runs = record_runs(seed=seed)
        model = train_model([runs[name] for name in ('D0', 'D0b', 'T1')], random_state=seed)
        judged = [evaluate(model, runs[name]) for name in ('T2', 'T3')]
        for name in judged[0].largest:
            values = 1e6 * np.concatenate([item.largest[name] for item in judged])
            measured.setdefault(name, []).append(values)
    printed = figures('Measured: the simulated mill')
    # The classical form diverges in some seeds; its residuals are never asserted.
    assert set(printed) == set(measured)
    for name in set(printed) - {'classical_grey'}:
        found = np.median(measured[name], axis=0)
        np.testing.assert_allclose(found, printed[name], rtol=0.0, atol=FIGURE_TOLERANCE)
    default, uncompensated = printed['default'], printed['uncompensated']
    assert all(
        10.0 > 0.2 * before > now for now, before in zip(default, uncompensated, strict=True)
    )


@pytest.mark.slow
@pytest.mark.paper
def test_figures_of_the_real_spindle_are_measured(data):
    columns = np.genfromtxt(
        data / 'spindle-thermal' / 'spindle_thermal.csv', delimiter=',', names=True
    )
    sensors = tuple(f't{number}' for number in range(1, 17))
    channels = tuple(f'ch{number}' for number in range(1, 6))
    run = ThermalRun(
        name='spindle',
        time=columns['t'],
        sensor=sensors,
        temperature=np.column_stack([columns[name] for name in sensors]),
        channel=channels,
        axis=('X', 'X', 'Y', 'Y', 'Z'),
        displacement=1e-6 * np.column_stack([columns[name] for name in channels]),
        spindle_speed=columns['rpm'] * (2.0 * np.pi / 60.0),
    )
    model = train_model([run.window(0.0, 86850.0)])
    judged = evaluate(model, run, start=86865.0, stop=115650.0)
    printed = figures('Measured: a real spindle')
    assert set(printed) == set(judged.rms) - {'classical_grey'}
    for name, numbers in printed.items():
        found = 1e6 * judged.rms[name]
        np.testing.assert_allclose(found, numbers, rtol=0.0, atol=FIGURE_TOLERANCE)


CITATION = r'\[([a-z]+(?:\d{4}|_[a-z]+))\]'


def cited() -> dict[str, str]:
    """Return the first file that cites each key: [key] in text, a link to it on a page."""
    found: dict[str, str] = {}
    for path in (*(ROOT / 'fuzzycnc_ros').rglob('*.py'), *(ROOT / 'test').rglob('*.py')):
        text = path.read_text()
        if 'References\n' not in text and not re.search(CITATION, text):
            continue  # which spares most files the parser
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                keys = re.findall(CITATION, node.value)
                section = node.value.partition('References\n')[2]
                keys += re.findall(r'^ *\[([^\]\s]+)\]', section.partition('\n\n')[0], re.M)
                found |= {key: label(path) for key in keys if key not in found}
    for page in PAGES:
        for key in re.findall(r'bibliography\.md#(\w+)\)', page.read_text()):
            found.setdefault(key, label(page))
    return found


def test_every_source_that_is_cited_is_in_the_bibliography():
    entries = TABLES['bibliography']()
    missing = {key: where for key, where in cited().items() if key not in entries}
    assert not missing
    assert {'deng2014', 'ding_zeng', 'lin2021', 'kang2007', 'long2014'} <= set(entries)
    assert all({'author', 'title', 'used'} <= set(entry) for entry in entries.values())


def test_references_are_keys():
    """A section References of a docstring names keys; where they lead is in the bibliography."""
    entries = TABLES['bibliography']()
    for path in (ROOT / 'fuzzycnc_ros').rglob('*.py'):
        for body in re.findall(
            r'^ *References\n *-{10}\n(.*?)(?:\n\n|""")', path.read_text(), re.M | re.S
        ):
            keys = re.findall(r'\[(\w+)\]', body)
            assert keys, f'{label(path)}: expected keys of the bibliography but found {body!r}'
            assert set(keys) <= set(entries), label(path)


def test_every_command_is_in_the_table_of_jobs():
    pytest.importorskip('typer', reason="typer is missing: pip install 'fuzzycnc_ros[cli]'")
    from fuzzycnc_ros.cli.main import COMMANDS

    page = (ROOT / 'docs' / 'reference' / 'commands.md').read_text()
    assert set(COMMANDS) == set(re.findall(r'\| `fuzzycnc ([\w-]+)', page))
