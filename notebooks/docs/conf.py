"""Settings of the documentation; `make docs` builds it."""

import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

import yaml
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.utils.math.latex2mathml import tex2mathml

sys.path.insert(0, str(Path(__file__).parent))

from reference import write_reference

from sonoservo.systems.files.writing import write_atomically

project = "sonoservo"
author = copyright = "the sonoservo authors"
release = version = version_of("sonoservo")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.doctest"]
html_theme = "furo"
html_static_path = ["wide.css"]
html_css_files = ["wide.css"]
exclude_patterns = ["_build"]
myst_heading_anchors = 3
html_math_renderer = "mathml"  # browsers draw it themselves: nothing comes from the network
myst_enable_extensions = ["dollarmath", "colon_fence"]
nb_execution_mode = "off"  # the notebooks hold their outputs
nb_merge_streams = True
autodoc_typehints = "signature"
napoleon_google_docstring = False
doctest_test_doctest_blocks = ""
suppress_warnings = ["myst.xref_missing", "ref.python"]

HERE = Path(__file__).parent
write_reference(HERE)
# The tutorials are the notebooks above this folder, to which the pages link.
(HERE / "tutorials").mkdir(exist_ok=True)
for page in (*HERE.parent.glob("[1-9]*.ipynb"), *HERE.parent.glob("*.png")):
    write_atomically(HERE / "tutorials" / page.name, page.read_bytes())


class PortsDirective(Directive):
    """Ports of a system, as Drake's documentation states them in docstrings."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return a list of the system's input and output ports."""
        system = yaml.safe_load("\n".join(self.content))
        block = nodes.bullet_list()
        for side in ("input_ports", "output_ports"):
            if ports := system.get(side):
                text = f"{side.replace('_', ' ')}: {', '.join(ports)}"
                block += nodes.list_item("", nodes.paragraph(text=text))
        return [block]


def _write_math(writer, node):
    writer.body.append(tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block)))
    raise nodes.SkipNode


def _link_tutorials(app, page, source):
    source[0] = re.sub(r"\]\(\.\./(?=\w+\.ipynb)", "](tutorials/", source[0])


def setup(app):
    """Add the directive, formulas as MathML, and links to the tutorials."""
    app.connect("source-read", _link_tutorials)
    app.add_directive("pydrake_system", PortsDirective)
    app.add_html_math_renderer("mathml", (_write_math, None), (_write_math, None))
