from importlib import import_module

import pytest

from sonoservo.diagrams.papers import registry
from sonoservo.diagrams.published import PAPERS
from sonoservo.diagrams.studies.study import StudyOptions
from sonoservo.systems.files.refusals import ConfigurationError


@pytest.mark.parametrize("paper", PAPERS)
def test_every_paper_has_its_reproduction(paper):
    assert callable(import_module(f"sonoservo.diagrams.papers.{paper}.reproduction").reproduce)


def test_an_unknown_paper_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="did you mean 'zhao2012'"):
        registry.reproduce("zhao2021", StudyOptions(folder=tmp_path))
