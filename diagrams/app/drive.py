"""Teleoperated runs of a scenario: needle, phantom and controller are driven from a page."""

import itertools
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System
from rich.console import Console as Terminal

from sonoservo.diagrams.app.kept_runs.kept_run import KeptRun, refusing
from sonoservo.diagrams.app.own_tracker import OwnTracker, as_system
from sonoservo.diagrams.app.pages.pacer import Pacer
from sonoservo.diagrams.app.run import progress_bar
from sonoservo.diagrams.app.run_result import RunResult
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    make_insertion,
    placed_hand,
    settings_controls,
    tracker_events,
)
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.systems.control.controller_schedule import ControllerSchedule, OperatorSettings
from sonoservo.systems.display.console.controls import OperatorPanel, operator_controls
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.needle.hand import OperatorHand
from sonoservo.systems.robot.operator_phantom_motion import OperatorPhantomMotion
from sonoservo.systems.signals.search_reason import Reader

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_STRIDE = 1 / 16  # Time in s between two readings of the buttons: simulated, or real while paused
# Shortest drive in s that is saved to a file of its own; clicks may follow one another quickly.
_MIN_TRY = 1.0
DRIVING = """\
In the page, switch the keys on and press W to push the needle in, S to pull it out; or use the
sliders. ? lists all keys. Space pauses, and "finish" ends the drive as Ctrl-C does here."""
"""Instructions for the operator, shown in the terminal."""


class DrivenExperiment(FollowingExperiment):
    """Following experiment with a teleoperated needle, phantom and controller.

    The operator's actions, from the console's pages, replace the scenario's pushes, moves of the
    phantom and changes of the controller.
    """

    reader = Reader.OPERATOR

    def __init__(
        self,
        scenario: Scenario,
        console: "Console",
        meshcat: Meshcat | None = None,
        observers: Mapping[str, System] | None = None,
        tracker: System | None = None,
    ) -> None:
        scenario = require_scenario(scenario, FollowingScenario)
        hand = placed_hand(scenario)
        depth = round(hand.initial_depth or 0.0, 3)  # as the slider has it, in whole mm
        still = replace(
            scenario,
            hand=replace(hand, start=0.0, pushes=[], initial_depth=depth),
            phantom_motion=replace(scenario.phantom_motion, moves=[]),
            controller_changes=[],
        )
        needle_and_phantom = operator_controls(
            depth=depth, azimuth_deg=hand.azimuth_deg, dip_deg=hand.dip_deg
        )
        panel = OperatorPanel(
            controls=[*needle_and_phantom, *settings_controls(scenario.controller)],
            inputs=console.controls,
        )
        self._hand = OperatorHand(make_insertion=lambda pushes: make_insertion(still, pushes))
        self._phantom_motion = OperatorPhantomMotion(
            X_WT=scenario.station.X_WT, breathing=scenario.phantom_motion.breathing
        )
        self._settings = OperatorSettings(schedule=ControllerSchedule(scenario.controller.settings))
        super().__init__(
            still,
            meshcat,
            tracker=tracker,
            console=console,
            observers=observers,
            film=False,
            pictures=True,
            sources={
                "operator_panel": panel,
                "hand": self._hand,
                "phantom_motion": self._phantom_motion,
                "controller_settings": self._settings,
            },
        )

    def hint(self) -> str:
        """Return a hint for the operator; empty if there is none."""
        context = self.context_of(self._hand)
        if self._hand.is_held(context):
            return "aim it when it is outside"
        pushed = any(push.speed for push in self._hand.insertion(context).parameters.pushes)
        return "" if pushed else "press W to push the needle in: switch the keys on first"

    def happened(self) -> FollowingScenario:
        """Return the scenario that repeats the operator's actions so far."""
        context_of = self.context_of
        pushes = self._hand.insertion(context_of(self._hand)).parameters.pushes
        moves = self._phantom_motion.moves(context_of(self._phantom_motion))
        changes = self._settings.schedule(context_of(self._settings)).changes
        return replace(
            self.scenario,
            duration=max(self.time, _STRIDE),
            hand=replace(self.scenario.hand, pushes=pushes),
            phantom_motion=replace(self.scenario.phantom_motion, moves=moves),
            controller_changes=list(changes),
        )


def drive(
    scenario: Scenario,
    console: "Console",
    *,
    meshcat: Meshcat | None = None,
    tracker: OwnTracker | None = None,
    observers: Mapping[str, System] | None = None,
    out: Path | None = None,
    begin: Callable[[], None] | None = None,
    show: Callable[[float, str], None] | None = None,
    progress: bool | Terminal | None = None,
) -> RunResult:
    """Let an operator drive in real time, for the scenario's duration or until they finish.

    The folder gets scenario.yaml, the drive, which `run` repeats; scenario_1.yaml and so on, drives
    that were saved, abandoned by a restart, or made earlier; and the results of the run since its
    last start, which are returned. `tracker`, `begin` and `progress` are those of `run`, and `show`
    is called regularly with the simulated time in s and a status text. ConfigurationError if the
    scenario cannot be carried out.
    """
    own = None if tracker is None else as_system(tracker, **tracker_events(scenario))
    with refusing(scenario):
        experiment = DrivenExperiment(scenario, console, meshcat, observers, own)
    kept = KeptRun(experiment, out=out, meshcat=meshcat, console=console)
    bar = progress_bar(scenario, progress)
    shown = [each for each in (bar.show if bar else None, show) if each is not None]

    def set_aside() -> None:
        if begin is not None:
            begin()
        if out is not None and (out / "scenario.yaml").exists():  # of an earlier drive
            (out / "scenario.yaml").rename(out / _next_name(out))

    def simulate() -> None:
        start = True
        while start or experiment.time < scenario.duration:
            if start:
                kept.begin()
                experiment.start(real_time=True)
                pacer = Pacer(console, "restart", "save", "finish", speed=None)
                numbered = 0.0
            pressed = pacer.look(experiment.time)
            if "finish" in pressed:
                break
            if pressed & {"save", "restart"} and experiment.time >= numbered + _MIN_TRY:
                if out is not None:
                    write_atomically(out / _next_name(out), experiment.happened().to_yaml())
                numbered = experiment.time
            start = "restart" in pressed
            if start:
                continue
            if pacer.paused or pacer.late:
                experiment.forgive_delay()
            if pacer.paused:
                time.sleep(_STRIDE)
            else:
                experiment.advance(min(experiment.time + _STRIDE, scenario.duration))
            kept.go_on()
            hint = experiment.hint()
            console.say(note=hint)
            said = "; ".join(filter(None, ["paused" if pacer.paused else pacer.pace, hint]))
            for each in shown:
                each(experiment.time, said)

    return kept.carry_out(simulate, begin=set_aside, bar=bar)


def _next_name(out: Path) -> str:
    """Return the first unused name of the series scenario_1.yaml, scenario_2.yaml and so on."""
    names = (f"scenario_{number}.yaml" for number in itertools.count(1))
    return next(name for name in names if not (out / name).exists())
