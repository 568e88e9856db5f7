# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The relief of one fingerprint: ridges with minutiae, drawn from a seed.

Phase of the ridges: the AM-FM model of a print, cos(ψ + Σ ± arg(z − z_k)), one spiral per minutia
(K. G. Larkin and P. A. Fletcher, "A coherent framework for fingerprint analysis: are fingerprints
holograms?", Optics Express 15(14), 2007).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np


@dataclass
class Fingerprint:
    """Relief of one finger, (SIZE, SIZE) float32 on a grid of PITCH (m), centred on the core.

    crest_distance: distance from the nearest crest in half periods, 0 on the ridge, 1 in the
    furrow. relief: fine relief that breaks ridges, standard deviation 1. patches: coarse relief of
    contrast, same scale.
    """

    crest_distance: np.ndarray
    relief: np.ndarray
    patches: np.ndarray

    PITCH = 30e-6
    SIZE = 1024

    @classmethod
    def draw(cls, rng: np.random.Generator, ridge_period: float) -> Fingerprint:
        """A print with whorl, loop-like or arch-like flow and about 40 minutiae."""
        coarse = cls.SIZE // 2
        axis = (np.arange(coarse) - (coarse - 1) / 2) * 2 * cls.PITCH
        x, y = np.meshgrid(axis, axis)
        kind = rng.integers(3)
        if kind == 0:
            flow = np.hypot(x, rng.uniform(0.85, 1.0) * y)
        elif kind == 1:
            # Concentric above the core, turning to level ridges below it.
            flow = np.hypot(np.hypot(x, y - 1e-3), 0.8e-3) + np.where(y > 0, y * 0.2, 0.0)
        else:
            flow = y * 0.95 + 3e-3 * np.exp(-((x / 5e-3) ** 2))
        flow = flow + 0.4e-3 * smooth_noise(rng, coarse, 2.5e-3 / (2 * cls.PITCH))
        # exp(i phase): a factor z − z_k, or its conjugate, for each minutia. In cm, so that the
        # product stays within the range of numbers.
        wave = np.exp(2j * math.pi * flow / ridge_period)
        for _ in range(40):
            px, py = rng.uniform(-10e-3, 10e-3, 2)
            sign = rng.choice([-1.0, 1.0])
            wave *= 1e2 * (axis - px) + (sign * 1e2j) * (axis - py)[:, None]
        wave /= np.abs(wave)
        full = (cls.SIZE, cls.SIZE)
        cosine = cv2.resize(wave.real.astype(np.float32), full, interpolation=cv2.INTER_CUBIC)
        sine = cv2.resize(wave.imag.astype(np.float32), full, interpolation=cv2.INTER_CUBIC)
        distance = (np.abs(np.arctan2(sine, cosine)) / math.pi).astype(np.float32)
        # Relief finer than a ridge is wide breaks dry ridges into islands.
        relief = smooth_noise(rng, cls.SIZE, 0.22 * ridge_period / cls.PITCH)
        patches = smooth_noise(rng, cls.SIZE, 1.5e-3 / cls.PITCH)
        return cls(distance, relief.astype(np.float32), patches.astype(np.float32))


def smooth_noise(rng: np.random.Generator, size: int, sigma: float) -> np.ndarray:
    """Gaussian random field (size, size), standard deviation 1.

    sigma: correlation length in samples.
    """
    # A field much smoother than its grid is drawn coarser and enlarged.
    step = max(1, int(sigma / 4))
    small = max(8, size // step + 1)
    noise = cv2.GaussianBlur(
        rng.standard_normal((small, small), dtype=np.float32), (0, 0), max(sigma / step, 0.3)
    )
    noise = cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return (noise - noise.mean()) / max(float(noise.std()), 1e-9)
