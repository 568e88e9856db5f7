"""Fits the finger model's parameters to recorded trials.

The subpackages, in the order in which a fit uses them: `problem` (trials and cost), `search`,
`full_order` (correction and check), `uncertainty`, `results` (what was found, and files), `report`
(figures and page), `study` (the stages, from bags to files).
"""
