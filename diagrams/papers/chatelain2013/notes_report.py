"""Title of Chatelain 2013, and the notes needed to interpret the rows of its reproduction."""

TITLE = (
    "Chatelain, Krupa and Marchal, Real-time needle detection and tracking using a visually "
    "servoed 3D ultrasound probe (ICRA 2013)"
)
NOTES = (
    "The paper shows one run of each experiment, on one phantom, and estimated errors only. Here, "
    "ground truth comes from the simulator; neither tracker nor controller reads it.",
    "As published: the whole published method and nothing of ours, on the same seeds. Consecutive "
    "sweeps of one direction are compared while the probe stands, one admissible entry point "
    "starts the track, the filter works in the probe's frame, eq. 25 alone moves the probe and its "
    "command is held between volumes, nothing checks a measurement, and a lost needle is not found "
    "again. The force law and the guard of the robot are ours.",
    "Where the paper is silent, the choice was made with figs. 4 to 6 on seeds from 100 on, or is "
    "that of our method. Detection: 5 mm3 of candidates, tau (27 mm)^2, delta 10 mm; the faces "
    "are those of the swept sector (PublishedDetectionParameters). Localization: 400 mm3 of "
    "candidates in a region of 10 mm around the prediction, 20 mm around a detected entry, alpha_0 "
    "35 deg, "
    "tracking from 10 mm on; discarded draws do not count; the needle ends 6 dB above its "
    "surroundings, after gaps of 3 mm at most (PublishedLocalizationParameters). Filter: R and Q "
    "are the same for all control points. A track ends below 10 mm or after 10 volumes without a "
    "measurement (PublishedLifecycle). lambda is 0.8/s (FollowingScenario.as_published).",
    "Sweeps to and fro differ by more than a needle of 2.5 mm/s changes between them. Between "
    "sweeps of one direction, 5 mm3 spread by 24, 13 and 1 mm with a needle of 2 to 25 mm (medians "
    "of fig. 4, seeds 100 and 101, and fig. 5, seed 101), and by no less than 34 mm without one. "
    "1 to 2 mm3 lie close together without a needle, too; 20 mm3 spread as far with a needle of "
    "2.5 mm/s as without.",
    "Open: the published method with other values of what the paper leaves open; those of alpha_0 "
    "in fig. 6, the others in fig. 5.",
    "Errors are those of the estimate after each volume, at the time for which it holds, over all "
    "volumes of all runs with at least 20 mm of the needle in the image. A volume without an "
    "estimate counts as an infinite error, and a failed run as one more run of such volumes. "
    "At rest, all samples of a run count whether or not the needle is tracked, first of the runs "
    "that converged, and then of all, as a median. Without an estimate, the true error takes the "
    "place of the estimated one, and a failed run has the worst run's error. "
    "Lost: the tracker searches although more than 15 mm are in the image.",
    "Intervals are 95 % intervals over runs: Wilson's for shares, Poisson's for numbers of events, "
    "and bootstraps of whole runs for quantiles and means. Fewer than six runs give none.",
    "Converged: the needle is tracked, and its true |X| and |Z| are below 2 mm and |Theta| below "
    "2 deg throughout the last second of the run (bent: X and Z only). Back after a move of the "
    "phantom: the same for half a second, before the next move.",
    "Bent: fig. 5 with a needle of bevel radius 150 to 400 mm, bent to any side, 0 to 40 deg out "
    "of the horizontal, and a curve of order 3. The deviation is the largest distance between the "
    "true and the estimated curve in the image, in both directions, from the estimated entry on.",
    "Computing times are those of one thread while the study's other processes run.",
)
"""Paragraphs of the report."""
