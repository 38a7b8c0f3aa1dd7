"""Symbolic traces with misreadings to operators, every literal with its probability; noise is estimated.

``candidates`` are the literals an action may have; ``touches`` are the moments at which an action could have
changed a ground atom; ``demoplan.inference`` says what each literal is; ``snapshots`` are clean states;
``implications`` leave out conditions that say nothing new; ``learning`` puts them into tables.
"""

from demoplan.stages.denoise.learning import Denoised, Gathered, conclude, denoise, forget, gather
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.tabling import traces_of

__all__ = ["DenoiseParams", "Denoised", "Gathered", "conclude", "denoise", "forget", "gather", "traces_of"]
