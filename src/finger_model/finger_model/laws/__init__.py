"""Material laws, and the parameters that each lets a fit vary."""

from .space import DerivedQuantity, ParameterSpace, ParameterSpec, Quantity

__all__ = ["DerivedQuantity", "ParameterSpace", "ParameterSpec", "Quantity"]
