"""Registry of the papers and studies that ``sonoservo reproduce`` knows.

A new paper is a package beside this module, with a module `reproduction` that has a function
``reproduce(options: StudyOptions) -> Study``, and a line in `PAPERS`. A study of no paper is such a
package among the studies, and an entry here.
"""

from importlib import import_module
from typing import TYPE_CHECKING

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


def reproduce(paper: str, options: "StudyOptions") -> "Study":
    """Repeat the experiments of one of the `PAPERS` or `STUDIES`, and return the study."""
    require_paper(paper)
    room = "papers" if paper in PAPERS else "studies"
    study: Study = import_module(f"sonoservo.diagrams.{room}.{paper}.reproduction").reproduce(
        options
    )
    return study
