"""The click of a person on the needle in a run's first slice."""

from dataclasses import replace

from rich.console import Console as Terminal

from sonoservo.diagrams.app.kept_runs.kept_run import refusing
from sonoservo.diagrams.app.options import Page
from sonoservo.diagrams.app.pages.pages import announce, open_site
from sonoservo.diagrams.experiments.shape_prediction import ShapePredictionExperiment
from sonoservo.diagrams.experiments.shape_prediction_scenario import ShapePredictionScenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.systems.display.pages.click_page import ClickPage
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.image_slice import ImageSlice


def ask_click(scenario: Scenario, terminal: Terminal, page: Page) -> ShapePredictionScenario:
    """Return the scenario with the place at which a person clicks in the first slice."""
    predicted = require_scenario(scenario, ShapePredictionScenario)
    with terminal.status("Acquiring the first slice ..."):
        image = first_slice(predicted)
    with open_site(page) as site:
        clicked = ClickPage(site, image)
        announce(terminal, "Click on the needle at", clicked.web_url, page)
        x, y = clicked.wait()
    terminal.print(f"The needle's first cross-section: x {1e3 * x:.2f} mm, depth {1e3 * y:.2f} mm.")
    start = [round(float(x), 6), round(float(y), 6)]
    return replace(predicted, tracker=replace(predicted.tracker, start=start))


def first_slice(scenario: ShapePredictionScenario) -> ImageSlice:
    """Return the first slice of a run, the one in which its tracker starts."""
    with refusing(scenario):
        experiment = ShapePredictionExperiment(scenario)
    experiment.start()
    for number in range(1, scenario.steps + 2):
        experiment.advance(number * scenario.period + scenario.processing_time)
        image = experiment.evaluate(experiment.slice_converter, "slice")
        if isinstance(image, ImageSlice):
            return image
    raise ConfigurationError("there is no slice to click in: the scanner loses all of them")
