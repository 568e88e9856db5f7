# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""The maps of a reduced model: networks for the kernels, with gains and biases of one finger.

`GeometryMaps` are those of one geometry (`finger-model reduce`), whose biases depend on ln E2/E0.
`PopulationMaps` serve every finger of the population box; gains and biases come from its context.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..geometry import Geometry
from ..laws import MaxwellLaw
from . import kernels as rk
from .elastic_contact import (
    ElasticContacts,
    LinearGuess,
    linear_guess,
    network_context,
    press_contexts,
)
from .population import context_of

if TYPE_CHECKING:
    from ..fem.linear_contact import LinearContact

NETWORKS = ("drive", "contact")


class Modulation(NamedTuple):
    """Gains and biases of a network: (w,), (w,), (w,), (w,), (o,)."""

    gain_1: np.ndarray
    bias_1: np.ndarray
    gain_2: np.ndarray
    bias_2: np.ndarray
    bias_3: np.ndarray


class Finger(NamedTuple):
    """What the maps need to know: inputs (c,) of the networks, and elastic curves (2, nodes, 3 + k)
    where the model has them."""

    inputs: np.ndarray
    curves: np.ndarray | None = None


class Maps:
    """Networks as the kernels take them. Raises ValueError for layers that do not fit together."""

    def __init__(
        self,
        layers: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
        betas: np.ndarray,
        response: np.ndarray | None = None,
    ) -> None:
        first = {name: values[0] for name, values in layers.items()}
        self.latents = k = layers["drive"][2].shape[1] - 1
        if not (np.isfinite(betas).all() and (np.asarray(betas) > 0.0).all()):
            raise ValueError("betas are not positive")
        frictions = len(betas)
        inputs = {
            "drive": rk.LOAD_INPUTS + k,
            "contact": rk.LOAD_INPUTS + k + frictions + rk.MIX_INPUTS + k,
        }
        outputs = {"drive": 1 + k, "contact": rk.CONTACT_OUTPUTS}
        widths = {name: values.shape[1] for name, values in first.items()}
        self.types = rk.record_types(k, frictions, widths["drive"], widths["contact"])
        self.networks = np.zeros(1, self.types.networks)
        self.networks["betas"] = betas
        if response is not None:
            if response.shape != (k, k):
                raise ValueError("response is no square matrix of the coordinates")
            self.networks["response"] = response
        self.work = np.zeros(1, self.types.work)
        for name, (one, two, three) in layers.items():
            width = widths[name]
            if (
                one.shape[0] != inputs[name]
                or two.shape != (width, width)
                or three.shape != (width, outputs[name])
            ):
                raise ValueError(f"layers of the {name} network do not fit together")
            record = self.networks[name]
            record["load"] = one[: rk.LOAD_INPUTS]
            record["amplitude"] = one[rk.LOAD_INPUTS : inputs["drive"]]
            record["weights_2"], record["weights_3"] = two, three
        rest = first["contact"][inputs["drive"] :]
        self.networks["contact"]["friction"] = rest[:frictions]
        self.networks["contact"]["mix"] = rest[frictions:]

    def _check(self, finger: np.ndarray) -> None:
        """Raise ValueError for gains and biases that do not fit, of a finger as networks see it."""
        record = np.zeros(1, self.types.parameters)
        for name in NETWORKS:
            for key, value in self.modulation(name, finger)._asdict().items():
                if value.shape != record[name][key][0].shape or not np.isfinite(value).all():
                    raise ValueError(f"{key} of the {name} network does not fit")

    def modulation(self, name: str, finger: np.ndarray) -> Modulation:
        """Gains and biases of a network for a finger, as the networks see it."""
        raise NotImplementedError

    def fingers_of(self, geometry: Geometry, materials: Sequence[MaxwellLaw]) -> list[Finger]:
        """What the maps need to know of a finger of each material."""
        raise NotImplementedError

    def largest_load(self, material: MaxwellLaw) -> float:
        """Largest F/(E0 L²) that the maps were trained for."""
        raise NotImplementedError

    def parameters(self, geometry: Geometry, materials: Sequence[MaxwellLaw]) -> np.ndarray:
        """The kernels' records (n,) of a finger of each material, without the force limit."""
        length = geometry.pad_semi_axis_radial
        records = [
            self.parameters_of(
                length,
                material.instantaneous_modulus * length**2,
                np.array([branch.fraction for branch in material.branches]),
                np.array([branch.relaxation_time for branch in material.branches]),
                finger,
            )
            for material, finger in zip(materials, self.fingers_of(geometry, materials))
        ]
        found = np.concatenate(records)
        bone = geometry.bone_semi_axis_axial - geometry.bone_center_height
        found["deepest"] = (geometry.pad_semi_axis_axial - bone) / length
        return found

    def parameters_of(
        self,
        length: float,
        scale: float,
        fractions: np.ndarray,
        times: np.ndarray,
        finger: Finger,
    ) -> np.ndarray:
        """The same of length (m), E0 L² (N), fractions and times (s) of the branches, finger; the
        indentation has no end."""
        record = np.zeros(1, self.types.parameters)
        record["deepest"] = np.inf
        record["length"] = length
        record["force_scale"] = scale
        record["branches"] = count = len(fractions)
        record["fraction"][0, :count] = fractions
        record["tau"][0, :count] = times
        record["share"] = min(1.0 - fractions.sum(), rk.MOST_SHARE)
        if finger.curves is not None:
            fill_curves(record, finger.curves)
        for name in NETWORKS:
            for key, value in self.modulation(name, finger.inputs)._asdict().items():
                record[name][key] = value
        # Indentation and drive at rest, which the kernels subtract.
        record["drive_at_rest"] = self.at_rest(record)["drive"]
        return record

    def at_rest(self, record: np.ndarray) -> np.ndarray:
        """The kernels' record (1,) of a finger at rest."""
        state = np.zeros(1, self.types.state)
        rk.rest(self.networks, record, state, self.work)
        return state


