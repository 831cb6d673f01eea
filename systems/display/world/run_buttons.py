"""Buttons in a Meshcat page that control a simulation."""

from collections.abc import Mapping

from pydrake.geometry import Meshcat


class RunButtons:
    """Buttons with keyboard shortcuts; several clicks between two readings count once.

    Parameters
    ----------
    meshcat
        Meshcat whose page shows the buttons.
    buttons
        Label and key of each button, by its name; keys are named as the browser names them.
    """

    def __init__(self, *, meshcat: Meshcat, buttons: Mapping[str, tuple[str, str]]) -> None:
        self._meshcat = meshcat
        self._labels = {name: label for name, (label, _) in buttons.items()}
        for label, key in buttons.values():
            meshcat.AddButton(label, key)
        self._seen = {name: meshcat.GetButtonClicks(label) for name, label in self._labels.items()}

    def pressed(self) -> set[str]:
        """Return the names of the buttons that were pressed since the last call."""
        clicks = {
            name: self._meshcat.GetButtonClicks(label) for name, label in self._labels.items()
        }
        pressed = {name for name, count in clicks.items() if count != self._seen[name]}
        self._seen = clicks
        return pressed
