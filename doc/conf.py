# SPDX-License-Identifier: Apache-2.0
"""Settings of the site that scripts/site builds from these pages."""

from pathlib import Path
import re
import sys
from xml.etree import ElementTree

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

manifest = ElementTree.parse(ROOT / 'package.xml')
project = 'herding_ros'
author = manifest.findtext('maintainer')
copyright = f'{author}, Apache-2.0'
version = release = manifest.findtext('version')

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinxcontrib.mermaid']
root_doc = 'index'
exclude_patterns = ['_build']

# The pages are those that GitHub shows, which knows these two without a directive.
myst_enable_extensions = ['dollarmath']
myst_fence_as_directive = ['mermaid']
myst_heading_anchors = 4
suppress_warnings = ['myst.header']  # pages of studies begin their sections at the third level

autodoc_member_order = 'bysource'
autodoc_preserve_defaults = True
autodoc_type_aliases = {'Array': 'Array', 'Policy': 'Policy'}
default_role = 'code'

html_theme = 'furo'
html_title = f'herding_ros {version}'
html_show_sphinx = False
html_math_renderer = 'mathml'


def take_as_plain_text(_app, _what, _name, _object, _options, lines):
    """Leave bars of absolute values alone, which would begin a substitution."""
    lines[:] = [line.replace('|', r'\|') for line in lines]


def write_formula(writer, node):
    """Write a formula as MathML, which browsers show without a script from the network."""
    # Parentheses grow by themselves, 2,0 is taken for one number, and without a font for formulas
    # a bar is in the letter.
    formula = re.sub(r'\\[Bb]ig(?![a-z])', '', node.astext()).replace(',', ', ')
    formula = formula.replace(r'\dots', r'\ldots').replace(r'\bar', r'\overline')
    writer.body.append(tex2mathml(formula, as_block=node.tagname == 'math_block'))
    raise SkipNode


def setup(app):
    """Connect to Sphinx."""
    app.add_html_math_renderer('mathml', (write_formula, None), (write_formula, None))
    app.connect('autodoc-process-docstring', take_as_plain_text)
