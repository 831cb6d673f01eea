"""Logistic regression of the looks, and its score on lines that were not fitted."""

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

RIDGE = 0.3
"""Weight of the squared weights of standardised looks, against chance."""


def top_lines(lines, odds, volumes, count=1):
    """Numbers of the lines of each of these volumes with the largest odds."""
    order = np.lexsort((-odds, lines.volume))
    rank = np.empty(len(odds), int)
    starts = np.searchsorted(lines.volume[order], lines.volume[order])
    rank[order] = np.arange(len(odds)) - starts
    return np.flatnonzero((rank < count) & np.isin(lines.volume, volumes))


def logistic(x, y):
    """Weights of the columns of x, of which the first is constant, for odds of y."""
    mean, std = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    mean[0], std[0] = 0.0, 1.0
    z = (x - mean) / std

    def loss(w):
        s = z @ w
        value = np.logaddexp(0, s).sum() - s @ y + 0.5 * RIDGE * w[1:] @ w[1:]
        return value, z.T @ (expit(s) - y) + RIDGE * np.r_[0.0, w[1:]]

    w = minimize(loss, np.zeros(x.shape[1]), jac=True).x / std
    w[0] -= w[1:] @ mean[1:]
    return w


def fit(lines, volumes, rounds=6, count=3):
    """Fit the weights to the likeliest lines of each volume, which the last weights choose."""
    here = np.flatnonzero(np.isin(lines.volume, volumes))
    for _ in range(rounds):
        weights = logistic(lines.looks[here], lines.right[here])
        here = top_lines(lines, lines.looks @ weights, volumes, count)
    # A probability is that of the likeliest line of a volume.
    odds = lines.looks @ weights
    best = top_lines(lines, odds, volumes)
    offset, slope = logistic(np.stack([np.ones(len(best)), odds[best]], axis=1), lines.right[best])
    weights = slope * weights
    weights[0] += offset
    return weights


def score(odds, right):
    """Log loss, and (b, 4) rows of a reliability curve: limits, mean stated, share, number."""
    p = expit(odds)
    loss = -np.mean(np.where(right, np.log(p + 1e-12), np.log(1 - p + 1e-12)))
    rows = []
    for low, high in ((0, 0.05), (0.05, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        here = (p >= low) & (p < high)
        if here.any():
            rows.append((low, min(high, 1), p[here].mean(), right[here].mean(), here.sum()))
    return loss, rows
