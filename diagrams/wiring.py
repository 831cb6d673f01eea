"""Wiring of a diagram by port names, which keeps the truth from trackers and controllers."""

from collections.abc import Container, Mapping

from pydrake.systems.framework import DiagramBuilder, OutputPort, System

TRUTH = frozenset(
    {
        "X_WT",
        "contact_force",
        "deformation",
        "motion_record",
        "needle",
        "needle_target",
        "phantom_command",
        "phantom_target",
        "pushed_needle",
        "query_object",
        "true_X_WP",
    }
)
"""Names of the ports that carry the truth, which the simulator knows but no scanner provides."""


def connect_by_name(
    builder: DiagramBuilder,
    systems: Mapping[str, System],
    *,
    optional: Container[str] = (),
    sees_truth: Container[str] = (),
) -> None:
    """Connect every input port to the output port of the same name.

    Parameters
    ----------
    builder
        Builder that holds the systems.
    systems
        Systems to connect, by name.
    optional
        Names of input ports that stay unconnected if there is no such output.
    sees_truth
        Names of the systems that may read the truth (`TRUTH`): world, renderer, logger and
        displays, but never a tracker or a controller.

    Raises
    ------
    ValueError
        If two outputs have the same name, an input has no output, or a system asks for the truth
        without being allowed to see it.
    """
    outputs: dict[str, tuple[str, OutputPort]] = {}
    for name, system in systems.items():
        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            other, _ = outputs.setdefault(port.get_name(), (name, port))
            if other != name:
                raise ValueError(
                    f"{other} and {name} both have an output {port.get_name()!r}; "
                    "rename one of them, as outputs are connected by name"
                )
    for name, system in systems.items():
        for index in range(system.num_input_ports()):
            port = system.get_input_port(index)
            wanted = port.get_name()
            if wanted in TRUTH and name not in sees_truth:
                raise ValueError(
                    f"{name} has an input {wanted!r}, which is the truth; "
                    "trackers and controllers must not read it"
                )
            if wanted in outputs:
                builder.Connect(outputs[wanted][1], port)
            elif wanted not in optional:
                raise ValueError(
                    f"{name} has an input {wanted!r}, but there is no such output; "
                    f"there are {', '.join(sorted(outputs.keys() - TRUTH))}"
                )
