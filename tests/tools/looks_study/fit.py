"""Conditional logit of the looks, and its score on volumes that were not fitted."""

import numpy as np
from scipy.optimize import minimize

RIDGE = 0.3
"""Weight of the squared weights of standardised looks, against chance."""


def probabilities(odds, volume, count):
    """Probabilities that lines are needles, and (v,) that there is none.

    A volume has one needle or none: with log odds o, a line has exp(o) / (1 + the sum of all).
    """
    top = np.zeros(count)
    np.maximum.at(top, volume, odds)
    shares = np.exp(odds - top[volume])
    total = np.exp(-top) + np.bincount(volume, shares, count)
    return shares / total[volume], np.exp(-top) / total


def fit(lines, volumes):
    """Weights of the looks that make the right lines of these volumes most probable, or none."""
    count = len(lines.made)
    mean, std = lines.looks.mean(axis=0), np.maximum(lines.looks.std(axis=0), 1e-9)
    mean[0], std[0] = 0.0, 1.0
    z = (lines.looks - mean) / std
    used = np.zeros(count, bool)
    used[volumes] = True

    def loss(w):
        p, none = probabilities(z @ w, lines.volume, count)
        right = p * lines.right
        likelihood = np.bincount(lines.volume, right, count)
        shown = np.bincount(lines.volume, lines.right, count) > 0
        likelihood = np.maximum(np.where(shown, likelihood, none), 1e-300)
        posterior = np.where(shown[lines.volume], right / likelihood[lines.volume], 0.0)
        slope = (p - posterior) * used[lines.volume]
        value = -np.log(likelihood[used]).sum() + 0.5 * RIDGE * w[1:] @ w[1:]
        return value, z.T @ slope + RIDGE * np.r_[0.0, w[1:]]

    w = minimize(loss, np.zeros(z.shape[1]), jac=True, options={"maxiter": 2000}).x / std
    w[0] -= w[1:] @ mean[1:]
    return w


def score(p, right):
    """Log loss, and (b, 4) rows of a reliability curve: limits, mean stated, share, number."""
    loss = -np.mean(np.where(right, np.log(p + 1e-12), np.log(1 - p + 1e-12)))
    rows = []
    for low, high in ((0, 0.05), (0.05, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        here = (p >= low) & (p < high)
        if here.any():
            rows.append((low, min(high, 1), p[here].mean(), right[here].mean(), here.sum()))
    return loss, rows
