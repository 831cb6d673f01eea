"""Registry of the papers that ``sonoservo reproduce`` knows.

A new paper is a package beside this module that exports ``reproduce(options: StudyOptions) ->
Study``, and an entry here.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest

if TYPE_CHECKING:
    from sonoservo.diagrams.studies.study import StudyOptions
    from sonoservo.diagrams.studies.study_report import Study

PAPERS = ("carriere2016", "chatelain2013", "zhao2012")
"""Name of each paper's package."""

ALL = "all"
"""Name that stands for all papers on the command line."""


def require_paper(paper: str) -> None:
    """Raise ConfigurationError unless there is a reproduction of a paper."""
    if paper not in PAPERS:
        raise ConfigurationError(f"unknown paper {paper!r}; {suggest(paper, PAPERS)}")


def reproduce(paper: str, options: "StudyOptions") -> "Study":
    """Repeat a paper's experiments; its package is imported on demand.

    Parameters
    ----------
    paper
        Name of one of the `PAPERS`.
    options
        Folder, seeds and number of processes.

    Raises
    ------
    ConfigurationError
        If there is no reproduction of that paper.
    """
    require_paper(paper)
    study: Study = import_module(f"sonoservo.diagrams.papers.{paper}").reproduce(options)
    return study
