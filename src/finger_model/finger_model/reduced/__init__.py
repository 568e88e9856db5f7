"""The reduced model: load, use, build."""

from .model import ReducedModel
