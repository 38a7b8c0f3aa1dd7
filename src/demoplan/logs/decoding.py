"""Which decoder reads a channel."""

from demoplan.logs.columns import Decoder, Wanted
from demoplan.logs.definitions import Definitions, UnknownTypeError
from demoplan.logs.layouts import CDR, ROS1, Interner
from demoplan.logs.messages import Channel
from demoplan.logs.objects import ObjectDecoder, parse_json
from demoplan.logs.protobuf import parser_of
from demoplan.logs.serialised import SerialisedDecoder

ENCODINGS = ("cdr", "json", "protobuf", "ros1")


def decoder_for(channel: Channel, wanted: Wanted, definitions: Definitions, interner: Interner) -> Decoder:
    """What reads the wanted fields from messages of a channel.

    Raises:
        UnknownTypeError: If the encoding is not supported, or the type has no usable definition.
        MissingFieldError: If the type lacks a required field.
    """
    if channel.encoding in ("cdr", "ros1"):
        form = CDR if channel.encoding == "cdr" else ROS1
        return SerialisedDecoder(definitions.node(channel), form, wanted, interner)
    if channel.encoding == "json":
        return ObjectDecoder(parse_json, None, wanted, interner)
    if channel.encoding == "protobuf":
        record, parse = parser_of(channel.message_type, channel.schema)
        return ObjectDecoder(parse, record, wanted, interner)
    raise UnknownTypeError(
        f"its encoding {channel.encoding!r} is not supported; supported: {', '.join(ENCODINGS)}"
    )
