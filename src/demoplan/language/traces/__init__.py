"""Symbolic traces as text: what actions and predicates there are, and what was observed between actions.

Read in the forms that the planning community's learners use: ``(:trajectory (:state (p a) …) (:action (name a
b)) (:state …) …)`` of AMLGym, ``(:observation …)`` with negated literals of OffLAM and NOLAM, ``((:init …)
(operator: (name a b)) (:state …))`` of SAM. What cannot be used is named by file and line and left out; the
rest is kept.
"""

from demoplan.language.traces.inferring import infer_signatures
from demoplan.language.traces.reading import TraceReader
from demoplan.language.traces.signatures import read_objects, read_signatures, render_strips
from demoplan.language.traces.values import ActionSignature, Fault, Signatures, TraceSet

__all__ = [
    "ActionSignature",
    "Fault",
    "Signatures",
    "TraceReader",
    "TraceSet",
    "infer_signatures",
    "read_objects",
    "read_signatures",
    "render_strips",
]
