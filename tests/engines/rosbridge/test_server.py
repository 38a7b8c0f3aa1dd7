"""The server against the real roslibpy client, and against clients that misbehave."""

import json
import threading
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.sync.client import connect

from demoplan.engines.rosbridge import Reply, Service, answers, start
from demoplan.errors import UsageError


def plan(arguments):
    if arguments.get("goal") == "wrong":
        raise UsageError("unknown object 'wrong'; available: cube_red")
    if arguments.get("goal") == "broken":
        raise ZeroDivisionError("oh")
    if arguments.get("goal") == "slow":
        time.sleep(0.3)
    return Reply({"outcome": "solved", "steps": [f"reach({arguments.get('goal')})"]})


SERVICES = {"/demoplan/plan_goal": Service(type="demoplan/PlanGoal", arguments=("goal",), function=plan)}


@pytest.fixture
def server():
    with start(SERVICES) as running:
        yield running


def call(port, *messages):
    with connect(f"ws://127.0.0.1:{port}") as client:
        replies = []
        for message in messages:
            client.send(message if isinstance(message, str | bytes) else json.dumps(message))
            replies.append(json.loads(client.recv(timeout=5)))
        return replies


def a_call(goal, number="1"):
    return {"op": "call_service", "id": number, "service": "/demoplan/plan_goal", "args": {"goal": goal}}


ROSLIBPY = """
import sys, threading, json
import roslibpy
ros = roslibpy.Ros(host="127.0.0.1", port=int(sys.argv[1]))
ros.run(timeout=10)
service = roslibpy.Service(ros, "/demoplan/plan_goal", "demoplan/PlanGoal")
print(json.dumps(dict(service.call(roslibpy.ServiceRequest({"goal": "cube_red"}), timeout=10))))
done, failures = threading.Event(), []
def failed(error):
    failures.append(str(error))
    done.set()
service.call(roslibpy.ServiceRequest({"goal": "wrong"}), callback=lambda _: done.set(), errback=failed)
done.wait(10)
print(json.dumps(failures))
print(json.dumps(ros.get_service_type("/demoplan/plan_goal")))
topic = roslibpy.Topic(ros, "/chatter", "std_msgs/String")
topic.subscribe(lambda _: None)
topic.publish(roslibpy.Message({"data": "hello"}))
print(json.dumps(dict(service.call(roslibpy.ServiceRequest({"goal": "again"}), timeout=10))))
ros.terminate()
"""


def test_the_real_roslibpy_client_calls_gets_errors_and_goes_on(server, tmp_path):
    pytest.importorskip("roslibpy")
    import subprocess
    import sys

    script = tmp_path / "client.py"
    script.write_text(ROSLIBPY)
    # Its reactor runs once in a process, so the client gets a process of its own.
    done = subprocess.run(
        [sys.executable, str(script), str(server.port)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    first, failures, kind, again = (json.loads(line) for line in done.stdout.splitlines())
    assert first == {"outcome": "solved", "steps": ["reach(cube_red)"]}
    assert len(failures) == 1
    assert "unknown object 'wrong'" in failures[0]
    assert kind == "demoplan/PlanGoal"
    assert again["steps"] == ["reach(again)"]


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ("not json", "not JSON"),
        ("[1, 2]", "JSON object"),
        ('{"op": "dance"}', "unknown op 'dance'"),
        ('{"op": {"a": 1}}', "'op' must be a string"),
        ('{"op": "advertise_service", "service": "/x"}', "not offered"),
    ],
)
def test_what_is_not_a_message_gets_an_error_and_the_server_goes_on(server, sent, said):
    refused, answered = call(server.port, sent, a_call("x"))
    assert refused["op"] == "status"
    assert refused["level"] == "error"
    assert said in refused["msg"]
    assert answered["result"] is True


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"service": "/nobody"}, "unknown service '/nobody'; available: /demoplan/plan_goal"),
        ({"service": 7}, "must be a string"),
        ({}, "must be a string"),
        ({"service": "/demoplan/plan_goal", "args": "x"}, "object or a list"),
        ({"service": "/demoplan/plan_goal", "args": {"aim": "x"}}, "takes goal"),
        ({"service": "/demoplan/plan_goal", "args": ["x", "y"]}, "takes 1 arguments; found 2"),
        ({"service": "/demoplan/plan_goal", "args": {"goal": "wrong"}}, "unknown object 'wrong'"),
        ({"service": "/demoplan/plan_goal", "args": {"goal": "broken"}}, "internal error: ZeroDivisionError"),
        ({"service": "/rosapi/nodes"}, "not offered"),
    ],
)
def test_a_call_that_cannot_be_made_is_answered_with_the_reason_and_its_number(message, said):
    (reply,) = answers(json.dumps({"op": "call_service", "id": "call:7", **message}), SERVICES)
    assert reply["op"] == "service_response"
    assert reply["id"] == "call:7"
    assert reply["result"] is False
    assert said in reply["values"]


def test_arguments_may_come_in_order():
    text = json.dumps({"op": "call_service", "service": "demoplan/plan_goal", "args": ["a"]})
    (reply,) = answers(text, SERVICES)
    assert reply["values"]["steps"] == ["reach(a)"]
    assert "id" not in reply


@pytest.mark.parametrize("operation", ["advertise", "subscribe", "publish", "unsubscribe", "unadvertise"])
def test_topics_are_declined_politely(operation):
    (reply,) = answers(json.dumps({"op": operation, "topic": "/t", "id": "s"}), SERVICES)
    assert (reply["op"], reply["level"], reply["id"]) == ("status", "warning", "s")


def test_a_client_that_goes_away_in_the_middle_of_a_call_disturbs_nobody(server):
    client = connect(f"ws://127.0.0.1:{server.port}")
    client.send(json.dumps(a_call("slow")))
    client.socket.close()
    assert call(server.port, a_call("x"))[0]["result"] is True


def test_calls_of_several_clients_are_made_one_after_another():
    running, most = [], []

    def slow(_):
        running.append(1)
        most.append(len(running))
        time.sleep(0.02)
        running.pop()
        return Reply({})

    with start({"/s": Service(type="t", arguments=(), function=slow)}) as server:
        message = {"op": "call_service", "service": "/s"}
        threads = [threading.Thread(target=call, args=(server.port, message)) for _ in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(10)
    assert most == [1] * 5


def test_a_message_that_is_far_too_long_ends_its_own_connection_only(server):
    with connect(f"ws://127.0.0.1:{server.port}") as client:
        client.send("x" * (2 << 20))
        with pytest.raises(Exception, match=r"1009|close"):
            client.recv(timeout=5)
    assert call(server.port, a_call("x"))[0]["result"] is True


def test_a_port_that_is_taken_is_said_to_be(server):
    with pytest.raises(UsageError, match=f"port {server.port}"):
        start(SERVICES, port=server.port)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=150, deadline=None)
@given(
    st.dictionaries(st.sampled_from(["op", "id", "service", "args", "topic"]), json_values)
    | st.fixed_dictionaries({"op": st.just("call_service"), "service": json_values, "args": json_values})
)
def test_whatever_is_sent_something_that_is_json_comes_back(message):
    for reply in answers(json.dumps(message), SERVICES):
        json.dumps(reply, allow_nan=False)
        assert reply["op"] in {"status", "service_response"}
