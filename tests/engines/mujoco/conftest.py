"""Demonstrations to look at; each takes about a third of a second."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

STEADY = {
    "hesitation_probability": 0.0,
    "regrasp_probability": 0.0,
    "miss_probability": 0.0,
    "careless_probability": 0.0,
}


@pytest.fixture(scope="session")
def performed():
    """A demonstration of a task by the participant of a seed, with habits changed."""
    pytest.importorskip("mujoco")
    from demoplan.engines.mujoco.acting import demonstrate
    from demoplan.engines.mujoco.participants import draw_participant
    from demoplan.engines.mujoco.scene import cube_names, draw_layout
    from demoplan.engines.mujoco.tasks import parse_task

    @cache
    def perform(text, seed=0, **habits):
        who = replace(draw_participant("p1", np.random.default_rng(seed)), **(STEADY | habits))
        task = parse_task(text)
        rng = np.random.default_rng([seed, 7])
        layout = draw_layout(cube_names(task.n_cubes), task.start, rng)
        return who, demonstrate(who, task, layout, rng)

    return perform
