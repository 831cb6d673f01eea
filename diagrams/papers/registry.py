"""Registry of the papers and studies that ``sonoservo reproduce`` knows.

A new paper is a package beside this module, and a line in `PAPERS`. Its module `reproduction` has a
function ``run(options: StudyOptions) -> list[Outcome]``, and its module `report` a function
``report(outcomes, folder=None) -> Study``. A study of no paper is such a package among the studies,
and an entry here.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from rich.console import Console

from sonoservo.diagrams.published import PAPERS
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest

if TYPE_CHECKING:
    from sonoservo.diagrams.studies.study import StudyOptions
    from sonoservo.diagrams.studies.study_report import Study

STUDIES = ("robustness",)
"""Name of the package of each study that belongs to no paper."""

ALL = "all"
"""Name that stands for all papers on the command line; studies of no paper do not belong to it."""


def require_paper(paper: str) -> None:
    """Raise ConfigurationError unless there is a reproduction of a paper, or a study, of a name."""
    known = (*PAPERS, *STUDIES)
    if paper not in known:
        raise ConfigurationError(f"unknown paper {paper!r}; {suggest(paper, known)}")


def module_of(paper: str, name: str) -> ModuleType:
    """Return the module ``reproduction`` or ``report`` of one of the `PAPERS` or `STUDIES`."""
    require_paper(paper)
    room = "papers" if paper in PAPERS else "studies"
    return import_module(f"sonoservo.diagrams.{room}.{paper}.{name}")


def reproduce(paper: str, options: "StudyOptions") -> "Study":
    """Repeat the experiments of one of the `PAPERS` or `STUDIES`, and return the study."""
    outcomes = module_of(paper, "reproduction").run(options)
    with (options.console or Console(quiet=True)).status("Making the report ..."):
        study: Study = module_of(paper, "report").report(outcomes, options.folder)
        return study
