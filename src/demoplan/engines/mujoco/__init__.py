"""Physics: scenes in MuJoCo, and participants who demonstrate tasks in them.

``scene`` builds a table with cubes and says what rests on what; ``hands`` adds a hand that follows a
commanded pose; ``workspace`` advances both, tick by tick. ``participants`` draws who demonstrates, ``tasks``
says what, ``motion`` gives minimum-jerk paths, ``moving`` and ``acting`` let them act. ``demonstration`` is
what comes of it, ``labels`` what they truly did, ``sensing`` what a rig saw of it.
"""

import importlib.util

from demoplan.errors import UsageError

if importlib.util.find_spec("mujoco") is None:
    raise UsageError("simulation needs MuJoCo, which is not installed; pip install 'demoplan[simulation]'")
