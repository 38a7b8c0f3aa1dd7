"""Goals over rosbridge to a robot in physics, as a ROS user would ask for them."""

import json

import pytest
from websockets.sync.client import connect

from demoplan.engines.rosbridge import start
from demoplan.pipeline.execution.goal_service import EXECUTE, PLAN, RESET, GoalService

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def port(learned_domain, tabletop):
    with start(GoalService(learned_domain, tabletop).services()) as server:
        yield server.port


def call(port, service, **arguments):
    with connect(f"ws://127.0.0.1:{port}") as client:
        client.send(json.dumps({"op": "call_service", "id": "1", "service": service, "args": arguments}))
        return json.loads(client.recv(timeout=60))


def test_a_goal_is_planned_executed_and_then_holds(port):
    goal = "onTop(cube_red, cube_blue)"
    planned = call(port, PLAN, goal=goal)
    assert planned["result"] is True
    assert [step.split("(")[0] for step in planned["values"]["steps"]] == [
        "reach_1",
        "take_1",
        "put_1",
        "release_1",
    ]
    done = call(port, EXECUTE, goal=goal)["values"]
    assert (done["outcome"], done["is_goal_reached"]) == ("reached", True)
    assert [step["state"] for step in done["steps"]] == ["succeeded"] * 4
    assert call(port, PLAN, goal=goal)["values"]["steps"] == []
    assert call(port, RESET)["values"]["success"] is True
    assert len(call(port, PLAN, goal=goal)["values"]["steps"]) == 4


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"goal": "onTop(cube_pink, cube_blue)"}, "cube_pink"),
        ({"goal": "onTop(cube_red"}, "expected"),
        ({"goal": 3}, "must be text"),
        ({}, "must be text"),
    ],
)
def test_a_goal_that_is_none_is_answered_with_the_reason(port, arguments, said):
    for service in (PLAN, EXECUTE):
        reply = call(port, service, **arguments)
        assert reply["result"] is False
        assert said in reply["values"]


def test_a_goal_that_has_no_plan_is_an_answer_and_no_error(port):
    reply = call(port, PLAN, goal="onTop(cube_red, cube_blue) & onTop(cube_blue, cube_red)")
    assert reply["result"] is True
    assert reply["values"]["outcome"] == "no_plan"


def test_a_client_that_goes_away_while_the_robot_moves_leaves_it_to_finish_and_disturbs_nobody(port):
    goal = "onTop(cube_red, cube_blue)"
    assert call(port, RESET)["values"]["success"] is True
    client = connect(f"ws://127.0.0.1:{port}")
    message = {"op": "call_service", "id": "1", "service": EXECUTE, "args": {"goal": goal}}
    client.send(json.dumps(message))
    # Gone without a word, in the middle of the call.
    client.socket.close()
    planned = call(port, PLAN, goal=goal)["values"]
    assert (planned["outcome"], planned["steps"]) == ("solved", []), "the goal holds: the robot went on alone"
