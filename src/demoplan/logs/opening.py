"""A path to the log files behind it: by what they contain, not by their names."""

import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from demoplan.errors import LogError
from demoplan.ids import ContentHash
from demoplan.logs import compression, mcap_files, ros1_bags, rosbag2_sqlite
from demoplan.logs.compression import ZSTD_MAGIC, BrokenStreamError
from demoplan.logs.mcap_files import McapFile
from demoplan.logs.messages import Container, Tally
from demoplan.logs.ros1_bags import Ros1Bag
from demoplan.logs.rosbag2_sqlite import Rosbag2Sqlite

_SUFFIXES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
_MOST_METADATA = 4 * 2**20
_KINDS = "an MCAP file, a ROS 1 bag (2.0), a rosbag2 .db3 file, or a folder with rosbag2 files"


@dataclass(frozen=True)
class LogFile:
    """One data file of a log."""

    path: Path
    is_packed: bool
    """Compressed as a whole, as rosbag2's mode 'file' does."""

    @contextmanager
    def container(self, tally: Tally, *, check_crc: bool = False) -> Iterator[Container]:
        """The file, opened by what it contains; one that is compressed as a whole is unpacked meanwhile."""
        if not self.is_packed:
            yield _container(self.path, self.path, check_crc)
            return
        with tempfile.TemporaryDirectory(prefix="demoplan-") as folder:
            unpacked = Path(folder) / self.path.stem
            with self.path.open("rb") as packed, unpacked.open("wb") as target:
                try:
                    for piece in compression.pieces("zstd", packed):
                        target.write(piece)
                except BrokenStreamError as error:
                    tally.problems.append(f"{self.path.name} does not decompress in full: {error}")
            tally.facts["compression"] = "zstd, by file"
            yield _container(unpacked, self.path, check_crc)


def _container(path: Path, shown: Path, check_crc: bool) -> Container:
    head = _head(path)
    if head.startswith(mcap_files.MAGIC):
        return McapFile(path, check_crc=check_crc)
    if head.startswith(ros1_bags.MAGIC):
        return Ros1Bag(path)
    if head.startswith(rosbag2_sqlite.MAGIC):
        return Rosbag2Sqlite(path)
    found = "the file is empty" if not head else f"it begins with {head[:8]!r}"
    raise LogError(shown, f"not a log: {found}; expected {_KINDS}")


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise LogError(path, f"cannot be read: {error.strerror or error}") from None


def files_of(path: Path) -> tuple[LogFile, ...]:
    """The data files of a log, in the order in which they were recorded.

    A folder needs no ``metadata.yaml``, and what that says is not trusted: the files themselves are read.

    Raises:
        LogError: If nothing is there, or it is no log.
    """
    if path.is_dir():
        found = [file for file in path.iterdir() if file.is_file() and file.name.endswith(_SUFFIXES)]
        if not found:
            listed = sorted(file.name for file in path.iterdir())[:10]
            raise LogError(path, f"the folder holds no log file; found: {', '.join(listed) or 'nothing'}")
        unpacked = {file.name for file in found}
        # rosbag2 may leave the unpacked file beside the packed one: one of them is enough.
        found = [file for file in found if not (file.suffix == ".zstd" and file.stem in unpacked)]
        paths = sorted(found, key=lambda file: _natural(file.name))
    elif path.exists():
        paths = [path]
    else:
        raise LogError(path, f"does not exist; expected {_KINDS}")
    files = tuple(LogFile(file, _head(file).startswith(ZSTD_MAGIC)) for file in paths)
    for file in files:
        if not file.is_packed:
            _container(file.path, file.path, False)
    return files


def note_missing_files(path: Path, files: tuple[LogFile, ...], tally: Tally) -> None:
    """Note as a problem where a folder's ``metadata.yaml`` speaks of more data files than are there.

    Only their number counts: after a folder was renamed, the names in it are out of date.
    """
    metadata = path / "metadata.yaml"
    if not path.is_dir() or not metadata.is_file():
        return
    if metadata.stat().st_size > _MOST_METADATA:
        tally.remarks.append(f"its metadata.yaml is larger than {_MOST_METADATA} bytes and was not read")
        return
    try:
        tree = YAML(typ="safe", pure=True).load(metadata.read_text(errors="replace"))
        about = tree["rosbag2_bagfile_information"]
        listed, n_messages = [str(name) for name in about["relative_file_paths"]], about.get("message_count")
    except (YAMLError, KeyError, TypeError, AttributeError, ValueError, RecursionError):
        tally.remarks.append("its metadata.yaml does not parse; the data files were read without it")
        return
    if len(listed) > len(files):
        here = {file.path.name for file in files}
        missing = [name for name in listed if Path(name).name not in here] or listed
        tally.problems.append(
            f"its metadata.yaml speaks of {len(listed)} files, but {len(files)} are here; "
            f"missing: {', '.join(missing[:5])}"
        )
    if isinstance(n_messages, int):
        tally.facts["metadata_messages"] = str(n_messages)


def _natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """A sort key by which ``log_10`` follows ``log_9``."""
    parts: list[tuple[int, int | str]] = []
    digits, letters = "", ""
    for character in name:
        if character.isdecimal() and character.isascii():
            if letters:
                parts.append((1, letters))
                letters = ""
            digits += character
        else:
            if digits:
                parts.append((0, int(digits[:4000])))
                digits = ""
            letters += character
    parts.append((0, int(digits[:4000])) if digits else (1, letters))
    return tuple(parts)


def fingerprint(path: Path | str) -> ContentHash:
    """SHA-256 of a log's bytes, in bounded memory; of a folder: of its data files, in name order.

    Raises:
        LogError: If nothing is there, or it cannot be read.
    """
    path = Path(path)
    digest = hashlib.sha256()
    paths = [path]
    if path.is_dir():
        paths = [file.path for file in files_of(path)]
    elif not path.exists():
        raise LogError(path, f"does not exist; expected {_KINDS}")
    for file_path in paths:
        try:
            with file_path.open("rb", buffering=0) as file:
                buffer = bytearray(2**20)
                while n_bytes := file.readinto(buffer):
                    digest.update(memoryview(buffer)[:n_bytes])
        except OSError as error:
            raise LogError(file_path, f"cannot be read: {error.strerror or error}") from None
    return ContentHash(digest.hexdigest())
