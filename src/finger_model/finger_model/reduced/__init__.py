"""The reduced model: load, use, build."""

from .model import ReducedModel, ReducedState

__all__ = ["ReducedModel", "ReducedState"]
