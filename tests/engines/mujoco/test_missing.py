import importlib.util
import sys

import pytest

from demoplan.errors import UsageError


def test_without_mujoco_it_is_said_how_to_get_it(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("demoplan.engines.mujoco")]:
        monkeypatch.delitem(sys.modules, module)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "mujoco" else find(name, *rest)
    )
    with pytest.raises(UsageError, match=r"MuJoCo.*demoplan\[simulation\]"):
        importlib.import_module("demoplan.engines.mujoco")
