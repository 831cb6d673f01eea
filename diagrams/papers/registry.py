"""Registry of the papers and studies that ``sonoservo reproduce`` knows.

A new paper is a package beside this module that exports ``reproduce(options: StudyOptions) ->
Study``, and an entry here. A study of no paper is such a package among the studies.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest

if TYPE_CHECKING:
    from sonoservo.diagrams.studies.study import StudyOptions
    from sonoservo.diagrams.studies.study_report import Study

PAPERS = ("carriere2016", "chatelain2013", "zhao2012")
"""Name of each paper's package."""

STUDIES = ("robustness",)
"""Name of the package of each study that belongs to no paper."""

ALL = "all"
"""Name that stands for all papers on the command line; studies of no paper do not belong to it."""


def require_paper(paper: str) -> None:
    """Raise ConfigurationError unless there is a reproduction of a paper, or a study, of a name."""
    known = (*PAPERS, *STUDIES)
    if paper not in known:
        raise ConfigurationError(f"unknown paper {paper!r}; {suggest(paper, known)}")


def study_folder(paper: str) -> Path:
    """Return the folder of the package of a paper or study."""
    return Path(__file__).resolve().parents[1] / _room(paper) / paper


def study_module(paper: str) -> str:
    """Return the name of the module that makes the results of a paper or study."""
    return f"sonoservo.diagrams.{_room(paper)}.{paper}.reproduction"


def _room(paper: str) -> str:
    return "papers" if paper in PAPERS else "studies"


def reproduce(paper: str, options: "StudyOptions") -> "Study":
    """Repeat the experiments of a paper or study; its package is imported on demand.

    Parameters
    ----------
    paper
        Name of one of the `PAPERS` or `STUDIES`.
    options
        Folder, seeds and number of processes.

    Raises
    ------
    ConfigurationError
        If there is no such paper or study.
    """
    require_paper(paper)
    study: Study = import_module(study_module(paper).rpartition(".")[0]).reproduce(options)
    return study
