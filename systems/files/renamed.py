"""Former names and places of fields, and removed fields, for errors about old files."""

from collections.abc import Container, Mapping

_RENAMED = {
    "angle_deviation_deg": "angle_std_deg",
    "depth": "feed.depth",
    "failure": "stop_probability",
    "first_deviation": "first_std",
    "first_drift": "first_drift_std",
    "first_speed": "first_speed_std",
    "force_noise": "wrist_sensor.force_noise",
    "kind": "experiment",
    "inlier_distance": "residual_threshold",
    "largest_deviation": "max_std",
    "greatest_angle_deg": "bend_angle_spread_deg",
    "greatest_radius": "bend_radius_spread",
    "largest_iterations": "max_trials",
    "lead": "feed.lead",
    "least_speed_deviation": "min_speed_std",
    "published": "published_figures",
    "min_radius": "bend_radius",
    "speed": "feed.speed",
    "torque_noise": "wrist_sensor.torque_noise",
    "transducer": "probe",
}
_REMOVED = {
    "anywhere": "must be left out: the tracker's field start sets it ('search' or 'anywhere')",
    "decibels_per_level": "must be left out: imaging.dynamic_range_db sets it",
    "tip_db": "must be left out: a tip returns what its faces and its wall mirror (tip, bevel_deg)",
    "friction": "must be left out: the phantom's contact.friction sets it",
}
_PREFIXES = {"least_": "min_", "largest_": "max_", "greatest_": "max_"}
_SUFFIXES = {"_deviation": "_std"}

_DIVIDED = ("kalman_filter", "axis_tip_filter")
"""Former parts of a tracker; some of their fields are now in ``filter`` and most in ``track``."""

_OF_FILTER = ("motion", "turning", "first_speed_std", "first_drift_std", "velocity_gate")


def current_name(name: str, known: Container[str]) -> str | None:
    """Return the present name of a field that was renamed, or None.

    Parameters
    ----------
    name
        Name of the field as found in a file.
    known
        Present names of the fields.
    """
    candidates = [_RENAMED.get(name, "")]
    for old, new in _PREFIXES.items():
        if name.startswith(old):
            candidates.append(new + name.removeprefix(old))
    for old, new in _SUFFIXES.items():
        if name.endswith(old):
            candidates.append(name.removesuffix(old) + new)
    return next((each for each in candidates if each.partition(".")[0] in known), None)


def moved_fields(path: str, value: object) -> dict[str, str]:
    """Return former and present paths of fields that moved; empty if none is known to have moved.

    Parameters
    ----------
    path
        Path of a field that no longer exists, as found in a file.
    value
        Value of the field. The fields of a mapping may have moved to different places.
    """
    *parents, name = path.split(".")
    if name == "order" and parents[-1:] == ["localizer"]:
        return {path: ".".join([*parents[:-1], name])}
    if name not in _DIVIDED or not isinstance(value, Mapping):
        return {}
    places = {}
    for key in value:
        now = current_name(key, _OF_FILTER) or key
        part = ["filter"] if now in _OF_FILTER else [] if now == "order" else ["track"]
        places[f"{path}.{key}"] = ".".join([*parents, *part, now])
    return places


def removed(name: str) -> str | None:
    """Return a hint on the replacement of a field that was removed, or None."""
    return _REMOVED.get(name)
