# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""`fuzzycnc security`: policies of SROS2, one for each node."""

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from xml.etree import ElementTree

import typer

from fuzzycnc_ros.cli.completion import node_names, some_of
from fuzzycnc_ros.cli.console import say, words, write_text

if TYPE_CHECKING:
    from fuzzycnc_ros.graph.access import Access

HELP = """Write access rights: each node may do only what it needs.

    fuzzycnc security write policies --machine mill

See docs/how-to/security.md. It needs a ROS 2 installation whose middleware has security.
"""

VERSION = '0.2.0'
"""Version of the format of policies."""
RULES: tuple[tuple[str, str, str], ...] = (
    ('publish', 'topics', 'topic'),
    ('subscribe', 'topics', 'topic'),
    ('reply', 'services', 'service'),
    ('request', 'services', 'service'),
    ('execute', 'actions', 'action'),
    ('call', 'actions', 'action'),
)
"""Field of `Access` and rule of a policy, with its elements."""
_NAMESPACE = re.compile(r'[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
_TOPIC = re.compile(r'(/[A-Za-z_][A-Za-z0-9_]*)+')


def write(
    folder: Annotated[
        Path, typer.Argument(metavar='DIR', help='Folder for the policies; made if missing.')
    ],
    machine: Annotated[
        str,
        typer.Option(help='Name of the machine: the namespace of its nodes. Several with commas.'),
    ] = 'mill',
    nodes: Annotated[
        str,
        typer.Option(
            metavar='NODE,...',
            show_default=False,
            help='Nodes, with commas; without it all but simulated_machine, simulated_body and '
            'player, which only stand in for a machine.',
            autocompletion=some_of(node_names),
        ),
    ] = '',
    subscribe: Annotated[
        list[str],
        typer.Option(
            metavar='NODE=/TOPIC',
            help='A topic from outside of the machine that a node reads too; may be given '
            'several times.',
        ),
    ] = [],  # noqa: B006 - typer reads it, nobody changes it
    keystore: Annotated[
        Path, typer.Option(help='Keystore in the commands that are printed.')
    ] = Path('keystore'),
) -> None:
    """Write a policy for each node, and print the commands that put them into force.

    What a node may publish, read, offer and call follows from its declaration; everything else
    is forbidden. Files that are there are written anew.

        fuzzycnc security write policies --machine mill

    Where another node publishes temperatures:

        fuzzycnc security write policies --subscribe temperature_acquisition=/plc/spindle
    """
    from fuzzycnc_ros.graph.access import PRETENDERS, TOOLS, access_of
    from fuzzycnc_ros.registry import COMPONENTS

    machines = words([machine])
    wrong = [name for name in machines if not _NAMESPACE.fullmatch(name)]
    if wrong or not machines:
        raise ValueError(
            '--machine: expected a namespace without leading slash, such as mill, but found '
            f'{wrong[0] if wrong else machine!r}'
        )
    chosen = words([nodes]) or [n for n in (*COMPONENTS, *TOOLS) if n not in PRETENDERS]
    granted = {node: access_of(node) for node in chosen}
    outside = _outside(subscribe, granted)
    commands: list[tuple[object, ...]] = [('create_keystore', keystore)]
    for name in machines:
        for node, access in granted.items():
            enclave = f'/{name}/{node}'
            file = folder / name / f'{node}.policy.xml'
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, policy(name, node, access, outside.get(node, ())))
            commands.append(('create_enclave', keystore, enclave))
            commands.append(('create_permission', keystore, enclave, file))
    say(f'# {len(machines) * len(granted)} policies in {folder}; on the ROS 2 installation:')
    for command in commands:
        say(shlex.join(['ros2', 'security', *map(str, command)]))


def policy(machine: str, node: str, access: 'Access', outside: Sequence[str] = ()) -> str:
    """Return the policy of one node as XML.

    Parameters
    ----------
    machine : str
        Namespace of the node, without leading slash.
    node : str
        Its name.
    access : Access
        What it may do.
    outside : sequence of str
        Further topics that it may read, absolute names.
    """
    from fuzzycnc_ros.graph.access import OPERATOR, Access

    root = ElementTree.Element('policy', version=VERSION)
    enclaves = ElementTree.SubElement(root, 'enclaves')
    enclave = ElementTree.SubElement(enclaves, 'enclave', path=f'/{machine}/{node}')
    profiles = ElementTree.SubElement(enclave, 'profiles')
    _add_profile(profiles, f'/{machine}', node, access, outside)
    if node == OPERATOR:
        # To look at several machines it stands outside of all of them.
        reply = tuple(name for name in access.reply if name.startswith('~/'))
        _add_profile(profiles, '/', node, Access(publish=('/rosout',), reply=reply))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding='unicode')
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _add_profile(
    profiles: ElementTree.Element,
    namespace: str,
    node: str,
    access: 'Access',
    outside: Sequence[str] = (),
) -> None:
    profile = ElementTree.SubElement(profiles, 'profile', ns=namespace, node=node)
    for rule, group, item in RULES:
        names = [*getattr(access, rule), *(outside if rule == 'subscribe' else ())]
        if not names:
            continue
        place = ElementTree.SubElement(profile, group, {rule: 'ALLOW'})
        for name in sorted(set(names)):
            ElementTree.SubElement(place, item).text = name


def _outside(texts: Sequence[str], granted: 'Mapping[str, Access]') -> dict[str, list[str]]:
    """Return the topics from outside by node.

    Raises
    ------
    ValueError
        If a text has another form, or names a node that gets no policy.
    """
    found: dict[str, list[str]] = {}
    for text in texts:
        node, _, topic = text.partition('=')
        if node not in granted or not _TOPIC.fullmatch(topic):
            raise ValueError(
                '--subscribe: expected NODE=/TOPIC such as temperature_acquisition=/plc/spindle, '
                f'with a node among {", ".join(granted)}, but found {text!r}'
            )
        found.setdefault(node, []).append(topic)
    return found


COMMANDS: dict[str, Callable[..., Any]] = {'write': write}
