"""Title of Zhao 2012, names of the estimators, and the notes needed to interpret the rows."""

TITLE = (
    "Zhao, Liebgott and Cachard, Tracking biopsy needle using Kalman filter and RANSAC algorithm "
    "with 3D ultrasound (Acoustics 2012)"
)

NAMES = {
    "ransac_sample": "RANSAC, best sample",
    "ransac": "RANSAC",
    "published": "published RANSAC + Kalman + velocity",
    "ours": "our RANSAC",
    "kalman": "RANSAC + Kalman",
    "kalman_velocity": "RANSAC + Kalman + velocity",
}
"""Name of each estimator."""

NOTES = (
    "'RANSAC' is the published one. Among the brightest voxels of the whole volume, it finds the "
    "line through two of them with the most others nearby, optimizes it on those, and places the "
    "tip where the intensity along the line falls. Its best sample alone is shown too. 'Published "
    "RANSAC + Kalman + velocity' adds the published filter, whose first two volumes are RANSAC's, "
    "and the speckle's velocity with the published search region around the known tip. 'Our "
    "RANSAC' is the one in our tracker: it searches near the prediction and refits three times. "
    "Our Kalman filter uses it, and its search for the speckle is centred on the prediction.",
    "Fresh speckle: each run has a phantom of its own. Same volumes: all runs share one phantom "
    "and differ only in RANSAC's draws, as probably in the paper. A needle at rest is shown 5 "
    "times, unchanged.",
    "The scatterers have the published density of 10/mm3, 1.75 in a resolution cell at the focus. "
    "The density alone leaves the speckle undeveloped: the mean square of its intensity is 2.6 "
    "times the squared mean, and 2 for developed speckle. The amplitudes are equal; amplitudes "
    "with the published K distribution would raise it to 3.3. The lines have noise 40 dB below the "
    "tissue, which the paper does not mention.",
    "Errors count from the third volume on; before, the paper's filter returns RANSAC's result. A "
    "reduction compares the means, over lengths or volumes, of the root mean square over runs. "
    "Where an estimator found nothing, and in a failed run, it has the worst error of the others.",
    "Commanded: eq. 1's input B u, with u the change of the scripted speed, is given to the "
    "published filter; otherwise u is zero, as for a hand. The speed is judged inside the tracker, "
    "beside the difference of RANSAC's tips and the filter without velocimeter; no window is "
    "placed with the truth.",
    "The paper does not say how many volumes a second there are. Here, 0.3 s pass between them, so "
    "that its search for the speckle, which reaches 0.42 mm along the needle, holds a needle of "
    "1 mm/s. The sense of the needle's axis comes from the side on which it enters.",
    "The paper does not publish the noise of the filter, the thresholds, the definition of the "
    "angles or the position of the needle. Here, alpha is the azimuth from the array towards "
    "elevation, and beta the angle from the depth. Thresholding keeps 60 mm3 of voxels; the sweep "
    "shows what that decides. The published filter's R is (0.5 mm)^2 for the tip and the rear end "
    "and (2 mm/s)^2 for the velocity, its Q the same in every direction (published_tracking). The "
    "velocimeters compare envelopes of whole lines in the published windows; a match at the border "
    "of a search does not count.",
    "Loop: fig. 5 of Chatelain 2013 with its steel needle, at 3.3 MHz; this paper has no figures "
    "for it. Rows count as in the study of that paper: runs that lost the needle, or never found "
    "it, enter with their true error. As published in the loop: RANSAC in every whole volume among "
    "1000 mm3 of voxels with f_0 0.75 mm, the published filter in the probe's frame, and windows "
    "of the published extents around the known tip. The paper is silent on how a needle is found "
    "and moves no probe, so detection, end of a track and eq. 25 are those of Chatelain 2013 as "
    "published (Zhao2012AsPublishedParameters).",
    "Speed in the loop: after a first push at 9 mm/s, the speeds follow one another in one run. A "
    "tracked volume counts from 1 s after a change on. Without velocimeter: our tracker after "
    "Chatelain 2013, on the same seeds.",
)
"""Paragraphs of the report."""
