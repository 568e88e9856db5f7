"""How well the data determine the parameters: covariance, profiles, bootstrap, bias."""

from .bias import BiasCorrected, bias_corrected, bias_pair, shifted_interval
from .bootstrap import bootstrap_sample, percentile_interval
from .covariance import Covariance, covariance, cramer_rao
from .profiles import Profile, in_interval, profile

__all__ = [
    "BiasCorrected",
    "Covariance",
    "Profile",
    "bias_corrected",
    "bias_pair",
    "bootstrap_sample",
    "covariance",
    "cramer_rao",
    "in_interval",
    "percentile_interval",
    "profile",
    "shifted_interval",
]
