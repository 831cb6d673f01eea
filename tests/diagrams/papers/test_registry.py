import pytest

from sonoservo.diagrams.papers import registry
from sonoservo.diagrams.studies import StudyOptions
from sonoservo.systems.files.refusals import ConfigurationError


def test_an_unknown_paper_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="did you mean 'zhao2012'"):
        registry.reproduce("zhao2021", StudyOptions(folder=tmp_path))
