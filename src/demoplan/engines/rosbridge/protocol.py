"""One message of a client to the messages that answer it: pure, and never an exception.

What a client sends is data from outside: anything may be missing, of a wrong type, or far too large. Every
call gets a ``service_response``; what cannot be understood gets a ``status`` of level ``error``.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from demoplan.errors import DemoplanError

Message: TypeAlias = dict[str, Any]

_IGNORED = frozenset(
    {"advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "set_level", "service_response"}
)
"""Operations that are understood and not offered: they get a polite word, as no topics are served."""

_UNOFFERED = frozenset(
    {"advertise_service", "unadvertise_service", "auth", "fragment", "png", "send_action_goal"}
)


@dataclass(frozen=True)
class Reply:
    """What a service answers; a failure's ``values`` hold its reason as text."""

    values: Mapping[str, Any] | str
    is_success: bool = True


@dataclass(frozen=True, kw_only=True)
class Service:
    """A service: its arguments' names in order, its ROS type, and the function behind it."""

    type: str
    arguments: tuple[str, ...]
    function: Callable[[Mapping[str, Any]], Reply]


def answers(text: str | bytes, services: Mapping[str, Service]) -> list[Message]:
    """The messages to send back.

    Args:
        text: What the client sent, one JSON object.
        services: Name → service. Beside them, ``/rosapi/services``, ``/rosapi/service_type`` and
            ``/rosapi/topics`` are answered, since clients ask for them on their own.
    """
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        return [_status("error", f"not JSON: {error}")]
    if not isinstance(message, dict):
        return [_status("error", f"a message is a JSON object; found {type(message).__name__}")]
    operation, number = message.get("op"), message.get("id")
    if not isinstance(operation, str):
        return [_status("error", f"'op' must be a string; found {operation!r:.60}", number)]
    if operation == "call_service":
        return [_called(message, services)]
    if operation in _IGNORED:
        what = message.get("topic") or message.get("service") or ""
        return [_status("warning", f"{operation} {what}: this server offers services, no topics", number)]
    known = sorted({"call_service", *_IGNORED})
    if operation in _UNOFFERED:
        return [_status("error", f"{operation!r} is not offered; offered: {', '.join(known)}", number)]
    return [_status("error", f"unknown op {operation!r}; known: {', '.join(known)}", number)]


def _called(message: Message, services: Mapping[str, Service]) -> Message:
    name, number = message.get("service"), message.get("id")
    if not isinstance(name, str):
        return _response(name, number, Reply(f"'service' must be a string; found {name!r:.60}", False))
    plain = "/" + name.strip("/")
    if plain.startswith("/rosapi/"):
        return _response(name, number, _introspection(plain, message.get("args"), services))
    if plain not in services:
        reason = f"unknown service {name!r:.100}; available: {', '.join(sorted(services))}"
        return _response(name, number, Reply(reason, False))
    service = services[plain]
    arguments = message.get("args", {})
    if isinstance(arguments, list):
        # The protocol allows arguments in order instead of by name.
        if len(arguments) > len(service.arguments):
            reason = f"{plain} takes {len(service.arguments)} arguments; found {len(arguments)}"
            return _response(name, number, Reply(reason, False))
        arguments = dict(zip(service.arguments, arguments, strict=False))
    if not isinstance(arguments, dict):
        reason = f"'args' must be an object or a list; found {type(arguments).__name__}"
        return _response(name, number, Reply(reason, False))
    unknown = sorted(set(arguments) - set(service.arguments))
    if unknown:
        reason = f"unknown argument {unknown[0]!r:.60}; {plain} takes {', '.join(service.arguments)}"
        return _response(name, number, Reply(reason, False))
    try:
        reply = service.function(arguments)
        json.dumps(reply.values, allow_nan=False)
    except DemoplanError as error:
        reply = Reply(str(error), False)
    except Exception as error:
        reply = Reply(f"internal error: {type(error).__name__}: {error}", False)
    return _response(name, number, reply)


def _introspection(name: str, arguments: Any, services: Mapping[str, Service]) -> Reply:
    """What a client may ask about the server itself, as rosapi would answer."""
    if name == "/rosapi/services":
        return Reply({"services": sorted(services)})
    if name == "/rosapi/topics":
        return Reply({"topics": [], "types": []})
    if name == "/rosapi/service_type":
        asked = arguments.get("service") if isinstance(arguments, dict) else None
        found = services.get("/" + asked.strip("/")) if isinstance(asked, str) else None
        return Reply({"type": "" if found is None else found.type})
    return Reply(
        f"{name} is not offered; offered: /rosapi/services, /rosapi/service_type, /rosapi/topics", False
    )


def _response(service: Any, number: Any, reply: Reply) -> Message:
    message: Message = {
        "op": "service_response",
        "service": service if isinstance(service, str) else "",
        "values": reply.values,
        "result": reply.is_success,
    }
    return message if number is None else {**message, "id": number}


def _status(level: str, text: str, number: Any = None) -> Message:
    message: Message = {"op": "status", "level": level, "msg": text}
    return message if number is None else {**message, "id": number}
