"""Buttons that steer a simulation, in the page of a Meshcat."""

from collections.abc import Mapping

from pydrake.geometry import Meshcat


class RunButtons:
    """Buttons with keys; however often one is clicked between two looks, it counts once.

    Parameters
    ----------
    meshcat
        In whose page they are.
    buttons
        Label and key, as the browser names it, by name.
    """

    def __init__(self, *, meshcat: Meshcat, buttons: Mapping[str, tuple[str, str]]) -> None:
        self._meshcat = meshcat
        self._labels = {name: label for name, (label, _) in buttons.items()}
        for label, key in buttons.values():
            meshcat.AddButton(label, key)
        self._seen = {name: meshcat.GetButtonClicks(label) for name, label in self._labels.items()}

    def pressed(self) -> set[str]:
        """Return the names of the buttons that were pressed since the last look."""
        clicks = {
            name: self._meshcat.GetButtonClicks(label) for name, label in self._labels.items()
        }
        pressed = {name for name, count in clicks.items() if count != self._seen[name]}
        self._seen = clicks
        return pressed