class GeometryMaps(Maps):
    """Maps of one geometry."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        layers = {}
        self._first: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._later: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for name in NETWORKS:
            a = {
                key.removeprefix(name + "_"): v for key, v in arrays.items() if key.startswith(name)
            }
            # Scaling of inputs and outputs goes into the weights; the last input is ln E2/E0.
            first = a["weights_1"] / a["input_scale"][:, None]
            own = first[:-1]
            if name == "contact":  # without elastic curves there is nothing to mix
                mix = rk.MIX_INPUTS + arrays["drive_weights_3"].shape[1] - 1
                own = np.concatenate([own, np.zeros((mix, own.shape[1]))])
            layers[name] = (own, a["weights_2"], a["weights_3"] * a["output_scale"])
            self._first[name] = (a["bias_1"] - a["input_mean"] @ first, first[-1])
            self._later[name] = (a["bias_2"], a["bias_3"] * a["output_scale"] + a["output_mean"])
        super().__init__(layers, arrays["betas"])
        self._check(np.zeros(1))
        self._limit = arrays["force_limit"]
        if self._limit.shape != (3,) or np.abs(self._limit).max() > 20.0:
            raise ValueError("force_limit is no fit of three exponents")

    def fingers_of(self, geometry: Geometry, materials: Sequence[MaxwellLaw]) -> list[Finger]:
        return [
            Finger(np.array([math.log(m.epidermis_modulus / m.instantaneous_modulus)]))
            for m in materials
        ]

    def modulation(self, name: str, finger: np.ndarray) -> Modulation:
        stiffness = float(finger[0])
        bias, row = self._first[name]
        ones = np.ones(len(bias))
        bias_2, bias_3 = self._later[name]
        return Modulation(ones, bias + stiffness * row, ones, bias_2, bias_3)

    def largest_load(self, material: MaxwellLaw) -> float:
        c = self._limit
        skin = material.epidermis_modulus / material.instantaneous_modulus
        return math.exp(c[0] + c[1] * math.log(material.long_term_fraction) + c[2] * math.log(skin))


class PopulationMaps(Maps):
    """Maps of all fingers of the population box."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        layers = {}
        self._context: dict[str, dict[str, np.ndarray]] = {}
        for name in NETWORKS:
            a = {
                key.removeprefix(name + "_"): np.asarray(value, float)
                for key, value in arrays.items()
                if key.startswith(name)
            }
            first = a["W1"] / a["input_scale"][:, None]
            layers[name] = (first, a["W2"], a["W3"] * a["output_scale"])
            self._context[name] = {**a, "shift": a["input_mean"] @ first}
        super().__init__(layers, arrays["betas"], arrays["response"])
        self.elastic = ElasticContacts.of_arrays(arrays)
        self._check(np.zeros(len(self._context["drive"]["context_mean"])))
        self._load = arrays["largest_load"]
        if self._load.shape != (2,) or not (self._load >= 0).all():
            raise ValueError("largest_load is no pair of coefficients")

    def fingers_of(self, geometry: Geometry, materials: Sequence[MaxwellLaw]) -> list[Finger]:
        contact = _linear_contact(geometry)
        return self.fingers_like(
            np.array([context_of(geometry, material) for material in materials]),
            np.array([material.long_term_fraction for material in materials]),
            linear_guess(contact, materials),
        )

    def fingers_like(
        self, contexts: np.ndarray, shares: np.ndarray, guess: LinearGuess
    ) -> list[Finger]:
        """Fingers of contexts (n, c), long-term fractions (n,) and the guess of all."""
        presses = press_contexts(contexts, shares)
        coarse = self.elastic.coarse_curves(presses, guess)
        default = self.elastic.default_curves(presses, guess, coarse)
        return [
            Finger(network_context(contexts[i], shares[i], coarse[:, i]), default[:, i])
            for i in range(len(contexts))
        ]

    def modulation(self, name: str, finger: np.ndarray) -> Modulation:
        a = self._context[name]
        context = (finger - a["context_mean"]) / a["context_scale"]
        first = sigmoid(context @ a["V1"] + a["d1"])[0]
        found = sigmoid(first @ a["V2"] + a["d2"])[0] @ a["V3"] + a["d3"]
        width = a["W2"].shape[0]
        gain_1, bias_1, gain_2, bias_2 = found[: 4 * width].reshape(4, width)
        bias_3 = found[4 * width :] * a["output_scale"] + a["output_mean"]
        return Modulation(gain_1, bias_1 - gain_1 * a["shift"], gain_2, bias_2, bias_3)

    def largest_load(self, material: MaxwellLaw) -> float:
        soft, stiffening = self._load
        return material.long_term_fraction * soft * (1.0 + stiffening * material.stiffening)


def fill_curves(record: np.ndarray, curves: np.ndarray) -> None:
    """Put elastic curves (2, nodes, 3 + k) into the kernels' record (1,) of a finger."""
    record["curved"] = 1
    record["curves"][0, :, :, 0] = curves
    record["curves"][0, :, :, 1] = np.gradient(curves, np.log(rk.NODES), axis=1)


@functools.lru_cache(maxsize=16)
def _linear_contact(geometry: Geometry) -> LinearContact:
    # Of the population's model only: finite elements take half a second to import.
    from ..fem.linear_contact import LinearContact

    return LinearContact(geometry)


def sigmoid(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """v/√(1 + v²) and its slope."""
    root = 1.0 / np.sqrt(1.0 + v * v)
    return v * root, root**3
