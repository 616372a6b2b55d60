"""Positive real roots of polynomials with rational coefficients, right to the last digit of a float."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.polynomial import polynomial

NEARLY_REAL = 1e-7  # imaginary share of a root, below which it may be a real one spoilt by rounding
MOST_STEPS = 60


def positive_roots(coefficients: list[Fraction]) -> list[float]:
    """Real roots above zero, ascending; coefficients with the constant first.

    A polynomial that is odd or even is solved for the square. Roots of even multiplicity, which rounding
    makes appear and vanish, are found to about half the digits.
    """
    nonzero = [power for power, coefficient in enumerate(coefficients) if coefficient]
    if len(nonzero) < 2:
        return []
    low, high = nonzero[0], nonzero[-1]
    stride = 2 if all((power - low) % 2 == 0 for power in nonzero) else 1
    reduced = coefficients[low : high + 1 : stride]
    # Rescaled so that the first and the last coefficient are alike: then none of them over- or underflows.
    first, last = abs(float(reduced[0])), abs(float(reduced[-1]))
    scale = Fraction(2) ** round(np.log2(first / last) / (len(reduced) - 1))
    scaled = [coefficient * scale**power for power, coefficient in enumerate(reduced)]
    largest = max(abs(coefficient) for coefficient in scaled)
    guesses = polynomial.polyroots([float(coefficient / largest) for coefficient in scaled])
    real = guesses[np.abs(guesses.imag) <= NEARLY_REAL * np.abs(guesses)].real
    polished = {_polished(float(guess), scaled) for guess in real if guess > 0.0}
    return sorted(
        float(np.sqrt(float(Fraction(root) * scale)) if stride == 2 else Fraction(root) * scale)
        for root in polished
    )


def _polished(root: float, coefficients: list[Fraction]) -> float:
    """The float next to the root that `root` is near, by Newton's method with exact residuals."""
    for _ in range(MOST_STEPS):
        x, value, slope = Fraction(root), Fraction(0), Fraction(0)
        for coefficient in reversed(coefficients):
            slope = slope * x + value
            value = value * x + coefficient
        if slope == 0:
            return root
        step = float(value / slope)
        better = root - step
        if abs(step) > 0.1 * abs(root):  # a double root that is none: Newton wanders
            return root
        if better == root or abs(step) < 1e-16 * abs(root):
            return better
        root = better
    return root
