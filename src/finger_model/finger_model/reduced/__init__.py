"""The reduced model: load, use, build."""

from .model import RANGE_NAMES, ReducedModel, ReducedState

__all__ = ["RANGE_NAMES", "ReducedModel", "ReducedState"]
