# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How Sphinx builds the site; `tools/make_docs.py` calls it and says what it adds to the pages."""

import re
from functools import cache
from pathlib import Path
from typing import Any

from bs4 import BeautifulSoup
from pygments.lexers.special import TextLexer

import fuzzycnc_ros

project = 'fuzzycnc'
author = 'The fuzzycnc authors'
copyright = author
version = release = fuzzycnc_ros.__version__

extensions = [
    'myst_nb',
    'sphinx.ext.autodoc',
    'sphinx.ext.autosectionlabel',
    'sphinx.ext.autosummary',
    'sphinx.ext.napoleon',
]
default_role = 'code'  # names in docstrings stand in single backticks
myst_heading_anchors = 4
nb_execution_mode = 'force'
nb_execution_raise_on_error = True
autosectionlabel_prefix_document = True

autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
autodoc_member_order = 'bysource'
autodoc_typehints = 'none'  # the docstrings say more: shapes and units
autodoc_default_options = {'members': True, 'show-inheritance': True}
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

# A word of a type that several classes have as an attribute, such as `sequence`
suppress_warnings = ['ref.python', 'autosummary.import_cycle', 'autosectionlabel.*']

BIBLIOGRAPHY = Path(__file__).parent / 'reference' / 'bibliography.bib'
KEYS = re.findall(r'^@\w+\{(\w+),', BIBLIOGRAPHY.read_text(encoding='utf-8'), re.M)
KEY = re.compile(rf'\[({"|".join(KEYS)})\]')

html_theme = 'furo'
html_title = f'fuzzycnc {version}'
templates_path = ['_templates']
html_static_path = ['_static']
html_css_files = ['site.css']
html_search_scorer = str(Path(__file__).parent / '_static' / 'scorer.js')
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_search_summary = False  # a browser reads no other file of a site that is opened as files


def plain(app: Any, what: str, name: str, item: Any, options: Any, lines: list[str]) -> None:
    """Link keys of the bibliography, and keep |x| and names that end in _ as they are."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith(('>>>', '...')):
            parts = re.split(r'(`+[^`]*`+)', line)
            parts[::2] = [re.sub(r'\||(?<=\w)_(?!\w)', r'\\\g<0>', part) for part in parts[::2]]
            lines[number] = KEY.sub(r':ref:`[\1] <reference/bibliography:\1>`', ''.join(parts))


def left_out(app: Any, what: str, name: str, item: Any, skip: bool, options: Any) -> bool | None:
    """Leave out what scikit-learn adds to every estimator."""
    module = getattr(item, '__module__', None) or ''
    return True if module.startswith('sklearn') or re.fullmatch(r'set_\w+_request', name) else None


def sort_objects(app: Any, env: Any) -> None:
    """Let no link of an ambiguous word depend on which of the parallel readers ends first."""
    objects = env.domaindata['py']['objects']
    ordered = sorted(objects.items())
    objects.clear()
    objects.update(ordered)


@cache
def tree(builder: Any, **options: Any) -> str:
    """Return the tree of all pages as the page `index` has it, where none is the current one."""
    return str(builder._get_local_toctree('index', **options))


def share_tree(app: Any, page: str, template: str, context: Any, doctree: Any) -> None:
    """Let all pages share one tree; Sphinx copies the whole one anew for each of them."""
    uri = app.builder.get_relative_uri

    def toctree(**options: Any) -> str:
        soup = BeautifulSoup(tree(app.builder, **options), 'html.parser')
        for link in soup.find_all('a'):
            name = link['href'].removesuffix('.html')
            link['href'] = uri(page, name) or '#'
            if name == page:
                link['class'].insert(0, 'current')
                for item in link.find_parents(['li', 'ul']):
                    item['class'] = [*item.get('class', []), 'current']
        return str(soup)

    context['toctree'] = toctree


def setup(app: Any) -> None:
    """Connect the above."""
    app.connect('autodoc-process-docstring', plain, priority=400)  # before napoleon
    app.connect('autodoc-skip-member', left_out)
    app.connect('env-updated', sort_objects)
    app.connect('html-page-context', share_tree, priority=400)  # before furo asks for the tree
    app.add_lexer('iecst', TextLexer)  # structured text, which Pygments does not know
