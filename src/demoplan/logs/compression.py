"""Compressed bytes back to what they were: whole, or in bounded pieces, as far as they go."""

import bz2
import io
import re
import threading
from collections.abc import Iterator
from typing import Any, Protocol

import lz4.frame
import zstandard

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_PIECE = 2**20
_OF_THREAD = threading.local()
"""Decompressors are dear to make and not to be shared between threads."""


class Readable(Protocol):
    """Where bytes come from."""

    def read(self, size: int = -1, /) -> bytes:
        """At most ``size`` bytes."""


class BrokenStreamError(Exception):
    """Compressed bytes end early or are damaged; what came before was given."""


class UnknownCompressionError(Exception):
    """A compression that no reader knows."""


def whole(name: str, data: bytes | memoryview, size: int) -> bytes | memoryview:
    """Exactly ``size`` bytes from compressed ``data``.

    Raises:
        BrokenStreamError: If the data is damaged, or holds another number of bytes than ``size``.
        UnknownCompressionError: If there is no such compression.
    """
    if name in ("", "none"):
        result: bytes | memoryview = data
    else:
        try:
            if name == "zstd":
                result = _whole_zstd(data, size)
            elif name == "lz4":
                result = (
                    lz4.frame.decompress(data)
                    if _lz4_fits(data, size)
                    else b"".join(pieces(name, data, size))
                )
            elif name == "bz2":
                result = b"".join(pieces(name, data, size))
            else:
                raise UnknownCompressionError(name)
        except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError) as error:
            raise BrokenStreamError(re.sub(r"\s+", " ", str(error))) from None
    if len(result) != size:
        raise BrokenStreamError(f"holds {len(result)} bytes where {size} were declared")
    return result


def _whole_zstd(data: bytes | memoryview, size: int) -> bytes:
    if zstandard.frame_content_size(bytes(data[:18])) not in (-1, size):
        raise BrokenStreamError(f"its frame does not hold the {size} bytes declared")
    # The frame's own size is as declared, or unknown: then the limit bounds what is allocated.
    if not hasattr(_OF_THREAD, "zstd"):
        _OF_THREAD.zstd = zstandard.ZstdDecompressor()
    result: bytes = _OF_THREAD.zstd.decompress(data, max_output_size=max(size, 1))
    return result


def _lz4_fits(data: bytes | memoryview, size: int) -> bool:
    """Whether the frame says itself that it unfolds to ``size`` bytes."""
    return int(lz4.frame.get_frame_info(bytes(data[:19]))["content_size"]) == size


def pieces(name: str, source: Readable | bytes | memoryview, most: int | None = None) -> Iterator[bytes]:
    """Decompressed bytes, piece by piece, each at most some MiB, from a stream or from bytes.

    Args:
        name: ``zstd``, ``lz4``, ``bz2`` or ``none``.
        source: Where compressed bytes come from.
        most: Give at most this many bytes; more than that counts as damage.

    Raises:
        BrokenStreamError: After the last piece that could be had.
        UnknownCompressionError: If there is no such compression.
    """
    stream: Readable = io.BytesIO(source) if isinstance(source, bytes | memoryview) else source
    given = 0
    try:
        for piece in _pieces(name, stream):
            given += len(piece)
            if most is not None and given > most:
                raise BrokenStreamError(f"holds more than the {most} bytes declared")
            yield piece
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError) as error:
        raise BrokenStreamError(re.sub(r"\s+", " ", str(error))) from None


def _pieces(name: str, stream: Readable) -> Iterator[bytes]:
    if name in ("", "none"):
        while piece := stream.read(_PIECE):
            yield piece
    elif name == "zstd":
        reader = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)  # type: ignore[arg-type]
        while piece := reader.read(_PIECE):
            yield piece
    elif name in ("lz4", "bz2"):
        yield from _pieces_of_object(
            lz4.frame.LZ4FrameDecompressor if name == "lz4" else bz2.BZ2Decompressor, stream
        )
    else:
        raise UnknownCompressionError(name)


def _pieces_of_object(make: Any, stream: Readable) -> Iterator[bytes]:
    decompressor = make()
    while not decompressor.eof:
        data = b""
        if decompressor.needs_input:
            data = stream.read(_PIECE)
            if not data:
                raise BrokenStreamError("ends early")
        if piece := decompressor.decompress(data, max_length=_PIECE):
            yield piece


class Part:
    """The next ``size`` bytes of a file, as a file of their own."""

    def __init__(self, file: Readable, size: int) -> None:
        self._file = file
        self._left = size

    def read(self, size: int = -1) -> bytes:
        """At most ``size`` bytes."""
        n_bytes = self._left if size < 0 else min(size, self._left)
        data = self._file.read(n_bytes)
        self._left -= len(data)
        return data
