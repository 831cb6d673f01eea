"""Settings of the tests, which run the notebooks in a short form."""

import os

os.environ["SONOSERVO_QUICK"] = " ".join(
    [
        "duration=4.8",
        "hand.start=0.2",
        "hand.pushes.0.speed=0.02",
        "station.probe.height=0.004",
        "station.plant.contact_model=point",
        "imaging.sector=0.5",
        "imaging.frames=11",
    ]
)
