"""Fits the finger model's parameters to recorded trials.

The rooms, in the order in which a fit passes through them: `problem` (trials and cost), `search`,
`full_order` (correction and check), `uncertainty`, `results` (what was found, and files), `report`
(figures and page), `study` (the stages, from bags to files).
"""
