"""Title of the study of robustness, and the notes needed to interpret its rows."""

from sonoservo.systems.evaluation.conspicuity import STANDS_OUT_DB
from sonoservo.systems.evaluation.success import (
    ENOUGH_MM,
    FOUND_DEG,
    FOUND_MM,
    KEPT,
    SUCCESS_DEG,
    SUCCESS_MM,
)

TITLE = "Robustness: one dial of the harder world at a time, and all of them in the clinic"

NOTES = (
    "Three trackers: ours (chatelain2013), the published one (chatelain2013_as_published, in the "
    "columns as published) and zhao2012 (rows of its own). None of them is told what is wrong with "
    "the world, and all have their default parameters.",
    "With every dial off, a needle is pushed at 8 mm/s and 5 deg below the horizontal, 45 mm below "
    "a probe that is turned by 20 deg; 20 dB of diffuse echo. sonoservo list names the moderate "
    "strengths. A dial's strength is given in its own unit.",
    "Open loop: the probe is moved as planned, without a robot, and every tracker gets the same "
    "volumes with the same measured poses. The probe rests during the first push. Then it comes "
    "over the needle in 3 s, turns to it, and follows a second push. It rides on the breathing "
    "phantom, and presses it in by 4 mm. Errors of the probe's mass and of the force, and the "
    "friction, change nothing there; they are studied in the closed loop only. Joints have no part "
    "in it either, so the clinic lacks their error there.",
    "Closed loop: each tracker moves the probe itself, with our controller, at moderate strength; "
    "the published tracker thus has our controller, and not eq. 25 of its paper alone.",
    f"Found: a volume is tracked with the tip within {FOUND_MM:g} mm and the axis within "
    f"{FOUND_DEG:g} deg of the truth. Kept: this holds in {100 * KEPT:.0f} % of the volumes from "
    f"then on in which at least {ENOUGH_MM:g} mm of the needle stand {STANDS_OUT_DB:g} dB or more "
    "over the tissue around it, measured in the image along the true needle. Success: kept, and "
    f"median errors of at most {SUCCESS_MM:g} mm and {SUCCESS_DEG:g} deg in these volumes. A run "
    "that ends with an error is none.",
    "Errors are those of the estimate after each of these volumes, at the time for which it holds. "
    "With an error of the hand-eye calibration, they are those in the probe's frame; with a wrong "
    "speed of sound, those across the depth; in the clinic, both. A run in which the needle is not "
    "found, or that ends with an error, counts as one infinite error.",
    "A false start begins more than 10 mm from the needle, or without one. Finding a lost needle "
    "again is a start, too.",
    "Withdrawals: while the needle rests in view, the phantom moves by 2 to 4 cm within about a "
    "second. A second later, the needle is withdrawn at 15 to 30 mm/s until it is out. Travel "
    "after a needle that is not in the image is what the servo commands meanwhile.",
    "Clinic without a needle, an hour in all: our tracker moves the probe, and as long as it "
    "follows nothing, the probe moves to and fro over the phantom at up to 6 mm/s, as if it "
    "followed a needle. The other trackers see the same volumes in the first ten minutes; nothing "
    "follows them.",
    "Truth inside the stated 95 %: share of the volumes that count for the errors, and for which "
    "the tracker states an uncertainty, in which tip, axis or velocity (over 0.3 s) lies inside "
    "the stated ellipsoid. Runs in which the needle was not found have no such volumes. With an "
    "error of the hand-eye calibration, and with a wrong speed of sound, it is judged where the "
    "errors are.",
    "Threshold: the first strength studied at which less than 95 % of the runs succeed; its "
    "interval reaches from the strength before to it. Thresholds and curves rest on the scenes "
    "that all three trackers saw: ten at moderate strength, three at others, so that one failure "
    "is enough, and moderate strength is the likelier to fall. Our tracker has twenty more scenes "
    "at moderate strength, which count in its rows.",
    "Poses corrected: our tracker estimates delay and hand-eye error of its poses from tissue that "
    "stands still, and takes them out (PoseCorrector). It is compared with the poses as measured "
    "in the same scenes, in which a second push of 2 mm/s lasts 14 s.",
    "Intervals are 95 % intervals over runs: Wilson's for shares of runs, Poisson's for rates, and "
    "bootstraps of whole runs for errors and shares of volumes. Fewer than six runs give no "
    "bootstrap.",
)
"""Paragraphs of the report."""
