"""The fit's problem: trials, the model, and the cost of a parameter set."""

from .cost import AreaCorrection, AreaModel, FitProblem, material_of
from .power_law import PowerLaw, fit_power_law, power_law_of
from .report_units import MM2, MM4, three_digits
from .trials import Exclusion, FitTrial, TrialRejected, prepare, prepare_all
