"""Settings of the documentation; `make docs` builds it."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

import yaml
from docutils import nodes
from docutils.parsers.rst import Directive

sys.path.insert(0, str(Path(__file__).parent))

from field_reference import write_reference

project = "sonoservo"
author = copyright = "the sonoservo authors"
release = version = version_of("sonoservo")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.doctest"]
html_theme = "furo"
exclude_patterns = ["_build"]
myst_heading_anchors = 3
autodoc_typehints = "signature"
autodoc_mock_imports = ["pyigtl"]
napoleon_google_docstring = False
doctest_test_doctest_blocks = ""
suppress_warnings = ["myst.xref_missing", "ref.python"]

write_reference(Path(__file__).parent / "fields.md")


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


def setup(app):
    """Add the directive."""
    app.add_directive("pydrake_system", PortsDirective)
