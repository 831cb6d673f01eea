"""Output files of a run of any experiment."""

import os
import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.geometry import Meshcat

from sonoservo.diagrams.app.run_result import RunResult
from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.presenter import Presenter
from sonoservo.diagrams.experiments.registry import present
from sonoservo.diagrams.experiments.scenario_changes import base_of, changed_fields
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.evaluation.compile_free_clock import CompileFreeClock
from sonoservo.systems.evaluation.explanation.explained_volume import clear_explanations
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.evaluation.reports.movie import write_movie
from sonoservo.systems.evaluation.reports.report import Story, save_replay
from sonoservo.systems.evaluation.reports.track_plots import write_pictures
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import (
    Unwritten,
    claim_folder,
    write_atomically,
    write_json,
)

if TYPE_CHECKING:
    from sonoservo.diagrams.app.terminal import Progress
    from sonoservo.systems.display.console.console import Console

_SAVE_EVERY = 10.0  # Wall-clock time in s after which log and scenario are saved again
PICTURES = "slices.npz"
"""File with the slices through the needle of every volume."""

# Results that do not stay beside those of a newer run.
_RESULTS = ("summary.json", "log.npz", PICTURES, "report.html", "replay.html")


@contextmanager
def refusing(scenario: Scenario) -> Iterator[None]:
    """Convert errors of a scenario's blocks to a ConfigurationError that names the scenario."""
    try:
        with refusing_failures(scenario.name):
            yield
    except ConfigurationError as error:
        if str(error).startswith(scenario.name):
            raise
        raise ConfigurationError(f"{scenario.name}: {error}") from error


class KeptRun:
    """A run that writes its scenario at the start, its log in any case, and its results at the end.

    Until the end, its summary says that it was interrupted, so that this is true whatever ends it.
    An interruption from the keyboard, or a recording that cannot be written, ends the simulation
    but not the program. Without ``out``, no file is written. `unwritten` collects the errors of
    files.
    """

    def __init__(
        self,
        experiment: Experiment[Any],
        *,
        out: Path | None = None,
        meshcat: Meshcat | None = None,
        movie: Path | None = None,
        console: "Console | None" = None,
    ) -> None:
        self._experiment, self.scenario = experiment, experiment.scenario
        self.out, self._meshcat, self._movie, self._console = out, meshcat, movie, console
        self._clock = CompileFreeClock()
        self.interrupted = False
        self.unwritten = Unwritten()

    def carry_out(
        self,
        simulate: Callable[[], None],
        *,
        begin: Callable[[], None] | None = None,
        bar: "Progress | None" = None,
    ) -> RunResult:
        """Simulate, and write the output files; ``begin`` is called when the folder is claimed."""
        with claim_folder(self.out):
            if begin is not None:
                begin()
            if self.out is not None:
                for name in _RESULTS:  # of an earlier run
                    (self.out / name).unlink(missing_ok=True)
                clear_explanations(self.out)
                write_json(self.out / "summary.json", self._head(wall=0.0, interrupted=True))
                write_atomically(self.out / "scenario.yaml", self.scenario.to_yaml())
            self._saved = time.perf_counter()
            with bar or nullcontext(), self._clock:
                self.begin()
                try:
                    with closing(self._experiment):
                        simulate()
                except KeyboardInterrupt:
                    self.interrupted = True
                except OSError as error:
                    self.unwritten.note(error)
                finally:
                    self._wall = self._clock() - self._started
                    if self._console is not None:
                        self._console.end(self._end_words())
                    self._save()
            return self._finish()

    def begin(self) -> None:
        """Start clock and replay, or restart them during a run; compilation does not count."""
        if self._meshcat is not None:
            self._meshcat.DeleteRecording()
            self._meshcat.StartRecording(set_visualizations_while_recording=True)
        self._started = self._clock()

    def go_on(self) -> None:
        """Save the run so far if the last time was long ago; call this regularly."""
        if time.perf_counter() - self._saved > _SAVE_EVERY:
            self._save()

    def _finish(self) -> RunResult:
        """Summarise a run that has ended, and write its output files."""
        experiment = self._experiment
        log = experiment.log()
        head = self._head(wall=self._wall, interrupted=self.interrupted)
        head["real_time_factor"] = experiment.time / self._wall
        summary = {**head, **experiment.summarize(log)}
        if self.out is not None:  # first, as little time may be left to an interrupted run
            with self.unwritten.collect():
                write_json(self.out / "summary.json", summary)
        presenter = present(experiment)
        result = RunResult(
            summary=summary,
            log=log,
            labels=presenter.labels,
            results=experiment.results(),
            verdict=presenter.verdict(summary),
            published=experiment.happened().published_figures,
            plots=presenter.plots(log),
        )
        self._write(result, presenter)
        return replace(result, failure=self.unwritten.failure)

    def _end_words(self) -> str:
        """Return the end in words that stay true if a page hears nothing more."""
        words = f"{self._experiment.time:.1f} s simulated"
        return words if self.out is None else f"{words}; the results go to {self.out}"

    def _head(self, *, wall: float, interrupted: bool) -> dict[str, Any]:
        """Return the figures of a summary that do not need the log."""
        return {
            "scenario": self.scenario.name,
            "seed": self.scenario.seed,
            "version": version("sonoservo"),
            "interrupted": interrupted,
            "simulated_s": self._experiment.time,
            "wall_s": wall,
            "compile_s": self._clock.compiled,
        }

    def _write(self, result: RunResult, presenter: Presenter) -> None:
        """Write pictures, plots, report.html, movie and, with a Meshcat, replay.html."""
        log, experiment = result.log, self._experiment
        if self._movie is not None:
            with self.unwritten.collect():
                write_movie(self._movie, presenter.frames(log), presenter.frame_rate)
        if self.out is None:
            return
        if pictures := experiment.pictures:
            with self.unwritten.collect():
                write_pictures(self.out / PICTURES, pictures)
        links = {}
        if self._meshcat is not None:
            with self.unwritten.collect():
                save_replay(self._meshcat, self.out / "replay.html")
            links["replay.html"] = "Watch the replay in 3D"
        if self._movie is not None:
            links[os.path.relpath(self._movie, self.out)] = "Watch the movie"
        base, name = base_of(self.scenario)
        path = f"{self.out}/scenario.yaml"
        story = Story(
            scenario=presenter.words(),
            base=name,
            changes=changed_fields(base, self.scenario),
            command=shlex.join(["sonoservo", "run", path]) if experiment.repeatable else "",
            links=links,
        )
        result.write_report(self.out, self.unwritten, story, presenter.key_frames(log))

    def _save(self) -> None:
        if self.out is not None:
            with self.unwritten.collect():
                head = self._head(wall=self._clock() - self._started, interrupted=True)
                write_json(self.out / "summary.json", head)
                write_log(self.out / "log.npz", self._experiment.log())
                # which a console may have changed
                write_atomically(self.out / "scenario.yaml", self._experiment.happened().to_yaml())
        self._saved = time.perf_counter()
