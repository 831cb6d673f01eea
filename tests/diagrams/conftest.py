"""Pictures are drawn where a test looks at them: drawing takes longer than a short run."""

import io

import pytest
from matplotlib.figure import Figure
from PIL import Image

DRAWN = ("test_run", "test_scan", "test_study_report", "test_interruption", "zhao2012")
"""Parts of the names of modules whose tests draw."""


def blank(figure, file, **options):
    """Write a picture of one dot."""
    buffer = io.BytesIO()
    Image.new("L", (1, 1)).save(buffer, "PNG")
    file.write(buffer.getvalue())


@pytest.fixture(scope="module", autouse=True)
def undrawn(request):
    """Leave out the drawing; what is in a figure is the same without it."""
    with pytest.MonkeyPatch.context() as patch:
        if not any(name in request.path.as_posix() for name in DRAWN):
            patch.setattr(Figure, "savefig", blank)
        yield
